"""Lights: where they lie from a point, and the irradiance they make on a plane facing them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import cast

import torch
from torch import Tensor

from raden_torch.brdf.shading.area_lights import AreaLight
from raden_torch.brdf.shading.environment import DistantLamps, EnvironmentLight
from raden_torch.brdf.shading.gbuffer import GBuffer
from raden_torch.brdf.shading.triples import Colour, Triple, as_map, checked, inverse_square
from raden_torch.errors import InputError, check_type
from raden_torch.geometry import dot, normalised, working_dtype


@dataclass(frozen=True)
class DirectionalLight:
    """A lamp at infinity.

    Attributes:
        direction: towards the light, of any length.
        irradiance: linear RGB, on a plane that faces the light; π lights a perfect white diffuser
            to radiance 1.
        visibility: `[B, 1, H, W]`, how much of it each pixel of the image sees, 0…1.

    Examples:
        >>> import torch
        >>> import raden_torch as rt
        >>> sun = rt.DirectionalLight(direction=(0, 3, 4), irradiance=(2.0, 2.0, 1.0))
        >>> direction, irradiance = sun.at(None, torch.zeros(1, 3, 1, 1))
        >>> direction.flatten().tolist(), irradiance.flatten().tolist()
        ([0.0, 3.0, 4.0], [2.0, 2.0, 1.0])
    """

    direction: Triple
    irradiance: Colour = (torch.pi, torch.pi, torch.pi)
    visibility: Tensor | None = None

    def __post_init__(self) -> None:
        _check(self, direction=self.direction, irradiance=self.irradiance)

    def at(self, position: Tensor | None, like: Tensor) -> tuple[Tensor, Tensor]:
        """Direction to the light and irradiance facing it, broadcastable to `like`'s batch."""
        return as_map(self.direction, like), as_map(self.irradiance, like)


@dataclass(frozen=True)
class PointLight:
    """A small lamp of equal intensity in all directions; needs positions in the G-buffer.

    Attributes:
        position: in the G-buffer's frame and unit of length.
        intensity: linear RGB; the irradiance facing it at distance d is intensity / d².
        visibility: `[B, 1, H, W]`, how much of it each pixel of the image sees, 0…1.

    Examples:
        At twice the distance a lamp gives a quarter:

        >>> import torch
        >>> import raden_torch as rt
        >>> surface = torch.zeros(1, 3, 1, 1)
        >>> for height in (1, 2):
        ...     lamp = rt.PointLight(position=(0, 0, height), intensity=(1.0, 1.0, 0.5))
        ...     print(lamp.at(surface, surface)[1].flatten().tolist())
        [1.0, 1.0, 0.5]
        [0.25, 0.25, 0.125]
    """

    position: Triple
    intensity: Colour = (torch.pi, torch.pi, torch.pi)
    visibility: Tensor | None = None

    def __post_init__(self) -> None:
        _check(self, position=self.position, intensity=self.intensity)

    def at(self, position: Tensor | None, like: Tensor) -> tuple[Tensor, Tensor]:
        """`[B, 3, H, W]` each: direction to the light (not unit) and irradiance facing it."""
        return _from_a_point(self, position, like)


@dataclass(frozen=True)
class SpotLight:
    """A point light with a cone; needs positions in the G-buffer.

    Attributes:
        position: of the lamp.
        target: a point that its axis goes through.
        intensity: linear RGB on the axis.
        inner_deg, outer_deg: half angles of the cone; full intensity within the inner one, none
            outside the outer one, a smooth step of the angle's cosine between.
        visibility: `[B, 1, H, W]`, how much of it each pixel of the image sees, 0…1.

    Examples:
        On its axis, and outside its cone:

        >>> import torch
        >>> import raden_torch as rt
        >>> surface = torch.zeros(1, 3, 1, 1)
        >>> for target in ((0, 0, 0), (2, 0, 0)):
        ...     lamp = rt.SpotLight(position=(0, 0, 2), target=target, intensity=(1.0, 1.0, 0.5))
        ...     print(lamp.at(surface, surface)[1].flatten().tolist())
        [0.25, 0.25, 0.125]
        [0.0, 0.0, 0.0]
    """

    position: Triple
    target: Triple
    intensity: Colour = (torch.pi, torch.pi, torch.pi)
    inner_deg: float = 15.0
    outer_deg: float = 25.0
    visibility: Tensor | None = None

    def __post_init__(self) -> None:
        _check(self, position=self.position, target=self.target, intensity=self.intensity)
        if not 0 <= self.inner_deg < self.outer_deg <= 180:
            raise InputError(
                "SpotLight: expected 0 <= inner_deg < outer_deg <= 180, got inner_deg "
                f"{self.inner_deg:g}, outer_deg {self.outer_deg:g}"
            )

    def at(self, position: Tensor | None, like: Tensor) -> tuple[Tensor, Tensor]:
        """`[B, 3, H, W]` each: direction to the light (not unit) and irradiance facing it."""
        to_light, irradiance = _from_a_point(self, position, like)
        axis = as_map(self.target, like) - as_map(self.position, like)
        length = torch.sqrt(dot(to_light, to_light) * dot(axis, axis))
        cosine = -dot(to_light, axis) / torch.clamp(length, min=torch.finfo(like.dtype).tiny)
        inner, outer = torch.cos(torch.deg2rad(like.new_tensor([self.inner_deg, self.outer_deg])))
        x = ((cosine - outer) / (inner - outer)).clamp(0, 1)
        return to_light, irradiance * (x * x * (3 - 2 * x))


KernelLight = DirectionalLight | PointLight | SpotLight | DistantLamps
"""The lights that the fused kernel knows (`packed`)."""
Light = KernelLight | EnvironmentLight | AreaLight
"""Every light that `shade` takes."""


def packed(
    lights: Sequence[KernelLight],
    position: Tensor | None,
    like: Tensor,
    may_be_lost: Tensor | float = 0.0,
) -> Tensor:
    """`[lights, 1 or B, 13]` for the fused kernel: kind (0 directional, 1 point, 2 spot), unit
    direction or position, irradiance or intensity, axis, cosines of the outer and inner angle, and
    the reach: irradiance or intensity over `may_be_lost` (`[3]`, the irradiance that all lights
    left out at a pixel may have together), the largest of the three channels."""
    if not lights:
        return like.new_zeros(0, 1, 13, dtype=torch.float32)
    if like.device.type == "cuda" and not _on_a_gpu(lights):
        # made here and copied once, without waiting for the GPU
        here = packed(lights, position, like.new_empty(0, device="cpu"))
        there = here.pin_memory().to(like.device, non_blocking=True)
        return there if isinstance(may_be_lost, float) else _with_reach(there, may_be_lost)
    rows = [
        _rows(light, like) if isinstance(light, DistantLamps) else _row(light, position, like)[None]
        for light in lights
    ]
    batch = max(row.shape[1] for row in rows)
    return _with_reach(torch.cat([row.expand(-1, batch, -1) for row in rows]), may_be_lost)


def _with_reach(rows: Tensor, may_be_lost: Tensor | float) -> Tensor:
    # 0 / 0, no light and nothing to be left out, is no reach, either
    reach = torch.nan_to_num((rows[..., 4:7].abs() / may_be_lost).amax(-1, True), nan=0.0)
    return torch.cat([rows[..., :12], reach], dim=-1)


def _on_a_gpu(lights: Sequence[KernelLight]) -> bool:
    values = (value for light in lights for value in vars(light).values())
    return any(isinstance(value, Tensor) and value.is_cuda for value in values)


def _rows(lamps: DistantLamps, like: Tensor) -> Tensor:
    """`[K, 1, 12]`, without reach; see `packed`."""
    colour = lamps.irradiance.detach().to(like.device, working_dtype(like))
    rows = colour.new_zeros(len(colour), 12)
    rows[:, 1:4] = lamps.directions.to(rows)
    rows[:, 4:7] = colour
    return rows[:, None]


def _row(
    light: DirectionalLight | PointLight | SpotLight,
    position: Tensor | None,
    like: Tensor,
) -> Tensor:
    def columns(value: Colour) -> Tensor:
        return as_map(value, like.new_zeros((), dtype=dtype))[..., 0, 0]

    dtype = working_dtype(like)
    axis, cosines = like.new_zeros(1, 3, dtype=dtype), like.new_zeros(1, 2, dtype=dtype)
    if isinstance(light, DirectionalLight):
        kind, radiated = 0, light.irradiance
        at = normalised(columns(light.direction)[..., None, None])[..., 0, 0]
    else:
        _needed(position, light)
        kind, radiated, at = 1, light.intensity, columns(light.position)
    if isinstance(light, SpotLight):
        kind, axis = 2, columns(light.target) - at
        angles = [cosines.new_full((1, 1), x) for x in (light.outer_deg, light.inner_deg)]
        cosines = torch.cos(torch.deg2rad(torch.cat(angles, dim=1)))
    colour = columns(radiated)
    parts = [at.new_full((1, 1), kind), at, colour, axis, cosines]
    batch = max(len(part) for part in parts)
    return torch.cat([part.expand(batch, -1) for part in parts], dim=1)


def directions_of(
    light: Light, position: Tensor | None, like: Tensor
) -> Iterator[tuple[Tensor, Tensor]]:
    """Direction to each lamp of a light, and the irradiance facing it; see their `at`."""
    if isinstance(light, AreaLight):
        yield from light.lamps(_needed(position, light).to(like.dtype), like)
        return
    if isinstance(light, EnvironmentLight):
        light = light.lamps()
    if not isinstance(light, DistantLamps):
        yield light.at(position, like)
        return
    for direction, irradiance in zip(light.directions, light.irradiance, strict=True):
        yield as_map(direction, like), as_map(irradiance, like)


def checked_visibility(light: Light, gbuffer: GBuffer) -> Tensor:
    """A light's visibility map, 0 where it is not finite.

    Raises:
        InputError: a size that is not the image's.
    """
    seen = light.visibility
    what = f"{type(light).__name__} visibility"
    check_type(what, seen, Tensor, "convert it by torch.as_tensor(x)")
    b, _, h, w = gbuffer.normal.shape
    seen = cast(Tensor, seen)
    if seen.ndim != 4 or seen.shape[1:] != (1, h, w) or seen.shape[0] not in (1, b):
        raise InputError(
            f"{what}: expected [{b}, 1, {h}, {w}], as the normals, got {list(seen.shape)}"
        )
    return torch.nan_to_num(seen.float(), nan=0.0).clamp(0, 1)


def _from_a_point(
    light: PointLight | SpotLight, position: Tensor | None, like: Tensor
) -> tuple[Tensor, Tensor]:
    to_light = as_map(light.position, like) - _needed(position, light)
    return to_light, as_map(light.intensity, like) * inverse_square(to_light)


def _needed(position: Tensor | None, light: object) -> Tensor:
    if position is None:
        raise InputError(
            f"{type(light).__name__}: expected a G-buffer with position [B, 3, H, W], got none; a "
            "DirectionalLight needs none"
        )
    return position


def _check(light: object, **triples: Colour) -> None:
    for name, value in triples.items():
        where = f"{type(light).__name__}: {name}"
        tensor = checked(where, value, may_be_one=name in ("irradiance", "intensity"))
        if name != "direction":
            continue
        if (tensor == 0).all(dim=-1).any():
            raise InputError(f"{where}: expected a direction towards the light, got zero")
        single = tensor.abs().amax(dim=-1).float()
        if (single == 0).any() or torch.isinf(single).any():
            raise InputError(
                f"{where}: expected numbers that single precision holds, got {value!r}; "
                "its length does not count"
            )
