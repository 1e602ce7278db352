"""The built-in samples: simulated shells from film optics.

Each is *a plausible nacre*, not a measured shell. In particular no measured tablet thickness of
yakogai (*Turbo marmoratus*) or of Japanese awabi (*Haliotis discus*) was found: their colours are
those that raden is made for, not data. docs/shells.md compares them with published descriptions.

Left out: diffraction at the steps where oblique layers come out of the surface (Liu, Shigley &
Hurwit, Opt. Express 4, 177 (1999), 10.1364/OE.4.000177), the coat's own mirror image, the layers'
texture, fluorescence, light that travels sideways in the shell.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from raden_torch.arrays import Floats
from raden_torch.errors import InputError
from raden_torch.measurement.readings import FACTOR_PER_SR, XYZ, BrdfMeasurement, Metadata
from raden_torch.optics.lacquered import Facets
from raden_torch.optics.nacre import Stack
from raden_torch.optics.shell import BANDS_NM, Specimen, brdf_per_sr

INSTRUMENT = "simulated: film optics (transfer matrix)"
MAX_ANGLE_DEG = 70.0
NOISE_FLOOR = 1.0
"""The noise has at least the size that it has on a reflectance factor of 1."""

TABLET_SCALES = (0.7, 1.4)

_MIN_STEP_DEG = 1.0
_ROWS_AT_ONCE = 20_000


def _slope(angle_deg: float) -> float:
    return math.tan(math.radians(angle_deg))


SPECIMENS: dict[str, Specimen] = {
    # Tablets [A]: in 440…520 nm, where the third order travels from pink to green. Planes [A]: at
    # 7.5° to the surface, which the coat's refraction brings out near 12°; a sheen and a haze.
    "yakogai": Specimen(
        Stack(tablet_nm=520, tablet_spread=0.035),
        steep_tablet_nm=440,
        facets=(
            Facets(0.40, _slope(7.5), 0.036, 0.044),
            Facets(0.48, _slope(7.5), 0.13, 0.12),
            Facets(0.12, 0.0, 0.28, 0.28),
        ),
        source="tablets 440 to 520 nm, an assumption; no measured thickness of this shell is known",
        body_albedo=0.45,
    ),
    # Tablets [R]: 0.25…0.39 µm for Haliotis iris and fulgens (Am. Mineral., "Mineralogical
    # microstructure of shells, part 2"). Planes [A].
    "abalone": Specimen(
        Stack(tablet_nm=360),
        steep_tablet_nm=300,
        facets=(
            Facets(0.40, _slope(9.0), 0.045, 0.055),
            Facets(0.42, _slope(9.0), 0.14, 0.12),
            Facets(0.18, 0.0, 0.28, 0.28),
        ),
        source="tablets 300 to 360 nm, within the 250 to 390 nm reported for Haliotis iris",
        body_albedo=0.30,
    ),
    # Tablets [R]: means of 0.33…0.44 µm and a spread of 3.5 % at strong lustre to 9 % (pearl
    # trade reports), taken as ± 2 σ: here 6 % [A]. Planes [A]: a slice along the layers, one peak.
    "akoya": Specimen(
        Stack(tablet_nm=368, tablet_spread=0.03),
        steep_tablet_nm=345,
        facets=(
            Facets(0.45, 0.0, 0.040, 0.045),
            Facets(0.35, 0.0, 0.11, 0.11),
            Facets(0.20, 0.0, 0.26, 0.26),
        ),
        source="tablets 345 to 368 nm, within the 330 to 440 nm reported for Akoya pearls",
        body_albedo=0.60,
    ),
    # Tablets [A]: none known of Haliotis discus. 0.35…0.52 µm is reported for the thicker-layered
    # abalones, Haliotis laevigata and rufescens [R] (as above). In 440…360 nm the third order goes
    # from green through blue to violet and the second enters at pink: the blue, green and pink of
    # the thin sheets that are sold for lacquer. Planes [A].
    "awabi": Specimen(
        Stack(tablet_nm=440, tablet_spread=0.03),
        steep_tablet_nm=360,
        facets=(
            Facets(0.45, _slope(8.0), 0.050, 0.060),
            Facets(0.40, _slope(8.0), 0.14, 0.14),
            Facets(0.15, 0.0, 0.28, 0.28),
        ),
        source="tablets 360 to 440 nm, within the 350 to 520 nm reported for other abalones; no "
        "measured thickness of Haliotis discus is known",
        body_albedo=0.35,
    ),
    # Mexican shell, "mekishiko-gai" or peacock abalone: taken to be Haliotis fulgens [A]. Tablets
    # [R]: 0.25…0.39 µm (as above). Planes [A]: strongly folded. Body [A]: dark.
    "mexican": Specimen(
        Stack(tablet_nm=300, tablet_spread=0.03),
        steep_tablet_nm=255,
        facets=(
            Facets(0.45, _slope(10.0), 0.050, 0.060),
            Facets(0.40, _slope(10.0), 0.14, 0.14),
            Facets(0.15, 0.0, 0.28, 0.28),
        ),
        source="tablets 255 to 300 nm, within the 250 to 390 nm reported for Haliotis fulgens",
        body_albedo=0.20,
    ),
}


def simulate_specimen(
    name: str = "yakogai",
    *,
    noise: float = 0.0,
    seed: int = 0,
    step_deg: float = 5.0,
    geometries_deg: ArrayLike | None = None,
    spectral: bool = False,
    tablet_scale: float = 1.0,
    azimuth_deg: Sequence[float] = (),
) -> BrdfMeasurement:
    """Measure a simulated shell.

    The shell is the same in every call: `seed` draws the noise alone.

    Args:
        name: "yakogai" (great green turban), "abalone" (pāua), "akoya" (pearl oyster), "awabi"
            (Japanese abalone) or "mexican" (Mexican abalone).
        noise: relative standard deviation of every value, 0…1; values below a reflectance factor
            of 1 get the noise of 1. Where it is not 0 the measurement carries `std`.
        seed: whole number ≥ 0.
        step_deg: of the grid incidence 0…70, receiving and tilt −70…70 degrees; 1…70, a whole
            number of steps in 70. 5 gives 15 x 29 x 29 readings.
        geometries_deg: `[M, 3]` incidence, receiving and tilt in degrees, in place of the grid.
        spectral: keep the bands 380nm, 385nm, … 780nm in place of X, Y, Z.
        tablet_scale: the tablets' thickness over the specimen's own, 0.7…1.4: another place of the
            same shell, whose colours are shifted (`artwork.cutting` has maps of such places).
        azimuth_deg: turns of the sample in its own plane, counter-clockwise seen from above; every
            geometry is read at each. Without, it is read at 0, and the azimuth is not said.

    Returns:
        Reflectance factors, the perfect reflecting diffuser = 100; XYZ for D65 and the CIE 1931 2°
        observer. Labelled as simulated in its metadata.

    Raises:
        InputError: an unknown name, or an argument out of its range.

    Examples:
        >>> import raden_torch as rt
        >>> rt.simulate_specimen("yakogai", step_deg=35, noise=0.002)
        BrdfMeasurement(simulated 'yakogai', 75 readings, 75 valid, channels X, Y, Z)
    """
    if name not in tuple(SPECIMENS):
        raise InputError(f"specimen: expected one of {', '.join(SPECIMENS)}, got {name!r}")
    noise = _number(noise, "noise", 0.0, 1.0)
    if isinstance(seed, bool) or not isinstance(seed, (int, np.integer)) or seed < 0:
        raise InputError(f"seed: expected a whole number of at least 0, got {seed!r}")
    tablet_scale = _number(tablet_scale, "tablet_scale", *TABLET_SCALES)
    shell = rescaled(SPECIMENS[name], tablet_scale)
    angles = _grid(step_deg) if geometries_deg is None else _scattered(geometries_deg)
    azimuth = None
    if len(azimuth_deg):
        turns = np.asarray([_number(x, "azimuth_deg", -360.0, 360.0) for x in azimuth_deg])
        azimuth = np.repeat(turns, len(angles))
        angles = np.tile(angles, (len(turns), 1))
    values = reflectance_factors(shell, angles, spectral=spectral, azimuth_deg=azimuth)
    std = noise * np.maximum(values, NOISE_FLOOR) if noise else None
    if std is not None:
        values = values + std * np.random.default_rng(seed).standard_normal(values.shape)
    incidence, receiving, tilt = angles.T
    return BrdfMeasurement(
        incidence,
        receiving,
        tilt,
        values=values,
        channels=_band_names() if spectral else XYZ,
        azimuth_deg=azimuth,
        std=std,
        metadata=_metadata(name, noise, seed, tablet_scale),
    )


def reflectance_factors(
    shell: Specimen,
    angles_deg: Floats,
    *,
    spectral: bool = False,
    azimuth_deg: Floats | None = None,
) -> Floats:
    """`[M, channels]` of a shell, the perfect reflecting diffuser = 100: X, Y, Z or `BANDS_NM`.

    Args:
        angles_deg: `[M, 3]` incidence, receiving and tilt.
        azimuth_deg: `[M]`, by which the sample is turned; 0 where None.
    """
    bands_to_values = np.eye(len(BANDS_NM)) if spectral else bands_to_xyz()
    values = np.empty((len(angles_deg), bands_to_values.shape[1]))
    for start in range(0, len(angles_deg), _ROWS_AT_ONCE):
        rows = slice(start, start + _ROWS_AT_ONCE)
        light, view = directions(np.radians(angles_deg[rows]))
        if azimuth_deg is not None:
            light, view = (turned(x, -np.radians(azimuth_deg[rows])) for x in (light, view))
        brdf = brdf_per_sr(shell, light, view)
        values[rows] = FACTOR_PER_SR * brdf @ bands_to_values
    return values


def directions(angles: Floats) -> tuple[Floats, Floats]:
    """Light and view `[M, 3]` of incidence, receiving and tilt `[M, 3]` in radians.

    In the sample's frame: z is the surface normal, x lies in the plane of light and view and points
    away from the light, and the sample tilts about x. The inverse of `geometry.raden_angles`, for
    NumPy.
    """
    a, r, t = np.moveaxis(angles, -1, 0)
    light = np.stack([-np.sin(a), -np.cos(a) * np.sin(t), np.cos(a) * np.cos(t)], axis=-1)
    view = np.stack([np.sin(r), -np.cos(r) * np.sin(t), np.cos(r) * np.cos(t)], axis=-1)
    return light, view


def turned(vectors: Floats, angle: Floats) -> Floats:
    """`[M, 3]`, each turned about z by its angle `[M]` in radians, counter-clockwise from above."""
    x, y, z = np.moveaxis(vectors, -1, 0)
    c, s = np.cos(angle), np.sin(angle)
    return np.stack([c * x - s * y, s * x + c * y, z], axis=-1)


@cache
def bands_to_xyz() -> Floats:
    """`[bands, 3]`: the XYZ of one unit in each band, a table: no colour-science is needed."""
    table = Path(__file__).with_name("bands_to_xyz.csv")
    return np.loadtxt(table, delimiter=",", skiprows=3)[:, 1:]


def _band_names() -> tuple[str, ...]:
    return tuple(f"{band:g}nm" for band in BANDS_NM)


def rescaled(shell: Specimen, scale: float) -> Specimen:
    """The same shell where its tablets are thicker or thinner; the organic sheets stay."""
    stack = replace(shell.stack, tablet_nm=scale * shell.stack.tablet_nm)
    return replace(shell, stack=stack, steep_tablet_nm=scale * shell.steep_tablet_nm)


def _metadata(name: str, noise: float, seed: int, tablet_scale: float) -> Metadata:
    notes = (("noise", f"{noise:g} relative, seed {seed}"),) if noise else ()
    if tablet_scale != 1:
        notes = (("tablets", f"{tablet_scale:g} times as thick"), *notes)
    return Metadata(
        sample=name,
        instrument=INSTRUMENT,
        simulated=True,
        other=(("numbers", SPECIMENS[name].source), *notes),
        notes=("a plausible nacre, not a measured shell",),
    )


def _number(value: float, name: str, low: float, high: float) -> float:
    real = isinstance(value, (int, float, np.integer, np.floating)) and not isinstance(value, bool)
    number = float(value) if real else math.nan
    if not low <= number <= high:
        raise InputError(f"{name}: expected a number in {low:g}…{high:g}, got {value!r}")
    return number


def _grid(step_deg: float) -> Floats:
    step = _number(step_deg, "step_deg", _MIN_STEP_DEG, MAX_ANGLE_DEG)
    steps = round(MAX_ANGLE_DEG / step)
    if not math.isclose(steps * step, MAX_ANGLE_DEG):
        raise InputError(
            f"step_deg: expected a whole number of steps to {MAX_ANGLE_DEG:g}, got {step:g}"
        )
    axis = np.linspace(-MAX_ANGLE_DEG, MAX_ANGLE_DEG, 2 * steps + 1)
    grid = np.meshgrid(axis[steps:], axis, axis, indexing="ij")
    return np.stack(grid, axis=-1).reshape(-1, 3)


def _scattered(geometries_deg: ArrayLike) -> Floats:
    try:
        angles = np.asarray(geometries_deg, np.float64)
    except (TypeError, ValueError):
        raise InputError(
            "geometries_deg: expected numbers [M, 3] in degrees, got values that are not numbers"
        ) from None
    if angles.ndim != 2 or angles.shape[1] != 3 or not len(angles):
        raise InputError(f"geometries_deg: expected shape [M, 3], got {list(angles.shape)}")
    limits = np.array([[0.0, 90.0], [-90.0, 90.0], [-90.0, 90.0]])
    wrong = ~((angles >= limits[:, 0]) & (angles <= limits[:, 1])).all(axis=1)
    if wrong.any():
        row = int(np.argmax(wrong))
        raise InputError(
            f"geometries_deg row {row + 1}: expected incidence 0…90, receiving and tilt -90…90 "
            f"degrees, got {angles[row].tolist()}"
        )
    return angles
