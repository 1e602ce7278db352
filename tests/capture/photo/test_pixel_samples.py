"""From pixels to reflectance: lamps, samples, the white, colour, and whether the sample moved."""

from __future__ import annotations

import json
from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path

import colour as colour_science
import cv2
import numpy as np
import pytest
from PIL import Image

from raden_torch.capture.photo.brdf.agreement import agreement
from raden_torch.capture.photo.brdf.capture_settings import CaptureSetup, SampleSpec
from raden_torch.capture.photo.brdf.cell_fit import robust_fit
from raden_torch.capture.photo.brdf.lighting import Lamp, directions_across, lamps_of_shots
from raden_torch.capture.photo.brdf.movement import edges_near, moved, outline_of
from raden_torch.capture.photo.brdf.node_colour import NodeColour
from raden_torch.capture.photo.brdf.photo_budget import relative_colour
from raden_torch.capture.photo.brdf.photo_cells import CellGrid
from raden_torch.capture.photo.brdf.photo_series import Frame, read_frame, read_series
from raden_torch.capture.photo.brdf.photo_white import (
    Scale,
    WhiteFactor,
    WhitePlace,
    WhiteReading,
    read_white,
    scale_of,
)
from raden_torch.capture.photo.brdf.pixel_samples import samples, samples_in_cells
from raden_torch.capture.photo.brdf.rays import rays_through
from raden_torch.capture.photo.brdf.reservoir import Reservoir
from raden_torch.capture.photo.brdf.sample_placement import SampleInPhotograph, place_sample
from raden_torch.capture.photo.brdf.sample_shapes import Plane, Sphere
from raden_torch.capture.photo.brdf.seen_surface import (
    LEAST_COSINE,
    SeenSurface,
    normal_std_deg,
    outline_std_px,
    seen_surface,
)
from raden_torch.capture.photo.brdf.shots import Shot, check_masks, shots_of
from raden_torch.capture.photo.brdf.white_sight import WhiteSight
from raden_torch.capture.photo.camera import Camera, Pose
from raden_torch.capture.photo.colour import ColourCorrection
from raden_torch.capture.photo.development import Development
from raden_torch.capture.photo.lamps import Lamps
from raden_torch.colorimetry import D65_XYZ
from raden_torch.errors import InputError
from raden_torch.images.raw_image import RawColour
from raden_torch.measurement.colour_conversion import xyz_to_rgb_matrix
from tests.capture.photo.brdf.conftest import write_lights

SIZE = (140, 160)
BALL = Sphere(np.array([80.0, -70.0, 0.0]), 50.0)
LEAN = np.array([0.3, -0.2, 0.8]) / np.sqrt(0.77)
RGB = np.array([0.9, 1.0, 1.1])
ACROSS = directions_across(LEAN)
FAR = Lamp(LEAN, None, RGB, 0.1, ACROSS)
NEAR = Lamp(LEAN, BALL.middle + 300 * LEAN, RGB, 0.1, ACROSS)


def seen_ball(ball: Sphere = BALL) -> SeenSurface:
    y, x = (v.ravel() for v in np.mgrid[: SIZE[0], : SIZE[1]])
    on = np.isfinite(ball.seen(rays_through(None, x, y)).normal).all(axis=1)
    return seen_surface(SampleInPhotograph(ball, x[on], y[on]), None)


def lit_by(lamp: Lamp, seen: SeenSurface, albedo: np.ndarray) -> Frame:
    """A matt ball's photograph: signal = albedo · irradiance, written out."""
    radiance = np.zeros((*SIZE, 3), np.float32)
    way = np.broadcast_to(lamp.direction, seen.surface.point.shape)
    fall = np.ones(len(way))
    if lamp.position is not None:
        way = lamp.position - seen.surface.point
        fall = ((lamp.position - BALL.middle) ** 2).sum() / (way**2).sum(1)
        way = way / np.linalg.norm(way, axis=1, keepdims=True)
    cosine = np.clip((way * seen.surface.normal).sum(1), 0, None)
    radiance[seen.y_px, seen.x_px] = (cosine * fall)[:, None] * albedo * lamp.rgb
    return Frame(radiance, np.ones(SIZE, bool), timed=False)


@pytest.mark.parametrize("lamp", [FAR, NEAR], ids=["far", "near"])
def test_a_matt_ball_reflects_alike_in_all_pixels(lamp: Lamp) -> None:
    """Each sample is albedo / white's, whatever its geometry; cos θi = cos a cos t, and likewise
    for the viewer."""
    seen, albedo, white = seen_ball(), np.array([0.2, 0.4, 0.6]), np.array([0.9, 0.8, 0.7])
    tiles = list(samples(lit_by(lamp, seen, albedo), seen, lamp, white * lamp.rgb))
    angles, value, pixel = (np.concatenate(part) for part in zip(*tiles, strict=True))
    np.testing.assert_allclose(value, np.broadcast_to(albedo / white, value.shape), rtol=1e-5)
    way = lamp.direction if lamp.position is None else lamp.position - seen.surface.point
    way = np.broadcast_to(way, seen.surface.point.shape)
    lit = (way * seen.surface.normal).sum(1) / np.linalg.norm(way, axis=1)
    lit_there = lit > LEAST_COSINE
    assert len(value) == lit_there.sum()
    np.testing.assert_array_equal(pixel, (seen.y_px * SIZE[1] + seen.x_px)[lit_there])
    a, r, t = np.radians(angles.T.astype(float))
    np.testing.assert_allclose(np.cos(a) * np.cos(t), lit[lit_there], atol=1e-5)
    facing = seen.surface.normal[lit_there, 2]
    np.testing.assert_allclose(np.cos(r) * np.cos(t), facing, atol=1e-5)


def test_unusable_pixels_give_no_sample_and_cells_hold_the_rest() -> None:
    seen, grid = seen_ball(), CellGrid(10.0)
    frame = lit_by(FAR, seen, np.ones(3))
    usable = frame.usable.copy()
    usable[:70] = False
    whole, half = (
        list(samples_in_cells(f, seen, FAR, RGB, grid))
        for f in (frame, replace(frame, usable=usable))
    )
    assert sum(len(part.cell) for part in half) < 0.7 * sum(len(part.cell) for part in whole)
    for part in whole:
        assert part.x.shape == part.y.shape == (len(part.cell), 3)
        assert (part.cell < grid.cells).all()
        np.testing.assert_allclose(part.y, 1, rtol=1e-5)


def test_pixels_that_graze_the_sample_are_left_out() -> None:
    seen = seen_ball()
    assert (seen.surface.normal[:, 2] > LEAST_COSINE).all()
    share = len(seen.x_px) / (np.pi * BALL.radius**2)  # sin² of the limiting angle
    assert share == pytest.approx(1 - LEAST_COSINE**2, abs=0.01)
    assert seen.middle.tolist() == [80, -70, 50]
    # a third of a pixel over 50 is a third of a degree
    assert outline_std_px(seen, 0.3) == 0.3
    assert outline_std_px(seen, None) == seen.outline_px
    assert outline_std_px(None, 0.3) == 0  # on the board
    assert normal_std_deg(seen, 0.3) == pytest.approx(np.degrees(0.3 / 49.8), rel=0.02)
    assert normal_std_deg(None, 0.3) == 0


def test_a_sphere_is_found_in_the_pictures_only_where_there_is_no_mask(tmp_path: Path) -> None:
    y, x = np.mgrid[: SIZE[0], : SIZE[1]]
    mask = tmp_path / "mask.png"
    cv2.imwrite(str(mask), 255 * (np.hypot(x - 80, y - 70) < 50).astype(np.uint8))
    never = (pytest.fail("a photograph was read") for _ in range(1))
    placed = place_sample(SampleSpec("sphere", mask), None, None, SIZE, never, "a.png")
    assert isinstance(placed.shape, Sphere)
    np.testing.assert_allclose(placed.shape.centre[:2], [80, -70], atol=0.3)
    assert placed.shape.radius == pytest.approx(50, abs=0.6)
    camera = Camera(np.diag([900.0, 900, 1]), np.zeros(5), SIZE)
    with pytest.raises(InputError, match="sphere: expected its radius in mm"):
        place_sample(SampleSpec("sphere"), camera, None, SIZE, never, "a.png")


def shot(pose: Pose | None) -> Shot:
    return Shot((Path("a.png"),), 0, pose, Development())


def test_a_lamp_beside_the_board_as_the_camera_moves() -> None:
    """Its place on the board, computed from either camera's pose, is the same."""
    first = Pose(np.eye(3), np.array([0.0, 0.0, 0.5]), 0.1, 24)
    turned = Pose(cv2.Rodrigues(np.array([0.3, -0.2, 0.9]))[0], np.array([0.1, 0, 0.6]), 0.1, 24)
    place = np.array([[120.0, 80.0, -300.0]])  # x right, y up, z to the viewer, mm
    way = place / np.linalg.norm(place)
    lamps = Lamps(way, np.ones(1), place, unit="mm")
    setup, camera = CaptureSetup(Path("l.json")), Camera(np.eye(3), np.zeros(5), SIZE)
    (moved_lamp,) = lamps_of_shots(lamps, [shot(turned)], camera, setup, first)
    flip = np.array([1.0, -1.0, -1.0])

    def on_board(position: np.ndarray, pose: Pose) -> np.ndarray:
        return pose.rotation.T @ (position * flip / 1000 - pose.translation_m)

    assert moved_lamp.position is not None
    np.testing.assert_allclose(
        on_board(moved_lamp.position, turned), on_board(place[0], first), atol=1e-12
    )
    (still,) = lamps_of_shots(lamps, [shot(turned)], camera, setup, None)
    np.testing.assert_array_equal(still.position, place[0])
    assert still.std_deg == 0.5
    with pytest.raises(InputError, match=r"l\.json: .* in mm; give the camera file"):
        lamps_of_shots(lamps, [shot(None)], None, setup, None)
    with pytest.raises(InputError, match=r"a\.png: the board's pose in it is not known"):
        lamps_of_shots(lamps, [shot(None)], camera, setup, first)


def test_photographs_stacks_and_lamps_are_told_apart() -> None:
    files = [Path(f"p{k}.tif") for k in range(6)]
    lamps = Lamps(np.tile(LEAN, (3, 1)), np.ones(3), names=("b1", "b2", "b3"))
    times = (0.1, 0.2, 0.3, 0.4, 0.5, 0.6)
    setup = CaptureSetup(Path("l.json"), stack=2, development=Development(exposures_s=times))
    pose = Pose(np.eye(3), np.ones(3), 0.1, 24)
    shots = shots_of(files, setup, lamps, {"p3.tif": pose, "p9.tif": pose})
    assert [s.lamp for s in shots] == [0, 1, 2]
    assert [s.files for s in shots] == [(files[0], files[1]), (files[2], files[3]), (*files[4:],)]
    assert [s.how.exposures_s for s in shots] == [(0.1, 0.2), (0.3, 0.4), (0.5, 0.6)]
    assert [s.pose for s in shots] == [None, pose, None]
    alone = shots_of(files, replace(setup, lamps=(3, 3, 1)), lamps, {"x.tif": pose})
    assert [s.lamp for s in alone] == [2, 2, 0]
    assert [s.pose for s in alone] == [pose] * 3  # nothing moves
    short = replace(setup, development=Development(exposures_s=times[:4]))
    with pytest.raises(InputError, match="exposure times: expected none, 2 or 6"):
        shots_of(files, short, lamps, {})


SIGHT = WhiteSight(
    rays_through(None, np.zeros(1), np.zeros(1)), Plane(np.zeros((1, 3)), np.eye(3)[2]), False
)
PARTS = np.stack(np.divmod(np.arange(32.0), 4), axis=1)


def test_the_white_s_signal_is_that_for_light_from_straight_above() -> None:
    """A tile leans; its level over cos θi and the near lamp's falloff is the same everywhere."""
    normal = np.array([0.2, 0.1, 0.9]) / np.linalg.norm([0.2, 0.1, 0.9])
    y, x = (v.ravel() for v in np.mgrid[20:60, 30:90])
    place = WhitePlace(x, y, Plane(BALL.middle[None], normal))
    rays = rays_through(None, x, y)
    point = place.plane.seen(rays).point
    assert NEAR.position is not None
    way = NEAR.position - point
    square = (way**2).sum(1)
    signal = (way @ normal) / np.sqrt(square) * ((NEAR.position - BALL.middle) ** 2).sum() / square
    radiance = np.zeros((*SIZE, 3), np.float32)
    radiance[y, x] = signal[:, None] * [0.5, 0.6, 0.7]
    frame = Frame(radiance, np.ones(SIZE, bool), timed=False)
    read = read_white(frame, place, rays, NEAR, BALL.middle, WhiteFactor(0.9 * D65_XYZ))
    assert read is not None
    np.testing.assert_allclose(read.rgb, [0.5, 0.6, 0.7], rtol=1e-5)
    assert (read.std < 1e-5).all()
    clipped = replace(frame, usable=np.zeros(SIZE, bool))
    assert read_white(clipped, place, rays, NEAR, BALL.middle, WhiteFactor(D65_XYZ)) is None


def test_a_shot_without_a_white_takes_its_lamp_s_intensity() -> None:
    power = np.array([1.0, 2.0, 0.5, 1.5])
    lamps = [Lamp(LEAN, None, p * RGB, 0.1, ACROSS) for p in power]
    flat = np.zeros((32, 3))
    readings: list[WhiteReading | None] = [
        WhiteReading(0.3 * p * RGB, np.full(3, 0.01), D65_XYZ, flat, PARTS, np.zeros(2), SIGHT)
        for p in power
    ]
    readings[2] = None
    scale = scale_of(readings, lamps, ["a", "b", "c", "d"])
    np.testing.assert_allclose(scale.rgb, 0.3 * power[:, None] * RGB)
    assert scale.measured.tolist() == [True, True, False, True]
    assert "not read in c" in scale.notes[0]
    assert scale.mean_rgb.max() == 1
    with pytest.raises(InputError, match=r"a … d: the white reference was not found"):
        scale_of([None] * 4, lamps, ["a", "b", "c", "d"])


def test_stains_of_the_white_are_common_and_shadows_are_not() -> None:
    """A pattern in all photographs is one error that all share; what differs between them is each
    one's own: s / √32 of the parts where neighbours are not alike."""
    random = np.random.default_rng(0)
    stains, own = 0.02 * random.normal(size=(32, 3)), 0.005 * random.normal(size=(6, 32, 3))
    readings = [
        WhiteReading(
            0.5 * RGB, np.full(3, 0.01), D65_XYZ, stains + part, 2 * PARTS, np.zeros(2), SIGHT
        )
        for part in own
    ]
    lamps = [Lamp(LEAN, None, RGB, 0.1, ACROSS)] * 6
    scale = scale_of(readings, lamps, list("abcdef"))
    wanted = np.std(stains + own.mean(axis=0), axis=0, ddof=1) / np.sqrt(32)
    np.testing.assert_allclose(scale.common_std, wanted)
    assert np.sqrt((scale.std**2).mean()) == pytest.approx(0.005 / np.sqrt(32), rel=0.15)


@pytest.mark.parametrize("patches", [12, 24])
def test_a_stained_white_s_deviation_is_that_of_its_level(patches: int) -> None:
    """Rationale: over many stained whites the level scatters about what it is in the mean by the
    deviation that each states; stains that are as large as its parts are wrong alike in two."""
    y, x = np.mgrid[21:160, 191:260]
    place = WhitePlace(x.ravel(), y.ravel(), Plane(np.zeros((1, 3)), np.eye(3)[2]))
    rays = rays_through(None, place.x_px, place.y_px)
    lamp = Lamp(np.eye(3)[2], None, RGB, 0.1, ACROSS)
    ratio = []
    for seed in range(150):
        spots = np.random.default_rng(seed).normal(size=(patches, patches))
        rows, columns = np.mgrid[:180, :260] * patches // np.array([180, 260])[:, None, None]
        radiance = (0.5 * (1 + 0.1 * spots[rows, columns]))[..., None] * np.ones(3)
        frame = Frame(radiance.astype(np.float32), np.ones((180, 260), bool), timed=False)
        read = read_white(frame, place, rays, lamp, np.zeros(3), WhiteFactor(D65_XYZ))
        assert read is not None
        ratio.append((read.rgb / 0.5 - 1) / read.std)
    assert 0.8 < np.sqrt(np.mean(np.square(ratio))) < 1.2


def test_a_lamp_that_leans_changes_the_light_on_the_white() -> None:
    """Of a plane: a radian along e changes cos θ = n·l by n·e."""
    flat = np.array([[20.0, -20], [120, -20], [120, -120], [20, -120]])
    corners = np.c_[flat, np.full(4, 50.0)]
    place = WhitePlace(*np.mgrid[40:60, 40:60].reshape(2, -1), Plane(corners, np.eye(3)[2]))
    rays = rays_through(None, place.x_px, place.y_px)
    frame = Frame(np.full((*SIZE, 3), 0.5, np.float32), np.ones(SIZE, bool), timed=False)
    read = read_white(frame, place, rays, FAR, BALL.middle, WhiteFactor(D65_XYZ))
    assert read is not None
    np.testing.assert_allclose(read.lean, np.radians(ACROSS[:, 2] / LEAN[2]), rtol=1e-3)


def of_white(rgb: np.ndarray) -> Scale:
    none = np.zeros(3), np.zeros((1, 2))
    return Scale(
        rgb[None], np.full((1, 3), 0.01), *none, 0.9 * D65_XYZ, np.ones(1, bool), (), (None,)
    )


def test_the_white_comes_out_as_its_own_factor() -> None:
    """And with a linear correction M the slopes are those of R_w · M(u w) / M(w)."""
    matrix = np.array([[0.5, 0.3, 0.1], [0.2, 0.7, 0.1], [0.0, 0.1, 0.9]])
    scale = of_white(np.array([0.8, 1.0, 0.6]))
    correction = ColourCorrection("least squares", matrix)
    given = NodeColour(correction, scale.mean_rgb, scale.xyz, 1.0, ("X", "Y", "Z"))
    np.testing.assert_allclose(given.factors(np.ones((1, 3)))[0], scale.xyz, rtol=1e-6)
    u = np.array([[0.3, 0.5, 0.2], [1.5, 0.1, 0.7], [np.nan, 0.5, 0.5]])
    to_xyz = correction.to_xyz(np.eye(3)).astype(float).T
    white = to_xyz @ scale.mean_rgb
    wanted = scale.xyz * ((u * scale.mean_rgb) @ to_xyz.T) / white
    np.testing.assert_allclose(given.factors(u), wanted, rtol=1e-5)
    slopes = scale.xyz[:, None] * to_xyz * scale.mean_rgb / white[:, None]
    np.testing.assert_allclose(given.slopes(u[:2]), np.broadcast_to(slopes, (2, 3, 3)), rtol=1e-3)
    plain = NodeColour.of(None, scale)
    np.testing.assert_allclose(plain.factors(u)[:2], u[:2] * plain.white)
    # a raw file's own way to sRGB is such a correction
    own = RawColour(np.linalg.inv(xyz_to_rgb_matrix()).T, np.array([2.0, 1.0, 1.6]), "the file")
    by_file = NodeColour.of(None, scale, own)
    assert by_file.channels == ("X", "Y", "Z")
    as_given = ColourCorrection("least squares", np.linalg.inv(xyz_to_rgb_matrix()) @ own.to_srgb)
    same = NodeColour(as_given, scale.mean_rgb, scale.xyz, 0.0, ("X", "Y", "Z"))
    np.testing.assert_allclose(by_file.factors(u), same.factors(u))
    np.testing.assert_allclose(by_file.factors(np.ones((1, 3)))[0], scale.xyz, rtol=1e-6)
    # the white's RGB is that of 0.9 D65: neutral
    np.testing.assert_allclose(plain.white, 90, rtol=1e-3)


def test_a_colour_difference_as_lightness() -> None:
    """dY/Y of one ΔE/√3 of lightness, against colour-science's L*."""
    luminance = np.array([5.0, 20.0, 60.0, 100.0])
    found = relative_colour(luminance, 2.0)
    step = 1e-4
    slope = (
        colour_science.lightness(luminance * (1 + step))
        - colour_science.lightness(luminance * (1 - step))
    ) / (2 * step)
    np.testing.assert_allclose(found, 2.0 / np.sqrt(3) / slope, rtol=1e-4)


def photographed(dx: float, dy: float) -> np.ndarray:
    """`[H, W, 3]` an evenly bright ball that moved, on a dark ground."""
    y, x = np.mgrid[: SIZE[0], : SIZE[1]]
    share = np.clip(50.5 - np.hypot(x - 80 - dx, y - 70 - dy), 0, 1)
    return np.repeat((0.01 + 0.5 * share)[..., None], 3, 2).astype(np.float32)


def test_the_photograph_in_which_the_sample_moved_and_by_how_much() -> None:
    outline = outline_of(seen_ball(Sphere(BALL.centre, 48.0)), SIZE)
    away = outline.points - [80, 70]
    radial = away / np.linalg.norm(away, axis=1, keepdims=True)
    assert (np.abs((outline.normals * radial).sum(1)) > 0.95).mean() > 0.95
    shifts = [(0, 0), (0.2, 0), (0, 0), (0, -0.3), (3.0, -4.0)]
    edges = [edges_near(photographed(*by), outline) for by in shifts]
    names = [f"p{k}.png" for k in range(5)]
    text = moved(edges, names)
    assert text is not None
    assert text.startswith("p4.png: the sample moved: its outline lies ")
    assert abs(float(text.split("lies ")[1].split()[0]) - 5) < 0.25
    assert moved(edges[:4], names[:4]) is None
    assert moved(edges[3:], names[3:]) is None  # two photographs do not say which
    assert edges_near(np.full((*SIZE, 3), 0.5, np.float32), outline) is None


@pytest.mark.parametrize("factor", [1.0, 1.2])
def test_a_shot_that_is_brighter_in_all_cells(factor: float) -> None:
    grid, random = CellGrid(10.0), np.random.default_rng(0)
    kept = Reservoir.of(grid.cells)
    cells = np.repeat(np.arange(200, 300), 10)
    for k in range(8):
        level = factor if k == 2 else 1.0
        y = level * (1 + 0.01 * random.normal(size=(len(cells), 3)))
        x = (random.random((len(cells), 3)) - 0.5).astype(np.float32)
        kept.add(cells, k, x, y.astype(np.float32), np.zeros(len(cells), np.intp))
    none = np.zeros(3), np.zeros((8, 2))
    scale = Scale(
        np.ones((8, 3)), np.full((8, 3), 0.005), *none, D65_XYZ, np.ones(8, bool), (), (None,) * 8
    )
    found = agreement(kept, robust_fit(kept, grid), scale, np.zeros(len(kept.cell)))
    assert (found.cells == 100).all()
    said = found.contradiction(list("abcdefgh"))
    if factor == 1:
        assert said is None
        assert (np.abs(found.brighter) < 0.02).all()
    else:
        assert said is not None
        assert said.startswith("c: it contradicts")
        assert "brighter by" in said
        assert found.brighter[2] == pytest.approx(0.2, abs=0.05)


@pytest.mark.parametrize(("own", "upside_down"), [(1, False), (3, True), (None, False)])
def test_a_camera_says_how_its_photographs_are_turned(
    tmp_path: Path, own: int | None, upside_down: bool
) -> None:
    """The phone guesses another orientation than when the board was photographed. Without EXIF a
    photograph stays as it is, and without a pose it is as its file says."""
    stored = np.arange(24 * 32 * 3, dtype=np.uint8).reshape(24, 32, 3)
    exif = Image.Exif()
    if own is not None:
        exif[274] = own
    Image.fromarray(stored).save(tmp_path / "a.png", exif=exif)
    write_lights(tmp_path / "l.json", LEAN[None], np.ones(1))
    content = {
        **{"format": "raden capture", "version": 1, "kind": "camera", "distortion": [0.0] * 5},
        **{"image_width_px": 32, "image_height_px": 24, "orientation": 1},
        "camera_matrix_px": np.diag([40.0, 40, 1]).tolist(),
    }
    pose = {
        **{"file": "b.png", "corners": 24, "reprojection_rms_px": 0.1},
        "rotation_board_to_camera": np.eye(3).tolist(),
        "translation_board_to_camera_m": [0, 0, 1],
    }
    board = {"columns": 5, "rows": 7, "square_m": 0.04, "marker_m": 0.02}
    board |= {"dictionary": "DICT_6X6_250", "legacy": False}
    camera = tmp_path / "camera.json"
    way = Development(coded="linear")
    setup = CaptureSetup(tmp_path / "l.json", camera=camera, development=way)
    for more in ({"board": board, "poses": [pose]}, {}):
        camera.write_text(json.dumps(content | more))
        (shot,) = read_series([tmp_path / "a.png"], setup).shots
        check_masks([shot], (None, None))
        refused = pytest.raises(InputError, match=r"m\.png: expected a mask beside photographs")
        with refused if upside_down and more else nullcontext():
            check_masks([shot], (None, tmp_path / "m.png"))
        turned = stored[::-1, ::-1] if upside_down and not more else stored
        np.testing.assert_allclose(read_frame(shot).radiance, turned / 255, atol=1e-6)
        # lamps are turned as the photographs were that showed them
        lights = json.loads((tmp_path / "l.json").read_text("utf-8"))
        (tmp_path / "t.json").write_text(json.dumps(lights | {"orientation": 1}))
        refused = pytest.raises(InputError, match=r"expected 1, as .* gave .*t\.json, got 3")
        with refused if upside_down and not more else nullcontext():
            read_series([tmp_path / "a.png"], replace(setup, lights=tmp_path / "t.json"))
