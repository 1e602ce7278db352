"""Simulated photographs of a sphere, a plane and a cylinder of analytic BRDF: a small ray caster of
its own, in NumPy, without the package's geometry. Frame: x right, y up, z to the viewer."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from raden_torch.capture.photo.brdf.photo_cells import CellGrid
from raden_torch.capture.photo.capture_brdf import CapturedBrdf, capture_brdf

Array = np.ndarray
Y_DOWN = np.array([1.0, -1.0, -1.0])


def unit(v: Array) -> Array:
    return v / np.linalg.norm(v, axis=-1, keepdims=True)


def shell(normal: Array, light: Array, view: Array, width: float = 0.12) -> Array:
    """`[P, 3]` f_r in 1/sr of a simulated shell: a matt body, and a coloured lobe around the
    mirror, isotropic and reciprocal."""
    half = unit(light + view)
    miss = np.linalg.norm(np.cross(normal, half), axis=1)
    lobe = np.exp(-((miss / width) ** 2) / 2)
    bend = np.arctan2(np.linalg.norm(np.cross(light, view), axis=1), (light * view).sum(1))
    colour = 1 + 0.5 * np.cos(bend[:, None] * 2 + np.array([0.0, 1.5, 3.0]))
    return (np.array([0.3, 0.35, 0.32]) + 0.9 * lobe[:, None] * colour) / np.pi


def node_truth(nodes_deg: Array, brdf: Callable[..., Array] = shell) -> Array:
    """`[M, 3]` reflectance factors at raden angles: N is z; L and V lie in a plane that leans by
    the tilt, on either side of N's projection."""
    a, r, t = np.radians(nodes_deg).T
    light = np.stack([-np.sin(a), -np.cos(a) * np.sin(t), np.cos(a) * np.cos(t)], 1)
    view = np.stack([np.sin(r), -np.cos(r) * np.sin(t), np.cos(r) * np.cos(t)], 1)
    normal = np.broadcast_to([0.0, 0.0, 1.0], light.shape)
    return 100 * np.pi * brdf(normal, light, view)


def lamp_ring(count: int, seed: int = 0) -> Array:
    """`[count, 3]` directions from 10 to 115 degrees off the camera's axis, on all sides."""
    k = np.arange(count)
    away = np.radians(10 + 105 * (k + 0.5) / count)
    turn = 2.4 * k + seed
    return np.stack([np.sin(away) * np.cos(turn), np.sin(away) * np.sin(turn), np.cos(away)], 1)


def lamp_triples(*away_deg: float) -> Array:
    """`[3 n, 3]`: three lamps at each angle off the camera's axis. A far lamp and a far camera fill
    the cells of one a + r alone, so that only lamps at like angles see the same cells."""
    away = np.radians(np.repeat(away_deg, 3))
    turn = 2.4 * np.arange(len(away))
    return np.stack([np.sin(away) * np.cos(turn), np.sin(away) * np.sin(turn), np.cos(away)], 1)


def anywhere(lamps: Array, seed: int, by_deg: float = 2.5) -> Array:
    """Lamps moved by up to so much away from the camera's axis, and turned about it: where they
    stand on no node of the grid, as in no laboratory."""
    random = np.random.default_rng([seed, 2])
    away = np.arccos(lamps[:, 2]) + np.radians(random.uniform(-by_deg, by_deg, len(lamps)))
    turn = np.arctan2(lamps[:, 1], lamps[:, 0]) + random.uniform(0, 2 * np.pi)
    return np.stack([np.sin(away) * np.cos(turn), np.sin(away) * np.sin(turn), np.cos(away)], 1)


@dataclass
class Series:
    """Simulated photographs in a folder, with the files of the earlier steps."""

    folder: Path
    photos: list[Path]
    lights: Path
    mask: Path
    white: Path
    lamps: Array
    extra: dict[str, object] = field(default_factory=dict)


def write_lights(
    path: Path, direction: Array, intensity: Array, position: Array | None = None, unit_: str = "px"
) -> None:
    rows = [
        {"photograph": f"ball{k}.png", "direction_to_lamp": d.tolist(), "intensity": float(i)}
        | ({} if position is None else {f"position_{unit_}": position[k].tolist()})
        for k, (d, i) in enumerate(zip(direction, intensity, strict=True))
    ]
    content = {"format": "raden capture", "version": 1, "kind": "lights", "made_from": []}
    content |= {"unit": unit_, "response_exponent": 1.0, "lamps": rows}
    path.write_text(json.dumps(content))


def write_photo(path: Path, linear: Array) -> None:
    stored = np.clip(np.rint(linear * 65535), 0, 65535).astype(np.uint16)
    cv2.imwrite(str(path), stored[..., ::-1])


def sphere_photographs(
    folder: Path,
    count: int = 12,
    *,
    radius: float = 150.0,
    near: float | None = None,
    noise: float = 0.002,
    outliers: float = 0.0,
    brdf: Callable[..., Array] = shell,
    lamps: Array | None = None,
    power: Array | None = None,
    exposure: float = 0.25,
    moved: dict[int, tuple[float, float]] | None = None,
    sample_only: dict[int, float] | None = None,
    wrong_lamp: dict[int, float] | None = None,
    lamp_error_deg: float = 0.0,
    outline_error_px: float = 0.0,
    stains: float = 0.0,
    seed: int = 0,
) -> Series:
    """Photographs of a sphere by a far camera; beside it a white card faces the camera."""
    random = np.random.default_rng(seed)
    side = int(2 * radius + 60)
    size = side, side + 80
    centre = np.array([side / 2 + 0.3, side / 2 - 0.2])
    y, x = np.mgrid[: size[0], : size[1]].astype(float)
    # of the white, by patches of a twelfth of it: the same in all photographs
    patches = np.random.default_rng([seed, 1]).normal(size=(12, 12))
    spots = cv2.resize(patches, size[::-1], interpolation=cv2.INTER_NEAREST)
    direction = lamp_ring(count) if lamps is None else lamps
    count = len(direction)
    power = np.ones(count) if power is None else power
    middle = np.array([centre[0], -centre[1], radius])
    position = None if near is None else middle + near * radius * direction
    photos = []
    for k in range(count):
        shift = (moved or {}).get(k, (0.0, 0.0))
        dx, dy = x - centre[0] - shift[0], -(y - centre[1] - shift[1])
        z = np.sqrt(np.clip(radius**2 - dx**2 - dy**2, 0, None))
        on = z > 0
        point = np.stack([dx + centre[0], dy - centre[1], z], -1)
        card = (x > side + 10) & (y > 20) & (y < side - 20)
        linear = np.full((*size, 3), 0.004)
        for where, normal in ((on, np.stack([dx, dy, z], -1) / radius), (card, None)):
            p = point[where] if normal is not None else np.stack([x, -y, 0 * x + radius], -1)[where]
            n = normal[where] if normal is not None else np.broadcast_to([0.0, 0, 1], p.shape)
            to = np.broadcast_to(direction[k], p.shape)
            fall = np.ones(len(p))
            if position is not None:
                to = position[k] - p
                fall = ((position[k] - middle) ** 2).sum() / (to**2).sum(1)
                to = unit(to)
            lit = np.clip((n * to).sum(1), 0, None) * fall * power[k]
            view = np.broadcast_to([0.0, 0, 1], p.shape)
            f = np.full((len(p), 3), 0.9 / np.pi)
            if normal is not None:
                f = brdf(n, to, view) * (sample_only or {}).get(k, 1.0)
            linear[where] = np.pi * f * lit[:, None] * exposure
        linear[card] *= 1 + stains * spots[card][:, None]
        linear = cv2.GaussianBlur(linear, (0, 0), 0.5)
        linear = linear + noise * np.sqrt(linear + 0.01) * random.normal(size=linear.shape)
        if outliers:
            bad = random.random(size) < outliers
            linear[bad] = random.choice([0.0, 0.9], bad.sum())[:, None]
        photos.append(folder / f"photo{k}.png")
        write_photo(photos[-1], linear)
    lean = np.radians(lamp_error_deg) * random.normal(size=direction.shape)
    said = unit(direction + lean)
    for k, degrees in (wrong_lamp or {}).items():  # turned about the camera's axis
        c, d = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
        said[k] = np.array([[c, -d, 0], [d, c, 0], [0, 0, 1]]) @ said[k]
    reach = None if position is None else middle + near * radius * said
    write_lights(folder / "lights.json", said, power / power.mean(), reach)
    off = outline_error_px * random.normal(size=3)
    on = np.hypot(x - centre[0] - off[0], y - centre[1] - off[1]) < radius + off[2]
    cv2.imwrite(str(folder / "mask.png"), 255 * on.astype(np.uint8))
    card = (x > side + 10) & (y > 20) & (y < side - 20)
    cv2.imwrite(str(folder / "white.png"), 255 * card.astype(np.uint8))
    return Series(
        folder, photos, folder / "lights.json", folder / "mask.png", folder / "white.png",
        direction,
    )  # fmt: skip


@pytest.fixture
def sphere_series(tmp_path: Path) -> Callable[..., Series]:
    """`sphere_photographs` in a folder of this name."""

    def make(count: int = 12, *, name: str = "s", **options: Any) -> Series:
        (tmp_path / name).mkdir(exist_ok=True)
        return sphere_photographs(tmp_path / name, count, **options)

    return make


def sphere_setup(series: Series) -> dict[str, object]:
    """The arguments of `capture_brdf` for such a series."""
    from raden_torch.capture.photo.brdf.capture_settings import CaptureSetup, SampleSpec, WhiteSpec
    from raden_torch.capture.photo.brdf.photo_white import WhiteFactor
    from raden_torch.capture.photo.development import Development
    from raden_torch.colorimetry import D65_XYZ

    return {
        "photographs": series.photos,
        "setup": CaptureSetup(series.lights, development=Development("linear"), lamp_std_deg=0.1),
        "sample": SampleSpec("sphere", series.mask),
        "white": WhiteSpec(series.white),
        "factor": WhiteFactor(0.9 * D65_XYZ),
    }


CAMERA_PX = np.array([[900.0, 0, 319.5], [0, 900.0, 239.5], [0, 0, 1.0]])
SIZE = (480, 640)
FLAT_M = np.array([[0.02, 0.02], [0.12, 0.02], [0.12, 0.10], [0.02, 0.10]])
WHITE_M = np.array([[0.13, 0.02], [0.16, 0.02], [0.16, 0.10], [0.13, 0.10]])
ROD_M = np.array([[0.02, 0.06], [0.12, 0.06]])
ROD_RADIUS_M = 0.02


def looking(azimuth_deg: float, away_deg: float, distance_m: float) -> tuple[Array, Array]:
    """A camera's pose (board to OpenCV's camera) that looks at the board's middle from `away_deg`
    off its normal."""
    turn, away = np.radians(azimuth_deg), np.radians(away_deg)
    middle = np.array([0.09, 0.06, 0.0])
    place = middle + distance_m * np.array(
        [np.sin(away) * np.cos(turn), np.sin(away) * np.sin(turn), -np.cos(away)]
    )
    forward = unit(middle - place)
    right = unit(np.cross(np.array([0.0, 1.0, 0.02]), forward))
    rotation = np.stack([right, np.cross(forward, right), forward])
    return rotation, -rotation @ place


BOARD = {"columns": 15, "rows": 10, "square_m": 0.012, "marker_m": 0.008}
BOARD |= {"dictionary": "DICT_6X6_250", "legacy": False}


def on_rod(start: Array, ray: Array, edges: Array | None = None) -> tuple[Array, Array]:
    """Which rays from `start` meet the rod, and where: the circle y = 0.06, z = −r, from x = 0.02
    to 0.12 m.

    Args:
        edges: `[2, 2]` of each edge, metres by which it lies aside, and by which its end does more.
    """
    o = start[1:] - [0.06, -ROD_RADIUS_M]
    d = ray[:, 1:]
    square = (d**2).sum(1)
    nearest = -(d @ o) / square
    x = start[0] + nearest * ray[:, 0]
    aside, radius = np.zeros(len(ray)), ROD_RADIUS_M
    if edges is not None:
        far, near = (edge[0] + edge[1] * (x - 0.07) / 0.05 for edge in edges)
        aside, radius = (far + near) / 2, ROD_RADIUS_M + (far - near) / 2
    b, c = d @ o - d[:, 0] * aside, (o[0] - aside) ** 2 + o[1] ** 2 - radius**2
    depth = b**2 - square * c
    on = start + ((-b - np.sqrt(np.clip(depth, 0, None))) / square)[:, None] * ray
    return (depth > 0) & (on[:, 0] > 0.02) & (on[:, 0] < 0.12), on


def pose_entry(file: str, rotation: Array, shift: Array, **more: object) -> dict[str, object]:
    """Of a camera file."""
    return {
        "file": file,
        "corners": 24,
        "reprojection_rms_px": 0.2,
        "rotation_board_to_camera": rotation.tolist(),
        "translation_board_to_camera_m": shift.tolist(),
    } | more


def found_pose(
    file: str, rotation: Array, shift: Array, free: Array, error_px: float, random: Any
) -> dict[str, object]:
    """The same, as the board's corners say that lie where the picture is `free`, each off by
    `error_px` at random."""
    from raden_torch.capture.photo.board import Board, BoardView
    from raden_torch.capture.photo.board_pose import board_pose
    from raden_torch.capture.photo.camera import Camera

    board = Board(**BOARD)
    seen = (board.corners_m @ rotation.T + shift) @ CAMERA_PX.T
    pixels = seen[:, :2] / seen[:, 2:]
    x, y = np.rint(pixels).astype(int).T
    there = (x >= 0) & (y >= 0) & (x < SIZE[1]) & (y < SIZE[0])
    there[there] = free[y[there], x[there]]
    ids = np.flatnonzero(there).astype(np.int32)
    off = error_px * random.normal(size=(len(ids), 2))
    pose = board_pose(
        BoardView(file, SIZE, board, ids, pixels[ids] + off),
        Camera(CAMERA_PX, np.zeros(5), SIZE),
    )
    assert pose.covariance is not None
    known = {"turn_and_translation_covariance": pose.covariance.tolist()}
    return pose_entry(file, pose.rotation, pose.translation_m, **known)


def board_photographs(
    folder: Path,
    lamps_m: Array,
    poses: list[tuple[float, float]],
    *,
    rod: bool = False,
    noise: float = 0.001,
    brdf: Callable[..., Array] = shell,
    seed: int = 0,
    distance_m: float = 0.35,
    exposure: float = 0.2,
    lamp_error_deg: float = 0.0,
    corner_error_px: float = 0.0,
    edge_error_px: float = 0.0,
) -> Series:
    """Photographs of a flat sample, or of a rod, on a board with a white field; near lamps that
    stand beside the board; the camera moves (`poses`: azimuth, away from the normal, degrees).

    Args:
        lamp_error_deg: by which the lamps lean from where the lights file says.
        corner_error_px: of the board's corners, by which its poses are found; 0: they are known.
        edge_error_px: of the two edges of the rod's mask, and of their ends.
    """
    random = np.random.default_rng(seed)
    drawn = np.random.default_rng([seed, 3])
    edges = edge_error_px * drawn.normal(size=(2, 2)) * distance_m / CAMERA_PX[0, 0]
    y, x = np.mgrid[: SIZE[0], : SIZE[1]].astype(float)
    photos, entries, mask = [], [], np.zeros(SIZE, bool)
    for k, (lamp, (turn, away)) in enumerate(zip(lamps_m, poses, strict=True)):
        rotation, shift = looking(turn, away, distance_m)
        ray = np.stack([(x - 319.5) / 900, (y - 239.5) / 900, np.ones_like(x)], -1)
        ray = unit(ray.reshape(-1, 3)) @ rotation
        start = -rotation.T @ shift
        point = start + (-start[2] / ray[:, 2])[:, None] * ray
        normal = np.broadcast_to([0.0, 0.0, -1.0], point.shape).copy()
        inside = [
            ((point[:, :2] > c.min(0)) & (point[:, :2] < c.max(0))).all(1)
            for c in (FLAT_M, WHITE_M)
        ]
        if rod:
            hit, on = on_rod(start, ray)
            point[hit] = on[hit]
            normal[hit] = unit((on - [0, 0.06, -ROD_RADIUS_M]) * [0, 1, 1])[hit]
            inside = [hit, inside[1] & ~hit]
            mask |= on_rod(start, ray, edges)[0].reshape(SIZE)
        to = lamp - point
        fall = 0.09 / (to**2).sum(1)
        to = unit(to)
        lit = np.clip((normal * to).sum(1), 0, None) * fall
        f = np.full((len(point), 3), 0.1 / np.pi)
        f[inside[0]] = brdf(normal[inside[0]], to[inside[0]], -ray[inside[0]])
        f[inside[1]] = 0.9 / np.pi
        linear = (exposure * np.pi * f * lit[:, None]).reshape(*SIZE, 3)
        linear = cv2.GaussianBlur(linear, (0, 0), 0.5)
        linear += noise * np.sqrt(np.abs(linear) + 0.01) * random.normal(size=linear.shape)
        photos.append(folder / f"photo{k}.png")
        write_photo(photos[-1], linear)
        if corner_error_px == 0:
            entries.append(pose_entry(photos[-1].name, rotation, shift))
        elif k == 0 or poses[k] != poses[k - 1]:  # else the camera stands still: one pose serves
            free = ~(inside[0] | inside[1]).reshape(SIZE)
            entries.append(
                found_pose(photos[-1].name, rotation, shift, free, corner_error_px, drawn)
            )
    camera = {"format": "raden capture", "version": 1, "kind": "camera", "made_from": []}
    camera |= {"camera_matrix_px": CAMERA_PX.tolist(), "distortion": [0.0] * 5}
    camera |= {"image_width_px": SIZE[1], "image_height_px": SIZE[0]}
    camera |= {"board": BOARD}
    (folder / "camera.json").write_text(json.dumps(camera | {"poses": entries}))
    rotation, shift = looking(*poses[0], distance_m)
    position = 1000 * (lamps_m @ rotation.T + shift) * Y_DOWN
    middle = 1000 * (rotation @ np.array([0.07, 0.06, 0.0]) + shift) * Y_DOWN
    # relative irradiance at the sample's middle: of equal lamps, by their distance
    power = 1 / ((position - middle) ** 2).sum(1)
    away = np.linalg.norm(position - middle, axis=1, keepdims=True)
    said = unit(position - middle)
    said = unit(said + np.radians(lamp_error_deg) * drawn.normal(size=said.shape))
    write_lights(folder / "lights.json", said, power / power.mean(), middle + away * said, "mm")
    cv2.imwrite(str(folder / "mask.png"), 255 * mask.astype(np.uint8))
    return Series(
        folder, photos, folder / "lights.json", folder / "mask.png", folder / "none.png",
        lamps_m, {"camera": folder / "camera.json"},
    )  # fmt: skip


@pytest.fixture
def board_series(tmp_path: Path) -> Callable[..., Series]:
    """`board_photographs` in a folder of this name."""

    def make(*args: object, name: str = "b", **options: object) -> Series:
        (tmp_path / name).mkdir()
        return board_photographs(tmp_path / name, *args, **options)

    return make


def planned_places(stances: Any, top: Array) -> tuple[Array, list[tuple[float, float]]]:
    """Lamps and poses of `board_photographs` by a plan of `raden capture guide`: the piece's middle
    stands at `top` on the board, whose y runs down its columns and z into it."""
    flip = np.array([1.0, -1.0, -1.0])
    lamps = np.array([top + np.array(s.lamp_mm) * flip / 1000 for s in stances])
    poses = []
    for stance in stances:
        x, y, z = np.array(stance.camera_mm) * flip
        poses.append(
            (float(np.degrees(np.arctan2(y, x))), float(np.degrees(np.arctan2(np.hypot(x, y), -z))))
        )
    return lamps, poses


def board_setup(series: Series, *, rod: bool = False, axis: bool = True) -> dict[str, object]:
    """The arguments of `capture_brdf` for such a series."""
    from raden_torch.capture.photo.brdf.capture_settings import CaptureSetup, SampleSpec, WhiteSpec
    from raden_torch.capture.photo.brdf.photo_white import WhiteFactor
    from raden_torch.capture.photo.development import Development
    from raden_torch.colorimetry import D65_XYZ

    sample = SampleSpec("plane", region_m=FLAT_M)
    if rod:
        sample = SampleSpec(
            "cylinder", series.mask, radius_mm=1000 * ROD_RADIUS_M, axis_m=ROD_M if axis else None
        )
    return {
        "photographs": series.photos,
        "setup": CaptureSetup(
            series.lights,
            Path(str(series.extra["camera"])),
            seen_in=series.photos[0].name,
            lamp_std_deg=0.1,
            development=Development("linear"),
        ),
        "sample": sample,
        "white": WhiteSpec(region_m=WHITE_M),
        "factor": WhiteFactor(0.9 * D65_XYZ),
    }


def board_lamps(count: int) -> Array:
    """`[count, 3]` places 0.3 m from the board's middle, 10 to 70 degrees off its normal."""
    k = np.arange(count)
    away, turn = np.radians(10 + 60 * (k + 0.5) / count), 2.4 * k
    direction = [np.sin(away) * np.cos(turn), np.sin(away) * np.sin(turn), -np.cos(away)]
    return np.array([0.09, 0.06, 0.0]) + 0.3 * np.stack(direction, 1)


class SphereBench:
    """Makes photographs of a sphere and measures them."""

    def __init__(self, make: Callable[..., Series]) -> None:
        self.series, self.arguments, self.shell = make, sphere_setup, shell
        self.triples = lamp_triples(20, 45, 70)

    def run(self, *args: object, go_on: bool = False, **options: object) -> CapturedBrdf:
        from raden_torch.measurement import Metadata

        series = self.series(*args, **options)
        return capture_brdf(
            **sphere_setup(series), go_on=go_on, metadata=Metadata("shell", simulated=True)
        )

    def truth(self, brdf: Callable[..., Array] = shell) -> Array:
        return node_truth(CellGrid().nodes_deg(), brdf)


class BoardBench:
    """The same on a board."""

    def __init__(self, make: Callable[..., Series]) -> None:
        self.series, self.arguments, self.lamps = make, board_setup, board_lamps
        self.truth_at, self.planned_places = node_truth, planned_places

    def run(self, case: str) -> CapturedBrdf:
        count, rod = 24, case != "plane"
        poses = [
            (15.0, 25.0)
            if rod
            else (17.0 * (k // 3) + 20 * (k % 3) - 20, 10 + 50 * (7 * k % 24) / 24)
            for k in range(count)
        ]
        series = self.series(board_lamps(count), poses, rod=rod)
        return capture_brdf(**board_setup(series, rod=rod, axis="edges" not in case))

    def truth(self) -> Array:
        return node_truth(CellGrid().nodes_deg())


@pytest.fixture
def sphere(sphere_series: Callable[..., Series]) -> SphereBench:
    return SphereBench(sphere_series)


@pytest.fixture
def board(board_series: Callable[..., Series]) -> BoardBench:
    return BoardBench(board_series)
