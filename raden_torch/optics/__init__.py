"""Film optics, and the simulated shells made from it. No torch."""

from raden_torch.optics.specimens import SPECIMENS, simulate_specimen

__all__ = ["SPECIMENS", "simulate_specimen"]
