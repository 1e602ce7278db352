"""Grounds of lacquerware: pigments in urushi, under their own polished face."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor

from raden_torch import geometry
from raden_torch.brdf.materials.coat import Coated
from raden_torch.errors import InputError
from raden_torch.geometry import dot

RGB = tuple[float, float, float]

URUSHI_INDEX = 1.53
"""Of a cured film in the visible: an assumption, in the range of 1.52 to 1.54 of other resins."""
SUKI_ABSORPTION = (3.0, 10.0, 30.0)
"""Of clear (*suki*) urushi, linear RGB per mm: an assumption, amber at the 0.03 mm of one coat and
brown at 0.1 mm."""
COAT_MM = 0.03
"""A brushed and polished coat: an assumption, from the 0.02 to 0.05 mm that are usual."""
BLACK: RGB = (0.023, 0.014, 0.009)
"""Of black urushi's body (*roiro*, stained with iron): an assumption, close to no reflectance and a
little brown, as it is seen where no lamp is mirrored."""
VERMILION: RGB = (0.62, 0.060, 0.022)
"""Of vermilion (*shu*, mercury sulfide) in urushi: an assumption, from its edge at 590 to 600 nm,
of some 5 % below and 65 % above, in linear sRGB."""


@dataclass(frozen=True)
class Lambertian:
    """A body that scatters the same everywhere: f_r = albedo/π.

    Attributes:
        albedo: linear RGB, 0…1.
    """

    albedo: RGB

    def __post_init__(self) -> None:
        if len(self.albedo) != 3 or not all(0 <= x <= 1 for x in self.albedo):
            raise InputError(f"albedo: expected three numbers in 0…1, got {self.albedo}")

    def working_dtype(self, *maps: Tensor) -> torch.dtype:
        return geometry.working_dtype(*maps)

    def of_unit_vectors(self, n: Tensor, l: Tensor, v: Tensor) -> Tensor:  # noqa: E741
        above = (dot(n, l) > 0) & (dot(n, v) > 0)
        f = n.new_tensor(self.albedo).view(3, 1, 1) / math.pi
        return torch.where(above, f, torch.zeros_like(f))

    def state(self) -> Any:
        return self.albedo


def black_urushi(roughness: float = 0.07) -> Coated:
    """Polished black urushi: `BLACK` under its own face.

    Args:
        roughness: GGX α of the polish, an assumption (see `Coated`).

    Examples:
        >>> black_urushi().base
        Lambertian(albedo=(0.023, 0.014, 0.009))
    """
    return Coated(Lambertian(BLACK), index=URUSHI_INDEX, roughness=roughness)


def vermilion_urushi(roughness: float = 0.07, clear_mm: float = COAT_MM) -> Coated:
    """Vermilion urushi under a coat of clear urushi: `VERMILION`, `SUKI_ABSORPTION`."""
    return Coated(
        Lambertian(VERMILION),
        index=URUSHI_INDEX,
        absorption=SUKI_ABSORPTION,
        thickness=clear_mm,
        roughness=roughness,
    )
