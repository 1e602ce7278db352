"""The index, asked: shells by their colour at an angle, and one shell's colours at many."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from raden_torch.arrays import Floats
from raden_torch.catalogue.colour_query import ColourQuery, Geometry
from raden_torch.catalogue.entry import COLUMNS, Entry, Kind
from raden_torch.catalogue.lab_grid import SHAPE, columns_at, within
from raden_torch.catalogue.store import Store

if TYPE_CHECKING:
    import pyarrow as pa


@dataclass(frozen=True)
class Found:
    """A shell that was looked for.

    Attributes:
        lab: L*, a*, b* at the geometry that was asked for; None where no colour was.
        score: by the query's formula; None without one.
        measured: whether the geometry lies within the angles that were measured.
    """

    entry: Entry
    lab: tuple[float, float, float] | None = None
    score: float | None = None
    measured: bool | None = None


@dataclass(frozen=True)
class Which:
    """Only shells of this kind, with all of these tags, with this text in the name or the file's
    name."""

    kind: Kind | None = None
    tags: frozenset[str] = frozenset()
    name: str = ""

    def rows(self, table: pa.Table) -> list[int]:
        """The rows of a table that are meant."""
        text = self.name.casefold()
        columns = (table[c].to_pylist() for c in ("kind", "tags", "name", "file"))
        return [
            row
            for row, (kind, tags, name, file) in enumerate(zip(*columns, strict=True))
            if self.kind in (None, kind)
            and self.tags <= set(tags)
            and (text in name.casefold() or text in file.casefold())
        ]


def search(
    store: Store, colour: ColourQuery | None, at: Geometry, which: Which, limit: int | None
) -> list[Found]:
    """What `Catalogue.find` does."""
    parts = columns_at(at) if colour else {}
    table = store.read((*COLUMNS, *parts))
    rows = np.array(which.rows(table), int)
    if not len(rows):
        return []
    if colour is None:
        return [Found(entry) for entry in _entries(table, rows[:limit])]
    lab = _colours(table, at)[rows]
    scores = colour.scores(lab)
    order = np.argsort(scores if colour.best_is_least else -scores, kind="stable")[:limit]
    angles = at.incidence_deg, at.receiving, at.tilt_deg
    return [
        Found(entry, (x, a, b), float(score), entry.measured_at(*angles))
        for entry, (x, a, b), score in zip(
            _entries(table, rows[order]), lab[order].tolist(), scores[order], strict=True
        )
    ]


def colours_of(store: Store, entry: Entry, at: Sequence[Geometry]) -> Floats:
    """`[K, 3]` L*, a*, b* of a shell."""
    columns = {name for one in at for name in columns_at(one)}
    table = store.read(("sha256", *sorted(columns)))
    row = table.take([table["sha256"].to_pylist().index(entry.sha256)])
    return np.concatenate([_colours(row, one) for one in at])


def _entries(table: pa.Table, rows: Floats) -> list[Entry]:
    return [Entry.of_row(row) for row in table.select(COLUMNS).take(rows).to_pylist()]


def _colours(table: pa.Table, at: Geometry) -> Floats:
    """`[N, 3]` L*, a*, b* of all rows."""
    parts = columns_at(at).items()
    return np.asarray(sum(weight * within(_nodes(table, name), at) for name, weight in parts))


def _nodes(table: pa.Table, name: str) -> Floats:
    """`[N, D, T, 3]`: a column of colours."""
    flat = table[name].combine_chunks().flatten().to_numpy(zero_copy_only=False)
    return np.asarray(flat.reshape(-1, *SHAPE[1:]))
