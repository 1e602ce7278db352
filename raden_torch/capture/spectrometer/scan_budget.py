"""Where the standard deviation of a reading comes from: the terms, and what a rig states of itself.

Type A terms are found from the scan's own readings, type B terms follow from what the rig file
states (JCGM 100:2008, 4.2 and 4.3). All are standard uncertainties (k = 1) of
R = R_w (S − D) / (W − D) · cos θi(w) / cos θi of docs/measuring.md:

| term | type | formula | shared with |
|---|---|---|---|
| repeatability | A | s / √n, s pooled from a cell's n readings and the references | nothing |
| white | A, B | R s_W √Σ share²/n; R tan a_w u(move) √Σ share² | cells near in time |
| dark | A | R_w |1 − ratio| s_D √Σ share²/n | cells near in time |
| drift | A | R · change between two white series / √12 | cells near in time |
| positioning | B | √Σ_axes ((∂R/∂angle − R tan angle) u(move))² | nothing |
| zeros | B | √Σ_axes (dR/dzero · u(zero))², see `measurement.systematic_errors` | all cells |
| colour | B | |∂R/∂λ| u(λ) with a spectrum, R u(xyz) without | all cells of one colour |
| scale | B | R u(certificate) | all cells; not in `total` |

tan of incidence and of tilt alone: receiving does not change the irradiance.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from raden_torch.arrays import Floats
from raden_torch.capture.spectrometer.journal import Header
from raden_torch.capture.spectrometer.white_reference import UNNAMED
from raden_torch.measurement import BrdfMeasurement
from raden_torch.measurement.budget_terms import BudgetTerms
from raden_torch.measurement.error_parts import zero_effects
from raden_torch.measurement.systematic_errors import SystematicErrors, zero_sensitivity
from raden_torch.reflectance.slopes import slopes_per_deg

_POOLED = 4.0  # degrees of freedom; see `repeatability`


@dataclass(frozen=True, eq=False)
class Budget(BudgetTerms):
    """Standard deviations (k = 1) of the reflectance factors, term by term, `[M, 3]` each.

    What each is, and what it is shared with, is in the module's table.
    """

    repeatability: Floats
    white: Floats
    dark: Floats
    drift: Floats
    positioning: Floats
    zeros: Floats
    colour: Floats


@dataclass(frozen=True)
class GeometryTerms:
    """`[M, 3]` each; see the module's table."""

    positioning: Floats
    zeros: Floats


def systematic_errors(header: Header, white_mean_std: float) -> SystematicErrors:
    """What the readings of a scan share, as their measurement states it.

    Args:
        white_mean_std: relative, of the mean of all its white readings.
    """
    here = header.white.position
    at_cells = bool(header.white.at_cells)
    named = header.white.name != UNNAMED  # a name that tells one white from another
    return SystematicErrors(
        scale_std=header.white.relative_std,
        scale_reference=header.white.name if named and header.white.relative_std else "",
        white_mean_std=white_mean_std,
        zero_std_deg=header.stated.zero_std_deg,
        white_deg=None if at_cells else here.angles_deg,
    )


def geometry_terms(measurement: BrdfMeasurement, header: Header) -> GeometryTerms:
    """From the slopes of the measured values; they are the measurement's own, with its noise.

    The effect of the zeros is computed by the function that a comparison uses to remove it.
    """
    m = measurement
    # a shift of the sample does not shift the white, so the white's position does not matter
    upright = None if m.metadata.systematic.white_deg is None else (0.0, 0.0, 0.0)
    slopes = slopes_per_deg(m.angles_deg, m.values, m.valid)
    moved = zero_sensitivity(m.values, m.angles_deg, slopes, upright)
    return GeometryTerms(
        _in_quadrature(moved * np.array(header.stated.position_std_deg)),
        _in_quadrature(zero_effects(m)),
    )


def repeatability(own_std: Floats, single_std: Floats, count: NDArray[np.int64]) -> Floats:
    """`[M, 3]` of the mean of each cell's readings.

    Two or three repeats hardly know their own scatter, and two that are alike by chance would have
    all the weight. Theirs is pooled (JCGM 100:2008, H.3.6) with what single readings scatter by,
    counted as `_POOLED` degrees of freedom: the references' scatter, larger where the repeats of
    the whole scan are.

    Args:
        own_std: `[M, 3]` of single readings, by the cell's repeats; NaN where it has one.
        single_std: `[M, 3]` by the references.
        count: `[M, 1]` readings, 1 or more.
    """
    freedom = np.where(count > 1, count - 1.0, 0.0)
    squares = np.where(count > 1, freedom * np.nan_to_num(own_std) ** 2, 0.0)
    expected = (freedom * np.nan_to_num(single_std) ** 2).sum(axis=0)
    larger = np.maximum(squares.sum(axis=0) / np.where(expected > 0, expected, np.inf), 1.0)
    pooled = (_POOLED * larger * single_std**2 + squares) / (_POOLED + freedom)
    return np.asarray(np.sqrt(pooled / count))


def white_move_std(header: Header) -> float:
    """Relative, of the irradiance on the white after one move to its geometry."""
    if header.white.at_cells:
        return 0.0
    here, stated = header.white.position, header.stated.position_std_deg
    tangents = np.tan(np.radians([here.incidence_deg, here.tilt_deg]))
    return float(np.hypot(*(tangents * np.radians([stated[0], stated[2]]))))


def _in_quadrature(effects: Floats) -> Floats:
    return np.asarray(np.sqrt((effects**2).sum(axis=-1)))
