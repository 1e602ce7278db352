"""The small parts of capture/photo: pictures of what was found, the lens of balls, chart grids."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
import torch

from raden_torch.capture.photo.ball_lens import BallLens
from raden_torch.capture.photo.brdf.photo_angles import angles_deg
from raden_torch.capture.photo.chart import COLUMNS, ROWS, Chart, sampled
from raden_torch.capture.photo.chart_fit import oriented, refined
from raden_torch.capture.photo.chart_reference import reference_xyz
from raden_torch.capture.photo.checking_picture import (
    captioned,
    picture_path,
    side_by_side,
    small,
)
from raden_torch.capture.photo.photo_set import PhotoSet
from raden_torch.capture.photo.photograph import shown
from raden_torch.errors import InputError
from raden_torch.measurement.colour_conversion import xyz_to_rgb_matrix

CAMERA = """%YAML:1.0
image_width: 64
image_height: 48
camera_matrix: !!opencv-matrix
   rows: 3
   cols: 3
   dt: d
   data: [ 60., 0., 32., 0., 61., 24., 0., 0., 1. ]
distortion_coefficients: !!opencv-matrix
   rows: 1
   cols: 5
   dt: d
   data: [ -0.3, 0.1, 0., 0., 0. ]
"""


def test_pictures_side_by_side_keep_their_pixels() -> None:
    frames = [np.full((10 + k, 20 - k, 3), 50 * k + 5, np.uint8) for k in range(5)]
    sheet = side_by_side(frames)
    assert sheet.shape == (2 * 14, 3 * 20, 3)
    for k, frame in enumerate(frames):
        y, x = (k // 3) * 14, (k % 3) * 20
        np.testing.assert_array_equal(sheet[y : y + len(frame), x : x + frame.shape[1]], frame)
    assert (sheet[14:, 40:] == 40).all()
    np.testing.assert_array_equal(captioned(frames[0], "µ is not ASCII")[:10], frames[0])
    assert captioned(frames[0], "")[10:].sum() == 0
    assert small(frames[0]) is frames[0]
    wide = np.tile(np.arange(0, 256, 2, dtype=np.uint8).repeat(10)[None, :, None], (320, 1, 3))
    assert small(wide).shape == (160, 640, 3)
    assert abs(small(wide).mean() - wide.mean()) < 0.5


def test_where_the_picture_goes(tmp_path: Path) -> None:
    assert picture_path(None, tmp_path / "a.json") == tmp_path / "a.png"
    assert picture_path(tmp_path / "b.jpg", tmp_path / "a.json") == tmp_path / "b.jpg"
    with pytest.raises(InputError, match=r"b\.gif: expected a file name that ends in \.png or"):
        picture_path(tmp_path / "b.gif", tmp_path / "a.json")


def test_pictures_of_balls_without_distortion(tmp_path: Path) -> None:
    """Straightened as OpenCV does it; without a camera nothing is touched."""
    path = tmp_path / "camera.yml"
    path.write_text(CAMERA)
    lens = BallLens.of(path, 10.0)
    assert lens.matrix is not None
    picture = np.random.default_rng(0).random((48, 64, 3)).astype(np.float32)
    wanted = cv2.undistort(picture, lens.matrix, np.array([-0.3, 0.1, 0, 0, 0]))
    np.testing.assert_array_equal(lens.straight(picture), wanted)
    photos = PhotoSet(torch.from_numpy(picture).movedim(-1, 0)[None], torch.zeros(1, 1, 48, 64), ())
    straight = lens.straightened(photos, [lens.straight(picture)])
    np.testing.assert_array_equal(straight.images[0].movedim(0, -1), wanted)
    plain = BallLens.of(None, None)
    assert plain.straight(picture) is picture
    assert plain.straightened(photos, []) is photos
    with pytest.raises(InputError, match="of use with a camera only"):
        BallLens.of(None, 10.0)
    with pytest.raises(InputError, match="the ball's radius in mm is needed"):
        BallLens.of(path, None)
    with pytest.raises(InputError, match=r"at their size of 50 x 40 pixels, got one of 64 x 48"):
        lens.check_size(path, (40, 50))


def charted(pitch: int = 30) -> np.ndarray:
    """A chart drawn upright: black, with patches of 0.8 of the pitch."""
    rgb = np.clip(reference_xyz() @ xyz_to_rgb_matrix().T, 0, 1).reshape(ROWS, COLUMNS, 3)
    linear = np.full((ROWS * pitch + 40, COLUMNS * pitch + 40, 3), 0.02)
    edge = pitch // 10
    for row in range(ROWS):
        for column in range(COLUMNS):
            y, x = 20 + row * pitch, 20 + column * pitch
            part = slice(y + edge, y + pitch - edge), slice(x + edge, x + pitch - edge)
            linear[part] = rgb[row, column]
    return shown(linear)


def grid_at(x: float, y: float, pitch: float) -> np.ndarray:
    return np.array([[pitch, 0, x - 0.5], [0, pitch, y - 0.5], [0, 0, 1.0]])


def test_a_grid_is_moved_onto_the_patches() -> None:
    """Three pixels off each way, and 4 % too large."""
    picture = charted()
    found = Chart(refined(picture, grid_at(23, 17, 31.2)), False, 0.0)
    truth = Chart(grid_at(20, 20, 30), False, 0.0)
    # what is measured, 0.45 of the pitch, may lie 5 pixels off and is on its patch
    assert np.abs(found.squares() - truth.squares()).max() < 3.5
    before = Chart(grid_at(23, 17, 31.2), False, 0.0)
    assert np.abs(before.squares() - truth.squares()).max() > 8


@pytest.mark.parametrize("mirror", [False, True])
@pytest.mark.parametrize("half_turn", [False, True])
def test_the_orientation_is_that_of_the_colours(mirror: bool, half_turn: bool) -> None:
    picture = charted()
    seen = picture[:, ::-1] if mirror else picture
    seen = np.ascontiguousarray(seen[::-1, ::-1] if half_turn else seen)
    chart = oriented(seen, grid_at(20, 20, 30))
    assert chart is not None
    assert chart.mirrored == mirror
    assert chart.misfit < 0.1
    height, width = seen.shape[:2]
    dark_skin = np.array([34.5, 34.5])
    dark_skin = [width - 1 - dark_skin[0], dark_skin[1]] if mirror else dark_skin
    if half_turn:
        dark_skin = [width - 1 - dark_skin[0], height - 1 - dark_skin[1]]
    np.testing.assert_allclose(chart.pixels(np.array([0.5, 0.5])), dark_skin, atol=0.6)
    assert oriented(np.full_like(picture, 128), grid_at(20, 20, 30)) is None


def test_values_between_pixels() -> None:
    """A bilinear ramp is itself at any place; beyond the edge it goes on as it ends."""
    y, x = np.mgrid[:20, :30].astype(np.float32)
    points = np.random.default_rng(0).random((5, 7, 2)) * [29, 19]
    found = sampled(np.stack([x, 2 * y], -1), points)
    np.testing.assert_allclose(found, points * [1, 2], atol=0.07)  # OpenCV: 1/32 of a pixel
    np.testing.assert_allclose(sampled(x, np.array([[-5.0, 3.0], [40.0, 3.0]]))[:, 0], [0, 29])
    many = np.tile(points.reshape(-1, 2), (2000, 1))  # more than the columns that remap takes
    np.testing.assert_array_equal(sampled(x, many)[:35], sampled(x, many)[-35:])


def test_angles_of_the_paper_s_plane() -> None:
    """N in the plane of L and V: incidence and receiving are the angles to N; tilt is 0."""
    degrees = np.radians(np.array([[20.0, 50.0], [45.0, -10.0], [60.0, 70.0]]))
    normal = np.tile([0.0, 0, 1], (3, 1))
    light = np.stack([-np.sin(degrees[:, 0]), 0 * degrees[:, 0], np.cos(degrees[:, 0])], 1)
    view = np.stack([np.sin(degrees[:, 1]), 0 * degrees[:, 1], np.cos(degrees[:, 1])], 1)
    found = angles_deg(normal, light, view)
    np.testing.assert_allclose(found, np.c_[np.degrees(degrees), np.zeros(3)], atol=2e-4)
