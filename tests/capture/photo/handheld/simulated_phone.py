"""The simulated phone: lens, tone curve, noise and white balance; and the path of the hand.
Board frame: x along the rows, y down the columns, z into the board, metres, origin at the pattern's
upper left corner. Camera frame: x right, y down, z forward. No code of the package is used."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property

import cv2
import numpy as np

Array = np.ndarray
CONTRAST, DARKER = 1.25, 0.85  # of the S-curve: log-odds times CONTRAST, minus log DARKER


def tone_curve(linear: Array) -> Array:
    """0..1 linear → 0..1 coded: sRGB's transfer function, then an S-curve with a shoulder."""
    x = np.clip(linear, 0, 1)
    t = np.where(x <= 0.0031308, 12.92 * x, 1.055 * np.maximum(x, 1e-9) ** (1 / 2.4) - 0.055)
    t = np.clip(t, 0, 1)
    return t**CONTRAST / (t**CONTRAST + DARKER * (1 - t) ** CONTRAST)


def inverse_tone_curve(coded: Array) -> Array:
    """0..1 coded → 0..1 linear."""
    s = np.clip(coded, 0, 1)
    bright, dark = (DARKER * s) ** (1 / CONTRAST), (1 - s) ** (1 / CONTRAST)
    t = bright / (bright + dark)
    return np.where(t <= 0.04045, t / 12.92, ((t + 0.055) / 1.055) ** 2.4)


@dataclass(frozen=True, eq=False)
class Phone:
    """`matrix` `[3, 3]` px and OpenCV's five distortion coefficients; `size` height, width px;
    `curve` and `inverse` of arrays in 0..1; `balance`: gains of a wrong white balance; `electrons`
    of a full pixel, and `read_noise` in electrons (0 electrons: no noise); JPEG `quality` 0..100;
    `vignetting`: 0 none, 1 the cos⁴ law; `blur_px`: the sharp lens's Gaussian sigma."""

    matrix: Array = field(
        default_factory=lambda: np.array([[770.0, 0, 482.3], [0, 771.5, 267.8], [0, 0, 1]])
    )
    distortion: Array = field(
        default_factory=lambda: np.array([0.08, -0.15, 0.0005, -0.0007, 0.02])
    )
    size: tuple[int, int] = (540, 960)
    curve: Callable[[Array], Array] = tone_curve
    inverse: Callable[[Array], Array] = inverse_tone_curve
    balance: tuple[float, float, float] = (1.0, 1.0, 1.0)
    electrons: float = 6000.0
    read_noise: float = 4.0
    quality: int = 95
    vignetting: float = 0.0
    blur_px: float = 0.5

    def scaled(self, by: float) -> Phone:
        """The same lens over a picture of `by` times the pixels a side."""
        matrix = np.diag([by, by, 1]) @ self.matrix
        matrix[:2, 2] += (by - 1) / 2  # a pixel's middle has whole coordinates
        options = {k: v for k, v in vars(self).items() if k in self.__dataclass_fields__}
        size = round(by * self.size[0]), round(by * self.size[1])
        return Phone(**options | {"matrix": matrix, "size": size, "blur_px": by * self.blur_px})

    def along(self, pixels: Array) -> Array:
        """`[P, 2]` x / z and y / z of the rays through `[P, 2]` pixels: OpenCV's lens model,
        inverted by fixed-point steps, which a mild lens shrinks by a factor of 4 or more each."""
        k1, k2, p1, p2, k3 = self.distortion
        bent = (np.asarray(pixels, float) - self.matrix[:2, 2]) / np.diag(self.matrix)[:2]
        x, y = x0, y0 = bent.T
        for _ in range(12):
            r2 = x * x + y * y
            radial = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
            dx = 2 * p1 * x * y + p2 * (r2 + 2 * x * x)
            dy = p1 * (r2 + 2 * y * y) + 2 * p2 * x * y
            x, y = (x0 - dx) / radial, (y0 - dy) / radial
        return np.stack([x, y], 1)

    def grid(self, fine: int) -> Array:
        """`[fine H, fine W, 2]` float32: `along` the middles of the pixels' `fine`² parts."""
        height, width = self.size
        y, x = np.mgrid[-1.0 : height + 1, -1.0 : width + 1]
        coarse = self.along(np.stack([x.ravel(), y.ravel()], 1)).reshape(*x.shape, 2)
        if fine > 1:  # the lens is smooth: between pixels it is linear
            coarse = cv2.resize(coarse, None, fx=fine, fy=fine, interpolation=cv2.INTER_LINEAR)
        return np.ascontiguousarray(coarse[fine:-fine, fine:-fine], np.float32)

    @cached_property
    def coarse(self) -> Array:
        return self.grid(1)

    @cached_property
    def fine(self) -> Array:
        return self.grid(3)

    @cached_property
    def falloff(self) -> Array:
        """`[H, W, 1]`: what the vignetting leaves."""
        cosine4 = 1 / (1 + (self.coarse**2).sum(-1, keepdims=True)) ** 2
        return 1 - self.vignetting * (1 - cosine4)

    @cached_property
    def table(self) -> Array:
        """`[65536]` uint8: the curve."""
        return np.rint(255 * self.curve(np.linspace(0, 1, 65536))).astype(np.uint8)


@dataclass(frozen=True, eq=False)
class Frame:
    """p_camera = `rotation` @ p_board + `shift_m` at the middle of the exposure, during which what
    the camera sees turns by the rotation vector `turn` and moves by `slide_m` (camera frame);
    `defocus_px`: Gaussian sigma."""

    rotation: Array
    shift_m: Array
    turn: Array = field(default_factory=lambda: np.zeros(3))
    slide_m: Array = field(default_factory=lambda: np.zeros(3))
    defocus_px: float = 0.0

    def at(self, part: float) -> Frame:
        """The pose at −0.5..0.5 of the exposure, at rest."""
        step = cv2.Rodrigues(part * self.turn)[0]
        shift = step @ self.shift_m + part * self.slide_m
        return Frame(step @ self.rotation, shift, defocus_px=self.defocus_px)

    @property
    def place_m(self) -> Array:
        """`[3]` the camera's place in the board frame."""
        return -self.rotation.T @ self.shift_m


def project(points_m: Array, phone: Phone, frame: Frame) -> Array:
    """`[P, 2]` pixels of `[P, 3]` points of the board frame."""
    pose = cv2.Rodrigues(frame.rotation)[0], frame.shift_m
    points = np.asarray(points_m, np.float64).reshape(-1, 1, 3)
    return cv2.projectPoints(points, *pose, phone.matrix, phone.distortion)[0].reshape(-1, 2)


def wave(random: np.random.Generator, shortest_s: float, longest_s: float) -> Callable:
    """A smooth random function of time within −1..1."""
    rate = 2 * np.pi / random.uniform(shortest_s, longest_s, 3)
    start, weight = random.uniform(0, 2 * np.pi, 3), random.uniform(0.5, 1, 3)
    return lambda t: float((weight * np.sin(rate * t + start)).sum() / weight.sum())


def hand_path(
    count: int,
    *,
    seed: int,
    shaken: Sequence[int] = (),
    defocused: Mapping[int, float] | None = None,
    duration_s: float = 30.0,
    exposure_s: float = 0.004,
    loops: float = 3.0,
    polar_deg: tuple[float, float] = (5.0, 60.0),
    arc_deg: tuple[float, float] = (0.0, 360.0),
    distance_m: tuple[float, float] = (0.25, 0.45),
    target_m: tuple[float, float] = (0.088, 0.072),
    wobble_m: float = 0.012,
    roll_deg: float = 8.0,
    tremor_deg: float = 0.06,
    shake_px: tuple[float, float] = (5.0, 15.0),
    phone: Phone | None = None,
) -> list[Frame]:
    """`count` frames evenly over `duration_s` of a smooth path over the card, aimed near
    `target_m`: the angle off the card's normal grows over the time, the azimuth goes round `loops`
    times, or to and fro where `arc_deg` is no full circle. The hand trembles at 8 to 12 Hz. Frames
    move during `exposure_s` (0: stills at rest); those of `shaken` turn by `shake_px` more."""
    random = np.random.default_rng([seed, 1])
    slow = [wave(random, 3.0, 9.0) for _ in range(6)]
    fast = [wave(random, 1 / 12, 1 / 8) for _ in range(3)]
    turn0 = random.uniform(0, 2 * np.pi)
    width = arc_deg[1] - arc_deg[0]

    def pose(t: float) -> tuple[Array, Array]:
        u = t / duration_s
        # the cosine folds what the hand's wobble takes beyond the ends back inside
        part = 0.5 - 0.5 * np.cos(np.pi * (u + 0.05 * slow[0](t)))
        away = np.radians(polar_deg[0] + (polar_deg[1] - polar_deg[0]) * part)
        if width >= 360:
            round_ = turn0 + 2 * np.pi * loops * u + 0.1 * slow[1](t)
        else:
            round_ = np.radians(
                arc_deg[0] + width * (0.5 + 0.5 * np.sin(turn0 + 2 * np.pi * loops * u))
            )
        reach = np.mean(distance_m) + np.ptp(distance_m) / 2 * slow[2](t)
        direction = [
            np.sin(away) * np.cos(round_), np.sin(away) * np.sin(round_), -np.cos(away),
        ]  # fmt: skip
        middle = np.array([*target_m, 0.0])
        place = middle + reach * np.array(direction)
        forward = middle + wobble_m * np.array([slow[3](t), slow[4](t), 0]) - place
        forward = forward / np.linalg.norm(forward)
        right = np.cross(np.array([0.0, 1.0, 0.02]), forward)
        right = right / np.linalg.norm(right)
        rotation = np.stack([right, np.cross(forward, right), forward])
        roll = np.array([0, 0, np.radians(roll_deg) * slow[5](t)])
        tremor = np.radians(tremor_deg) * np.array([f(t) for f in fast])
        rotation = cv2.Rodrigues(tremor)[0] @ cv2.Rodrigues(roll)[0] @ rotation
        return rotation, -rotation @ place

    focal = (phone or Phone()).matrix[0, 0]
    frames = []
    for k in range(count):
        t = duration_s * (k + 0.5) / count
        (before, from_), (after, to) = (pose(t + s * exposure_s / 2) for s in (-1, 1))
        rotation, shift = pose(t)
        turn = cv2.Rodrigues(after @ before.T)[0].ravel()
        # of what Frame.at turns about the camera, the rest is a move
        half = cv2.Rodrigues(turn / 2)[0]
        slide = to - from_ - (half - half.T) @ shift
        if k in shaken:
            angle = random.uniform(0, 2 * np.pi)
            turn = turn + random.uniform(*shake_px) / focal * np.array(
                [np.cos(angle), np.sin(angle), 0]
            )
        frames.append(Frame(rotation, shift, turn, slide, (defocused or {}).get(k, 0.0)))
    return frames


def developed(linear: Array, phone: Phone, gain: float, rng: np.random.Generator) -> Array:
    """`[H, W, 3]` uint8 RGB of `[H, W, 3]` linear radiance; `gain` × radiance = 1 fills a pixel."""
    signal = np.maximum(gain * linear, 0).astype(np.float32)
    if phone.electrons:
        variance = signal / phone.electrons + (phone.read_noise / phone.electrons) ** 2
        signal += np.sqrt(variance) * rng.standard_normal(signal.shape, np.float32)
    signal *= np.array(phone.balance, np.float32)
    return phone.table[(np.clip(signal, 0, 1) * 65535 + 0.5).astype(np.uint16)]
