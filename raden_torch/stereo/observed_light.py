"""What K photographs say of P pixels, and what a material would show there."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import torch
from torch import Tensor

from raden_torch.brdf.materials.surface import Reflection

RELATIVE_NOISE = 0.03
"""Of a value: what lamps' directions, a model and a camera are off by, as a standard deviation."""


@dataclass(frozen=True, eq=False)
class ObservedLight:
    """P pixels under K lamps.

    Attributes:
        value: `[K, C, P]` linear light, C = 3 of the model's primaries, or 1: their mean.
        usable: `[K, 1, P]`, 1 where the value is not clipped, else 0.
        light: `[K, 3, P or 1]` unit vectors to the lamps.
        strength: `[K, 1, P or 1]`, the lamps' irradiance there, relative.
        view: `[3, P or 1]` unit vectors to the camera.
        floor: the standard deviation of a dark value, in the unit of `value`.
        surface: `[3, P or 1]` normals of the surface where these are known: it is then the film
            layers below it that turn (`GBuffer.layer_normal`).
        relative: of a value, what it is off by as a standard deviation.
    """

    value: Tensor
    usable: Tensor
    light: Tensor
    strength: Tensor
    view: Tensor
    floor: float
    surface: Tensor | None = None
    relative: float = RELATIVE_NOISE

    def at(self, index: Tensor) -> ObservedLight:
        """Some of the pixels, by their numbers or as a mask."""

        def part(m: Tensor) -> Tensor:
            return m if m.shape[-1] == 1 else m[..., index]

        return ObservedLight(
            self.value[..., index],
            self.usable[..., index],
            part(self.light),
            part(self.strength),
            part(self.view),
            self.floor,
            None if self.surface is None else part(self.surface),
            self.relative,
        )

    def under(self, lamps: Sequence[int]) -> ObservedLight:
        """Some of the photographs, by their numbers."""
        parts = {
            name: getattr(self, name)[list(lamps)]
            for name in ("value", "usable", "light", "strength")
        }
        return replace(self, **parts)

    @property
    def pixels(self) -> int:
        return self.value.shape[-1]

    @cached_property
    def counted(self) -> Tensor:
        """`[P]`, how many values of each pixel count."""
        return self.usable.sum((0, 1)) * self.value.shape[1]

    @cached_property
    def weight(self) -> Tensor:
        """`[K, C, P]` one over the standard deviation of each value, 0 where it is clipped."""
        return self.usable / (self.relative * self.value + self.floor)

    @property
    def film_surface(self) -> Tensor:
        """`[3, P or 1]`, the surface's normals, of light whose surface is known."""
        if self.surface is None:
            raise ValueError("light.surface: expected normals, got None")
        return self.surface

    def vectors(self, normal: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Unit normals `[3, P]`, lights and views, `[K, 3, 1, P]` each."""
        size = (len(self.light), 3, 1, normal.shape[-1])
        given = (normal[None, :, None], self.light[:, :, None], self.view[None, :, None])
        n, to, v = (m.expand(size) for m in given)
        return n, to, v

    @property
    def middle(self) -> ObservedLight:
        """One pixel, lit and seen as the pixels' mean is, without values."""

        def mean(m: Tensor, across: int) -> Tensor:
            m = m.mean(-1, keepdim=True)
            return m / m.norm(dim=across, keepdim=True)

        return ObservedLight(
            self.value[..., :0],
            self.usable[..., :0],
            mean(self.light, 1),
            self.strength.mean(-1, keepdim=True),
            mean(self.view, 0),
            self.floor,
            None if self.surface is None else mean(self.surface, 0),
            self.relative,
        )


GRAZING = 0.05
"""Below this irradiance, the lamp's strength times the cosine, a reading is mostly noise."""


def thinned(index: Tensor, most: int) -> Tensor:
    """Of pixels' numbers no more than so many, evenly."""
    return index[:: max(1, -(-len(index) // most))]


def sampled(light: ObservedLight, most: int) -> ObservedLight:
    """No more than so many of the pixels, evenly."""
    return light.at(thinned(torch.arange(light.pixels), most))


def shown(material: Reflection, normal: Tensor, light: ObservedLight) -> Tensor:
    """`[K, C, P]` radiance s f_r(N, L, V) N·L of unit normals `[3, P]`; 0 in the own shadow.

    Where the surface is known, `normal` is that of the film layers, and the cosine the surface's.
    """
    f = material.of_unit_vectors(*light.vectors(normal))[:, :, 0]
    x, y, z = normal if light.surface is None else light.surface
    # far faster than a sum over xyz
    facing = light.light[:, 0] * x + light.light[:, 1] * y + light.light[:, 2] * z
    seen = light.view[0] * x + light.view[1] * y + light.view[2] * z > 0
    radiance = f * (facing.clamp(min=0) * seen * light.strength[:, 0])[:, None]
    return radiance if light.value.shape[1] == 3 else radiance.mean(1, keepdim=True)
