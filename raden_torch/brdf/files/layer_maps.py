"""What an EXR says of the film layers in a surface: their normals, a gain on what they reflect."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor

from raden_torch.brdf.files.exr_tensors import evidence, stacked
from raden_torch.brdf.files.gbuffer_frame import GBufferFrame
from raden_torch.brdf.files.normal_coding import decoded
from raden_torch.brdf.shading.gbuffer import GBuffer
from raden_torch.images.exr_file import Key
from raden_torch.images.exr_layers import Layers


class LayerMaps:
    """The layers "layer_normal" and "gain"; rows of them are read when they are asked for.

    Normals of layers are decoded from (n + 1)/2 as normals are, and are in the space of the
    positions. A gain is one channel or three.

    Args:
        bands: rows by which the file is read.

    Attributes:
        keys: the channels, none where there are no such layers.
    """

    def __init__(
        self, layers: Layers, frame: GBufferFrame, bands: Sequence[tuple[int, int]]
    ) -> None:
        self._file, self._frame = layers.file, frame
        self._normal = layers.vector("layer_normal") or ()
        self._gain: tuple[Key, ...] = layers.vector("gain") or layers.scalar("gain") or ()
        self.keys = (*self._normal, *self._gain)
        self._coded = bool(self._normal) and evidence(self._file, self._normal, bands).is_coded

    def on(self, gbuffer: GBuffer, top: int, bottom: int) -> dict[str, Tensor]:
        """The fields of a G-buffer's rows that they are: `layer_normal` and both gains.

        Where a layer's normal is zero, the layers lie in the surface.
        """
        found: dict[str, Tensor] = {}
        if self._normal:
            stored = decoded(stacked(self._file, self._normal, top, bottom), self._coded)
            there = (stored != 0).any(dim=1, keepdim=True)
            turned = self._frame.of_positions(stored)
            found["layer_normal"] = torch.where(there, turned, gbuffer.normal)
        if self._gain:
            gain = torch.nan_to_num(stacked(self._file, self._gain, top, bottom), posinf=0.0)
            found["diffuse_gain"] = found["specular_gain"] = gain.clamp(min=0)
        return found
