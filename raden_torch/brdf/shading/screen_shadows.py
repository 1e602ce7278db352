"""Shadows from what the picture itself shows: a march through the position map to each lamp."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from numbers import Real
from typing import cast

import torch
from torch import Tensor

from raden_torch.brdf.shading.area_lights import AreaLight
from raden_torch.brdf.shading.gbuffer import GBuffer
from raden_torch.brdf.shading.lights import (
    DirectionalLight,
    Light,
    PointLight,
    SpotLight,
    directions_of,
)
from raden_torch.brdf.shading.pinhole_fit import PinholeFit, fit_pinhole
from raden_torch.brdf.shading.triples import as_map
from raden_torch.errors import InputError, check_type
from raden_torch.geometry import dot, normalised, working_dtype

CASTING = (DirectionalLight, PointLight, SpotLight, *AreaLight.__args__)
"""The lights that get shadows; an environment keeps what it has."""
USUAL_THICKNESS = 0.1
"""Of the median distance to the camera."""
_RAYS = 2**16
"""That are marched together."""
_SWEEP = 16
"""Steps between two looks for rays that have ended."""


def with_screen_shadows(
    gbuffer: GBuffer,
    lights: Sequence[Light],
    *,
    thickness: float | None = None,
    bias_px: float = 1.0,
    steps: int = 512,
) -> list[Light]:
    """The lights, each with a visibility map of the shadows that the picture's surfaces cast.

    What the picture does not show casts no shadow: what is beside it, behind something or on the
    far side of a thing; how far that reaches is guessed by `thickness`. Edges of shadows are as
    coarse as the pixels of what casts them, and hard but for lamps with a shape, whose samples are
    averaged (one march for each sample: slow). Environments are returned as they are.

    Args:
        gbuffer: with positions and the camera that sees them, a pinhole; where the mask is 0, or
            normal or position are not finite, there is no surface.
        lights: a visibility map that a light already has is multiplied with the new one.
        thickness: how deep a visible surface is, along the camera's axis, in the unit of the
            positions; None takes `USUAL_THICKNESS`.
        bias_px: by how many pixels' footprints a ray starts above its surface.
        steps: samples along the longer side of the picture, at most one a pixel.

    Returns:
        As many lights, in their order; `visibility` is `[B, 1, H, W]`, 0 where the surface faces
        away from the lamp and where there is none.

    Raises:
        InputError: no positions or no camera; positions that no pinhole at `camera` sees pixel by
            pixel; settings out of range.

    Examples:
        >>> import raden_torch as rt
        >>> from raden_torch.brdf.shading.screen_shadows import with_screen_shadows
        >>> from raden_torch.brdf.shading.sphere_gbuffer import sphere
        >>> ball = sphere(16, samples=1)
        >>> [sun] = with_screen_shadows(ball, [rt.DirectionalLight((0, 0, 1))])
        >>> bool((sun.visibility == ball.mask).all())  # nothing stands between
        True
    """
    check_type("gbuffer", gbuffer, GBuffer, "make it by GBuffer(normal=…, view=…)")
    check_type("lights", lights, Sequence, "give a list of lights")
    _check_settings(thickness, bias_px, steps)
    if not any(isinstance(light, CASTING) for light in lights):
        return list(lights)
    with torch.no_grad():
        seen = _Seen.of(gbuffer, thickness, bias_px, steps)
        return [seen.shadowed(x) if isinstance(x, CASTING) else x for x in lights]


def _check_settings(thickness: float | None, bias_px: float, steps: int) -> None:
    for name, value in (("thickness", thickness), ("bias_px", bias_px)):
        if value is None and name == "thickness":
            continue
        check_type(name, value, (float, Real))
        if not 0 <= cast(float, value) < math.inf or (name == "thickness" and value == 0):
            least = "more than 0" if name == "thickness" else "0 or more"
            raise InputError(f"{name}: expected a finite number, {least}, got {value}")
    if not (isinstance(steps, int) and steps >= 1):
        raise InputError(f"steps: expected a whole number of 1 or more, got {steps!r}")


@dataclass(frozen=True)
class _Rays:
    """Rays of one image as homogeneous pixels: at `s` along them, `start + s * towards`.

    Attributes:
        start, towards: `[3, R]`.
        end: the `s` of the lamp.
    """

    start: Tensor
    towards: Tensor
    end: float

    def __getitem__(self, kept: Tensor) -> _Rays:
        return _Rays(self.start[:, kept], self.towards[:, kept], self.end)


@dataclass(frozen=True)
class _Seen:
    """What the camera sees, made ready for marching.

    Attributes:
        normal, position: `[B, 3, H, W]`; unit normals, 0 where there is no surface.
        inverse: `[B, H, W]`, 1 over the planar depth, 0 where there is no surface.
        pinholes: one for each image.
        thickness: `[B]`.
        stride: pixels from sample to sample.
    """

    normal: Tensor
    position: Tensor
    camera: Tensor
    inverse: Tensor
    pinholes: list[PinholeFit]
    thickness: list[float]
    bias_px: float
    stride: int

    @classmethod
    def of(cls, gbuffer: GBuffer, thickness: float | None, bias_px: float, steps: int) -> _Seen:
        if gbuffer.position is None or gbuffer.camera is None:
            given = [k for k in ("position", "camera") if getattr(gbuffer, k) is not None]
            raise InputError(
                "screen-space shadows: expected a G-buffer with position and camera, got "
                f"{given[0] + ' alone' if given else 'neither'}"
            )
        dtype = working_dtype(gbuffer.normal, gbuffer.position)
        b, _, h, w = gbuffer.normal.shape
        position = gbuffer.position.to(dtype).expand(b, 3, h, w)
        normal = normalised(gbuffer.normal.to(dtype))
        camera = as_map(gbuffer.camera, position).expand(b, 3, 1, 1)
        there = torch.isfinite(position).all(1) & (normal != 0).any(1)
        if gbuffer.mask is not None:
            there &= gbuffer.mask.expand(b, 1, h, w)[:, 0] > 0
        rays = torch.where(there[:, None], position - camera, torch.zeros_like(position))
        pinholes, inverse, depths = [], torch.zeros_like(rays[:, 0]), []
        for k in range(b):
            pinhole = fit_pinhole(f"screen-space shadows: image {k}", rays[k], there[k])
            depth = torch.einsum("c,chw->hw", pinhole.matrix[2], rays[k])
            in_front = there[k] & (depth > 0)
            inverse[k] = torch.where(in_front, 1 / torch.where(in_front, depth, 1), 0)
            usual = USUAL_THICKNESS * float(depth[in_front].median()) if in_front.any() else 1.0
            depths.append(usual if thickness is None else float(thickness))
            pinholes.append(pinhole)
        there = inverse > 0
        normal = torch.where(there[:, None], normal, torch.zeros_like(normal))
        stride = max(1, math.ceil(max(h, w) / steps))
        return cls(normal, position, camera, inverse, pinholes, depths, bias_px, stride)

    def shadowed(self, light: Light) -> Light:
        """The light with its visibility."""
        distant = isinstance(light, DirectionalLight)
        arriving = seen = None
        for to, irradiance in directions_of(light, self.position, self.position):
            to_light = to.expand_as(self.position)
            facing = dot(self.normal, normalised(to_light)).clamp(min=0)
            visible = self._visible(to_light, (facing > 0)[:, 0], distant)[:, None]
            if not isinstance(light, AreaLight):
                seen = visible
                break
            weight = torch.nan_to_num(irradiance.abs().sum(1, keepdim=True) * facing, nan=0.0)
            arriving = weight if arriving is None else arriving + weight
            seen = weight * visible if seen is None else seen + weight * visible
        found = cast(Tensor, seen)
        if arriving is not None:
            found = torch.where(arriving > 0, found / torch.where(arriving > 0, arriving, 1), 0)
        own = light.visibility
        return replace(light, visibility=found if own is None else found * own.to(found))

    def _visible(self, to_light: Tensor, facing: Tensor, distant: bool) -> Tensor:
        """`[B, H, W]`: 1 where nothing stands in the way.

        Args:
            to_light: `[B, 3, H, W]`, of any length; that to the lamp, unless it is `distant`.
            facing: `[B, H, W]`, which pixels are asked for; the others are 0.
        """
        visible = facing.to(self.inverse)
        for k in range(len(visible)):
            pixels = facing[k].flatten().nonzero()[:, 0]
            flat = visible[k].view(-1)
            for some in pixels.split(_RAYS):
                rays = self._rays(k, some, to_light[k].flatten(1)[:, some], distant)
                flat[some[self._blocked(k, rays)]] = 0
        return visible

    def _rays(self, image: int, pixels: Tensor, to_light: Tensor, distant: bool) -> _Rays:
        pinhole = self.pinholes[image]
        depth = 1 / self.inverse[image].flatten()[pixels]
        lift = self.normal[image].flatten(1)[:, pixels] * (depth * pinhole.pixel * self.bias_px)
        start = self.position[image].flatten(1)[:, pixels] - self.camera[image, :, 0] + lift
        towards = normalised(to_light[None, :, None])[0, :, 0] if distant else to_light - lift
        end = math.inf if distant else 1.0
        return _Rays(pinhole.matrix @ start, pinhole.matrix @ towards, end)

    def _blocked(self, image: int, rays: _Rays) -> Tensor:
        """`[R]` bool: a surface stands in the way of a ray."""
        blocked = torch.zeros(rays.start.shape[1], dtype=torch.bool, device=rays.start.device)
        # how fast a ray moves over the picture, in pixels: the sample's coordinate along the
        # faster axis is a whole number
        w = rays.start[2]
        speed = (rays.towards[:2] * w - rays.start[:2] * rays.towards[2]) / (w * w)
        upright = speed[1].abs() > speed[0].abs()
        height, width = self.inverse.shape[1:]
        inverse = self.inverse[image]
        for axis, length in ((0, width), (1, height)):
            mine = ((upright if axis else ~upright) & (speed[axis] != 0)).nonzero()[:, 0]
            along = rays[mine]
            depths = inverse if axis == 0 else inverse.T
            order = [axis, 1 - axis, 2]
            march = _March(
                depths.contiguous(),
                _Rays(along.start[order], along.towards[order], along.end),
                speed[axis][mine].sign() * self.stride,
                self.thickness[image],
            )
            blocked[mine[march.run(math.ceil(length / self.stride))]] = True
        return blocked


class _March:
    """Rays that move along x, a whole number of pixels a step, through `[H, W]` inverse depths."""

    def __init__(self, inverse: Tensor, rays: _Rays, step: Tensor, thickness: float) -> None:
        self._flat, (self._height, self._width) = inverse.flatten(), inverse.shape
        self._rays, self._step, self._thickness = rays, step, thickness
        self._x = torch.round(rays.start[0] / rays.start[2])
        self._depth = rays.start[2]

    def run(self, steps: int) -> Tensor:
        """The numbers of the rays that end at a surface."""
        number = torch.arange(len(self._x), device=self._x.device)
        on = torch.ones_like(number, dtype=torch.bool)
        hit = torch.zeros_like(on)
        found = []
        for k in range(steps + 1):
            blocked, on_its_way = self._advance()
            hit |= on & blocked
            on &= on_its_way & ~blocked
            if k % _SWEEP == _SWEEP - 1 or k == steps:
                found.append(number[hit])
                if not bool(on.any()):
                    break
                self._rays, number = self._rays[on], number[on]
                self._x, self._step, self._depth = self._x[on], self._step[on], self._depth[on]
                on = torch.ones_like(number, dtype=torch.bool)
                hit = torch.zeros_like(on)
        return torch.cat(found)

    def _advance(self) -> tuple[Tensor, Tensor]:
        """One step: which rays are behind a surface there, and which are still on their way."""
        self._x = x = self._x + self._step
        (x0, y0, w0), (x1, y1, w1) = self._rays.start, self._rays.towards
        # (x0 + s x1) / (w0 + s w1) = x
        s = (x * w0 - x0) / (x1 - x * w1)
        depth = w0 + s * w1
        y = (y0 + s * y1) / depth
        on = (s > 0) & (s < self._rays.end) & (depth > 0)
        on &= (x >= 0) & (x <= self._width - 1) & (y >= 0) & (y <= self._height - 1)
        y = torch.where(on, y, 0)
        low = y.floor().clamp(max=max(self._height - 2, 0))
        first = (low * self._width + torch.where(on, x, 0)).long()
        near = self._flat[first]
        far = self._flat[(first + self._width).clamp(max=len(self._flat) - 1)]
        surface = _depth_between(near, far, y - low, self._thickness)
        behind = depth - surface
        # a step may pass through more depth than the thickness
        deep = (depth - self._depth).abs().clamp(min=self._thickness)
        self._depth = torch.where(on, depth, self._depth)
        return on & (behind > 0) & (behind < deep), on


def _depth_between(one: Tensor, other: Tensor, share: Tensor, gap: float) -> Tensor:
    """Depth between two pixels, whose inverses are given: 1/z is linear on a plane.

    Where one has no surface, or they lie further apart than `gap`, the farther one counts, so that
    nothing grows beyond its outline.
    """
    between = one + share * (other - one)
    least = torch.minimum(one, other)
    apart = (one - other).abs() > gap * one * other
    kept = torch.where(apart, least, between)
    return torch.where(kept > 0, 1 / torch.where(kept > 0, kept, 1), math.inf)
