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
from tests.capture.photo.handheld.simulated_ball import add_ball
from tests.capture.photo.handheld.simulated_card import (
    GREYS,
    TABLE,
    Card,
    Scene,
    irradiance,
    lamp_in_camera,
    lamp_on_board,
    patches,
    rectangle,
)
from tests.capture.photo.handheld.simulated_phone import (
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
GLASS = 0.04  # reflectance of its mirror image
LATTICE = np.stack(np.meshgrid(np.linspace(0, 1, 9), np.linspace(0, 1, 9)), -1).reshape(-1, 2)


def disc(ray: Array, toward: Array, radius: Array | float, pixel: Array | float) -> Array:
    """0..1 of the lamp's disc that a ray meets; `radius` and a pixel's width `pixel` in radians."""
    return np.clip((radius - np.linalg.norm(ray - toward, axis=-1)) / pixel + 0.5, 0, 1)


def add_lamp(linear: Array, scene: Scene, phone: Phone, lamp: Array) -> None:
    """The lamp itself, at `[3]` in the camera frame, where the camera sees it."""
    if lamp[2] < 0.02:
        return
    lens = phone.matrix, phone.distortion
    far, focal = np.linalg.norm(lamp), phone.matrix[0, 0]
    if max(abs(lamp[:2] / lamp[2])) > 1:
        return  # far outside of the picture, where the lens model may fold
    middle = cv2.projectPoints(lamp[None], np.zeros(3), np.zeros(3), *lens)[0].ravel()
    around = 1.5 * scene.lamp_radius_m / lamp[2] * focal + 3
    left, top = np.maximum(middle - around, 0).astype(int)
    right, bottom = np.maximum(np.minimum(middle + around, phone.size[::-1]), 0).astype(int)
    xy = phone.coarse[top:bottom, left:right].astype(float)
    ray = unit(np.concatenate([xy, np.ones_like(xy[..., :1])], -1))
    met = disc(ray, lamp / far, scene.lamp_radius_m / far, 1 / focal)
    linear[top:bottom, left:right] += met[..., None] / (np.pi * scene.lamp_radius_m**2)


def window_of(corners_m: Array, phone: Phone, frame: Frame) -> tuple[Array, Array]:
    """Least and one past the greatest pixel `[2]` around the plane's points `[P, 2]`: all of the
    picture's where some lie behind the camera or far aside, where the lens model may fold."""
    points = np.c_[corners_m, np.zeros(len(corners_m))]
    seen = points @ frame.rotation.T + frame.shift_m
    size = np.array(phone.size[::-1])
    if (seen[:, 2] < 0.02).any() or (np.abs(seen[:, :2]) > seen[:, 2:]).any():
        return np.zeros(2, int), size
    pixels = project(points, phone, frame)
    low = np.clip(np.floor(pixels.min(0)) - 3, 0, size - 1).astype(int)
    return low, np.clip(np.ceil(pixels.max(0)) + 4, low + 1, size).astype(int)


def plane_radiance(scene: Scene, phone: Phone, frame: Frame, lamp: Array) -> Array:
    """`[H, W, 3]` of the card, what lies on it, the table, and the lamp itself, before the lens."""
    levels, low, step = scene.texture
    back = np.linalg.inv(np.c_[frame.rotation[:, :2], frame.shift_m])
    focal = phone.matrix[0, 0]
    depth = np.linalg.norm(frame.shift_m + frame.rotation[:, :2] @ np.array(scene.card.size_m) / 2)
    level = int(np.clip(np.round(np.log2(depth / focal / 3 / step)), 0, len(levels) - 1))
    scale, (dx, dy) = 1 / (step * 2**level), -low / (step * 2**level) - 0.5
    on_texture = np.array([[scale, 0, dx], [0, scale, dy], [0, 0, 1]]) @ back
    seen = np.zeros((*phone.size, 3), np.float32)
    seen[..., 0] = TABLE
    shape = np.array(levels[0].shape[1::-1])
    (left, top), (right, bottom) = window_of(low + LATTICE * shape * step, phone, frame)
    there = cv2.perspectiveTransform(
        phone.fine[3 * top : 3 * bottom, 3 * left : 3 * right], on_texture
    )
    part = cv2.remap(
        levels[level], there, None, cv2.INTER_LINEAR,
        borderMode=cv2.BORDER_CONSTANT, borderValue=(TABLE, 0, 0),
    )  # fmt: skip
    window = right - left, bottom - top
    seen[top:bottom, left:right] = cv2.resize(part, window, interpolation=cv2.INTER_AREA)
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
    add_lamp(linear, scene, phone, frame.rotation @ lamp + frame.shift_m)
    return linear


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


def radiance(scene: Scene, phone: Phone, frame: Frame, *, step_px: float = 1.25) -> Array:
    """`[H, W, 3]` float32 linear radiance at the sensor, blurred by lens and motion (the mean of
    poses not more than `step_px` apart over the exposure), with vignetting, without noise."""
    extent = blur_extent_px(scene, phone, frame)
    count = 1 if extent < 0.6 else int(np.ceil(extent / step_px))
    linear = np.zeros((*phone.size, 3), np.float32)
    for part in (np.arange(count) + 0.5) / count - 0.5:
        linear += at_rest(scene, phone, frame.at(part))
    linear *= np.array(scene.tint, np.float32) / np.float32(count)
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
    """A film of all frames, by the path's ending: .mp4 (MPEG-4), .avi (Motion JPEG) or .mkv (FFV1,
    lossless). OpenCV 5.0's .mp4 reads back darker, by 1 code of 255 in green and 3 to 4 in red and
    blue; the others do not. Sizes are even: MPEG-4 would lose a row."""
    if any(side % 2 for side in phone.size):
        raise ValueError(f"size: expected even height and width for a film, got {phone.size}")
    motion_jpeg = path.suffix == ".avi"
    kind = {".mp4": "mp4v", ".avi": "MJPG", ".mkv": "FFV1"}[path.suffix]
    backend = cv2.CAP_OPENCV_MJPEG if motion_jpeg else cv2.CAP_FFMPEG
    # FFmpeg's writer takes no quality
    quality = ([cv2.VIDEOWRITER_PROP_QUALITY, phone.quality],) if motion_jpeg else ()
    code = cv2.VideoWriter_fourcc(*kind)
    writer = cv2.VideoWriter(str(path), backend, code, rate, phone.size[::-1], *quality)
    if not writer.isOpened():
        raise OSError(f"{path}: expected OpenCV to write {kind}, got no writer")
    for picture in pictures(scene, phone, frames, gain, seed):
        writer.write(np.ascontiguousarray(picture))
    writer.release()
    return path
