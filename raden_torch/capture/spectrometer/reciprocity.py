"""Helmholtz reciprocity, checked in a scan: f with light and viewer in each other's place."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from raden_torch.arrays import Floats
from raden_torch.measurement import BrdfMeasurement
from raden_torch.reflectance.grid import DIGITS
from raden_torch.reflectance.symmetry import reciprocal

_FEWEST_PAIRS = 20
_RECIPROCAL = 0.8  # of the pairs within 2 standard deviations; 0.95 where only noise is left


@dataclass(frozen=True)
class Reciprocity:
    """f(a, r, t) against f with light and viewer in each other's place, in Y.

    Attributes:
        pairs: how many pairs were measured.
        mean: |difference| over the pair's mean, weighted by that mean.
        within_two_std: share of the pairs that differ by at most two standard deviations.
        worst_deg: incidence, receiving and tilt where they differ by most of them.
    """

    pairs: int
    mean: float
    within_two_std: float
    worst_deg: tuple[float, ...] = ()

    @property
    def warning(self) -> str | None:
        """What to say where the law is broken far beyond the readings' uncertainty."""
        if self.pairs < _FEWEST_PAIRS or self.within_two_std >= _RECIPROCAL:
            return None
        share = 100 * (1 - self.within_two_std)
        worst = ", ".join(f"{angle:g}" for angle in self.worst_deg)
        return (
            f"reciprocity is broken beyond the uncertainty in {share:.0f} % of the pairs, worst at "
            f"({worst}): a zero is off, or the sample is not reciprocal"
        )


def check_reciprocity(measurement: BrdfMeasurement) -> Reciprocity:
    """Compare every valid cell with its reciprocal one, where that was measured, too.

    Real samples and rigs break the law; a large figure is a reason to check the rig's zeros.
    """
    m = measurement.select(measurement.valid) if measurement.valid.any() else None
    if m is None:
        return Reciprocity(0, float("nan"), float("nan"))
    rows = {key: row for row, key in enumerate(_keys(m.angles_deg))}
    other = np.array([rows.get(key, -1) for key in _keys(reciprocal(m.angles_deg))])
    here = np.flatnonzero(other > np.arange(len(m)))  # each pair once, none with itself
    there = other[here]
    y, std = m.values[:, 1], np.zeros(len(m)) if m.std is None else m.std[:, 1]
    difference, size = abs(y[here] - y[there]), abs(y[here] + y[there]) / 2
    if not len(here) or not size.sum() > 0:
        return Reciprocity(0, float("nan"), float("nan"))
    allowed = 2 * np.hypot(std[here], std[there]) + 1e-9 * size
    worst = here[np.argmax(difference / np.maximum(allowed, 1e-12))]
    return Reciprocity(
        len(here),
        float(difference.sum() / size.sum()),
        float((difference <= allowed).mean()),
        (
            float(m.incidence_deg[worst]),
            float(m.receiving_deg[worst]),
            float(m.tilt_deg[worst]),
        ),
    )


def _keys(angles: Floats) -> list[tuple[float, ...]]:
    return [tuple(row) for row in (np.round(angles, DIGITS) + 0.0).tolist()]  # −0 becomes 0
