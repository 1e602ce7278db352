"""Simulated photographs of charts and boards: warped, turned, noisy, blurred, of known truth."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import cv2
import numpy as np
import pytest

from raden_torch.capture.photo.board import Board
from raden_torch.capture.photo.chart_reference import reference_xyz
from raden_torch.measurement.colour_conversion import xyz_to_rgb_matrix

CAMERA_PX = np.array([[620.0, 0, 318], [0, 622, 243], [0, 0, 1]])
"""Of the simulated photographs of boards, without distortion."""


@dataclass(frozen=True)
class Scene:
    """A simulated photograph, `[H, W, 3]` linear RGB, and where the target's points lie in it."""

    linear: np.ndarray
    homography: np.ndarray

    def at(self, points: np.ndarray) -> np.ndarray:
        mapped = np.c_[points, np.ones(len(points))] @ self.homography.T
        return mapped[:, :2] / mapped[:, 2:]

    @property
    def srgb(self) -> np.ndarray:
        x = np.clip(self.linear, 0, 1)
        coded = np.where(x <= 0.0031308, 12.92 * x, 1.055 * x ** (1 / 2.4) - 0.055)
        return np.rint(255 * coded).astype(np.uint8)


def flat_chart(pitch: int = 40, margin: float = 0.5, gap: float = 0.14) -> np.ndarray:
    """A ColorChecker in linear sRGB, `pitch` pixels a patch, with its black frame."""
    rgb = np.clip(reference_xyz() @ xyz_to_rgb_matrix().T, 0, 1)
    height, width = (round((n + 2 * margin) * pitch) for n in (4, 6))
    flat = np.full((height, width, 3), 0.03)
    for i, colour in enumerate(rgb):
        row, column = divmod(i, 6)
        y, x = ((n + margin + gap / 2) * pitch for n in (row, column))
        side = (1 - gap) * pitch
        flat[round(y) : round(y + side), round(x) : round(x + side)] = colour
    return flat


def placed(
    flat: np.ndarray,
    size: tuple[int, int],
    width: float,
    turn_deg: float,
    tilt: float,
    centre: tuple[float, float],
    mirrored: bool,
) -> np.ndarray:
    """`[3, 3]`: pixels of the flat picture → pixels of the photograph."""
    height, flat_width = flat.shape[:2]
    corners = np.array([[0, 0], [flat_width, 0], [flat_width, height], [0, height]], float)
    p = (corners - [flat_width / 2, height / 2]) / flat_width * width
    if mirrored:
        p[:, 0] *= -1
    t = np.deg2rad(turn_deg)
    p = p @ np.array([[np.cos(t), np.sin(t)], [-np.sin(t), np.cos(t)]])
    p = p / (1 + tilt * p[:, :1] / width + 0.6 * tilt * p[:, 1:] / width)  # a leaning plane
    p = p + np.array([centre[0] * size[1], centre[1] * size[0]])
    return cv2.getPerspectiveTransform(corners.astype(np.float32), p.astype(np.float32))


@pytest.fixture
def chart_scene() -> Callable[..., Scene]:
    """Make a simulated photograph of a chart; `Scene.at` takes chart coordinates (6 x 4)."""

    def make(
        *,
        size: tuple[int, int] = (480, 640),
        width: float = 400,
        turn_deg: float = 0.0,
        tilt: float = 0.0,
        centre: tuple[float, float] = (0.5, 0.5),
        mirrored: bool = False,
        noise: float = 0.005,
        blur: float = 0.7,
        background: float = 0.35,
        exposure: float = 0.9,
        camera: np.ndarray | None = None,
        onto: np.ndarray | None = None,
        seed: int = 0,
    ) -> Scene:
        pitch, margin = 40, 0.5
        flat = flat_chart(pitch, margin)
        h = placed(flat, size, width, turn_deg, tilt, centre, mirrored)
        photo = np.full((*size, 3), background) if onto is None else onto.copy()
        big = 3  # supersampled, so that edges are as soft as a lens makes them
        up = np.array([[big, 0, (big - 1) / 2], [0, big, (big - 1) / 2], [0, 0, 1.0]])
        shape = (size[1] * big, size[0] * big)
        warped = cv2.warpPerspective(flat, up @ h, shape)
        cover = cv2.warpPerspective(np.ones(flat.shape[:2]), up @ h, shape)
        warped, cover = (
            cv2.resize(a, size[::-1], interpolation=cv2.INTER_AREA) for a in (warped, cover)
        )
        photo = photo * (1 - cover[..., None]) + warped
        if camera is not None:
            photo = photo @ camera.T
        photo = cv2.GaussianBlur(photo * exposure, (0, 0), blur)
        photo = photo + noise * np.random.default_rng(seed).normal(size=photo.shape)
        to_flat = np.array([[pitch, 0, margin * pitch], [0, pitch, margin * pitch], [0, 0, 1.0]])
        return Scene(photo, h @ to_flat)

    return make


@pytest.fixture
def board_scene() -> Callable[..., np.ndarray]:
    """Make a simulated photograph, `[H, W, 3]` 8 bits, of a printed board before a pinhole."""

    def make(
        board: Board,
        rotation_vector: tuple[float, float, float],
        translation_m: tuple[float, float, float],
        *,
        matrix: np.ndarray = CAMERA_PX,
        size: tuple[int, int] = (480, 640),
        noise: float = 2.0,
        blur: float = 0.6,
        onto: np.ndarray | None = None,
        seed: int = 0,
    ) -> np.ndarray:
        pixels = 60  # a square
        sheet = board.opencv().generateImage((pixels * board.columns, pixels * board.rows))
        sheet = cv2.copyMakeBorder(sheet, 20, 20, 20, 20, cv2.BORDER_CONSTANT, value=255)
        scale = board.square_m / pixels
        # pixel i of the sheet covers [i, i + 1], its centre is i + 0.5
        to_m = np.array([[scale, 0, (0.5 - 20) * scale], [0, scale, (0.5 - 20) * scale], [0, 0, 1]])
        turn, _ = cv2.Rodrigues(np.array(rotation_vector))
        h = matrix @ np.column_stack([turn[:, 0], turn[:, 1], translation_m]) @ to_m
        big = 3
        up = np.array([[big, 0, (big - 1) / 2], [0, big, (big - 1) / 2], [0, 0, 1.0]])
        shape = (size[1] * big, size[0] * big)
        ground = np.full(size, 120.0) if onto is None else onto[..., 0].astype(float)
        seen, cover = (
            cv2.resize(
                cv2.warpPerspective(a.astype(np.float32), up @ h, shape),
                size[::-1],
                interpolation=cv2.INTER_AREA,
            )
            for a in (sheet * 0.8 + 20, np.ones(sheet.shape))
        )
        photo = cv2.GaussianBlur(ground * (1 - cover) + seen, (0, 0), blur)
        photo = photo + noise * np.random.default_rng(seed).normal(size=size)
        return np.repeat(np.clip(np.rint(photo), 0, 255).astype(np.uint8)[..., None], 3, 2)

    return make
