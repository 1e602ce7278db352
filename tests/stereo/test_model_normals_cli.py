"""`raden capture normals --model` and its other ways, as a user calls them."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

import raden_torch as rt
from raden_torch.brdf.files.image_file import read_normal_map
from raden_torch.brdf.materials.palette import Palette
from raden_torch.brdf.materials.runtime import runtime_brdf
from raden_torch.brdf.model.runtime_table import RuntimeLayout
from raden_torch.capture.photo.photograph import read_linear
from raden_torch.images.exr import read_channels
from tests.stereo.scenes import Scene, Shell, off_deg, photographed


@pytest.fixture(scope="module")
def folder(scene: Scene, tmp_path_factory: pytest.TempPathFactory) -> Path:
    made = tmp_path_factory.mktemp("stereo")
    scene.write(made)
    layout = RuntimeLayout((32, 57, 65), (0.4, 0.3))
    baked = runtime_brdf(Shell().of_unit_vectors, torch.zeros(1), layout)
    rt.save_model(Palette([baked], ["simulated"]), made / "shell.safetensors")
    return made


def command(folder: Path, *more: object) -> list[object]:
    photos = sorted(folder.glob("photo*.png"))
    known = ("--lights", folder / "lights.json", "--mask", folder / "mask.png")
    return ["capture", "normals", *photos, *known, "--coded", "linear", *more]


def test_photographs_and_a_model_to_normals(
    raden, scene: Scene, folder: Path, tmp_path: Path
) -> None:
    out = tmp_path / "normals"
    done = raden(*command(folder, "--model", folder / "shell.safetensors", "-o", out))
    assert done.returncode == 0, done.stderr
    written = ("albedo.png", "confidence.png", "found.png", "normals.exr", "normals.json")
    assert sorted(p.name for p in out.iterdir()) == sorted((*written, "normals.png"))
    found = read_normal_map(out / "normals.png")[0][:, torch.tensor(scene.mask)]
    assert np.median(off_deg(found, scene.true)) < 0.3
    said = json.loads((out / "normals.json").read_text())
    assert (said["method"], said["model"]) == ("model", "shell.safetensors")
    assert said["pixels_solved"] == scene.mask.sum()
    assert said["median_standard_error_deg"] < 2
    assert max(lamp["relative_residual"] for lamp in said["lamps"]) < 0.1


def test_photographs_in_another_order_are_refused(
    raden, scene: Scene, folder: Path, tmp_path: Path
) -> None:
    order = [3, 1, 2, 0, *range(4, 10)]
    replace(scene, linear=scene.linear[order]).write(tmp_path)
    known = ("--lights", folder / "lights.json", "--mask", folder / "mask.png", "--coded", "linear")
    words = ["capture", "normals", *sorted(tmp_path.glob("photo*.png")), *known]
    words += ["--model", folder / "shell.safetensors", "-o", tmp_path / "n"]
    done = raden(*words)
    assert done.returncode == 2
    assert "photo00.png under lamp 4, photo03.png under lamp 1" in done.stderr
    assert done.stderr.count("\n") == 1
    assert not (tmp_path / "n").exists()
    done = raden(*words, "--keep-order", warn="default")
    assert done.returncode == 0
    assert "another order" in done.stderr


@pytest.mark.parametrize(
    ("more", "said"),
    [
        (("--model", "shell.safetensors", "--method", "robust"), "--model and --method"),
        (("--colour", "colour.json"), "--colour: expected with --model"),
        (("--method", "alternating", "--refine-intensity"), "--refine-intensity"),
        (("--model", "none.safetensors"), "none.safetensors"),
    ],
)
def test_what_does_not_go_together(raden, folder: Path, tmp_path: Path, more, said) -> None:
    done = raden(*command(folder, *more, "-o", tmp_path / "n"), cwd=folder)
    assert done.returncode == 2
    assert said in done.stderr
    assert done.stderr.count("\n") == 1
    assert not (tmp_path / "n").exists()


def test_normals_and_material_relit_under_a_lamp_that_was_held_out(
    raden, scene: Scene, tmp_path: Path
) -> None:
    """Without a model: normals and material of nine photographs show the tenth, but for a scale."""
    left = replace(scene, linear=scene.linear[:9], lamps=scene.lamps[:9])
    photos = left.write(tmp_path)
    out, mask = tmp_path / "n", tmp_path / "mask.png"
    known = ("--lights", tmp_path / "lights.json", "--mask", mask, "--coded", "linear")
    done = raden("capture", "normals", *photos, *known, "--method", "alternating", "-o", out)
    assert done.returncode == 0, done.stderr
    model = out / "material.safetensors"
    assert json.loads((out / "normals.json").read_text())["model"] == model.name
    told = rt.load_model(model).provenance
    assert told.instrument == "learnt from photographs, not measured by an instrument"
    assert told.fit["learnt"]["photographs"] == [path.name for path in photos]
    done = raden("info", model)
    assert done.returncode == 0, done.stderr
    assert told.instrument in done.stdout
    maps = read_channels(out / "normals.exr")
    n = torch.tensor(np.stack([maps[f"normal.{c}"] for c in "XYZ"]))[None]
    to = torch.tensor(scene.lamps[0]).float().view(1, 3, 1, 1).expand_as(n)
    view = torch.tensor([0.0, 0.0, 1.0]).view(1, 3, 1, 1).expand_as(n)
    f = rt.load_model(model).of_unit_vectors(n, to, view)[0].movedim(0, -1).detach().numpy()
    albedo = np.stack([maps[f"albedo.{c}"] for c in "RGB"], -1)
    facing = (n * to).sum(1)[0].clamp(min=0).numpy()[..., None]
    bright = scene.mask & (scene.linear[0].min(-1) > 0.05)
    ratio = scene.linear[0][bright] / (albedo * f * facing)[bright]
    assert 0.97 < np.median(ratio) < 1.03  # as docs/normals.md says of the albedo
    light = ",".join(f"{x:.6f}" for x in scene.lamps[9])
    more = ("--mask", mask, "--model", model, f"--light={light}", "--linear")
    relit = tmp_path / "relit.exr"
    done = raden("relight", photos[0], "--normals", out / "normals.png", *more, "-o", relit)
    assert done.returncode == 0, done.stderr
    shown = read_linear(relit, coded="linear").linear[scene.mask]
    true = scene.linear[9][scene.mask]
    off = abs(shown * np.median(true / shown.clip(1e-6)) - true).mean(1) / true.mean()
    assert np.median(off) < 0.03


def test_no_material_is_written_of_what_is_matt(raden, scene: Scene, tmp_path: Path) -> None:
    red = np.array([0.2, 0.07, 0.03])
    linear = photographed(
        scene.normal, scene.mask, scene.lamps, lambda n, to: np.tile(red, (len(n), 1))
    )
    photos = replace(scene, linear=linear).write(tmp_path)
    (tmp_path / "n").mkdir()
    (tmp_path / "n/material.safetensors").write_text("of an earlier run")
    known = ("--lights", tmp_path / "lights.json", "--mask", tmp_path / "mask.png")
    words = ["capture", "normals", *photos, *known, "--coded", "linear", "-o", tmp_path / "n"]
    done = raden(*words, "--method", "alternating", warn="default")
    assert done.returncode == 0, done.stderr
    assert "hardly better than a matt body" in done.stderr
    assert not (tmp_path / "n/material.safetensors").exists()
