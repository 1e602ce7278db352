"""Simulated footage of a phone in the hand, made once for all tests."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest

from raden_torch.capture.photo.board import Board, BoardView
from raden_torch.capture.photo.camera import Camera, Pose
from raden_torch.capture.photo.handheld.handheld_setup import GreyPatch, HandheldSetup
from raden_torch.capture.photo.handheld.lamp_sights import ChromeBall
from tests.capture.photo.handheld.simulated_scene import (
    GREYS,
    Frame,
    Phone,
    Scene,
    auto_gains,
    hand_path,
    patches,
    project,
    rectangle,
    write_clip,
    write_stills,
)

BALL = (0.155, 0.03, 0.015)
PIECE_M, WHITE_M = rectangle(0.056, 0.052, 0.108, 0.090), rectangle(0.120, 0.053, 0.140, 0.089)
GREY_M = rectangle(0.02, 0.118, 0.09, 0.132)
LAMPS_M = ((-0.12, -0.05, -0.30), (0.30, 0.10, -0.25))
FLASH_M = (0.014, -0.006, 0.0)


@dataclass(frozen=True, eq=False)
class Footage:
    """What was filmed, and how it was."""

    paths: list[Path]
    phone: Phone
    frames: list[Frame]


def setup(**more: object) -> HandheldSetup:
    """What a person says of the scene, the ball's place to 2 mm."""
    middles = patches(GREY_M).mean(axis=1)
    said = HandheldSetup(
        Board(11, 9, 0.016, 0.012),
        PIECE_M,
        WHITE_M,
        balls=(ChromeBall(BALL[0] + 0.001, BALL[1] + 0.0015, BALL[2]),),
        greys=tuple(GreyPatch(x, y, g) for (x, y), g in zip(middles, GREYS, strict=True)),
    )
    return replace(said, **more)


@pytest.fixture(scope="session")
def phone() -> Phone:
    return Phone(balance=(1.25, 1.0, 0.8))


@pytest.fixture(scope="session")
def footage(tmp_path_factory: pytest.TempPathFactory, phone: Phone) -> Footage:
    """A film of 36 frames, three of them shaken and one out of focus, under one lamp, and 24 stills
    under another, exposed automatically."""
    folder = tmp_path_factory.mktemp("footage")
    paths, all_frames = [], []
    for k, lamp in enumerate(LAMPS_M):
        scene = Scene(lamp_m=np.array(lamp), grey_m=GREY_M, balls_m=(BALL,))
        stills = k == 1
        frames = hand_path(
            24 if stills else 36,
            seed=20 + k,
            shaken=() if stills else (10, 11, 12),
            defocused={} if stills else {20: 4.0},
            exposure_s=0.0 if stills else 0.002,
            polar_deg=(8.0, 52.0),
        )
        gain = auto_gains(scene, phone, frames, level=0.6, drift=0.01, seed=k)
        if stills:
            (folder / "stills").mkdir()
            write_stills(folder / "stills", scene, phone, frames, gain=gain, seed=k)
            paths.append(folder / "stills")
        else:
            paths.append(write_clip(folder / "walk.avi", scene, phone, frames, gain=gain, seed=k))
        all_frames += frames
    return Footage(paths, phone, all_frames)


@pytest.fixture(scope="session")
def views(phone: Phone) -> Callable[..., tuple[list[BoardView], Camera, list[Pose]]]:
    """Corners as they would be found in pictures: by geometry alone, with 0.1 px of noise."""

    def make(
        count: int = 12,
        heights: Callable[[np.ndarray], np.ndarray] | None = None,
        zoom: float = 1.0,
        seed: int = 0,
    ) -> tuple[list[BoardView], Camera, list[Pose]]:
        random = np.random.default_rng(seed)
        board = Board(11, 9, 0.016, 0.012, legacy=False)
        points = board.corners_m.copy()
        if heights is not None:
            points[:, 2] = heights(points)
        lens = phone.matrix * np.array([[zoom], [zoom], [1]]) + np.array(
            [[0, 0, (1 - zoom) * phone.matrix[0, 2]], [0, 0, (1 - zoom) * phone.matrix[1, 2]],
             [0, 0, 0]]
        )  # fmt: skip
        seen, poses = [], []
        for k, frame in enumerate(hand_path(count, seed=seed, polar_deg=(25.0, 50.0))):
            zoomed = replace(phone, matrix=lens) if k == count - 1 else phone
            pixels = project(points, zoomed, frame) + 0.1 * random.normal(size=(len(points), 2))
            ids = np.arange(len(points), dtype=np.int32)
            seen.append(BoardView(f"p{k}.jpg", phone.size, board, ids, pixels))
            poses.append(Pose(frame.rotation, frame.shift_m, 0.1, len(ids)))
        return seen, Camera(phone.matrix, phone.distortion, phone.size), poses

    return make
