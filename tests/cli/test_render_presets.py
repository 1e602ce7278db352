"""`raden render --preset`: lamps and cameras in the renderer's own world, or one line why not."""

from __future__ import annotations

import subprocess
from collections.abc import Callable
from pathlib import Path

import pytest
import torch

import raden_torch as rt
from raden_torch.brdf.files.exr_tensors import read_colour
from raden_torch.brdf.model.model import CosineDiffuse
from raden_torch.images.exr import read_channels

Command = Callable[..., subprocess.CompletedProcess[str]]
FILES = Path(__file__).parents[1] / "brdf/files/blender"
SHOT = FILES / "shell_on_lacquer.exr"


@pytest.fixture(scope="module")
def model(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("presets") / "m.safetensors"
    rt.save_model(rt.RadenBrdf(CosineDiffuse(torch.full((3,), 0.3), torch.zeros(3)), None), path)
    return path


def test_a_lamp_above_blenders_floor_lights_it(raden: Command, model: Path) -> None:
    lit = model.with_name("lit.exr")
    words = ("render", model, "--gbuffer", SHOT, "--preset", "blender", "-o", lit)
    done = raden(*words, "--camera-file", SHOT.with_suffix(".json"), "--light", "0,1,2")
    assert (done.returncode, done.stderr) == (0, "")
    floor = read_channels(SHOT)["ViewLayer.IndexMA.X"] == 2
    seen = read_colour(lit)[0].numpy()[:, floor]
    assert seen.min() > 0.1
    # without the preset's z-up, the same lamp lies in the plane of the floor
    done = raden(*words, "--camera", "4,-5,3", "--world", "y-up", "--light", "0,1,0")
    assert done.returncode == 0
    assert float(read_colour(lit)[0].numpy()[:, floor].max()) == 0


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("--preset", "maxwell"), "preset: expected arnold, blender, karma"),
        (("--preset", "blender"), "camera: expected where it is, with vectors in world space"),
        (("--preset", "blender", "--camera-file", "none.json"), "expected a camera file, got"),
        (("--space", "object"), "space"),
        (("--preset", "blender", "--channel", "normal=Nope"), "got the channels ViewLayer."),
    ],
)
def test_what_is_missing_is_said_in_one_line(
    raden: Command, model: Path, words: tuple[str, ...], message: str
) -> None:
    done = raden("render", model, "--gbuffer", SHOT, *words, "-o", model.with_name("no.png"))
    assert done.returncode == 2
    assert message in done.stderr
    assert done.stderr.count("\n") == 1


def test_it_describes_a_gbuffer(raden: Command, model: Path) -> None:
    done = raden("render", model, "--position-space", "world", "-o", model.with_name("no.png"))
    assert done.returncode == 2
    assert "--position-space: expected with --gbuffer" in done.stderr
