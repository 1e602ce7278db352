"""Timing jobs one after the other, over and over: a drift of the machine hits all alike."""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable, Mapping


def in_turn(
    jobs: Mapping[str, Callable[[], object]],
    runs: int,
    *,
    warm_up: int = 1,
    clock: Callable[[], float] = time.perf_counter,
) -> dict[str, list[float]]:
    """Seconds of each job, `runs` of them after the first ones."""
    times: dict[str, list[float]] = {name: [] for name in jobs}
    for run in range(warm_up + runs):
        for name, job in jobs.items():
            start = clock()
            job()
            if run >= warm_up:
                times[name].append(clock() - start)
    return times


def median_ms(jobs: Mapping[str, Callable[[], object]], runs: int) -> dict[str, float]:
    """Milliseconds of each; the first run, which may bake tables, does not count."""
    return {name: 1e3 * statistics.median(taken) for name, taken in in_turn(jobs, runs).items()}


def least_cpu_ms(jobs: Mapping[str, Callable[[], object]], runs: int) -> dict[str, float]:
    """Milliseconds of processor time of each, the least: for a machine that others use, too."""
    taken = in_turn(jobs, runs, clock=time.process_time)
    return {name: 1e3 * min(each) for name, each in taken.items()}
