"""`BrdfMeasurement`: one row a reading; a regular grid is a view of it."""

from __future__ import annotations

import hashlib
import os
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from raden_torch.arrays import Floats
from raden_torch.errors import InputError
from raden_torch.measurement.reading_checks import (
    as_column,
    check_angles,
    check_duplicates,
    check_shape,
    check_values,
)
from raden_torch.measurement.reading_grid import ReadingGrid, is_filled
from raden_torch.measurement.systematic_errors import SystematicErrors
from raden_torch.reflectance.grid import DIGITS, AngleGrid

XYZ = ("X", "Y", "Z")
RGB = ("R", "G", "B")
WHITE_LEVEL = 100.0
"""The perfect reflecting diffuser's value, in every geometry and channel."""
FACTOR_PER_SR = WHITE_LEVEL * np.pi
"""The reflectance factor of f_r = 1/sr: R = 100 π f_r."""
LEAST_COVERAGE = 0.05
"""Share of a grid's cells with a reading below which it is too little for a model."""


@dataclass(frozen=True)
class Metadata:
    """What is known of a measurement beside its numbers.

    Attributes:
        sample: the specimen's name.
        instrument: what measured it.
        white: the illuminant of the XYZ values, by its CIE name ("D65").
        observer: the colour-matching functions of the XYZ values.
        simulated: True where the values were computed, not measured.
        systematic: the errors that all readings share; the scale's is not in `std`.
        other: further header entries, kept as they were read.
        notes: free text lines, kept as they were read.
    """

    sample: str = ""
    instrument: str = ""
    white: str = "D65"
    observer: str = "CIE 1931 2 deg"
    simulated: bool = False
    systematic: SystematicErrors = field(default_factory=SystematicErrors)
    other: tuple[tuple[str, str], ...] = ()
    notes: tuple[str, ...] = ()


@dataclass(frozen=True, eq=False)
class BrdfMeasurement:
    """Readings of a reflecting sample: M geometries, C channels.

    Angles are in degrees: incidence 0…90, receiving −90…90 (positive away from the light, so the
    mirror lies at receiving = incidence), tilt −90…90; `azimuth_deg` turns the sample in its own
    plane, against the plane of incidence, from a zero that is the instrument's own. Values are
    reflectance factors: the perfect reflecting diffuser is 100 in every geometry.

    Attributes:
        incidence_deg, receiving_deg, tilt_deg: `[M]`.
        values: `[M, C]`; negative noise is kept; NaN only where `valid` is False.
        channels: ("X", "Y", "Z"), ("R", "G", "B") (linear, sRGB primaries) or one name a spectral
            band, as "550nm".
        azimuth_deg: `[M]` or None.
        std: `[M, C]` standard deviations (k = 1) or None: all that is known but the error of the
            scale, which is common to all readings (`metadata.systematic`).
        count: `[M]` how many raw readings went into a row, or None.
        valid: `[M]`; a row whose value is NaN is never valid.

    Raises:
        InputError: shapes that do not fit, angles out of range or not finite, infinite values, a
            negative standard deviation, or two valid readings of one geometry that disagree.

    Examples:
        A perfect diffuser, read in 15 geometries:

        >>> import numpy as np
        >>> import raden_torch as rt
        >>> incidence, receiving, tilt = np.mgrid[0:71:35, -70:71:35, 0:1].reshape(3, -1)
        >>> rt.BrdfMeasurement(incidence, receiving, tilt, np.full((15, 3), 100.0))
        BrdfMeasurement('', 15 readings, 15 valid, channels X, Y, Z)
    """

    incidence_deg: Floats
    receiving_deg: Floats
    tilt_deg: Floats
    values: Floats
    channels: tuple[str, ...] = XYZ
    azimuth_deg: Floats | None = None
    std: Floats | None = None
    count: NDArray[np.int64] | None = None
    valid: NDArray[np.bool_] = None  # type: ignore[assignment]  # every reading, where not given
    metadata: Metadata = field(default_factory=Metadata)

    def __post_init__(self) -> None:
        set_ = lambda name, value: object.__setattr__(self, name, value)  # noqa: E731
        for name in ("incidence_deg", "receiving_deg", "tilt_deg"):
            set_(name, as_column(getattr(self, name), name))
        set_("channels", tuple(self.channels))
        set_("values", np.asarray(self.values, np.float64))
        n = len(self.incidence_deg)
        if n == 0:
            raise InputError("measurement: expected at least one reading, got none")
        check_shape("values", self.values, (n, len(self.channels)))
        check_shape("receiving_deg", self.receiving_deg, (n,))
        check_shape("tilt_deg", self.tilt_deg, (n,))
        _check_channels(self.channels)
        if self.azimuth_deg is not None:
            set_("azimuth_deg", as_column(self.azimuth_deg, "azimuth_deg"))
            check_shape("azimuth_deg", self.azimuth_deg, (n,))
        if self.std is not None:
            set_("std", np.asarray(self.std, np.float64))
            check_shape("std", self.std, self.values.shape)
        if self.count is not None:
            set_("count", np.asarray(self.count, np.int64))
            check_shape("count", self.count, (n,))
        valid = np.ones(n, bool) if self.valid is None else np.asarray(self.valid, bool)
        check_shape("valid", valid, (n,))
        set_("valid", valid & ~np.isnan(self.values).any(axis=1))
        check_angles(self.angles_deg)
        check_values(self.values, self.std, self.valid, self.channels)
        check_duplicates(self._geometries, self.values, self.std, self.valid, self.channels)

    def __len__(self) -> int:
        return len(self.incidence_deg)

    # -- derived -------------------------------------------------------------------------------

    @property
    def angles_deg(self) -> Floats:
        """`[M, 3]` incidence, receiving and tilt."""
        return np.stack([self.incidence_deg, self.receiving_deg, self.tilt_deg], axis=1)

    @property
    def _geometries(self) -> Floats:
        """`[M, 3]`, or `[M, 4]` with the sample's azimuth, 0…360 degrees."""
        if self.azimuth_deg is None:
            return self.angles_deg
        azimuth = np.round(self.azimuth_deg % 360, DIGITS) % 360
        return np.column_stack([self.angles_deg, azimuth])

    @property
    def is_spectral(self) -> bool:
        return _wavelength(self.channels[0]) is not None

    @property
    def wavelengths_nm(self) -> Floats:
        """`[C]` band centres in nm. Raises InputError where the channels are not spectral."""
        if not self.is_spectral:
            raise InputError(f"measurement: expected spectral bands, got channels {self.channels}")
        return np.array([_wavelength(c) for c in self.channels], np.float64)

    @property
    def sha256(self) -> str:
        """A hash of the readings themselves (angles, values, validity), in their order."""
        digest = hashlib.sha256(",".join(self.channels).encode())
        for column in (self.incidence_deg, self.receiving_deg, self.tilt_deg, self.azimuth_deg):
            digest.update(b"-" if column is None else np.ascontiguousarray(column).tobytes())
        digest.update(np.ascontiguousarray(self.values).tobytes() + self.valid.tobytes())
        return digest.hexdigest()

    @property
    def has_colour(self) -> bool:
        """False where the channels are spectral bands that do not span the visible range."""
        from raden_torch.measurement import colour_conversion

        return colour_conversion.why_no_colour(self) is None

    def as_xyz(self) -> BrdfMeasurement:
        """The same readings as CIE XYZ reflectance factors under `metadata.white`."""
        from raden_torch.measurement import colour_conversion

        return colour_conversion.as_xyz(self)

    def as_rgb(self) -> BrdfMeasurement:
        """The same readings as linear RGB, sRGB primaries, unclipped; see `colour_conversion`."""
        from raden_torch.measurement import colour_conversion

        return colour_conversion.as_rgb(self)

    def select(self, rows: ArrayLike) -> BrdfMeasurement:
        """The readings of a boolean mask or an index array over the M rows."""
        rows = np.asarray(rows)
        pick = lambda column: None if column is None else column[rows]  # noqa: E731
        return replace(
            self,
            incidence_deg=self.incidence_deg[rows],
            receiving_deg=self.receiving_deg[rows],
            tilt_deg=self.tilt_deg[rows],
            values=self.values[rows],
            azimuth_deg=pick(self.azimuth_deg),
            std=pick(self.std),
            count=pick(self.count),
            valid=self.valid[rows],
        )

    @property
    def azimuths(self) -> int:
        """How many sample azimuths the readings were taken at; 1 where none is given."""
        if self.azimuth_deg is None:
            return 1
        return len(np.unique(np.round(self.azimuth_deg % 360, DIGITS) % 360))

    @property
    def is_grid(self) -> bool:
        """True where the readings fill a good part of a regular grid, at one azimuth."""
        return self.azimuths == 1 and is_filled(self.angles_deg)

    def grid(self) -> ReadingGrid:
        """The regular grid of these readings; its axes are the distinct angles that occur.

        Readings of one geometry are averaged, weighted by their count.

        Raises:
            InputError: the readings are scattered (their grid would be almost empty), or they were
                taken at several azimuths.
        """
        if self.azimuths > 1:
            raise InputError(
                f"measurement: expected readings of one sample azimuth, got {self.azimuths}; "
                "select the readings of one azimuth"
            )
        if not self.is_grid:
            shape = AngleGrid.through(self.angles_deg)[0].shape
            raise InputError(
                f"measurement: expected readings on a grid, got {len(self)} scattered ones (a "
                f"grid through all of them has {' x '.join(map(str, shape))} cells)"
            )
        weight = np.ones(len(self)) if self.count is None else np.maximum(self.count, 1.0)
        valid = np.where(self.valid[:, None], self.values, np.nan)
        return ReadingGrid.of(self.angles_deg, valid, weight, self.channels)

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the project's CSV; `load_measurement` reads back an equal measurement."""
        from raden_torch.measurement import native_csv

        native_csv.write(self, path)

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, BrdfMeasurement):
            return NotImplemented
        return (self.channels, self.metadata) == (other.channels, other.metadata) and all(
            _equal(getattr(self, name), getattr(other, name))
            for name in (
                "incidence_deg",
                "receiving_deg",
                "tilt_deg",
                "values",
                "azimuth_deg",
                "std",
                "count",
                "valid",
            )
        )

    def __repr__(self) -> str:
        kind = "simulated " if self.metadata.simulated else ""
        return (
            f"BrdfMeasurement({kind}{self.metadata.sample!r}, {len(self)} readings, "
            f"{int(self.valid.sum())} valid, channels {', '.join(self.channels[:4])}"
            f"{', …' if len(self.channels) > 4 else ''})"
        )


def _check_channels(channels: tuple[str, ...]) -> None:
    spectral = [_wavelength(c) for c in channels]
    if channels not in (XYZ, RGB) and (not channels or None in spectral):
        raise InputError(
            "measurement: channels: expected X, Y, Z or R, G, B or spectral bands (as 550nm), "
            f"got {', '.join(channels) or '(none)'}"
        )
    if None not in spectral and (np.diff(np.array(spectral, float)) <= 0).any():
        raise InputError(
            "measurement: expected spectral bands in ascending wavelength, got "
            f"{', '.join(channels)}"
        )


def _wavelength(channel: str) -> float | None:
    if not channel.endswith("nm"):
        return None
    try:
        value = float(channel[:-2])
    except ValueError:
        return None
    return value if np.isfinite(value) and value > 0 else None


def _equal(a: Any, b: Any) -> bool:
    if a is None or b is None:
        return a is b
    return bool(np.array_equal(a, b, equal_nan=a.dtype.kind == "f"))
