"""How much light falls on the white, where it, its lamp or both stand elsewhere."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from raden_torch.arrays import Floats
from raden_torch.capture.photo.brdf.lighting import LEAN_DEG, Lamp
from raden_torch.capture.photo.brdf.rays import Rays
from raden_torch.capture.photo.brdf.sample_shapes import Plane


@dataclass(frozen=True, eq=False)
class WhiteSight:
    """The white in one photograph, by a few of its pixels.

    Attributes:
        rays: of the pixels, all over it.
        plane: that they see.
        on_board: that plane is the board's.
    """

    rays: Rays
    plane: Plane
    on_board: bool

    def light(self, lamp: Lamp, middle: Floats, plane: Plane | None = None) -> Floats:
        """`[P]` irradiance, that at `middle`, the sample's, on a plane that faces the lamp being 1.

        Args:
            plane: where the white would be.
        """
        surface = (plane or self.plane).seen(self.rays)
        way, falloff = lamp.at(surface.point, middle)
        return np.asarray((way * surface.normal).sum(1) * falloff)

    def change(
        self, before: tuple[Lamp, Floats], after: tuple[Lamp, Floats], plane: Plane | None = None
    ) -> float:
        """The share by which its light grows, from one lamp and sample's middle to another."""
        return float((self.light(*after, plane) / self.light(*before)).mean() - 1)

    def lean(self, lamp: Lamp, middle: Floats) -> Floats:
        """`[2]`: the share by which its light grows, a degree that the lamp leans along each of its
        two directions."""
        here = self.light(lamp, middle)
        found = []
        for along in LEAN_DEG * np.eye(2):
            there, back = (self.light(lamp.turned(s * along, middle), middle) for s in (1, -1))
            found.append(((there - back) / here).mean() / (2 * LEAN_DEG))
        return np.array(found)
