"""Is the stated standard deviation of a lamp's direction what chrome balls err by?"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from raden_torch.capture.photo.ball import Ball
from raden_torch.capture.photo.highlight import Highlight
from raden_torch.capture.photo.lamp_errors import direction_std_deg, highlight_std_px
from raden_torch.capture.photo.lamps import lamps_from_balls, read_lamps, write_lamps

MATRIX = np.array([[900.0, 0, 320], [0, 900.0, 240], [0, 0, 1]])


def seen_at(ball: Ball, lamp: np.ndarray, *, near: bool) -> tuple[float, float]:
    """Where a mirror ball shows a lamp: the pixel whose reflected ray meets it, by search."""
    from scipy.optimize import least_squares

    def off(at: np.ndarray) -> np.ndarray:
        point, way = ball.towards_lamp(at[0], at[1])
        to = lamp - point if near else lamp
        return np.asarray(way - to / np.linalg.norm(to))

    start = np.array([ball.x_px + 0.3, ball.y_px - 0.2])
    found = least_squares(off, start, x_scale=5.0, xtol=1e-12).x
    return float(found[0]), float(found[1])


def far_ball(x: float, y: float, radius: float) -> Ball:
    return Ball(x, y, radius, 0.25, np.array([x, -y, 0.0]), radius)


def ball_before(centre: np.ndarray, radius: float) -> Ball:
    x, y = 320 + 900 * centre[0] / -centre[2], 240 - 900 * centre[1] / -centre[2]
    return Ball(x, y, -900 * radius / centre[2], 0.25, centre, radius, MATRIX)


def directions(count: int, random: np.random.Generator) -> np.ndarray:
    away, turn = random.uniform(0.2, 1.1, count), random.uniform(0, 2 * np.pi, count)
    return np.stack([np.sin(away) * np.cos(turn), np.sin(away) * np.sin(turn), np.cos(away)], 1)


def standardised(balls: list[Ball], lamps: np.ndarray, *, near: bool, seed: int) -> np.ndarray:
    """`[K, 2]` errors across over the stated deviation, of balls whose outline and highlights are
    drawn with the errors that are assumed of them."""
    random = np.random.default_rng(seed)
    true = [[seen_at(ball, lamp, near=near) for ball in balls] for lamp in lamps]
    off = highlight_std_px(20) * random.normal(size=(len(lamps), len(balls), 2))
    seen = [
        [Highlight(x + dx, y + dy, 20, "a.png") for (x, y), (dx, dy) in zip(row, by, strict=True)]
        for row, by in zip(true, off, strict=True)
    ]
    drawn = []
    for ball in balls:
        dx, dy, dr = ball.std_px * random.normal(size=3)
        pixel = ball.radius / ball.radius_px
        if ball.matrix is None:
            drawn.append(far_ball(ball.x_px + dx, ball.y_px + dy, ball.radius_px + dr))
        else:
            moved = ball.centre + pixel * np.array([dx, dy, 0])
            drawn.append(replace(ball, centre=moved * (1 + dr / ball.radius_px)))
    found = lamps_from_balls(drawn, seen, unit="mm" if near else "px")
    std = direction_std_deg(found, drawn, seen)
    middle = np.mean([ball.centre for ball in balls], axis=0)
    truth = lamps - middle if near else lamps
    truth = truth / np.linalg.norm(truth, axis=1, keepdims=True)
    error = np.degrees(np.linalg.norm(found.direction - truth, axis=1)) / np.sqrt(2)
    return np.asarray(error / std)


def test_one_ball_and_far_lamps() -> None:
    """Expected: the root mean square of error over stated is 1, over 40 drawn balls of 6 lamps."""
    z = [
        standardised(
            [far_ball(100.2, 90.7, 60.0)],
            directions(6, np.random.default_rng(seed)),
            near=False,
            seed=seed,
        )
        for seed in range(40)
    ]
    assert 0.85 < np.sqrt(np.mean(np.square(z))) < 1.15


def test_two_balls_and_near_lamps() -> None:
    """With a camera: positions, seen from the balls' middle."""
    balls = [ball_before(np.array([x, 5.0, -500.0]), 20.0) for x in (-40.0, 45.0)]
    z = []
    for seed in range(25):
        away = directions(4, np.random.default_rng(seed))
        lamps = np.array([2.5, 5.0, -500.0]) + 500 * away
        z.append(standardised(balls, lamps, near=True, seed=seed))
    assert 0.85 < np.sqrt(np.mean(np.square(z))) < 1.2


def test_a_lights_file_keeps_it(tmp_path: Path) -> None:
    lamps = lamps_from_balls(
        [far_ball(100, 90, 60)], [[Highlight(90.0 + 5 * k, 80.0, 20, f"{k}.png")] for k in range(3)]
    )
    write_lamps(lamps, tmp_path / "none.json")
    assert read_lamps(tmp_path / "none.json").std_deg is None
    lamps = replace(lamps, std_deg=np.array([0.1234, 0.2, 0.5]))
    write_lamps(lamps, tmp_path / "lights.json")
    found = read_lamps(tmp_path / "lights.json")
    np.testing.assert_allclose(found.std_deg, [0.123, 0.2, 0.5])
    assert "± 0.20 deg" in str(lamps)


@pytest.mark.parametrize("area", [4, 20, 80])
def test_the_centroid_of_a_clipped_disc(area: int) -> None:
    """Discs of that area anywhere between the pixels: the centroid of the pixels that they hold."""
    random, radius = np.random.default_rng(area), np.sqrt(area / np.pi)
    y, x = np.mgrid[:30, :30]
    off = []
    for _ in range(300):
        at = 15 + random.random(2)
        inside = np.hypot(x - at[0], y - at[1]) < radius
        off.append([x[inside].mean() - at[0], y[inside].mean() - at[1]])
    scatter = float(np.std(off))
    assert 0.4 * highlight_std_px(area) < scatter < 1.3 * highlight_std_px(area)
