"""A budget of standard deviations: its terms, and what of them a measurement carries as `std`."""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np

from raden_torch.arrays import Floats


@dataclass(frozen=True, eq=False)
class BudgetTerms:
    """Every field is a term, `[M, 3]` standard deviations (k = 1) of reflectance factors.

    `scale` is common to all cells: it would only hide how well they compare.
    """

    scale: Floats

    @property
    def total(self) -> Floats:
        """All terms but `scale`, in quadrature: what a measurement carries as its `std`."""
        squares = [term**2 for name, term in self.terms().items() if name != "scale"]
        return np.sqrt(np.sum(squares, axis=0))

    def terms(self) -> dict[str, Floats]:
        """`[M, 3]` by name, the scale last."""
        names = [field.name for field in fields(self) if field.name != "scale"]
        return {name: getattr(self, name) for name in (*names, "scale")}
