"""Running a sequence from the command line: a bar for people, lines of JSON for a farm."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from contextlib import closing
from typing import Any

from raden_torch.cli.sequence_options import SequenceOptions
from raden_torch.cli.status import progress
from raden_torch.interrupts import Interrupted
from raden_torch.sequences.job import Outcome
from raden_torch.sequences.local import LocalEngine
from raden_torch.sequences.picture_job import PictureJob
from raden_torch.sequences.report import Report, one_warning_of_a_kind


def run_frames(
    job: PictureJob[Any, Any, Any],
    frames: Sequence[int],
    asked: SequenceOptions,
    memory: int,
    prepared: Any = None,
) -> None:
    """Do the frames, say what became of them, and exit with 3 where some are not there.

    Args:
        memory, prepared: as for `LocalEngine`.
    """
    engine = LocalEngine(memory=memory, prepared=prepared)
    count = 0 if asked.frames is None else len(asked.frames)
    report = Report(frames, count)
    room = engine.room(job)
    if asked.json:
        print(report.started_line(job.target, **room), flush=True)
    try:
        with (
            one_warning_of_a_kind(),
            progress("frames") as shown,
            closing(engine.run(job, frames)) as outcomes,
        ):
            for outcome in outcomes:
                report.add(outcome)
                _tell(job, outcome, report, as_json=asked.json)
                shown(report.done / len(frames))
    except Interrupted as interrupt:
        _end(job, report, asked, str(interrupt))
        raise
    _end(job, report, asked, None)
    if report.exit_code:
        raise SystemExit(report.exit_code)


def _tell(
    job: PictureJob[Any, Any, Any], outcome: Outcome[int], report: Report, *, as_json: bool
) -> None:
    if as_json:
        print(report.frame_line(outcome, job.output(outcome.item)), flush=True)
    elif outcome.state == "failed":
        print(f"raden: frame {outcome.item}: {outcome.message}", file=sys.stderr)


def _end(
    job: PictureJob[Any, Any, Any],
    report: Report,
    asked: SequenceOptions,
    stopped_by: str | None,
) -> None:
    if asked.json:
        print(report.ended_line(stopped_by), flush=True)
        return
    print(report.summary(job.target))
    if report.is_full:
        print("raden: the disk is full: no further frame was begun", file=sys.stderr)
