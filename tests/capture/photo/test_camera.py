"""Boards of known place before a known camera, and the real photograph of one."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from raden_torch.capture.photo.board import Board, BoardView, draw_board, find_board
from raden_torch.capture.photo.board_pose import board_pose, reprojected
from raden_torch.capture.photo.calibration import calibrate
from raden_torch.capture.photo.camera import Camera, read_camera, read_poses, write_camera
from raden_torch.capture.photo.handheld.footage import clips_of
from raden_torch.capture.photo.handheld.judging import judged
from raden_torch.capture.photo.photograph import read_stored
from raden_torch.errors import InputError

BOARD = Board(5, 7, 0.04, 0.02)
EVEN = Board(6, 8, 0.03, 0.02)
MATRIX = np.array([[620.0, 0, 318], [0, 622, 243], [0, 0, 1]])
CAMERA = Camera(MATRIX, np.zeros(5), (480, 640))
PLACES = [
    ((0.0, 0.0, 0.0), (-0.1, -0.14, 0.5)),
    ((0.5, 0.1, 0.1), (-0.12, -0.1, 0.5)),
    ((-0.5, 0.2, -0.2), (-0.08, -0.16, 0.5)),
    ((0.1, 0.55, 0.4), (0.0, -0.15, 0.45)),
    ((0.1, -0.6, 1.5), (0.16, -0.1, 0.5)),
    ((0.4, 0.4, 3.0), (0.1, 0.12, 0.5)),
]


def turn_deg(a: np.ndarray, b: np.ndarray) -> float:
    return float(np.rad2deg(np.linalg.norm(cv2.Rodrigues(a @ b.T)[0])))


def test_calibration_and_poses(board_scene: Callable, tmp_path: Path) -> None:
    """Rationale: a pinhole is known exactly. Expected: focal lengths and poses to 1 %."""
    views = [
        find_board(board_scene(BOARD, *place, seed=i), BOARD, f"{i}.png")
        for i, place in enumerate(PLACES)
    ]
    assert min(len(view.ids) for view in views) >= 20
    found = calibrate(views)
    assert found.rms_px < 0.3
    np.testing.assert_allclose(np.diag(found.camera.matrix)[:2], [620, 622], rtol=0.01)
    np.testing.assert_allclose(found.camera.matrix[:2, 2], [318, 243], atol=6)
    assert (found.focal_std_px < 0.02 * 620).all()
    for view, pose, (turn, shift) in zip(views, found.poses, PLACES, strict=True):
        wanted, _ = cv2.Rodrigues(np.array(turn))
        assert turn_deg(pose.rotation, wanted) < 1
        given = board_pose(view, CAMERA)
        assert turn_deg(given.rotation, wanted) < 0.5
        np.testing.assert_allclose(given.translation_m, shift, atol=0.005)
        camera_m = -given.rotation.T @ given.translation_m  # its centre in the board's frame
        np.testing.assert_allclose(camera_m, -wanted.T @ shift, atol=0.006)
        assert camera_m[2] < 0
    path = tmp_path / "camera.json"
    write_camera(path, found.camera, views, found.poses, calibration=found, made_from=["0.png"])
    back = read_camera(path)
    np.testing.assert_array_equal(back.matrix, found.camera.matrix)
    assert back.size == (480, 640)
    board, poses = read_poses(path)
    assert board == views[0].board
    np.testing.assert_array_equal(poses["3.png"].rotation, found.poses[3].rotation)
    assert found.poses[3].covariance is not None
    np.testing.assert_array_equal(poses["3.png"].covariance, found.poses[3].covariance)


def test_a_pose_s_covariance_is_how_it_scatters() -> None:
    """Corners 0.3 px off at random, 200 times: the errors of turn and place over their covariance
    have six squares of 1 in the mean, or a little more, since the deviation is estimated, too; the
    six errors of a pose are as many parts of it."""
    turn, shift = (np.array(part) for part in PLACES[1])
    rotation, ids = cv2.Rodrigues(turn)[0], np.arange(24, dtype=np.int32)
    exact = cv2.projectPoints(BOARD.corners_m, turn, shift, CAMERA.matrix, CAMERA.distortion)[0]
    random = np.random.default_rng(0)
    squares = []
    for _ in range(200):
        off = 0.3 * random.normal(size=(24, 2))
        pose = board_pose(
            BoardView("a", CAMERA.size, BOARD, ids, exact.reshape(-1, 2) + off), CAMERA
        )
        wrong = cv2.Rodrigues(rotation @ pose.rotation.T)[0].ravel()
        wrong = np.r_[wrong, shift - pose.translation_m]
        assert pose.covariance is not None
        squares.append(wrong @ np.linalg.solve(pose.covariance, wrong))
        parts = np.array(pose.errors())
        np.testing.assert_allclose(parts.T @ parts, pose.covariance, rtol=1e-6, atol=1e-15)
    assert np.mean(squares) == pytest.approx(6 * 42 / 40, rel=0.12)
    np.testing.assert_allclose(pose.moved(wrong).translation_m, shift, atol=1e-9)
    assert turn_deg(pose.moved(wrong).rotation, rotation) < 1e-4


def test_reprojection_is_one_to_one(board_scene: Callable) -> None:
    """OpenCV 5 gives [n, 1, 2] and [n, 2]: their difference is [n, n, 2] and means nothing."""
    view = find_board(board_scene(BOARD, *PLACES[1]), BOARD, "a.png")
    pose = board_pose(view, CAMERA)
    off = reprojected(view, CAMERA, pose) - view.pixels
    assert off.shape == (24, 2)
    assert pose.rms_px == pytest.approx(np.sqrt((off**2).sum(axis=1).mean()))


def test_legacy_pattern_is_found(board_scene: Callable) -> None:
    """On 6 x 8 squares the wrong setting finds nothing; on 5 x 7 the two are one pattern."""
    for legacy in (False, True):
        printed = replace(EVEN, legacy=legacy)
        picture = board_scene(printed, (0.2, 0.1, 0.1), (-0.08, -0.12, 0.4))
        view = find_board(picture, EVEN, "a.png")
        assert view.board.legacy is legacy
        assert len(view.ids) == 35
        with pytest.raises(
            InputError, match=r"expected a 6 x 8 board .*, got 24 markers that do not form one"
        ):
            find_board(picture, replace(EVEN, legacy=not legacy), "a.png")


def test_slanted_boards(board_scene: Callable) -> None:
    """OpenCV's own check of the corners rejects such views (opencv issue 25850)."""
    picture = board_scene(BOARD, (1.05, 0.0, 0.0), (-0.1, -0.05, 0.33), size=(480, 640))
    view = find_board(picture, BOARD, "a.png")
    wanted, _ = cv2.Rodrigues(np.array([1.05, 0, 0]))
    assert turn_deg(board_pose(view, CAMERA).rotation, wanted) < 1


def test_what_is_wrong_with_a_picture(board_scene: Callable) -> None:
    picture = board_scene(BOARD, *PLACES[1])
    for bad, message in (
        (cv2.GaussianBlur(picture, (0, 0), 4), r"a\.png: .*blurred"),
        (picture[:9], r"a\.png: expected a photograph of a board, got 640 x 9 pixels"),
        (np.full_like(picture, 255), "over-exposed nearly everywhere"),
        (np.full_like(picture, 90), "expected a 5 x 7 board of DICT_6X6_250, .*, got no board"),
        (np.concatenate([picture, picture], 1), "there twice: two boards in one photograph"),
    ):
        with pytest.raises(InputError, match=message):
            find_board(bad, BOARD, "a.png")
    for other in (Board(7, 5, 0.04, 0.02), Board(6, 7, 0.04, 0.02)):
        with pytest.raises(InputError, match="markers that do not form one"):
            find_board(picture, other, "a.png")


def test_what_is_wrong_with_views(board_scene: Callable) -> None:
    view = find_board(board_scene(BOARD, *PLACES[0]), BOARD, "a.png")
    with pytest.raises(InputError, match=r"expected at least 3 photographs with a board .*, got 2"):
        calibrate([view, view])
    big = BoardView("b.png", (960, 1280), BOARD, view.ids, view.pixels * 2)
    with pytest.raises(
        InputError,
        match=r"b\.png: .* one size .*, got 1280 x 960 pixels, but a\.png has 640 x 480",
    ):
        calibrate([view, view, big])
    with pytest.raises(InputError, match=r"b\.png: expected 640 x 480 pixels, .*, got 1280 x 960"):
        board_pose(big, CAMERA)


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ((1, 7, 0.04, 0.02), "2…100"),
        ((5, 7, 0.02, 0.04), "0 < marker < square"),
        ((5, 7, 0.04, 0.02, "DICT_9X9"), "DICT_6X6_250"),
        ((30, 30, 0.04, 0.02), "expected .* at least 450 markers, got DICT_6X6_250 with 250"),
    ],
)
def test_boards_that_cannot_be(values: tuple, message: str) -> None:
    with pytest.raises(InputError, match=message):
        Board(*values)


def test_camera_files_that_are_none(tmp_path: Path) -> None:
    for name, content, message in (
        ("a.json", "{}", "expected a camera file of `raden capture`, got another file"),
        ("b.yml", "%YAML:1.0\n---\na: 1\n", "no whole camera_matrix"),
        ("c.yml", "\x00\x01", "expected an OpenCV calibration, got another file"),
    ):
        (tmp_path / name).write_text(content)
        with pytest.raises(InputError, match=message):
            read_camera(tmp_path / name)
    with pytest.raises(InputError, match="no such file"):
        read_camera(tmp_path / "none.yml")


def test_the_real_board(shared: Path) -> None:
    """The issue's figures: 24 corners and a re-projection rms of at most 0.3 px."""
    folder = shared / "data" / "charuco"
    camera = read_camera(folder / "tutorial_camera_charuco.yml")
    picture = read_stored(folder / "choriginal.jpg")
    view = find_board(picture, BOARD, "choriginal.jpg")
    whole = board_pose(view, camera)
    assert len(view.ids) == 24
    assert whole.rms_px <= 0.3
    assert (draw_board(picture, view) != picture).any()
    rng = np.random.default_rng(0)
    seen = []
    for _ in range(20):
        painted = picture.copy()
        centre = view.pixels[rng.integers(24)] + rng.normal(size=2) * 20
        half = rng.integers(30, 60, 2)
        (x0, y0), (x1, y1) = (np.rint(centre + s * half).astype(int) for s in (-1, 1))
        cv2.rectangle(painted, (x0, y0), (x1, y1), (90, 60, 200), -1)
        part = find_board(painted, BOARD, "painted")
        pose = board_pose(part, camera)
        away = np.linalg.norm(pose.translation_m - whole.translation_m)
        assert len(part.ids) >= 10
        assert away < 0.01 * np.linalg.norm(whole.translation_m)
        assert turn_deg(pose.rotation, whole.rotation) < 0.6
        seen.append(len(part.ids))
    assert min(seen) < 20  # the paint did cover something


@pytest.mark.parametrize(("focal", "k2", "kept"), [(3000.0, 0.3, False), (700.0, 0.4, True)])
def test_terms_of_the_lens_that_cannot_be_told_from_0_are_left_out(
    focal: float, k2: float, kept: bool
) -> None:
    """A long lens bends nothing by r⁴; fitted to noise, k2 would bend the picture's corners."""
    board = Board(7, 5, 0.03, 0.02)
    matrix = np.array([[focal, 0, 445.0], [0, focal, 310], [0, 0, 1]])
    lens = np.array([-0.3, k2, 0, 0, 0.0])
    rng = np.random.default_rng(8)
    views = []
    for k in range(12):
        turn = np.array([np.cos(k), np.sin(k), 0.1]) * 0.6
        away = np.array([-0.1, -0.07, 0.23 * focal / 900])
        pixels, _ = cv2.projectPoints(board.corners_m, turn, away, matrix, lens)
        noisy = pixels.reshape(-1, 2) + rng.normal(0, 0.1, (len(board.corners_m), 2))
        ids = np.arange(len(noisy), dtype=np.int32)
        views.append(BoardView(f"{k}.png", (600, 900), board, ids, noisy))
    found = calibrate(views).camera.distortion
    assert (found[1] != 0) == kept
    assert (found[2:4] == 0).all()


@pytest.mark.parametrize(
    "damage",
    [
        ("cols: 3", "cols: -1"),
        ("rows: 3", "rows: 2147483647"),
        ("rows: 3", "rows: 1"),
        ("cols: 3", "cols: many"),
        ("2.0, 0.0, 5.0", "2.0, 0.0"),
        ("data: [2.0", "data: [.inf"),
    ],
)
def test_a_matrix_of_another_size_than_its_data_is_refused(
    tmp_path: Path, damage: tuple[str, str]
) -> None:
    """OpenCV's own reader writes beyond its buffers."""
    whole = (
        "%YAML:1.0\n---\nimage_width: 20\nimage_height: 10\n"
        "camera_matrix: !!opencv-matrix\n   rows: 3\n   cols: 3\n   dt: d\n"
        "   data: [2.0, 0.0, 5.0, 0.0, 3.0, 4.0, 0.0, 0.0, 1.0]\n"
        "distortion_coefficients: !!opencv-matrix\n   rows: 1\n   cols: 5\n   dt: d\n"
        "   data: [0.1, 0.2, 0.0, 0.0, 0.3]\n"
    )
    path = tmp_path / "camera.yml"
    path.write_text(whole)
    camera = read_camera(path)
    np.testing.assert_array_equal(camera.matrix, [[2, 0, 5], [0, 3, 4], [0, 0, 1]])
    np.testing.assert_array_equal(camera.distortion, [0.1, 0.2, 0, 0, 0.3])
    path.write_text(whole.replace(*damage))
    with pytest.raises(InputError, match=r"camera\.yml: expected an? (whole )?OpenCV calibration"):
        read_camera(path)


def test_what_is_said_where_other_pictures_show_the_board(
    board_scene: Callable, tmp_path: Path
) -> None:
    """Blurred beyond recognition, or with a corner of it alone: the board is the right one."""
    whole = board_scene(BOARD, *PLACES[1])
    columns = np.flatnonzero((whole < 90).any(axis=(0, 2)))
    cut = whole.copy()
    cut[:, (columns[0] + columns[-1]) // 2 - 60 :] = 200
    names = {"soft": cv2.GaussianBlur(whole, (0, 0), 12), "cut": cut, "whole": whole}
    for name, picture in names.items():
        cv2.imwrite(str(tmp_path / f"{name}.png"), picture)
    clips = clips_of([tmp_path / f"{name}.png" for name in names])
    for each in judged(clips, BOARD, most_blur_px=5)[:2]:
        assert each.reason == "no board found"
        assert "other pictures show the board; here it is too blurred" in each.refused
        assert "expected a" not in each.refused
    with pytest.raises(InputError, match="got none in 1: no board found: expected a 5 x 7 board"):
        judged(clips_of([tmp_path / "soft.png"]), BOARD, most_blur_px=5)
