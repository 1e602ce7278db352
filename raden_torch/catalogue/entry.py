"""One shell of a catalogue: where it came from, and what is known of it without opening it."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass, fields
from typing import Any, Literal

Kind = Literal["measurement", "model"]
SHORT = 12
"""Hexadecimal digits of an ID as it is shown; any that begin only one are enough to ask by."""


@dataclass(frozen=True)
class Entry:
    """What the index says of one shell beside its colours.

    Attributes:
        sha256: of the file's bytes, 64 hexadecimal digits: the ID.
        number: of its folder, from 0 in the order of adding.
        kind: what the file is.
        name: the sample's, as its file says.
        file: the name of the file that was added, without its folder.
        bytes: its size.
        added: when, ISO 8601 in UTC.
        date: of the measurement as the file's header has it; may be empty.
        instrument: as the file's header has it; may be empty.
        simulated: the values were computed, not measured.
        tags, note: given when it was added.
        header: further entries of the file's header.
        fit: the fit's report (`FitReport.as_dict`); empty where a model has none.
        box_deg: first and last incidence, receiving and tilt that were measured; may be empty.
    """

    sha256: str
    number: int
    kind: Kind
    name: str
    file: str
    bytes: int
    added: str
    date: str
    instrument: str
    simulated: bool
    tags: tuple[str, ...]
    note: str
    header: dict[str, str]
    fit: dict[str, Any]
    box_deg: tuple[tuple[float, float], ...]

    @property
    def short_id(self) -> str:
        return self.sha256[:SHORT]

    @property
    def kind_in_words(self) -> str:
        return f"simulated {self.kind}" if self.simulated else self.kind

    @property
    def name_in_words(self) -> str:
        return self.name or "(unnamed)"

    def as_row(self) -> dict[str, Any]:
        """For the index; what has no columns of its own is JSON."""
        row = asdict(self)
        return {
            **row,
            "tags": list(self.tags),
            **{name: json.dumps(row[name], ensure_ascii=False) for name in _AS_JSON},
        }

    @classmethod
    def of_row(cls, row: dict[str, Any]) -> Entry:
        """The inverse of `as_row`."""
        known = {field.name: row[field.name] for field in fields(cls)}
        known |= {name: json.loads(row[name]) for name in _AS_JSON}
        known["tags"] = tuple(row["tags"])
        known["box_deg"] = tuple((low, high) for low, high in known["box_deg"])
        return cls(**known)

    def measured_at(self, incidence: float, receiving: float, tilt: float) -> bool:
        """Whether a geometry lies within the angles that were measured."""
        at = zip(self.box_deg, (incidence, receiving, tilt), strict=False)
        return bool(self.box_deg) and all(low <= x <= high for (low, high), x in at)


_AS_JSON = ("header", "fit", "box_deg")
COLUMNS = tuple(field.name for field in fields(Entry))
