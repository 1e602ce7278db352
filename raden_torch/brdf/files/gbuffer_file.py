"""G-buffers in OpenEXR files: which channels are the normals, the positions, the depth.

`images/exr_file.py` reads rows of channels, `images/exr_layers.py` knows the names of layers, and
`gbuffer_reading.py` what else has to be said; here they become a `GBuffer`.

Whatever the file holds, the G-buffer is in one frame: the camera's, x right, y up, z to the viewer,
with the camera at the origin and the scene at z < 0 where positions come from depth; or the world's
with y up, where vectors are declared to be in world space (`gbuffer_frame.py`).
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import replace
from typing import Any, cast

import torch
from torch import Tensor

from raden_torch.brdf.files.bands import BYTES_GATHERED, bands_of
from raden_torch.brdf.files.depth_check import warn_of_other_kind
from raden_torch.brdf.files.exr_tensors import evidence, stacked
from raden_torch.brdf.files.gbuffer_reading import USUAL, GBufferReading
from raden_torch.brdf.files.layer_maps import LayerMaps
from raden_torch.brdf.files.material_map import MaterialMap, nothing_to_choose
from raden_torch.brdf.files.normal_check import warn_of_facing, warn_of_normals
from raden_torch.brdf.files.normal_coding import decoded, has_negative
from raden_torch.brdf.files.pinhole import Y_UP, pinhole_matrix, rays
from raden_torch.brdf.files.tangent_layer import TangentLayer
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
from raden_torch.images.exr_file import ExrFile, Key
from raden_torch.images.exr_layers import Layers


def read_gbuffer(
    path: str | os.PathLike[str],
    *,
    palette: Palette | None = None,
    turns: bool = False,
    **reading: Any,
) -> GBuffer:
    """The G-buffer in an EXR file; the frame is that of this module.

    Normals are found by name (`NAMES`, as "N.X", "Normal.R", "ViewLayer.Normal.X") or are the bare
    RGB of a file whose colours are unit vectors, not all positive. They are decoded from (n + 1)/2
    where no value is below −0.02 and the median vector comes nearer to unit length by it. Without
    normals they are made from depth, which is planar z unless `depth` says otherwise.

    Args:
        palette: of which the pixels' materials are read; None reads none.
        turns: whether tangents are read, too, where there are some.
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
    file = GBufferFile(path, GBufferReading(**reading), palette=palette, turns=turns)
    gbuffer = file.rows(0, file.size[0])
    if not has_pixels(gbuffer):
        raise file.is_empty()
    return gbuffer


class GBufferFile:
    """The G-buffer in an EXR file, read some rows at a time; otherwise as `read_gbuffer`.

    Every band is as those rows of the whole.

    Attributes:
        size: height and width in pixels.
        channels: all of the file's, by name.
        bands: (first row, row after the last) of each part that fits the memory.

    Args:
        memory: bytes that a band may take with all that shading it and writing it needs; where
            None, the whole file is one band.
        palette, turns: as for `read_gbuffer`.
        is_checked: whether what seems to be declared wrongly is warned of.
    """

    def __init__(
        self,
        path: str | os.PathLike[str],
        reading: GBufferReading = USUAL,
        *,
        memory: int | None = None,
        palette: Palette | None = None,
        turns: bool = False,
        is_checked: bool = True,
    ) -> None:
        self.path, self._reading, self._is_checked = path, reading, is_checked
        self._kind, self._axes = depth_kind(reading.depth or "planar"), reading.axes
        self._file = ExrFile(path)
        self.size = self._file.size
        self.channels = tuple(key for key, _, _ in self._file.keys)
        self._material = self._materials(palette)
        gathered = 0 if self._material is None else max(1, len(self._material.keys))
        self.bands = bands_of(self._file, memory, BYTES_GATHERED * gathered)
        layers = Layers.of(self._file, reading.channels)
        self._normal, self._coded = self._normals(layers)
        self._depth, self._mask = layers.scalar("depth"), layers.scalar("mask")
        self._position = None if self._normal is None else layers.vector("position")
        is_tangent = reading.space == "tangent"
        self._surface = layers.vector("surface") if is_tangent else None
        self._tangent = layers.vector("tangent") if is_tangent else None
        self._frame = reading.frame(path, self._file.first)
        self._turning = TangentLayer(layers, reading, self._frame, self.bands, turns=turns)
        self._layers = LayerMaps(layers, self._frame, self.bands)
        self._matrix = self._pinhole()
        self._check(layers)

    def rows(self, top: int, bottom: int) -> GBuffer:
        """The rows from `top` to before `bottom`, a batch of 1 in float32."""
        maps = (self._normal, self._position, self._surface, self._tangent, self._turning.keys)
        keys = [
            key
            for each in (*maps, self._layers.keys, self._depth, self._mask)
            for key in each or ()
        ]
        if self._material is not None and self._reading.material is None:
            keys += self._material.keys
        self._file.read(keys, top, bottom)
        stored = self._read(self._depth, top, bottom)
        depth = None if stored is None else in_front(stored, self._kind)
        if self._normal is not None:
            found = self._from_normals(depth, top, bottom)
        else:
            found = self._from_depth(cast(Tensor, depth))
        found = replace(
            found,
            tangent=self._turning.rows(top, bottom, found.normal),
            **self._layers.on(found, top, bottom),
        )
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
        intrinsics, fov_deg = said.intrinsics, said.fov_deg
        if intrinsics is None and fov_deg is None and (pose := self._frame.pose) is not None:
            intrinsics, fov_deg = pose.intrinsics, pose.fov_deg
        try:
            return pinhole_matrix(intrinsics, fov_deg, self.size, aspect)
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
            if self._frame.is_world:
                self._check_viewer()
            return
        if self._depth is None:
            raise layers.missing("expected normals or a depth")
        if not pinhole:
            raise InputError(
                f"{self.path}: expected normals, or a depth and its camera, got the channels "
                f"{layers.listing}; give `fov_deg` or intrinsics, or name the normals' layer by "
                "`channels`"
            )
        if self._reading.camera is not None:
            raise at_origin
        if len(self.bands) > 1:
            raise InputError(
                f"{self.path}: expected normals, got depth alone, from which normals are computed "
                "on the whole image at once: allow more memory, or add normals to the image"
            )

    def _check_viewer(self) -> None:
        """Raise InputError where vectors are in world space and the viewer is not known."""
        pose, said = self._frame.pose, self._reading
        stands = said.camera is not None or pose is not None
        looks = pose is not None and pose.axes is not None
        if said.view is None and not looks and not (stands and self._position is not None):
            raise InputError(
                f"{self.path}: camera: expected where it is, with vectors in world space; give "
                "camera (--camera x,y,z) with a layer of positions, or a camera file "
                "(--camera-file), or view"
            )

    def _read(self, keys: tuple[Key, ...] | None, top: int, bottom: int) -> Tensor | None:
        return None if keys is None else stacked(self._file, keys, top, bottom)

    def _from_normals(self, depth: Tensor | None, top: int, bottom: int) -> GBuffer:
        frame, said = self._frame, self._reading
        stored = decoded(cast(Tensor, self._read(self._normal, top, bottom)), self._coded)
        around = (self._read(keys, top, bottom) for keys in (self._surface, self._tangent))
        normal = frame.of_normals(self._axes.of_map(stored), *around)
        there = (stored != 0).any(dim=1, keepdim=True)
        if depth is not None:
            there = there & is_depth(depth)
        mask = self._masked(there, top, bottom)
        position = self._read(self._position, top, bottom)
        position = None if position is None else frame.of_positions(position)
        through = None
        if self._matrix is not None:
            through = frame.of_camera(rays(self._matrix, top, bottom, self.size[1]))
        camera = None if said.camera is None else frame.of_triple("camera", said.camera)
        if position is None and depth is not None and through is not None:
            position = self._positions(depth, through)
            camera = frame.camera if said.view is None else None
        elif position is not None and camera is None and said.view is None and frame.is_world:
            camera = frame.camera
        if camera is not None:
            gbuffer = GBuffer(normal, position=position, camera=camera, mask=mask)
        else:
            view = self._view(through, top, bottom)
            gbuffer = GBuffer(normal, view=view, position=position, mask=mask)
        if self._is_checked and top <= self.size[0] // 2 < bottom:
            if frame.is_world:
                warn_of_facing(self.path, gbuffer)
            elif said.camera is None and said.view is None and said.space == "camera":
                warn_of_normals(self.path, stored * (mask > 0), self._axes, is_coded=self._coded)
        return gbuffer

    def _view(self, through: Tensor | None, top: int, bottom: int) -> Tensor:
        """Towards the viewer, as it was said, else along the rays, else along the camera's axis."""
        view = self._reading.view
        if view is None:
            axis = torch.tensor([0.0, 0.0, 1.0]).view(1, 3, 1, 1)
            return self._frame.of_camera(axis) if through is None else -through
        if isinstance(view, Tensor) and view.ndim == 4:
            if view.shape[2] == self.size[0]:
                view = view[:, :, top:bottom]
            return self._frame.of_viewer(_as_view(view))
        return _as_view(self._frame.of_triple("view", view))

    def _from_depth(self, depth: Tensor) -> GBuffer:
        matrix, (height, width) = cast(Tensor, self._matrix), self.size
        through = rays(matrix, 0, height, width)
        there = is_depth(depth)
        self._warn_of_depth(depth, there, through)
        position = self._in_camera(depth, through)
        # a neutral depth of 1 where there is none
        made = GBuffer.from_depth(grown(-position[:, 2:], there, self._reading.smooth_px), matrix)
        y_up = depth.new_tensor(Y_UP).view(3, 1, 1)
        normal = torch.where(there, made.normal * y_up, torch.zeros_like(made.normal))
        mask = self._masked(there, 0, height)
        frame = self._frame
        normal, position = frame.of_camera(normal), self._positions(depth, frame.of_camera(through))
        if self._reading.view is not None:
            view = self._view(None, 0, height)
            return GBuffer(normal, view=view, position=position, mask=mask)
        return GBuffer(normal, position=position, camera=frame.camera, mask=mask)

    def _warn_of_depth(self, depth: Tensor, there: Tensor, through: Tensor) -> None:
        if not bool(there.any()) and bool((depth < 0).any()):
            raise InputError(
                f"{self.path}: depth: expected a valid pixel, got none above 0; if it is the z of "
                'a camera that looks along −z, give `depth="negative"`'
            )
        if not self._is_checked:
            return
        if self._reading.smooth_px <= 0:
            warn_of_steps(self.path, depth[there], cast(Tensor, self._matrix))
        if self._reading.depth is None:
            warn_of_other_kind(self.path, depth, there, through)

    def _positions(self, depth: Tensor, through: Tensor) -> Tensor:
        """In the frame, on its rays; where there is no depth, at 1 along the axis."""
        origin = depth.new_tensor(self._frame.camera or (0.0, 0.0, 0.0)).view(3, 1, 1)
        return self._in_camera(depth, through) + origin

    def _in_camera(self, depth: Tensor, through: Tensor) -> Tensor:
        """The same from the camera's place."""
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


def _as_view(view: Tensor | Sequence[float]) -> Tensor:
    return torch.as_tensor(view, dtype=torch.float32, device="cpu")
