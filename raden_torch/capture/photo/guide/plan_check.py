"""Were photographs taken as a plan says, of the piece that it is for, and in its order?"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from raden_torch.arrays import Floats
from raden_torch.capture.photo.brdf.capture_settings import SampleSpec
from raden_torch.capture.photo.brdf.photo_series import PhotoSeries
from raden_torch.capture.photo.brdf.rays import MM, board_direction, board_to_scene
from raden_torch.capture.photo.directions import apart_deg
from raden_torch.capture.photo.guide.plan_file import PlanFile, read_plan
from raden_torch.errors import InputError

_OFF_DEG = 12.0
"""A person with a protractor is nearer than this to where the plan says."""
_OTHER_SIZE = 1.5
_UP = np.array([0.0, 0.0, 1.0])


def check_planned(path: Path, series: PhotoSeries, sample: SampleSpec) -> str | None:
    """What is wrong with the order of the photographs, in one line; None where nothing is.

    Compared are, for each photograph, the angles of lamp and camera from the piece's normal and the
    angle between the two: the marks on the table need not be right. Without the board's pose the
    last one alone.

    Raises:
        InputError: no plan; one for another piece, or for fewer photographs.
    """
    plan = read_plan(path)
    _check_piece(path, plan, sample)
    if len(series.shots) > len(plan.photographs):
        raise InputError(
            f"{path}: expected a plan of {len(series.shots)} photographs or more, got one of "
            f"{len(plan.photographs)}"
        )
    planned = np.array([_angles(np.array(p.lamp_mm), np.array(p.camera_mm), _UP)
                        for p in plan.photographs])  # fmt: skip
    for k, number in enumerate(_numbers(series, len(planned))):
        angles = _taken(series, k, sample)
        known = np.isfinite(angles)
        if not known.any():
            continue
        off = abs(planned - angles)[:, known].max(axis=1)
        if off[number] <= _OFF_DEG:
            continue
        best = int(off.argmin())
        if off[best] <= _OFF_DEG:
            return (
                f"{series.names[k]}: it is given as number {number + 1} of {path}, but was taken "
                f"as number {best + 1}; give the photographs in the plan's order, or leave it out "
                "if its lamp was not found where it stood"
            )
        return (
            f"{series.names[k]}: lamp or camera stood {off[number]:.0f} deg from where number "
            f"{number + 1} of {path} has them; a plan for another sample, or take it again"
        )
    return None


def _numbers(series: PhotoSeries, planned: int) -> list[int]:
    """Which of the plan each photograph is, from 0: each has its own lamp, so the lamp says; where
    lamps stand for several photographs, their order does."""
    lamps = [shot.lamp for shot in series.shots]
    own = len(set(lamps)) == len(lamps) and max(lamps) < planned
    return lamps if own else list(range(len(lamps)))


def _check_piece(path: Path, plan: PlanFile, sample: SampleSpec) -> None:
    if plan.shape != sample.shape:
        bent = " (it is bent, not a plane)" if plan.shape != "plane" else ""
        raise InputError(
            f"{path}: it is a plan for {plan.piece}{bent}: expected shape {plan.shape}, got "
            f"{sample.shape}"
        )
    if not sample.regions_m:
        return
    sizes = [np.sort(MM * np.ptp(region[:, :2], axis=0)) for region in sample.regions_m]
    largest = max(sizes, key=lambda size: float(size[1]))
    ratio = largest / np.sort(plan.size_mm)
    if ratio.max() > _OTHER_SIZE or ratio.max() < 1 / _OTHER_SIZE:
        height, width = largest
        raise InputError(
            f"{path}: it is a plan for {plan.piece}, got a region of {width:.0f} x {height:.0f} "
            "mm; a plan for another sample"
        )


def _taken(series: PhotoSeries, number: int, sample: SampleSpec) -> Floats:
    """`[3]` degrees, as `_angles`; NaN where they are not known."""
    shot, lamp = series.shots[number], series.lamps[number]
    if shot.pose is None or not sample.regions_m:
        if series.camera is None:
            return np.array([np.nan, np.nan, apart_deg(lamp.direction, _UP)])
        return np.full(3, np.nan)
    middle = np.mean(np.concatenate([region[:, :2] for region in sample.regions_m]), axis=0)
    at = board_to_scene(shot.pose, np.append(middle, 0))
    towards_lamp, _ = lamp.at(at[None], at)
    return _angles(towards_lamp[0], -at, board_direction(shot.pose, [0, 0, -1]))


def _angles(to_lamp: Floats, to_camera: Floats, normal: Floats) -> Floats:
    """Of lamp and camera from the unit normal, and between them, in degrees."""
    lamp, camera = (way / np.linalg.norm(way) for way in (to_lamp, to_camera))
    return apart_deg(np.stack([lamp, camera, lamp]), np.stack([normal, normal, camera]))
