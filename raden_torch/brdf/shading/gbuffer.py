"""The G-buffer: what a renderer or a photograph gives for each pixel before it is lit."""

from __future__ import annotations

import copy
from collections.abc import Callable
from dataclasses import dataclass
from typing import cast

import torch
from torch import Tensor

from raden_torch import geometry
from raden_torch.brdf.shading.depth import depth_kind, in_front, to_planar
from raden_torch.brdf.shading.triples import Triple, as_map, checked
from raden_torch.errors import InputError, check_type

_VECTOR_MAPS = ("normal", "view", "position", "layer_normal", "tangent")
_GAINS = ("diffuse_gain", "specular_gain")
_MAPS = (
    *("normal", "view", "position", "camera", "mask", "layer_normal", "tangent", "material"),
    *_GAINS,
)


@dataclass(frozen=True, eq=False)
class GBuffer:
    """Per-pixel maps of a batch of images; all vectors in one frame, of any floating dtype.

    Give `view`, or `position` and `camera`.

    Attributes:
        normal: `[B, 3, H, W]`, of any length; zero or not finite marks an invalid pixel.
        view: `[B, 3, H, W]` (or broadcastable) directions to the viewer; `[3]` or `[B, 3]` for a
            camera at infinity.
        position: `[B, 3, H, W]` surface points; point and spot lights need it.
        camera: `[3]` or `[B, 3]`, the viewer's position.
        mask: `[B, 1, H, W]`, how much of the pixel is this material: bool; floating, 0…1; or 8-bit
            integers, 0…255, or 0 and 1 where none is above 1. Kept as bool or floating.
        layer_normal: `[B, 3, H, W]` (or broadcastable) normals of the film layers, where they do
            not lie in the polished surface.
        tangent: `[B, 3, H, W]` (or broadcastable), the direction of azimuth 0 of an anisotropic
            material; only its part in the surface counts.
        material: which of several materials: `[B, 1, H, W]` integers, or `[B, K, H, W]` weights.
        diffuse_gain, specular_gain: `[B, 1 or 3, H, W]` (or broadcastable), 0 or more: factors on
            I_d and I_s of eq. (2), pixel by pixel. One tensor as both is a gain on the whole, which
            every material takes; two need a `RadenBrdf`, and take two reads.

    Examples:
        >>> import torch
        >>> import raden_torch as rt
        >>> normal = torch.tensor([0.0, 0.0, 1.0]).view(1, 3, 1, 1).expand(1, 3, 2, 4)
        >>> rt.GBuffer(normal, view=(0, 0, 1), mask=torch.ones(1, 1, 2, 4))
        GBuffer(normal=[1, 3, 2, 4], view=[1, 3, 1, 1], mask=[1, 1, 2, 4], torch.float32, cpu)
    """

    normal: Tensor
    view: Tensor | Triple | None = None
    position: Tensor | None = None
    camera: Triple | None = None
    mask: Tensor | None = None
    layer_normal: Tensor | None = None
    tangent: Tensor | None = None
    material: Tensor | None = None
    diffuse_gain: Tensor | None = None
    specular_gain: Tensor | None = None

    def __post_init__(self) -> None:
        if not isinstance(self.normal, Tensor) or self.normal.ndim != 4:
            shape = list(getattr(self.normal, "shape", [type(self.normal).__name__]))
            raise InputError(
                "GBuffer normal: expected a tensor [B, 3, H, W], got "
                f"{shape}{geometry.how_to_convert(self.normal)}"
            )
        view = self.view
        if view is None and (self.position is None or self.camera is None):
            given = [k for k in ("position", "camera") if getattr(self, k) is not None]
            got = f"{given[0]} alone" if given else "neither"
            raise InputError(f"GBuffer: expected view, or position and camera, got {got}")
        if view is not None and getattr(view, "ndim", 1) <= 2:
            object.__setattr__(self, "view", _triple("view", view, self.normal))
        if self.camera is not None:
            _triple("camera", self.camera, self.normal)
        maps = {k: getattr(self, k) for k in _VECTOR_MAPS}
        geometry.check_vector_maps(**{k: cast(Tensor, v) for k, v in maps.items() if v is not None})
        if self.material is not None:
            self._check_material(self.material)
        for name in _GAINS:
            self._check_gain(name)
        if self.mask is not None:
            self._check_mask(self.mask)
            object.__setattr__(self, "mask", coverage(self.mask))

    def __repr__(self) -> str:
        maps = (
            f"{name}={list(value.shape)}"
            for name in _MAPS
            if isinstance(value := getattr(self, name), Tensor)
        )
        return f"GBuffer({', '.join(maps)}, {self.normal.dtype}, {self.normal.device})"

    @classmethod
    def from_depth(
        cls, depth: Tensor, intrinsics: Tensor, mask: Tensor | None = None, *, kind: str = "planar"
    ) -> GBuffer:
        """A G-buffer from depth alone: positions and normals by kornia.

        Args:
            depth: `[B, 1, H, W]`; pixels that are not finite or not in front of the camera are
                masked out.
            intrinsics: `[3, 3]` or `[B, 3, 3]` pinhole matrix in pixels.
            mask: `[B, 1, H, W]` or None.
            kind: of `depth.KINDS`: "planar", along the camera's axis; "distance", along the pixel's
                ray; "negative", minus the planar one; or the renderer that wrote it.

        Returns:
            In the camera's frame: x right, y down, z forward, the camera at the origin. Normals
            face the camera; across a jump in depth they are as wrong as the differences they come
            from.
        """
        from kornia.geometry.depth import depth_to_3d_v2, depth_to_normals

        for name, given in (("depth", depth), ("intrinsics", intrinsics)):
            check_type(name, given, Tensor, "convert it by torch.as_tensor(x)")
        if depth.ndim != 4 or depth.shape[1] != 1 or not depth.is_floating_point():
            raise InputError(
                f"depth: expected floating-point [B, 1, H, W], got {depth.dtype} "
                f"{list(depth.shape)}"
            )
        if min(depth.shape[-2:]) < 2:
            raise InputError(
                f"depth: expected at least 2 x 2 pixels to make normals of, got {list(depth.shape)}"
            )
        if intrinsics.shape[-2:] != (3, 3) or intrinsics.ndim not in (2, 3):
            raise InputError(
                f"intrinsics: expected shape [3, 3] or [B, 3, 3], got {list(intrinsics.shape)}"
            )
        dtype = geometry.working_dtype(depth)
        matrix = intrinsics.to(depth.device, dtype).expand(len(depth), 3, 3)
        known_kind = depth_kind(kind)
        depth = in_front(depth, known_kind)
        valid = torch.isfinite(depth) & (depth > 0)
        # a neutral depth where there is none, so that its neighbours stay finite
        clean = torch.where(valid, depth, torch.ones_like(depth)).to(dtype)
        if known_kind == "distance":
            rays = depth_to_3d_v2(torch.ones_like(clean[:, 0]), matrix).movedim(-1, 1)
            clean = to_planar(clean, known_kind, rays)
        position = depth_to_3d_v2(clean[:, 0], matrix).movedim(-1, 1)
        normal = depth_to_normals(clean, matrix)
        outward = torch.where(geometry.dot(normal, position) > 0, -1.0, 1.0).to(dtype)
        inside = valid if mask is None else valid * coverage(mask).to(dtype)
        return cls(normal * outward, position=position, camera=(0.0, 0.0, 0.0), mask=inside)

    def to(self, device: torch.device | str, *, non_blocking: bool = False) -> GBuffer:
        """The same on another device; from pinned memory, `non_blocking` does not wait for it."""
        return self._each(lambda m: m.to(device, non_blocking=non_blocking))

    def pin_memory(self) -> GBuffer:
        """The same in page-locked memory, as torch's DataLoader asks for with `pin_memory`."""
        return self._each(Tensor.pin_memory)

    def _each(self, change: Callable[[Tensor], Tensor]) -> GBuffer:
        """With every map changed, which is not checked again: that would wait for a GPU."""
        own = copy.copy(self)
        for name in _MAPS:
            if isinstance(value := getattr(self, name), Tensor):
                object.__setattr__(own, name, change(value))
        return own

    def view_map(self, like: Tensor) -> Tensor:
        """Directions to the viewer, not unit, in the dtype of `like`."""
        if isinstance(self.view, Tensor):
            return self.view.to(like.dtype)
        # __post_init__ saw to it that both are there
        return as_map(cast(Triple, self.camera), like) - cast(Tensor, self.position).to(like.dtype)

    def _check_material(self, material: Tensor) -> None:
        check_type("GBuffer material", material, Tensor, "convert it by torch.as_tensor(x)")
        indices = not material.is_floating_point()
        if not self._fits(material) or (indices and material.shape[1] != 1):
            b, _, h, w = self.normal.shape
            raise InputError(
                f"GBuffer material: expected integers {[b, 1, h, w]} or floating-point weights "
                f"[{b}, K, {h}, {w}], got {material.dtype} {list(material.shape)}"
            )

    def _check_gain(self, name: str) -> None:
        gain = getattr(self, name)
        if gain is None:
            return
        what = f"GBuffer {name}"
        check_type(what, gain, Tensor, "convert it by torch.as_tensor(x)")
        if not (gain.is_floating_point() and self._fits(gain) and gain.shape[1] in (1, 3)):
            b, _, h, w = self.normal.shape
            raise InputError(
                f"{what}: expected floating-point [{b}, 1 or 3, {h}, {w}], got {gain.dtype} "
                f"{list(gain.shape)}"
            )
        if torch.compiler.is_compiling() or not gain.numel():
            return
        low, high = (float(x) for x in gain.detach().aminmax())
        if not 0 <= low <= high < float("inf"):
            raise InputError(f"{what}: expected finite factors of 0 or more, got {low:g}…{high:g}")

    def _fits(self, values: Tensor) -> bool:
        """Whether a map is broadcastable to the normals, but for its channels."""
        if values.ndim != 4:
            return False
        sides = ((values.shape[i], self.normal.shape[i]) for i in (0, 2, 3))
        return all(own in (1, side) for own, side in sides)

    def _check_mask(self, mask: Tensor) -> None:
        check_type("GBuffer mask", mask, Tensor, "convert it by torch.as_tensor(x)")
        size = self.normal.shape
        if not self._fits(mask) or mask.shape[1] != 1:
            raise InputError(
                f"GBuffer mask: expected shape {[size[0], 1, *size[2:]]} for normal {list(size)}, "
                f"got {list(mask.shape)}"
            )


def coverage(mask: Tensor) -> Tensor:
    """A mask as bool, or floating in 0…1.

    8-bit integers 0…255 are divided by 255; where none is above 1 they are 0 and 1.

    Raises:
        InputError: other integers, which have no known full scale.
    """
    if mask.dtype == torch.bool or mask.is_floating_point():
        return mask
    largest = int(mask.max()) if mask.numel() else 0
    if mask.dtype == torch.uint8 and largest > 1:
        return mask.to(torch.float32) / 255
    if largest <= 1:
        return mask.to(torch.float32)
    raise InputError(
        f"mask: expected bool, floating-point 0…1 or uint8, got {mask.dtype} up to {largest}; "
        "divide it by its full scale"
    )


def _triple(name: str, value: Triple, like: Tensor) -> Tensor:
    tensor = checked(f"GBuffer {name}", value)
    is_traced = torch.compiler.is_compiling()
    if name == "view" and not is_traced and (tensor == 0).all(dim=-1).any():
        raise InputError("GBuffer view: expected a direction towards the viewer, got zero")
    return as_map(value, like)
