"""`raden capture texture` without a model: the shells are learnt from simulated photographs of a
flat inlay of two shells of analytic BRDF whose layers wave; then relit under a held-out lamp."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

import raden_torch as rt
from raden_torch.brdf.files.gbuffer_file import read_gbuffer
from raden_torch.brdf.materials.palette import Palette
from raden_torch.errors import InputError
from raden_torch.stereo import learn_shell
from raden_torch.stereo.learnt_model import INSTRUMENT, learnt_model
from raden_torch.stereo.learnt_palette import learn_palette
from raden_torch.stereo.shell_table import body
from raden_torch.stereo.split_pieces import split_pieces
from tests.stereo.scenes import Shell, lamps_around, unit, write_lights, write_photographs
from tests.stereo.test_texture import TURNS, off_by, radiance

Array = np.ndarray
SIDE, EXPOSURE = 44, 1.4


class Wavy:
    """Two shells side by side in lacquer, under 8 lamps; `lamp_out` is a ninth among them."""

    def __init__(self, folder: Path, gap: int, lean: float) -> None:
        self.folder = folder
        y, x = np.mgrid[:SIDE, :SIDE]
        self.material = np.zeros((SIDE, SIDE), int)
        self.material[4:40, 4 : 22 - gap] = 1
        self.material[4:40, 22 + gap : 40] = 2
        slope = lean * np.stack([np.sin(x / 3 + y / 7), np.sin(y / 4 - x / 9)], -1)
        self.layers = unit(np.concatenate([slope, np.ones((SIDE, SIDE, 1))], -1))
        lamps = lamps_around(9)
        self.lamp_out, self.lamps = lamps[4], np.delete(lamps, 4, 0)
        rng = np.random.default_rng(0)
        linear = EXPOSURE * np.stack([self.radiance(lamp) for lamp in self.lamps])
        linear += 0.002 * np.sqrt(linear + 0.01) * rng.normal(size=linear.shape)
        write_photographs(folder, linear)
        write_lights(folder / "lights.json", self.lamps)
        cv2.imwrite(str(folder / "map.png"), self.material.astype(np.uint8))

    def radiance(self, lamp: Array) -> Array:
        return radiance(self.material, self.layers, lamp)

    def command(self, output: Path, *more: object, lamps: int = 8) -> list[object]:
        photos = sorted(self.folder.glob("photo*.png"))[:lamps]
        known = ("--lights", self.folder / "lights.json", "--coded", "linear")
        return ["capture", "texture", *photos, *known, "-o", output, *more]


@pytest.fixture(scope="module")
def wavy(tmp_path_factory: pytest.TempPathFactory) -> Wavy:
    return Wavy(tmp_path_factory.mktemp("wavy"), gap=2, lean=0.12)


def shaded(palette: Palette, gbuffer: rt.GBuffer, lamp: rt.DirectionalLight) -> Array:
    with torch.no_grad():
        return rt.shade(palette, gbuffer, lamp)[0].movedim(0, -1).numpy()


@pytest.mark.slow
def test_learnt_and_relit_under_a_lamp_that_was_held_out(raden, wavy: Wavy, tmp_path: Path) -> None:
    white = f"{EXPOSURE / np.pi:.5f}"
    out = tmp_path / "inlay"
    words = wavy.command(out, "--map", wavy.folder / "map.png", "--per-pixel", "--white", white)
    done = raden(*words)
    assert done.returncode == 0, done.stderr
    palette = rt.load_model(out / "palette.safetensors")
    assert palette.names == ("ground", "shell1", "shell2")
    assert all(isinstance(model, rt.RadenBrdf) for model in list(palette)[1:])
    lamp = rt.DirectionalLight(tuple(wavy.lamp_out), irradiance=(1.0, 1.0, 1.0))
    gbuffer = read_gbuffer(out / "inlay.exr", palette=palette)
    image = shaded(palette, gbuffer, lamp)
    off = off_by(image, wavy.radiance(wavy.lamp_out))[wavy.material > 0]
    assert np.median(off) < 2.0
    flat = rt.GBuffer(gbuffer.normal, view=(0, 0, 1), material=gbuffer.material)
    upright = shaded(palette, flat, lamp)
    assert np.median(off_by(upright, wavy.radiance(wavy.lamp_out))[wavy.material > 0]) > 4
    said = json.loads((out / "inlay.json").read_text())["learnt"]
    assert said["photographs"] == [f"photo{k:02d}.png" for k in range(8)]
    assert 0 < said["shells"]["shell1"]["seen"] < 0.1
    assert said["scale"] == "by the white"
    shown = raden("info", out / "palette.safetensors")
    assert INSTRUMENT in shown.stdout
    assert "learnt from 8 photographs" in raden("info", out / "inlay.json").stdout


@pytest.mark.parametrize(
    ("lamps", "more", "said"),
    [
        (8, (), "or say by --shells how many there are"),
        (4, ("--shells", 2), "expected at least 5 to learn the shells from"),
        (8, ("--shells", 0), "shells: expected 1…254, got 0"),
        (8, ("--shells", 2, "--white", "-1"), "white: expected more than 0"),
    ],
)
def test_bad_input_is_one_line(
    raden, wavy: Wavy, tmp_path: Path, lamps: int, more: tuple[object, ...], said: str
) -> None:
    words = wavy.command(tmp_path / "o", *more, lamps=lamps)
    if lamps < 8:
        write_lights(tmp_path / "lights.json", wavy.lamps[:lamps])
        words[words.index(wavy.folder / "lights.json")] = tmp_path / "lights.json"
    done = raden(*words)
    assert done.returncode == 2
    assert said in done.stderr
    assert done.stderr.count("\n") == 1
    assert not (tmp_path / "o").exists()


def seen_of(scene: Wavy):
    from raden_torch.capture.photo.capture_normals import read_lit_set
    from raden_torch.stereo.photographed import Photographed

    photos = sorted(scene.folder.glob("photo*.png"))
    lit = read_lit_set(photos, scene.folder / "lights.json", None, coded="linear")
    return Photographed.of(lit), torch.tensor([[0.0], [0.0], [1.0]]).repeat(1, SIDE * SIDE)


@pytest.mark.parametrize("white", [None, 0.01])
def test_a_flat_shell_is_warned_of_and_a_false_white_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, white: float | None
) -> None:
    monkeypatch.setattr(learn_shell, "_BODIES", learn_shell._BODIES[:1])
    monkeypatch.setattr(learn_shell, "_NOISE", (0.3, 0.1, 0.1, 0.03, 0.03))
    scene = Wavy(tmp_path, gap=2, lean=0.0)
    seen, surface = seen_of(scene)
    pieces = (scene.material == 1).astype(np.int32)
    told = (seen, pieces, np.array([0]), surface, ["shell1"], [str(k) for k in range(8)])
    if white is not None:
        with pytest.raises(InputError, match="more than all light"):
            learn_palette(*told, white=white)
        return
    assert "holds near these lamps" in learn_palette(*told).notes[0]


def test_touching_shells_are_told_apart(tmp_path: Path) -> None:
    scene = Wavy(tmp_path, gap=0, lean=0.12)
    seen, surface = seen_of(scene)
    shells = [Shell(turn) for turn in TURNS]
    merged = (scene.material > 0).astype(np.int32)
    pieces, which = split_pieces(seen, shells, merged, surface, 16, lambda share: None)
    found = np.concatenate([[0], which + 1])[pieces]
    assert (found == scene.material).mean() > 0.97
    # what is one shell stays one piece
    one = (scene.material == 1).astype(np.int32)
    pieces, which = split_pieces(seen, shells, one, surface, 16, lambda share: None)
    assert (pieces == one).all()
    assert which.tolist() == [0]


@settings(deadline=None, max_examples=30)
@given(st.floats(0, 80), st.floats(-80, 80), st.floats(0, 60))
def test_a_learnt_model_is_reciprocal(incidence: float, receiving: float, tilt: float) -> None:
    model = MODEL
    angles = [torch.tensor([x]).view(1, 1, 1, 1).deg2rad() for x in (incidence, receiving, tilt)]
    n, to, v = rt.vectors_from_angles(*angles)
    with torch.no_grad():
        there, back = model(n, to, v), model(n, v, to)
    torch.testing.assert_close(there, back, rtol=1e-3, atol=1e-4)


MODEL = learnt_model(body(6.0, 6.0, 12.0).values, 0.2, "shell1", {}, ())
