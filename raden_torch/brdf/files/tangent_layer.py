"""The tangents of a G-buffer: a layer of its EXR, or one direction for all pixels."""

from __future__ import annotations

from collections.abc import Sequence

from torch import Tensor

from raden_torch.brdf.files.exr_tensors import evidence, stacked
from raden_torch.brdf.files.gbuffer_frame import GBufferFrame
from raden_torch.brdf.files.gbuffer_reading import GBufferReading
from raden_torch.brdf.files.normal_coding import decoded
from raden_torch.brdf.materials.anisotropic import no_tangent
from raden_torch.brdf.shading.triples import as_map
from raden_torch.images.exr_file import Key
from raden_torch.images.exr_layers import Layers


class TangentLayer:
    """Where the tangents are; rows of them are read when they are asked for.

    They are decoded from (t + 1)/2 as normals are, and are in the space of the positions.

    Args:
        bands: rows by which the file is read.
        turns: whether the material turns with them; otherwise there are none.

    Attributes:
        keys: the channels, none where the layer is missing or a direction is given.

    Raises:
        InputError: tangents that are named or given, and nothing that turns; no such layer.
    """

    def __init__(
        self,
        layers: Layers,
        reading: GBufferReading,
        frame: GBufferFrame,
        bands: Sequence[tuple[int, int]],
        *,
        turns: bool,
    ) -> None:
        self._file, self._frame = layers.file, frame
        self._direction = reading.tangent
        self.keys: tuple[Key, ...] = ()
        named = "tangent" in (reading.channels or {}) and reading.space != "tangent"
        if not turns:
            if named or self._direction is not None:
                raise no_tangent(f"{layers.file.path}: tangent")
            return
        if self._direction is None:
            self.keys = layers.vector("tangent") or ()
        self._coded = bool(self.keys) and evidence(self._file, self.keys, bands).is_coded

    def rows(self, top: int, bottom: int, like: Tensor) -> Tensor | None:
        """`[1, 3, rows, W]`, or `[1, 3, 1, 1]` where one is for all; zero where there is none."""
        if self._direction is not None:
            return as_map(self._frame.of_triple("tangent", self._direction), like)
        if not self.keys:
            return None
        stored = decoded(stacked(self._file, self.keys, top, bottom), self._coded)
        return self._frame.of_positions(stored)
