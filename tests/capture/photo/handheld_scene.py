"""Simulated photographs and films by a phone in the hand: a flat piece, a white field, and what
else is wanted, on a printed ChArUco card under one small lamp. A ray caster of its own in NumPy and
OpenCV, without the package's geometry.

Radiance is that of a lamp of radiant intensity 1 per steradian: the irradiance is cosθ / d²."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

import cv2
import numpy as np

from tests.capture.photo.brdf.conftest import unit
from tests.capture.photo.handheld_card import (
    GREYS,
    TABLE,
    Card,
    Scene,
    lamp_in_camera,
    lamp_on_board,
    patches,
    rectangle,
)
from tests.capture.photo.handheld_phone import (
    Frame,
    Phone,
    developed,
    hand_path,
    inverse_tone_curve,
    project,
    tone_curve,
)

__all__ = [
    "GREYS", "Card", "Frame", "Phone", "Scene", "auto_gains", "blur_extent_px", "developed",
    "hand_path", "inverse_tone_curve", "lamp_in_camera", "lamp_on_board", "patches", "project",
    "radiance", "rectangle", "tone_curve", "write_clip", "write_stills",
]  # fmt: skip

Array = np.ndarray
CHROME, GLASS = 0.6, 0.04  # reflectances of their mirror images
SEEN_PIECE = 0.3  # the piece's reflectance in a ball's mirror image, where it counts as matt


def irradiance(scene: Scene, lamp: Array, x: Array, y: Array, pixel_m: Array | float) -> Array:
    """Of the plane's points, with the balls' shadows, whose edges a pixel of `pixel_m` smooths."""
    toward = [np.float32(lamp[0]) - x, np.float32(lamp[1]) - y, np.float32(lamp[2])]
    square = toward[0] ** 2 + toward[1] ** 2 + toward[2] ** 2
    length = np.sqrt(square)
    light = max(-lamp[2], 0) / (square * length)
    for bx, by, r in scene.balls_m:
        ball = [np.float32(bx) - x, np.float32(by) - y, np.float32(-r)]
        along = sum(a * b for a, b in zip(ball, toward, strict=True)) / length
        miss = np.sqrt(np.maximum(sum(b**2 for b in ball) - along**2, 0))
        soft = np.maximum(scene.lamp_radius_m * along / np.maximum(length - along, 1e-6), 0)
        soft = np.maximum(soft, 0.5 * pixel_m)
        seen = np.clip((miss - r) / (2 * soft) + 0.5, 0, 1)
        light *= np.where((along > 0) & (along < length), seen, 1)
    return light


def disc(ray: Array, toward: Array, radius: Array | float, pixel: Array | float) -> Array:
    """0..1 of the lamp's disc that a ray meets; `radius` and a pixel's width `pixel` in radians."""
    return np.clip((radius - np.linalg.norm(ray - toward, axis=-1)) / pixel + 0.5, 0, 1)


def plane_radiance(scene: Scene, phone: Phone, frame: Frame, lamp: Array) -> Array:
    """`[H, W, 3]` of the card, what lies on it, the table, and the lamp itself, before the lens."""
    levels, low, step = scene.texture
    back = np.linalg.inv(np.c_[frame.rotation[:, :2], frame.shift_m])
    focal = phone.matrix[0, 0]
    depth = np.linalg.norm(frame.shift_m + frame.rotation[:, :2] @ np.array(scene.card.size_m) / 2)
    level = int(np.clip(np.round(np.log2(depth / focal / 3 / step)), 0, len(levels) - 1))
    scale, (left, top) = 1 / (step * 2**level), -low / (step * 2**level) - 0.5
    on_texture = np.array([[scale, 0, left], [0, scale, top], [0, 0, 1]]) @ back
    there = cv2.perspectiveTransform(phone.fine, on_texture)
    seen = cv2.remap(
        levels[level], there, None, cv2.INTER_LINEAR,
        borderMode=cv2.BORDER_CONSTANT, borderValue=(TABLE, 0, 0),
    )  # fmt: skip
    seen = cv2.resize(seen, phone.size[::-1], interpolation=cv2.INTER_AREA)
    at = cv2.perspectiveTransform(phone.coarse, back)
    x, y = at[..., 0], at[..., 1]
    over = (phone.coarse @ back[2, :2].astype(np.float32) + np.float32(back[2, 2])) <= 0.02
    seen[over] = 0  # above the horizon, or nearly
    light = irradiance(scene, lamp, x, y, depth / focal)
    light[over] = 0
    linear = np.repeat((seen[..., 0] * light / np.pi)[..., None], 3, -1)
    place = frame.place_m
    for channel in (1, 2):
        row, column = np.nonzero(seen[..., channel])
        if not len(row):
            continue
        point = np.stack([x[row, column], y[row, column], 0 * row], 1).astype(np.float64)
        to, view = lamp - point, unit(place - point)
        far = np.linalg.norm(to, axis=1, keepdims=True)
        cover = seen[row, column, channel, None]
        if channel == 1:
            normal = np.broadcast_to([0.0, 0.0, -1.0], point.shape)
            f = scene.brdf(normal, to / far, view)
            linear[row, column] += cover * f * light[row, column, None]
        else:
            away = np.linalg.norm(place - point, axis=1)
            mirrored = view * [-1, -1, 1]
            pixel = (1 + away / far[:, 0]) / focal
            met = disc(mirrored, to / far, scene.lamp_radius_m / far[:, 0], pixel)
            linear[row, column] += GLASS * cover * met[:, None] / (np.pi * scene.lamp_radius_m**2)
    lamp_seen = frame.rotation @ lamp + frame.shift_m
    if lamp_seen[2] > 0.02:  # the camera may see the lamp itself
        far = np.linalg.norm(lamp_seen)
        ray = unit(np.concatenate([phone.coarse, np.ones_like(phone.coarse[..., :1])], -1))
        met = disc(ray, (lamp_seen / far).astype(np.float32), scene.lamp_radius_m / far, 1 / focal)
        linear += met[..., None] / (np.pi * scene.lamp_radius_m**2)
    return linear


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

    def add(values: Array, low: Array, high: Array, fine: int, remains: Array | None) -> None:
        window = linear[low[1] : high[1], low[0] : high[0]]
        wide, tall = high - low
        for part, to in ((remains, np.multiply), (values, np.add)):
            if part is not None:
                mean = part.reshape(tall, fine, wide, fine).mean((1, 3))
                to(window, mean[..., None], out=window, casting="same_kind")

    pixels, hit, point, mirrored, off = cast(low, high, 4)
    if not hit.any():
        return
    shown = np.zeros(len(pixels))
    shown[hit] = CHROME * card_in_mirror(scene, lamp, point[hit], mirrored[hit])
    add(shown, low, high, 4, ~hit)
    # the highlight is small: finely, around the place where the mirrored ray is nearest to the lamp
    best = pixels[hit][off[hit].argmin()]
    low = np.maximum(np.round(best).astype(int) - 2, 0)
    high = np.minimum(np.round(best).astype(int) + 3, phone.size[::-1])
    _, hit, _, _, off = cast(low, high, 32)
    lit = CHROME / (np.pi * scene.lamp_radius_m**2) * (hit & (off < 1))
    add(lit, low, high, 32, None)


def at_rest(scene: Scene, phone: Phone, frame: Frame) -> Array:
    lamp = lamp_on_board(scene, frame)
    linear = plane_radiance(scene, phone, frame, lamp)
    far_first = sorted(
        scene.balls_m,
        key=lambda b: -np.linalg.norm(frame.place_m - [b[0], b[1], -b[2]]),
    )
    for ball in far_first:
        add_ball(linear, scene, phone, frame, lamp, np.array(ball))
    return linear


def blur_extent_px(scene: Scene, phone: Phone, frame: Frame) -> float:
    """The longest way of the card's corners and middle over the exposure."""
    size = np.array(scene.card.size_m)
    points = np.c_[np.array([[0, 0], [1, 0], [0, 1], [1, 1], [0.5, 0.5]]) * size, np.zeros(5)]
    ends = [project(points, phone, frame.at(part)) for part in (-0.5, 0.5)]
    return float(np.linalg.norm(ends[1] - ends[0], axis=1).max())


def radiance(scene: Scene, phone: Phone, frame: Frame, *, step_px: float = 1.0) -> Array:
    """`[H, W, 3]` float32 linear radiance at the sensor, blurred by lens and motion (the mean of
    poses not more than `step_px` apart over the exposure), with vignetting, without noise."""
    extent = blur_extent_px(scene, phone, frame)
    count = 1 if extent < 0.4 else int(np.ceil(extent / step_px)) + 1
    linear = np.zeros((*phone.size, 3), np.float32)
    for part in (np.arange(count) + 0.5) / count - 0.5:
        linear += at_rest(scene, phone, frame.at(part)) / count
    linear *= np.array(scene.tint, np.float32)
    sigma = float(np.hypot(phone.blur_px, frame.defocus_px))
    if sigma:
        linear = cv2.GaussianBlur(linear, (0, 0), sigma)
    if phone.vignetting:
        linear *= phone.falloff.astype(np.float32)
    return linear


def auto_gains(
    scene: Scene,
    phone: Phone,
    frames: Sequence[Frame],
    *,
    level: float = 0.8,
    drift: float = 0.0,
    seed: int = 0,
) -> list[float]:
    """The gains of an automatic exposure: the 0.99 quantile of the picture's middle half comes to
    `level` of a full pixel, by a picture of a quarter the side, times a random walk of relative
    step `drift` a frame."""
    small = phone.scaled(0.25)
    height, width = small.size
    middle = np.s_[height // 4 : -height // 4, width // 4 : -width // 4]
    walk = np.exp(drift * np.random.default_rng([seed, 2]).normal(size=len(frames)).cumsum())
    gains = []
    for frame, factor in zip(frames, walk, strict=True):
        still = Frame(frame.rotation, frame.shift_m)
        gains.append(factor * level / np.quantile(radiance(scene, small, still)[middle], 0.99))
    return [float(g) for g in gains]


def pictures(
    scene: Scene, phone: Phone, frames: Sequence[Frame], gain: float | Sequence[float], seed: int
) -> Iterator[Array]:
    """`[H, W, 3]` uint8 BGR of each frame."""
    gains = np.broadcast_to(np.asarray(gain, float), len(frames))
    for k, (frame, g) in enumerate(zip(frames, gains, strict=True)):
        random = np.random.default_rng([seed, k])
        yield developed(radiance(scene, phone, frame), phone, g, random)[..., ::-1]


def write_stills(
    folder: Path,
    scene: Scene,
    phone: Phone,
    frames: Sequence[Frame],
    *,
    gain: float | Sequence[float],
    seed: int,
) -> list[Path]:
    """A JPEG `still000.jpg` … of each frame; `gain`: one (locked exposure), or one a frame."""
    paths = []
    for k, picture in enumerate(pictures(scene, phone, frames, gain, seed)):
        coded = cv2.imencode(".jpg", picture, [cv2.IMWRITE_JPEG_QUALITY, phone.quality])[1]
        paths.append(folder / f"still{k:03d}.jpg")
        paths[-1].write_bytes(coded.tobytes())
    return paths


def write_clip(
    path: Path,
    scene: Scene,
    phone: Phone,
    frames: Sequence[Frame],
    *,
    gain: float | Sequence[float],
    seed: int,
    rate: float = 30.0,
) -> Path:
    """A film of all frames, by the path's ending: .mp4 (MPEG-4) or .avi (Motion JPEG)."""
    kind = {".mp4": "mp4v", ".avi": "MJPG"}[path.suffix]
    writer = cv2.VideoWriter(
        str(path), cv2.VideoWriter_fourcc(*kind), rate, phone.size[::-1],
        [cv2.VIDEOWRITER_PROP_QUALITY, phone.quality],
    )  # fmt: skip
    if not writer.isOpened():
        raise OSError(f"{path}: expected OpenCV to write {kind}, got no writer")
    for picture in pictures(scene, phone, frames, gain, seed):
        writer.write(np.ascontiguousarray(picture))
    writer.release()
    return path
