"""The error of each reading in two parts: its own, and the one that all readings share."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from raden_torch.arrays import Floats, Ints
from raden_torch.errors import InputError
from raden_torch.measurement.colour_conversion import matrix_to
from raden_torch.measurement.readings import BrdfMeasurement
from raden_torch.measurement.systematic_errors import zero_sensitivity
from raden_torch.reflectance.slopes import slopes_per_deg

_LEAST_OWN = 1.0 / 3.0  # of `std`: what a slope that was overestimated may take from it
_LEAST_STD = 1e-9  # relative to the largest value: rounding, where no error is stated


@dataclass(frozen=True)
class ErrorParts:
    """N valid readings of C channels. The covariance of a channel is diag(`variance`) + U U′ with
    the columns of `zeros` as U; the scale's error is beside it, in the metadata.

    Attributes:
        values: `[N, C]`.
        variance: `[N, C]` of each reading's own error.
        zeros: `[N, C, 3]` what one standard deviation of each axis' zero does.
    """

    values: Floats
    variance: Floats
    zeros: Floats

    def interpolated(self, weights: Floats, rows: Ints, added: Floats) -> ErrorParts:
        """At N′ places: each `weights` `[N′, K]` times the readings `rows` `[N′, K]`.

        Args:
            added: `[N′, C]` standard deviation of the interpolation itself.
        """
        mixed = lambda column: np.einsum("nk,nk...->n...", weights, column[rows])  # noqa: E731
        variance = np.einsum("nk,nkc->nc", weights**2, self.variance[rows]) + added**2
        return ErrorParts(mixed(self.values), variance, mixed(self.zeros))

    def at(self, rows: Ints) -> ErrorParts:
        """Some of the readings."""
        return ErrorParts(self.values[rows], self.variance[rows], self.zeros[rows])


def error_parts(measurement: BrdfMeasurement, channels: tuple[str, ...]) -> ErrorParts:
    """The valid readings of a measurement in other channels.

    What the zeros do is in `std` and is taken out of it, in the channels that were measured: the
    slopes there are those that it was put in with.

    Args:
        channels: its own; or X, Y, Z or R, G, B.

    Raises:
        InputError: its channels make no colour, or some readings state no standard deviation.
    """
    m = measurement.select(measurement.valid)
    common = m.metadata.systematic
    floor = (_LEAST_STD * abs(m.values).max(initial=1e-6)) ** 2
    variance = np.full(m.values.shape, floor)
    zeros = np.zeros((*m.values.shape, 3))
    if any(common.zero_std_deg):
        zeros = zero_effects(m)
    if m.std is not None:
        square = stated_variance(m)
        own = np.maximum(square - (zeros**2).sum(axis=-1), _LEAST_OWN**2 * square)
        variance = np.maximum(own, floor)
    matrix = matrix_to(m, channels)
    return ErrorParts(
        m.values @ matrix.T,
        variance @ (matrix**2).T,
        np.einsum("ncz,dc->ndz", zeros, matrix),
    )


def stated_variance(measurement: BrdfMeasurement) -> Floats:
    """`[M, C]` std² of a measurement whose readings are all valid.

    Raises:
        InputError: it has no standard deviations, or not for every reading.
    """
    m = measurement
    name = m.metadata.sample or "an unnamed sample"
    if m.std is None:
        raise InputError(
            f"measurement of {name}: expected columns std_{', std_'.join(m.channels[:3])}, got "
            "none; without a standard deviation it has no weight"
        )
    wrong = ~np.isfinite(m.std).all(axis=1)
    if wrong.any():
        row = int(np.argmax(wrong))
        raise InputError(
            f"measurement of {name}: expected a standard deviation at incidence "
            f"{m.incidence_deg[row]:g}, receiving {m.receiving_deg[row]:g}, tilt "
            f"{m.tilt_deg[row]:g} deg, got none; give it one, or mark the reading as not valid"
        )
    return np.asarray(m.std**2)


def zero_effects(measurement: BrdfMeasurement) -> Floats:
    """`[M, C, 3]`: what one standard deviation of each axis' zero does to each value."""
    m, common = measurement, measurement.metadata.systematic
    slopes = slopes_per_deg(m.angles_deg, m.values, m.valid)
    sensitivity = zero_sensitivity(m.values, m.angles_deg, slopes, common.white_deg)
    return np.asarray(sensitivity * np.array(common.zero_std_deg))
