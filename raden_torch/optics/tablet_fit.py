"""Readings along the mirror ridge → nacre's tablets: thickness, spread, and how sure that is.

A reading i is g_i F + b B: g_i the share of film planes that mirror the light, free for each
reading (so a reading tells by its colour, not by its brightness); F the films' mean reflectance
under the coat; B the body below them, lit and seen through the films, with an albedo that is linear
in the wavelength and the same for all readings. g and b are solved exactly for each thickness and
spread (variable projection: Golub & Pereyra, Inverse Problems 19, R1 (2003)), so two parameters are
left.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares

from raden_torch.arrays import Floats, Ints
from raden_torch.errors import InputError
from raden_torch.measurement.colour_conversion import bands_to_xyz_matrix
from raden_torch.measurement.readings import BrdfMeasurement
from raden_torch.optics import lacquered
from raden_torch.optics.nacre_table import ORGANIC_NM, SPREADS, TABLETS_NM, NacreTable, nacre_table
from raden_torch.optics.shell import BANDS_NM
from raden_torch.optics.specimens import bands_to_xyz, directions

ORGANIC_STD_NM = 5.0
"""Of the organic sheets [M]: colour tells the period, and hardly what of it is sheet."""
ASSUMED_STD = 0.02
"""The relative standard deviation of readings that state none."""
NEARLY_AS_WELL = 9.0
"""Two thicknesses whose chi² (over its degrees of freedom at the best) differ by less are both
possible: three standard deviations."""

_RIDGE_DEG = 3.0  # receiving − incidence on the ridge
_LEAST_INCIDENCES, _LEAST_RANGE_DEG = 5, 25.0
_SEARCH_NM = 3.0
_TABLET_PER_SHEET = 0.91  # nm of tablet that go for one of sheet, on simulated shells
PERIOD_MODEL_STD, SPREAD_MODEL_STD = 0.0051, 0.0055
"""What the estimate is off beyond noise and sheets, relative to the thickness both: that of the
period, and that of the spread, which is a difference of spreads, not a share of it. The optics are
averaged over: by maximum likelihood, times Student's t, from simulated shells whose index of the
sheets, dispersion, loss, number of tablets and spread of the sheets are drawn from their published
ranges (benchmarks/tablets.py, 36 shells of seed 2026)."""
_MOST_LEFT = 0.5  # of the colour change, not explained, in a nacre; 1.3 and more in what is none
_LEAST_CHANGE = 0.01  # relative change of colour along the ridge
_TWO_SIGMA = 1.96


@dataclass(frozen=True)
class TabletEstimate:
    """What the colours along the mirror ridge say of nacre's tablets.

    Attributes:
        tablet_nm: mean thickness of the tablets, the organic sheets taken as 25 nm.
        tablet_std_nm: its standard uncertainty, with that of the sheets (5 nm).
        period_nm, period_std_nm: a tablet and a sheet, which the colours tell better.
        spread, spread_std: the tablets' relative standard deviation within a stack.
        others_nm: thicknesses of other orders that fit nearly as well.
        left: share of the colour change along the ridge that the films do not explain.
        reduced_chi_squared: of the fit; 1 where the readings' `std` is what is left.
        readings: how many were used.
        tilt_deg: their tilt, of both signs: where the ridge is brightest.
        simulated: as the measurement says.
    """

    tablet_nm: float
    tablet_std_nm: float
    period_nm: float
    period_std_nm: float
    spread: float
    spread_std: float
    others_nm: tuple[float, ...]
    left: float
    reduced_chi_squared: float
    readings: int
    tilt_deg: float
    simulated: bool = False

    @property
    def tablet_interval_nm(self) -> tuple[float, float]:
        """The 95 % interval."""
        half = _TWO_SIGMA * self.tablet_std_nm
        return self.tablet_nm - half, self.tablet_nm + half

    @property
    def spread_interval(self) -> tuple[float, float]:
        """The 95 % interval, of a relative error: by its logarithm."""
        times = float(np.exp(_TWO_SIGMA * self.spread_std / self.spread))
        return self.spread / times, self.spread * times

    def __str__(self) -> str:
        low, high = self.tablet_interval_nm
        s_low, s_high = self.spread_interval
        lines = [
            f"tablets {self.tablet_nm:.0f} nm thick, 95 % in {low:.0f}…{high:.0f} nm "
            f"(organic sheets taken as {ORGANIC_NM:g} ± {ORGANIC_STD_NM:g} nm)",
            f"period  {self.period_nm:.1f} ± {_TWO_SIGMA * self.period_std_nm:.1f} nm",
            f"spread  {100 * self.spread:.1f} % of the thickness, "
            f"95 % in {100 * s_low:.1f}…{100 * s_high:.1f} %",
            f"from    {self.readings} readings on the mirror ridge at tilt ± {self.tilt_deg:g}°; "
            f"films explain {100 * (1 - self.left):.0f} % of its colour change"
            + (" (simulated)" if self.simulated else ""),
        ]
        if self.others_nm:
            others = ", ".join(f"{other:.0f}" for other in self.others_nm)
            lines.append(f"order   uncertain: {others} nm fit nearly as well")
        return "\n".join(lines)


@dataclass(frozen=True)
class _Ridge:
    """The readings that are fitted, over their standard deviations, and their geometry."""

    values: Floats  # [M, C]
    std: Floats  # [M, C]
    facet_q_squared: Floats  # [M] on the mirroring planes
    flat_q_squared: Floats  # [M] on planes in the surface
    passed: Floats  # [M] the coat's transmittance, in and out
    wavelength_nm: Floats  # [W]
    to_channels: Floats  # [W, C]


def estimate_tablets(measurement: BrdfMeasurement, *, coat_n: float = 1.53) -> TabletEstimate:
    """Estimate tablet thickness and spread from a measured table.

    Args:
        measurement: X, Y, Z, linear RGB or bands within 380…780 nm; on the ridge (receiving =
            incidence within 3°) at one tilt it needs five incidences over 25°.
        coat_n: index of the clear lacquer over the shell, 1…1.7; 1 for a bare, polished one.

    Raises:
        InputError: too few readings on the ridge; colours that do not change along it; colours that
            nacre does not explain.
    """
    if not 1 <= coat_n <= 1.7:
        raise InputError(f"coat_n: expected an index in 1…1.7, got {coat_n:g}")
    rows, tilt_deg = _brightest_ridge(measurement)
    ridge = _ridge_of(measurement, rows, coat_n)
    change, flat_chi = _without_films(ridge)
    if change < _LEAST_CHANGE:
        raise InputError(
            "analyse: expected colours that change with the incidence, got a relative change of "
            f"{100 * change:.1f} % along the mirror ridge: no interference is seen; not nacre"
        )
    table = nacre_table(coat_n)
    tablets, chi_squared = _search(ridge, table)
    fits = [_refined(ridge, table, *start) for start in _minima(tablets, chi_squared)]
    fits.sort(key=lambda fit: fit[1])
    (tablet, log_spread), chi, covariance = fits[0]
    left = float(np.sqrt(chi / flat_chi))
    if left > _MOST_LEFT:
        raise InputError(
            "analyse: expected the colours of nacre along the mirror ridge, got colours of which "
            f"its films leave {100 * left:.0f} % unexplained at best ({tablet:.0f} nm); not nacre, "
            "or not with this coat"
        )
    freedom = max(ridge.values.size - len(rows) - 4, 1)
    reduced = chi / freedom
    scaled = max(reduced, 1.0)
    period_std = float(np.hypot(np.sqrt(covariance[0, 0] * scaled), PERIOD_MODEL_STD * tablet))
    sheet = _TABLET_PER_SHEET * ORGANIC_STD_NM
    spread = float(np.exp(log_spread))
    spread_noise = spread * float(np.sqrt(covariance[1, 1] * scaled))
    others = [f[0][0] for f in fits[1:] if (f[1] - chi) / scaled < NEARLY_AS_WELL]
    return TabletEstimate(
        tablet_nm=float(tablet),
        tablet_std_nm=float(np.hypot(period_std, sheet)),
        period_nm=float(tablet + ORGANIC_NM),
        period_std_nm=float(np.hypot(period_std, ORGANIC_STD_NM - sheet)),
        spread=spread,
        spread_std=float(np.hypot(spread_noise, SPREAD_MODEL_STD)),
        others_nm=tuple(float(other) for other in others if abs(other - tablet) > 5),
        left=left,
        reduced_chi_squared=float(reduced),
        readings=len(rows),
        tilt_deg=tilt_deg,
        simulated=measurement.metadata.simulated,
    )


def _brightest_ridge(measurement: BrdfMeasurement) -> tuple[Ints, float]:
    """Rows at receiving = incidence and one tilt, of either sign, and that tilt."""
    incidence, receiving, tilt = measurement.angles_deg.T[:3]
    on_ridge = measurement.valid & (abs(receiving - incidence) <= _RIDGE_DEG)
    tilts = np.round(abs(tilt))
    best: tuple[float, Ints, float] | None = None
    for value in np.unique(tilts[on_ridge]):
        rows = np.flatnonzero(on_ridge & (tilts == value) & (incidence <= 75))
        nodes = np.unique(np.round(incidence[rows]))
        if len(nodes) < _LEAST_INCIDENCES or np.ptp(nodes) < _LEAST_RANGE_DEG:
            continue
        brightness = float(np.median(measurement.values[rows].mean(axis=1)))
        if best is None or brightness > best[0]:
            best = brightness, rows, float(value)
    if best is None:
        raise InputError(
            f"analyse: expected readings at receiving = incidence (within {_RIDGE_DEG:g}°) and one "
            f"tilt at {_LEAST_INCIDENCES} incidences over {_LEAST_RANGE_DEG:g}° or more, "
            "got fewer at every tilt"
        )
    return best[1], best[2]


def _ridge_of(measurement: BrdfMeasurement, rows: Ints, coat_n: float) -> _Ridge:
    if measurement.is_spectral:
        bands = measurement.wavelengths_nm
        used = np.flatnonzero((bands >= 380) & (bands <= 780))
        if len(used) < 5:
            raise InputError(f"analyse: expected five bands or more in 380…780 nm, got {len(used)}")
        wavelength, to_channels = bands[used], np.eye(len(used))
    else:
        measurement = measurement.as_xyz()
        used, wavelength = np.arange(3), BANDS_NM
        to_channels = _to_xyz(measurement)
    values = measurement.values[np.ix_(rows, used)]
    floor = 0.1 * ASSUMED_STD * np.median(abs(values))
    std = ASSUMED_STD * abs(values)
    if measurement.std is not None:
        std = measurement.std[np.ix_(rows, used)]
    angles = np.radians(measurement.angles_deg[rows, :3])
    light, view = directions(angles)
    cosines = np.clip([light[:, 2], view[:, 2]], 1e-3, 1)
    light, view = lacquered.refracted(light, coat_n), lacquered.refracted(view, coat_n)
    passed = lacquered.coat_transmittance(cosines[0], light[:, 2], coat_n)
    passed = passed * lacquered.coat_transmittance(cosines[1], view[:, 2], coat_n)
    return _Ridge(
        values,
        np.maximum(np.nan_to_num(std, nan=np.inf), floor),
        np.clip(coat_n**2 * (1 - np.sum(light * view, axis=1)) / 2, 0, 1),
        1 - np.mean(cosines**2, axis=0),
        passed,
        wavelength,
        to_channels,
    )


def _to_xyz(measurement: BrdfMeasurement) -> Floats:
    meta = measurement.metadata
    if (meta.white, meta.observer) == ("D65", "CIE 1931 2 deg"):
        return bands_to_xyz()
    one = np.zeros(1)
    names = tuple(f"{band:g}nm" for band in BANDS_NM)
    bands = BrdfMeasurement(one, one, one, np.zeros((1, len(names))), names, metadata=meta)
    return bands_to_xyz_matrix(bands).T


def _without_films(ridge: _Ridge) -> tuple[float, float]:
    """How far the colour of the readings changes, relatively; and chi² of one colour for all."""
    whitened = ridge.values / ridge.std
    direction = (ridge.values / ridge.values.sum(axis=1, keepdims=True)).mean(axis=0) / ridge.std
    gain = np.sum(whitened * direction, axis=1) / np.sum(direction**2, axis=1)
    off = whitened - gain[:, None] * direction
    change = np.sqrt(np.mean((off * ridge.std) ** 2) / np.mean(ridge.values**2))
    return float(change), float(np.sum(off**2))


def _residuals(ridge: _Ridge, films: Floats, flat: Floats) -> Floats:
    """`[..., M, C]` what is left of the whitened readings when g and b are solved.

    Args:
        films, flat: `[..., M, W]` the films' reflectance on the mirroring planes and on flat ones.
    """
    lit = ((1 - flat) ** 2) * ridge.passed[:, None]
    slope = ridge.wavelength_nm / 550 - 1
    shape = films @ ridge.to_channels / ridge.std
    columns = [ridge.values / ridge.std + 0 * shape]
    columns += [(lit * albedo) @ ridge.to_channels / ridge.std for albedo in (1 + 0 * slope, slope)]
    unit = shape / np.maximum(np.linalg.norm(shape, axis=-1, keepdims=True), 1e-300)
    left, body, warm = (c - np.sum(c * unit, axis=-1, keepdims=True) * unit for c in columns)
    dot = lambda a, b: np.sum(a * b, axis=(-2, -1))  # noqa: E731
    bb, bw, ww = dot(body, body), dot(body, warm), dot(warm, warm)
    by, wy = dot(body, left), dot(warm, left)
    determinant = np.maximum(bb * ww - bw**2, 1e-12 * bb * ww + 1e-300)
    b = ((ww * by - bw * wy) / determinant)[..., None, None]
    w = ((bb * wy - bw * by) / determinant)[..., None, None]
    alone = np.maximum(by / np.maximum(bb, 1e-300), 0)[..., None, None]
    usable = (b > 0) & (abs(w) < 2 * b)  # a body that is not negative at either end
    return left - np.where(usable, b * body + w * warm, alone * body)


def _at(
    ridge: _Ridge, table: NacreTable, tablet_nm: float, spreads: slice = slice(None)
) -> tuple[Floats, Floats]:
    films, flat = (
        table.reflectance(tablet_nm, ridge.wavelength_nm, q_squared, spreads)
        for q_squared in (ridge.facet_q_squared, ridge.flat_q_squared)
    )
    return films, flat


def _search(ridge: _Ridge, table: NacreTable) -> tuple[Floats, Floats]:
    """Thicknesses, and chi² at each of them for every spread of the table `[T, spreads]`."""
    tablets = np.arange(TABLETS_NM[0], TABLETS_NM[-1] + 1e-9, _SEARCH_NM)
    chi = [np.sum(_residuals(ridge, *_at(ridge, table, t)) ** 2, axis=(-2, -1)) for t in tablets]
    return tablets, np.array(chi)


def _minima(tablets: Floats, chi_squared: Floats) -> list[tuple[float, float]]:
    """Thickness and spread where chi² over the thickness is least: the three best valleys."""
    least = chi_squared.min(axis=1)
    inner = np.pad(least, 1, constant_values=np.inf)
    valleys = np.flatnonzero((inner[1:-1] <= inner[:-2]) & (inner[1:-1] <= inner[2:]))
    chosen = valleys[np.argsort(least[valleys])][:3]
    return [(float(tablets[i]), float(SPREADS[chi_squared[i].argmin()])) for i in chosen]


def _refined(
    ridge: _Ridge, table: NacreTable, tablet_nm: float, spread: float
) -> tuple[Floats, float, Floats]:
    """Thickness and log spread; chi²; their covariance where the readings have unit variance."""

    def left(parameters: Floats) -> Floats:
        tablet, log_spread = parameters
        place = np.interp(np.exp(log_spread), SPREADS, np.arange(len(SPREADS)))
        below = int(min(place, len(SPREADS) - 2))
        films, flat = (
            (1 - place + below) * f[0] + (place - below) * f[1]
            for f in _at(ridge, table, float(tablet), slice(below, below + 2))
        )
        return _residuals(ridge, films, flat).ravel()

    low = np.array([TABLETS_NM[0], np.log(SPREADS[0])])
    high = np.array([TABLETS_NM[-1], np.log(SPREADS[-1])])
    start = np.clip([tablet_nm, np.log(spread)], low + 1e-3, high - 1e-3)
    found = least_squares(
        left, start, bounds=(low, high), x_scale=(2.0, 0.1), diff_step=(1e-3, 2e-2)
    )
    covariance = np.linalg.pinv(found.jac.T @ found.jac)
    return found.x, float(2 * found.cost), covariance
