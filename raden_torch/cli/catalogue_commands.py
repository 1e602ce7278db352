"""Catalogues of shells: catalogue add, find."""

from __future__ import annotations

import sys
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from cyclopts import Parameter

from raden_torch.cli.endings import in_options
from raden_torch.cli.json_output import AsJson, print_json
from raden_torch.cli.option_types import argument, files
from raden_torch.cli.status import progress
from raden_torch.errors import InputError

if TYPE_CHECKING:
    from raden_torch.catalogue import Added, Catalogue, Found, Geometry

Folder = Annotated[Path, argument("the folder of the catalogue")]


@Parameter(name="*")
@dataclass(frozen=True)
class AddOptions:
    """What is kept with the shells."""

    tag: tuple[str, ...] = ()
    """a word to find them by; may be repeated"""
    note: str = ""
    """a line that is kept with them"""
    assume: Literal["isotropic"] | None = None
    """assumed symmetry of measured samples: one plane, one view or one side is then enough"""
    wait_s: Annotated[float, Parameter(name="--wait")] = 60.0
    """how long to wait for another process that adds, seconds"""


def add(
    folder: Folder,
    /,
    *shells: Annotated[Path, files("measurements or models, one shell each")],
    what: AddOptions = AddOptions(),
    as_json: AsJson = False,
) -> None:
    from raden_torch.catalogue import Catalogue

    catalogue = Catalogue(folder, create=True)
    done: list[Added] = []
    failed: list[str] = []
    with progress("adding") as share_done:
        for place, path in enumerate(shells):
            try:
                added = _added(catalogue, path, what)
            except InputError as error:
                failed.append(str(error))
                print(f"raden: {in_options(str(error), sys.argv[1:])}", file=sys.stderr)
            else:
                done.append(added)
                if not as_json:
                    print(_in_words(path, added), flush=True)
            share_done((place + 1) / len(shells))
    if as_json:
        states = [{"state": a.state, **asdict(a.entry)} for a in done]
        print_json(shells=states, failed=failed)
    else:
        print(f"{folder}: {len(catalogue)} shells")
    if failed:
        raise InputError(f"catalogue add: {len(failed)} of {len(shells)} files were not added")


def _added(catalogue: Catalogue, path: Path, what: AddOptions) -> Added:
    try:
        return catalogue.add(
            path, tags=what.tag, note=what.note, assume=what.assume, wait_s=what.wait_s
        )
    except FileNotFoundError as error:
        raise InputError(f"{error.filename}: expected a file, got none") from None


def _in_words(path: Path, added: Added) -> str:
    said = {
        "new": "added",
        "known": "is in the catalogue already, unchanged",
        "restored": "is in the catalogue already; its file there was damaged, now restored",
    }
    return f"{added.entry.short_id}  {path.name}: {said[added.state]}"


@Parameter(name="*")
@dataclass(frozen=True)
class FindOptions:
    """Which shells, and where their colour is looked at."""

    colour: str | None = None
    """a name (green, 緑), a hue angle in degrees (162), #rrggbb or lab:L,a,b; without one, shells
    in the order in which they were added"""
    incidence_deg: Annotated[float, Parameter(name="--at")] = 40.0
    """incidence, degrees, 0…80"""
    receiving_deg: float | None = None
    """receiving, degrees, −80…80; by default the mirror direction"""
    tilt_deg: float = 0.0
    """tilt, degrees, −60…60"""
    rank: Literal["chroma", "saturation"] = "chroma"
    """how a hue is ranked: by chroma towards it, or by that beside the lightness"""
    kind: Literal["measurement", "model"] | None = None
    """only measurements, or only models"""
    tag: tuple[str, ...] = ()
    """only shells with this tag; may be repeated"""
    name: str = ""
    """only shells with this text in their name or file"""
    limit: int = 10
    """how many are shown; 0: all"""
    sheet: Path | None = None
    """also a picture of what was found: .png, .svg or .pdf"""

    def __post_init__(self) -> None:
        if self.limit < 0:
            raise InputError(f"--limit: expected 0 or more, got {self.limit}")


def find(folder: Folder, /, *, what: FindOptions = FindOptions(), as_json: AsJson = False) -> None:
    from raden_torch.catalogue import Catalogue, ColourQuery, Geometry

    if what.sheet is not None:
        from raden_torch.plots import check_plot_path

        check_plot_path(what.sheet)
    colour = None if what.colour is None else ColourQuery.read(what.colour, what.rank)
    at = Geometry(what.incidence_deg, what.receiving_deg, what.tilt_deg)
    catalogue = Catalogue(folder)
    found = catalogue.find(
        colour, at, kind=what.kind, tags=what.tag, name=what.name, limit=what.limit or None
    )
    if colour is None:
        title = f"{len(found)} of {len(catalogue)} shells, as they were added"
    else:
        title = f"{colour.text}, {len(found)} of {len(catalogue)} shells: {colour.formula}; {at}"
    if what.sheet is not None and found:
        from raden_torch.catalogue.contact_sheet import draw_sheet
        from raden_torch.plots import save_plot

        save_plot(draw_sheet(catalogue, found, title), what.sheet)
    if as_json:
        print_json(**_found_json(found, colour.formula if colour else None, at))
        return
    print(title)
    for place, one in enumerate(found, 1):
        print(_found_line(place, one))
    if any(one.measured is False for one in found):
        print("* beyond the measured angles, or it is not known which were")
    if what.sheet is not None and found:
        print(f"wrote {what.sheet}")


def _found_line(place: int, found: Found) -> str:
    from raden_torch.catalogue.colour_query import chroma_and_hue

    entry = found.entry
    said = ""
    if found.lab is not None:
        chroma, hue = chroma_and_hue(found.lab)
        star = " " if found.measured else "*"
        said = f"{found.score:8.3g}{star} L* {found.lab[0]:5.1f}  C* {chroma:5.1f}  h {hue:5.1f}°  "
    tags = f"  [{', '.join(entry.tags)}]" if entry.tags else ""
    return (
        f"{place:4}  {entry.short_id}  {said}{entry.name_in_words}, {entry.file}, "
        f"{entry.kind_in_words}{tags}"
    )


def _found_json(found: list[Found], formula: str | None, at: Geometry) -> dict[str, Any]:
    where = {"incidence_deg": at.incidence_deg, "receiving_deg": at.receiving}
    shells = [
        {
            "id": one.entry.sha256,
            "name": one.entry.name,
            "file": one.entry.file,
            "kind": one.entry.kind,
            "simulated": one.entry.simulated,
            "tags": one.entry.tags,
            "lab": one.lab,
            "score": one.score,
            "measured": one.measured,
        }
        for one in found
    ]
    return {"formula": formula, **where, "tilt_deg": at.tilt_deg, "shells": shells}
