"""Frame ranges as render farms write them, and file names with the frame's number in them."""

from __future__ import annotations

import re
from collections.abc import Iterable
from pathlib import Path

from raden_torch.errors import InputError
from raden_torch.packages import require

MOST_FRAMES = 1_000_000
"""Of one range."""

_NUMBER = re.compile(r"#+|@+|%0?(\d*)d")


def frame_numbers(text: str) -> tuple[int, ...]:
    """The frames of a range, each once, in order: "1-10x2,15" is 1, 3, 5, 7, 9, 15.

    Args:
        text: numbers and FIRST-LAST, by commas; `x2` takes every second frame, `y2` all but those,
            `:2` is the order in which some farms take all of them.

    Raises:
        InputError: something else; a negative or broken number; more than `MOST_FRAMES`; or
            fileseq, of the extra `images`, is not installed.
    """
    require("frame ranges", "images")
    from fileseq.exceptions import FileSeqException
    from fileseq.frameset import FrameSet

    got = " ".join(text.split())[:40] or "nothing"
    wanted = f"frames: expected ranges from 0, as 1-48 or 1-10x2,15, got {got}"
    if not re.fullmatch(r"[\d\s,:xy-]+", text) or len(text) > 100_000:
        raise InputError(wanted)
    try:
        numbers = sorted({int(number) for number in FrameSet(text)})
    except (FileSeqException, ValueError):
        raise InputError(wanted) from None
    if not numbers or numbers[0] < 0:
        raise InputError(wanted)
    if len(numbers) > MOST_FRAMES:
        raise InputError(f"frames: expected at most {MOST_FRAMES}, got {len(numbers)}")
    return tuple(numbers)


def frame_range(numbers: Iterable[int]) -> str:
    """The text of some frames: 1, 3, 5, 15 is "1-5x2,15"."""
    require("frame ranges", "images")
    from fileseq.frameset import FrameSet

    return str(FrameSet.framesToFrameRange(sorted(numbers)))


def is_pattern(path: Path | None) -> bool:
    """Whether a file's name has a place for the frame's number: `####`, `@@@@` or `%04d`."""
    return path is not None and _NUMBER.search(path.name) is not None


def frame_path(pattern: Path, number: int) -> Path:
    """The file of a frame: `shot.####.exr` is shot.0007.exr; of a path without a place for the
    number that path, which all frames share.

    Raises:
        InputError: two places.
    """
    if not is_pattern(pattern):
        return pattern
    found = list(_NUMBER.finditer(pattern.name))
    if len(found) > 1:
        raise InputError(
            f"{pattern}: expected one place for the frame's number, as shot.####.exr, got "
            f"{len(found)}"
        )
    digits = str(number).zfill(_width(found[0]))
    start, end = found[0].span()
    return pattern.with_name(pattern.name[:start] + digits + pattern.name[end:])


def frames_on_disk(pattern: Path) -> list[int]:
    """The numbers of the files there that a pattern stands for, in order."""
    found = _NUMBER.search(pattern.name)
    if found is None or not pattern.parent.is_dir():
        return []
    start, end = found.span()
    name = re.compile(
        re.escape(pattern.name[:start]) + r"(\d+)" + re.escape(pattern.name[end:]), re.DOTALL
    )
    numbers = {
        int(digits)
        for path in pattern.parent.iterdir()
        if (match := name.fullmatch(path.name))
        and (digits := match[1]) == str(int(digits)).zfill(_width(found))
    }
    return sorted(numbers)


def _width(found: re.Match[str]) -> int:
    """Digits that a number has at least."""
    return int(found[1] or 0) if found[0].startswith("%") else len(found[0])
