"""`Catalogue`: add shells, find them by colour and angle, take them out as they went in."""

from __future__ import annotations

import hashlib
import os
import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from raden_torch.arrays import Floats
from raden_torch.catalogue.colour_query import ColourQuery, Geometry
from raden_torch.catalogue.entry import COLUMNS, Entry
from raden_torch.catalogue.index_table import single_row
from raden_torch.catalogue.lab_grid import column
from raden_torch.catalogue.search import Found, Which, colours_of, search
from raden_torch.catalogue.store import THUMBNAIL, Store
from raden_torch.errors import InputError
from raden_torch.files import check_seekable, write_durably

if TYPE_CHECKING:
    import pyarrow as pa

    from raden_torch.catalogue.indexing import Indexed

WAIT_S = 60.0
_MAX_BYTES = 2_000_000_000
_LEAST_DIGITS = 4


@dataclass(frozen=True)
class Added:
    """What became of a file: the shell's entry, and whether it is `new`, was there and had to be
    `restored` from the file, or was there ("known")."""

    entry: Entry
    state: Literal["new", "known", "restored"]


class Catalogue:
    """A folder with shells. Any number of processes may read it, while one adds to it.

    Args:
        folder: of the catalogue.
        create: begin one where the folder is not there or empty.

    Raises:
        InputError: no catalogue, a damaged one, or one of a newer version.

    Examples:
        >>> from raden_torch.catalogue import Catalogue, ColourQuery, Geometry
        >>> shells = Catalogue("shells", create=True)  # doctest: +SKIP
        >>> shells.add("yakogai.csv", tags=["Tokyo"]).state  # doctest: +SKIP
        'new'
        >>> found = shells.find(ColourQuery.read("green"), Geometry(40))  # doctest: +SKIP
    """

    def __init__(self, folder: str | os.PathLike[str], *, create: bool = False) -> None:
        self._store = Store(Path(folder), create=create)
        self.folder = Path(folder)

    def __len__(self) -> int:
        return self._store.contents().entries

    def add(
        self,
        path: str | os.PathLike[str],
        *,
        tags: Sequence[str] = (),
        note: str = "",
        assume: Literal["isotropic"] | None = None,
        wait_s: float = WAIT_S,
    ) -> Added:
        """Add a measurement or a model, kept byte for byte. It is there when this returns.

        Args:
            tags, note: kept with it, one line each.
            assume: of a measurement, as for `fit`.
            wait_s: how long to wait for another process that adds.

        Raises:
            InputError: a file of another kind; one that cannot be fitted; a palette; another
                process writes for longer than `wait_s`.
            OSError: a full disk, no permission.
        """
        from raden_torch.catalogue.indexing import index_file

        path = Path(path)
        _check_lines(*tags, note)
        data = _bytes_of(path)
        sha256 = hashlib.sha256(data).hexdigest()
        if not self._has(sha256):
            indexed = index_file(path, assume)
            if _bytes_of(path) != data:
                raise InputError(f"{path}: expected a file that stays, got one that has changed")
        with self._store.writing(wait_s) as add:
            if self._has(sha256):  # since before, or by another process meanwhile
                return self._known(self.entry(sha256), data, path, assume)
            entry = _entry(path, data, sha256, indexed, tags, note)
            files = {self.file(entry).name: data, THUMBNAIL: indexed.thumbnail}
            number = add(_row(entry, indexed), files)
            return Added(Entry.of_row({**entry.as_row(), "number": number}), "new")

    def _known(
        self, entry: Entry, data: bytes, path: Path, assume: Literal["isotropic"] | None
    ) -> Added:
        """A shell that is added again, whose folder may have been damaged since."""
        from raden_torch.catalogue.indexing import index_file

        lost = {}
        try:
            self.content(entry)
        except InputError:
            lost[self.file(entry)] = data
        if not self.thumbnail(entry).is_file():
            lost[self.thumbnail(entry)] = index_file(path, assume).thumbnail
        for place, content in lost.items():
            place.parent.mkdir(exist_ok=True)
            write_durably(place, content)
        return Added(entry, "restored" if lost else "known")

    def find(
        self,
        colour: ColourQuery | None = None,
        at: Geometry | None = None,
        *,
        kind: Literal["measurement", "model"] | None = None,
        tags: Sequence[str] = (),
        name: str = "",
        limit: int | None = None,
    ) -> list[Found]:
        """Shells, the best first; without a colour in the order in which they were added.

        The colours are the index's, linear between the nodes of `lab_grid`.

        Args:
            at: where the colour is looked for; None: in the mirror direction at 40° of incidence.
            kind, tags, name: only those of this kind, with all of these tags, with this text in
                the name or the file's name.
            limit: the most that are wanted; None: all.
        """
        return search(
            self._store, colour, at or Geometry(), Which(kind, frozenset(tags), name), limit
        )

    def entry(self, short_id: str) -> Entry:
        """The shell whose ID begins so.

        Raises:
            InputError: no such shell, or several.
        """
        wanted = short_id.strip().lower()
        if not re.fullmatch(rf"[0-9a-f]{{{_LEAST_DIGITS},64}}", wanted):
            raise InputError(
                f"{self.folder}: expected an ID of {_LEAST_DIGITS} to 64 hexadecimal digits, got "
                f"{short_id!r}"
            )
        table = self._store.read(COLUMNS)
        ids = table["sha256"].to_pylist()
        rows = [row for row, known in enumerate(ids) if known.startswith(wanted)]
        if len(rows) != 1:
            got = f"{len(rows)} shells" if rows else "none"
            raise InputError(
                f"{self.folder}: expected one shell whose ID begins with {wanted}, got {got}"
            )
        return Entry.of_row(table.take(rows).to_pylist()[0])

    def mirror_colours(self, entry: Entry, incidence_deg: Sequence[float]) -> Floats:
        """`[K, 3]` L*, a*, b* of a shell in the mirror direction at these angles, 0…80."""
        return colours_of(self._store, entry, [Geometry(at) for at in incidence_deg])

    def file(self, entry: Entry) -> Path:
        """A shell's own file in the catalogue; `content` reads and checks it."""
        return self._store.shell(entry.number) / _file_name(entry.sha256, entry.file)

    def thumbnail(self, entry: Entry) -> Path:
        """A small picture of a lit sphere, PNG."""
        return self._store.shell(entry.number) / THUMBNAIL

    def content(self, entry: Entry) -> bytes:
        """The file as it was added, byte for byte.

        Raises:
            InputError: it is missing or damaged.
        """
        path = self.file(entry)
        again = f"restore it from a copy, or add {entry.file} again"
        try:
            data = path.read_bytes()
        except FileNotFoundError:
            raise InputError(f"{path}: expected {entry.name}'s file, got none; {again}") from None
        found = hashlib.sha256(data).hexdigest()
        if found != entry.sha256:
            raise InputError(
                f"{path}: expected {entry.bytes} bytes with this SHA-256, got {len(data)} with "
                f"{found}: damaged; {again}"
            )
        return data

    def damages(self, shown: Callable[[float], object] = lambda share: None) -> Iterator[str]:
        """Read every shell's file, and say of each that is missing or damaged what is wrong.

        Args:
            shown: called with the share that is done.

        Raises:
            InputError: the index is damaged.
        """
        self._store.check_index()
        every = self.find()
        for done, found in enumerate(every, 1):
            try:
                self.content(found.entry)
                if not (picture := self.thumbnail(found.entry)).is_file():
                    yield f"{picture}: expected a thumbnail, got none; add {found.entry.file} again"
            except InputError as error:
                yield str(error)
            shown(done / len(every))

    def _has(self, sha256: str) -> bool:
        import pyarrow.compute as pc

        ids = self._store.read(["sha256"])["sha256"]
        return len(ids) > 0 and bool(pc.index(ids, sha256).as_py() >= 0)


def _bytes_of(path: Path) -> bytes:
    check_seekable(path)
    size = path.stat().st_size
    if size > _MAX_BYTES:
        raise InputError(f"{path}: expected at most {_MAX_BYTES / 1e9:g} GB, got {size} bytes")
    return path.read_bytes()


def _check_lines(*texts: str) -> None:
    for text in texts:
        if text and not text.isprintable():
            raise InputError(f"tags and note: expected one printable line each, got {text!r}")


def _file_name(sha256: str, name: str) -> str:
    """In the shell's folder; programs go by the suffix, which stays where it is a plain one."""
    suffix = Path(name).suffix.lower()
    return sha256 + (suffix if re.fullmatch(r"\.[a-z0-9]{1,20}", suffix) else "")


def _entry(
    path: Path, data: bytes, sha256: str, indexed: Indexed, tags: Sequence[str], note: str
) -> Entry:
    """Of a shell that is new, and has no number yet."""
    return Entry(
        sha256=sha256,
        number=-1,
        kind=indexed.kind,
        name=indexed.name,
        file=path.name,
        bytes=len(data),
        added=datetime.now(UTC).isoformat(timespec="seconds"),
        date=indexed.date,
        instrument=indexed.instrument,
        simulated=indexed.simulated,
        tags=tuple(tags),
        note=note,
        header=indexed.header,
        fit=indexed.fit,
        box_deg=indexed.box_deg,
    )


def _row(entry: Entry, indexed: Indexed) -> pa.Table:
    facts = entry.as_row()
    del facts["number"]  # the store's to give
    return single_row(facts | {column(k): lab for k, lab in enumerate(indexed.lab)})
