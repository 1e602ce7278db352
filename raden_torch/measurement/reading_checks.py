"""What a measurement refuses: shapes, angles, values, and readings that contradict."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from raden_torch.arrays import Bools, Floats
from raden_torch.errors import InputError
from raden_torch.measurement.consistency import pair_contradicts
from raden_torch.reflectance.grid import DIGITS

_LARGEST = 1e30
"""What is above is no reflectance factor, but infinite, or an instrument's code for an overload
(9.9e37 in SCPI)."""
_MISSING = (-999.0, -9999.0, -99999.0)
"""Values that other programs write where they have none."""

_ANGLE_LIMITS = {"incidence": (0.0, 90.0), "receiving": (-90.0, 90.0), "tilt": (-90.0, 90.0)}


def as_column(column: Any, name: str) -> Floats:
    """`[M]` finite numbers."""
    array = np.asarray(column, np.float64)
    if array.ndim != 1:
        raise InputError(f"measurement: {name}: expected shape [M], got {list(array.shape)}")
    if not np.isfinite(array).all():
        row = int(np.argmin(np.isfinite(array)))
        raise InputError(
            f"measurement: reading {row + 1}: {name}: expected a finite number, got {array[row]:g}"
        )
    return array


def check_shape(name: str, array: NDArray[Any], shape: tuple[int, ...]) -> None:
    """An array has the shape that the rest of the measurement asks for."""
    if array.shape != shape:
        raise InputError(
            f"measurement: {name}: expected shape {list(shape)}, got {list(array.shape)}"
        )


def check_angles(angles_deg: Floats) -> None:
    """`[M, 3]` incidence, receiving and tilt within their limits."""
    for (name, (low, high)), angle in zip(_ANGLE_LIMITS.items(), angles_deg.T, strict=True):
        wrong = ~((angle >= low) & (angle <= high))
        if wrong.any():
            row = int(np.argmax(wrong))
            raise InputError(
                f"measurement: reading {row + 1}: {name}_deg: expected {low:g}…{high:g} "
                f"degrees, got {angle[row]:g}"
            )


def check_values(
    values: Floats, std: Floats | None, valid: Bools, channels: tuple[str, ...]
) -> None:
    """`[M, C]` values: finite, and no code of another program's; no deviation below 0."""
    infinite = np.isinf(values) | (abs(values) > _LARGEST) & valid[:, None]
    if infinite.any():
        row, channel, value = _first(infinite, values)
        raise InputError(
            f"measurement: reading {row + 1}: {channels[channel]}: expected a finite "
            f"reflectance factor, got {value:g}; mark a saturated reading as not valid, or "
            "leave its value empty"
        )
    missing = np.isin(values, _MISSING) & valid[:, None]
    if missing.any():
        row, channel, value = _first(missing, values)
        raise InputError(
            f"measurement: reading {row + 1}: {channels[channel]}: expected a reflectance factor, "
            f"got {value:g}, which looks like a code for a missing value; mark it as not valid, or "
            "leave its value empty"
        )
    if std is not None and (std < 0).any():
        row, channel, value = _first(std < 0, std)
        raise InputError(
            f"measurement: reading {row + 1}: std_{channels[channel]}: expected at least "
            f"0, got {value:g}"
        )


def check_duplicates(
    geometries_deg: Floats,
    values: Floats,
    std: Floats | None,
    valid: Bools,
    channels: tuple[str, ...],
) -> None:
    """Refuse readings of one geometry that contradict; see `consistency.pair_contradicts`.

    Args:
        geometries_deg: `[M, 3]` the angles, or `[M, 4]` with the sample's azimuth, 0…360.
    """
    rows = np.flatnonzero(valid)
    key = np.round(geometries_deg[rows], DIGITS)
    order = np.lexsort(key.T[::-1])
    same = (key[order][1:] == key[order][:-1]).all(axis=1)
    if not same.any():
        return
    first, second = rows[order[:-1][same]], rows[order[1:][same]]
    of_both = None if std is None else np.hypot(std[first], std[second])
    wrong = pair_contradicts(values[first], values[second], of_both)
    if wrong.any():
        k = int(np.argmax(wrong))
        i, j = sorted((int(first[k]), int(second[k])))
        geometry = ", ".join(f"{angle:g}" for angle in geometries_deg[i])
        raise InputError(
            f"measurement: readings {i + 1} and {j + 1}: expected different geometries, or "
            f"standard deviations, got {channels[0]} = {values[i, 0]:g} and "
            f"{values[j, 0]:g} at the same geometry ({geometry} deg)"
        )


def _first(wrong: Bools, numbers: Floats) -> tuple[int, int, float]:
    """Row, column and number of the first that is wrong."""
    row, channel = np.unravel_index(int(np.argmax(wrong)), wrong.shape)
    return int(row), int(channel), float(numbers[row, channel])
