"""G-buffers in OpenEXR files: which channels are the normals, the positions, the depth.

`images/exr_file.py` reads rows of channels, `images/exr_layers.py` knows the names of layers, and
`gbuffer_reading.py` what else has to be said; here they become a `GBuffer`.

Whatever the file holds, the G-buffer is in one frame: x right, y up, z to the viewer. Normals and
positions are taken as they are; a renderer that writes world-space vectors must have looked along
−z, or the lights are in its world's frame. Positions and normals that come from depth have the
camera at the origin and the scene at z < 0.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import replace
from math import lcm
from typing import Any, cast

import torch
from torch import Tensor

from raden_torch.brdf.files.depth_check import warn_of_other_kind
from raden_torch.brdf.files.exr_tensors import evidence, stacked
from raden_torch.brdf.files.gbuffer_reading import USUAL, GBufferReading
from raden_torch.brdf.files.material_map import MaterialMap, nothing_to_choose
from raden_torch.brdf.files.normal_check import warn_of_normals
from raden_torch.brdf.files.normal_coding import decoded, has_negative
from raden_torch.brdf.files.pinhole import Y_UP, pinhole_matrix, rays
from raden_torch.brdf.materials.palette import Palette
from raden_torch.brdf.shading.depth import (
    FAR,
    depth_kind,
    grown,
    in_front,
    is_depth,
    to_planar,
    warn_of_steps,
)
from raden_torch.brdf.shading.gbuffer import GBuffer
from raden_torch.errors import InputError
from raden_torch.images.exr import WRITTEN_LINES
from raden_torch.images.exr_file import ExrFile, Key
from raden_torch.images.exr_layers import Layers

BYTES_A_PIXEL, BYTES_A_CHANNEL, BYTES_GATHERED = 240, 10, 120
"""The most that reading, shading and writing some rows takes: that of the eager form. With the
fused kernel it is a third. What a palette gathers comes on top, once for each of its weights."""


def read_gbuffer(
    path: str | os.PathLike[str], *, palette: Palette | None = None, **reading: Any
) -> GBuffer:
    """The G-buffer in an EXR file; the frame is that of this module.

    Normals are found by name (`NAMES`, as "N.X", "Normal.R", "ViewLayer.Normal.X") or are the bare
    RGB of a file whose colours are unit vectors, not all positive. They are decoded from (n + 1)/2
    where no value is below −0.02 and the median vector comes nearer to unit length by it. Without
    normals they are made from depth, which is planar z unless `depth` says otherwise.

    Args:
        palette: of which the pixels' materials are read; None reads none.
        reading: attributes of `GBufferReading`, as in `fov_deg=40`.

    Returns:
        A batch of 1 in float32. The mask is the file's mask or alpha, and 0 where the normal is
        zero or not finite, or the depth is: not finite, not positive, beyond `FAR` or 65504.

    Raises:
        InputError: no such channel (the message lists those there are), depth without a camera, no
            valid pixel, or a file that `ExrFile` rejects.

    Warns:
        UserWarning: the steps of half-precision depth will show in the normals; depth that is not
            declared is the distance along the ray, by the shapes that it shows; without `camera`
            and `view`, normals are stored otherwise, by `normal_check`.
    """
    file = GBufferFile(path, GBufferReading(**reading), palette=palette)
    gbuffer = file.rows(0, file.size[0])
    if not has_pixels(gbuffer):
        raise file.is_empty()
    return gbuffer


class GBufferFile:
    """The G-buffer in an EXR file, read some rows at a time; otherwise as `read_gbuffer`.

    Every band is as those rows of the whole.

    Attributes:
        size: height and width in pixels.
        bands: (first row, row after the last) of each part that fits the memory.

    Args:
        memory: bytes that a band may take with all that shading it and writing it needs; where
            None, the whole file is one band.
        palette: of which the pixels' materials are read; None reads none.
    """

    def __init__(
        self,
        path: str | os.PathLike[str],
        reading: GBufferReading = USUAL,
        *,
        memory: int | None = None,
        palette: Palette | None = None,
    ) -> None:
        self.path, self._reading = path, reading
        self._kind, self._axes = depth_kind(reading.depth or "planar"), reading.axes
        self._file = ExrFile(path)
        self.size = self._file.size
        self._material = self._materials(palette)
        gathered = 0 if self._material is None else max(1, len(self._material.keys))
        self.bands = _bands(self._file, memory, BYTES_GATHERED * gathered)
        layers = Layers.of(self._file, reading.channels)
        self._normal, self._coded = self._normals(layers)
        self._depth, self._mask = layers.scalar("depth"), layers.scalar("mask")
        self._position = None if self._normal is None else layers.vector("position")
        self._matrix = self._pinhole()
        self._check(layers)

    def rows(self, top: int, bottom: int) -> GBuffer:
        """The rows from `top` to before `bottom`, a batch of 1 in float32."""
        keys = [*(self._normal or ()), *(self._position or ())]
        keys += [*(self._depth or ()), *(self._mask or ())]
        if self._material is not None and self._reading.material is None:
            keys += self._material.keys
        self._file.read(keys, top, bottom)
        stored = self._read(self._depth, top, bottom)
        depth = None if stored is None else in_front(stored, self._kind)
        if self._normal is not None:
            found = self._from_normals(depth, top, bottom)
        else:
            found = self._from_depth(cast(Tensor, depth))
        if self._material is None:
            return found
        return replace(found, material=self._material.rows(top, bottom, found.mask))

    def is_empty(self) -> InputError:
        """What to raise where no pixel of all rows is valid."""
        return InputError(
            f"{self.path}: expected normals that are not zero, depth between 0 and {FAR:g} and a "
            "mask above 0, got no valid pixel"
        )

    def _normals(self, layers: Layers) -> tuple[tuple[Key, ...] | None, bool]:
        """Their channels, and whether they are coded, by the evidence of all rows."""
        named = layers.vector("normal")
        keys = named or layers.bare_vector()
        if keys is None:
            return None, False
        if named and any(has_negative(stacked(self._file, keys, *band)) for band in self.bands):
            return keys, False
        found = evidence(self._file, keys, self.bands)
        return (keys if named or found.is_normals else None), found.is_coded

    def _materials(self, palette: Palette | None) -> MaterialMap | None:
        """None where there is nothing to choose."""
        path = self._reading.material
        named = (self._reading.channels or {}).get("material")
        if palette is None or (len(palette) == 1 and path is None and named is None):
            if path is not None or named is not None:
                raise nothing_to_choose(path or self.path)
            return None
        if path is not None:
            return MaterialMap(path, palette, self.size, named)
        return MaterialMap(self.path, palette, self.size, named, self._file)

    def _pinhole(self) -> Tensor | None:
        said, aspect = self._reading, self._file.first.pixel_aspect
        try:
            return pinhole_matrix(said.intrinsics, said.fov_deg, self.size, aspect)
        except InputError as error:
            raise InputError(f"{self.path}: {error}") from None

    def _check(self, layers: Layers) -> None:
        pinhole = self._matrix is not None
        at_origin = InputError(
            f"{self.path}: camera: expected none with positions from depth, which have it at "
            "0, 0, 0, got one"
        )
        if self._normal is not None:
            if self._reading.camera is not None and self._position is None:
                if self._depth is not None and pinhole:
                    raise at_origin
                raise layers.missing("camera: expected positions with it (position=LAYER)")
            return
        if self._depth is None:
            raise layers.missing("expected normals or a depth")
        if not pinhole:
            raise InputError(
                f"{self.path}: expected normals, or a depth and its camera, got the channels "
                f"{layers.listing}; give intrinsics or fov_deg, or name the normals' layer"
            )
        if self._reading.camera is not None:
            raise at_origin
        if len(self.bands) > 1:
            raise InputError(
                f"{self.path}: expected normals, got depth alone, from which normals are computed "
                "on the whole image at once: allow more memory, or add normals to the image"
            )

    def _read(self, keys: tuple[Key, ...] | None, top: int, bottom: int) -> Tensor | None:
        return None if keys is None else stacked(self._file, keys, top, bottom)

    def _from_normals(self, depth: Tensor | None, top: int, bottom: int) -> GBuffer:
        stored = decoded(cast(Tensor, self._read(self._normal, top, bottom)), self._coded)
        normal = self._axes.of_map(stored)
        position = self._read(self._position, top, bottom)
        camera, view = self._reading.camera, self._reading.view
        there = (normal != 0).any(dim=1, keepdim=True)
        if depth is not None:
            there = there & is_depth(depth)
        mask = self._masked(there, top, bottom)
        is_in_the_middle = top <= self.size[0] // 2 < bottom
        if is_in_the_middle and self._reading.camera is None and self._reading.view is None:
            warn_of_normals(self.path, stored * (mask > 0), self._axes, is_coded=self._coded)
        through = None if self._matrix is None else rays(self._matrix, top, bottom, self.size[1])
        if position is None and depth is not None and through is not None:
            position = self._positions(depth, through)
            camera = (0.0, 0.0, 0.0) if view is None else None
        if camera is not None:
            return GBuffer(normal, position=position, camera=camera, mask=mask)
        if view is None:
            view = (0.0, 0.0, 1.0) if through is None else -through
        elif isinstance(view, Tensor) and view.ndim == 4 and view.shape[2] == self.size[0]:
            view = view[:, :, top:bottom]
        return GBuffer(normal, view=_as_view(view), position=position, mask=mask)

    def _from_depth(self, depth: Tensor) -> GBuffer:
        matrix, (height, width) = cast(Tensor, self._matrix), self.size
        through = rays(matrix, 0, height, width)
        there = is_depth(depth)
        self._warn_of_depth(depth, there, through)
        position = self._positions(depth, through)
        # a neutral depth of 1 where there is none
        made = GBuffer.from_depth(grown(-position[:, 2:], there, self._reading.smooth_px), matrix)
        y_up = depth.new_tensor(Y_UP).view(3, 1, 1)
        normal = torch.where(there, made.normal * y_up, torch.zeros_like(made.normal))
        mask = self._masked(there, 0, height)
        if self._reading.view is not None:
            return GBuffer(normal, view=_as_view(self._reading.view), position=position, mask=mask)
        return GBuffer(normal, position=position, camera=(0.0, 0.0, 0.0), mask=mask)

    def _warn_of_depth(self, depth: Tensor, there: Tensor, through: Tensor) -> None:
        if not bool(there.any()) and bool((depth < 0).any()):
            raise InputError(
                f"{self.path}: depth: expected a valid pixel, got none above 0; if it is the z of "
                'a camera that looks along −z, give `depth="negative"`'
            )
        if self._reading.smooth_px <= 0:
            warn_of_steps(self.path, depth[there], cast(Tensor, self._matrix))
        if self._reading.depth is None:
            warn_of_other_kind(self.path, depth, there, through)

    def _positions(self, depth: Tensor, through: Tensor) -> Tensor:
        """On the rays; where there is no depth, at 1 along the axis."""
        planar = to_planar(depth, self._kind, through)
        return torch.where(is_depth(depth), planar, torch.ones_like(depth)) * through

    def _masked(self, there: Tensor, top: int, bottom: int) -> Tensor:
        mask = self._read(self._mask, top, bottom)
        if mask is None:
            return there.float()
        return torch.nan_to_num(mask, nan=0.0).clamp(0, 1) * there


def has_pixels(gbuffer: GBuffer) -> bool:
    """Whether some pixel is not masked out."""
    return gbuffer.mask is None or bool((gbuffer.mask > 0).any())


def _bands(file: ExrFile, memory: int | None, more: int) -> list[tuple[int, int]]:
    """Args: more: bytes a pixel than a model alone takes."""
    height, width = file.size
    a_row = width * (BYTES_A_PIXEL + more + BYTES_A_CHANNEL * len(file.keys))
    if memory is None:
        if not file.may_be_whole:
            raise InputError(
                f"{file.path}: expected a frame that can be read at once, got {width} x {height} "
                "pixels; `raden render` shades it in bands if it writes an .exr"
            )
        return [(0, height)]
    rows = min(memory // a_row, file.most_rows)
    if rows >= height:
        return [(0, height)]
    step = lcm(WRITTEN_LINES, file.chunk_rows)
    rows = rows // step * step
    if rows == 0:
        raise InputError(
            f"{file.path}: memory: expected at least {min(step, height) * a_row} bytes for "
            f"{min(step, height)} rows, the fewest that can be read at once, got {memory}"
        )
    return [(top, min(top + rows, height)) for top in range(0, height, rows)]


def _as_view(view: Tensor | Sequence[float]) -> Tensor:
    return torch.as_tensor(view, dtype=torch.float32, device="cpu")
