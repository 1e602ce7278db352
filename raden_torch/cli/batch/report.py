"""The report of a batch, for people and as JSON: written after every job, read by the next run."""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Annotated

import msgspec
from msgspec import Meta

from raden_torch.cli.batch.job import Job, Outcome, run_job
from raden_torch.errors import InputError
from raden_torch.files import check_outputs, written_beside
from raden_torch.schema import checked, read_document
from raden_torch.writer_lock import writer_lock

FORMAT = "raden_torch batch"
VERSION = 1


class _Report(msgspec.Struct):
    """What is read of an earlier report."""

    format: Annotated[str, Meta(pattern=rf"\A{FORMAT}\Z", description=repr(FORMAT))]
    version: Annotated[int, Meta(le=VERSION, description=f"version {VERSION} or older")]
    jobs: list[Outcome]


@dataclass
class Batch:
    """Jobs that are run one after another, and their report.

    Attributes:
        what: of the report, as "photograph sets in /shells".
        report: the JSON file; the text stands beside it, as .txt.
        names: of the jobs, in their order; each differs.
    """

    what: str
    report: Path
    names: Sequence[str]

    def __post_init__(self) -> None:
        check_outputs(self.report, self.report.with_suffix(".txt"))
        self._before = _done_before(self.report)
        self._outcomes = {
            # what was done stays known where this batch ends before it comes to that job
            name: replace(self._before.get(name, Outcome(name, "not begun")), state="not begun")
            for name in self.names
        }

    @contextmanager
    def alone(self) -> Iterator[None]:
        """In the block, be the only batch with this report; where there is flock (not on Windows).

        Raises:
            InputError: another one runs.
        """
        if os.name != "posix":
            yield
            return
        with writer_lock(self.report.with_suffix(".lock"), 0.0):
            yield

    def is_done(self, job: Job) -> bool:
        """Whether an earlier run has done this very job, and its outputs are still there."""
        before = self._before.get(job.name)
        return before is not None and before.fingerprint == job.fingerprint() and job.has_outputs()

    def skip(self, job: Job) -> None:
        """Keep what the earlier report says of a job that was done."""
        before = self._before.get(job.name, Outcome(job.name, "skipped", outputs=job.outputs))
        self.record(replace(before, state="skipped"))

    def run(self, job: Job) -> Outcome:
        """Run a job; whatever interrupts it, the report says so."""
        interrupted = Outcome(job.name, "failed", "interrupted", outputs=job.outputs)
        try:
            outcome = run_job(job)
        except BaseException as error:
            interrupted.message = str(error) or type(error).__name__
            self.record(interrupted)
            raise
        self.record(outcome)
        return outcome

    def record(self, outcome: Outcome) -> None:
        """Put what became of a job into the report, and on the screen."""
        self._outcomes[outcome.name] = outcome
        for text in outcome.warnings if outcome.state != "skipped" else ():
            print(f"raden: warning: {outcome.name}: {text}", file=sys.stderr)
        print(_line(outcome), flush=True)
        jobs = [asdict(one) for one in self._outcomes.values()]
        content = {"format": FORMAT, "version": VERSION, "what": self.what, "jobs": jobs}
        with written_beside(self.report) as temporary:
            temporary.write_text(json.dumps(content, indent=2, ensure_ascii=False), "utf-8")
        with written_beside(self.report.with_suffix(".txt")) as temporary:
            temporary.write_text("\n".join(self._text()) + "\n", "utf-8")

    def finish(self) -> None:
        """Say how many were done.

        Raises:
            InputError: some were not.
        """
        report = f"{self.report}, {self.report.with_suffix('.txt').name}"
        print(f"{self.counts()}; wrote {report}")
        if any(outcome.state in ("failed", "not begun") for outcome in self._outcomes.values()):
            raise InputError(f"{self.what}: {self.counts()}; {self.report} says why")

    def counts(self) -> str:
        states = [outcome.state for outcome in self._outcomes.values()]
        said = [f"{states.count(s)} {s}" for s in dict.fromkeys(states)]
        return ", ".join(said) or "none"

    def _text(self) -> Iterator[str]:
        yield f"{self.what}: {self.counts()}"
        for outcome in self._outcomes.values():
            yield ""
            yield _line(outcome)
            for text in outcome.warnings:
                yield f"  warning: {text}"
            for line in outcome.text.splitlines():
                yield f"  {line}"


def _line(outcome: Outcome) -> str:
    said = {
        "done": f"done in {outcome.seconds:.1f} s: {', '.join(outcome.outputs)}",
        "skipped": "done before: " + ", ".join(outcome.outputs),
        "failed": f"FAILED: {outcome.message}",
        "not begun": "not begun" + (f": {outcome.message}" if outcome.message else ""),
    }
    return f"{outcome.name}: {said[outcome.state]}"


def _done_before(report: Path) -> dict[str, Outcome]:
    if not report.exists():
        return {}
    found = checked(read_document(report, "the report of a batch"), _Report, str(report))
    return {one.name: one for one in found.jobs if one.fingerprint}
