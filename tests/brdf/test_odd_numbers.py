"""Numbers, arrays and settings of torch that are not as usual: refused in a line, or right."""

from __future__ import annotations

import json
import math
import struct
from collections.abc import Callable, Iterator
from pathlib import Path

import cv2
import numpy as np
import pytest
import torch

import raden_torch as rt
from raden_torch.brdf.files.image_file import read_normal_map
from raden_torch.brdf.model.model import CosineDiffuse
from raden_torch.brdf.model.reflectance_table import ReflectanceTable
from raden_torch.capture.photo.camera import read_camera
from raden_torch.capture.photo.colour import read_colour
from raden_torch.capture.photo.result_file import write_result
from raden_torch.errors import InputError
from raden_torch.relighting import original_lamp

UP = torch.tensor([0.0, 0.0, 1.0], device="cpu").view(1, 3, 1, 1).expand(1, 3, 2, 2)


@pytest.fixture
def model() -> rt.RadenBrdf:
    part = CosineDiffuse(torch.full((3,), 1 / math.pi), torch.full((3,), 0.5))
    table = ReflectanceTable(torch.full((2, 2, 2, 3), 1 / math.pi), (0, -70, -70), (70, 140, 140))
    return rt.RadenBrdf(part, table)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (
            lambda: rt.GBuffer(UP, position=UP, camera=(math.nan, 0, 1)),
            "camera: expected three finite numbers",
        ),
        (
            lambda: rt.GBuffer(UP, position=UP, camera="abc"),
            "camera: expected three numbers, got 'abc'",
        ),
        (lambda: rt.GBuffer(UP, view=(0, 0, 0)), "view: expected a direction .*, got zero"),
        (lambda: rt.DirectionalLight((1e300, 0, 1e300)), "single precision holds"),
        (lambda: rt.DirectionalLight((1e-300, 0, 0)), "single precision holds"),
        (lambda: rt.DirectionalLight((10**400, 0, 1)), "three numbers"),
        (lambda: rt.RadenBrdf(None, None, specular_gain=math.nan), "specular_gain: .* got nan"),
        (lambda: setattr(rt.RadenBrdf(None, None), "diffuse_gain", "2"), "diffuse_gain: expected"),
        (lambda: ReflectanceTable(torch.ones(2, 2, 2, 3), (0, 0, 0), (1, math.nan, 1)), "step_deg"),
        (lambda: ReflectanceTable(torch.ones(2, 2, 2, 3), (0, 1e308, 0), (1, 1, 1)), "first_deg"),
    ],
)
def test_numbers_that_make_a_black_picture_are_refused(
    make: Callable[[], object], message: str
) -> None:
    with pytest.raises(InputError, match=message):
        make()


@pytest.mark.parametrize(
    "direction",
    [
        np.array([0.0, 0.6, 0.8], np.longdouble),
        np.array([0.8, 0.6, 0.0])[::-1],
        np.array([0, 3, 4], np.int32),
        np.array([0.0, 0.6, 0.8], np.float16),
    ],
    ids=["long double", "reversed", "whole", "half"],
)
def test_arrays_of_any_kind_are_directions(model: rt.RadenBrdf, direction: np.ndarray) -> None:
    light = rt.DirectionalLight(direction, np.longdouble(math.pi))
    image = rt.shade(model, rt.GBuffer(UP, view=np.array([0, 0, 2])), light)
    torch.testing.assert_close(image, torch.full((1, 3, 2, 2), 0.8), rtol=1e-3, atol=0)


@pytest.fixture
def other_default() -> Iterator[None]:
    """Nothing can be computed on "meta": whoever leaves the device to torch is found out."""
    torch.set_default_device("meta")
    yield
    torch.set_default_device(None)


@pytest.mark.usefixtures("other_default")
@pytest.mark.parametrize("precision", [torch.float32, torch.float64])
def test_the_default_device_does_not_matter(tmp_path: Path, precision: torch.dtype) -> None:
    flat = rt.simulate_specimen("yakogai", step_deg=35.0)
    fitted = rt.fit(flat, interpolation="trilinear").model
    rt.save_model(fitted, tmp_path / "m.safetensors")
    loaded = rt.load_model(tmp_path / "m.safetensors")
    lights = [
        rt.DirectionalLight((0, 0, 1)),
        rt.PointLight((0, 0, 3)),
        rt.SpotLight((0, 0, 3), (0, 0, 0)),
    ]
    scene = rt.GBuffer(UP.to(precision), position=UP, camera=(0, 1, 5))
    image = rt.shade(loaded, scene, lights, tolerance=1e-4)
    assert (image.device.type, image.dtype) == ("cpu", precision)
    assert bool((image > 0).all())
    normal = UP.clone().requires_grad_()
    loaded(normal, UP, UP).sum().backward()
    assert normal.grad is not None
    assert normal.grad.device.type == "cpu"


def test_a_models_wild_metadata_is_one_line(tmp_path: Path, model: rt.RadenBrdf) -> None:
    rt.save_model(model, tmp_path / "m.safetensors")
    data = (tmp_path / "m.safetensors").read_bytes()
    (length,) = struct.unpack("<Q", data[:8])
    header = json.loads(data[8 : 8 + length])
    about = json.loads(header["__metadata__"]["about"])
    wild = [
        json.dumps(about | {"version": math.inf}),
        json.dumps(about | {"specular_gain": 10**400}),
        json.dumps(about | {"step_deg": [1, math.inf, 1]}),
        "[" * 100_000,
    ]
    for text in wild:
        header["__metadata__"]["about"] = text
        changed = json.dumps(header).encode()
        path = tmp_path / "wild.safetensors"
        path.write_bytes(struct.pack("<Q", len(changed)) + changed + data[8 + length :])
        with pytest.raises(InputError, match=r"wild\.safetensors"):
            rt.load_model(path)


def test_wild_results_are_one_line(tmp_path: Path) -> None:
    path = tmp_path / "r.json"
    for method in ([], {}, 10**400):
        write_result(path, "colour", {"method": method, "matrix": [[1, 0, 0]] * 3})
        with pytest.raises(InputError, match=r"r\.json: method"):
            read_colour(path)
    write_result(path, "colour", {"method": "least squares", "matrix": [[10**400, 0, 0]] * 3})
    with pytest.raises(InputError, match=r"r\.json: matrix"):
        read_colour(path)
    for lamps in (
        3,
        [3],
        [{"photograph": "a.png"}],
        [{"photograph": "a.png", "direction_to_lamp": 1}],
    ):
        write_result(path, "normals", {"lamps": lamps})
        with pytest.raises(InputError, match=r"r\.json"):
            original_lamp(path, Path("a.png"))


def test_results_that_an_editor_marked_are_read(tmp_path: Path) -> None:
    path = tmp_path / "r.json"
    write_result(path, "colour", {"method": "least squares", "matrix": np.eye(3)})
    path.write_bytes(b"\xef\xbb\xbf" + path.read_bytes())
    assert read_colour(path).method == "least squares"


def test_a_calibration_that_broke_opencvs_parser(tmp_path: Path) -> None:
    text = (
        "%YAML:1.0\n---\nimage_width: 4\nimage_height: 3\ncamera_matrix: !!opencv-matrix\n"
        "   rows: 3\n   cols: {}\n   dt: d\n   data: [ 5., 0., 1., 0., 5., 1., 0., 0., 1. ]\n"
        "distortion_coefficients: !!opencv-matrix\n   rows: 1\n   cols: 5\n   dt: d\n"
        "   data: [ 0., 0., 0., 0., 0. ]\n"
    )
    path = tmp_path / "c.yml"
    path.write_text(text.format(3))
    assert read_camera(path).size == (3, 4)
    for changed in (text.format("9" * 400), text.format(3).replace("width: 4", "width: .Inf")):
        path.write_text(changed)
        with pytest.raises(InputError, match=r"c\.yml"):
            read_camera(path)


def test_normals_that_are_no_numbers_are_none(tmp_path: Path) -> None:
    stored = np.zeros((4, 4, 3), np.float32) + np.array([0, 0, -1], np.float32)[::-1]
    stored[0, 0], stored[0, 1], stored[1, 1] = np.inf, np.nan, 3e38
    cv2.imwrite(str(tmp_path / "n.tiff"), stored)
    normal = read_normal_map(tmp_path / "n.tiff", xyz="r,g,b")
    assert bool(torch.isfinite(normal).all())
    assert normal[0, :, 0, :2].abs().sum() == 0
    torch.testing.assert_close(normal[0, :, 1, 1], torch.full((3,), 3**-0.5))
