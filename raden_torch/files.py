"""Files that appear whole or not at all."""

from __future__ import annotations

import os
import re
import stat
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from secrets import token_hex

from raden_torch.errors import InputError


def check_writable(path: str | os.PathLike[str]) -> Path:
    """The path, if a file can be written there; called early, so that no work is lost.

    Raises:
        InputError: the folder does not exist or is closed to us; ``path`` is a folder, a device or
            a pipe, write-protected, or a link that leads nowhere.
    """
    target = Path(path)
    if target.is_dir():
        raise InputError(f"{target}: expected a file name, got a folder")
    real = _behind_links(target)
    if not real.parent.is_dir():
        raise InputError(
            f"{target}: expected an existing folder, got {real.parent}; create it first"
        )
    if real.exists() and not real.is_file():
        raise InputError(f"{target}: expected a file to write, got a device or a pipe")
    for place in (real.parent, real):
        if place.exists() and not os.access(place, os.W_OK):
            raise InputError(f"{target}: expected a place to write, got {place}, write-protected")
    return target


def check_seekable(path: str | os.PathLike[str]) -> None:
    """Refuse to read a pipe, which is used up by the look that tells what it holds.

    Raises:
        InputError: a pipe or a terminal.
        OSError: it is not there.
    """
    mode = os.stat(path).st_mode
    if stat.S_ISFIFO(mode) or stat.S_ISCHR(mode) or stat.S_ISSOCK(mode):
        raise InputError(f"{path}: expected a file, got a pipe or a device; save it as one first")


def first_bytes(path: str | os.PathLike[str], count: int) -> bytes | None:
    """What a file begins with, `count` bytes at most; None where there is none to read.

    Raises:
        InputError: as for `check_seekable`.
    """
    try:
        check_seekable(path)
        with open(path, "rb") as file:
            return file.read(count)
    except OSError:
        return None


def check_output(
    path: str | os.PathLike[str],
    suffixes: Sequence[str] = (),
    *,
    inputs: Iterable[str | os.PathLike[str] | None] = (),
) -> Path:
    """The path, if a command may write its result there; called before any work is done.

    An older file is replaced, unless the command reads it.

    Args:
        suffixes: of what is written, as ".csv"; any where empty.
        inputs: the files that the command reads; None stands for one that was not given.

    Raises:
        InputError: another suffix; what `check_writable` refuses; or the path is one of the inputs,
            by whatever name (a link, too).
    """
    target = Path(path)
    if suffixes and target.suffix.lower() not in suffixes:
        raise InputError(
            f"{target}: expected a file name that ends in {' or '.join(suffixes)}, "
            f"got {target.suffix or 'none'}"
        )
    check_writable(target)
    for source in inputs:
        if source is not None and is_same_file(target, source):
            raise InputError(
                f"{target}: is also an input, which would be overwritten; expected another name"
            )
    return target


def check_outputs(
    *paths: str | os.PathLike[str], inputs: Iterable[str | os.PathLike[str] | None] = ()
) -> None:
    """Check all that one command writes, as `check_output` does; no two of them may be one file."""
    sources = list(inputs)
    seen: dict[Path, Path] = {}
    for path in paths:
        target = check_output(path, inputs=sources)
        real = _behind_links(target)
        if real in seen:
            raise InputError(f"{target}: is also the output {seen[real]}; expected another name")
        seen[real] = target


def is_same_file(first: str | os.PathLike[str], second: str | os.PathLike[str]) -> bool:
    """Whether two paths lead to one existing file, through links of either kind."""
    try:
        return os.path.samefile(first, second)
    except OSError:
        return False


@contextmanager
def written_beside(path: str | os.PathLike[str]) -> Iterator[Path]:
    """Yield a temporary path in the same folder; rename it to ``path`` if the block succeeds.

    A failure inside the block (an error, a full disk, Ctrl-C) removes the temporary file and leaves
    an older ``path`` as it was. Where ``path`` is a link, the file that it leads to is replaced and
    the link stays. The temporary name keeps the suffix, since encoders look at it.

    Raises:
        InputError: what `check_writable` refuses.
        OSError: it cannot be written (a full disk, no permission); names ``path``.
    """
    with _temporary(path) as (temporary, real):
        os.close(os.open(temporary, os.O_CREAT | os.O_EXCL | os.O_WRONLY, 0o666))
        yield temporary
        os.replace(temporary, real)


@contextmanager
def _temporary(path: str | os.PathLike[str]) -> Iterator[tuple[Path, Path]]:
    """A name beside the file that ``path`` leads to, and that file; raises as `written_beside`.

    What has that name is removed at the end.
    """
    target = check_writable(path)
    real = _behind_links(target)
    # the name is known before the file is there: whatever interrupts, it is found and removed
    temporary = real.with_name(f".{real.stem[:40]}.{token_hex(4)}{target.suffix}")
    try:
        yield temporary, real
    except OSError as error:
        if error.filename not in (None, str(temporary), temporary):
            raise  # of another file
        raise OSError(error.errno, error.strerror or str(error), str(target)) from None
    finally:
        with suppress(OSError):
            temporary.unlink()


def write_durably(path: str | os.PathLike[str], data: bytes) -> None:
    """Write a whole file by `written_beside`; when this returns, a power cut cannot undo it.

    Raises:
        InputError, OSError: as of `written_beside`.
    """
    with written_beside(path) as temporary, temporary.open("wb") as file:
        file.write(data)
        file.flush()
        os.fsync(file.fileno())
    sync_folder(_behind_links(Path(path)).parent)


def sync_folder(folder: Path) -> None:
    """Put a folder's list of names on the disk."""
    if os.name != "posix":  # Windows opens no folders
        return
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def write_once(
    path: str | os.PathLike[str], write: Callable[[Path], object], *, replace: bool = False
) -> bool:
    """Put in place what `write` makes beside, whole, unless a file is there by then.

    Several processes may write the same file: the first one counts.

    Args:
        write: makes the file whose path it is called with; its errors name ``path`` instead.
        replace: put it in place of a file that is there.

    Returns:
        Whether it was put in place.

    Raises:
        InputError, OSError: as for `written_beside`; whatever `write` raises.
    """
    with _temporary(path) as (temporary, real):
        try:
            write(temporary)
        except InputError as error:
            raise InputError(str(error).replace(str(temporary), os.fspath(path))) from None
        if replace:
            os.replace(temporary, real)
            return True
        return _put_in_place(temporary, real)


def _put_in_place(temporary: Path, real: Path) -> bool:
    """Give the file its name, unless that is taken."""
    try:
        os.link(temporary, real)
    except FileExistsError:
        return False
    except OSError:  # the file system has no hard links
        if real.exists():
            return False
        os.replace(temporary, real)
    return True


def remove_leftovers(path: str | os.PathLike[str]) -> None:
    """Remove what was begun beside ``path`` by a process that was killed; nobody may be writing
    ``path`` now."""
    real = _behind_links(Path(path))
    stem = re.escape(real.stem[:39])
    cut = ".?" if len(real.stem) > 39 else ""
    # one token, or two where a writer was given a temporary name and wrote beside that
    name = re.compile(rf"\.{{1,2}}{stem}{cut}(\.[0-9a-f]{{0,8}}){{1,2}}{re.escape(real.suffix)}")
    for found in real.parent.iterdir():
        if name.fullmatch(found.name):
            found.unlink(missing_ok=True)


def _behind_links(path: Path) -> Path:
    """The path of the file itself, there or not."""
    real = Path(os.path.realpath(path))
    if real.is_symlink():
        raise InputError(f"{path}: is a link that leads back to itself; expected a file to write")
    return real
