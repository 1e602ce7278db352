"""One measured form of the model: a row of the benchmark's file, a mark of its plot."""

from __future__ import annotations

from dataclasses import dataclass

from raden_torch.brdf.fitting.score import Score


@dataclass(frozen=True)
class Row:
    """One form in one backend.

    Attributes:
        form, nodes, default, backend, precision: what ran, as in `forms.Form`.
        times_floor, times_naive: run time over a copy of the same bytes, and over the naive form.
        errors: by region, "inside" and "outside" the measured box and over the whole "hemisphere"
            (all readings); a region without readings is left out.
        delta_e: mean ΔE2000 of a lit sphere against the simulation; None of a real sample.
    """

    form: str
    nodes: int
    default: bool
    backend: str
    precision: str
    times_floor: float
    times_naive: float
    errors: dict[str, Score]
    delta_e: float | None = None
