"""The urushi that pictures of plates are made with."""

from __future__ import annotations

from functools import lru_cache

from raden_torch.brdf.materials.coat import Coated
from raden_torch.brdf.materials.urushi import BLACK, RGB, URUSHI_INDEX, Lambertian


@lru_cache(maxsize=8)  # a coat is baked once
def Lacquer(base: RGB = BLACK) -> Coated:
    """Polished urushi over a body of this albedo; zeros leave the gloss alone."""
    return Coated(Lambertian(base), index=URUSHI_INDEX)
