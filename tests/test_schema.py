"""Files of ours against their schemas: whatever is changed in one, an error is one line."""

from __future__ import annotations

import copy
import json
import math
import subprocess
import sys
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from random import Random
from typing import Annotated, Any, Literal

import numpy as np
import pytest
from msgspec import Meta, Struct

from raden_torch.brdf.files.model_file import assemble
from raden_torch.capture.photo.brdf.capture_settings import WhiteFactorSpec
from raden_torch.capture.photo.brdf.chart_white import chart_white
from raden_torch.capture.photo.camera import read_camera, read_poses
from raden_torch.capture.photo.colour import read_colour
from raden_torch.capture.photo.lamps import read_lamps
from raden_torch.capture.spectrometer import drivers
from raden_torch.capture.spectrometer.journal import read_journal
from raden_torch.capture.spectrometer.plan_json import plan_from_json
from raden_torch.capture.spectrometer.rig_config import load_rig
from raden_torch.errors import InputError
from raden_torch.info.kinds import describe_file
from raden_torch.relighting import original_lamp
from raden_torch.schema import Finite, Matrix, Positive, Text, Triple, checked, read_document

GONE = object()
ODD = (
    *(True, False, 0, -1, -1.5, 2**63, 10**400, 1e308, -1e308, math.inf, math.nan),
    *("", " ", "x", "x\ny", "\0", "é" * 500, [], [1], [[]], [1, 2, 3, 4], [math.nan] * 3, [{}]),
    *({}, {"x": 1}, {"x - at `$.y": 1}, {"": {}}),
)
TEXTS = (b"", b"\xef\xbb\xbf", b"\xff\xfe\0", b"\0" * 50, b"[" * 50_000, b"{", b"[]", b"3", b"null")

AXIS = {"letter": "A", "limits_deg": [-75, 75], "direction": 1, "zero_deg": 0.5}
RIG = {
    "name": "rig",
    "simulated": True,
    "goniometer": {
        "driver": "grbl",
        "port": "a",
        "baud": 9600,
        "settle_s": 0.5,
        "homing": "manual",
        "axes": {
            "incidence": AXIS,
            "receiving": AXIS | {"letter": "b"},
            "tilt": AXIS | {"letter": "C"},
        },
        "show": {"sample": ["M9"], "white": "manual"},
    },
    "colorimeter": {"driver": "cs2000", "port": "b", "spectrum": True, "xyz_std": 0.01},
    "obstruction": {"angle_deg": 8, "collides": False},
    "white": {"reflectance_factor": 99, "geometry_deg": [45, 0, 0], "relative_std": 0.01},
}
HEAD = {"format": "raden capture", "version": 1, "made_from": ["a.png"], "notes": ["n"]}
LAMP = {
    "photograph": "a.png",
    "direction_to_lamp": [0, 0, 1],
    "intensity": 1.0,
    "tint_rgb": [1, 1, 1],
    "position_mm": [0, 0, 100],
}
POSE = {
    "file": "a.png",
    "corners": 20,
    "reprojection_rms_px": 0.3,
    "rotation_board_to_camera": np.eye(3).tolist(),
    "translation_board_to_camera_m": [0, 0, 1],
}
LENS = [[50, 0, 9], [0, 50, 9], [0, 0, 1]]
RESULTS: dict[str, dict[str, Any]] = {
    "lights": {
        "lamps": [LAMP, LAMP],
        "unit": "mm",
        "response_exponent": 1.0,
        "camera_matrix_px": LENS,
        "camera_distortion": [0] * 5,
    },
    "camera": {
        "camera_matrix_px": LENS,
        "distortion": [0, 0, 0, 0, 0],
        "image_width_px": 20,
        "image_height_px": 20,
        "board": {"columns": 5, "rows": 7, "square_m": 0.04, "marker_m": 0.02, "legacy": None},
        "poses": [POSE, POSE],
    },
    "colour": {
        "method": "least squares",
        "matrix": np.eye(3).tolist(),
        "chart": "ColorChecker Classic, edition 2014",
        "chart_corners_px": [[0, 0], [60, 0], [60, 40], [0, 40]],
        "left_out_delta_e_2000": {"least squares": {"mean": 0.5, "worst": 1.0}},
    },
    "normals": {
        "lamps": [LAMP],
        "files": {"normals": "normals.png"},
        "method": "robust",
        "pixels_solved": 9,
        "median_confidence": 0.9,
        "median_standard_error_deg": 0.5,
    },
    "brdf": {
        "shape": "sphere",
        "grid_step_deg": 5.0,
        "samples": 4321,
        "cells": 100,
        "cells_covered": 25,
        "coverage": 0.25,
        "median_relative_std_percent": {"ridge": {"total": 2.5}},
        "photographs": [{}],
        "next": [{"text": "a lamp"}],
    },
}
READERS: dict[str, list[Callable[[Path], object]]] = {
    "lights": [read_lamps, describe_file],
    "camera": [read_camera, read_poses, describe_file],
    "colour": [read_colour, lambda path: chart_white(path, WhiteFactorSpec("99")), describe_file],
    "normals": [lambda path: original_lamp(path, Path("a.png")), describe_file],
    "brdf": [describe_file],
}
READING = {"range": "ok", "xyz": [1, 2, 3], "integration_s": None, "time_s": 1e9}
PLAN = {
    "name": "p",
    "cells": [[0, 0, 0], [5, 0, 0]],
    "repeats": 1,
    "white_at_each": False,
    "excluded": [[5, 5, 0, "hidden"]],
    "as_given_deg": 5.0,
}
PLANS = (
    {"kind": "fixed", **PLAN},
    {"kind": "adaptive", **PLAN, "candidates": PLAN["cells"], "budget": 2, "target": 0.1},
)
STATED = {
    "zero_std_deg": [0] * 3,
    "position_std_deg": [0] * 3,
    "wavelength_std_nm": 0,
    "xyz_std": 0,
}
LINES: list[dict[str, Any]] = [
    {
        "record": "header",
        "format": 1,
        "plan": PLANS[1],
        "plan_hash": plan_from_json(PLANS[1]).hash,
        "white": {
            "name": "tile",
            "position_deg": [45, 0, 0],
            "xyz": [95, 100, 108],
            "at_cells": [],
            "relative_std": 0.01,
        },
        "reference_every_s": 600,
        "reference_readings": 2,
        "goniometer": "g",
        "colorimeter": "c",
        "simulated": True,
        "sample": "s",
        "started": "now",
        "stated": STATED,
    },
    {"record": "session", "what": "started", "text": "", "time_s": 1e9},
    {"record": "reference", "series": 0, "target": "white", **READING},
    {"record": "fault", "kind": "busy", "text": "", "attempt": 1, "time_s": 1e9},
    {
        "record": "reading",
        "number": 0,
        "cell": 0,
        "target": "sample",
        "angles_deg": [0, 0, 0],
        **READING,
        "nm": [400, 700],
        "radiance": [1, 2, 3],
    },
    {"record": "reading", "number": 1, "cell": 1, "target": "sample", "angles_deg": [5, 0, 0]}
    | READING,
    {
        "record": "decision",
        "after": 2,
        "cells": [],
        "why": "all",
        "estimated_rms": 0.1,
        "estimated_log_error": 0.1,
    },
]
MODEL = {
    "diffuse_gain": 1.0,
    "specular_gain": 1.0,
    "provenance": {"sample": "s", "simulated": True, "fit": {"rms": 0.1}},
    "first_deg": [0, -70, -70],
    "step_deg": [70, 140, 140],
    "pieces": None,
}


def places(value: Any, at: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    if at:
        yield at
    keys = value if isinstance(value, dict) else range(len(value) if isinstance(value, list) else 0)
    for key in keys:
        yield from places(value[key], (*at, key))


def mutations(value: Any) -> Iterator[Any]:
    """Each value taken out, null, or one of some odd ones; each key misspelt."""
    draw = Random(0)
    for *way, last in places(value):
        for odd in (GONE, None, *draw.sample(ODD, 6)):
            changed = copy.deepcopy(value)
            inside = changed
            for key in way:
                inside = inside[key]
            if odd is GONE:
                del inside[last]
            else:
                inside[last] = copy.deepcopy(odd)
            yield changed
        if isinstance(inside, dict):
            changed = copy.deepcopy(value)
            inside = changed
            for key in way:
                inside = inside[key]
            inside[f"{last}_"] = inside.pop(last)
            yield changed


def refused(read: Callable[..., object], given: Any, name: str = "") -> str:
    """What is said; empty where it was read after all."""
    try:
        read(given)
    except InputError as error:
        said = str(error)
        assert said.splitlines() == [said]
        assert name in said
        assert len(said) < 1200
        return said
    return ""


def toml(value: Any) -> str:
    """TOML that `json.dumps` nearly writes; null is left out."""
    if isinstance(value, dict):
        entries = (f"{json.dumps(k)} = {toml(v)}" for k, v in value.items() if v is not None)
        return "{" + ", ".join(entries) + "}"
    if isinstance(value, list):
        return f"[{', '.join(toml(v) for v in value if v is not None)}]"
    if isinstance(value, float):
        return repr(value)  # nan and inf are TOML
    return json.dumps(value, ensure_ascii=False) if isinstance(value, str) else json.dumps(value)


def write_toml(path: Path, content: dict[str, Any]) -> None:
    path.write_text(
        "\n".join(f"{json.dumps(k)} = {toml(v)}" for k, v in content.items() if v is not None),
        encoding="utf-8",
    )


def test_rigs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(drivers, "entry_points", lambda group: ())  # looked up at each reading
    path = tmp_path / "rig.toml"
    write_toml(path, RIG)
    assert load_rig(path).goniometer_settings.axes.receiving.letter == "B"
    said = []
    for changed in mutations(RIG):
        write_toml(path, changed)
        said.append(refused(load_rig, path, path.name))
    assert sum(map(bool, said)) > 0.7 * len(said)
    for text in TEXTS:
        path.write_bytes(text)
        assert refused(load_rig, path, path.name)


@pytest.mark.parametrize("kind", RESULTS)
@pytest.mark.filterwarnings("ignore::RuntimeWarning")
def test_results(tmp_path: Path, kind: str) -> None:
    path = tmp_path / "result.json"
    whole = {**HEAD, "kind": kind, **RESULTS[kind]}
    path.write_text(json.dumps(whole))
    for read in READERS[kind][: len(READERS[kind]) - (kind == "colour")]:
        read(path)  # describing a colour file asks for more of it
    count = some = 0
    for changed in mutations(whole):
        path.write_text(json.dumps(changed))
        wrong = [bool(refused(read, path)) for read in READERS[kind]]
        count += 1
        some += any(wrong)
    assert some > 0.5 * count
    for text in TEXTS:
        path.write_bytes(text)
        for read in READERS[kind]:
            assert refused(read, path, path.name)


def test_journals(tmp_path: Path) -> None:
    path = tmp_path / "scan.jsonl"

    def write(lines: list[dict[str, Any]]) -> None:
        # one more behind, or a changed last line would count as cut
        path.write_text("".join(json.dumps(line) + "\n" for line in [*lines, LINES[1]]))

    write(LINES)
    assert [len(read_journal(path).taken), len(read_journal(path).decisions)] == [2, 1]
    for number, line in enumerate(LINES):
        some = count = 0
        for changed in mutations(line):
            write([*LINES[:number], changed, *LINES[number + 1 :]])
            some += bool(refused(read_journal, path, path.name))
            count += 1
        assert some > 0.5 * count
    for text in TEXTS:
        path.write_bytes(text)
        assert refused(read_journal, path, path.name)


@pytest.mark.parametrize("plan", PLANS, ids=lambda plan: plan["kind"])
def test_plans(plan: dict[str, Any]) -> None:
    for changed in mutations(plan):
        refused(plan_from_json, changed, "plan")
    for other in (None, 3, [], {}):
        assert refused(plan_from_json, other, "plan: kind: expected fixed or adaptive")


def test_models() -> None:
    without_tensors = partial(assemble, tensors={})
    assert without_tensors(MODEL).provenance.sample == "s"
    assert refused(without_tensors, MODEL | {"diffuse_gain": math.nan}, "diffuse_gain")
    for changed in mutations(MODEL):
        refused(without_tensors, changed)


class Inner(Struct, forbid_unknown_fields=True):
    above: Positive = 1.0
    both: Annotated[float, Meta(ge=-5, le=5)] = 1.0
    pair: tuple[Finite, Text] | None = None
    choice: Literal["near", "far"] = "near"
    way: Triple = (0.0, 0.0, 1.0)

    def __post_init__(self) -> None:
        if self.above == 7:
            raise InputError("above: expected any number but 7")


class Outer(Struct, forbid_unknown_fields=True):
    inner: Inner
    count: Annotated[int, Meta(ge=1)] = 1
    rows: tuple[Inner, ...] = ()
    turn: Matrix | None = None
    named: dict[str, Finite] = {}
    flag: bool = False


@pytest.mark.parametrize(
    ("document", "message"),
    [
        ([], "f: expected a table with inner, count, rows, turn, named, flag, got "),
        ({}, "f: inner: expected a table with above, both, pair, choice, way, got none"),
        ({"iner": {}}, "f: iner: expected one of count, .*, got 'iner'; did you mean inner?"),
        ({"inner": {"abov": 1}}, "f: inner.abov: .*, got 'abov'; did you mean above?"),
        (
            {"inner": {"zz": 1}},
            "f: inner.zz: expected one of above, both, choice, pair, way, got 'zz'$",
        ),
        ({"inner": {"above": 0}}, "f: inner.above: expected a number above 0, got 0"),
        ({"inner": {"above": math.nan}}, "f: inner.above: expected a number above 0, got nan"),
        ({"inner": {"above": math.inf}}, "f: inner.above: expected a number above 0, got inf"),
        ({"inner": {"above": 7}}, "f: inner: above: expected any number but 7"),
        ({"inner": {"both": "1"}}, "f: inner.both: expected a number in -5…5, got '1'"),
        ({"inner": {"both": True}}, "f: inner.both: expected a number in -5…5, got True"),
        ({"inner": {"both": None}}, "f: inner.both: expected a number in -5…5, got None"),
        ({"inner": {"pair": [1, " "]}}, r"f: inner.pair\[1\]: expected a text, got ' '"),
        ({"inner": {"pair": [1]}}, r"f: inner.pair: expected 2 numbers, got \[1\]"),
        ({"inner": {"choice": "x"}}, "f: inner.choice: expected one of far, near, got 'x'"),
        ({"inner": {"way": [0, 1]}}, r"f: inner.way: expected 3 numbers, got \[0, 1\]"),
        ({"inner": {}, "count": 0}, "f: count: expected a whole number from 1, got 0"),
        ({"inner": {}, "count": 1.5}, "f: count: expected a whole number from 1, got 1.5"),
        ({"inner": {}, "rows": [{}, {"above": -1}]}, r"f: rows\[1\].above: .* above 0, got -1"),
        ({"inner": {}, "rows": 3}, "f: rows: expected a list, got 3"),
        ({"inner": {}, "turn": [[1, 2, 3]]}, "f: turn: expected 3 rows of 3 numbers, got"),
        ({"inner": {}, "named": {"a": "b"}}, "f: named: .* each entry is a number, got {'a': 'b'}"),
        ({"inner": {}, "flag": 1}, "f: flag: expected true or false, got 1"),
        ({"inner": {}, "a\nb": 1}, r"f: 'a\\nb': expected one of .*, got 'a\\nb'"),
        ({"inner": {}, "a - at `$.b": 1}, r"f: a - at `\$.b: expected one of"),
        ({"inner": {"both": "x" * 999}}, r"got 'x{20,40}\.\.\.x{20,40}'"),
    ],
)
def test_what_is_wrong_where(document: Any, message: str) -> None:
    with pytest.raises(InputError, match=message) as caught:
        checked(document, Outer, "f")
    assert "\n" not in str(caught.value)


def test_a_document_that_is_none(tmp_path: Path) -> None:
    path = tmp_path / "a.json"
    for data, message in (
        (b'{"a": \n}', r"a\.json: expected a thing, got no valid JSON: Expecting value: line 2"),
        (b"\xff", "got bytes that are not UTF-8 text"),
        (b"1" * 5000, "got no valid JSON"),
        (b"1" * 20_000, "got over 10000 bytes"),
    ):
        path.write_bytes(data)
        with pytest.raises(InputError, match=message):
            read_document(path, "a thing", most_bytes=10_000)
    with pytest.raises(InputError, match="expected a thing, got an error: No such file"):
        read_document(tmp_path / "none.json", "a thing")
    path.write_bytes(b'\xef\xbb\xbf{"a": 1}')
    assert read_document(path, "a thing") == {"a": 1}


def test_the_schema_library_is_imported_by_the_first_file_alone() -> None:
    code = (
        "import sys, raden_torch as rt; rt.load_model, rt.fit, rt.shade; import raden_torch.cli; "
        "sys.exit('msgspec' in sys.modules)"
    )
    assert subprocess.run([sys.executable, "-c", code]).returncode == 0
