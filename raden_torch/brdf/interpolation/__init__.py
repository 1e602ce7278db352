"""What lies between the measured nodes: interpolators, their choice, and baking them."""

from raden_torch.brdf.interpolation.bake import Baked, bake
from raden_torch.brdf.interpolation.schemes import SCHEMES, Scheme, reconstruct, why_not

__all__ = ["SCHEMES", "Baked", "Scheme", "bake", "reconstruct", "why_not"]
