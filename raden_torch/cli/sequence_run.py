"""Running a job from the command line: a bar for people, lines of JSON for a farm."""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from contextlib import closing
from pathlib import Path
from typing import Any

from raden_torch.cli.endings import in_options
from raden_torch.cli.sequence_options import SequenceOptions
from raden_torch.cli.status import progress
from raden_torch.interrupts import Interrupted
from raden_torch.sequences.job import Engine, Job
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
    local = LocalEngine(memory=memory, prepared=prepared)
    engine = asked.where.among(local)
    report = Report(frames, 0 if asked.frames is None else len(asked.frames))
    room = local.room(job) if engine is local else {}
    if asked.json:
        print(report.started_line(job.target, **room), flush=True)
    run_items(job, frames, engine, job.target, report, as_json=asked.json)


def run_items(
    job: Job[Any, Any, Any, Any],
    items: Sequence[Any],
    engine: Engine,
    target: Path,
    report: Report,
    *,
    as_json: bool = False,
    noun: str = "frame",
    called: Callable[[Any], str] = lambda item: f"frame {item}",
) -> None:
    """Do the items, say what became of them, and exit with 3 where some are not there.

    Args:
        target: what is written, in the summary.
        noun, called: what items are, and one of them, in messages.
    """
    try:
        with (
            one_warning_of_a_kind(),
            progress("working") as shown,
            closing(engine.run(job, items)) as outcomes,
        ):
            for outcome in outcomes:
                report.add(outcome)
                if as_json:
                    print(report.frame_line(outcome, job.output(outcome.item)), flush=True)
                elif outcome.state == "failed":
                    told = _told(called(outcome.item), outcome.message)
                    print(f"raden: {in_options(told, sys.argv[1:])}", file=sys.stderr)
                shown(report.done / len(items))
    except Interrupted as interrupt:
        _end(target, report, str(interrupt), noun, as_json=as_json)
        raise
    _end(target, report, None, noun, as_json=as_json)
    if report.exit_code:
        raise SystemExit(report.exit_code)


def _told(item: str, message: str) -> str:
    """An item and what was wrong, which may begin with the item's file."""
    return message if message.startswith(f"{item}:") else f"{item}: {message}"


def _end(target: Path, report: Report, stopped_by: str | None, noun: str, *, as_json: bool) -> None:
    if as_json:
        print(report.ended_line(stopped_by), flush=True)
        return
    print(report.summary(target))
    if report.is_full:
        print(f"raden: the disk is full: no further {noun} was begun", file=sys.stderr)
