"""`raden info FILE`: what the project writes or reads is described with its figures, or refused."""

from __future__ import annotations

import json
import random
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import onnx
import OpenEXR
import pytest
import torch
from PIL import Image, ImageCms

import raden_torch as rt
from raden_torch.brdf.model.model import CosineDiffuse
from raden_torch.capture.photo.ball import Ball
from raden_torch.capture.photo.board import Board, BoardView
from raden_torch.capture.photo.camera import Calibration, Camera, Pose, write_camera
from raden_torch.capture.photo.lamps import Lamps, write_lamps
from raden_torch.capture.photo.result_file import write_result
from raden_torch.capture.spectrometer.journal import FINISHED, Header, JournalFile, Session
from raden_torch.capture.spectrometer.ports import ColorReading, Position, Range
from raden_torch.capture.spectrometer.scan_cells import grid
from raden_torch.capture.spectrometer.scan_plan import TakenReading, make_plan
from raden_torch.capture.spectrometer.white_reference import White
from raden_torch.errors import InputError
from raden_torch.images.exr import write_channels
from raden_torch.info import describe_file, kind_of


def measurement(path: Path) -> None:
    rt.simulate_specimen("yakogai", step_deg=35.0).save(path)


def model(path: Path) -> None:
    m = rt.simulate_specimen("yakogai", step_deg=35.0)
    rt.save_model(rt.fit(m, interpolation="trilinear").model, path)


def shader_of_others(path: Path) -> None:
    value = onnx.helper.make_tensor_value_info
    float_ = onnx.TensorProto.FLOAT
    node = onnx.helper.make_node("Add", ["a", "b"], ["c"])
    graph = onnx.helper.make_graph(
        [node],
        "g",
        [value("a", float_, ["n", 3]), value("b", float_, [3])],
        [value("c", float_, ["n", 3])],
        [onnx.numpy_helper.from_array(np.ones(3, np.float32), "b")],
    )
    opset = [onnx.helper.make_opsetid("", 17)]
    made = onnx.helper.make_model(graph, ir_version=8, opset_imports=opset)
    path.write_bytes(made.SerializeToString())


def gbuffer(path: Path) -> None:
    flat = {"N.X": 0.0, "N.Y": 0.0, "N.Z": 1.0, "Z": 2.0}
    write_channels(path, {name: np.full((20, 30), v) for name, v in flat.items()})


def tiled_beauty(path: Path) -> None:
    """Written by OpenEXR itself: half and float, a data window within the display window."""
    header = {
        "compression": OpenEXR.PIZ_COMPRESSION,
        "type": OpenEXR.tiledimage,
        "tiles": OpenEXR.TileDescription(),
        "displayWindow": ((0, 0), (99, 49)),
        "dataWindow": ((10, 5), (73, 36)),
    }
    channels = {c: np.full((32, 64), 0.5, np.float16) for c in "RGB"}
    channels["aux.V"] = np.ones((32, 64), np.float32)
    OpenEXR.File(header, channels).write(str(path))


def lights(path: Path) -> None:
    direction = np.array([[0.0, 0.6, 0.8], [0.0, -0.6, 0.8]])
    lamps = Lamps(
        direction,
        np.array([1.25, 0.75]),
        direction * 1000,
        np.array([1.5, 2.5]),
        unit="mm",
        exponent=0.9,
        names=("a.png", "b.png"),
    )
    write_lamps(lamps, path, balls=[Ball(9.0, 9.0, 5.0, 0.1, np.zeros(3), 5.0)])


def camera(path: Path) -> None:
    lens = Camera(
        np.array([[800.0, 0, 320], [0, 801, 240], [0, 0, 1]]),
        np.array([-0.25, 0.125, 0, 0, 0]),
        (480, 640),
    )
    pose = Pose(np.eye(3), np.array([0.0, 0, 1]), 0.3, 4)
    view = BoardView("a.png", (480, 640), Board(5, 4, 0.02, 0.01), np.arange(4), np.zeros((4, 2)))
    found = Calibration(lens, 0.25, np.array([2.0, 2.5]), (pose,), ("tilt it more",))
    write_camera(path, lens, [view], [pose], calibration=found, made_from=["a.png"])


def opencv_camera(path: Path) -> None:
    beside = path.with_suffix(".yml")  # OpenCV chooses by the name; we do not
    file = cv2.FileStorage(str(beside), cv2.FILE_STORAGE_WRITE)
    file.write("image_width", 640)
    file.write("image_height", 480)
    file.write("camera_matrix", np.array([[800.0, 0, 320], [0, 801, 240], [0, 0, 1]]))
    file.write("distortion_coefficients", np.array([-0.25, 0.125, 0, 0, 0]))
    file.release()
    beside.rename(path)


def colour(path: Path) -> None:
    content = {
        "method": "least squares",
        "matrix": np.eye(3),
        "maps": "camera RGB to XYZ",
        "chart": "ColorChecker Classic, edition 2014",
        "mean_delta_e_2000": 0.5,
        "worst_delta_e_2000": 1.5,
        "left_out_delta_e_2000": {"least squares": {"mean": 0.75, "worst": 2.0}},
        "neutral_exponent": 1.02,
        "notes": ["left out, since saturated: white"],
    }
    write_result(path, "colour", content)


def normals(path: Path) -> None:
    content = {
        "method": "robust",
        "files": {"normals": "normals.png", "maps": "normals.exr"},
        "pixels_solved": 1234,
        "median_confidence": 0.9,
        "median_standard_error_deg": 0.5,
        "lamps": [{}, {}, {}],
    }
    write_result(path, "normals", content)


def brdf(path: Path) -> None:
    content = {
        "shape": "sphere",
        "grid_step_deg": 5.0,
        "samples": 4321,
        "cells": 100,
        "cells_covered": 25,
        "coverage": 0.25,
        "median_relative_std_percent": {"ridge": {"noise": 1.0, "total": 2.5}},
        "photographs": [{}, {}],
        "next": [{"text": "a lamp at 30 degrees"}],
    }
    write_result(path, "brdf", content)


def truth(path: Path) -> None:
    content = {
        "simulated": True,
        "renderer": "Mitsuba 3, scalar_rgb",
        "material": "yakogai",
        "material_source": "film optics",
        "measurement": "truth.csv",
        "normals": "truth_normals.exr",
        "camera": {"size": [200, 300], "bits": 14, "matrix": [[900.0, 0, 150]]},
        "exposure_s": {"a.png": 0.1, "b.png": 0.2},
        "lamps": [{}],
        "boards": {"b.png": {}},
        "specimen": {"shape": "sphere"},
    }
    path.write_text(json.dumps(content, indent=1))


def bench(path: Path) -> None:
    errors = {
        region: {"readings": 10, "rms": rms, "log_error": 0.002}
        for region, rms in (("inside", 0.00123), ("outside", 0.0321), ("hemisphere", 0.02))
    }
    row = {"backend": "avx2", "precision": "float32", "times_floor": 3.25, "errors": errors}
    content = {
        "sample": "yakogai",
        "simulated": True,
        "frame": [720, 1280],
        "runs": 9,
        "default_nodes": 147744,
        "interpolation": "lobes",
        "machine": {},
        "rows": [{**row, "default": True}, {**row, "backend": "naive", "default": False}],
    }
    path.write_text(json.dumps(content, indent=2))


def journal(path: Path, *, finished: bool = False) -> None:
    plan = make_plan(grid(step_deg=70), "coarse", repeats=2)
    header = Header(
        plan=plan,
        white=White(Position(45.0, 0.0, 0.0), (95.0, 100.0, 108.0), "tile"),
        reference_every_s=600.0,
        reference_readings=5,
        goniometer="GRBL 1.1h",
        colorimeter="CS-2000 1234",
        simulated=True,
        sample="yakogai",
        started="2026-01-02 03:04:05 UTC",
    )
    taken: list[TakenReading] = []
    with JournalFile.create(path, header) as kept:
        kept.append(Session("started", "", 1.7e9))
        for i in range(plan.steps if finished else 7):
            step = plan.next_step(taken)
            assert step is not None
            reading = ColorReading(np.array([0.1, 0.2, 0.3]), Range.OK, 0.5)
            taken.append(TakenReading(step, reading, 1.7e9 + i))
            kept.append(taken[-1])
        if finished:
            kept.append(Session(FINISHED, "", 1.7e9 + 3600))


def finished_journal(path: Path) -> None:
    journal(path, finished=True)


def rig(path: Path) -> None:
    text = (Path(__file__).parents[2] / "docs/rig.md").read_text(encoding="utf-8")
    path.write_text(text.split("```toml\n")[1].split("```")[0], encoding="utf-8")


def cells(path: Path) -> None:
    path.write_text("# mine\nincidence_deg,receiving_deg,tilt_deg\n0,10,5\n20,-30,-5\n")


def png_with_profile(path: Path) -> None:
    profile = ImageCms.ImageCmsProfile(ImageCms.createProfile("sRGB"))
    pixels = np.arange(24 * 32 * 4, dtype=np.uint32).reshape(24, 32, 4) % 256
    image = Image.fromarray(pixels.astype(np.uint8), "RGBA")
    image.save(path, format="png", icc_profile=profile.tobytes())


def png_of_16_bits(path: Path) -> None:
    rng = np.random.default_rng(0)
    ok, data = cv2.imencode(".png", rng.integers(0, 65536, (24, 32, 3), dtype=np.uint16))
    assert ok
    path.write_bytes(data.tobytes())


def tiff_of_two_pages(path: Path) -> None:
    pages = [Image.fromarray(np.full((24, 32), v, np.uint8)) for v in (10, 20)]
    pages[0].save(path, format="tiff", save_all=True, append_images=pages[1:])


def jpeg(path: Path) -> None:
    _plain(path, "jpeg")


def _plain(path: Path, form: str) -> None:
    Image.fromarray(np.full((24, 32, 3), 99, np.uint8)).save(path, format=form)


def bmp(path: Path) -> None:
    _plain(path, "bmp")


def gif(path: Path) -> None:
    _plain(path, "gif")


def webp(path: Path) -> None:
    _plain(path, "webp")


def ppm(path: Path) -> None:
    _plain(path, "ppm")


def hdr(path: Path) -> None:
    ok, data = cv2.imencode(".hdr", np.full((24, 32, 3), 1.5, np.float32))
    assert ok
    path.write_bytes(data.tobytes())


FILES: dict[Callable[[Path], None], tuple[str, ...]] = {
    measurement: (
        "measurement of yakogai (simulated)",
        "75 readings, 75 valid; channels X, Y, Z",
        "incidence: 0…70 deg by 35, 3 values",
    ),
    model: (
        "model of yakogai (simulated specimen)",
        "table: 4 x 7 x 7 x 3; incidence 0…105 by 35",
        "measured: incidence 0…70, receiving -70…70, tilt -70…70 deg; beyond, what was measured is "
        "continued",
    ),
    shader_of_others: (
        "ONNX file of another program",
        "input a: float [n, 3]",
        "input b: float [3], optional",
        "output c: float [n, 3]",
        "opset 17, IR 8, 1 nodes",
    ),
    gbuffer: (
        "OpenEXR file: 30 x 20 pixels (width x height)",
        "scan lines, compression ZIP",
        "layer N: X, Y, Z (float)",
        "channels Z (float)",
        "usable as a G-buffer: normals in N.X, N.Y, N.Z; depth in Z",
    ),
    tiled_beauty: (
        "OpenEXR file: 100 x 50 pixels",
        "tiles of 32 x 32, compression PIZ",
        "data window 10, 5 to 73, 36; display window 0, 0 to 99, 49",
        "channels B, G, R (half)",
        "layer aux: V (float)",
        "no G-buffer as it is: no normals and no depth",
    ),
    lights: (
        "lights: 2 lamps (positions in mm), written by `raden capture lights`",
        "camera's response: exponent 0.9; balls: 1",
        "a.png: 36.9 deg from the camera's axis, towards 90 deg (0 right, 90 up), intensity 1.250",
        "a.png: at 0, 600, 800 mm",
    ),
    camera: (
        "camera, written by `raden capture calibrate`",
        "640 x 480 pixels; focal lengths 800.0, 801.0 px; horizontal field of view 43.60 deg",
        "principal point 320.0, 240.0 px; distortion (OpenCV's order): -0.25, 0.125, 0, 0, 0",
        "re-projection rms 0.250 px; focal lengths ± 2 px",
        "poses of the board: 1",
        "note: tilt it more",
    ),
    opencv_camera: ("camera, a calibration by OpenCV", "focal lengths 800.0, 801.0 px"),
    colour: (
        "written by `raden capture colour`",
        "mean 0.50, worst 1.50; each patch left out in turn: mean 0.75, worst 2.00",
        "signal ~ reflectance^1.02",
        "note: left out, since saturated: white",
    ),
    normals: (
        "written by `raden capture normals`",
        "1234 pixels solved from 3 photographs, method robust",
        "standard error 0.5 deg",
        "maps beside it: normals.png, normals.exr",
    ),
    brdf: (
        "report of a BRDF from 2 photographs of a sphere, written by `raden capture brdf`",
        "grid of 5 deg: 25 of 100 cells covered (25.0 %), 4321 samples",
        "standard deviation, ridge: 2.5 % (median)",
        "next: a lamp at 30 degrees",
    ),
    truth: (
        "truth of simulated photographs",
        "300 x 200 pixels, 14 bits, focal length 900.0 px",
        "photographs: 2; lamps: 1; boards: 1",
    ),
    bench: (
        "benchmark on yakogai (simulated), written by `raden bench`",
        "frame 1280 x 720; 2 rows; default: lobes, 147744 nodes",
        "avx2 float32: 3.2 times a copy, RMS 0.00123 inside the measured box, 0.03210 outside it, "
        "0.02000 over the hemisphere",
    ),
    journal: (
        "journal of a scan of yakogai (simulated instruments), written by `raden scan`",
        "goniometer: GRBL 1.1h",
        "plan: coarse, 18 cells",
        "readings: 7 of 36; dark and white: 0; faults: 0; sessions: 1",
        "begun 2026-01-02 03:04:05 UTC; last record 2023-11-14 22:13:26 UTC",
        "not finished: `raden scan … --resume` goes on with it",
    ),
    finished_journal: ("readings: 36 of 36", "last record 2023-11-14 23:13:20 UTC", "\nfinished"),
    rig: (
        "rig goniometer, room 3, for `raden scan --config`",
        "goniometer: grbl at /dev/ttyUSB0",
        "receiving: axis B, -75…75 deg, zero at 12.5 deg, direction -1",
        "colorimeter: cs2000 at /dev/ttyACM0, with spectrum",
        "white reference: tile 1234, reflectance factor 98.5, read at incidence 45",
        "the detector hides the lamp within 8 deg of it",
    ),
    cells: ("list of 2 cells, for `raden scan --plan`", "receiving: -30…10 deg"),
    png_with_profile: (
        "PNG image: 32 x 24 pixels (width x height)",
        "RGB, alpha; 8 bits a channel, whole numbers",
        "frames: 1",
        "ICC profile: sRGB",
    ),
    png_of_16_bits: ("PNG image: 32 x 24", "RGB; 16 bits a channel", "ICC profile: none"),
    tiff_of_two_pages: (
        "TIFF image: 32 x 24",
        "cannot be read here: expected one image, got 2",
        "frames: 2",
    ),
    jpeg: ("JPEG image: 32 x 24", "RGB; 8 bits a channel"),
    hdr: ("Radiance HDR image: 32 x 24", "RGB; 32 bits a channel, floating point"),
    bmp: ("BMP image: 32 x 24", "RGB; 8 bits a channel"),
    gif: ("GIF image: 32 x 24", "RGB; 8 bits a channel"),
    webp: ("WEBP image: 32 x 24", "RGB; 8 bits a channel"),
    ppm: ("PPM image: 32 x 24", "RGB; 8 bits a channel"),
}


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """One file of each kind, under its suffix and under another one."""
    path = tmp_path_factory.mktemp("info")
    for make in FILES:
        suffix = {measurement: ".csv", model: ".safetensors"}.get(make)
        suffix = suffix or (".exr" if make in (gbuffer, tiled_beauty) else ".json")
        make(path / f"made{suffix}")
        (path / f"made{suffix}").rename(path / make.__name__)
    return path


@pytest.mark.parametrize("make", FILES, ids=lambda make: make.__name__)
def test_a_file_is_described_whatever_its_name(folder: Path, make: Callable[..., None]) -> None:
    text = describe_file(folder / make.__name__)
    for words in FILES[make]:
        assert words in text


@pytest.mark.parametrize("make", FILES, ids=lambda make: make.__name__)
def test_a_damaged_file_is_one_line(
    folder: Path, tmp_path: Path, make: Callable[..., None], recwarn: pytest.WarningsRecorder
) -> None:
    """Cut, or with some bytes changed: described as far as it is whole, or refused."""
    data = (folder / make.__name__).read_bytes()
    rng, path = random.Random(make.__name__), tmp_path / make.__name__
    said = []
    for case in range(30):
        changed = bytearray(data)
        if case < 10:
            del changed[rng.randrange(len(data)) :]
        else:
            for _ in range(rng.choice((1, 10, 100))):
                changed[rng.randrange(len(data))] = rng.randrange(256)
        path.write_bytes(changed)
        try:
            describe_file(path)
        except InputError as error:
            said.append(str(error))
    assert len(said) >= 5
    assert all(str(path) in message and "\n" not in message for message in said)


def test_half_an_exr_is_refused(folder: Path, tmp_path: Path) -> None:
    data = (folder / "gbuffer").read_bytes()
    (tmp_path / "half.exr").write_bytes(data[:-40])
    with pytest.raises(InputError, match=r"half\.exr: truncated or damaged"):
        describe_file(tmp_path / "half.exr")


def test_a_cut_journal_is_described(folder: Path, tmp_path: Path) -> None:
    (tmp_path / "x").write_bytes((folder / "journal").read_bytes()[:-10])
    text = describe_file(tmp_path / "x")
    assert "readings: 6 of 36" in text
    assert "its last line is cut" in text


@pytest.mark.parametrize(
    ("data", "got"),
    [
        (b"", "an empty file"),
        (b"# notes\nof a day\n", "text that begins with '# notes'"),
        (b'{"a": 1}', "JSON of another program"),
        (b"\x7fELF\x02\x01\x01\0\0", "a binary file that begins with the bytes 7f 45 4c 46"),
    ],
)
def test_what_is_not_known(tmp_path: Path, data: bytes, got: str) -> None:
    (tmp_path / "x.csv").write_bytes(data)
    with pytest.raises(InputError, match=r"x\.csv: expected one of .*a measurement.*; got ") as why:
        describe_file(tmp_path / "x.csv")
    assert got in str(why.value)
    assert "\n" not in str(why.value)


def test_what_is_not_there(tmp_path: Path) -> None:
    for path in (tmp_path / "x", tmp_path):
        with pytest.raises(InputError, match="expected a file that raden knows"):
            kind_of(path)


@pytest.mark.parametrize(
    ("words", "wanted"),
    [
        (("plot", "lights", "-o", "x.png"), "expected a measurement or a model, got a result of"),
        (("plot", "journal", "-o", "x.png"), "expected a measurement or a model, got a scan's"),
        (("plot", "measurement", "model", "-o", "x.png"), "expected a measurement, got a model"),
        (("info", "measurement", "gbuffer"), "expected a measurement or a model, got an OpenEXR"),
        (("info", "model", "measurement"), "expected a measurement, got a model"),
        (
            ("info", "measurement", "--against", "measurement"),
            "--against: expected a model to score, got a measurement",
        ),
        (("info", "measurement", "model", "--against", "model"), "give one"),
    ],
)
def test_another_kind_is_refused_by_its_name(
    raden: Callable[..., subprocess.CompletedProcess[str]],
    folder: Path,
    words: tuple[str, ...],
    wanted: str,
) -> None:
    here = [str(folder / w) if w in {f.__name__ for f in FILES} else w for w in words[1:]]
    done = raden(words[0], *here)
    assert done.returncode == 2, done.stderr
    assert done.stderr.count("\n") == 1
    assert wanted in done.stderr


def test_json_is_described_without_torch(folder: Path) -> None:
    names = ("lights", "camera", "normals", "journal", "rig", "cells")
    code = "import sys; from raden_torch.info import describe_file\n"
    code += "for path in sys.argv[1:]: describe_file(path)\n"
    code += "assert 'torch' not in sys.modules"
    subprocess.run([sys.executable, "-c", code, *(folder / name for name in names)], check=True)


@pytest.mark.slow
def test_an_exported_shader(tmp_path: Path) -> None:
    about = rt.fit(rt.simulate_specimen("yakogai", step_deg=35.0), interpolation="trilinear")
    diffuse = CosineDiffuse(torch.tensor([0.1, 0.2, 0.3]), torch.ones(3))
    matt = rt.RadenBrdf(diffuse, None, provenance=about.model.provenance)
    rt.export_onnx(matt, tmp_path / "x.onnx", output="brdf")
    text = describe_file(tmp_path / "x.onnx")
    for words in (
        "shader of yakogai (simulated specimen), written by `raden export`",
        "runtime form, profile gbuffer, output brdf",
        "units: 1/sr",
        "input normal: float [batch, 3, height, width]",
        "input table: float [32, 69, 67, 3], optional",
        "output brdf: float [batch, 3, height, width]",
        "opset 18, IR 8",
        f"{(tmp_path / 'x.onnx').stat().st_size} bytes",
        f"measurement sha256: {matt.provenance.measurement_sha256}",
    ):
        assert words in text
