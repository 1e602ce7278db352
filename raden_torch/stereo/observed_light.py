"""What K photographs say of P pixels, and what a material would show there."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

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
    """

    value: Tensor
    usable: Tensor
    light: Tensor
    strength: Tensor
    view: Tensor
    floor: float

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
        )

    @property
    def pixels(self) -> int:
        return self.value.shape[-1]

    @cached_property
    def weight(self) -> Tensor:
        """`[K, C, P]` one over the standard deviation of each value, 0 where it is clipped."""
        return self.usable / (RELATIVE_NOISE * self.value + self.floor)

    @property
    def middle(self) -> tuple[Tensor, Tensor, Tensor]:
        """Light, strength and view at the pixels' mean, `[..., 1]` each."""
        light, view = self.light.mean(-1, keepdim=True), self.view.mean(-1, keepdim=True)
        light = light / light.norm(dim=1, keepdim=True)
        view = view / view.norm(dim=0, keepdim=True)
        return light, self.strength.mean(-1, keepdim=True), view


def shown(
    material: Reflection,
    normal: Tensor,
    light: Tensor,
    strength: Tensor,
    view: Tensor,
    *,
    channels: int = 3,
    layers: Tensor | None = None,
) -> Tensor:
    """`[K, C, P]` radiance s f_r(N, L, V) N·L of unit normals `[3, P]`; 0 in the own shadow.

    Args:
        light, strength, view: as in `ObservedLight`.
        layers: `[3, P]` normals of the film layers, where the material turns with them and the
            irradiance stays that of `normal` (`GBuffer.layer_normal`).
    """
    count, pixels = len(light), normal.shape[-1]
    size = (count, 3, 1, pixels)
    turned = (normal if layers is None else layers)[None, :, None].expand(size)
    to, v = light[:, :, None].expand(size), view[None, :, None].expand(size)
    f = material.of_unit_vectors(turned, to, v)[:, :, 0]
    x, y, z = normal
    facing = light[:, 0] * x + light[:, 1] * y + light[:, 2] * z  # far faster than a sum over xyz
    seen = view[0] * x + view[1] * y + view[2] * z > 0
    radiance = f * (facing.clamp(min=0) * seen * strength[:, 0])[:, None]
    return radiance if channels == 3 else radiance.mean(1, keepdim=True)
