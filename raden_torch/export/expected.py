"""What the picture should be: torch's own, with the edges of the conventions marked."""

from __future__ import annotations

import copy
from dataclasses import dataclass

import torch
from torch import Tensor

from raden_torch import geometry
from raden_torch.brdf.shading.gbuffer import GBuffer
from raden_torch.brdf.shading.lights import DirectionalLight, Light, PointLight, directions_of
from raden_torch.brdf.shading.shade import shade
from raden_torch.export.forms import FitForm, Form, Mixed, PaletteForm, RuntimeForm
from raden_torch.export.profiles import ports

REGIONS = ("general", "steep", "L near V", "any length", "L parallel to V", "not vectors")
"""`general`, `steep` and `L near V` hold vectors that are unit already, which nothing normalises
again; in `any length` the rounding of the normalisation shows, divided by |L × V|."""

NEAR = 1e-2
"""L is near V where |L × V| is below this."""

STEEP = 2.5
"""The model is steep where it changes by more than this times the peak in one radian, as in a
narrow highlight and at the edge of the table: the angles' own rounding, 1e-6 rad, shows there."""

_NUDGE = 1e-3  # radians
_ROUNDING = 2e-6  # a side of a seam is decided by roundings within this many radians
_EPS = torch.finfo(torch.float32).eps
_PARALLEL = 4 * _EPS


Chosen = RuntimeForm | FitForm | Mixed
"""A form of every pixel."""


@dataclass(frozen=True)
class Expected:
    """A picture to compare with.

    Attributes:
        values: `[S, B, 3, H, W]`; more than one where a rounding decides on which side of a seam a
            pixel lies (the horizon; in the fit form a = 0, where the signs flip), and 0 where a
            vector is longer or shorter than the file takes: any is right.
        region: `[B, 1, H, W]`, an index into `REGIONS`.
        sine: `[B, 1, H, W]`, |L × V|, of the light for which it is smallest.
        slope: `[B, 1, H, W]`, how much the value changes in one radian of the angles.
        rounding: `[B, 1, H, W]`, how much it changes with the last bit of N, or of V where a vector
            had to be normalised: torch itself is no more exact next to the horizon, where a model
            may be infinitely steep, and where L and V almost agree.
    """

    values: Tensor
    region: Tensor
    sine: Tensor
    slope: Tensor
    rounding: Tensor

    def regions(self, peak: float) -> Tensor:
        """`region`, with what is steep taken out of the general one."""
        steep = (self.region == REGIONS.index("general")) & (self.slope > STEEP * peak)
        return torch.where(steep, REGIONS.index("steep"), self.region)


def expected(form: Form, profile: str, output: str, inputs: dict[str, Tensor]) -> Expected:
    """The picture by the form's eager code, with what the inputs override put into it."""
    found = _overridden(form, profile, output, inputs)
    own: Chosen
    if isinstance(found, PaletteForm):
        own = found.of_material(inputs["material" if found.by == "index" else "weights"])
    else:
        own = found
    with torch.no_grad():
        if profile == "scene":
            return _scene(own, inputs)
        return _gbuffer(own, output, inputs)


def _gbuffer(form: Chosen, output: str, inputs: dict[str, Tensor]) -> Expected:
    maps = [inputs[name] for name in ("normal", "light", "view")]
    n, l, v = (geometry.normalised(m) for m in maps)  # noqa: E741
    f = form.of_unit_vectors(n, l, v)
    a, r, t = geometry.angles_from_unit_vectors(n, l, v)
    facing, seen = geometry.dot(n, l), geometry.dot(n, v)
    on_horizon = (facing.abs() < _ROUNDING) | (seen.abs() < _ROUNDING)
    sides = [f, torch.where(on_horizon, torch.zeros_like(f), f)]
    if isinstance(form, FitForm):
        flips = (a < _ROUNDING) & (facing > 0) & (seen > 0)
        sides.append(torch.where(flips, form.at_angles(a, -r, -t), f))
    unit = torch.stack(
        [(m == u).all(1, keepdim=True).expand_as(a) for m, u in zip(maps, (n, l, v), strict=True)]
    ).all(0)
    groups = [sides, _nudged(form, a, r, t), _rounded(form, n, l, v, unit)]
    extreme = torch.stack([_is_extreme(m).expand_as(a) for m in maps]).any(0)
    sides.append(torch.where(extreme, torch.zeros_like(f), f))
    values = torch.stack([f for group in groups for f in group])
    if output == "radiance":
        irradiance = inputs.get("irradiance", torch.full((1, 3, 1, 1), torch.pi))
        values = values * irradiance * facing.clamp(min=0) * inputs.get("exposure", 1.0)
    valid = torch.stack([_is_vector(m).expand_as(a) for m in maps]).all(0)
    sine = _sine(l, v).expand_as(a)
    values, *others = values.split([len(group) for group in groups])
    nudge, rounding = ((x - values[0]).abs().amax(0).amax(1, keepdim=True) for x in others)
    region = _regions(sine, valid, unit)
    return Expected(_masked(values, inputs), region, sine, nudge / _NUDGE, rounding)


def _nudged(form: Chosen, a: Tensor, r: Tensor, t: Tensor) -> list[Tensor]:
    """f_r with one of the angles a little larger or smaller."""
    moves = [
        tuple(sign * _NUDGE * (i == k) for i in range(3)) for k in range(3) for sign in (1, -1)
    ]
    return [form.at_angles(a + x, r + y, t + z) for x, y, z in moves]


def _rounded(form: Chosen, n: Tensor, l: Tensor, v: Tensor, unit: Tensor) -> list[Tensor]:  # noqa: E741
    """f_r with the last bit of one component changed: of N, and of V where one was normalised."""
    moves = torch.eye(3).reshape(3, 1, 3, 1, 1) * _EPS
    moves = torch.cat([moves, -moves])
    normalised = 2 * (~unit).to(v.dtype)  # V − L: one rounding each
    return [
        *(form.of_unit_vectors(n + move, l, v) for move in moves),
        *(form.of_unit_vectors(n, l, v + move * normalised) for move in moves),
    ]


def _scene(form: Chosen, inputs: dict[str, Tensor]) -> Expected:
    normal, position = inputs["normal"], inputs["position"]
    camera = inputs["camera"].expand(len(normal), 3)
    gbuffer = GBuffer(normal, position=position, camera=camera)
    lights = lights_of(inputs["light"], inputs["light_colour"])
    image = shade(form, gbuffer, lights) * inputs.get("exposure", 1.0)
    view = camera[:, :, None, None] - position
    valid = _is_vector(normal) & _is_vector(view)
    sine = torch.ones_like(normal[:, :1]).double()
    lamps = (lamp for light in lights for lamp in directions_of(light, position, normal))
    for to_light, _ in lamps:
        direction = geometry.normalised(to_light)
        sine = torch.minimum(sine, _sine(direction, geometry.normalised(view)))
    region = _regions(sine, valid, torch.zeros_like(valid))
    nothing = torch.zeros_like(sine)
    sides = torch.stack([image, torch.where(_is_extreme(view), torch.zeros_like(image), image)])
    return Expected(_masked(sides, inputs), region, sine, nothing, nothing)


def lights_of(light: Tensor, colour: Tensor) -> list[Light]:
    """The scene profile's `[K, 4]` and `[K, 3]` as the library's own lights."""
    return [
        PointLight(place[:3], tint) if place[3] > 0 else DirectionalLight(place[:3], tint)
        for place, tint in zip(light, colour, strict=True)
    ]


def _overridden(form: Form, profile: str, output: str, inputs: dict[str, Tensor]) -> Form:
    own = copy.deepcopy(form)
    tensors = own.state_dict()
    for port in ports(form, profile, output):
        if port.parameter is not None and port.name in inputs:
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


def _is_extreme(m: Tensor) -> Tensor:
    """Whether a vector's length is beyond what `docs/export.md` promises."""
    largest = m.abs().amax(geometry.XYZ_DIM, keepdim=True)
    return (largest < 1e-18) | (largest > 1e18)
