"""`raden render --shadows`: a ball over a wall casts its shadow, or one line says why not."""

from __future__ import annotations

import subprocess
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import torch

import raden_torch as rt
from raden_torch.brdf.files.exr_tensors import read_colour
from raden_torch.brdf.model.model import CosineDiffuse
from raden_torch.images.exr import write_channels

Command = Callable[..., subprocess.CompletedProcess[str]]
SIZE, EYE = 64, 5.0


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A matt model, and a ball of radius 0.5 that touches the wall z = 0, as an EXR."""
    made = tmp_path_factory.mktemp("shadows")
    part = CosineDiffuse(torch.full((3,), 0.3), torch.ones(3))
    rt.save_model(rt.RadenBrdf(part, None), made / "m.safetensors")
    across = (2 * (np.arange(SIZE) + 0.5) / SIZE - 1) * 0.4
    x, y = np.meshgrid(across, -across)
    rays = np.stack([x, y, -np.ones_like(x)])
    eye, centre = np.array([0, 0, EYE]), np.array([0, 0, 0.5])
    square, half = (rays**2).sum(0), np.einsum("c,chw->hw", eye - centre, rays)
    root = half**2 - square * ((eye - centre) @ (eye - centre) - 0.25)
    on_ball = root > 0
    reach = np.where(on_ball, (-half - np.sqrt(np.where(on_ball, root, 0))) / square, EYE)
    point = eye[:, None, None] + reach * rays
    wall = np.array([0.0, 0.0, 1.0])[:, None, None]
    normal = np.where(on_ball, (point - centre[:, None, None]) / 0.5, wall)
    layers = {"N": normal, "P": point}
    channels = {f"{k}.{c}": v[i] for k, v in layers.items() for i, c in enumerate("XYZ")}
    write_channels(made / "shot.exr", {k: v.astype(np.float32) for k, v in channels.items()})
    return made


def render(raden: Command, folder: Path, *words: str) -> subprocess.CompletedProcess[str]:
    return raden(
        *("render", str(folder / "m.safetensors"), "--gbuffer", str(folder / "shot.exr")),
        *("--light", "1,0,0.7", *words),
    )


def test_the_wall_is_dark_beside_the_ball(raden: Command, folder: Path) -> None:
    seen = ("--camera", f"0,0,{EYE}")
    for name, more in (("lit", ()), ("shadowed", ("--shadows", "--thickness", "0.5"))):
        done = render(raden, folder, *seen, *more, "-o", str(folder / f"{name}.exr"))
        assert done.returncode == 0, done.stderr
    lit, shadowed = (read_colour(folder / f"{k}.exr")[0, 1] for k in ("lit", "shadowed"))
    middle = SIZE // 2
    dark, right = shadowed[middle] == 0, SIZE // 2 + 12
    assert int(dark[:middle].sum()) > 8  # the lamp is on the right
    assert not dark[right:].any()
    assert bool((lit > 0)[:, 0].all())
    kept = shadowed != 0
    assert torch.equal(shadowed[kept], lit[kept])
    done = render(raden, folder, *seen, "--shadows", "-o", str(folder / "shadowed.png"))
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("--shadows",), "expected a G-buffer with position and camera, got position alone"),
        (("--thickness", "1"), "--thickness: expected with --shadows"),
        (
            ("--shadows", "--camera", f"0,0,{EYE}", "--memory", "700K"),
            "shadows: expected an image that is read at once, got 2 bands",
        ),
        (("--shadows", "--camera", "3,0,1"), "a pinhole at --camera sees in their pixels"),
    ],
)
def test_why_there_are_none_is_one_line(raden: Command, folder: Path, words, said) -> None:
    output = folder / "refused.exr"
    done = render(raden, folder, *words, "-o", str(output))
    assert done.returncode == 2
    assert done.stderr.count("\n") == 1
    assert said in done.stderr
    assert not output.exists()
