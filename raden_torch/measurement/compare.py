"""Do two measurements of one specimen agree within their stated uncertainties?

The differences d of the readings at common geometries have the covariance

    C = diag(v) + Σ_k u_k u_k′,

v from each reading's own errors, u_k from what one standard deviation of each shared error does to
all readings: the ratio of the two scales, the zeros of each one's axes. χ² = d′ C⁻¹ d has as many
degrees of freedom as there are differences. The channels' errors are not independent of each other
(a lamp's or a camera's noise is in all of them), so that each has its χ²; together they are judged
by the smallest p, times their number (Bonferroni).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

from raden_torch.arrays import Floats, Ints
from raden_torch.errors import InputError
from raden_torch.measurement.consistency import MAX_BIRGE, SIGNIFICANT, Chi2, Covariance
from raden_torch.measurement.error_parts import ErrorParts, error_parts
from raden_torch.measurement.matching import interpolated_at, same_geometries
from raden_torch.measurement.readings import XYZ, BrdfMeasurement
from raden_torch.reflectance.regions import regions

MAX_SCALE_STD = 3.0
"""How many standard deviations one factor between two measurements may be from 1."""

_ENOUGH_SHARED = 0.5  # of the smaller one's readings: fewer, and the denser one is interpolated


@dataclass(frozen=True)
class RegionComparison:
    """One region, in the channel of `Comparison.judged`.

    Attributes:
        name: of `regions.REGIONS`, or "all".
        count: geometries compared.
        difference: median of |second − first| over their mean.
        bias: median of second − first over their mean.
        stated: median of the standard deviation of the difference over the mean, shared errors
            included.
        chi2: of the differences, shared errors as such.
    """

    name: str
    count: int
    difference: float
    bias: float
    stated: float
    chi2: Chi2


@dataclass(frozen=True)
class ScaleComparison:
    """One factor between two measurements, in the channel of `Comparison.judged`.

    Attributes:
        factor: second over first, by least squares with all stated errors but the scales'.
        std: of the factor, from the readings.
        stated_std: of the ratio of the two scales, as stated.
        chi2: of all differences with the factor left free.
    """

    factor: float
    std: float
    stated_std: float
    chi2: Chi2

    @property
    def deviations(self) -> float:
        """How many standard deviations the factor is from 1."""
        total = float(np.hypot(self.std, self.stated_std))
        return abs(self.factor - 1.0) / total if total else 0.0


@dataclass(frozen=True)
class Comparison:
    """Two measurements, second against first; `str` gives it as text.

    Attributes:
        names: of the samples.
        simulated: of each, whether it is.
        std_stated: of each, whether it states standard deviations.
        channels: compared; `judged` is the one of the regions and the scale: Y, G or the middle.
        interpolated: True where the denser one was interpolated: its errors are then shared by
            neighbours, and p-values are approximate.
        without_partner: readings of the first and of the second that were not compared.
        regions: those that have readings, then "all".
        by_channel: χ² of all differences in each channel.
        scale: one factor between the two.
        angles_deg: `[N, 3]` of the geometries compared.
        deviations: `[N]` (second − first) / std in the channel `judged`.
        region_masks: `[N]` of those geometries, by the regions' names.
    """

    names: tuple[str, str]
    simulated: tuple[bool, bool]
    std_stated: tuple[bool, bool]
    channels: tuple[str, ...]
    judged: str
    interpolated: bool
    without_partner: tuple[int, int]
    regions: tuple[RegionComparison, ...]
    by_channel: tuple[Chi2, ...]
    scale: ScaleComparison
    angles_deg: Floats
    deviations: Floats
    region_masks: dict[str, NDArray[np.bool_]]

    @property
    def p(self) -> float:
        """Of all channels together: the smallest, times their number."""
        return min(1.0, len(self.by_channel) * min(chi2.p for chi2 in self.by_channel))

    @property
    def birge(self) -> float:
        """The largest of the channels': how many times the stated uncertainties they differ."""
        return max(chi2.birge for chi2 in self.by_channel)

    @property
    def agrees(self) -> bool:
        """By chance as likely as 1 %; or else within `consistency.MAX_BIRGE` times the stated
        uncertainties, and the scales within 3 of theirs."""
        close = self.birge <= MAX_BIRGE and self.scale.deviations <= MAX_SCALE_STD
        return self.p >= SIGNIFICANT or close

    def __str__(self) -> str:
        from raden_torch.measurement.comparison_text import in_words

        return in_words(self)


def compare(first: BrdfMeasurement, second: BrdfMeasurement) -> Comparison:
    """Compare two measurements where both have readings.

    At the same geometries, where at least half of the smaller one's readings have a partner;
    otherwise the denser one is interpolated to the other's geometries (`matching`). Channels that
    differ are converted to XYZ.

    Raises:
        InputError: no common geometries, another white or observer, or channels without a colour.
    """
    pair = (first, second)
    shared = len(same_geometries(first, second).first)
    few = shared < _ENOUGH_SHARED * min(int(m.valid.sum()) for m in pair)
    common = _interpolated(pair) if few else _at_same(pair)
    if not len(common.rows):
        raise InputError(
            "measurements: expected geometries in common, or close enough to interpolate, got "
            "none; measure some cells of one in the other, too"
        )
    return _compared(pair, common)


def compare_shared(first: BrdfMeasurement, second: BrdfMeasurement) -> Comparison | None:
    """As `compare`, at the same geometries alone; None where there are none."""
    common = _at_same((first, second))
    return _compared((first, second), common) if len(common.rows) else None


@dataclass(frozen=True)
class _Common:
    """Both measurements at N common geometries: `rows` of the valid readings of `of`."""

    of: BrdfMeasurement
    rows: Ints
    a: ErrorParts
    b: ErrorParts
    left: tuple[int, int]
    interpolated: bool


def _at_same(pair: tuple[BrdfMeasurement, BrdfMeasurement]) -> _Common:
    matched, channels = same_geometries(*pair), common_channels(pair)
    rows = (matched.first, matched.second)
    a, b = (error_parts(m, channels).at(at) for m, at in zip(pair, rows, strict=True))
    left = (int(pair[0].valid.sum()) - len(rows[0]), int(pair[1].valid.sum()) - len(rows[1]))
    return _Common(pair[0], rows[0], a, b, left, False)


def _interpolated(pair: tuple[BrdfMeasurement, BrdfMeasurement]) -> _Common:
    """The denser one at the other's geometries."""
    first, second = pair
    channels = common_channels(pair)
    swapped = first.valid.sum() > second.valid.sum()
    coarse, dense = (second, first) if swapped else (first, second)
    rows, found = interpolated_at(coarse, dense, error_parts(dense, channels))
    own = error_parts(coarse, channels).at(rows)
    alone = int(coarse.valid.sum()) - len(rows)
    if swapped:
        return _Common(coarse, rows, found, own, (0, alone), True)
    return _Common(coarse, rows, own, found, (alone, 0), True)


def _compared(pair: tuple[BrdfMeasurement, BrdfMeasurement], common: _Common) -> Comparison:
    first, second = pair
    channels = common_channels(pair)
    at = common.of.select(np.flatnonzero(common.of.valid)[common.rows])
    scale_std = _scale_std(pair)
    pairs = [_Pair.of(common.a, common.b, channel) for channel in range(len(channels))]
    judged = channels.index("Y") if "Y" in channels else len(channels) // 2
    masks = {name: mask for name, mask in regions(at.angles_deg).items() if mask.any()}
    masks["all"] = np.ones(len(at), bool)
    return Comparison(
        names=(first.metadata.sample, second.metadata.sample),
        simulated=(first.metadata.simulated, second.metadata.simulated),
        std_stated=(first.std is not None, second.std is not None),
        channels=channels,
        judged=channels[judged],
        interpolated=common.interpolated,
        without_partner=common.left,
        regions=tuple(
            _region(name, pairs[judged].within(mask), scale_std) for name, mask in masks.items()
        ),
        by_channel=tuple(one.covariance(scale_std).chi2(one.difference) for one in pairs),
        scale=_scale(pairs[judged], scale_std),
        angles_deg=at.angles_deg,
        deviations=pairs[judged].difference / pairs[judged].covariance(scale_std).std,
        region_masks=masks,
    )


def common_channels(measurements: tuple[BrdfMeasurement, ...]) -> tuple[str, ...]:
    """The channels they all have, else XYZ.

    Raises:
        InputError: they are under different whites or for different observers.
    """
    for what in ("white", "observer"):
        values = list(dict.fromkeys(getattr(m.metadata, what) for m in measurements))
        if len(values) > 1:
            raise InputError(
                f"measurements: {what}: expected the same in both, got {' and '.join(values)}"
            )
    same = len({m.channels for m in measurements}) == 1
    return measurements[0].channels if same else XYZ


def _scale_std(pair: tuple[BrdfMeasurement, BrdfMeasurement]) -> float:
    """Of the ratio of their scales; where both name the same reference, its error cancels."""
    a, b = (m.metadata.systematic for m in pair)
    own = math.hypot(a.white_mean_std, b.white_mean_std)
    if a.scale_reference and a.scale_reference == b.scale_reference:
        return own
    return math.hypot(own, a.scale_std, b.scale_std)


@dataclass(frozen=True)
class _Pair:
    """Both measurements at N common geometries, in one channel; `[N]` each."""

    a: Floats
    b: Floats
    a_variance: Floats
    b_variance: Floats
    zeros: Floats  # [N, 6]

    @classmethod
    def of(cls, a: ErrorParts, b: ErrorParts, channel: int) -> _Pair:
        return cls(
            a.values[:, channel],
            b.values[:, channel],
            a.variance[:, channel],
            b.variance[:, channel],
            np.concatenate([a.zeros[:, channel], b.zeros[:, channel]], axis=1),
        )

    def within(self, mask: NDArray[np.bool_]) -> _Pair:
        return _Pair(*(getattr(self, field.name)[mask] for field in fields(self)))

    @property
    def difference(self) -> Floats:
        return self.b - self.a

    @property
    def mean(self) -> Floats:
        """Weighed by the variances: its noise is then independent of the difference's."""
        share = self.a_variance / (self.a_variance + self.b_variance)
        return self.a * (1 - share) + self.b * share

    def covariance(self, scale_std: float) -> Covariance:
        """Of the difference; `scale_std` of the ratio of the two scales."""
        scale = scale_std * self.mean[:, None]
        return Covariance(
            self.a_variance + self.b_variance, np.concatenate([self.zeros, scale], axis=1)
        )


def _region(name: str, pair: _Pair, scale_std: float) -> RegionComparison:
    mean = np.maximum(abs(pair.mean), 1e-9 * max(float(abs(pair.mean).max()), 1e-9))
    relative = pair.difference / mean
    covariance = pair.covariance(scale_std)
    return RegionComparison(
        name,
        len(mean),
        float(np.median(abs(relative))),
        float(np.median(relative)),
        float(np.median(covariance.std / mean)),
        covariance.chi2(pair.difference),
    )


def _scale(pair: _Pair, stated_std: float) -> ScaleComparison:
    """d = s m + errors by generalised least squares; the factor is 1 + s."""
    covariance, mean = pair.covariance(0.0), pair.mean
    information = float(mean @ covariance.solve(mean))
    excess = float(mean @ covariance.solve(pair.difference)) / information
    left = covariance.chi2(pair.difference - excess * mean)
    return ScaleComparison(
        1.0 + excess, information**-0.5, stated_std, Chi2(left.value, left.dof - 1)
    )
