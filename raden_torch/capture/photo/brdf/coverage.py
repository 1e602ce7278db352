"""How much of the grid the photographs cover, and where lamp and camera should stand next.

A candidate is a lamp's direction and, for a sample on the board, a camera's. Points all over the
sample say which cells it would fill; the one that fills most new cells is taken, then the next
(greedy: at least 63 % of what the best set of as many could fill, Nemhauser et al. 1978).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from raden_torch.arrays import Bools, Floats
from raden_torch.capture.photo.brdf.cell_fit import FEWEST
from raden_torch.capture.photo.brdf.photo_angles import angles_deg
from raden_torch.capture.photo.brdf.photo_cells import CellGrid
from raden_torch.capture.photo.brdf.rays import Y_UP
from raden_torch.capture.photo.brdf.sample_shapes import Shape, fibonacci_sphere
from raden_torch.capture.photo.brdf.seen_surface import LEAST_COSINE
from raden_torch.capture.photo.camera import Camera, Pose
from raden_torch.capture.photo.directions import apart_deg

_LAMPS, _CAMERAS = 500, 60
"""Directions over the whole sphere that are tried: about 9 and 26 degrees apart."""
_BESIDE_DEG, _BEHIND_DEG = 8.0, 150.0
"""A lamp nearer to the camera's axis stands behind or before the camera; one further away shines
into it."""
_LEAN_DEG = 75.0
"""Of a camera from the board's normal, at most."""
_POINTS, _DENSE = 4000, 40_000
_BITS = np.unpackbits(np.arange(256, dtype=np.uint8)[:, None], axis=1).sum(axis=1)


@dataclass(frozen=True, eq=False)
class LightingPosition:
    """A lamp and a camera that would help.

    Attributes:
        lamp: `[3]` direction to the lamp from the sample, in the frame of the first photograph's
            camera.
        camera: `[3]` direction to the camera; None: where it is.
        gain: cells that it would fill beside those filled before.
        text: the directions in degrees that a person can set up.
    """

    lamp: Floats
    camera: Floats | None
    gain: int
    text: str


@dataclass(frozen=True, eq=False)
class Coverage:
    """What is covered.

    Attributes:
        covered: `[cells]`.
        reachable: `[cells]` that some lamp (and, for a sample on the board, some camera) reaches.
        next: where to put them, the most useful first.
        after: `[cells]` covered when all of these were followed, as predicted.
    """

    covered: Bools
    reachable: Bools
    next: tuple[LightingPosition, ...]
    after: Bools

    @property
    def share(self) -> float:
        return float(self.covered.mean())

    @property
    def share_of_reachable(self) -> float:
        return float(self.covered.sum() / max(int(self.reachable.sum()), 1))

    def __str__(self) -> str:
        lines = [
            f"covered: {self.covered.sum()} of {self.covered.size} cells "
            f"({100 * self.share:.1f} %), {100 * self.share_of_reachable:.1f} % of those that this "
            "sample can show"
        ]
        lines += [f"next: {place.text}: {place.gain} more cells" for place in self.next]
        return "\n".join(lines)


def coverage(
    covered: Bools,
    grid: CellGrid,
    shape: Shape,
    camera: Camera | None,
    pose: Pose | None,
    lamp_distance: float | None,
    *,
    stances: int = 4,
) -> Coverage:
    """Which cells are covered, and where lamp and camera would add most.

    Args:
        shape: of the sample, in the first photograph.
        pose: of the board there; with it, other places of the camera are tried, too.
        lamp_distance: from the sample, for near lamps; None: far away.
        stances: how many such places of lamp and camera to suggest.
    """
    scene = _Scene(grid, shape, camera, pose, lamp_distance)
    tried: list[tuple[Floats, Floats | None]] = []
    each = []
    for lamps, eye in scene.candidates():
        tried += [(lamp, eye) for lamp in lamps]
        each.append(np.packbits(scene.cells(lamps, eye, _POINTS), axis=1))
    packed = np.concatenate(each)
    reachable = np.unpackbits(np.bitwise_or.reduce(packed), count=grid.cells).astype(bool)
    now, chosen = covered.copy(), []
    for _ in range(stances):
        gains = _BITS[packed & ~np.packbits(now)].sum(axis=1)
        best = int(gains.argmax())
        if gains[best] == 0:
            break
        lamp, eye = tried[best]
        fills = scene.cells(lamp[None], eye, _DENSE)[0]
        gain = int((fills & ~now).sum())
        chosen.append(LightingPosition(lamp, eye, gain, scene.described(lamp, eye)))
        now |= fills
        packed[best] = 0
    return Coverage(covered, reachable | covered, tuple(chosen), now)


@dataclass(eq=False)
class _Scene:
    grid: CellGrid
    shape: Shape
    camera: Camera | None
    pose: Pose | None
    lamp_distance: float | None

    def candidates(self) -> list[tuple[Floats, Floats | None]]:
        """For each direction to a camera (None: where it is) those `[L, 3]` to lamps."""
        eyes: list[Floats | None] = [None]
        if self.pose is not None:
            away = fibonacci_sphere(_CAMERAS)
            up = self._from_board(np.array([0.0, 0.0, -1.0]))
            eyes += [eye for eye in away if eye @ up > np.cos(np.radians(_LEAN_DEG))]
        lamps = fibonacci_sphere(_LAMPS if len(eyes) == 1 else _LAMPS // 2)
        found = []
        for eye in eyes:
            apart = apart_deg(lamps, self._to_eye() if eye is None else eye)
            found.append((lamps[(apart > _BESIDE_DEG) & (apart < _BEHIND_DEG)], eye))
        return found

    def cells(self, lamps: Floats, eye: Floats | None, count: int) -> Bools:
        """`[L, cells]` that would hold samples enough under each lamp `[L, 3]`."""
        point, normal, area = self._surface(count)
        view, scale = self._view(point, eye)
        light = np.broadcast_to(lamps[:, None], (len(lamps), *point.shape))
        if self.lamp_distance is not None:
            light = self.shape.middle + self.lamp_distance * light - point
            light = light / np.linalg.norm(light, axis=2, keepdims=True)
        facing = (normal * view).sum(1)
        lit = np.einsum("lpc,pc->lp", light, normal) > LEAST_COSINE
        lamp, place = np.nonzero(lit & (facing > LEAST_COSINE))
        angles = angles_deg(normal[place], light[lamp, place], view[place])
        rows, cell, _ = self.grid.sort(angles)
        pixels = (area * facing * scale)[place[rows]]
        bins = lamp[rows] * self.grid.cells + cell
        counted = np.bincount(bins, pixels, len(lamps) * self.grid.cells)
        return np.asarray(counted.reshape(len(lamps), -1) >= FEWEST)

    def described(self, lamp: Floats, eye: Floats | None) -> str:
        if self.pose is None:
            return f"the lamp {_direction(lamp)} of the camera's axis (0 right, 90 up)"
        flip = np.array([1.0, -1.0, -1.0])  # board: y down its columns, z into it
        on_board = [
            self._to_board(v) * flip for v in (lamp, self._to_eye() if eye is None else eye)
        ]
        where = [_direction(v) for v in on_board]
        stays = "where it was in the first photograph, " if eye is None else ""
        return (
            f"the lamp {where[0]} and the camera {stays}{where[1]} of the board's normal "
            "(0 along its rows, 90 up its columns)"
        )

    def _surface(self, count: int) -> tuple[Floats, Floats, Floats]:
        known: dict[int, tuple[Floats, Floats, Floats]] = self.__dict__.setdefault("_known", {})
        if count not in known:
            surface, area = self.shape.spread(count)
            known[count] = surface.point, surface.normal, area
        return known[count]

    def _view(self, point: Floats, eye: Floats | None) -> tuple[Floats, Floats]:
        """Unit directions to the viewer, and pixels a unit of area that faces it."""
        if self.camera is None:
            towards = np.array([0.0, 0.0, 1.0]) if eye is None else eye
            return np.broadcast_to(towards, point.shape), np.ones(len(point))
        middle = self.shape.middle
        at = np.zeros(3) if eye is None else middle + np.linalg.norm(middle) * eye
        view = at - point
        square = (view**2).sum(1)
        focal = float(self.camera.matrix[0, 0] * self.camera.matrix[1, 1])
        return view / np.sqrt(square)[:, None], focal / square

    def _to_eye(self) -> Floats:
        if self.camera is None:
            return np.array([0.0, 0.0, 1.0])
        return np.asarray(-self.shape.middle / np.linalg.norm(self.shape.middle))

    def _to_board(self, vector: Floats) -> Floats:
        assert self.pose is not None
        return np.asarray(self.pose.rotation.T @ (vector * Y_UP))

    def _from_board(self, vector: Floats) -> Floats:
        assert self.pose is not None
        return np.asarray((self.pose.rotation @ vector) * Y_UP)


def _direction(v: Floats) -> str:
    """As "40 deg towards 90 deg": off z, and which way in x and y."""
    away = np.degrees(np.arctan2(np.hypot(v[0], v[1]), v[2]))
    turn = np.degrees(np.arctan2(v[1], v[0]))
    return f"{away:.0f} deg towards {turn:.0f} deg"
