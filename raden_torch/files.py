"""Files that appear whole or not at all."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path

from raden_torch.errors import InputError


def check_writable(path: str | os.PathLike[str]) -> Path:
    """The path, if a file can be written there; called early, so that no work is lost.

    Raises:
        InputError: the folder does not exist, or ``path`` is a folder.
    """
    target = Path(path)
    if target.is_dir():
        raise InputError(f"{target}: is a folder; name the file to write")
    if not target.parent.is_dir():
        raise InputError(f"{target}: the folder {target.parent} does not exist; create it first")
    return target


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
        InputError: another suffix; a folder that does not exist; or the path is one of the inputs,
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
    an older ``path`` as it was. The temporary name keeps the suffix, since encoders look at it.

    Raises:
        InputError: the folder does not exist, or ``path`` is a folder.
    """
    target = check_writable(path)
    handle, name = tempfile.mkstemp(
        prefix=f".{target.stem}.", suffix=target.suffix, dir=target.parent
    )
    os.close(handle)
    temporary = Path(name)
    try:
        yield temporary
        os.chmod(temporary, 0o666 & ~_umask())
        os.replace(temporary, target)
    finally:
        with suppress(FileNotFoundError):
            temporary.unlink()


def _umask() -> int:
    mask = os.umask(0)
    os.umask(mask)
    return mask
