"""The parts of `raden capture handheld`: footage, blur, card, lamp, tone curve."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from raden_torch.capture.photo.board import Board, find_board
from raden_torch.capture.photo.board_pose import board_pose
from raden_torch.capture.photo.camera import Pose
from raden_torch.capture.photo.handheld.card_checks import bent, heights_m, zoom_of, zoomed
from raden_torch.capture.photo.handheld.choosing import spread_out
from raden_torch.capture.photo.handheld.edge_blur import edge_blur
from raden_torch.capture.photo.handheld.footage import clips_of, pictures
from raden_torch.capture.photo.handheld.judging import judged
from raden_torch.capture.photo.handheld.lamp_fit import LampSetting, find_lamp
from raden_torch.capture.photo.handheld.lamp_sights import (
    ChromeBall,
    FlatMirror,
    Shadow,
    Sights,
    white_squares_m,
)
from raden_torch.capture.photo.handheld.mirror_geometry import mirror_points
from raden_torch.capture.photo.handheld.response_fit import (
    Greys,
    fit_response,
    read_response,
    write_response,
)
from raden_torch.errors import InputError
from tests.capture.photo.handheld.simulated_scene import (
    Phone,
    hand_path,
    inverse_tone_curve,
    project,
    tone_curve,
)

LAMP = np.array([-0.12, -0.05, -0.30])
TABLE = (inverse_tone_curve(np.arange(256) / 255)).astype(np.float32)


def board_picture(blur: float, motion: int = 0) -> tuple[np.ndarray, Board]:
    """A board at a slant, blurred by a Gaussian and along x, drawn at four times its size."""
    board = Board(11, 9, 0.016, 0.012, legacy=False)
    flat = board.opencv().generateImage((1760, 1440))
    place = np.diag([4.0, 4, 1]) @ np.array(
        [[0.45, 0.05, 60], [-0.03, 0.42, 60], [5e-5, 2e-5, 1.0]]
    )
    large = cv2.warpPerspective(flat, place, (3840, 2880), borderValue=40)
    large = cv2.GaussianBlur(large, (0, 0), 4 * blur)
    if motion:
        large = cv2.blur(large, (4 * motion, 1))
    small = cv2.resize(large, (960, 720), interpolation=cv2.INTER_AREA) * 0.7 + 20
    noise = np.random.default_rng(0).normal(size=small.shape)
    return np.clip(small + 2 * noise, 0, 255).astype(np.uint8), board


@pytest.mark.parametrize("blur", [0.5, 1.0, 2.0, 3.0])
def test_blur_is_measured_in_pixels(blur: float) -> None:
    picture, board = board_picture(blur)
    found = edge_blur(picture, find_board(picture, board, "p"))
    assert found is not None
    of_pixels = np.hypot(blur, 0.35)  # their area
    assert found.across_rows == pytest.approx(of_pixels, abs=0.2)
    assert found.across_columns == pytest.approx(of_pixels, abs=0.2)
    assert not found.is_motion


def test_motion_blurs_one_way() -> None:
    picture, board = board_picture(0.5, motion=6)
    found = edge_blur(picture, find_board(picture, board, "p"))
    assert found is not None
    assert found.is_motion
    assert found.worst_px == pytest.approx(np.hypot(6 / np.sqrt(12), 0.6), abs=0.3)


def test_real_photographs_are_judged(shared: Path, tmp_path: Path) -> None:
    """A real photograph of a board is sharp; the same, blurred by 2 pixels, is refused as such."""
    real = shared / "data/charuco/choriginal.jpg"
    pixels = cv2.imread(str(real))
    cv2.imwrite(str(tmp_path / "soft.png"), cv2.GaussianBlur(pixels, (0, 0), 2.0))
    clips = clips_of([real, tmp_path / "soft.png"])
    sharp, soft = judged(clips, Board(5, 7, 0.04, 0.02), most_blur_px=1.5)
    assert sharp.refused == ""
    assert sharp.blur is not None
    assert sharp.blur.worst_px < 1.3
    assert soft.refused.startswith(("out of focus", "no board found"))


def test_what_is_no_footage(tmp_path: Path) -> None:
    (tmp_path / "empty").mkdir()
    (tmp_path / "text.mp4").write_text("no video")
    (tmp_path / "a").mkdir()
    for folder in (tmp_path, tmp_path / "a"):
        cv2.imwrite(str(folder / "one.png"), np.zeros((40, 40, 3), np.uint8))
    for paths, said in (
        ([tmp_path / "none.mp4"], "got no such file"),
        ([tmp_path / "empty"], "expected a folder of photographs, got none"),
        ([tmp_path / "one.png", tmp_path / "a"], "one.png: expected photographs of different"),
    ):
        with pytest.raises(InputError, match=said):
            clips_of(paths)
    (clip,) = clips_of([tmp_path / "text.mp4"])
    with pytest.raises(InputError, match="expected a video that OpenCV's decoders read"):
        next(pictures(clip, 0))


def test_a_video_gives_the_frames_that_are_wanted(tmp_path: Path) -> None:
    path = tmp_path / "film.avi"
    film = cv2.VideoWriter(str(path), cv2.VideoWriter_fourcc(*"MJPG"), 30, (64, 48))
    for k in range(9):
        film.write(np.full((48, 64, 3), 20 * k, np.uint8))
    film.release()
    (clip,) = clips_of([path])
    found = list(pictures(clip, 3, {2, 7}))
    assert [(p.name, p.clip, p.number) for p in found] == [
        ("film_000002.png", 3, 2),
        ("film_000007.png", 3, 7),
    ]
    for picture, level in zip(found, (40, 140), strict=True):
        assert abs(picture.pixels.astype(int) - level).max() <= 4
    path.write_bytes(path.read_bytes()[:2000])  # cut off: what is there is read, or it is said
    (cut,) = clips_of([path])
    with pytest.raises(InputError, match=r"film\.avi"):
        list(pictures(cut, 0))


def test_a_bent_card_is_told(views: Callable) -> None:
    flat = views()
    assert bent(heights_m(*flat), 0.016) is None
    curved = views(heights=lambda p: -0.004 * (1 - ((p[:, 0] - 0.088) / 0.08) ** 2))
    found = heights_m(*curved)
    points = curved[0][0].board.corners_m
    bow = -0.004 * (1 - ((points[:, 0] - 0.088) / 0.08) ** 2)
    plane = np.c_[points[:, :2], np.ones(len(points))]
    bow -= plane @ np.linalg.lstsq(plane, bow, rcond=None)[0]
    assert np.corrcoef(found, bow)[0, 1] > 0.95
    said = bent(found, 0.016)
    assert said is not None
    assert "not flat" in said


def test_a_changed_zoom_is_told(views: Callable) -> None:
    seen, camera, _ = views(zoom=1.05)
    told = [zoomed(*zoom_of(view, camera, board_pose(view, camera))) for view in seen]
    assert told[:-1] == [None] * (len(seen) - 1)
    assert told[-1] is not None
    assert "+5." in told[-1] or "+4." in told[-1]


@given(
    st.tuples(*[st.floats(-0.3, 0.3)] * 4), st.floats(0.1, 1.0), st.floats(0.1, 1.0),
    st.floats(0.002, 0.02),
)  # fmt: skip
def test_a_ball_mirrors_at_equal_angles(
    places: tuple[float, ...], eye_z: float, lamp_z: float, radius: float
) -> None:
    centre = np.array([0.0, 0.0, -radius])
    eye, lamp = (np.array([[*places[i : i + 2], -z]]) for i, z in ((0, eye_z), (2, lamp_z)))
    point = mirror_points(centre, radius, eye, lamp)
    normal = (point - centre) / radius
    ways = [(v - point) / np.linalg.norm(v - point) for v in (eye, lamp)]
    assert np.linalg.norm(normal) == pytest.approx(1, abs=1e-12)
    mirrored = 2 * (normal * ways[0]).sum() * normal - ways[0]
    np.testing.assert_allclose(mirrored, ways[1], atol=1e-7)


def sights_of(
    lamp: np.ndarray, phone: Phone, ball: ChromeBall | None, mirror: FlatMirror | None, **more: int
) -> tuple[list[Pose], list[Sights]]:
    """What pictures would show, by geometry alone, with 0.2 px of noise."""
    random = np.random.default_rng(0)
    squares = white_squares_m(Board(11, 9, 0.016, 0.012)).mean(axis=1)
    points = np.c_[squares, np.zeros(len(squares))]
    to = lamp - points
    light = -to[:, 2] / np.linalg.norm(to, axis=1) ** 3
    stored = 255 * tone_curve(0.6 * light / light.max())
    poses, seen = [], []
    for frame in hand_path(**{"count": 20, "seed": 3} | more):
        poses.append(Pose(frame.rotation, frame.shift_m, 0.1, 80))
        balls, mirrors = np.zeros((0, 2)), np.zeros((0, 2))
        if ball is not None:
            at = mirror_points(ball.centre_m, ball.radius_m, frame.place_m[None], lamp[None])
            balls = project(at, phone, frame) + 0.2 * random.normal(size=(1, 2))
        if mirror is not None:
            behind = lamp * [1, 1, -1] - [0, 0, 2 * mirror.height_m]
            mirrors = project(behind[None], phone, frame) + 0.2 * random.normal(size=(1, 2))
        seen.append(Sights(balls, mirrors, stored))
    return poses, seen


def setting(views: Callable, **more: object) -> LampSetting:
    camera = views()[1]
    board = Board(11, 9, 0.016, 0.012)
    middle = np.array([0.08, 0.07, 0.0])
    return replace(LampSetting(camera, board, (), (), (), False, middle), **more)


def off_deg(found: np.ndarray, lamp: np.ndarray = LAMP) -> float:
    a, b = (v - np.array([0.08, 0.07, 0.0]) for v in (found, lamp))
    return float(np.degrees(np.arctan2(np.linalg.norm(np.cross(a, b)), a @ b)))


def test_a_lamp_by_a_ball(views: Callable, phone: Phone) -> None:
    ball = ChromeBall(0.155, 0.03, 0.015)
    poses, seen = sights_of(LAMP, phone, ball, None)
    said = ChromeBall(0.157, 0.028, 0.015)
    found = find_lamp(setting(views, balls=(said,)), poses, seen, TABLE, "clip")
    assert off_deg(found.at_m) < max(0.5, 2 * found.std_deg)
    np.testing.assert_allclose(found.balls_m[0], [0.155, 0.03], atol=3e-4)
    assert np.linalg.norm(found.at_m) == pytest.approx(np.linalg.norm(LAMP), rel=0.03)


def test_a_lamp_by_a_mirror(views: Callable, phone: Phone) -> None:
    mirror = FlatMirror(np.array([[0.0, 0], [0.1, 0], [0.1, 0.1]]), 0.003)
    poses, seen = sights_of(LAMP, phone, None, mirror, count=8)
    found = find_lamp(setting(views, mirrors=(mirror,)), poses, seen, TABLE, "clip")
    assert off_deg(found.at_m) < 0.2


def test_a_lamp_by_shadows(views: Callable, phone: Phone) -> None:
    pins = []
    for x, y in ((0.02, 0.02), (0.16, 0.13)):
        height = 0.04
        tip = np.array([x, y]) + (np.array([x, y]) - LAMP[:2]) * height / (-LAMP[2] - height)
        pins.append(Shadow(x, y, height, *tip))
    poses, seen = sights_of(LAMP, phone, None, None)
    found = find_lamp(setting(views, shadows=tuple(pins)), poses, seen, TABLE, "clip")
    assert off_deg(found.at_m) < 0.5


def test_images_that_fit_no_lamp_are_left_out(views: Callable, phone: Phone) -> None:
    ball = ChromeBall(0.155, 0.03, 0.015)
    poses, seen = sights_of(LAMP, phone, ball, None)
    for k in (2, 9, 15):
        seen[k] = replace(seen[k], balls=seen[k].balls + np.array([7.0, -4.0]))
    found = find_lamp(setting(views, balls=(ball,)), poses, seen, TABLE, "clip")
    assert found.left_out == 3
    assert off_deg(found.at_m) < max(0.5, 2 * found.std_deg)
    random = np.random.default_rng(0)
    nowhere = [replace(s, balls=s.balls + 8 * random.normal(size=(1, 2))) for s in seen]
    with pytest.raises(InputError, match="clip: of 20 images of the lamp"):
        find_lamp(setting(views, balls=(ball,)), poses, nowhere, TABLE, "clip")
    unseen = [replace(s, balls=np.full((1, 2), np.nan)) for s in seen]
    with pytest.raises(InputError, match="the lamp's image was found in no ball or mirror"):
        find_lamp(setting(views, balls=(ball,)), poses, unseen, TABLE, "clip")


def grey_pictures(
    reflectances: tuple[float, ...], exposures: np.ndarray, noise: float = 0.5
) -> list[Greys]:
    random = np.random.default_rng(1)
    light = np.array(reflectances)
    balance = np.array([1.2, 1.0, 0.8])
    return [
        Greys(
            255 * tone_curve(np.outer(light, e * balance)) + noise * random.normal(size=(6, 3)),
            np.log(light) + 0.3,
        )
        for e in exposures
    ]


GREYS = (0.9, 0.59, 0.36, 0.2, 0.09, 0.03)


def test_a_tone_curve_by_greys(tmp_path: Path) -> None:
    found = fit_response(grey_pictures(GREYS, np.linspace(0.4, 0.9, 10)))
    z = np.arange(20, 240)
    ratio = found.table[z] / TABLE[z]
    np.testing.assert_allclose(ratio / ratio[100], 1, atol=0.03)
    assert found.rms < 0.03
    write_response(found, tmp_path / "response.json", made_from=())
    np.testing.assert_allclose(read_response(tmp_path / "response.json"), found.table, atol=1e-6)


def test_greys_that_tell_no_curve() -> None:
    with pytest.raises(InputError, match="expected greys whose light differs by 4 times"):
        fit_response(grey_pictures((0.5, 0.48, 0.46, 0.44, 0.42, 0.4), np.full(6, 0.6)))
    wrong = [Greys(g.stored, g.log_light[::-1]) for g in grey_pictures(GREYS, np.full(6, 0.6))]
    with pytest.raises(InputError, match="no rising curve fits the greys"):
        fit_response(wrong)
    with pytest.raises(InputError, match="twelve values"):
        fit_response(grey_pictures(GREYS, np.full(4, 40.0)))


@given(st.lists(st.tuples(st.floats(-60, 60), st.floats(-60, 60)), min_size=1, max_size=25),
       st.integers(1, 12))  # fmt: skip
def test_chosen_pictures(ways: list[tuple[float, float]], most: int) -> None:
    poses = []
    for x, y in ways:
        turn = cv2.Rodrigues(np.radians([x, y, 0]))[0]
        poses.append(Pose(turn, np.array([0, 0, 0.4]), 0.1, 80))
    clips = [k % 3 for k in range(len(poses))]
    chosen = spread_out(poses, np.zeros(3), clips, most)
    assert chosen == sorted(set(chosen))
    assert len(chosen) <= most
    assert len(chosen) == min(most, len(poses)) or len(poses) > len(chosen) >= most - 2


def test_raw_and_deep_stills_are_refused(tmp_path: Path) -> None:
    cv2.imwrite(str(tmp_path / "deep.png"), np.full((40, 40, 3), 30_001, np.uint16))
    (clip,) = clips_of([tmp_path / "deep.png"])
    with pytest.raises(InputError, match=r"deep\.png: expected stills of 8 bits"):
        next(pictures(clip, 0))


def test_rays_into_the_board_and_a_single_pin(views: Callable, phone: Phone) -> None:
    """No lamp is there, in a line; of one pin the distance is not known, and that is said."""
    below = LAMP * [1, 1, -0.3]
    mirror = FlatMirror(np.array([[0.0, 0], [0.1, 0], [0.1, 0.1]]))
    poses, seen = sights_of(LAMP, phone, None, mirror, count=6)
    shown = [project((below * [1, 1, -1])[None], phone, f) for f in hand_path(6, seed=3)]
    wrong = [replace(s, mirrors=at) for s, at in zip(seen, shown, strict=True)]
    with pytest.raises(InputError, match="clip: "):
        find_lamp(setting(views, mirrors=(mirror,)), poses, wrong, TABLE, "clip")
    foot = np.array([0.02, 0.02])
    tip = foot + (foot - LAMP[:2]) * 0.04 / (-LAMP[2] - 0.04)
    pin = Shadow(*foot, 0.04, *tip)
    dark = [
        replace(s, mirrors=np.zeros((0, 2)), squares=np.full_like(s.squares, np.nan)) for s in seen
    ]
    found = find_lamp(setting(views, shadows=(pin,)), poses, dark, TABLE, "clip")
    assert found.std_deg > 3


def test_stills_of_other_primaries_are_known(tmp_path: Path) -> None:
    """As a phone's: Display P3, here by a PNG's cICP chunk."""
    coded = cv2.imencode(".png", np.full((40, 40, 3), 100, np.uint8))[1].tobytes()
    body = b"cICP" + bytes([12, 13, 0, 1])
    chunk = struct.pack(">I", 4) + body + struct.pack(">I", zlib.crc32(body))
    (tmp_path / "srgb.png").write_bytes(coded)
    (tmp_path / "p3.png").write_bytes(coded[:33] + chunk + coded[33:])
    (clip,) = clips_of([tmp_path / "srgb.png", tmp_path / "p3.png"])
    assert [(p.is_srgb, p.pixels[0, 0, 0]) for p in pictures(clip, 0)] == [
        (True, 100),
        (False, 100),
    ]
