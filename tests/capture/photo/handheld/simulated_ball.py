"""Balls of chrome in the simulated photographs: the lamp's highlight, the card's mirror image."""

from __future__ import annotations

import cv2
import numpy as np

from tests.capture.photo.brdf.conftest import unit
from tests.capture.photo.handheld.simulated_card import Scene, irradiance
from tests.capture.photo.handheld.simulated_phone import Frame, Phone

Array = np.ndarray
CHROME = 0.6  # reflectance
FINE = 24  # rays a pixel's side around the highlight
SEEN_PIECE = 0.3  # the piece's reflectance in a ball's mirror image, where it counts as matt


def mirrored_by(
    lamp: Array, lamp_radius: float, ball: Array, start: Array, rays: Array
) -> tuple[Array, Array, Array, Array]:
    """Rays `[P, 3]` from `start` `[3]` and a ball (x, y, radius): `[P]` whether they meet, `[P, 3]`
    where, `[P, 3]` the mirrored rays, and `[P]` their angle to the lamp in its angular radii."""
    centre, radius = np.array([ball[0], ball[1], -ball[2]]), ball[2]
    from_ = start - centre
    b = rays @ from_
    root = b**2 - (from_ @ from_ - radius**2)
    point = start + (-b - np.sqrt(np.maximum(root, 0)))[:, None] * rays
    normal = (point - centre) / radius
    mirrored = rays - 2 * (rays * normal).sum(1)[:, None] * normal
    far = np.linalg.norm(lamp - point, axis=1)
    off = np.linalg.norm(mirrored - (lamp - point) / far[:, None], axis=1)
    return root > 0, point, mirrored, off / (lamp_radius / far)


def card_in_mirror(scene: Scene, lamp: Array, point: Array, mirrored: Array) -> Array:
    """`[P]` radiance of card and table where mirrored rays `[P, 3]` meet them, 0 of the others."""
    levels, low, step = scene.texture
    down = mirrored[:, 2] > 1e-3
    on = point[down] - (point[down, 2:] / mirrored[down, 2:]) * mirrored[down]
    high, wide = levels[2].shape[:2]
    column, row = np.clip((on[:, :2] - low) / (4 * step), 0, [wide - 1, high - 1]).astype(int).T
    seen = levels[2][row, column]  # its edge is all table
    light = irradiance(scene, lamp, on[:, 0], on[:, 1], 1e-4)
    shown = np.zeros(len(point))
    shown[down] = (seen[:, 0] + SEEN_PIECE * seen[:, 1]) * light / np.pi
    return shown


def add_ball(
    linear: Array, scene: Scene, phone: Phone, frame: Frame, lamp: Array, ball: Array
) -> None:
    """Draw a ball over `[H, W, 3]`, with the lamp's highlight."""
    start, radius = frame.place_m, ball[2]
    centre = frame.rotation @ np.array([ball[0], ball[1], -radius]) + frame.shift_m
    if centre[2] < 2 * radius:
        return
    # the circle in which the rays that touch the ball do so
    distance = np.linalg.norm(centre)
    axis, sine = centre / distance, radius / distance
    across = unit(np.cross(axis, [0.0, 1, 0]))
    angle = np.linspace(0, 2 * np.pi, 64)[:, None]
    rim = np.cos(angle) * across + np.sin(angle) * np.cross(axis, across)
    rim = distance * (1 - sine**2) * axis + radius * np.sqrt(1 - sine**2) * rim
    lens = phone.matrix, phone.distortion
    rim = cv2.projectPoints(rim, np.zeros(3), np.zeros(3), *lens)[0].reshape(-1, 2)
    low = np.maximum(np.floor(rim.min(0)) - 2, 0).astype(int)
    high = np.minimum(np.ceil(rim.max(0)) + 3, phone.size[::-1]).astype(int)
    if (high <= low).any():
        return

    def cast(low: Array, high: Array, fine: int) -> tuple[Array, ...]:
        u, v = (
            (np.arange(a * fine, b * fine) + 0.5) / fine - 0.5
            for a, b in zip(low, high, strict=True)
        )
        pixels = np.stack(np.meshgrid(u, v), -1).reshape(-1, 2)
        rays = unit(np.c_[phone.along(pixels), np.ones(len(pixels))]) @ frame.rotation
        return pixels, *mirrored_by(lamp, scene.lamp_radius_m, ball, start, rays)

    pixels, hit, point, mirrored, off = cast(low, high, 4)
    if not hit.any():
        return
    shown = np.zeros(len(pixels))
    shown[hit] = CHROME * card_in_mirror(scene, lamp, point[hit], mirrored[hit])
    window = linear[low[1] : high[1], low[0] : high[0]]
    wide, tall = high - low
    for values, to in ((~hit, np.multiply), (shown, np.add)):
        mean = values.reshape(tall, 4, wide, 4).mean((1, 3))
        to(window, mean[..., None], out=window, casting="same_kind")
    # the highlight is small: finely, around the place where the mirrored ray is nearest to the lamp
    best = np.round(pixels[hit][off[hit].argmin()]).astype(int)
    low = np.maximum(best - 2, 0)
    high = np.minimum(best + 3, phone.size[::-1])
    pixels, hit, _, _, off = cast(low, high, FINE)
    lit = pixels[hit & (off < 1)]
    # shared among the four nearest pixels, so that a spot within one keeps its place under the blur
    at = np.clip(np.floor(lit), 0, np.array(phone.size[::-1]) - 2)
    part = lit - at
    column, row = at.astype(int).T
    power = CHROME / (np.pi * scene.lamp_radius_m**2) / FINE**2
    for dx in (0, 1):
        for dy in (0, 1):
            weight = np.abs(1 - dx - part[:, 0]) * np.abs(1 - dy - part[:, 1])
            np.add.at(linear, (row + dy, column + dx), np.float32(power) * weight[:, None])
