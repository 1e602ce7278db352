"""Do the photographs belong to these lamps, in this order?

Pixels that all K lamps light give brightnesses I = L b with L `[K, 3]`: vectors in the columns'
space of L. What lies outside it, as a share of the whole, does not depend on the surface. Other
orders of the lamps make other spaces, so the order that leaves least outside is the likely one
(a rotation of a regular ring of lamps leaves as much, and cannot be told so).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import combinations
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

_LIT = 0.1
_FEWEST_PIXELS = 50
_CLEARLY, _PERHAPS = 1.5, 1.1
"""How many times more must lie outside before another order is believed, or thought possible."""
_WORTH = 0.03
"""And how much, of the brightness."""


@dataclass(frozen=True)
class OrderCheck:
    """How the photographs agree with the lamps.

    Attributes:
        outside: share of the brightness (rms) that no surface could have under these lamps.
        best: the same for the best order found.
        order: that order: photograph k was lit by lamp order[k].
    """

    outside: float
    best: float
    order: tuple[int, ...]

    @property
    def doubtful(self) -> bool:
        """Another order fits clearly better."""
        return self.outside > max(_WORTH, _CLEARLY * self.best)

    @property
    def uncertain(self) -> bool:
        """Another order fits somewhat better."""
        return self.outside > max(_WORTH, _PERHAPS * self.best)

    def moved(self) -> list[int]:
        return [k for k, lamp in enumerate(self.order) if lamp != k]


def check_order(images: Tensor, lights: Tensor, mask: Tensor | None = None) -> OrderCheck | None:
    """Compare the order given with others.

    Args:
        images: `[K, C, H, W]` linear light; divided by the lamps' intensities.
        lights: `[K, 3]` directions to the lamps.
        mask: `[1, 1, H, W]`.

    Returns:
        None where it cannot be told: K < 5, or too few pixels that all lamps light.
    """
    count = len(images)
    directions = lights.double().cpu().numpy()
    grey = images.mean(dim=1).reshape(count, -1)
    if mask is not None:
        grey = grey[:, mask.reshape(-1) > 0.5]
    brightest = grey.amax(dim=0)
    lit = (grey.amin(dim=0) > _LIT * brightest) & (brightest > 0.01 * brightest.max())
    if count < 5 or int(lit.sum()) < _FEWEST_PIXELS:
        return None
    grey = grey[:, lit].double()
    grey = grey / grey.norm(dim=0)
    gram = (grey @ grey.T / torch.trace(grey @ grey.T)).cpu().numpy()

    def outside(order: list[int]) -> float:
        basis = np.linalg.qr(directions[order])[0]
        return float(np.sqrt(max(0.0, 1 - np.trace(basis.T @ gram @ basis))))

    given = list(range(count))
    shifts = [given[s:] + given[:s] for s in range(1, count)]
    starts = [given, given[::-1], *sorted(shifts, key=outside)[:2]]
    best = min((_swapped_downhill(start, outside) for start in starts), key=outside)
    first = outside(given)
    if outside(best) > first * (1 - 1e-9):
        best = given
    return OrderCheck(first, outside(best), tuple(best))


def under_lamps(order: Sequence[int], photographs: Sequence[Path]) -> str:
    """The first four that have another lamp than their own: "a.png under lamp 3, …"."""
    pairs = enumerate(zip(order, photographs, strict=True))
    shown = [f"{path.name} under lamp {lamp + 1}" for k, (lamp, path) in pairs if lamp != k]
    return ", ".join(shown[:4]) + (" …" if len(shown) > 4 else "")


def _swapped_downhill(order: list[int], outside: Callable[[list[int]], float]) -> list[int]:
    """Swap pairs as long as that helps."""
    cost = outside(order)
    while True:
        trials = []
        for i, j in combinations(range(len(order)), 2):
            trial = list(order)
            trial[i], trial[j] = trial[j], trial[i]
            trials.append((outside(trial), trial))
        least, trial = min(trials)
        if least >= cost * (1 - 1e-6):
            return order
        order, cost = trial, least
