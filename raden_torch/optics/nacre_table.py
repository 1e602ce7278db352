"""The mean reflectance of nacre for any tablet thickness and spread, fast: a table of a few stacks.

Films scale: tablets and sheets s times as thick reflect what these do at a wavelength across them
s times as long. So a few thicknesses serve for all between. Two neighbours, scaled to the same
optical period, differ in their organic sheets; a blend of them has sheets of 25 nm again.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from scipy.interpolate import CubicSpline

from raden_torch.arrays import Floats
from raden_torch.optics.nacre import (
    ARAGONITE_N_O,
    ORGANIC_N,
    Stack,
    mean_reflectance,
    wavelength_across,
)

TABLETS_NM = (220.0, 290.0, 370.0, 460.0, 580.0)
"""The thicknesses that are computed; what is between the first and the last can be asked for."""
SPREADS = np.linspace(0.01, 0.12, 23)
"""The relative spreads that are kept."""

ORGANIC_NM = 25.0
"""Of the stacks that are computed."""

_COMPUTED_SPREADS = (0.01, 0.025, 0.04, 0.06, 0.085, 0.12)
_Q_SQUARED = np.linspace(0.0, 1.0, 5)
_STEP_NM = 4.5  # in vacuum, at 550 nm
_RANGE_NM = (380.0, 780.0)
_STACKS = 40


@dataclass(frozen=True)
class NacreTable:
    """Mean reflectance `[q², log of the wavelength across, spreads]` of each thickness."""

    values: tuple[Floats, ...]
    first: tuple[float, ...]
    step: float

    def reflectance(
        self,
        tablet_nm: float,
        wavelength_nm: Floats,
        q_squared: Floats,
        spreads: slice = slice(None),
    ) -> Floats:
        """`[spreads, M, W]` at the spreads of the table, or some of them.

        Args:
            wavelength_nm: `[W]`, 380…780.
            q_squared: `[M]` (n sin θ)², 0…1.
            spreads: which of `SPREADS`.
        """
        # the readings on both sides of tilt 0 are of the same angle
        angles, inverse = np.unique(np.round(q_squared, 12), return_inverse=True)
        length = _length(tablet_nm)
        nodes = _length(np.array(TABLETS_NM))
        above = int(np.clip(np.searchsorted(nodes, length), 1, len(nodes) - 1))
        thick, thin = ORGANIC_NM * length / nodes[above - 1], ORGANIC_NM * length / nodes[above]
        share = (thick - ORGANIC_NM) / (thick - thin)
        across = np.log(wavelength_across(wavelength_nm, angles[:, None]) / length)
        row = np.broadcast_to(angles[:, None] * (len(_Q_SQUARED) - 1), across.shape)
        total: Floats = np.zeros(())
        for node, weight in ((above - 1, 1 - share), (above, share)):
            column = (across - self.first[node]) / self.step
            total = total + weight * _bilinear(self.values[node][..., spreads], row, column)
        return np.moveaxis(total, -1, 0)[:, inverse]


def _length(tablet_nm: Floats | float) -> Floats:
    """The optical period along the normal, in nanometres of aragonite."""
    return np.asarray(tablet_nm + ORGANIC_N / ARAGONITE_N_O * ORGANIC_NM)


def _bilinear(table: Floats, row: Floats, column: Floats) -> Floats:
    """`[..., S]` of a table `[rows, columns, S]`; beyond its edges the edge."""
    found: Floats = np.zeros(())
    places = []
    for at, count in zip((row, column), table.shape, strict=False):
        inside = np.clip(at, 0, count - 1)
        low = np.minimum(inside.astype(int), count - 2)
        places.append(((low, 1 - (inside - low)), (low + 1, inside - low)))
    for i, share_i in places[0]:
        for j, share_j in places[1]:
            found = found + (share_i * share_j)[..., None] * table[i, j]
    return found


@lru_cache(maxsize=2)
def nacre_table(ambient_n: float) -> NacreTable:
    """The table under a medium of index `ambient_n`; computed once in a process, in seconds."""
    step = _STEP_NM / 550
    values, first = [], []
    for node, tablet in enumerate(TABLETS_NM):
        thinnest = TABLETS_NM[max(node - 1, 0)]
        thickest = TABLETS_NM[min(node + 1, len(TABLETS_NM) - 1)]
        low, high = _RANGE_NM[0] * tablet / thickest, _RANGE_NM[1] * tablet / thinnest
        start = float(np.log(wavelength_across(low, 0.0) / _length(tablet)))
        stop = float(np.log(wavelength_across(high, 1.0) / _length(tablet)))
        across = np.arange(start, stop + step, step)
        vacuum = np.linspace(0.9 * low, 1.1 * high, 400)
        computed = np.zeros((len(_COMPUTED_SPREADS), len(_Q_SQUARED), len(across)))
        for row, q_squared in enumerate(_Q_SQUARED):
            known = np.log(wavelength_across(vacuum, q_squared) / _length(tablet))
            used = (across >= known[0]) & (across <= known[-1])
            wavelengths = np.interp(across[used], known, vacuum)
            for k, spread in enumerate(_COMPUTED_SPREADS):
                stack = Stack(tablet, spread, ORGANIC_NM)
                computed[k, row, used] = mean_reflectance(
                    stack, wavelengths, np.array([q_squared]), ambient_n=ambient_n, stacks=_STACKS
                )[0]
        by_spread = CubicSpline(_COMPUTED_SPREADS, computed)(SPREADS)
        values.append(np.ascontiguousarray(np.moveaxis(by_spread, 0, -1)))
        first.append(start)
    return NacreTable(tuple(values), tuple(first), step)
