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
from typing import cast

import numpy as np
from numpy.typing import NDArray

from raden_torch.errors import InputError
from raden_torch.measurement.colour_conversion import matrix_to
from raden_torch.measurement.common_errors import CommonErrors
from raden_torch.measurement.compare import common_channels
from raden_torch.measurement.consistency import CONTRADICTION_STD, MAX_BIRGE, Chi2
from raden_torch.measurement.matching import DIGITS, angles_deg
from raden_torch.measurement.readings import BrdfMeasurement, Floats, Metadata

_ROUNDS = 50
_REFUSED_P = 1e-6  # what chance alone may refuse
_SETTLED = 1e-12
_WORST = 3  # cells that are named


@dataclass(frozen=True)
class Merged:
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
            f"scales divided by {factors}; scale_std left: {m.metadata.common.scale_std:.2g}",
            f"chi2/dof of the shared cells {self.chi2.per_dof:.3g}",
        ]
        if self.contradicting or self.enlarged > 1.0:
            lines.append(
                f"{self.contradicting} cells contradict; standard deviations enlarged "
                f"{self.enlarged:.3g} times in shared cells, and to the scatter in these"
            )
        return "\n".join(lines)


def merge(measurements: Sequence[BrdfMeasurement], *, robust: bool = False) -> Merged:
    """One measurement of several of one specimen; their order does not matter.

    Args:
        measurements: two or more, with standard deviations. Channels that differ become XYZ.
        robust: enlarge the standard deviation of cells that contradict, in place of refusing them,
            to what makes χ²/dof 1 (Birge's ratio).

    Raises:
        InputError: fewer than two, one without standard deviations, another white or observer, or
            readings that contradict each other beyond them.
    """
    if len(measurements) < 2:
        raise InputError("merge: two measurements or more were wanted")
    for number, m in enumerate(measurements, 1):
        if m.std is None:
            raise InputError(
                f"merge: measurement {number} ({m.metadata.sample or 'unnamed'}) states no "
                "standard deviation, and so has no weight; give it columns std_X, std_Y, std_Z"
            )
    if len({m.azimuth_deg is None for m in measurements}) > 1:
        raise InputError("merge: some have a sample azimuth and some have none; give it to all")
    stack = _Stack.of(measurements)
    scales = _scales(stack, [m.metadata.common for m in measurements])
    values, weight = stack.rescaled(scales.errors)
    mean, std = stack.mean(values, weight), stack.total(weight) ** -0.5
    consistency = _consistency(stack, values, mean, weight)
    if consistency.found and not robust:
        raise InputError(_contradiction(stack, values, consistency))
    enlarged = max(1.0, consistency.overall.birge) if robust else 1.0
    several = stack.several
    std = np.where(several[:, None], std * enlarged, std)
    if robust:
        own = np.maximum(np.sqrt(consistency.per_cell) / enlarged, 1.0)
        std = np.where(consistency.contradicts[:, None], std * own[:, None], std)
    merged = BrdfMeasurement(
        stack.angles[:, 0],
        stack.angles[:, 1],
        stack.angles[:, 2],
        values=mean,
        channels=stack.channels,
        azimuth_deg=None if measurements[0].azimuth_deg is None else stack.angles[:, 3],
        std=std,
        count=stack.total(stack.count[:, None])[:, 0].astype(np.int64),
        metadata=_metadata(measurements, scales, enlarged),
    )
    return Merged(
        merged,
        int(several.sum()),
        tuple(np.exp(scales.errors).tolist()),
        consistency.overall,
        int(consistency.contradicts.sum()),
        enlarged,
    )


@dataclass(frozen=True)
class _Stack:
    """All valid readings `[N]` of all measurements, and which cell `[K]` each is of."""

    channels: tuple[str, ...]
    angles: Floats  # [K, 4]
    cell: NDArray[np.intp]  # [N]
    source: NDArray[np.intp]  # [N]
    values: Floats  # [N, C]
    weight: Floats  # [N, C]
    count: Floats  # [N]

    @classmethod
    def of(cls, measurements: Sequence[BrdfMeasurement]) -> _Stack:
        channels = common_channels(tuple(measurements))
        kept = [m.select(m.valid) for m in measurements]
        angles = np.concatenate([np.round(angles_deg(m), DIGITS) + 0.0 for m in kept])
        cells, cell = np.unique(angles, axis=0, return_inverse=True)
        values, variances = [], []
        for m in kept:
            matrix = matrix_to(m, channels)
            values.append(m.values @ matrix.T)
            variances.append(np.nan_to_num(cast(Floats, m.std)) ** 2 @ (matrix**2).T)
        stacked, variance = np.concatenate(values), np.concatenate(variances)
        floor = (1e-9 * abs(stacked).max(initial=1e-6)) ** 2  # a std of 0 is rounding
        return cls(
            channels,
            cells,
            cell.ravel(),
            np.repeat(np.arange(len(kept)), [len(m) for m in kept]),
            stacked,
            1.0 / np.maximum(variance, floor),
            np.concatenate([np.ones(len(m)) if m.count is None else m.count for m in kept]),
        )

    @property
    def several(self) -> NDArray[np.bool_]:
        """`[K]`: more than one measurement has a reading there."""
        pairs = np.unique(np.stack([self.cell, self.source], axis=1), axis=0)
        return np.bincount(pairs[:, 0], minlength=len(self.angles)) > 1

    def total(self, rows: Floats) -> Floats:
        """`[K, C]` sums over the readings of each cell."""
        cells = len(self.angles)
        return np.stack([np.bincount(self.cell, column, cells) for column in rows.T], axis=1)

    def rescaled(self, errors: Floats) -> tuple[Floats, Floats]:
        """`[N, C]` values and weights without these errors `[S]` of the scales."""
        factor = np.exp(errors)[self.source, None]
        return self.values / factor, self.weight * factor**2

    def mean(self, values: Floats, weight: Floats) -> Floats:
        """`[K, C]`; a lone reading is kept to the bit."""
        mean = self.total(values * weight) / self.total(weight)
        alone = np.bincount(self.cell, minlength=len(self.angles))[self.cell] == 1
        mean[self.cell[alone]] = values[alone]
        return mean


@dataclass(frozen=True)
class _Scales:
    errors: Floats  # [S] e_s, natural logarithms of factors
    remaining: float  # relative standard uncertainty of the result's scale
    share: Floats  # [S] of each measurement's weight in the result


def _scales(stack: _Stack, common: list[CommonErrors]) -> _Scales:
    """Gauss–Newton on z; the cells' means are eliminated in each round."""
    effect, sources = _effects(common), len(common)
    z = np.zeros(effect.shape[1])
    for _ in range(_ROUNDS):
        values, weight = stack.rescaled(effect @ z)
        mean = stack.total(values * weight) / stack.total(weight)
        pull = (weight * mean[stack.cell] * (values - mean[stack.cell])).sum(axis=1)
        right = np.bincount(stack.source, pull, sources)
        normal = effect.T @ _information(stack, mean, weight, sources) @ effect
        system = np.eye(len(z)) + normal
        before, z = z, np.linalg.solve(system, effect.T @ right + normal @ z)
        if abs(z - before).max(initial=0.0) < _SETTLED:
            break
    share = np.bincount(stack.source, (weight * mean[stack.cell] ** 2).sum(axis=1), sources)
    mixed = effect.T @ (share / share.sum())
    remaining = float(np.sqrt(mixed @ np.linalg.solve(system, mixed)))
    return _Scales(effect @ z, remaining, share / share.sum())


def _effects(common: list[CommonErrors]) -> Floats:
    """`[S, G]`: what one standard deviation of each independent scale does to each measurement."""
    references = [one.scale_reference or f"\0{number}" for number, one in enumerate(common)]
    names = sorted(set(references))
    effect = np.zeros((len(common), len(names) + len(common)))
    for row, (reference, one) in enumerate(zip(references, common, strict=True)):
        effect[row, names.index(reference)] = one.scale_std
        effect[row, len(names) + row] = one.white_mean_std
    return effect


def _information(stack: _Stack, mean: Floats, weight: Floats, sources: int) -> Floats:
    """`[S, S]`: how well the shared cells know the scales against each other; 0 on their sum."""
    cells = len(stack.angles)
    total = np.zeros((sources, sources))
    for channel in range(len(stack.channels)):
        each = np.bincount(
            stack.cell * sources + stack.source, weight[:, channel], cells * sources
        ).reshape(cells, sources)
        square = mean[:, channel] ** 2
        total += np.diag(square @ each)
        total -= each.T @ (each * (square / each.sum(axis=1))[:, None])
    return total


@dataclass(frozen=True)
class _Consistency:
    per_cell: Floats  # [K] χ²/dof of the channel where it is largest; 0 for a lone reading
    contradicts: NDArray[np.bool_]  # [K]
    overall: Chi2

    @property
    def found(self) -> bool:
        scattered = self.overall.p < _REFUSED_P and self.overall.birge > MAX_BIRGE
        return bool(self.contradicts.any()) or scattered


def _consistency(stack: _Stack, values: Floats, mean: Floats, weight: Floats) -> _Consistency:
    from scipy.special import chdtrc

    chi2 = stack.total((values - mean[stack.cell]) ** 2 * weight)
    dof = np.bincount(stack.cell, minlength=len(stack.angles)) - 1
    largest = chi2.max(axis=1)
    chance = chdtrc(np.maximum(dof, 1), largest)
    per_channel = [Chi2(float(column[dof > 0].sum()), int(dof.sum())) for column in chi2.T]
    return _Consistency(
        np.where(dof > 0, largest / np.maximum(dof, 1), 0.0),
        (dof > 0) & (chance < chdtrc(1, CONTRADICTION_STD**2)),
        max(per_channel, key=lambda one: one.value),
    )


def _contradiction(stack: _Stack, values: Floats, found: _Consistency) -> str:
    worst = np.argsort(-found.per_cell)[:_WORST]
    named = []
    for cell in worst[found.per_cell[worst] > 0]:
        here = stack.cell == cell
        channel = min(1, len(stack.channels) - 1)
        angles = ", ".join(f"{angle:g}" for angle in stack.angles[cell, :3])
        read = " and ".join(f"{value:.5g}" for value in values[here, channel])
        named.append(f"({angles} deg) {stack.channels[channel]} = {read}")
    return (
        f"merge: {int(found.contradicts.sum())} cells contradict beyond their uncertainty, and all "
        f"differ by {found.overall.birge:.3g} times it; worst: {'; '.join(named)}; see `raden info "
        "A B` for where they differ, leave one out, or enlarge the uncertainties by --robust"
    )


def _metadata(
    measurements: Sequence[BrdfMeasurement], scales: _Scales, enlarged: float
) -> Metadata:
    """The same in any order; what was merged stands in the entries."""
    metas = [m.metadata for m in measurements]
    joined = lambda name: "; ".join(sorted({getattr(meta, name) for meta in metas} - {""}))  # noqa: E731
    references = {meta.common.scale_reference for meta in metas}
    zeros = np.array([meta.common.zero_std_deg for meta in metas])
    a, r, t = (float(f"{std:.9g}") for std in np.sqrt(scales.share**2 @ zeros**2))
    whites = {meta.common.white_deg for meta in metas}
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
        common=CommonErrors(
            float(f"{scales.remaining:.9g}"),  # the same in any order, beyond rounding
            references.pop() if len(references) == 1 else "",
            zero_std_deg=(a, r, t),
            white_deg=whites.pop() if len(whites) == 1 else None,
        ),
        other=tuple(numbered),
        notes=note if enlarged > 1.0 else (),
    )
