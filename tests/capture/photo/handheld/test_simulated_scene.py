"""The simulated photographs by a phone in the hand agree with what they are said to show."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
from scipy.optimize import minimize

from tests.capture.photo.brdf.conftest import shell, unit
from tests.capture.photo.handheld.simulated_scene import (
    Frame,
    Phone,
    Scene,
    auto_gains,
    blur_extent_px,
    developed,
    hand_path,
    inverse_tone_curve,
    lamp_in_camera,
    lamp_on_board,
    project,
    radiance,
    rectangle,
    tone_curve,
    write_clip,
    write_stills,
)

Array = np.ndarray
BALLS = ((0.030, 0.120, 0.008), (0.150, 0.120, 0.006))
LAMP = np.array([0.21, -0.13, -0.34])


def still(seed: int, k: int) -> Frame:
    return hand_path(9, seed=seed, exposure_s=0)[k]


@pytest.fixture(scope="module")
def phone() -> Phone:
    return Phone()


@pytest.fixture(scope="module")
def fixed() -> Scene:
    return Scene(lamp_m=LAMP, balls_m=BALLS)


@pytest.fixture(scope="module")
def flash() -> Scene:
    return Scene(flash_m=np.array([0.014, -0.011, 0.0]), balls_m=BALLS)


def on_plane(xy: Array) -> Array:
    return np.c_[xy, np.zeros(len(xy))]


def sampled(linear: Array, pixels: Array) -> Array:
    """`[P, 3]` between pixels, linearly."""
    at = np.floor(pixels).astype(int)
    u, v = (pixels - at).T[..., None]
    x, y = at.T
    upper = (1 - u) * linear[y, x] + u * linear[y, x + 1]
    lower = (1 - u) * linear[y + 1, x] + u * linear[y + 1, x + 1]
    return (1 - v) * upper + v * lower


def lit(scene: Scene, frame: Frame, points: Array) -> tuple[Array, Array, Array]:
    """Irradiance `[P, 1]`, directions to the lamp and to the camera of the plane's points."""
    to = lamp_on_board(scene, frame) - points
    distance = np.linalg.norm(to, axis=1, keepdims=True)
    return -to[:, 2:] / distance**3, to / distance, unit(frame.place_m - points)


@pytest.mark.parametrize("k", [1, 4])
def test_the_detected_corners_lie_at_their_projection(fixed: Scene, phone: Phone, k: int) -> None:
    frame = still(1, k)
    linear = radiance(fixed, phone, frame)
    picture = developed(
        linear, phone, auto_gains(fixed, phone, [frame])[0], np.random.default_rng(0)
    )
    board = fixed.card.board()
    corners, ids, _, _ = cv2.aruco.CharucoDetector(board).detectBoard(
        cv2.cvtColor(picture, cv2.COLOR_RGB2GRAY)
    )
    points = np.array(board.getChessboardCorners())[ids.ravel()]
    hidden = [
        ((points[:, :2] > c.min(0) - 0.004) & (points[:, :2] < c.max(0) + 0.004)).all(1)
        for c in (fixed.piece_m, fixed.white_m)
    ]
    # a ball, its shadow and its height hide more of the card than its foot
    hidden += [np.hypot(*(points[:, :2] - b[:2]).T) < 5 * b[2] for b in BALLS]
    clear = ~np.any(hidden, 0)
    off = np.linalg.norm(corners.reshape(-1, 2) - project(points, phone, frame), axis=1)[clear]
    print(f"{clear.sum()} corners: median {np.median(off):.3f} px, max {off.max():.3f} px")
    assert clear.sum() > 30
    assert np.median(off) < 0.1
    assert off.max() < 0.3


def mirror_place(camera: Array, lamp: Array, ball: tuple[float, float, float]) -> Array:
    """`[3]` of the ball's surface where the normal halves the angle between lamp and camera."""
    centre = np.array([ball[0], ball[1], -ball[2]])
    first = unit(unit(camera - centre) + unit(lamp - centre))
    across = unit(np.cross(first, [0.3, 1.0, 0.2]))
    other = np.cross(first, across)

    def surface(p: Array) -> tuple[Array, Array]:
        normal = unit(first + p[0] * across + p[1] * other)
        return normal, centre + ball[2] * normal

    def miss(p: Array) -> float:
        normal, place = surface(p)
        to, view = unit(lamp - place), unit(camera - place)
        return 1e6 * float(((2 * (to @ normal) * normal - to - view) ** 2).sum())

    return surface(minimize(miss, np.zeros(2), method="Nelder-Mead", tol=1e-10).x)[1]


def bright_middle(linear: Array, near: Array) -> Array:
    """`[2]` the centroid of what is bright within 4 pixels of the place."""
    x, y = np.round(near).astype(int)
    window = linear[y - 4 : y + 5, x - 4 : x + 5, 1]
    weight = np.where(window > 0.1 * window.max(), window, 0)
    v, u = np.mgrid[y - 4 : y + 5, x - 4 : x + 5]
    return np.array([(weight * u).sum(), (weight * v).sum()]) / weight.sum()


@pytest.mark.parametrize("kind", ["fixed", "flash"])
def test_the_highlight_lies_where_the_angles_are_equal(
    request: pytest.FixtureRequest, phone: Phone, kind: str
) -> None:
    scene, frame = request.getfixturevalue(kind), still(2, 5)
    linear = radiance(scene, phone, frame)
    for ball in BALLS:
        place = mirror_place(frame.place_m, lamp_on_board(scene, frame), ball)
        (expected,) = project(place[None], phone, frame)
        x, y = np.round(expected).astype(int)
        assert linear[y - 4 : y + 5, x - 4 : x + 5].max() > 10  # the white has about 2
        off = np.linalg.norm(bright_middle(linear, expected) - expected)
        print(f"highlight: {off:.3f} px")
        assert off < 0.25


def test_black_glass_shows_the_lamp_below_the_card(phone: Phone) -> None:
    frame = still(3, 1)
    place = frame.place_m
    # the lamp stands so that its mirror image lies at the glass's middle
    middle = np.array([0.08, 0.112, 0.0])
    lamp = middle + 1.2 * (middle - place) * [1, 1, -1]
    scene = Scene(lamp_m=lamp, mirror_m=rectangle(0.054, 0.1, 0.11, 0.125))
    (expected,) = project(middle[None], phone, frame)
    linear = radiance(scene, phone, frame)
    assert np.linalg.norm(bright_middle(linear, expected) - expected) < 0.5


@pytest.mark.parametrize("kind", ["fixed", "flash"])
def test_white_and_piece_have_their_radiance(
    request: pytest.FixtureRequest, phone: Phone, kind: str
) -> None:
    scene, frame = request.getfixturevalue(kind), still(4, 2)
    linear = radiance(scene, phone, frame)
    u, v = np.meshgrid(np.linspace(0.12, 0.88, 9), np.linspace(0.12, 0.88, 7))
    inner = np.stack([u.ravel(), v.ravel()], 1)
    for corners, brdf in ((scene.white_m, None), (scene.piece_m, shell)):
        points = on_plane(corners[0] + inner * (corners[2] - corners[0]))
        light, to, view = lit(scene, frame, points)
        normal = np.broadcast_to([0.0, 0, -1], points.shape)
        truth = 0.9 / np.pi if brdf is None else brdf(normal, to, view)
        ratio = sampled(linear, project(points, phone, frame)) / light / truth
        print(f"{kind}: {ratio.min():.4f} to {ratio.max():.4f} of the truth")
        np.testing.assert_allclose(ratio, 1, atol=0.01)


def test_a_flash_stays_where_it_is_in_the_camera(flash: Scene, fixed: Scene) -> None:
    for frame in hand_path(5, seed=1):
        np.testing.assert_allclose(lamp_in_camera(flash, frame), flash.flash_m, atol=1e-12)
        np.testing.assert_allclose(lamp_on_board(fixed, frame), LAMP, atol=1e-12)


def test_the_lens_is_inverted(phone: Phone) -> None:
    pixels = np.stack(np.meshgrid(np.linspace(0, 959, 13), np.linspace(0, 539, 9)), -1)
    rays = np.c_[phone.along(pixels.reshape(-1, 2)), np.ones(13 * 9)]
    frame = Frame(np.eye(3), np.zeros(3))
    np.testing.assert_allclose(project(rays, phone, frame), pixels.reshape(-1, 2), atol=1e-3)


def test_curve_and_inverse_invert(phone: Phone) -> None:
    x = np.linspace(0, 1, 1001)
    np.testing.assert_allclose(inverse_tone_curve(tone_curve(x)), x, atol=1e-9)
    np.testing.assert_allclose(tone_curve(inverse_tone_curve(x)), x, atol=1e-9)
    assert (np.diff(phone.table.astype(int)) >= 0).all()
    assert phone.table[0] == 0
    assert phone.table[-1] == 255


def test_the_path_keeps_its_bounds_and_only_shaken_frames_blur(fixed: Scene, phone: Phone) -> None:
    shaken = (3, 11, 30)
    frames = hand_path(60, seed=5, shaken=shaken, defocused={4: 2.5})
    away = [np.degrees(np.arccos(-unit(f.place_m - [0.088, 0.072, 0])[2])) for f in frames]
    distance = [np.linalg.norm(f.place_m - [0.088, 0.072, 0]) for f in frames]
    assert min(away) >= 4.9
    assert max(away) <= 60.1
    assert max(away) - min(away) > 45
    assert min(distance) >= 0.25
    assert max(distance) <= 0.45
    blur = np.array([blur_extent_px(fixed, phone, f) for f in frames])
    assert (blur[list(shaken)] > 4).all()
    assert (blur[list(shaken)] < 18).all()
    assert np.delete(blur, shaken).max() < 2
    assert frames[4].defocus_px == 2.5
    rest = hand_path(60, seed=5, exposure_s=0)
    assert all(np.array_equal(a.rotation, b.rotation) for a, b in zip(frames, rest, strict=True))
    assert max(np.abs(f.turn).max() + np.abs(f.slide_m).max() for f in rest) == 0


def test_a_shaken_frame_is_wide_along_its_motion(phone: Phone) -> None:
    scene, rest = Scene(lamp_m=LAMP), still(1, 3)
    small = phone.scaled(0.5)
    shaken = Frame(rest.rotation, rest.shift_m, turn=np.array([0, 12 / phone.matrix[0, 0], 0]))
    there, moved = (radiance(scene, small, f)[..., 1] for f in (rest, shaken))
    # six pixels of the half picture along x: the same as a mean over them
    expected = (
        cv2.blur(there, (6, 1), anchor=(3, 0)) / 2 + cv2.blur(there, (6, 1), anchor=(2, 0)) / 2
    )
    change = np.abs(moved - expected)[20:-20, 20:-20].mean() / np.abs(moved - there).mean()
    print(f"left of the motion blur: {change:.3f}")
    assert change < 0.25


@pytest.mark.parametrize(("ending", "codes"), [("mp4", 5), ("avi", 3), ("mkv", 0)])
def test_a_clip_reads_back(
    tmp_path: Path, fixed: Scene, phone: Phone, ending: str, codes: float
) -> None:
    small, frames = phone.scaled(1 / 3), hand_path(5, seed=2)
    gain = auto_gains(fixed, phone, frames[:1])[0]
    path = write_clip(tmp_path / f"clip.{ending}", fixed, small, frames, gain=gain, seed=3)
    video = cv2.VideoCapture(str(path))
    read = []
    while (answer := video.read())[0]:
        read.append(answer[1][..., ::-1])
    assert len(read) == len(frames)
    for k in (0, 4):
        random = np.random.default_rng([3, k])
        sent = developed(radiance(fixed, small, frames[k]), small, gain, random)
        off = np.abs(sent.astype(float) - read[k]).mean()
        print(f"{ending}: mean difference {off:.2f} of 255")
        assert off <= codes


def test_stills_read_back_and_the_exposure_is_as_said(tmp_path: Path, fixed: Scene) -> None:
    small = Phone(electrons=0, quality=98, balance=(1.2, 1.0, 0.8)).scaled(0.5)
    frames = hand_path(3, seed=2, exposure_s=0)
    gains = auto_gains(fixed, small, frames, drift=0.05, seed=1)
    paths = write_stills(tmp_path, fixed, small, frames, gain=gains, seed=0)
    assert [p.name for p in paths] == ["still000.jpg", "still001.jpg", "still002.jpg"]
    picture = cv2.imread(str(paths[1]))[..., ::-1] / 255
    points = on_plane(fixed.white_m.mean(0)[None])
    light, _, _ = lit(fixed, frames[1], points)
    (at,) = np.round(project(points, small, frames[1])).astype(int)
    signal = inverse_tone_curve(picture[at[1] - 1 : at[1] + 2, at[0] - 1 : at[0] + 2].mean((0, 1)))
    truth = gains[1] * 0.9 / np.pi * light[0, 0] * np.array(small.balance)
    np.testing.assert_allclose(signal, np.minimum(truth, 1), rtol=0.03)
    locked = auto_gains(fixed, small, frames, level=0.6)
    middle = radiance(fixed, small, frames[0])[67:-67, 120:-120]
    assert abs(locked[0] * np.quantile(middle, 0.99) - 0.6) < 0.05  # by a smaller picture


def test_one_lamp_is_wanted() -> None:
    with pytest.raises(ValueError, match="expected one of lamp_m and flash_m"):
        Scene()
