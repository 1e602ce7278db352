"""One shell of a catalogue, or all its files: catalogue show, get, check."""

from __future__ import annotations

import sys
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from raden_torch.cli.catalogue_commands import Folder
from raden_torch.cli.json_output import AsJson, print_json
from raden_torch.cli.option_types import argument, output
from raden_torch.cli.status import progress
from raden_torch.errors import InputError
from raden_torch.files import check_output, written_beside

if TYPE_CHECKING:
    from raden_torch.catalogue import Catalogue, Entry

ShellId = Annotated[str, argument("a shell's ID, or the digits that it begins with")]
_SHOWN_AT = (0.0, 20.0, 40.0, 60.0, 80.0)


def show(folder: Folder, shell: ShellId, /, *, as_json: AsJson = False) -> None:
    from raden_torch.catalogue import Catalogue

    catalogue = Catalogue(folder)
    entry = catalogue.entry(shell)
    colours = catalogue.mirror_colours(entry, _SHOWN_AT)
    if as_json:
        places = {"path": str(catalogue.file(entry)), "thumbnail": str(catalogue.thumbnail(entry))}
        mirror = [
            {"incidence_deg": at, "lab": lab.tolist()}
            for at, lab in zip(_SHOWN_AT, colours, strict=True)
        ]
        print_json(**asdict(entry), **places, mirror=mirror)
        return
    print("\n".join(_facts(entry, catalogue)))
    from raden_torch.catalogue.colour_query import chroma_and_hue

    print("colour in the mirror direction:")
    for at, lab in zip(_SHOWN_AT, colours, strict=True):
        chroma, hue = chroma_and_hue(lab)
        known = "" if entry.measured_at(at, at, 0.0) else "  (beyond the measured angles)"
        print(f"  {at:3.0f} deg: L* {lab[0]:.1f}, C* {chroma:.1f}, h {hue:.0f}°{known}")


def _facts(entry: Entry, catalogue: Catalogue) -> list[str]:
    lines = [
        f"{entry.name_in_words}: {entry.kind_in_words}",
        f"SHA-256: {entry.sha256}",
        f"file: {entry.file}, {entry.bytes} bytes, added {entry.added}",
        f"kept as: {catalogue.file(entry)}",
        f"thumbnail: {catalogue.thumbnail(entry)}",
    ]
    named = {"date": entry.date, "instrument": entry.instrument, "tags": ", ".join(entry.tags)}
    named |= {"note": entry.note, **entry.header}
    lines += [f"{name}: {text}" for name, text in named.items() if text]
    axes = zip(("incidence", "receiving", "tilt"), entry.box_deg, strict=False)
    box = ", ".join(f"{name} {low:g}…{high:g}" for name, (low, high) in axes)
    lines += [f"measured: {box} deg"] if box else []
    fit = entry.fit
    if "interpolation" in fit:
        lines.append(
            f"fit: {fit['interpolation']}, {fit['measured']} of {fit['cells']} nodes measured, "
            f"residual {fit['reading_rms']:.2e} of the 99.9 % quantile (--json has all of it)"
        )
    return lines + [f"warning of the fit: {text}" for text in fit.get("warnings", ())]


def get(
    folder: Folder,
    shell: ShellId,
    /,
    *,
    output: Annotated[Path, output("the file to write, as it was added")],
) -> None:
    from raden_torch.catalogue import Catalogue

    catalogue = Catalogue(folder)
    entry = catalogue.entry(shell)
    check_output(output, inputs=(catalogue.file(entry),))
    data = catalogue.content(entry)
    with written_beside(output) as temporary:
        temporary.write_bytes(data)
    print(f"wrote {output}: {entry.file} as it was added, SHA-256 {entry.sha256}")


def check(folder: Folder, /) -> None:
    from raden_torch.catalogue import Catalogue

    catalogue = Catalogue(folder)
    damaged = 0
    with progress("reading") as share_done:
        for line in catalogue.damages(share_done):
            damaged += 1
            print(f"raden: {line}", file=sys.stderr)
    if damaged:
        raise InputError(f"{folder}: {damaged} of {len(catalogue)} shells are damaged or missing")
    print(f"{folder}: {len(catalogue)} shells, each as it was added")
