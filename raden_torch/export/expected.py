"""What the picture should be: torch's own, with the edges of the conventions marked."""

from __future__ import annotations

import copy
from dataclasses import dataclass

import torch
from torch import Tensor

from raden_torch import geometry
from raden_torch.brdf.model import simd
from raden_torch.brdf.model.model import RadenBrdf
from raden_torch.brdf.shading.gbuffer import GBuffer
from raden_torch.brdf.shading.lights import DirectionalLight, Light, PointLight
from raden_torch.brdf.shading.shade import shade
from raden_torch.export.profiles import GAINS, ports

REGIONS = ("general", "steep", "L near V", "any length", "L parallel to V", "not vectors")
"""`general`, `steep` and `L near V` hold vectors that are unit already, which nothing normalises
again; in `any length` the rounding of the normalisation shows, divided by |L × V|."""

NEAR = 1e-2
"""L is near V where |L × V| is below this."""

STEEP = 2.5
"""The model is steep where it changes by more than this times the peak in one radian, as in a
narrow highlight and at the edge of the table: the angles' own rounding, 1e-6 rad, shows there."""

_PARALLEL = 4 * torch.finfo(torch.float32).eps
_NUDGE = 1e-3  # radians
_ROUNDING = 2e-6  # a side of a seam is decided by roundings within this many radians


@dataclass(frozen=True)
class Expected:
    """A picture to compare with.

    Attributes:
        values: `[S, B, 3, H, W]`; more than one where a rounding decides on which side of a seam
            (the horizon; a = 0, where the signs flip) a pixel lies: any of them is right.
        region: `[B, 1, H, W]`, an index into `REGIONS`.
        sine: `[B, 1, H, W]`, |L × V|, of the light for which it is smallest.
        slope: `[B, 1, H, W]`, how much the value changes in one radian of the angles.
    """

    values: Tensor
    region: Tensor
    sine: Tensor
    slope: Tensor

    def regions(self, peak: float) -> Tensor:
        """`region`, with what is steep taken out of the general one."""
        steep = (self.region == REGIONS.index("general")) & (self.slope > STEEP * peak)
        return torch.where(steep, REGIONS.index("steep"), self.region)


def expected(model: RadenBrdf, profile: str, output: str, inputs: dict[str, Tensor]) -> Expected:
    """The picture by the eager model, with what the inputs override put into it."""
    own = _overridden(model, profile, output, inputs)
    with (
        torch.no_grad(),
        simd.using(simd.OFF),
    ):  # the eager form is the reference
        if profile == "scene":
            return _scene(own, inputs)
        return _gbuffer(own, output, inputs)


def _gbuffer(model: RadenBrdf, output: str, inputs: dict[str, Tensor]) -> Expected:
    maps = [inputs[name] for name in ("normal", "light", "view")]
    n, l, v = (geometry.normalised(m) for m in maps)  # noqa: E741
    f = model(*maps)
    a, r, t = geometry.raden_angles(*maps)
    other_sign = model.at_angles(a, -r, -t)
    facing, seen = geometry.dot(n, l), geometry.dot(n, v)
    on_horizon = (facing.abs() < _ROUNDING) | (seen.abs() < _ROUNDING)
    clear = (facing > 0) & (seen > 0)
    sides = [
        f,
        torch.where((a < _ROUNDING) & clear, other_sign, f),
        torch.where(on_horizon, torch.zeros_like(f), f),
    ]
    values = torch.stack([*sides, *_nudged(model, a, r, t)])
    if output == "radiance":
        irradiance = inputs.get("irradiance", torch.full((1, 3, 1, 1), torch.pi))
        values = values * irradiance * facing.clamp(min=0) * inputs.get("exposure", 1.0)
    valid = torch.stack([_is_vector(m).expand_as(a) for m in maps]).all(0)
    unit = torch.stack(
        [(m == u).all(1, keepdim=True).expand_as(a) for m, u in zip(maps, (n, l, v), strict=True)]
    )
    sine = _sine(l, v).expand_as(a)
    values, nudged = values[: len(sides)], values[len(sides) :]
    slope = (nudged - values[0]).abs().amax(0).amax(1, keepdim=True) / _NUDGE
    return Expected(_masked(values, inputs), _regions(sine, valid, unit.all(0)), sine, slope)


def _nudged(model: RadenBrdf, a: Tensor, r: Tensor, t: Tensor) -> list[Tensor]:
    """f_r with one of the angles a little larger or smaller."""
    moves = [
        tuple(sign * _NUDGE * (i == k) for i in range(3)) for k in range(3) for sign in (1, -1)
    ]
    return [model.at_angles(a + x, r + y, t + z) for x, y, z in moves]


def _scene(model: RadenBrdf, inputs: dict[str, Tensor]) -> Expected:
    normal, position = inputs["normal"], inputs["position"]
    camera = inputs["camera"].expand(len(normal), 3)
    gbuffer = GBuffer(normal, position=position, camera=camera)
    lights = lights_of(inputs["light"], inputs["light_colour"])
    image = shade(model, gbuffer, lights) * inputs.get("exposure", 1.0)
    view = camera[:, :, None, None] - position
    valid = _is_vector(normal) & _is_vector(view)
    sine = torch.ones_like(normal[:, :1]).double()
    for light in lights:
        direction = geometry.normalised(light.at(position, normal)[0])
        sine = torch.minimum(sine, _sine(direction, geometry.normalised(view)))
    region = _regions(sine, valid, torch.zeros_like(valid))
    return Expected(_masked(image[None], inputs), region, sine, torch.zeros_like(sine))


def lights_of(light: Tensor, colour: Tensor) -> list[Light]:
    """The scene profile's `[K, 4]` and `[K, 3]` as the library's own lights."""
    return [
        PointLight(place[:3], tint) if place[3] > 0 else DirectionalLight(place[:3], tint)
        for place, tint in zip(light, colour, strict=True)
    ]


def _overridden(
    model: RadenBrdf, profile: str, output: str, inputs: dict[str, Tensor]
) -> RadenBrdf:
    own = copy.deepcopy(model).float()
    tensors = own.state_dict()
    for port in ports(model, profile, output):
        if port.parameter is None or port.name not in inputs:
            continue
        if port.parameter in GAINS:
            setattr(own, port.parameter, float(inputs[port.name]))
        else:
            tensors[port.parameter].copy_(inputs[port.name])
    return own


def _masked(values: Tensor, inputs: dict[str, Tensor]) -> Tensor:
    mask = inputs.get("mask")
    if mask is None:
        return values
    return values * torch.nan_to_num(mask, nan=0.0).clamp(0, 1)


def _regions(sine: Tensor, valid: Tensor, unit: Tensor) -> Tensor:
    name = dict(zip(REGIONS, range(len(REGIONS)), strict=True))
    region = torch.where(sine < NEAR, name["L near V"], name["general"])
    region = torch.where(unit, region, name["any length"])
    region = torch.where(sine <= _PARALLEL, name["L parallel to V"], region)
    return torch.where(valid, region, name["not vectors"])


def _sine(l: Tensor, v: Tensor) -> Tensor:  # noqa: E741
    """|L × V| of unit maps."""
    l, v = torch.broadcast_tensors(l.double(), v.double())  # noqa: E741
    return torch.linalg.cross(l, v, dim=geometry.XYZ_DIM).norm(dim=geometry.XYZ_DIM, keepdim=True)


def _is_vector(m: Tensor) -> Tensor:
    return (geometry.normalised(m) != 0).any(geometry.XYZ_DIM, keepdim=True)
