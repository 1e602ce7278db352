"""The truth beside simulated photographs, as a JSON file; and the commands that look for it."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from raden_torch.capture.photo.simulation.angles import Floats
from raden_torch.capture.photo.simulation.camera import View
from raden_torch.capture.photo.simulation.colours import white_xyz
from raden_torch.capture.photo.simulation.materials import Material
from raden_torch.capture.photo.simulation.scene import Lamp, Sheet
from raden_torch.capture.photo.simulation.sets import (
    CHROME_BALL,
    GREY_BALL,
    SECOND_BALL,
    WHITE,
    PhotoPlan,
)
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
    first = [names["lamp"][k * stack] for k in range(len(plan.lamps))]
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
            name: _pose(place, _facing()) for name, place in
            zip(names["board"], plan.boards, strict=True)
        },
        "lamps": [
            _lamp(name, lamp, view, plan.specimen["centre_mm"])
            for name, lamp, view in zip(first, plan.lamps, plan.views, strict=True)
        ],
        "board_in_photograph": {
            name: _pose(plan.board_place, view) for name, view in
            zip(first, plan.views, strict=True)
        },
        "specimen": {"shape": plan.shape, **plan.specimen},
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
    board, chrome = plan.board, [n for n in plan.balls if n in (CHROME_BALL, SECOND_BALL)]
    lamp = "lamp_??.png" if stack == 1 else "lamp_??_1.png"
    every = "lamp_??.png" if stack == 1 else "lamp_??_?.png"
    radius = plan.balls[CHROME_BALL].radius_mm
    masks = " ".join(f"--mask mask_{name}.png" for name in chrome)
    return [
        f"raden capture calibrate board_*.png --squares {board.columns}x{board.rows} "
        f"--square {board.square_mm / 1000:g} --marker {board.marker_mm / 1000:g} -o camera.json",
        "raden capture colour chart_*.png -o colour.json",
        f"raden capture lights ball_??.png {masks} --camera camera.json --ball-radius {radius:g} "
        f"--reference '{lamp}' --reference-mask mask_{GREY_BALL}.png -o lights.json",
        f"raden capture brdf {every} "
        + (f"--stack {stack} " if stack > 1 else "")
        + f"--shape sphere --mask mask_specimen.png --radius {plan.specimen['radius_mm']:g} "
        f"--camera camera.json --lights lights.json --colour colour.json "
        f"--white-mask mask_{WHITE}.png --white-factor {plan.white_factor:g} -o brdf.csv",
    ]


def _facing() -> View:
    return View(_OPENCV, np.zeros(3))


def _lamp(name: str, lamp: Lamp, view: View, centre: Sequence[float]) -> dict[str, Any]:
    """In the camera's frame with y up."""
    at, sample = (_OPENCV @ view.of_points(np.array([p], float))[0]
                  for p in (lamp.position_mm, centre))  # fmt: skip
    distance = float(np.linalg.norm(at - sample))
    return {
        "photograph": name,
        "position_mm": at.tolist(),
        "direction_from_specimen": ((at - sample) / distance).tolist(),
        "irradiance": float(lamp.intensity[1] / distance**2),
    }


def _pose(place: Sheet, view: View) -> dict[str, Any]:
    rotation, translation = _board_pose(place, view)
    return {"rotation": rotation.tolist(), "translation_m": translation.tolist()}


def _board_pose(place: Sheet, view: View) -> tuple[Floats, Floats]:
    """R and t (metres) of p_camera = R p_board + t, in OpenCV's frames."""
    axes = np.stack([place.right, place.down, -place.normal], axis=1)
    return view.rotation @ axes, view.of_points(place.corner_mm[None])[0] / 1000
