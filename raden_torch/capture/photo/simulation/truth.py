"""The truth beside simulated photographs, as a JSON file; and the commands that look for it."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from raden_torch.arrays import Floats
from raden_torch.capture.photo.simulation.colours import white_xyz
from raden_torch.capture.photo.simulation.materials import Material
from raden_torch.capture.photo.simulation.mitsuba_scene import Sheet
from raden_torch.capture.photo.simulation.photo_plan import (
    CHROME_BALL,
    FACING,
    GREY_BALL,
    PLAN_NAME,
    WHITE,
    PhotoPlan,
    Shot,
)
from raden_torch.capture.photo.simulation.simulated_camera import View
from raden_torch.files import written_beside

_OPENCV = np.diag([1.0, -1.0, -1.0])


def write_truth(
    folder: Path,
    plan: PhotoPlan,
    material: Material,
    names: Mapping[str, Sequence[str]],
    seconds: Mapping[str, float],
    stack: int,
    variant: str,
) -> None:
    """Write truth.json: camera, poses, lamps, white, exposure times, and the other files' names.

    Lamps are given in each photograph's own camera (x right, y up, z to the viewer, mm), as a
    lights file has them; the board's poses in OpenCV's frames, metres.
    """
    camera = plan.camera
    first = dict(zip(names["lamp"][::stack], plan.shots, strict=True))
    content = {
        "simulated": True,
        "renderer": f"Mitsuba 3, {variant}",
        "material": material.name,
        "material_source": material.source,
        "measurement": "truth.csv",
        "normals": "truth_normals.exr",
        "camera": {
            "matrix": camera.matrix.tolist(),
            "distortion": camera.distortion.tolist(),
            "size": list(camera.size),
            "rgb_from_xyz": (camera.from_xyz / white_xyz()).tolist(),
            "bits": camera.bits,
            "full_well_e": camera.full_well_e,
            "read_noise_e": camera.read_noise_e,
        },
        "exposure_s": dict(seconds),
        "boards": {
            name: _pose(place, FACING) for name, place in
            zip(names["board"], plan.boards, strict=True)
        },
        "lamps": [_lamp(name, plan, shot) for name, shot in first.items()],
        "board_in_photograph": {
            name: _pose(plan.board_place, plan.views[shot.view]) for name, shot in first.items()
        },
        "specimen": {"shape": plan.shape, **plan.specimen},
        "white": plan.white,
        "white_factor": plan.white_factor,
        "grey_ball_reflectance": plan.grey_ball,
        "chrome_balls": {
            name: {"centre_mm": list(ball.centre_mm), "radius_mm": ball.radius_mm}
            for name, ball in plan.balls.items()
        },
    }  # fmt: skip
    with written_beside(folder / "truth.json") as temporary:
        temporary.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")


def commands(plan: PhotoPlan, names: Mapping[str, Sequence[str]], stack: int) -> list[str]:
    """The commands that make a measurement of the photographs, to be given in their folder."""
    square, marker = plan.board.square_mm / 1000, plan.board.marker_mm / 1000
    board = f"--squares {plan.board.columns}x{plan.board.rows} --square {square:g} "
    board += f"--marker {marker:g}"
    masks = " ".join(f"--mask mask_{n}.png" for n in plan.balls)
    balls = "ball_*.png" if plan.reference is not None else "ball_??.png"
    lights = f"raden capture lights {balls} {masks} --camera camera.json "
    lights += f"--ball-radius {plan.balls[CHROME_BALL].radius_mm:g}"
    brdf = f"--colour colour.json --white-factor {plan.white_factor:g} --simulated -o brdf.csv"
    first = [
        f"raden capture calibrate board_*.png {board} -o camera.json",
        "raden capture colour chart_*.png -o colour.json",
    ]
    if plan.shape == "plane":
        numbers = " ".join(f"--lamp {shot.lamp + 1}" for shot in plan.shots)
        seen_in, more = names["lamp"][0], ""
        if plan.reference is not None:
            seen_in, more = names["chart"][-1], f" {names['chart'][-1]}"
            brdf = f"--plan {PLAN_NAME} --scattered {brdf}"
        region, white = (
            " ".join(f"{x:g},{y:g}" for x, y in place["region_m"])
            for place in (plan.specimen, plan.white)
        )
        return [
            *first,
            f"raden capture calibrate view_*.png{more} {board} --camera camera.json -o poses.json",
            f"{lights} -o lights.json",
            f'raden capture brdf view_*.png --shape plane --region "{region}" '
            f"--camera poses.json --lights lights.json --lamps-stand board --lights-seen-in "
            f'{seen_in} {numbers} --white-region "{white}" {brdf}',
        ]
    reference, files = ("lamp_??_1.png", "lamp_??_?.png") if stack > 1 else ("lamp_??.png",) * 2
    stacked = f"--stack {stack} " if stack > 1 else ""
    return [
        *first,
        f"{lights} --reference '{reference}' --reference-mask mask_{GREY_BALL}.png -o lights.json",
        f"raden capture brdf {files} {stacked}--shape sphere --mask mask_specimen.png "
        f"--radius {plan.specimen['radius_mm']:g} --camera camera.json --lights lights.json "
        f"--white-mask mask_{WHITE}.png {brdf}",
    ]


def _lamp(name: str, plan: PhotoPlan, shot: Shot) -> dict[str, Any]:
    """In the photograph's camera, y up."""
    lamp, view = plan.lamps[shot.lamp], plan.views[shot.view]
    at, middle = (_OPENCV @ view.of_points(np.array([p], float))[0]
                  for p in (lamp.position_mm, plan.middle_mm))  # fmt: skip
    distance = float(np.linalg.norm(at - middle))
    return {
        "photograph": name,
        "position_mm": at.tolist(),
        "direction_from_specimen": ((at - middle) / distance).tolist(),
        "irradiance": float(lamp.intensity[1] / distance**2),
    }


def _pose(place: Sheet, view: View) -> dict[str, Any]:
    rotation, translation = _board_pose(place, view)
    return {"rotation": rotation.tolist(), "translation_m": translation.tolist()}


def _board_pose(place: Sheet, view: View) -> tuple[Floats, Floats]:
    """R and t (metres) of p_camera = R p_board + t, in OpenCV's frames."""
    axes = np.stack([place.right, place.down, -place.normal], axis=1)
    return view.rotation @ axes, view.of_points(place.corner_mm[None])[0] / 1000
