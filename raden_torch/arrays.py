"""The array types that NumPy code here takes and gives, sums by group, and a weighted quantile."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Floats32 = NDArray[np.float32]
Complexes = NDArray[np.complex128]
Ints = NDArray[np.intp]
Bools = NDArray[np.bool_]


def group_sums(rows: Floats, group: Ints, groups: int) -> Floats:
    """`[groups, C]`: the sums of the rows `[N, C]` whose `group` `[N]` they are."""
    return np.stack([np.bincount(group, column, groups) for column in rows.T], axis=1)


def weighted_quantile(
    values: NDArray[np.floating[Any]], weights: NDArray[np.floating[Any]], share: float
) -> float:
    """The least of the values `[N]` up to which `share` (0…1) of all weight `[N]` lies."""
    order = np.argsort(values)
    reached = np.cumsum(weights[order], dtype=np.float64)
    return float(values[order][np.searchsorted(reached, share * reached[-1])])
