"""What is said of a sequence: a line of JSON for each frame, a summary, an exit code."""

from __future__ import annotations

import json
import re
import time
import warnings
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from raden_torch.sequences.frames import frame_range
from raden_torch.sequences.job import Outcome

INCOMPLETE = 3
"""The exit code where frames failed or were not reached: the same command does the rest."""


class Report:
    """Counts outcomes.

    Args:
        items: what there is to do.
        asked: how many were asked for, with those that are left out because files are missing.
        named: items in words; frames as a range unless stated.
    """

    def __init__(
        self,
        items: Sequence[Any],
        asked: int | None = None,
        named: Callable[[Sequence[Any]], str] = frame_range,
    ) -> None:
        self._named = named
        self._items, self._start = list(items), time.perf_counter()
        self._missing = (len(items) if asked is None else asked) - len(items)
        self._counts: Counter[str] = Counter()
        self._failed: list[Any] = []
        self.is_full = False

    def add(self, outcome: Outcome[Any]) -> None:
        """Count one."""
        self._counts[outcome.state] += 1
        if outcome.state == "failed":
            self._failed.append(outcome.item)
        self.is_full = self.is_full or outcome.is_last

    @property
    def done(self) -> int:
        """How many have been told."""
        return self._counts.total()

    @property
    def left(self) -> int:
        """How many were not reached."""
        return len(self._items) - self.done

    @property
    def exit_code(self) -> int:
        return INCOMPLETE if self._failed or self.left else 0

    @property
    def seconds(self) -> float:
        return time.perf_counter() - self._start

    def summary(self, target: Path) -> str:
        """One line for people."""
        counts = self._counts
        said = [f"{counts['written']} written"]
        said += [f"{counts['kept']} kept"] * bool(counts["kept"])
        said += [f"{self._missing} without files"] * bool(self._missing)
        if self._failed:
            said.append(f"{len(self._failed)} failed ({self._named(self._failed)})")
        said += [f"{self.left} not reached"] * bool(self.left)
        return f"{target}: {', '.join(said)}, in {self.seconds:.1f} s"

    def started_line(self, target: Path, **more: Any) -> str:
        """JSON, before the first frame; `docs/sequences.md` has the fields of all lines."""
        return _line(
            "start",
            target=str(target),
            frames=self._named(self._items) if self._items else "",
            total=len(self._items),
            missing=self._missing,
            **more,
        )

    def frame_line(self, outcome: Outcome[Any], file: Path) -> str:
        """JSON, after `add`."""
        return _line(
            "frame",
            frame=outcome.item if isinstance(outcome.item, int) else str(outcome.item),
            file=str(file),
            state=outcome.state,
            message=outcome.message,
            seconds={stage: round(taken, 4) for stage, taken in outcome.seconds.items()},
            done=self.done,
            total=len(self._items),
        )

    def ended_line(self, stopped_by: str | None = None) -> str:
        """JSON, after the last frame.

        Args:
            stopped_by: the signal's name; a full disk is known.
        """
        return _line(
            "end",
            written=self._counts["written"],
            kept=self._counts["kept"],
            failed=self._named(self._failed) if self._failed else "",
            left=self.left,
            missing=self._missing,
            stopped_by=stopped_by or ("full disk" if self.is_full else None),
            seconds=round(self.seconds, 3),
            exit_code=self.exit_code,
        )


def _line(event: str, **fields: Any) -> str:
    return json.dumps({"event": event, **fields}, ensure_ascii=False)


@contextmanager
def one_warning_of_a_kind() -> Iterator[None]:
    """Of warnings that differ by numbers alone, as a frame's, the first one is shown."""
    shown, seen = warnings.showwarning, set[str]()

    def show(message: Warning | str, *rest: Any, **more: Any) -> None:
        kind = re.sub(r"\d+", "#", str(message))
        if kind not in seen:
            seen.add(kind)
            shown(message, *rest, **more)

    warnings.showwarning = show
    try:
        yield
    finally:
        warnings.showwarning = shown
