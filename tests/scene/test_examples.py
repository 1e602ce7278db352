"""The scene files in examples/ render, at a small size."""

from __future__ import annotations

from pathlib import Path

import pytest
import torch

from raden_torch.scene.scene import Scene

EXAMPLES = sorted((Path(__file__).resolve().parents[2] / "examples" / "scenes").glob("*.toml"))


def test_there_are_examples() -> None:
    assert EXAMPLES


@pytest.mark.slow
@pytest.mark.parametrize("path", EXAMPLES, ids=lambda path: path.stem)
def test_an_example_renders(path: Path) -> None:
    scene = Scene.read(path, width=128)
    image = scene.frame(scene.table.animation.frames // 2)
    assert image.shape == (1, 3, 72, 128)
    assert torch.isfinite(image).all()
    lid = image[0, :, 20:30, 45:70]
    assert float(lid.std()) > 0.02  # a decoration
    assert scene.caption is not None
    assert "yakogai" in scene.caption
