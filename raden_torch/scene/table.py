"""The table under a box, with the box's shadow: its matt part."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor
from torch.nn.functional import grid_sample

from raden_torch.artwork.box import Box
from raden_torch.brdf.shading.area_lights import AreaLight
from raden_torch.brdf.shading.environment import DistantLamps, EnvironmentLight
from raden_torch.brdf.shading.lights import Light, directions_of
from raden_torch.geometry import unit_columns

_REACH, _SIDE = 6.0, 121
"""Half the side of the square whose soft shadow is kept, and nodes along it."""
_LAMPS = 256
_EDGE = 0.08
"""Of small lamps' shadows, in the way of light through the box."""


@dataclass(frozen=True)
class Table:
    """A matt plane at y = 0.

    Attributes:
        albedo: linear RGB, 0…1.
        roughness: GGX α of the polished face above it; None: matt.
    """

    albedo: tuple[float, float, float] = (0.42, 0.405, 0.385)
    roughness: float | None = None

    def under(self, light: EnvironmentLight) -> EnvironmentLight:
        """Surroundings whose lower half is the table far from the box, as lit by the upper one."""
        radiance = light.radiance.clone()
        height = radiance.shape[1]
        radiance[:, (height + 1) // 2 :] = 0
        upper = _lamps(EnvironmentLight(radiance))
        received = (upper.irradiance * upper.directions[:, 1:2].clamp(min=0)).sum(0)
        seen = received.float() * torch.tensor(self.albedo) / torch.pi
        radiance[:, (height + 1) // 2 :] = seen[:, None, None]
        return EnvironmentLight(radiance, light.rotation_deg, light.intensity)


class LitTable:
    """A table under lights, with the shadow of a box on it.

    Soft light is kept at the nodes of a grid about the box; small lamps are asked for every place.
    """

    def __init__(self, table: Table, box: Box | None, lights: Sequence[Light]) -> None:
        self._box = box
        self._factor = torch.tensor(table.albedo)[:, None] / torch.pi
        self._sharp = [x for x in lights if not isinstance(x, _SOFT)]
        axis = torch.linspace(-_REACH, _REACH, _SIDE)
        z, x = torch.meshgrid(axis, axis, indexing="ij")
        nodes = torch.stack([x, torch.zeros_like(x), z]).flatten(1)
        soft = [_lamps(x) if isinstance(x, EnvironmentLight) else x for x in lights]
        lit = self._received(nodes, [x for x in soft if isinstance(x, _SOFT)])
        self._grid = lit.view(1, 3, _SIDE, _SIDE)

    def radiance(self, position: Tensor) -> Tensor:
        """`[3, N]` from places `[3, N]` on the table, in every direction."""
        return self._factor * (self._read(position) + self._received(position, self._sharp))

    def mirrored(self, position: Tensor) -> Tensor:
        """The same without small lamps' shadows: what a reflection needs."""
        return self._factor * self._read(position)

    def _read(self, position: Tensor) -> Tensor:
        at = (position[[0, 2]] / _REACH).T[None, None]
        found = grid_sample(self._grid, at, align_corners=True, padding_mode="border")
        return found[0, :, 0]

    def _received(self, position: Tensor, lights: Sequence[Light]) -> Tensor:
        """Irradiance `[3, N]`."""
        total = torch.zeros_like(position)
        where = position[None, :, None]
        for light in lights:
            for towards, irradiance in directions_of(light, where, where):
                to = unit_columns(towards[0, :, 0])
                cosine = to[1].clamp(min=0)
                if not bool((cosine > 0).any()):
                    continue
                open_sky = torch.ones(1)
                if self._box is not None:
                    soft = 0.0 if isinstance(light, _SOFT) else _EDGE
                    open_sky = 1 - self._box.covers(position, to.expand_as(position), soft)
                total += irradiance[0, :, 0] * (cosine * open_sky)
        return total


_SOFT = (EnvironmentLight, DistantLamps, AreaLight)


def _lamps(light: EnvironmentLight) -> DistantLamps:
    lamps = light.lamps(_LAMPS)
    return DistantLamps(lamps.directions.float(), lamps.irradiance.float())
