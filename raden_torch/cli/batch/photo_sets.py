"""capture batch: a folder of photograph sets, each by its own set.toml.

    [lights]                       # steps of `raden capture`, with the options that they have
    photos = "chrome.*.png"        # a pattern, or a list of them; sorted by name, as a shell does
    mask = "ball.png"              # paths are seen from the set's folder
    [normals]
    photos = "box.*.png"
    lights = "lights.json"

`defaults.toml` beside the sets has the same tables: what all sets share. A set's own keys come
first; `normals = false` leaves a step out.
"""

from __future__ import annotations

import sys
import tomllib
from collections.abc import Mapping
from glob import glob
from pathlib import Path
from typing import Annotated, Any

from cyclopts import Parameter

from raden_torch.cli.batch.job import Job, Outcome
from raden_torch.cli.batch.report import Batch
from raden_torch.cli.batch.table_arguments import arguments_of
from raden_torch.cli.endings import WRONG_INPUT
from raden_torch.cli.option_types import argument
from raden_torch.errors import InputError
from raden_torch.files import check_output
from raden_torch.schema import nearest, read_document

SET_FILE, DEFAULTS_FILE = "set.toml", "defaults.toml"
OUTPUTS = {
    "calibrate": "camera.json",
    "colour": "colour.json",
    "lights": "lights.json",
    "normals": "normals",
    "brdf": "{name}.csv",
    "segment": "map.png",
}
"""What each step writes unless told, in the order in which the steps run."""


def batch(
    folder: Annotated[Path, argument(f"the folder with the sets, each with a {SET_FILE}")],
    /,
    *,
    force: Annotated[bool, Parameter(help="run sets again that are done")] = False,
    report: Annotated[
        Path | None,
        Parameter(help="the report, .json; by default report.json in the folder; .txt beside it"),
    ] = None,
) -> None:
    if not folder.is_dir():
        raise InputError(f"{folder}: expected a folder of photograph sets, got none")
    target = folder / "report.json" if report is None else report
    check_output(target, (".json",))
    found = photo_sets(folder)
    made = Batch(f"photograph sets in {folder}", target, list(found))
    for place in sorted(folder.glob("[!.]*/")):
        if place.name not in found:
            print(f"raden: {place}: left out, no {SET_FILE}", file=sys.stderr)
    with made.alone():
        for name, job in found.items():
            if isinstance(job, InputError):
                made.record(Outcome(name, "failed", str(job), WRONG_INPUT))
            elif not force and made.is_done(job):
                made.skip(job)
            else:
                made.run(job)
    made.finish()


def photo_sets(folder: Path) -> dict[str, Job | InputError]:
    """The sets of a folder by name, in the order of their names; of one whose file is wrong, what
    is wrong.

    Raises:
        InputError: no set, or a wrong `defaults.toml`.
    """
    shared = folder / DEFAULTS_FILE
    defaults = _tables(shared) if shared.is_file() else {}
    folders = sorted(path.parent for path in folder.glob(f"*/{SET_FILE}"))
    if not folders:
        raise InputError(f"{folder}: expected folders with a {SET_FILE}, got none")
    found: dict[str, Job | InputError] = {}
    for place in folders:
        try:
            found[place.name] = _job(place, _tables(place / SET_FILE), defaults)
        except InputError as error:
            found[place.name] = error
    return found


def _tables(path: Path) -> dict[str, Any]:
    document = read_document(path, "a file about photographs", tomllib.loads)
    for step, table in document.items():
        if step not in OUTPUTS:
            raise InputError(
                f"{path}: expected the steps {', '.join(OUTPUTS)}, got "
                f"{step!r}{nearest(step, OUTPUTS)}"
            )
        if table is not False and not isinstance(table, dict):
            raise InputError(f"{path}: {step}: expected a table or false, got {table!r:.60}")
    return dict(document)


def _job(folder: Path, own: Mapping[str, Any], defaults: Mapping[str, Any]) -> Job:
    commands, outputs = [], []
    for step, usual in OUTPUTS.items():
        if own.get(step) is False or step not in {*own, *defaults}:
            continue
        shared = defaults.get(step) or {}
        table = {"output": usual.format(name=folder.name), **shared, **own.get(step, {})}
        if step not in own and not shared:
            continue
        where = f"{folder / SET_FILE}: {step}"
        photos = _photographs(folder, table.pop("photos", None), where)
        commands.append(("capture", step, *photos, *arguments_of(table, where)))
        outputs.append(str(table["output"]))
    if not commands:
        raise InputError(f"{folder / SET_FILE}: expected a step of {', '.join(OUTPUTS)}, got none")
    return Job(folder.name, folder, tuple(commands), tuple(outputs))


def _photographs(folder: Path, patterns: Any, where: str) -> list[str]:
    """Seen from the folder; sorted within each pattern."""
    listed = [patterns] if isinstance(patterns, str) else patterns
    if not isinstance(listed, list) or not all(isinstance(one, str) for one in listed):
        raise InputError(f"{where}: photos: expected a pattern or a list of them, got {patterns!r}")
    found = []
    for pattern in listed:
        matching = sorted(glob(pattern, root_dir=folder))
        if not matching:
            raise InputError(f"{where}: photos: expected files as {pattern}, got none")
        found += matching
    return found
