"""Chrome balls → lamps: circles, highlights, reflections and near positions against known truth."""

from __future__ import annotations

import json
from collections.abc import Sequence
from contextlib import nullcontext
from pathlib import Path

import cv2
import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from PIL import Image

from raden_torch.capture.photo.ball import Ball, ball_from_mask, find_ball
from raden_torch.capture.photo.capture_lights import capture_lights
from raden_torch.capture.photo.capture_normals import capture_normals, read_lit_set
from raden_torch.capture.photo.highlight import find_highlight
from raden_torch.capture.photo.lamps import (
    Lamps,
    lamps_from_balls,
    read_lamps,
    write_lamps,
)
from raden_torch.capture.photo.reference_photos import Reference
from raden_torch.errors import InputError

SIZE = (240, 320)
MATRIX = np.array([[400.0, 0, 159.5], [0, 400.0, 119.5], [0, 0, 1]])


def disc(x: float, y: float, r: float) -> np.ndarray:
    """A mask with an anti-aliased edge, as a person would paint it."""
    v, u = np.mgrid[: SIZE[0], : SIZE[1]]
    return (np.clip(r - np.hypot(u - x, v - y) + 0.5, 0, 1) * 255).astype(np.uint8)


def silhouette(centre: np.ndarray, radius: float) -> np.ndarray:
    """What a pinhole camera sees of a sphere, from the rays that hit it."""
    v, u = np.mgrid[: SIZE[0], : SIZE[1]].astype(float)
    rays = np.stack([u, v, np.ones_like(u)], -1) @ np.linalg.inv(MATRIX).T * [1, -1, -1]
    rays /= np.linalg.norm(rays, axis=-1, keepdims=True)
    along = rays @ centre
    return ((along**2 - centre @ centre + radius**2) > 0).astype(np.uint8) * 255


def chrome(ball: Ball, lamps: np.ndarray, *, near: bool, size_deg: float = 1.5) -> np.ndarray:
    """A clipped photograph of a mirror ball under a lamp, made from the law of reflection."""
    v, u = np.mgrid[: SIZE[0], : SIZE[1]]
    point, direction = ball.towards_lamp(u, v)
    to_lamp = lamps - point if near else np.broadcast_to(lamps, point.shape)
    to_lamp = to_lamp / np.linalg.norm(to_lamp, axis=-1, keepdims=True)
    off = np.rad2deg(np.arccos(np.clip((direction * to_lamp).sum(-1), -1, 1)))
    glow = np.clip(3 * np.exp(-((off / size_deg) ** 2)), 0, 1)
    return np.nan_to_num(0.02 + glow)[..., None].repeat(3, -1)


@settings(max_examples=25, deadline=None)
@given(st.floats(90, 230), st.floats(90, 150), st.floats(10, 80), st.booleans())
def test_a_mask_gives_the_circle(x: float, y: float, r: float, smooth: bool) -> None:
    """Rationale: a smooth edge says where the circle crosses a pixel, a hard one only which pixels
    it holds. Expected: 0.05 pixel, and a quarter of one."""
    mask = disc(x, y, r) if smooth else np.where(disc(x, y, r) > 127, 255, 0)
    ball = ball_from_mask(mask)
    bar = 0.05 if smooth else 0.25
    assert np.hypot(ball.x_px - x, ball.y_px - y) < bar
    assert abs(ball.radius_px - r) < bar
    assert ball.rms_px < 0.5


def test_a_ball_that_the_frame_cuts() -> None:
    ball = ball_from_mask(disc(30, 120, 60))
    assert (ball.x_px, ball.y_px, ball.radius_px) == pytest.approx((30, 120, 60), abs=0.3)


def test_a_ball_is_found_in_a_photograph() -> None:
    rng = np.random.default_rng(0)
    grey = 0.1 + 0.5 * disc(150.3, 121.7, 70.4) / 255.0
    photo = np.clip(cv2.GaussianBlur(grey, (0, 0), 1.0) + rng.normal(0, 0.01, SIZE), 0, 1)
    ball = find_ball([photo[..., None].repeat(3, -1)])
    assert (ball.x_px, ball.y_px, ball.radius_px) == pytest.approx((150.3, 121.7, 70.4), abs=0.4)
    with pytest.raises(InputError, match="no ball found"):
        find_ball([rng.normal(0.5, 0.01, (*SIZE, 3)).clip(0, 1)])


def test_a_camera_places_the_ball() -> None:
    centre = np.array([2.0, -1.0, -14.0])
    ball = ball_from_mask(silhouette(centre, 2.5), matrix=MATRIX, radius=2.5)
    assert ball.centre == pytest.approx(centre, abs=0.08)
    point, normal, view = ball.surface(ball.x_px, ball.y_px)
    assert np.linalg.norm(point - ball.centre) == pytest.approx(2.5)
    assert (normal * view).sum() > 0.99
    assert np.isnan(ball.surface(0, 0)[1]).all()


@settings(max_examples=25, deadline=None)
@given(st.floats(0, 2 * np.pi), st.floats(0, 65))
def test_the_direction_to_a_far_lamp(turn: float, from_axis_deg: float) -> None:
    """Rationale: L = 2 (N·V) N − V at the highlight. Expected: within half a degree."""
    theta = np.deg2rad(from_axis_deg)
    lamp = np.array([np.sin(theta) * np.cos(turn), np.sin(theta) * np.sin(turn), np.cos(theta)])
    ball = ball_from_mask(disc(160, 120, 80))
    photo = chrome(ball, lamp, near=False)
    lamps = lamps_from_balls([ball], [[find_highlight(photo, ball)]])
    assert np.rad2deg(np.arccos(min(1.0, lamps.direction[0] @ lamp))) < 0.5


@pytest.mark.parametrize("perspective", [False, True])
def test_two_balls_place_a_near_lamp(perspective: bool) -> None:
    if perspective:
        centres = [np.array([-4.0, 0.5, -15.0]), np.array([4.0, -0.5, -16.0])]
        balls = [ball_from_mask(silhouette(c, 2.5), matrix=MATRIX, radius=2.5) for c in centres]
        true = np.array([[3.0, 8.0, -5.0], [-9.0, 4.0, -6.0]])
    else:
        balls = [ball_from_mask(disc(80, 120, 60)), ball_from_mask(disc(240, 120, 60))]
        true = np.array([[200.0, 60.0, 500.0], [60.0, -300.0, 600.0]])
    rows = [
        [find_highlight(chrome(b, lamp, near=True), b, name=f"{k}.png") for b in balls]
        for k, lamp in enumerate(true)
    ]
    lamps = lamps_from_balls(balls, rows)
    assert lamps.position is not None
    distance = np.linalg.norm(true - np.mean([b.centre for b in balls], axis=0), axis=1)
    assert (np.linalg.norm(lamps.position - true, axis=1) < 0.06 * distance).all()
    assert (lamps.miss < 0.02 * distance).all()


def test_far_lamps_have_no_position() -> None:
    balls = [ball_from_mask(disc(80, 120, 60)), ball_from_mask(disc(240, 120, 60))]
    lamp = np.array([0.3, 0.4, np.sqrt(0.75)])
    lamps = lamps_from_balls(
        balls, [[find_highlight(chrome(b, lamp, near=False), b) for b in balls]]
    )
    assert lamps.position is None
    assert "too far away" in lamps.notes[0]


def test_irradiance_falls_with_the_square_of_the_distance() -> None:
    ball = ball_from_mask(disc(160, 120, 80))
    lamps = lamps_from_balls([ball], [[find_highlight(chrome(ball, [0, 0, 1], near=False), ball)]])
    points = np.array([[0.0, 300.0], [0.0, 0.0], [0.0, 0.0]])
    assert np.linalg.norm(lamps.towards(points), axis=1) == pytest.approx(np.ones((1, 2)))
    from dataclasses import replace

    near = replace(lamps, position=np.array([[0.0, 0.0, 400.0]]))
    to_lamp = near.towards(points)
    length = np.linalg.norm(to_lamp, axis=1)[0]
    assert length[0] / length[1] == pytest.approx((500 / 400) ** 2)
    assert to_lamp[0, :, 1] / length[1] == pytest.approx([-0.6, 0, 0.8])


def test_a_plane_through_a_lens() -> None:
    """Rationale: OpenCV projects the plane's points on to the pixels that they belong to."""
    matrix = np.array([[300.0, 0, 150], [0, 310, 110], [0, 0, 1]])
    lens = np.array([-0.25, 0.08, 0.001, -0.002, 0.0])
    lamps = Lamps(np.eye(3), np.ones(3), matrix=matrix, distortion=lens)
    points = lamps.plane((220, 300), -500.0)
    assert points[2] == pytest.approx(-500.0)
    opencv = (points.reshape(3, -1) * [[1], [-1], [-1]]).T
    pixels = cv2.projectPoints(opencv, np.zeros(3), np.zeros(3), matrix, lens)[0].reshape(-1, 2)
    v, u = np.mgrid[:220, :300]
    assert np.abs(pixels - np.stack([u, v], -1).reshape(-1, 2)).max() < 0.02


@pytest.fixture
def balls_under_coloured_lamps(tmp_path: Path) -> tuple[list[Path], Reference, np.ndarray]:
    """Simulated: a mirror and a matt ball, linear in 16 bits, under six lamps of other colours."""
    tint = 1 - 0.4 * np.random.default_rng(3).random((6, 3))
    turn = np.arange(6) * np.pi / 3
    to_lamp = np.stack([0.5 * np.cos(turn), 0.5 * np.sin(turn), np.full(6, 0.75**0.5)], 1)
    ball = ball_from_mask(disc(160, 120, 80))
    v, u = np.mgrid[: SIZE[0], : SIZE[1]]
    normal = np.nan_to_num(ball.surface(u, v)[1])
    photographs = []
    for k, lamp in enumerate(to_lamp):
        mirror = chrome(ball, lamp, near=False)
        matt = 0.8 * np.clip(normal @ lamp, 0, 1)[..., None] * tint[k]
        for name, linear in (("c", mirror), ("g", matt)):
            stored = np.rint(65535 * np.clip(linear, 0, 1)).astype(np.uint16)
            cv2.imwrite(str(tmp_path / f"{name}{k}.png"), stored[..., ::-1])
        photographs.append(tmp_path / f"c{k}.png")
    mask = tmp_path / "mask.png"
    cv2.imwrite(str(mask), 255 * (disc(160, 120, 80) > 127).astype(np.uint8))
    return photographs, Reference(str(tmp_path / "g?.png"), mask), tint


def test_the_colours_of_lamps(balls_under_coloured_lamps, tmp_path: Path) -> None:
    photographs, grey, tint = balls_under_coloured_lamps
    lamps = capture_lights(photographs, [grey.mask], reference=grey, coded="linear").lamps
    assert lamps.intensity == pytest.approx(tint.mean(1) / tint.mean(), abs=0.01)
    expected = tint / tint.mean(0) * (tint.mean() / tint.mean(1))[:, None]
    assert lamps.tint == pytest.approx(expected, abs=0.01)
    write_lamps(lamps, tmp_path / "lights.json")
    assert read_lamps(tmp_path / "lights.json").tint == pytest.approx(lamps.tint, abs=1e-5)


def test_linear_files_read_as_srgb_are_noticed_on_a_grey_ball(balls_under_coloured_lamps) -> None:
    photographs, grey, _ = balls_under_coloured_lamps
    with pytest.warns(UserWarning, match=r"g0\.png: .* not linear light: set `coded` to linear"):
        capture_lights(photographs, [grey.mask], reference=grey)


def test_a_lamp_that_moved_is_named_and_left_out(tmp_path: Path) -> None:
    """Simulated: lamp 3 stands ten degrees off under the grey ball and the object, not the mirror;
    the lights file is read by `capture_normals`, which gives its true normals all the same."""
    turn = np.arange(8) * np.pi / 4
    to_lamp = np.stack([0.5 * np.cos(turn), 0.5 * np.sin(turn), np.full(8, 0.75**0.5)], 1)
    elsewhere = to_lamp.copy()
    elsewhere[2] = [0.05, 0.65, 0.75]
    elsewhere[2] /= np.linalg.norm(elsewhere[2])
    ball = ball_from_mask(disc(160, 120, 80))
    v, u = np.mgrid[: SIZE[0], : SIZE[1]]
    normal = np.nan_to_num(ball.surface(u, v)[1])
    chromes, greys = [], []
    for k in range(8):
        grey = 0.8 * np.clip(normal @ elsewhere[k], 0, 1)[..., None] * np.ones(3)
        for name, linear, to in (
            ("c", chrome(ball, to_lamp[k], near=False), chromes),
            ("g", grey, greys),
        ):
            path = tmp_path / f"{name}{k}.png"
            stored = np.rint(65535 * np.clip(linear, 0, 1)).astype(np.uint16)
            cv2.imwrite(str(path), stored[..., ::-1])
            to.append(path)
    mask, lights = tmp_path / "mask.png", tmp_path / "lights.json"
    cv2.imwrite(str(mask), 255 * (disc(160, 120, 80) > 127).astype(np.uint8))
    reference = Reference(str(tmp_path / "g?.png"), mask, fit_response=True)
    with pytest.warns(UserWarning, match=r"g2\.png: .* lamp 3 stood elsewhere than in c2\.png"):
        lamps = capture_lights(chromes, [mask], reference=reference, coded="linear").lamps
    assert lamps.exponent == pytest.approx(1.0, abs=0.02)
    assert lamps.moved is not None
    assert np.flatnonzero(lamps.moved).tolist() == [2]
    assert any("lamp 3" in note for note in lamps.notes)
    write_lamps(lamps, lights)
    again = read_lamps(lights)
    assert again.moved is not None
    assert again.moved.tolist() == lamps.moved.tolist()
    found = capture_normals(greys, lights, mask, coded="linear").surface
    assert np.isnan(float(found.lamp_residual[2]))
    inside = ball.inside(SIZE, 0.9)
    off = np.linalg.norm(found.normal[0].numpy().transpose(1, 2, 0) - normal, axis=-1)
    assert np.degrees(np.median(off[inside])) < 0.2
    text = lights.read_text("utf-8")
    assert text.count('"moved": true') == 1
    lights.write_text(text.replace('"moved": true', '"moved": false'))
    with pytest.warns(UserWarning, match="it disagrees with the others"):
        kept = capture_normals(greys, lights, mask, coded="linear").surface
    assert np.isfinite(float(kept.lamp_residual[2]))


def retagged(path: Path, orientation: int | None, *, lying: bool = False) -> Path:
    """The photograph in 8 bits with an orientation in EXIF: of the same scene, or, lying, of the
    same pixels."""
    pixels = cv2.imread(str(path))[..., ::-1]
    exif = Image.Exif()
    if orientation is not None:
        exif[274] = orientation
    if orientation == 3 and not lying:
        pixels = pixels[::-1, ::-1]
    target = path.with_name(f"{path.stem}-{orientation}-{lying}.png")
    Image.fromarray(np.ascontiguousarray(pixels)).save(target, exif=exif)
    return target


def test_lamps_are_as_the_camera_file_turns_the_photographs(
    balls_under_coloured_lamps, tmp_path: Path
) -> None:
    """Rationale: a phone that looks down guesses how it is held, and tags one sensor's pictures as
    turned by 180 degrees. Expected: the lamps of untagged ones; a mask over pictures that the
    camera file turns is refused."""
    photographs, grey, _ = balls_under_coloured_lamps
    camera = tmp_path / "camera.json"
    content = {
        **{"format": "raden capture", "version": 1, "kind": "camera", "distortion": [0.0] * 5},
        **{"image_width_px": SIZE[1], "image_height_px": SIZE[0], "orientation": 1},
        "camera_matrix_px": MATRIX.tolist(),
    }
    camera.write_text(json.dumps(content))

    def lamps(orientation: int | None, masks: Sequence[Path] = ()) -> Lamps:
        tagged = [retagged(path, orientation, lying=True) for path in photographs]
        return capture_lights(
            tagged, masks, camera=camera, ball_radius_mm=10.0, coded="linear"
        ).lamps

    upright, turned = lamps(None), lamps(3)
    assert upright.orientation == 1  # as the camera file says
    assert turned.orientation == 1
    np.testing.assert_array_equal(turned.direction, upright.direction)
    with pytest.raises(InputError, match=r"mask\.png: expected a mask beside .*, 1, got"):
        lamps(3, [grey.mask])
    assert lamps(1, [grey.mask]).orientation == 1
    # the sample's photographs are turned as the balls' were: not refused for their own tags
    write_lamps(turned, tmp_path / "lights.json")
    matt = [retagged(path, 3, lying=True) for path in sorted(tmp_path.glob("g?.png"))]
    found = read_lit_set(matt, tmp_path / "lights.json", None, coded="linear")
    assert found.photos.orientation == 1
    plain = [retagged(path, None) for path in sorted(tmp_path.glob("g?.png"))]
    upright_set = read_lit_set(plain, tmp_path / "lights.json", None, coded="linear")
    assert torch.equal(found.photos.images, upright_set.photos.images)


@pytest.mark.filterwarnings("ignore:.*disagrees with the others")  # the lamps' tints
@pytest.mark.parametrize(
    ("theirs", "own", "fits"), [(1, 1, True), (3, 3, True), (1, 3, False), (None, 3, True)]
)
def test_lamps_and_photographs_that_are_turned_otherwise(
    balls_under_coloured_lamps, tmp_path: Path, theirs: int | None, own: int, fits: bool
) -> None:
    """Expected: refused, where both say how they are turned; the reference, too."""
    photographs, grey, _ = balls_under_coloured_lamps
    matt = [retagged(path, own) for path in sorted(tmp_path.glob("g?.png"))]
    balls = [retagged(path, theirs) for path in photographs]
    lights = tmp_path / "lights.json"
    write_lamps(capture_lights(balls, [grey.mask], coded="linear").lamps, lights)
    assert read_lamps(lights).orientation == theirs
    said = rf"orientation by EXIF: expected {theirs}, as the photographs were read that gave"
    reference = Reference(str(tmp_path / f"g?-{own}-False.png"), grey.mask)
    with nullcontext() if fits else pytest.raises(InputError, match=said):
        capture_normals(matt, lights, grey.mask, coded="linear")
    with nullcontext() if fits else pytest.raises(InputError, match=said):
        capture_lights(balls, [grey.mask], reference=reference, coded="linear")


def test_lights_come_back_from_their_file(tmp_path: Path) -> None:
    balls = [ball_from_mask(disc(80, 120, 60)), ball_from_mask(disc(240, 120, 60))]
    true = np.array([[200.0, 60.0, 500.0], [60.0, -300.0, 600.0]])
    rows = [
        [find_highlight(chrome(b, lamp, near=True), b, name=f"{k}.png") for b in balls]
        for k, lamp in enumerate(true)
    ]
    lamps = lamps_from_balls(balls, rows)
    write_lamps(lamps, tmp_path / "lights.json", balls=balls, made_from=["0.png"])
    again = read_lamps(tmp_path / "lights.json")
    assert again.direction == pytest.approx(lamps.direction, abs=1e-6)
    assert again.position == pytest.approx(lamps.position)
    assert again.names == ("0.png", "1.png")
    text = (tmp_path / "lights.json").read_text("utf-8")
    assert "are no normals" in text
    (tmp_path / "lights.json").write_text(text.replace('"intensity": 1.0', '"intensity": -1.0'))
    with pytest.raises(
        InputError, match=r"lamps\[0\].intensity: expected a number above 0, got -1"
    ):
        read_lamps(tmp_path / "lights.json")
    (tmp_path / "lights.json").write_text(text.replace('"direction_to_lamp"', '"way"'))
    with pytest.raises(InputError, match="direction_to_lamp"):
        read_lamps(tmp_path / "lights.json")


def stand(mask: np.ndarray) -> np.ndarray:
    mask[150:230, 130:190] = 255
    return mask


BAD_MASKS = {
    "empty": (np.zeros(SIZE, np.uint8), "empty"),
    "with its stand": (stand(disc(160, 90, 70)), "not round"),
    "two balls": (
        np.maximum(disc(70, 120, 50), disc(220, 120, 55)),
        "expected one mask per ball, got more than one white area",
    ),
    "a hollow ring": (
        disc(160, 120, 80) - disc(160, 120, 74),
        "white all over the ball, got one with holes",
    ),
    "tiny": (disc(160, 120, 5), "too small|no outline"),
    "all white": (np.full(SIZE, 255, np.uint8), "no outline"),
}


@pytest.mark.parametrize("name", BAD_MASKS)
def test_a_mask_that_is_no_ball(name: str) -> None:
    mask, message = BAD_MASKS[name]
    with pytest.raises(InputError, match=message) as raised:
        ball_from_mask(mask, name="ball.png")
    assert "ball.png" in str(raised.value)


def test_photographs_without_one_highlight() -> None:
    ball = ball_from_mask(disc(160, 120, 80))
    lamp = np.array([0.3, 0.2, np.sqrt(0.87)])
    one = chrome(ball, lamp, near=False)
    other = chrome(ball, lamp * [-1, 1, 1], near=False)
    for photo, message in (
        (np.full((*SIZE, 3), 0.3), "no highlight"),
        (np.ones((*SIZE, 3)), "no highlight"),
        (np.zeros((*SIZE, 3)), "no highlight"),
        (np.maximum(one, other), "expected one highlight on the ball, .*, got two"),
        (chrome(ball, lamp, near=False, size_deg=25), "covers"),
    ):
        with pytest.raises(InputError, match=message) as raised:
            find_highlight(photo, ball, name="chrome.3.png")
        assert "chrome.3.png" in str(raised.value)


def test_the_real_chrome_ball(shared: Path) -> None:
    folder = shared / "data/photometric_stereo"
    ball = ball_from_mask(cv2.imread(str(folder / "chrome.mask.png"), cv2.IMREAD_GRAYSCALE))
    rows = [
        [find_highlight(cv2.imread(str(folder / f"chrome.{k}.png")) / 255, ball)] for k in range(12)
    ]
    lamps = lamps_from_balls([ball], rows)
    assert ball.rms_px < 0.5
    assert (lamps.direction[:, 2] > 0.7).all()  # all in front
    assert (lamps.direction[:, 1] > 0).all()  # all above
    grey = ball_from_mask(cv2.imread(str(folder / "gray.mask.png"), cv2.IMREAD_GRAYSCALE))
    seen = find_ball([cv2.imread(str(folder / f"gray.{k}.png")) / 255 for k in range(12)])
    assert np.hypot(seen.x_px - grey.x_px, seen.y_px - grey.y_px) < 1.5
    assert abs(seen.radius_px - grey.radius_px) < 1


def test_a_small_highlight_is_found_between_the_pixels() -> None:
    """As wide as the lens is sharp: what is below half of its peak tells where it lies."""
    mask = disc(60.3, 58.8, 45.0)
    ball = ball_from_mask(mask)
    y, x = np.mgrid[: mask.shape[0], : mask.shape[1]]
    for true in ([50.0, 60.0], [50.25, 60.5], [49.6, 60.1]):
        tent = np.clip(1.5 - abs(x - true[0]), 0, 1) * np.clip(1.5 - abs(y - true[1]), 0, 1)
        found = find_highlight(np.repeat((0.01 + 0.8 * tent)[..., None], 3, 2), ball)
        np.testing.assert_allclose([found.x_px, found.y_px], true, atol=0.06)
