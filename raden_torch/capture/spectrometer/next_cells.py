"""Where would a further reading reduce the estimated error most?

The readings so far are kriged (`reflectance.kriging`), as `fit` does with them. Two things make an
estimate of the error at a place that was not read: how far it is from the readings, which the
kriging's own standard deviation says; and how much the sample changes there, which the readings
around say, each left out and predicted from the others. What their noise alone explains is taken
off first: no reading is spent on it.

The cost is the sum of the two errors that a fit is judged by: the RMS error of Y over its 99.9 %
quantile, and the mean |Δ log(1 + Y)|. A place counts with what its error adds to that sum.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from raden_torch.arrays import Floats
from raden_torch.measurement import BrdfMeasurement
from raden_torch.reflectance.kriging import ridge_coordinates
from raden_torch.reflectance.log_readings import FLOOR, LUMINANCE, LogReadings
from raden_torch.reflectance.symmetry import canonical

_AROUND = 12  # readings whose left-out errors tell how much the sample changes at a place
_APART = 0.6  # of the distance to the nearest reading: how near two readings of a batch may lie
_LEAST_SHARE = 0.01  # of a left-out error's square that is believed whatever the noise


@dataclass(frozen=True)
class Estimate:
    """What is expected of a fit to the readings so far.

    Attributes:
        rms: RMS error of Y over its 99.9 % quantile.
        log_error: mean |Δ log(1 + Y)|.
        gain: `[N]`, what each candidate adds to their sum.
    """

    rms: float
    log_error: float
    gain: Floats


def estimate(readings: BrdfMeasurement, candidates: Floats) -> Estimate:
    """The error at the candidates, `[N, 3]` in degrees, which also stand for all other places.

    Args:
        readings: XYZ, of which the valid ones count; their `std` tells noise from change.
    """
    valid = readings.select(readings.valid)
    known = LogReadings.of(valid.angles_deg, valid.values, valid.std, valid.count)
    noise, logs = known.noise, known.logs[:, LUMINANCE]
    kriging = known.kriged()
    errors, unit = kriging.leave_one_out()
    square = errors[:, LUMINANCE] ** 2 / known.spread
    _, around = kriging.nearest(candidates, _AROUND)
    total, states = square[around].sum(axis=1), (unit**2)[around].sum(axis=1)
    # a left-out error holds the reading's own noise, and about half as much of its neighbours'
    own = noise[around].sum(axis=1)
    change = np.maximum(total - 1.5 * own, 0) / np.maximum(states - own, 1e-9)
    change = np.clip(change, _LEAST_SHARE * total / states, total / states)
    mean, std = kriging.with_std(candidates)
    log_error = std * np.sqrt(known.spread * change)
    y = np.maximum(np.exp(mean[:, LUMINANCE]) - FLOOR, 0)
    slope = log_error * (FLOOR + y)  # of Y over its logarithm
    level = max(float(np.quantile(np.exp(logs) - FLOOR, 0.999)), 1e-9)
    of_rms, of_log = (slope / level) ** 2, slope / (1 + y)
    rms = float(np.sqrt(of_rms.mean()))
    return Estimate(rms, float(of_log.mean()), of_rms / max(2 * rms, 1e-12) + of_log)


def choose(gain: Floats, candidates: Floats, read: Floats, count: int) -> NDArray[np.intp]:
    """Rows of at most `count` candidates, the best first; none beside a better one.

    What is beside depends on how dense the readings are there already: a place's error falls when
    its neighbour is read.
    """
    from scipy.spatial import cKDTree

    points = ridge_coordinates(canonical(candidates))
    free_deg = cKDTree(ridge_coordinates(canonical(read))).query(points)[0]
    tree = cKDTree(points)
    taken = np.zeros(len(points), bool)
    chosen: list[int] = []
    for row in np.argsort(-gain, kind="stable").tolist():
        if len(chosen) == count:
            break
        if not taken[row]:
            chosen.append(row)
            taken[tree.query_ball_point(points[row], _APART * free_deg[row])] = True
    return np.array(chosen, np.intp)
