"""Do the readings of one scan contradict each other beyond their own noise?"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from raden_torch.arrays import Floats
from raden_torch.errors import InputError
from raden_torch.measurement.consistency import CONTRADICTION_STD

MAX_SHARE = 0.1
"""Of the cells with repeats: where more contradict themselves, nothing is reduced."""
MAX_LAMP_STEP = 0.3
"""Relative change of the white between two series that no drift explains."""

_NAMED = 5
_JUMP = 0.01  # of the white, relative: below, a straight line between the series will do
_USUAL = 6.0  # times the median step


def of_repeats(
    readings: Floats, index: NDArray[np.int64], means: Floats, single_std: Floats, cells: Floats
) -> tuple[str, ...]:
    """Cells one of whose readings is over 6 standard deviations of a single one from their mean.

    Args:
        readings: `[N, 3]` reflectance factors; `index` `[N]` which of the cells each is of.
        means: `[M, 3]` of the cells; `cells` `[M, 3]` their angles in degrees.
        single_std: `[N, 3]` what single readings of the references scatter by, at these values.

    Raises:
        InputError: over `MAX_SHARE` of the cells with repeats are so.
    """
    repeated = np.bincount(index, minlength=len(cells)) > 1
    if not repeated.any():
        return ()
    away = abs(readings - means[index]) / np.maximum(single_std, 1e-9 * abs(means[index]) + 1e-12)
    worst = np.zeros(len(cells))
    np.maximum.at(worst, index, away.max(axis=1))
    found = np.flatnonzero(repeated & (worst > CONTRADICTION_STD))
    if not len(found):
        return ()
    named = "; ".join(
        f"({', '.join(f'{angle:g}' for angle in cells[cell])}) {worst[cell]:.3g}"
        for cell in found[np.argsort(-worst[found])][:_NAMED]
    )
    text = (
        f"repeats of {len(found)} of {int(repeated.sum())} cells lie up to so many standard "
        f"deviations of a reading from their mean: {named}"
    )
    if len(found) > MAX_SHARE * repeated.sum():
        raise InputError(
            f"journal: {text}; the sample moves, or the light flickers: mend that and scan again"
        )
    return (text,)


def of_white(levels: Floats, time_s: Floats) -> tuple[str, ...]:
    """Steps of the lamp between two white series that are out of the ordinary.

    Args:
        levels: `[K, 3]` the white series over the first; `time_s` `[K]` when they were read.

    Raises:
        InputError: a step of over `MAX_LAMP_STEP`: something else than the lamp has changed.
    """
    steps = np.diff(levels[:, 1]) / levels[:-1, 1]
    if not len(steps):
        return ()
    worst = int(np.argmax(abs(steps)))
    minutes = (time_s[worst : worst + 2] - time_s[0]) / 60
    text = (
        f"the white changed by {100 * steps[worst]:+.3g} % between {minutes[0]:.0f} and "
        f"{minutes[1]:.0f} min"
    )
    if abs(steps[worst]) > MAX_LAMP_STEP:
        raise InputError(
            f"journal: {text}; lamp, shutter or white reference is not what it was: scan again"
        )
    usual = max(_JUMP, _USUAL * float(np.median(abs(steps))))
    return (f"{text}, a jump",) if abs(steps[worst]) > usual else ()
