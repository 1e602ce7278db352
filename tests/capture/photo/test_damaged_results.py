"""Result files and models with values changed at random: nothing but an InputError, in one line."""

from __future__ import annotations

import copy
import json
import math
import struct
from collections.abc import Callable, Iterator
from pathlib import Path
from random import Random
from typing import Any

import numpy as np
import pytest
import torch

import raden_torch as rt
from raden_torch.brdf.model.model import CosineDiffuse
from raden_torch.brdf.model.reflectance_table import ReflectanceTable
from raden_torch.capture.photo.camera import read_camera, read_poses
from raden_torch.capture.photo.colour import read_colour
from raden_torch.capture.photo.lamps import read_lamps
from raden_torch.errors import InputError
from raden_torch.relighting import original_lamp

ODD = (None, True, 0, -1, 10**400, math.inf, math.nan, 1e308, "", "\0", [], {}, [[]], "x" * 500)
HEAD = {"format": "raden capture", "version": 1, "made_from": ["a.png"]}
LAMP = {"photograph": "a.png", "direction_to_lamp": [0, 0, 1], "intensity": 1.0}
POSE = {
    "file": "a.png",
    "corners": 20,
    "reprojection_rms_px": 0.3,
    "rotation_board_to_camera": np.eye(3).tolist(),
    "translation_board_to_camera_m": [0, 0, 1],
    "turn_and_translation_covariance": np.zeros((6, 6)).tolist(),
}
CAMERA = {
    "camera_matrix_px": [[50, 0, 9], [0, 50, 9], [0, 0, 1]],
    "distortion": [0, 0, 0, 0, 0],
    "image_width_px": 20,
    "image_height_px": 20,
    "board": {"columns": 5, "rows": 7, "square_m": 0.04, "marker_m": 0.02},
    "poses": [POSE],
}
READERS: dict[str, tuple[dict[str, Any], Callable[[Path], object]]] = {
    "lights": ({"lamps": [LAMP, LAMP], "unit": "mm", "response_exponent": 1.0}, read_lamps),
    "camera": (CAMERA, lambda path: (read_camera(path), read_poses(path))),
    "colour": ({"method": "least squares", "matrix": np.eye(3).tolist()}, read_colour),
    "normals": ({"lamps": [LAMP]}, lambda path: original_lamp(path, Path("a.png"))),
}


def places(value: Any, at: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    if at:
        yield at
    keys = value if isinstance(value, dict) else range(len(value) if isinstance(value, list) else 0)
    for key in keys:
        yield from places(value[key], (*at, key))


def changed(value: Any, draw: Random) -> Any:
    value = copy.deepcopy(value)
    *way, last = draw.choice(list(places(value)))
    inside = value
    for key in way:
        inside = inside[key]
    if draw.random() < 0.2:
        del inside[last]
    else:
        inside[last] = copy.deepcopy(draw.choice(ODD))
    return value


def read_or_refused(read: Callable[[Path], object], path: Path) -> bool:
    try:
        read(path)
    except InputError as error:
        said = str(error)
    else:
        return False
    assert "\n" not in said
    assert path.name in said or "board" in said
    return True


@pytest.mark.parametrize("kind", READERS)
def test_results(tmp_path: Path, kind: str) -> None:
    content, read = READERS[kind]
    whole = {**HEAD, "kind": kind, **content}
    path = tmp_path / "r.json"
    path.write_text(json.dumps(whole))
    read(path)
    refused = 0
    for seed in range(150):
        path.write_text(json.dumps(changed(whole, Random(seed))))
        refused += read_or_refused(read, path)
    assert 30 < refused < 150
    path.write_text('{"format": ' + "[" * 100_000)
    assert read_or_refused(read, path)


def test_models(tmp_path: Path) -> None:
    part = CosineDiffuse(torch.ones(3), torch.ones(3))
    table = ReflectanceTable(torch.ones(2, 2, 2, 3), (0, -70, -70), (70, 140, 140))
    path = tmp_path / "m.safetensors"
    rt.save_model(rt.RadenBrdf(part, table), path)
    data = path.read_bytes()
    (length,) = struct.unpack("<Q", data[:8])
    header = json.loads(data[8 : 8 + length])
    about = json.loads(header["__metadata__"]["about"])
    up = torch.tensor([0.0, 0.6, 0.8]).view(1, 3, 1, 1)

    def read(path: Path) -> None:
        assert bool(torch.isfinite(rt.load_model(path)(up, up, up)).all())

    refused = 0
    for seed in range(300):
        draw = Random(seed)
        other = copy.deepcopy(header)
        if seed % 2:
            other["__metadata__"]["about"] = json.dumps(changed(about, draw))
        else:
            other = changed(header, draw)
        text = json.dumps(other).encode()
        path.write_bytes(struct.pack("<Q", len(text)) + text + data[8 + length :])
        refused += read_or_refused(read, path)
    assert 100 < refused < 300
