"""Lamps of a set of photographs: which way, where, how bright.

Every vector here points TO a lamp, from the object; none is a surface normal. The frame is the
camera's: x right, y up, z to the viewer.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from msgspec import Meta, Struct
from numpy.typing import NDArray

from raden_torch.arrays import Floats
from raden_torch.capture.photo.ball import Ball
from raden_torch.capture.photo.directions import apart_deg, nearest_points
from raden_torch.capture.photo.highlight import Highlight
from raden_torch.capture.photo.result_file import read_result, write_result
from raden_torch.errors import InputError
from raden_torch.schema import Finite, Matrix, Orientation, Positive, Triple

KIND = "lights"
_PARALLEL_DEG = 0.5
"""Rays from two balls that differ by less do not tell how far away the lamp is."""


@dataclass(frozen=True, eq=False)
class Lamps:
    """K lamps, one a photograph.

    Attributes:
        direction: `[K, 3]` unit vectors to the lamps: as seen from the ball, or (near lamps) from
            the mean of the balls.
        intensity: `[K]` relative, of mean 1.
        position: `[K, 3]` of near lamps, in `unit`, else None.
        miss: `[K]`, how far the rays from the balls pass a near lamp, in `unit`.
        unit: of positions: "px" without a camera, else the unit of the ball's radius.
        exponent: of the camera's response, as a reference sphere gave it; 1 is linear.
        names: the photographs, in order.
        photographs: of each lamp the names of all that were taken under it; empty where each lamp
            is one photograph's.
        notes: what a person should know of these lamps.
        matrix: `[3, 3]` of the camera (pixels, x right, y down) where there was one.
        distortion: of its lens, as OpenCV has it.
        tint: `[K, 3]` RGB of each lamp over its intensity, relative to the mean of all lamps, as a
            reference gave them; None where nothing is known.
        std_deg: `[K]` standard deviation of each direction, in each of two directions across; None
            where nothing is known.
        moved: `[K]` bool, lamps that stood elsewhere when a reference sphere was photographed;
            normals leave them out. None where that was not asked.
        orientation: EXIF's, 1…8, by which the photographs were turned in which they were seen;
            None where nobody says.
    """

    direction: Floats
    intensity: Floats
    position: Floats | None = None
    miss: Floats | None = None
    unit: str = "px"
    exponent: float = 1.0
    names: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()
    matrix: Floats | None = None
    distortion: Floats | None = None
    tint: Floats | None = None
    std_deg: Floats | None = None
    photographs: tuple[tuple[str, ...], ...] = ()
    moved: NDArray[np.bool_] | None = None
    orientation: int | None = None

    def __len__(self) -> int:
        return len(self.direction)

    @property
    def away_deg(self) -> Floats:
        """`[K]` between each lamp and the camera's axis, 0…180."""
        x, y, z = self.direction.T
        return np.asarray(np.rad2deg(np.arctan2(np.hypot(x, y), z)))

    @property
    def turn_deg(self) -> Floats:
        """`[K]` which way from that axis, −180…180: 0 right, 90 up."""
        return np.asarray(np.rad2deg(np.arctan2(self.direction[:, 1], self.direction[:, 0])))

    def __str__(self) -> str:
        """A line a lamp: its angle from the camera's axis, which way, and how bright."""
        lines = []
        for k, (away, turn) in enumerate(zip(self.away_deg, self.turn_deg, strict=True)):
            name = self.names[k] if self.names else f"lamp {k + 1}"
            line = f"{name}: {away:.1f} deg from the camera's axis, towards {turn:.0f} deg"
            line += " (0 right, 90 up)"
            if self.std_deg is not None:
                line += f", ± {self.std_deg[k]:.2f} deg"
            line += f", intensity {self.intensity[k]:.3f}"
            if self.position is not None and self.miss is not None:
                at = ", ".join(f"{c:.0f}" for c in self.position[k])
                line += f", at {at} {self.unit} (rays miss by {self.miss[k]:.1f})"
            lines.append(line)
        return "\n".join((*lines, *self.notes))

    def plane(self, size: tuple[int, int], z: float) -> Floats:
        """`[3, H, W]` points that the pixels see of a plane z, which faces the camera.

        Raises:
            InputError: with a camera, a plane that is not in front of it (z < 0).
        """
        v, u = np.mgrid[: size[0], : size[1]].astype(np.float64)
        if self.matrix is None:
            return np.stack([u, -v, np.full_like(u, z)])
        if not z < 0:
            raise InputError(
                f"plane z = {z:g} {self.unit}: the camera is at 0 and looks along -z; give the "
                "object's distance as a negative number"
            )
        import cv2

        lens = np.zeros(5) if self.distortion is None else self.distortion
        pixels = np.stack([u, v], -1).reshape(-1, 1, 2)
        straight = cv2.undistortPoints(pixels, self.matrix, lens).reshape(-1, 2).T
        ray = np.concatenate([straight, np.ones((1, straight.shape[1]))])
        return np.asarray((ray / ray[2] * [[-z], [z], [z]]).reshape(3, *size))

    def towards(self, points: Floats) -> Floats:
        """`[K, 3, ...]` vectors from points `[3, ...]` to the lamps, for `solve_normals`.

        Their length is the irradiance relative to that at the points' mean: (d̄/d)² for near lamps,
        1 for those far away.
        """
        shape = (-1, 3, *[1] * (points.ndim - 1))
        if self.position is None:
            ones = np.ones((len(self), *points.shape))
            return np.asarray(self.direction.reshape(shape) * ones)
        to_lamp = self.position.reshape(shape) - points
        distance = np.linalg.norm(to_lamp, axis=1, keepdims=True)
        middle = np.nanmean(points.reshape(3, -1), axis=1)
        reference = np.linalg.norm(self.position - middle, axis=1).reshape(-1, *[1] * points.ndim)
        return np.asarray(to_lamp / distance * (reference / distance) ** 2)


class LampEntry(Struct):
    """One lamp of a lights file."""

    direction_to_lamp: Triple
    intensity: Positive
    photograph: str = ""
    tint_rgb: tuple[Positive, Positive, Positive] | None = None
    position_px: Triple | None = None
    position_mm: Triple | None = None
    direction_std_deg: Positive | None = None
    photographs: tuple[str, ...] = ()
    moved: bool = False


class LightsFile(Struct):
    """What is read of a lights file."""

    lamps: Annotated[tuple[LampEntry, ...], Meta(min_length=1)]
    unit: Literal["px", "mm"]
    response_exponent: Finite
    camera_matrix_px: Matrix | None = None
    camera_distortion: tuple[Finite, ...] | None = None
    orientation: Orientation | None = None


def lamps_from_balls(
    balls: Sequence[Ball], highlights: Sequence[Sequence[Highlight]], *, unit: str = "px"
) -> Lamps:
    """Directions from one mirror ball; positions from two or more.

    Args:
        balls: B of them, in one frame.
        highlights: `[K][B]`, the lamp's image in each ball of each photograph.
        unit: what `Ball.radius` is in.
    """
    reflected = [
        [ball.towards_lamp(h.x_px, h.y_px) for ball, h in zip(balls, row, strict=True)]
        for row in highlights
    ]
    point = np.array([[p for p, _ in row] for row in reflected])
    direction = np.array([[d for _, d in row] for row in reflected])
    names = tuple(Path(row[0].found_in).name for row in highlights)
    if not np.isfinite(direction).all():
        bad = int(np.argwhere(~np.isfinite(direction).all((1, 2)))[0, 0])
        raise InputError(f"{highlights[bad][0].found_in}: its highlight lies beside the ball")
    mean = direction.mean(1)
    mean /= np.linalg.norm(mean, axis=1, keepdims=True)
    lamps = Lamps(mean, np.ones(len(mean)), unit=unit, names=names, matrix=balls[0].matrix)
    if len(balls) == 1:
        return lamps
    apart = apart_deg(direction, mean[:, None]).max(1)
    if float(np.median(apart)) < _PARALLEL_DEG:
        note = (
            f"the balls see the lamps {np.median(apart):.2f} degrees apart: they are too far "
            "away for positions; directions only"
        )
        return replace(lamps, notes=(note,))
    position, passing = nearest_points(point, direction)
    miss = np.sqrt((passing**2).mean(1))
    middle = np.mean([ball.centre for ball in balls], axis=0)
    to_lamp = position - middle
    if bool(((to_lamp * mean).sum(1) <= 0).any()):
        bad = int(np.argmin((to_lamp * mean).sum(1)))
        raise InputError(
            f"{names[bad]}: the rays from the balls part instead of meeting at a lamp; are the "
            "masks in the order of the balls, and the camera the right one?"
        )
    to_lamp = to_lamp / np.linalg.norm(to_lamp, axis=1, keepdims=True)
    return replace(lamps, direction=to_lamp, position=position, miss=miss)


def write_lamps(
    lamps: Lamps,
    path: str | os.PathLike[str],
    *,
    balls: Sequence[Ball] = (),
    made_from: Sequence[str | os.PathLike[str]] = (),
) -> None:
    """Write a lights file of `raden capture`."""
    each = [
        {
            "photograph": name,
            "direction_to_lamp": np.round(lamps.direction[k], 6),
            "intensity": round(float(lamps.intensity[k]), 5),
        }
        | ({} if lamps.std_deg is None else {"direction_std_deg": _digits(lamps.std_deg[k])})
        | ({} if lamps.tint is None else {"tint_rgb": np.round(lamps.tint[k], 5)})
        | ({} if lamps.position is None else {f"position_{lamps.unit}": lamps.position[k]})
        | ({"photographs": list(lamps.photographs[k])} if lamps.photographs else {})
        | ({} if lamps.moved is None or not lamps.moved[k] else {"moved": True})
        for k, name in enumerate(lamps.names or [str(k) for k in range(len(lamps))])
    ]
    found = [
        {
            "found_in": Path(ball.found_in).name,
            "x_px": round(ball.x_px, 3),
            "y_px": round(ball.y_px, 3),
            "radius_px": round(ball.radius_px, 3),
            "rms_px": round(ball.rms_px, 3),
        }
        for ball in balls
    ]
    content: dict[str, Any] = {
        "frame": "x right, y up, z to the viewer; vectors point to the lamp and are no normals",
        "unit": lamps.unit,
        "response_exponent": round(lamps.exponent, 4),
        **({} if lamps.matrix is None else {"camera_matrix_px": lamps.matrix}),
        **({} if lamps.distortion is None else {"camera_distortion": lamps.distortion}),
        **({} if lamps.orientation is None else {"orientation": lamps.orientation}),
        "lamps": each,
        "balls": found,
        "notes": list(lamps.notes),
    }
    write_result(path, KIND, content, made_from=made_from)


def read_lamps(path: str | os.PathLike[str]) -> Lamps:
    """Read a lights file of `raden capture`.

    Raises:
        InputError: missing, of another kind, or damaged.
    """
    found = read_result(path, KIND, LightsFile)
    direction = np.array([lamp.direction_to_lamp for lamp in found.lamps])
    largest = abs(direction).max(axis=1, keepdims=True)
    if not largest.all():
        k = int(np.argmin(largest))
        raise InputError(f"{path}: lamps[{k}].direction_to_lamp: expected a direction, got 0, 0, 0")
    moved = np.array([lamp.moved for lamp in found.lamps])
    direction = direction / largest  # whose squares do not overflow
    return Lamps(
        direction / np.linalg.norm(direction, axis=1, keepdims=True),
        np.array([lamp.intensity for lamp in found.lamps]),
        _column(path, found.lamps, f"position_{found.unit}"),
        unit=found.unit,
        exponent=found.response_exponent,
        matrix=_array(found.camera_matrix_px),
        distortion=_array(found.camera_distortion),
        tint=_column(path, found.lamps, "tint_rgb"),
        names=tuple(lamp.photograph for lamp in found.lamps),
        std_deg=_column(path, found.lamps, "direction_std_deg"),
        photographs=_photographs(found.lamps),
        moved=moved if moved.any() else None,
        orientation=found.orientation,
    )


def _photographs(lamps: Sequence[LampEntry]) -> tuple[tuple[str, ...], ...]:
    named = tuple(lamp.photographs for lamp in lamps)
    return named if any(named) else ()


def _digits(value: float) -> float:
    """Three digits, as a standard deviation has at best."""
    return float(f"{value:.3g}")


def _array(values: Any) -> Floats | None:
    return None if values is None else np.array(values)


def _column(path: str | os.PathLike[str], lamps: Sequence[LampEntry], key: str) -> Floats | None:
    """`[K, …]` of what all lamps have, or none of them."""
    values = [getattr(lamp, key) for lamp in lamps]
    missing = [k for k, value in enumerate(values) if value is None]
    if len(missing) == len(values):
        return None
    if missing:
        raise InputError(
            f"{path}: lamps[{missing[0]}].{key}: expected it, as other lamps have it, got none"
        )
    return np.array(values)
