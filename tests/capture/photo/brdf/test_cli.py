"""`raden capture brdf` as a user calls it, with colour and an exposure stack; its files."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import Any

import cv2
import numpy as np
import pytest

from raden_torch.capture.exchange import load_measurement
from raden_torch.capture.photo.brdf.capture_settings import WhiteFactorSpec
from raden_torch.capture.photo.brdf.chart_white import chart_white
from raden_torch.images.raw import read_raw
from raden_torch.measurement.colour_conversion import xyz_to_rgb_matrix
from tests.dng import mosaic_of

Command = Callable[..., subprocess.CompletedProcess[str]]


def process(*arguments: object) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", "raden_torch.cli", *map(str, arguments)],
        capture_output=True,
        text=True,
        timeout=300,
    )


def colour_file(path: Path, matrix: np.ndarray) -> Path:
    said = {"format": "raden capture", "version": 1, "kind": "colour", "made_from": []}
    said |= {"method": "least squares", "matrix": matrix.tolist()}
    said |= {"left_out_delta_e_2000": {"least squares": {"mean": 0.5, "worst": 1.0}}}
    path.write_text(json.dumps(said))
    return path


@pytest.mark.slow
def test_the_command_and_its_files(sphere: Any, tmp_path: Path) -> None:
    """Camera RGB of known matrix, two exposures a lamp: XYZ, its report, a picture to look at."""
    to_xyz = np.array([[0.6, 0.25, 0.1], [0.3, 0.65, 0.05], [0.02, 0.1, 0.97]])
    series = sphere.series(lamps=sphere.triples, radius=70.0, exposure=0.5, noise=0.001)
    stacks = []
    for path in series.photos:  # the longer exposure is clipped in the ridge
        short = path.with_name(path.stem + "_short.png")
        bright = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
        cv2.imwrite(str(short), (bright.astype(float) / 4).round().astype(np.uint16))
        stacks += [path, short]
    colour = colour_file(tmp_path / "colour.json", to_xyz)
    out = tmp_path / "shell.csv"
    done = process(
        *("capture", "brdf", *stacks, "--stack", 2, "--exposure", 0.4, "--exposure", 0.1),
        *("--shape", "sphere", "--mask", series.mask, "--lights", series.lights),
        *("--colour", colour, "--white-mask", series.white, "--white-factor", 90),
        *("--white-std", 1.5, "--coded", "linear", "--simulated", "--lamp-std", 0.1, "-o", out),
    )
    assert done.returncode == 0, done.stderr
    assert "samples from 9 photographs" in done.stdout
    assert "next: the lamp" in done.stdout
    m = load_measurement(out)
    assert m.channels == ("X", "Y", "Z")
    assert m.metadata.simulated
    assert m.metadata.systematic.scale_std == pytest.approx(0.015)
    # the white is grey to the camera: so is the matrix' own white
    white = np.array([95.047, 100.0, 108.883])
    truth = sphere.truth() @ to_xyz.T / to_xyz.sum(axis=1) * white / 100
    relative = np.abs(m.values / truth - 1).max(axis=1)[m.valid]
    assert np.median(relative) < 0.01
    report = json.loads(out.with_suffix(".json").read_text())
    assert report["kind"] == "brdf"
    assert report["samples"] > 30_000
    assert len(report["photographs"]) == 9
    assert min(cv2.imread(str(out.with_suffix(".png"))).shape[:2]) > 500


@pytest.mark.slow
def test_raw_files_without_a_colour_file(
    raden: Command, sphere: Any, dng: ModuleType, tmp_path: Path
) -> None:
    """Expected: XYZ by the matrix in the files, whatever the balance, and a note that says so."""
    series = sphere.series(lamps=sphere.triples, radius=70.0, exposure=0.5, noise=0.001)
    black, raws = 1024, []
    for path in series.photos:
        rgb = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)[..., ::-1] / 65535
        stored = np.rint(black + (65535 - black) * mosaic_of(rgb, "GRBG")).astype(np.uint16)
        raw = path.with_suffix(".dng")
        raws.append(dng.write_dng(raw, stored, pattern="GRBG", black=black, neutral=(0.8, 1, 0.5)))
    out = tmp_path / "shell.csv"
    done = raden(
        *("capture", "brdf", *raws, "--shape", "sphere", "--mask", series.mask),
        *("--lights", series.lights, "--white-mask", series.white, "--white-factor", 90),
        *("--simulated", "--lamp-std", 0.1, "-o", out),
    )
    assert done.returncode == 0, done.stderr
    assert "colours by the matrix of the file and the white balance as shot" in done.stdout
    m = load_measurement(out)
    assert m.channels == ("X", "Y", "Z")
    colour = read_raw(raws[0]).colour
    assert colour is not None
    to_xyz = np.linalg.inv(xyz_to_rgb_matrix()) @ colour.to_srgb
    white = np.array([95.047, 100.0, 108.883])
    truth = sphere.truth() @ to_xyz.T / to_xyz.sum(axis=1) * white / 100
    relative = np.abs(m.values / truth - 1).max(axis=1)[m.valid]
    assert np.median(relative) < 0.015


def test_what_is_wrong_is_one_line_and_no_file(raden: Command, sphere: Any, tmp_path: Path) -> None:
    series = sphere.series(4, radius=40.0)
    out = tmp_path / "shell.csv"
    done = raden(
        *("capture", "brdf", *series.photos, series.photos[0], "--shape", "sphere"),
        *("--mask", series.mask, "--lights", series.lights, "--white-mask", series.white),
        *("--white-factor", 90, "-o", out),
    )
    assert done.returncode == 2
    assert "photo0.png: its lamp is not in" in done.stderr
    assert done.stderr.count("\n") == 1
    assert not out.exists()
    assert not out.with_suffix(".json").exists()


def test_the_chart_s_white_patch_is_the_white(tmp_path: Path) -> None:
    """Its place follows from the chart's corners, its factor from the edition."""
    colour = colour_file(tmp_path / "colour.json", np.eye(3))
    said = json.loads(colour.read_text())
    said |= {"chart": "ColorChecker Classic, edition 2014"}
    said |= {"chart_corners_px": [[100, 50], [700, 50], [700, 450], [100, 450]]}
    colour.write_text(json.dumps(said))
    corners, factor = chart_white(colour, WhiteFactorSpec(std_percent=1.0))
    assert corners is not None
    np.testing.assert_allclose(corners, [[120, 370], [180, 370], [180, 430], [120, 430]], atol=1e-3)
    assert 85 < factor.xyz[1] < 95
    assert factor.relative_std == pytest.approx(0.01)
    _, stated = chart_white(colour, WhiteFactorSpec("90,94,101"))
    assert stated.xyz.tolist() == [90, 94, 101]


def test_a_measured_white_is_looked_up_at_its_own_geometry(sphere: Any, tmp_path: Path) -> None:
    """A file that says the same everywhere gives what the one number gives; and a sphere without a
    mask is found."""
    from dataclasses import replace

    from raden_torch.capture.photo.brdf.photo_white import WhiteFactor
    from raden_torch.capture.photo.capture_brdf import capture_brdf
    from raden_torch.colorimetry import D65_XYZ
    from raden_torch.measurement import BrdfMeasurement

    angles = np.stack(np.meshgrid([0.0, 40, 85], [-85.0, 0, 85], [-85.0, 0, 85], indexing="ij"), -1)
    angles = angles.reshape(-1, 3)
    white = BrdfMeasurement(*angles.T, values=np.tile(0.9 * D65_XYZ, (len(angles), 1)))
    white.save(tmp_path / "white.csv")
    series = sphere.series(lamps=sphere.triples, radius=60.0)
    arguments = sphere.arguments(series)
    constant = capture_brdf(**arguments).measurement
    arguments["factor"] = WhiteFactor(D65_XYZ, tmp_path / "white.csv")
    looked_up = capture_brdf(**arguments).measurement
    np.testing.assert_allclose(looked_up.values, constant.values, rtol=1e-6)
    arguments["sample"] = replace(arguments["sample"], mask=None)  # and the sphere is found
    found = capture_brdf(**arguments).measurement
    both = found.valid & constant.valid
    assert both.sum() > 0.9 * constant.valid.sum()
    assert np.median(np.abs(found.values / constant.values - 1)[both]) < 0.02
