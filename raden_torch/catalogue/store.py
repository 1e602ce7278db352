"""The folder of a catalogue: files that are only ever added, and one that says which of them count.

    catalogue.json          the format's version, the next number, and the index files that count
    index/000017.parquet    a row for each of some shells, written once
    shells/000017/          one shell: its file, named by its SHA-256, and thumbnail.png
    writer.lock             held by the process that writes (flock)

Replacing `catalogue.json` is what adds a shell: before it, readers see the catalogue without, after
it with. What a writer that was killed has left behind is named by no `catalogue.json`, and stands
where the next writer looks: under the next number, and in `index/`.

A shell's row is written together with the rows of the last index files that have no more of them
(as a binary counter carries): n shells lie in at most log₂ n + 1 files, and a row is written
log₂ n times.
"""

from __future__ import annotations

import hashlib
import shutil
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import msgspec
from msgspec import Meta

from raden_torch.catalogue.index_table import as_parquet, read_parquet
from raden_torch.errors import InputError
from raden_torch.files import sync_folder, write_durably
from raden_torch.schema import Count, checked, read_document
from raden_torch.writer_lock import writer_lock

if TYPE_CHECKING:
    import pyarrow as pa

FORMAT = "raden_torch catalogue"
VERSION = 1
THUMBNAIL = "thumbnail.png"
_CONTENTS = "catalogue.json"
_LOCK = "writer.lock"
_TRIES = 100
"""Of a reader, each of which a writer has to overtake."""


class _NoCatalogueError(InputError):
    """What is there instead."""


class Segment(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """An index file, how many rows it has, and its hash."""

    file: Annotated[str, Meta(pattern=r"\A\d{6,}\.parquet\Z", description="a name of digits")]
    entries: Count
    sha256: str


class Contents(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """What `catalogue.json` holds."""

    format: str
    version: int
    next: Count
    segments: tuple[Segment, ...]

    @property
    def entries(self) -> int:
        return sum(segment.entries for segment in self.segments)


class Store:
    """A catalogue's folder; see the head of this file.

    Args:
        create: begin a catalogue where the folder is not there or empty.

    Raises:
        InputError: no catalogue, a damaged one, or one of a newer version.
    """

    def __init__(self, folder: Path, *, create: bool = False) -> None:
        self.folder = folder
        if create and _is_empty(folder):
            self._begin()
        try:
            self.contents()
        except _NoCatalogueError as error:
            new = ", or a new or empty one" if create else ""
            raise InputError(
                f"{folder}: expected the folder of a catalogue{new}, got {error}"
            ) from None

    def contents(self) -> Contents:
        """What counts now; raises InputError as the class does."""
        path = self.folder / _CONTENTS
        if not path.is_file():
            if not self.folder.exists():
                raise _NoCatalogueError("no folder")
            if not self.folder.is_dir():
                raise _NoCatalogueError("a file")
            raise _NoCatalogueError(f"one without {_CONTENTS}")
        document = read_document(path, "the contents of a catalogue")
        said = document if isinstance(document, dict) else {}
        if said.get("format") != FORMAT:
            raise InputError(f"{path}: expected the format {FORMAT!r}, got {said.get('format')!r}")
        version = said.get("version")
        if isinstance(version, int) and version > VERSION:
            raise InputError(
                f"{path}: expected version {VERSION} or older, got {version}: a newer raden_torch "
                "wrote it; update this one"
            )
        return checked(document, Contents, str(path))

    def read(self, columns: Sequence[str]) -> pa.Table:
        """The rows of all shells, in the order in which they were added.

        Raises:
            InputError: an index file is damaged or missing.
        """
        import pyarrow as pa

        before = self.contents()
        for _ in range(_TRIES):
            try:
                tables = [self._segment(segment, columns) for segment in before.segments]
                return pa.concat_tables(tables) if tables else pa.table({c: [] for c in columns})
            except FileNotFoundError as error:  # joined with others since, or gone
                now = self.contents()
                if now == before:
                    raise InputError(
                        f"{error.filename}: expected an index file that {_CONTENTS} names, got "
                        "none; restore it from a copy"
                    ) from None
                before = now
        raise InputError(f"{self.folder}: expected to read it between two additions, could not")

    def _segment(self, segment: Segment, columns: Sequence[str] | None = None) -> pa.Table:
        path = self.folder / "index" / segment.file
        table = read_parquet(path, columns)
        if table.num_rows != segment.entries:
            raise InputError(f"{path}: expected {segment.entries} rows, got {table.num_rows}")
        return table

    def check_index(self) -> None:
        """Raise InputError where an index file is not as it was written.

        `read` sees damage in the pages that it reads; here every byte counts.
        """
        for segment in self.contents().segments:
            path = self.folder / "index" / segment.file
            if hashlib.sha256(path.read_bytes()).hexdigest() != segment.sha256:
                raise InputError(
                    f"{path}: expected the SHA-256 that {_CONTENTS} says, got another: damaged; "
                    "restore it from a copy"
                )

    def shell(self, number: int) -> Path:
        """The folder of one shell."""
        return self.folder / "shells" / f"{number:06d}"

    @contextmanager
    def writing(self, wait_s: float) -> Iterator[Callable[[pa.Table, dict[str, bytes]], int]]:
        """Be the one writer in the block; yields what adds a shell.

        It takes the shell's row, without its `number`, and the files of its folder by name, and
        returns the number.

        Raises:
            InputError: another process writes for longer than `wait_s`; the catalogue is damaged.
            OSError: a full disk, no permission.
        """
        with writer_lock(self.folder / _LOCK, wait_s, "; `wait_s` waits longer"):
            self._clear()
            try:
                yield self._add
            except BaseException:
                with suppress(OSError, InputError):
                    self._clear()
                raise

    def _add(self, row: pa.Table, files: dict[str, bytes]) -> int:
        import pyarrow as pa

        before = self.contents()
        number = before.next
        folder = self.shell(number)
        folder.mkdir()
        for name, data in files.items():
            write_durably(folder / name, data)
        sync_folder(folder.parent)
        tables = [row.append_column("number", pa.array([number], pa.int64()))]
        kept, entries = list(before.segments), 1
        while kept and kept[-1].entries <= entries:
            tables.insert(0, self._segment(kept[-1]))
            entries += kept.pop().entries
        columns = tables[-1].column_names
        joined = as_parquet(pa.concat_tables([table.select(columns) for table in tables]))
        sha256 = hashlib.sha256(joined).hexdigest()
        segment = Segment(f"{number:06d}.parquet", entries, sha256)
        write_durably(self.folder / "index" / segment.file, joined)
        self._replace(Contents(FORMAT, VERSION, number + 1, (*kept, segment)))
        for joint in before.segments[len(kept) :]:
            (self.folder / "index" / joint.file).unlink()
        return number

    def _replace(self, contents: Contents) -> None:
        write_durably(self.folder / _CONTENTS, msgspec.json.format(msgspec.json.encode(contents)))

    def _begin(self) -> None:
        self.folder.mkdir(parents=True, exist_ok=True)
        with writer_lock(self.folder / _LOCK, wait_s=10.0):
            if not (self.folder / _CONTENTS).exists():  # another process may have been first
                for name in ("index", "shells"):
                    (self.folder / name).mkdir(exist_ok=True)
                self._replace(Contents(FORMAT, VERSION, 0, ()))

    def _clear(self) -> None:
        """Remove what a writer that did not come to its end has left; no reader looks there."""
        contents = self.contents()
        named = {segment.file for segment in contents.segments}
        left = [path for path in (self.folder / "index").iterdir() if path.name not in named]
        left += self.folder.glob(f".{Path(_CONTENTS).stem}.*")
        for path in left:
            path.unlink()
        if self.shell(contents.next).exists():
            shutil.rmtree(self.shell(contents.next))


def _is_empty(folder: Path) -> bool:
    """Not there, or with nothing in it but the beginning of a catalogue that was cut short."""
    if not folder.exists():
        return True
    if not folder.is_dir() or (folder / _CONTENTS).exists():
        return False
    begun = {_LOCK, "index", "shells"}
    return all(
        path.name in begun or path.name.startswith(f".{Path(_CONTENTS).stem}.")
        for path in folder.iterdir()
    )
