"""Timing jobs one after the other, over and over: a drift of the machine hits all alike."""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable, Mapping


def in_turn(
    jobs: Mapping[str, Callable[[], object]], runs: int, *, warm_up: int = 1
) -> dict[str, list[float]]:
    """Seconds of each job, `runs` of them after the first ones."""
    times: dict[str, list[float]] = {name: [] for name in jobs}
    for run in range(warm_up + runs):
        for name, job in jobs.items():
            start = time.perf_counter()
            job()
            if run >= warm_up:
                times[name].append(time.perf_counter() - start)
    return times


def median_ms(jobs: Mapping[str, Callable[[], object]], runs: int) -> dict[str, float]:
    """Milliseconds of each; the first run, which may bake tables, does not count."""
    return {name: 1e3 * statistics.median(taken) for name, taken in in_turn(jobs, runs).items()}
