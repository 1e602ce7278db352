"""The mean reflectance of nacre for any tablet thickness and spread, fast: a table of a few stacks.

Films scale: tablets s times as thick reflect what these do at a wavelength across them s times as
long. So a few thicknesses serve for all between; neighbouring ones are blended, which leaves the
dispersion and the organic sheet, which do not scale, right at the nodes and nearly so between.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.ndimage import map_coordinates

from raden_torch.arrays import Floats
from raden_torch.optics.nacre import Stack, mean_reflectance, wavelength_across

TABLETS_NM = (220.0, 290.0, 370.0, 460.0, 580.0)
"""The thicknesses that are computed; what is between the first and the last can be asked for."""
SPREADS = np.linspace(0.01, 0.12, 23)
"""The relative spreads that are kept."""

_COMPUTED_SPREADS = (0.01, 0.025, 0.04, 0.06, 0.085, 0.12)
_Q_SQUARED = np.linspace(0.0, 1.0, 5)
_STEP_NM = 4.5  # in vacuum, at 550 nm
_RANGE_NM = (380.0, 780.0)
_STACKS = 40


@dataclass(frozen=True)
class NacreTable:
    """Mean reflectance `[spreads, q², log of the wavelength across]` of each thickness."""

    values: tuple[Floats, ...]
    first: tuple[float, ...]
    step: float

    def reflectance(self, tablet_nm: float, wavelength_nm: Floats, q_squared: Floats) -> Floats:
        """`[spreads, M, W]` at every spread of the table.

        Args:
            wavelength_nm: `[W]`, 380…780.
            q_squared: `[M]` (n sin θ)², 0…1.
        """
        nodes = np.array(TABLETS_NM)
        above = int(np.clip(np.searchsorted(nodes, tablet_nm), 1, len(nodes) - 1))
        share = (tablet_nm - nodes[above - 1]) / (nodes[above] - nodes[above - 1])
        across = np.log(wavelength_across(wavelength_nm, q_squared[:, None]) / tablet_nm)
        row = np.broadcast_to(q_squared[:, None] * (len(_Q_SQUARED) - 1), across.shape)
        total = np.zeros((len(SPREADS), *across.shape))
        for node, weight in ((above - 1, 1 - share), (above, share)):
            column = (across - self.first[node]) / self.step
            for spread, table in enumerate(self.values[node]):
                found = map_coordinates(table, [row, column], order=1, mode="nearest")
                total[spread] += weight * found
        return total


@lru_cache(maxsize=2)
def nacre_table(ambient_n: float) -> NacreTable:
    """The table under a medium of index `ambient_n`; computed once in a process, in seconds."""
    step = _STEP_NM / 550
    values, first = [], []
    for node, tablet in enumerate(TABLETS_NM):
        thinnest = TABLETS_NM[max(node - 1, 0)]
        thickest = TABLETS_NM[min(node + 1, len(TABLETS_NM) - 1)]
        low, high = _RANGE_NM[0] * tablet / thickest, _RANGE_NM[1] * tablet / thinnest
        start = float(np.log(wavelength_across(low, 0.0) / tablet))
        stop = float(np.log(wavelength_across(high, 1.0) / tablet))
        across = np.arange(start, stop + step, step)
        vacuum = np.linspace(0.9 * low, 1.1 * high, 400)
        computed = np.zeros((len(_COMPUTED_SPREADS), len(_Q_SQUARED), len(across)))
        for row, q_squared in enumerate(_Q_SQUARED):
            known = np.log(wavelength_across(vacuum, q_squared) / tablet)
            used = (across >= known[0]) & (across <= known[-1])
            wavelengths = np.interp(across[used], known, vacuum)
            for k, spread in enumerate(_COMPUTED_SPREADS):
                stack = Stack(tablet, spread)
                computed[k, row, used] = mean_reflectance(
                    stack, wavelengths, np.array([q_squared]), ambient_n=ambient_n, stacks=_STACKS
                )[0]
        values.append(CubicSpline(_COMPUTED_SPREADS, computed)(SPREADS))
        first.append(start)
    return NacreTable(tuple(values), tuple(first), step)
