"""Several measurements of one specimen → one: each reading weighed by its variance.

Reading i of measurement s at geometry k is v_ik = c_k exp(e_s) + noise, with e_s the error of the
measurement's scale, of the stated standard uncertainty u_s. First the e_s are found, then

    c_k = Σ w v exp(−e_s) / Σ w,   w = exp(2 e_s) / std²,   std(c_k) = 1 / √Σ w.

The e_s = u_s z_s are those that make Σ (v − c exp(u z))² / std² + Σ z² least: scales move towards
each other by no more than their uncertainties explain; one that states none stays; those with the
same reference move together. What remains uncertain of the scale is the result's `scale_std`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from raden_torch.arrays import Floats
from raden_torch.errors import InputError
from raden_torch.measurement.compare import compare_shared
from raden_torch.measurement.consistency import CONTRADICTION_STD, MAX_BIRGE, Chi2
from raden_torch.measurement.readings import BrdfMeasurement, Metadata
from raden_torch.measurement.scale_alignment import Scales, aligned_scales
from raden_torch.measurement.stack import Stack
from raden_torch.measurement.systematic_errors import SystematicErrors

_REFUSED_P = 1e-6  # what chance alone may refuse
_ADVICE = (
    "see `raden info A B` for where they differ, leave one out, or enlarge the uncertainties by "
    "`robust`"
)
_WORST = 3  # cells that are named


@dataclass(frozen=True)
class MergedMeasurement:
    """Attributes:
    measurement: the result; `count` adds up, cells of one measurement alone are kept.
    shared: how many cells have readings of several measurements.
    scale_factors: what each measurement was divided by.
    chi2: of the shared cells' readings about their means, in the channel where it is largest.
    contradicting: how many cells contradict; 0 unless `robust`.
    enlarged: by how much the standard deviations of the shared cells were enlarged; 1 unless
        `robust`.
    """

    measurement: BrdfMeasurement
    shared: int
    scale_factors: tuple[float, ...]
    chi2: Chi2
    contradicting: int
    enlarged: float

    def __str__(self) -> str:
        m = self.measurement
        factors = ", ".join(f"{factor:.5g}" for factor in self.scale_factors)
        lines = [
            repr(m),
            f"{self.shared} cells from several measurements, {int(m.valid.sum()) - self.shared} "
            "from one",
            f"scales divided by {factors}; scale_std left: {m.metadata.systematic.scale_std:.2g}",
            f"chi2/dof of the shared cells {self.chi2.per_dof:.3g}",
        ]
        if self.contradicting or self.enlarged > 1.0:
            lines.append(
                f"{self.contradicting} cells contradict; standard deviations enlarged "
                f"{self.enlarged:.3g} times in shared cells, and to the scatter in these"
            )
        return "\n".join(lines)


def merge(measurements: Sequence[BrdfMeasurement], *, robust: bool = False) -> MergedMeasurement:
    """One measurement of several of one specimen; their order does not matter.

    Args:
        measurements: two or more, with standard deviations. Channels that differ become XYZ.
        robust: enlarge the standard deviation of cells that contradict, in place of refusing them,
            to what makes χ²/dof 1 (Birge's ratio).

    Raises:
        InputError: fewer than two, readings without standard deviations, another white or observer,
            or readings that contradict each other beyond them.
    """
    _check(measurements)
    stack = Stack.of(measurements)
    scales = aligned_scales(stack, [m.metadata.systematic for m in measurements])
    values, weight = stack.rescaled(scales.errors)
    mean = stack.mean(values, weight)
    scatter = _scatter(stack, values, mean, weight)
    if not robust:
        if scatter.contradicts.any():
            raise InputError(_contradiction(stack, values, scatter))
        _check_pairs(measurements)
    enlarged = max(1.0, scatter.overall.birge) if robust else 1.0
    merged = BrdfMeasurement(
        stack.angles[:, 0],
        stack.angles[:, 1],
        stack.angles[:, 2],
        values=mean,
        channels=stack.channels,
        azimuth_deg=None if measurements[0].azimuth_deg is None else stack.angles[:, 3],
        std=stack.total(weight) ** -0.5 * _growth(stack, scatter, enlarged)[:, None],
        count=stack.total(stack.count[:, None])[:, 0].astype(np.int64),
        metadata=_metadata(measurements, scales, enlarged),
    )
    return MergedMeasurement(
        merged,
        int(stack.several.sum()),
        tuple(np.exp(scales.errors).tolist()),
        scatter.overall,
        int(scatter.contradicts.sum()),
        enlarged,
    )


def _check(measurements: Sequence[BrdfMeasurement]) -> None:
    if len(measurements) < 2:
        raise InputError(f"merge: expected two measurements or more, got {len(measurements)}")
    if len({m.azimuth_deg is None for m in measurements}) > 1:
        raise InputError(
            "merge: expected a sample azimuth in all measurements or in none, got it in some"
        )


def _check_pairs(measurements: Sequence[BrdfMeasurement]) -> None:
    """Refuse two that disagree as a whole, their shared errors taken as such (`compare`)."""
    for (i, first), (j, second) in combinations(enumerate(measurements, 1), 2):
        c = compare_shared(first, second)
        if c is None:
            continue
        if c.p < _REFUSED_P and c.birge > MAX_BIRGE:
            by = f"by {c.birge:.3g} times their uncertainty"
        elif c.scale.deviations > CONTRADICTION_STD:
            by = f"in scale by {c.scale.deviations:.3g} standard deviations"
        else:
            continue
        raise InputError(
            f"merge: expected measurements that agree, got {i} and {j}, which differ {by} over all "
            f"cells; {_ADVICE}"
        )


@dataclass(frozen=True)
class _Scatter:
    per_cell: Floats  # [K] χ²/dof of the channel where it is largest; 0 for a lone reading
    contradicts: NDArray[np.bool_]  # [K]
    overall: Chi2


def _scatter(stack: Stack, values: Floats, mean: Floats, weight: Floats) -> _Scatter:
    from scipy.special import chdtrc

    chi2 = stack.total((values - mean[stack.cell]) ** 2 * weight)
    dof = np.bincount(stack.cell, minlength=len(stack.angles)) - 1
    largest = chi2.max(axis=1)
    chance = chdtrc(np.maximum(dof, 1), largest)
    per_channel = [Chi2(float(column[dof > 0].sum()), int(dof.sum())) for column in chi2.T]
    return _Scatter(
        np.where(dof > 0, largest / np.maximum(dof, 1), 0.0),
        (dof > 0) & (chance < chdtrc(1, CONTRADICTION_STD**2)),
        max(per_channel, key=lambda one: one.value),
    )


def _contradiction(stack: Stack, values: Floats, found: _Scatter) -> str:
    worst = np.argsort(-found.per_cell)[:_WORST]
    named = []
    for cell in worst[found.per_cell[worst] > 0]:
        here = stack.cell == cell
        channel = min(1, len(stack.channels) - 1)
        angles = ", ".join(f"{angle:g}" for angle in stack.angles[cell, :3])
        read = " and ".join(f"{value:.5g}" for value in values[here, channel])
        named.append(f"({angles} deg) {stack.channels[channel]} = {read}")
    return (
        "merge: expected measurements that agree within their uncertainty, got "
        f"{int(found.contradicts.sum())} cells that contradict; worst: "
        f"{'; '.join(named)}; {_ADVICE}"
    )


def _growth(stack: Stack, scatter: _Scatter, enlarged: float) -> Floats:
    """`[K]`: by how much the standard deviations grow: 1 but in shared cells of a robust merge."""
    if enlarged == 1.0 and not scatter.contradicts.any():
        return np.ones(len(stack.angles))
    own = np.where(scatter.contradicts, np.sqrt(scatter.per_cell), 0.0)
    return np.where(stack.several, np.maximum(own, enlarged), 1.0)


def _metadata(measurements: Sequence[BrdfMeasurement], scales: Scales, enlarged: float) -> Metadata:
    """The same in any order; what was merged stands in the entries."""
    metas = [m.metadata for m in measurements]
    joined = lambda name: "; ".join(sorted({getattr(meta, name) for meta in metas} - {""}))  # noqa: E731
    references = {meta.systematic.scale_reference for meta in metas}
    zeros = np.array([meta.systematic.zero_std_deg for meta in metas])
    a, r, t = (float(f"{std:.9g}") for std in np.sqrt(scales.share**2 @ zeros**2))
    whites = {meta.systematic.white_deg for meta in metas}
    entries = [
        (
            "merged",
            f"{meta.sample or 'unnamed'}{' (simulated)' if meta.simulated else ''}, "
            f"{int(m.valid.sum())} readings, sha256 {m.sha256[:12]}, "
            f"divided by {np.exp(error):.6g}",
        )
        for meta, m, error in zip(metas, measurements, scales.errors, strict=True)
    ]
    numbered = [(f"{key} {i}", text) for i, (key, text) in enumerate(sorted(entries), 1)]
    note = (f"standard deviations of shared cells enlarged {enlarged:.3g} times",)
    return replace(
        metas[0],
        sample=joined("sample"),
        instrument=joined("instrument"),
        simulated=any(meta.simulated for meta in metas),
        systematic=SystematicErrors(
            float(f"{scales.remaining:.9g}"),  # the same in any order, beyond rounding
            references.pop() if len(references) == 1 else "",
            zero_std_deg=(a, r, t),
            white_deg=whites.pop() if len(whites) == 1 else None,
        ),
        other=tuple(numbered),
        notes=note if enlarged > 1.0 else (),
    )
