"""Do values of one quantity contradict each other beyond their uncertainty?"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from raden_torch.arrays import Floats

MAX_BIRGE = 1.2
"""How many times the stated uncertainty a scatter may be and still agree with it.

A standard deviation is not known better: from 13 readings it is itself uncertain by a fifth
(JCGM 100:2008, table E.1).
"""
SIGNIFICANT = 0.01
"""A p-value below this counts as a significant disagreement."""
CONTRADICTION_STD = 6.0
"""Readings of one geometry contradict where two differ by more of their standard deviations, or
several by what is as improbable."""


@dataclass(frozen=True)
class Chi2:
    """Squared differences over their variances, summed, and how many independent ones there were.

    Attributes:
        value: the sum; 0 where nothing differs.
        dof: degrees of freedom.
    """

    value: float
    dof: int

    @property
    def per_dof(self) -> float:
        return self.value / self.dof if self.dof > 0 else 0.0

    @property
    def birge(self) -> float:
        """By how much the uncertainties would have to grow to explain the scatter: √(χ²/dof).

        R. T. Birge, Phys. Rev. 40, 207 (1932).
        """
        return float(np.sqrt(self.per_dof))

    @property
    def p(self) -> float:
        """How often chance alone makes the sum as large, if the uncertainties are right; 0…1."""
        from scipy.special import chdtrc

        return float(chdtrc(self.dof, self.value)) if self.dof > 0 else 1.0

    @property
    def agrees(self) -> bool:
        return self.p >= SIGNIFICANT or self.birge <= MAX_BIRGE


class Covariance:
    """D + U U′ of N differences whose errors are partly shared; only K x K is ever solved.

    Args:
        variance: `[N]` D, of the independent parts, above 0.
        common: `[N, K]` U, what one standard deviation of a shared error does to a difference.
    """

    def __init__(self, variance: Floats, common: Floats) -> None:
        self.variance = variance
        self._common = common
        self._weighed = common / variance[:, None]
        self._system = np.eye(common.shape[1]) + common.T @ self._weighed

    @property
    def std(self) -> Floats:
        """`[N]`: of each difference alone."""
        return np.sqrt(self.variance + (self._common**2).sum(axis=1))

    def solve(self, x: Floats) -> Floats:
        """`[N]`: (D + U U′)⁻¹ x, by Woodbury's identity."""
        shared = np.linalg.solve(self._system, self._weighed.T @ x)
        return np.asarray(x / self.variance - self._weighed @ shared)

    def chi2(self, difference: Floats) -> Chi2:
        """Of `[N]` differences: d′ (D + U U′)⁻¹ d with N degrees of freedom."""
        return Chi2(max(float(difference @ self.solve(difference)), 0.0), len(difference))


def pair_contradicts(first: Floats, second: Floats, std: Floats | None) -> Floats:
    """`[N]` True where two readings `[N, C]` differ by over 5 % and `CONTRADICTION_STD`.

    Args:
        std: `[N, C]` of the difference; None, or NaN, where it is not known.
    """
    allowed = 0.05 * np.maximum(abs(first), abs(second)).max(axis=1) + 1e-9
    if std is not None:
        allowed = np.maximum(allowed, CONTRADICTION_STD * np.nan_to_num(std).max(axis=1))
    return np.asarray(abs(first - second).max(axis=1) > allowed)
