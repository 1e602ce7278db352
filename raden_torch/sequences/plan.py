"""What is asked before the first frame: are all files there, what is the first frame like, how is
it exposed."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, TypeVar

from raden_torch.brdf.files.display import Display
from raden_torch.errors import InputError
from raden_torch.files import check_output
from raden_torch.sequences.frames import frame_path, frame_range, frames_on_disk, is_pattern
from raden_torch.sequences.picture_job import PictureJob, Shape

_T = TypeVar("_T")


def target_pattern(output: Path, name: str) -> Path:
    """The files to write; a folder, which is made where it is missing, has them under this name.

    Raises:
        InputError: a file's name without a place for the frame's number.
    """
    if is_pattern(output):
        return output
    if output.is_dir() or not output.suffix:
        output.mkdir(parents=True, exist_ok=True)
        return output / name
    raise InputError(
        f"{output}: expected a name with a place for the frame's number, as "
        f"{output.stem}.####{output.suffix}, or a folder, got neither"
    )


def check_pattern(path: Path) -> None:
    """Raise InputError where a frame's input has no place for the number."""
    if not is_pattern(path):
        raise InputError(
            f"{path}: expected a name with a place for the frame's number, as shot.####"
            f"{path.suffix}, with `frames`, got none"
        )


def check_no_pattern(path: Path | None) -> None:
    """Raise InputError where a name has a place for the number, but no frames are asked for."""
    if (
        path is not None
        and is_pattern(path)
        and not path.exists()
        and (found := frames_on_disk(path))
    ):
        raise InputError(f"{path}: expected `frames`, as {frame_range(found)}, got none")


def frames_to_do(
    job: PictureJob[Any, Any, Any], frames: Sequence[int], *, skip_missing: bool
) -> tuple[list[int], list[int]]:
    """The frames that are to be gone through, and those of them that are not done yet.

    Args:
        skip_missing: leave out frames of which a file is missing.

    Raises:
        InputError: files are missing: a line with their numbers; or the output is one of the
            inputs, or cannot be written.
    """
    gone: dict[Path, list[int]] = {}
    kept, to_do = [], []
    for number in frames:
        if not job.force and job.output(number).exists():
            kept.append(number)
            continue
        lacking = [p for p in job.patterns if not frame_path(p, number).is_file()]
        if lacking:
            gone.setdefault(lacking[0], []).append(number)
        else:
            to_do.append(number)
    if gone and (not skip_missing or not (kept or to_do)):
        pattern, numbers = next(iter(gone.items()))
        more = "; `skip_missing` leaves them out" if kept or to_do else ""
        raise missing(pattern, frames, numbers, more)
    for number in {frames[0], frames[-1], *to_do[:1]}:
        check_output(job.output(number), inputs=(*job.inputs(number), *job.shared))
    return sorted([*kept, *to_do]), to_do


def missing(pattern: Path, asked: Sequence[int], gone: Sequence[int], hint: str) -> InputError:
    """To raise where frames have no file."""
    return InputError(
        f"{pattern}: expected frames {frame_range(asked)}, missing are {frame_range(gone)} "
        f"({len(gone)} of {len(asked)}){hint}"
    )


def first_like(
    pattern: Path, frames: Sequence[int], look: Callable[[Path], Shape]
) -> tuple[int, Shape]:
    """The first frame that can be read, and its shape; damaged ones before it fail later.

    Raises:
        InputError: none can be read: what the first one says.
    """
    refused: InputError | None = None
    for number in frames:
        try:
            return number, look(frame_path(pattern, number))
        except InputError as error:
            refused = refused or error
    raise refused or InputError(f"{pattern}: expected frames, got none")


def first_read(pattern: Path, read: Callable[[int], _T]) -> _T:
    """What `read` makes of the first frame on disk that it takes; damaged ones fail later.

    Raises:
        InputError: it takes none: what it says of the first one.
    """
    refused: InputError | None = None
    for number in frames_on_disk(pattern):
        try:
            return read(number)
        except InputError as error:
            refused = refused or error
    raise refused or InputError(f"{pattern}: expected frames, got none")


def exposed_alike(display: Display, target: Path, stops: Callable[[], float]) -> Display:
    """The same display with stops that all frames have, where a picture's are to be found."""
    if not isinstance(display.exposure, str) or target.suffix.lower() == ".exr":
        return display
    return replace(display, exposure=stops())
