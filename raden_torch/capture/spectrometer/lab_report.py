"""What a laboratory keeps of a scan: coverage, drift, repeatability, reciprocity, faults."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from typing import cast

import numpy as np

from raden_torch.arrays import Floats
from raden_torch.capture.spectrometer.journal import JournalContents
from raden_torch.capture.spectrometer.reciprocity import Reciprocity, check_reciprocity
from raden_torch.capture.spectrometer.reduction import ReducedScan
from raden_torch.measurement import BrdfMeasurement


@dataclass(frozen=True)
class LabReport:
    """A scan in numbers; `str` gives it as text.

    Attributes:
        sample, goniometer, colorimeter, white, plan: by name.
        decisions: what the plan decided on the way, in words.
        simulated: True where the instruments were.
        started: date and time in UTC.
        hours: from the first to the last reading, interruptions included.
        sessions: how often the scan was begun or resumed.
        cells: how many the plan wanted.
        valid, over, under: how many have a value, were over, were under the range.
        excluded: how many the rig could not reach, by reason.
        readings: taken; lost: planned and not in the journal, where the scan is `finished`.
        planned: how many readings the plan has.
        finished: False where the scan can still be resumed.
        lamp_change: largest change of the white in Y between two series of one scan, relative to
            the first; lamp_step: between one series and the next.
        white_std, repeat_std: relative standard deviation in Y of single readings of the white, and
            of a cell (the median over the cells; NaN without repeats).
        median_std: of the cells' values in Y, relative, all terms but the white's certificate.
        white_relative_std: the certificate's.
        spectral: see `reduction.ReducedScan`.
        reciprocity: the check.
        travel_deg, as_given_deg: degrees of travel, summed over the axes, in the order of
            measuring and in the order in which the cells were given.
        faults: how many of each kind were got over, or ended a session.
        warnings: readings that contradict each other.
        terms: the median of each term of the budget in Y, relative.
    """

    sample: str
    goniometer: str
    colorimeter: str
    white: str
    plan: str
    plan_hash: str
    decisions: str
    simulated: bool
    started: str
    hours: float
    sessions: int
    cells: int
    valid: int
    over: int
    under: int
    excluded: dict[str, int]
    readings: int
    lost: int
    planned: int
    finished: bool
    lamp_change: float
    lamp_step: float
    white_std: float
    repeat_std: float
    median_std: float
    white_relative_std: float
    spectral: bool
    reciprocity: Reciprocity
    travel_deg: float
    as_given_deg: float
    faults: dict[str, int]
    warnings: tuple[str, ...]
    terms: dict[str, float]

    def __str__(self) -> str:
        return "\n".join(f"{name}: {text}" for name, text in self.entries())

    def entries(self) -> tuple[tuple[str, str], ...]:
        """Name and text, line by line: as they stand in the measurement's file, too."""
        kind = " (simulated)" if self.simulated else ""
        faults = ", ".join(f"{name} {count}" for name, count in sorted(self.faults.items()))
        return (
            ("scan", f"{self.sample or 'unnamed sample'}, {self.plan}{kind}"),
            ("plan hash", self.plan_hash),
            *([("decisions", self.decisions)] if self.decisions else []),
            ("goniometer", self.goniometer),
            ("colorimeter", self.colorimeter),
            ("started", f"{self.started}, {self.hours:.2f} h, sessions {self.sessions}"),
            *self._readings(),
            *self._quality(),
            ("white reference", self.white),
            (
                "ratio",
                "wavelength by wavelength, then X, Y, Z for D65"
                if self.spectral
                else "of X, Y and Z: exact for a lamp with the spectrum of D65",
            ),
            ("travel", self._travel()),
            ("faults", faults or "none"),
        )

    def _readings(self) -> tuple[tuple[str, str], ...]:
        """What was read, of what was to be read."""
        reasons = "; ".join(f"{why}: {count}" for why, count in self.excluded.items())
        return (
            (
                "coverage",
                f"{self.valid} of {self.cells} cells ({_percent(self.valid / self.cells)}); over "
                f"range {self.over}, under range {self.under}, excluded "
                f"{sum(self.excluded.values())}",
            ),
            ("excluded", reasons or "none"),
            (
                "readings taken",
                f"{self.readings}, lost {self.lost}"
                if self.finished
                else f"{self.readings} of {self.planned}: the scan is not finished",
            ),
        )

    def _quality(self) -> tuple[tuple[str, str], ...]:
        """How far the values can be trusted."""
        once = np.isnan(self.repeat_std)
        cells = "read once" if once else f"{_percent(self.repeat_std)} a reading (median)"
        terms = ", ".join(f"{name} {_percent(of)}" for name, of in self.terms.items())
        return (
            (
                "drift",
                f"lamp {_percent(self.lamp_change)} over the scan, at most "
                f"{_percent(self.lamp_step)} between two white series; corrected",
            ),
            ("repeatability", f"white {_percent(self.white_std)} a reading; cells {cells}"),
            (
                "standard deviation",
                f"{_percent(self.median_std)} of Y (median); without the white's own "
                f"{_percent(self.white_relative_std)}",
            ),
            ("budget", terms),
            ("warnings", "; ".join(self.warnings) or "none"),
            ("reciprocity", self._reciprocity()),
        )

    def _reciprocity(self) -> str:
        found = self.reciprocity
        if not found.pairs:
            return "no pair was measured"
        return (
            f"{found.pairs} pairs, broken by {_percent(found.mean)} on average, "
            f"{_percent(found.within_two_std)} within 2 standard deviations"
        )

    def _travel(self) -> str:
        travel = f"{self.travel_deg:.0f} deg, summed over the axes"
        if self.decisions:  # nobody gave an order of cells that were not known
            return travel
        ratio = self.as_given_deg / self.travel_deg if self.travel_deg else 1.0
        return f"{travel}; in the order given {self.as_given_deg:.0f} ({ratio:.2g} times)"


def with_report(measurement: BrdfMeasurement, report: LabReport) -> BrdfMeasurement:
    """The measurement with the report in its metadata, and so in its file."""
    return replace(measurement, metadata=replace(measurement.metadata, other=report.entries()))


def make_report(contents: JournalContents, reduced: ReducedScan) -> LabReport:
    """Everything that `LabReport` lists."""
    header, plan, m = contents.header, contents.plan, reduced.measurement
    times = [t.time_s for t in contents.taken] + [r.time_s for r in contents.references]
    level = reduced.white_level[:, 1]
    y, std = m.values[m.valid, 1], cast(Floats, m.std)[m.valid, 1]
    reciprocity = check_reciprocity(m)
    here = header.white.position
    where = (
        "read in every cell"
        if header.white.at_cells
        else f"read at incidence {here.incidence_deg:g}, receiving {here.receiving_deg:g}, tilt "
        f"{here.tilt_deg:g}, where its XYZ reflectance factor is "
        f"{', '.join(f'{value:.4g}' for value in header.white.xyz)}"
    )
    return LabReport(
        sample=header.sample,
        goniometer=header.goniometer,
        colorimeter=header.colorimeter,
        white=f"{header.white.name}, {where}",
        plan=plan.name,
        plan_hash=header.plan.hash,
        decisions=_decisions(contents),
        simulated=header.simulated,
        started=header.started,
        hours=(max(times) - min(times)) / 3600,
        sessions=sum(s.what in ("started", "resumed") for s in contents.sessions),
        cells=len(m),
        valid=int(m.valid.sum()),
        over=int((reduced.over > 0).sum()),
        under=int(((reduced.under > 0) & ~m.valid).sum()),
        excluded=plan.why_excluded(),
        readings=len(contents.taken),
        lost=plan.steps - len(contents.taken) if contents.finished else 0,
        planned=plan.steps,
        finished=contents.finished,
        lamp_change=float(np.ptp(level)),
        lamp_step=float(abs(np.diff(level)).max(initial=0.0)),
        white_std=float(reduced.white_single_std[1]),
        repeat_std=float(reduced.repeat_std[1]),
        median_std=float(np.median(std / np.maximum(abs(y), 1e-9))) if len(y) else np.nan,
        white_relative_std=header.white.relative_std,
        spectral=reduced.spectral,
        reciprocity=reciprocity,
        travel_deg=plan.travel_deg,
        as_given_deg=plan.as_given_deg,
        faults=dict(Counter(fault.kind for fault in contents.faults)),
        warnings=reduced.warnings + ((reciprocity.warning,) if reciprocity.warning else ()),
        terms=_median_terms(reduced),
    )


def _median_terms(reduced: ReducedScan) -> dict[str, float]:
    """Of each term of the budget that there is, in Y, relative to it."""
    valid = reduced.measurement.valid
    y = np.maximum(abs(reduced.measurement.values[valid, 1]), 1e-9)
    medians = {
        name: float(np.median(term[valid, 1] / y)) if len(y) else np.nan
        for name, term in reduced.budget.terms().items()
    }
    return {name: median for name, median in medians.items() if median != 0.0}


def now_utc() -> str:
    """Date and time, to the second."""
    return datetime.now(UTC).strftime("%Y-%m-%d %H:%M:%S UTC")


def _decisions(contents: JournalContents) -> str:
    """Empty where there are none."""
    if not contents.decisions:
        return ""
    last = contents.decisions[-1]
    batches = sum(len(decision.cells) > 0 for decision in contents.decisions)
    ended = "; " + last.why if not len(last.cells) else ""
    return (
        f"{len(contents.header.plan.cells)} cells first, then {batches} batches; estimated error "
        f"after {last.after} readings: RMS {last.rms:.5f} of the 99.9 % quantile of Y, mean "
        f"|Δ log(1+Y)| {last.log_error:.5f}{ended}"
    )


def _percent(share: float) -> str:
    return "not known" if np.isnan(share) else f"{100 * share:.3g} %"
