"""G-buffers in OpenEXR files: which channels are the normals, the positions, the depth.

Whatever the file holds, the G-buffer is in one frame: x right, y up, z to the viewer. Normals and
positions are taken as they are; a renderer that writes world-space vectors must have looked along
−z, or the lights are in its world's frame. Positions and normals that come from depth have the
camera at the origin and the scene at z < 0.
"""

from __future__ import annotations

import os
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import radians, tan

import numpy as np
import torch
from numpy.typing import ArrayLike, NDArray
from torch import Tensor

from raden_torch.brdf.exr import channel_keys, read_parts, write_channels
from raden_torch.brdf.gbuffer import GBuffer
from raden_torch.brdf.lights import Triple
from raden_torch.errors import InputError

NAMES: dict[str, tuple[str, ...]] = {
    "normal": (
        *("n", "normal", "normals", "ns", "nn", "normalworld", "normal_world", "worldnormal"),
        *("world_normal", "sh_normal", "shading_normal", "denoising normal"),
    ),
    "position": ("p", "position", "positions", "pos", "worldposition", "world_position", "pworld"),
    "depth": ("z", "depth", "zdepth", "depth_z"),
    "mask": ("mask", "a", "alpha"),
    "colour": ("", "rgba", "rgb", "beauty", "combined", "colour", "color"),
}
"""The layer names that are known, compared in lower case, the first one first. A name found
nowhere as a whole may be the last part of one layer's name ("ViewLayer.Normal")."""

FAR = 1e9
"""Depth from which on there is nothing; so also 65504, the largest half."""
MAX_SMOOTH_PX = 100.0
UNIT_SHARE = 0.8
"""A bare RGB image holds normals where this share of its pixels that are not black has length 1."""
UNIT_TOLERANCE = 0.02

_VECTORS = ("xyz", "rgb")
_SCALARS = ("v", "z", "r", "y")
_LARGEST_HALF = 65504.0
_Y_UP = (1.0, -1.0, -1.0)  # x right, y down, z forward → x right, y up, z to the viewer


def read_gbuffer(
    path: str | os.PathLike[str],
    *,
    channels: Mapping[str, str] | None = None,
    intrinsics: Tensor | ArrayLike | None = None,
    fov_deg: float | None = None,
    camera: Triple | None = None,
    view: Triple | None = None,
    smooth_px: float = 0.0,
) -> GBuffer:
    """The G-buffer in an EXR file; the frame is that of this module.

    Normals are found by name (`NAMES`, as "N.X", "Normal.R", "ViewLayer.Normal.X") or are the bare
    RGB of a file whose colours are unit vectors, not all positive. They are decoded from (n + 1)/2
    where no value is below −0.02 and the median vector comes nearer to unit length by it. Without
    normals they are made from depth, the distance along the camera's axis.

    The direction to the viewer is, the first that is given: `view`; from positions to `camera`; a
    pinhole's, by `intrinsics` or `fov_deg`; (0, 0, 1), a camera at infinity that looks along −z.

    Args:
        channels: layers by name, `{"normal": "MyLayer", "position": …, "depth": "Z2", "mask": …}`;
            a vector's three channels also as "nx,ny,nz".
        intrinsics: `[3, 3]` pinhole matrix in pixels of the display window, y down.
        fov_deg: instead, the horizontal angle of view of square pixels around the centre.
        camera: `[3]`, the viewer's position, for a file with positions.
        view: `[3]` towards a viewer at infinity, or a map `[1, 3, H, W]`.
        smooth_px: standard deviation of a Gaussian over the depth before normals are made of it;
            depth in half precision needs one of several pixels.

    Returns:
        A batch of 1 in float32. The mask is the file's mask or alpha, and 0 where the normal is
        zero or not finite, or the depth is: not finite, not positive, beyond `FAR` or 65504.

    Raises:
        InputError: no such channel (the message lists those there are), depth without a camera, no
            valid pixel, or a file that `read_parts` rejects.

    Warns:
        UserWarning: the steps of half-precision depth will show in the normals.
    """
    source = _Source.of(path, channels)
    if view is not None and camera is not None:
        raise InputError(f"{path}: view and camera are both given; one of them was wanted")
    normal, depth = source.normals(), source.scalar("depth")
    matrix = _matrix(intrinsics, fov_deg, source.size)
    if not 0 <= smooth_px <= MAX_SMOOTH_PX:
        raise InputError(f"smooth_px {smooth_px:g}; 0…{MAX_SMOOTH_PX:g} pixels were wanted")
    if normal is not None:
        gbuffer = _from_normals(source, normal, depth, matrix, camera, view)
    elif depth is None:
        raise source.missing("no normals and no depth")
    elif matrix is None:
        raise InputError(
            f"{path}: depth without normals; give intrinsics or fov_deg, or name the normals' "
            f"layer among its channels {source.listing}"
        )
    elif camera is not None:
        raise source.camera_is_at_origin()
    else:
        gbuffer = _from_depth(source, depth, matrix, view, smooth_px)
    if not (gbuffer.mask is None or bool((gbuffer.mask > 0).any())):
        raise InputError(
            f"{path}: no valid pixel; normals that are not zero, depth between 0 and {FAR:g} and a "
            "mask above 0 were wanted"
        )
    return gbuffer


def read_colour(
    path: str | os.PathLike[str], *, channels: Mapping[str, str] | None = None
) -> Tensor | None:
    """`[1, 3, H, W]` scene-linear RGB of the file, or None where it holds none.

    As OpenEXR has it, multiplied by alpha. The bare R, G, B, or a layer in `NAMES`; values that are
    not finite become 0. Bare colours that are unit vectors are normals, not colours.

    Args:
        channels: as for `read_gbuffer`, `{"colour": "Layer"}`.
    """
    source = _Source.of(path, channels)
    colour = source.vector("colour")
    if colour is None or ("colour" not in source.chosen and source.bare_normals() is not None):
        return None
    return torch.where(torch.isfinite(colour), colour, torch.zeros_like(colour))


def write_image(image: Tensor, path: str | os.PathLike[str]) -> None:
    """Write scene-linear `[1, 3, H, W]` RGB as an EXR of half floats, cut off at ±65504."""
    if image.ndim != 4 or image.shape[:2] != (1, 3):
        raise InputError(f"{path}: image of shape {list(image.shape)}; [1, 3, H, W] was wanted")
    rgb = image[0].detach().float().clamp(-_LARGEST_HALF, _LARGEST_HALF).cpu().numpy()
    write_channels(path, dict(zip("RGB", rgb, strict=True)), half=True)


@dataclass(frozen=True)
class _Source:
    """The channels of a file by all the names that they go by.

    Attributes:
        arrays: by name; in a multi-part file also as "part.name".
        layers: layer in lower case → last part of the name in lower case → name.
        chosen: what the caller named.
        listing: the channels as `list_channels` names them, for messages.
    """

    path: str | os.PathLike[str]
    arrays: dict[str, NDArray[np.float32]]
    layers: dict[str, dict[str, str]]
    chosen: Mapping[str, str]
    listing: str

    @classmethod
    def of(cls, path: str | os.PathLike[str], chosen: Mapping[str, str] | None) -> _Source:
        unknown = [name for name in chosen or {} if name not in NAMES]
        if unknown:
            raise InputError(f"channels: {unknown[0]!r}; {', '.join(NAMES)} were wanted")
        parts = read_parts(path)
        keys = channel_keys(parts)
        arrays = {key: parts[part][name] for key, part, name in keys}
        if len(parts) > 1:
            for _, part, name in keys:
                arrays.setdefault(f"{part}.{name}", parts[part][name])
        layers: dict[str, dict[str, str]] = {}
        for name in arrays:
            layer, _, last = name.lower().rpartition(".")
            layers.setdefault(layer, {}).setdefault(last, name)
        shown = [key for key, _, _ in keys]
        more = f" and {len(shown) - 40} more" if len(shown) > 40 else ""
        return cls(path, arrays, layers, chosen or {}, ", ".join(shown[:40]) + more)

    @property
    def size(self) -> tuple[int, int]:
        height, width = next(iter(self.arrays.values())).shape
        return height, width

    def missing(self, what: str) -> InputError:
        return InputError(
            f"{self.path}: {what}; it has the channels {self.listing}: name a layer of them, as in "
            "normal=LAYER"
        )

    def camera_is_at_origin(self) -> InputError:
        return InputError(
            f"{self.path}: camera is given, but positions from depth have it at 0, 0, 0"
        )

    def normals(self) -> Tensor | None:
        """`[1, 3, H, W]`, decoded, 0 where there are none."""
        normal = self.vector("normal")
        return self.bare_normals() if normal is None else decoded(normal)

    def bare_normals(self) -> Tensor | None:
        """The bare R, G, B, decoded, if they are unit vectors and no layer is called normals.

        Some component must be negative: an image of pure red and blue has unit colours, too.
        """
        bare = self._stack(self._vector_in(""))
        if bare is None or "normal" in self.chosen or self._named("normal", self._vectors()):
            return None
        normal = decoded(bare)
        length = _length(normal)
        unit = (length[length > 0] - 1).abs() < UNIT_TOLERANCE
        signed = bool((normal < -UNIT_TOLERANCE).any())
        return normal if signed and bool(unit.float().mean() >= UNIT_SHARE) else None

    def vector(self, what: str) -> Tensor | None:
        """`[1, 3, H, W]` of the layer that was named, else of a known one, else None."""
        names = None
        if what in self.chosen:
            text = self.chosen[what]
            names = self._listed(what, text) if "," in text else self._vector_in(text.lower())
            if names is None:
                raise self.missing(f"no layer {text!r} with X, Y, Z or R, G, B for the {what}")
        else:
            names = self._named(what, self._vectors())
        return self._stack(names)

    def scalar(self, what: str) -> Tensor | None:
        """`[1, 1, H, W]`, likewise."""
        if what in self.chosen:
            text = self.chosen[what]
            names = self._scalars().get(text.lower())
            if names is None:
                raise self.missing(f"no channel {text!r} for the {what}")
        else:
            names = self._named(what, self._scalars())
        return self._stack(names)

    def _named(
        self, what: str, candidates: Mapping[str, tuple[str, ...]]
    ) -> tuple[str, ...] | None:
        """The candidate with a known name; several by the last part of it are an error."""
        for name in NAMES[what]:
            if name in candidates:
                return candidates[name]
        for name in filter(None, NAMES[what]):
            found = {
                id(self.arrays[names[0]]): layer
                for layer, names in candidates.items()
                if layer.rpartition(".")[2] == name
            }
            if len(found) > 1 and what in ("normal", "depth"):
                several = ", ".join(found.values())
                raise self.missing(f"several layers may be the {what} ({several})")
            if len(found) == 1:
                return candidates[next(iter(found.values()))]
        return None

    def _vectors(self) -> dict[str, tuple[str, ...]]:
        found = {layer: self._vector_in(layer) for layer in self.layers}
        return {layer: names for layer, names in found.items() if names is not None}

    def _vector_in(self, layer: str) -> tuple[str, ...] | None:
        members = self.layers.get(layer, {})
        for letters in _VECTORS:
            if all(letter in members for letter in letters):
                return tuple(members[letter] for letter in letters)
        return None

    def _scalars(self) -> dict[str, tuple[str, ...]]:
        """Channels by their names, and layers that stand for one channel ("Depth.V")."""
        found: dict[str, tuple[str, ...]] = {}
        for layer, members in self.layers.items():
            vector = all(letter in members for letter in "xyz")
            for last, name in members.items():
                if not vector:
                    found[f"{layer}.{last}".lstrip(".")] = (name,)
        for layer, members in self.layers.items():
            letters = [letter for letter in _SCALARS if letter in members]
            if layer and letters and "x" not in members:
                found.setdefault(layer, (members[letters[0]],))
        return found

    def _listed(self, what: str, text: str) -> tuple[str, ...]:
        names = tuple(name.strip() for name in text.split(","))
        absent = [name for name in names if name not in self.arrays]
        if absent or len(names) != 3:
            raise self.missing(f"{text!r} for the {what} is not three of its channels")
        return names

    def _stack(self, names: tuple[str, ...] | None) -> Tensor | None:
        if names is None:
            return None
        return torch.from_numpy(np.stack([self.arrays[name] for name in names]))[None]


def decoded(normal: Tensor) -> Tensor:
    """Normals `[B, 3, H, W]` as stored → −1…1, and 0 where there are none.

    They are taken as (n + 1)/2 where no value is below −0.02 and the median vector comes nearer to
    unit length so. Then black pixels, and grey ones (0.5, 0.5, 0.5), have no normal.
    """
    finite = torch.isfinite(normal).all(dim=1, keepdim=True)
    normal = torch.where(finite, normal, torch.zeros_like(normal))
    there = (normal != 0).any(dim=1, keepdim=True)
    if not there.any() or bool((normal < -UNIT_TOLERANCE).any()):
        return normal
    spread = 2 * normal - 1
    as_is = (_length(normal)[there] - 1).abs().median()
    by_half = (_length(spread)[there] - 1).abs().median()
    if as_is <= by_half:
        return normal
    return torch.where(there & (_length(spread) > 0.1), spread, torch.zeros_like(normal))


def _from_normals(
    source: _Source,
    normal: Tensor,
    depth: Tensor | None,
    matrix: Tensor | None,
    camera: Triple | None,
    view: Triple | None,
) -> GBuffer:
    position = source.vector("position")
    mask = _mask(source, (normal != 0).any(dim=1, keepdim=True))
    if depth is not None:
        mask = mask * _is_depth(depth)
    rays = None if matrix is None else _rays(matrix, source.size)
    if position is None and depth is not None and rays is not None:
        position = torch.where(_is_depth(depth), depth, torch.ones_like(depth)) * rays
        if camera is not None:
            raise source.camera_is_at_origin()
        camera = (0.0, 0.0, 0.0) if view is None else None
    if camera is not None:
        if position is None:
            raise source.missing("camera is given, but there are no positions (position=LAYER)")
        return GBuffer(normal, position=position, camera=camera, mask=mask)
    if view is None:
        view = (0.0, 0.0, 1.0) if rays is None else -rays
    return GBuffer(normal, view=_as_view(view), position=position, mask=mask)


def _from_depth(
    source: _Source, depth: Tensor, matrix: Tensor, view: Triple | None, smooth_px: float
) -> GBuffer:
    there = _is_depth(depth)
    if smooth_px <= 0:
        _warn_of_steps(source, depth[there], matrix)
    made = GBuffer.from_depth(_grown(depth, there, smooth_px), matrix)
    y_up = depth.new_tensor(_Y_UP).view(3, 1, 1)
    normal = torch.where(there, made.normal * y_up, torch.zeros_like(made.normal))
    # the rays of the depth as it was stored, not of what the normals were made from
    position = torch.where(there, depth, torch.ones_like(depth)) * _rays(matrix, source.size)
    mask = _mask(source, there)
    if view is not None:
        return GBuffer(normal, view=_as_view(view), position=position, mask=mask)
    return GBuffer(normal, position=position, camera=(0.0, 0.0, 0.0), mask=mask)


def _mask(source: _Source, there: Tensor) -> Tensor:
    mask = source.scalar("mask")
    if mask is None:
        return there.float()
    return torch.nan_to_num(mask, nan=0.0).clamp(0, 1) * there


def _is_depth(depth: Tensor) -> Tensor:
    return torch.isfinite(depth) & (depth > 0) & (depth < FAR) & (depth != _LARGEST_HALF)


def _grown(depth: Tensor, there: Tensor, smooth_px: float) -> Tensor:
    """The depth, smoothed where that is asked for, and continued over its edge.

    So the differences at a silhouette are those of the surface, not of a surface and nothing.
    """
    from kornia.filters import gaussian_blur2d

    weight = there.to(depth.dtype)
    known = torch.where(there, depth, torch.zeros_like(depth))
    if smooth_px > 0:
        size = 2 * int(np.ceil(3 * smooth_px)) + 1
        smallest = min(depth.shape[-2:])
        size = min(size, 2 * ((smallest - 1) // 2) + 1)
        blur = ((size, size), (smooth_px, smooth_px), "replicate")
        total, share = gaussian_blur2d(known, *blur), gaussian_blur2d(weight, *blur)
    else:
        total, share = (torch.nn.functional.avg_pool2d(m, 3, 1, 1) for m in (known, weight))
    around = torch.where(share > 1e-6, total / share.clamp(min=1e-6), torch.full_like(share, -1.0))
    return around if smooth_px > 0 else torch.where(there, depth, around)


def _warn_of_steps(source: _Source, depth: Tensor, matrix: Tensor) -> None:
    """Depth in steps of half precision that are coarse beside a pixel gives terraces."""
    if len(depth) == 0 or not torch.equal(depth.half().float(), depth):
        return
    middle = float(depth.median())
    step, pixel = float(np.spacing(np.float16(middle))), middle / float(matrix[0, 0])
    if step > pixel / 8 and len(torch.unique(depth)) > 16:
        warnings.warn(
            f"{source.path}: depth in half precision, in steps of {step:.2g} where a pixel is "
            f"{pixel:.2g} wide: the normals will be terraced; smooth it (smooth_px), or write the "
            "depth in 32 bits",
            stacklevel=4,
        )


def _matrix(
    intrinsics: Tensor | ArrayLike | None, fov_deg: float | None, size: tuple[int, int]
) -> Tensor | None:
    """`[3, 3]` float32, or None."""
    if intrinsics is not None and fov_deg is not None:
        raise InputError("intrinsics and fov_deg are both given; one of them was wanted")
    height, width = size
    if fov_deg is not None:
        if not 0 < fov_deg < 180:
            raise InputError(f"fov_deg {fov_deg:g}; an angle between 0 and 180 was wanted")
        focal = width / 2 / tan(radians(fov_deg) / 2)
        centre_x, centre_y = (width - 1) / 2, (height - 1) / 2
        intrinsics = np.array([[focal, 0, centre_x], [0, focal, centre_y], [0, 0, 1]])
    if intrinsics is None:
        return None
    matrix = torch.as_tensor(intrinsics, dtype=torch.float32)
    usable = matrix.shape == (3, 3) and bool(torch.isfinite(matrix).all())
    if not usable or float(matrix[0, 0]) <= 0 or float(matrix[1, 1]) <= 0:
        raise InputError(
            f"intrinsics {matrix.tolist()}; a matrix [3, 3] with focal lengths above 0 was wanted"
        )
    return matrix


def _rays(matrix: Tensor, size: tuple[int, int]) -> Tensor:
    """`[1, 3, H, W]` from the camera through each pixel, with −1 along z (y up)."""
    height, width = size
    v, u = torch.meshgrid(
        torch.arange(height, dtype=torch.float64),
        torch.arange(width, dtype=torch.float64),
        indexing="ij",
    )
    pixels = torch.stack([u, v, torch.ones_like(u)])
    rays = torch.einsum("ij,jhw->ihw", torch.linalg.inv(matrix.double()), pixels)
    return (rays * rays.new_tensor(_Y_UP).view(3, 1, 1)).float()[None]


def _as_view(view: Tensor | Sequence[float]) -> Tensor:
    return torch.as_tensor(view, dtype=torch.float32)


def _length(vectors: Tensor) -> Tensor:
    return (vectors * vectors).sum(dim=1, keepdim=True).sqrt()  # vector_norm is 20 times slower
