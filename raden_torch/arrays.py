"""The array types that NumPy code here takes and gives, and sums of rows by group."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Floats32 = NDArray[np.float32]
Ints = NDArray[np.intp]
Bools = NDArray[np.bool_]


def group_sums(rows: Floats, group: Ints, groups: int) -> Floats:
    """`[groups, C]`: the sums of the rows `[N, C]` whose `group` `[N]` they are."""
    return np.stack([np.bincount(group, column, groups) for column in rows.T], axis=1)
