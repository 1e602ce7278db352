"""What rays see of a sphere, a plane and a cylinder, by the shapes' own equations and OpenCV."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from raden_torch.capture.photo.brdf.board_region import board_pixels, board_plane
from raden_torch.capture.photo.brdf.cylinder_axis import rod_from_mask, rod_on_board
from raden_torch.capture.photo.brdf.pixel_regions import eroded, polygon_pixels
from raden_torch.capture.photo.brdf.rays import Rays, projected, rays_through, undistorted
from raden_torch.capture.photo.brdf.sample_shapes import Cylinder, Plane, Shape, Sphere
from raden_torch.capture.photo.camera import Camera, Pose
from raden_torch.errors import InputError

SIZE = (480, 640)
MATRIX = np.array([[800.0, 0, 320], [0, 790, 235], [0, 0, 1]])
CAMERA = Camera(MATRIX, np.array([-0.2, 0.08, 0.001, -0.002, 0.0]), SIZE)
STRAIGHT = Camera(MATRIX, np.zeros(5), SIZE)
TILTED = Pose(cv2.Rodrigues(np.array([0.4, -0.3, 0.2]))[0], np.array([-0.05, -0.04, 0.4]), 0.1, 24)
AXIS = np.array([0.8, 0.6, 0.0])
SHAPES: dict[str, Shape] = {
    "sphere": Sphere(np.array([5.0, -8.0, -400.0]), 60.0),
    "plane": Plane(
        np.array([[-50.0, -50, -400], [50, -50, -400], [50, 50, -400], [-50, 50, -400]]),
        np.array([0.0, 0.0, 1.0]),
    ),
    "cylinder": Cylinder(np.array([-40.0, -30.0, -400.0]), AXIS, 25.0, (0.0, 100.0)),
}
AREA = {"sphere": 4 * np.pi * 60**2, "plane": 100.0**2, "cylinder": 2 * np.pi * 25 * 100}


def off_surface(name: str, point: np.ndarray) -> np.ndarray:
    """How far points lie from the shape, by its equation."""
    shape = SHAPES[name]
    if isinstance(shape, Sphere):
        return np.linalg.norm(point - shape.centre, axis=1) - shape.radius
    if isinstance(shape, Plane):
        return (point - shape.corners[0]) @ shape.normal
    assert isinstance(shape, Cylinder)
    return np.linalg.norm(np.cross(point - shape.point, shape.axis), axis=1) - shape.radius


def pixels(count: int = 4000) -> np.ndarray:
    random = np.random.default_rng(0)
    return random.random((count, 2)) * [SIZE[1] - 1, SIZE[0] - 1]


def test_a_pixel_s_ray_ends_at_that_pixel() -> None:
    """OpenCV's projection of points on the rays, through the lens with its distortion."""
    place = pixels()
    rays = rays_through(CAMERA, *place.T)
    np.testing.assert_allclose(np.linalg.norm(rays.direction, axis=1), 1, atol=1e-12)
    points = 300 * rays.direction * [1, -1, -1]  # OpenCV's frame
    back, _ = cv2.projectPoints(points, np.zeros(3), np.zeros(3), MATRIX, CAMERA.distortion)
    np.testing.assert_allclose(back.reshape(-1, 2), place, atol=1e-5)
    np.testing.assert_allclose(projected(CAMERA, 300 * rays.direction), place, atol=1e-5)
    flat = undistorted(STRAIGHT, place)
    np.testing.assert_allclose(flat, (place - [320, 235]) / [800, 790], atol=1e-12)


def test_without_a_camera_rays_are_parallel() -> None:
    rays = rays_through(None, [3.0, 4.0], [5.0, 6.0])
    assert rays.start.tolist() == [[3, -5, 0], [4, -6, 0]]
    assert rays.direction.tolist() == [[0, 0, -1], [0, 0, -1]]
    assert projected(None, rays.start).tolist() == [[3, 5], [4, 6]]


@pytest.mark.parametrize("name", SHAPES)
@pytest.mark.parametrize("camera", [CAMERA, None], ids=["near", "far"])
def test_a_ray_meets_the_near_side(name: str, camera: Camera | None) -> None:
    """Points lie on the shape, on the ray, before the far side; normals are unit and face back."""
    place = pixels() if camera else pixels() / [SIZE[1], SIZE[0]] * 300 - 150
    rays = rays_through(camera, *place.T)
    seen = SHAPES[name].seen(rays)
    hit = np.isfinite(seen.normal).all(axis=1)
    assert hit.sum() > 20
    point, normal = seen.point[hit], seen.normal[hit]
    start, direction = rays.start[hit], rays.direction[hit]
    np.testing.assert_allclose(off_surface(name, point), 0, atol=1e-6)
    across = np.cross(point - start, direction)
    np.testing.assert_allclose(across, 0, atol=1e-6)
    np.testing.assert_allclose(np.linalg.norm(normal, axis=1), 1, atol=1e-9)
    assert ((normal * direction).sum(1) < 0).all()
    # the normal is the gradient of the shape's equation
    step = 1e-3
    for axis in range(3):
        moved = step * np.eye(3)[axis]
        slope = (off_surface(name, point + moved) - off_surface(name, point - moved)) / (2 * step)
        np.testing.assert_allclose(normal[:, axis], slope, atol=1e-6)


@pytest.mark.parametrize("name", SHAPES)
def test_spread_points_have_the_whole_area(name: str) -> None:
    surface, area = SHAPES[name].spread(4000)
    assert 2000 < len(surface) < 4400
    np.testing.assert_allclose(area.sum(), AREA[name], rtol=0.02)
    np.testing.assert_allclose(off_surface(name, surface.point), 0, atol=1e-9)
    assert abs(off_surface(name, SHAPES[name].middle[None])[0]) < 1e-9


def test_a_place_on_the_board_is_where_opencv_draws_it() -> None:
    corners = np.array([[0.01, 0.02], [0.11, 0.02], [0.11, 0.08], [0.01, 0.08]])
    inside = board_pixels(corners, CAMERA, TILTED, SIZE, "a.png")
    plane = board_plane(corners, TILTED)
    y, x = np.nonzero(np.ones(SIZE, bool))
    scene = plane.seen(rays_through(CAMERA, x, y)).point * [1, -1, -1] / 1000
    on_board = (scene - TILTED.translation_m) @ TILTED.rotation
    np.testing.assert_allclose(on_board[:, 2], 0, atol=1e-9)
    low, high = corners.min(0), corners.max(0)
    wanted = ((on_board[:, :2] > low) & (on_board[:, :2] < high)).all(axis=1).reshape(SIZE)
    assert wanted.sum() > 10_000
    clear = eroded(~wanted) | eroded(wanted)  # away from the outline
    np.testing.assert_array_equal(inside[clear], wanted[clear])
    behind = Pose(TILTED.rotation, np.array([0.0, 0.0, -0.4]), 0.1, 24)
    with pytest.raises(InputError, match=r"a\.png: the place on the board lies behind the camera"):
        board_pixels(corners, CAMERA, behind, SIZE, "a.png")
    with pytest.raises(InputError, match="needs a camera file"):
        board_pixels(corners, None, TILTED, SIZE, "a.png")


def test_a_polygon_and_what_is_left_inside_its_edge() -> None:
    square = np.array([[9.5, 9.5], [30.5, 9.5], [30.5, 20.5], [9.5, 20.5]])
    drawn = polygon_pixels(square, (40, 50))
    inside = np.zeros((40, 50), bool)
    inside[10:21, 10:31] = True
    assert (drawn & inside).sum() == inside.sum()
    assert drawn.sum() <= 13 * 23
    kept = eroded(inside, 2)
    assert kept.sum() == 7 * 17
    assert kept[12:19, 12:29].all()
    assert not eroded(np.ones((10, 10), bool), 2)[[0, 1, -1], :].any()  # nor beside the frame


@pytest.mark.parametrize("camera", [CAMERA, None], ids=["near", "far"])
def test_a_rod_is_found_by_its_edges(camera: Camera | None) -> None:
    """A mask drawn by the rays that meet it gives its axis back."""
    y, x = (v.ravel() for v in np.mgrid[: SIZE[0], : SIZE[1]])
    rod = Cylinder(np.array([-40.0, -30.0, -400.0]), AXIS, 25.0, (0.0, 100.0))
    if camera is None:
        rod = Cylinder(np.array([240.0, -300.0, 0.0]), AXIS, 40.0, (0.0, 200.0))
    seen = rod.seen(rays_through(camera, x, y))
    along = (seen.point - rod.point) @ rod.axis
    with np.errstate(invalid="ignore"):
        on = np.isfinite(along) & (along > rod.reach[0]) & (along < rod.reach[1])
    mask = on.reshape(SIZE).astype(np.float32)
    radius = None if camera is None else rod.radius
    found, std_px = rod_from_mask(mask, camera, radius, "rod.png")
    assert 0.1 < std_px < 0.15  # its edges cross many rows
    axis = found.axis * np.sign(found.axis @ rod.axis)
    assert np.degrees(np.arccos(min(1.0, axis @ rod.axis))) < 0.3
    assert abs(found.radius / rod.radius - 1) < 0.02
    apart = np.cross(found.point - rod.point, rod.axis)
    if camera is None:
        apart = apart[2:]  # depth is not known
    assert np.linalg.norm(apart) < (2.5 if camera else 0.7)


def test_a_rod_whose_ends_look_round() -> None:
    """Seen from near its end its outline is an ellipse's there, which is no part of its edges."""
    y, x = (v.ravel() for v in np.mgrid[: SIZE[0], : SIZE[1]])
    for up in np.linspace(-0.06, 0.06, 7):
        axis = np.array([0.8, up, 0.6]) / np.linalg.norm([0.8, up, 0.6])
        rod = Cylinder(np.array([-60.0, 0.0, -380.0]), axis, 25.0, (0.0, 110.0))
        seen = rod.seen(rays_through(STRAIGHT, x, y))
        along = (seen.point - rod.point) @ rod.axis
        with np.errstate(invalid="ignore"):
            on = np.isfinite(along) & (along > rod.reach[0]) & (along < rod.reach[1])
        found, _ = rod_from_mask(on.reshape(SIZE).astype(np.float32), STRAIGHT, 25.0, "rod.png")
        axis = found.axis * np.sign(found.axis @ rod.axis)
        assert np.degrees(np.arccos(min(1.0, axis @ rod.axis))) < 1.5


def test_an_edge_along_a_row_is_known_worse() -> None:
    """Than one that crosses rows; 1/√12 of a pixel, where it may lie in it."""
    y, x = (v.ravel() for v in np.mgrid[: SIZE[0], : SIZE[1]])
    stds = []
    for turn in (0.0, 0.2):
        axis = np.array([np.cos(turn), np.sin(turn), 0.0])
        rod = Cylinder(np.array([200.0, -240.0, 0.0]), axis, 40.0, (0.0, 200.0))
        along = (rod.seen(rays_through(None, x, y)).point - rod.point) @ rod.axis
        with np.errstate(invalid="ignore"):
            on = (along > 0) & (along < 200)
        stds.append(rod_from_mask(on.reshape(SIZE).astype(np.float32), None, None, "rod.png")[1])
    assert stds[0] == pytest.approx(np.hypot(0.1, 1 / np.sqrt(12)), abs=0.002)
    assert 0.1 < stds[1] < 0.12


def test_a_rod_that_lies_on_the_board() -> None:
    ends = np.array([[0.02, 0.05], [0.10, 0.05]])
    rod = rod_on_board(ends, 8.0, TILTED, CAMERA, "a.png")
    board = (rod.point * [1, -1, -1] / 1000 - TILTED.translation_m) @ TILTED.rotation
    np.testing.assert_allclose(board, [0.02, 0.05, -0.008], atol=1e-12)
    other = rod.point + rod.reach[1] * rod.axis
    board = (other * [1, -1, -1] / 1000 - TILTED.translation_m) @ TILTED.rotation
    np.testing.assert_allclose(board, [0.10, 0.05, -0.008], atol=1e-12)
    with pytest.raises(InputError, match="two different points"):
        rod_on_board(ends[[0, 0]], 8.0, TILTED, CAMERA, "a.png")


def test_a_ray_beside_the_shape_sees_nothing() -> None:
    beside = Rays(np.array([[500.0, 500.0, 0.0]]), np.array([[0.0, 0.0, -1.0]]))
    assert np.isnan(SHAPES["sphere"].seen(beside).normal).all()
    assert np.isnan(SHAPES["cylinder"].seen(beside).normal).all()
    back = Rays(np.zeros((1, 3)), np.array([[0.0, 0.0, 1.0]]))
    assert np.isnan(SHAPES["plane"].seen(back).point).all()
