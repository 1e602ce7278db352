"""One measured form of the model: a row of the benchmark's file, a mark of its plot."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Row:
    """One interpolator in one backend.

    Attributes:
        scheme, backend, precision: what ran.
        times_floor, times_naive: run time over a copy of the same bytes, and over the naive form.
        rms, log_error: as in `score.Score`.
        table_bytes: of the table.
        delta_e: mean ΔE2000 of a lit sphere against the simulation; NaN without one.
    """

    scheme: str
    backend: str
    precision: str
    times_floor: float
    times_naive: float
    rms: float
    log_error: float
    table_bytes: int
    delta_e: float = float("nan")
