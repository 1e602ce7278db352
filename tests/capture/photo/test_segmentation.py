"""The map of an inlay's materials from photographs: rendered boards of known pieces."""

from __future__ import annotations

import subprocess
from collections.abc import Callable
from itertools import permutations
from pathlib import Path

import cv2
import numpy as np
import pytest
import torch

import raden_torch as rt
from raden_torch.artwork import board
from raden_torch.brdf.materials.palette import Palette
from raden_torch.capture.photo.segmentation import segment
from raden_torch.errors import InputError

Command = Callable[..., subprocess.CompletedProcess[str]]
NAMES = ("awabi", "mexican", "yakogai")
LAMPS = ((-0.3, 0.9, 0.8), (0.8, 0.5, 0.9), (0.2, -0.6, 1.0))
WIDTH = 360


@pytest.fixture(scope="module")
def photographs() -> list[np.ndarray]:
    """A board with the motif in three shells, under three lamps in turn, and a dim room."""
    shells = [
        rt.fit(rt.simulate_specimen(name, step_deg=10), interpolation="trilinear").model
        for name in NAMES
    ]
    room = rt.DirectionalLight((0, 0.2, 1), 0.1)
    with torch.no_grad():
        images = [
            board.shade_materials(
                Palette(shells, NAMES), [rt.DirectionalLight(lamp, 2.0), room], WIDTH
            )
            for lamp in LAMPS
        ]
    return [image[0].movedim(0, -1).numpy() for image in images]


@pytest.fixture(scope="module")
def truth() -> np.ndarray:
    """0 for lacquer, 1 to 3 for the panels' shells."""
    coverage = board._board(NAMES, WIDTH, 1).maps.coverage[0].numpy()
    panel = np.arange(WIDTH) * len(NAMES) // WIDTH
    return np.where(coverage > 0.5, panel + 1, 0)


def best_named(index: np.ndarray, truth: np.ndarray) -> np.ndarray:
    """The shells' numbers exchanged so that they fit best: no photograph knows their names."""
    named = (np.array((0, *order))[index] for order in permutations((1, 2, 3)))
    return max(named, key=lambda found: (found == truth).sum())


def test_three_shells_are_told_apart(photographs: list[np.ndarray], truth: np.ndarray) -> None:
    found = segment(photographs, 3)
    assert sum(found.areas) == truth.size
    assert list(found.areas[1:]) == sorted(found.areas[1:], reverse=True)
    named = best_named(found.index, truth)
    shell = (truth > 0) & (named > 0)
    assert (named == truth)[shell].mean() > 0.98
    assert (named == truth).mean() > 0.95  # what is missing are edges of a pixel


def test_the_order_of_the_photographs_does_not_matter(photographs: list[np.ndarray]) -> None:
    first, second = (segment(each, 3).index for each in (photographs, photographs[::-1]))
    assert (first == second).mean() > 0.999


def test_from_the_command_line(
    raden: Command, photographs: list[np.ndarray], truth: np.ndarray, tmp_path: Path
) -> None:
    paths = []
    for k, photo in enumerate(photographs):
        stored = np.clip(photo / np.percentile(photo, 99.9), 0, 1) ** (1 / 2.2)
        paths.append(tmp_path / f"lamp{k}.png")
        cv2.imwrite(str(paths[-1]), np.rint(stored[..., ::-1] * 255).astype(np.uint8))
    done = raden("capture", "segment", *paths, "--shells", "3", "-o", tmp_path / "map.png")
    assert done.returncode == 0, done.stderr
    assert "pieces of 3 shells; ground: " in done.stdout
    index = cv2.imread(str(tmp_path / "map.png"), cv2.IMREAD_UNCHANGED)
    assert index.dtype == np.uint8
    assert (best_named(index, truth) == truth).mean() > 0.95
    picture = cv2.imread(str(tmp_path / "map.found.png"))
    assert picture.shape == (truth.shape[0], 2 * WIDTH, 3)
    done = raden("capture", "segment", *paths, "--shells", "300", "-o", tmp_path / "no.png")
    assert done.returncode == 2
    assert "--shells: expected 1…254" in done.stderr or "shells: expected 1…254" in done.stderr
    assert not (tmp_path / "no.png").exists()


@pytest.mark.parametrize(
    ("photos", "shells", "message"),
    [
        ([], 1, "photographs: expected at least one"),
        ([np.ones((8, 8, 3), np.float32)], 0, r"shells: expected 1…254"),
        ([np.ones((8, 8, 3), np.float32), np.ones((8, 9, 3), np.float32)], 1, "expected one size"),
        ([np.zeros((8, 8, 3), np.float32)], 2, "expected at least 2 pieces of 16 pixels or more"),
    ],
)
def test_what_shows_no_pieces(photos: list[np.ndarray], shells: int, message: str) -> None:
    with pytest.raises(InputError, match=message):
        segment(photos, shells)
