"""A plan of photographs as a result file, and as a table for a person with a protractor."""

from __future__ import annotations

import csv
import os
from dataclasses import asdict
from pathlib import Path

import numpy as np
from msgspec import Struct

from raden_torch.capture.photo.guide.plan import Plan, said
from raden_torch.capture.photo.result_file import read_result, write_result
from raden_torch.files import written_beside
from raden_torch.schema import Finite, NotNegative, Positive, Triple

KIND = "plan"
PathLike = str | os.PathLike[str]


class PlannedPhotograph(Struct):
    """Where lamp and camera stand, in the piece's frame; mm."""

    lamp_mm: Triple
    camera_mm: Triple


class PlanFile(Struct):
    """What is checked of a plan file."""

    sample: str
    shape: str
    size_mm: tuple[Positive, Positive]
    tilts_deg: tuple[Finite, ...]
    piece: str
    photographs: tuple[PlannedPhotograph, ...]
    assume: str | None = None
    expected_error: tuple[NotNegative, ...] = ()


def write_plan(plan: Plan, path: PathLike, *, made_from: tuple[Path, ...] = ()) -> None:
    """Write a plan as JSON; `raden capture simulate` and `raden capture brdf` read it.

    Raises:
        InputError: as for `write_result`.
    """
    content = {
        "sample": plan.name,
        "shape": plan.piece.shape,
        "size_mm": plan.piece.size_mm,
        "tilts_deg": plan.piece.tilts_deg,
        "piece": plan.piece.described(),
        "set_up": asdict(plan.set_up),
        "assume": plan.assume,
        "expected_error": np.round(plan.expected, 5),
        "photographs": [
            {"number": k + 1, **asdict(stance), "text": said(stance, plan.set_up)}
            for k, stance in enumerate(plan.stances)
        ],
    }
    write_result(path, KIND, content, made_from=made_from)


def write_table(plan: Plan, path: PathLike) -> None:
    """The same as CSV: a row a photograph, degrees and cm, and the error expected after it."""
    with written_beside(path) as temporary, temporary.open("w", newline="") as file:
        table = csv.writer(file)
        table.writerow(
            [
                *("photograph", "turn_deg", "wedge_deg"),
                *("lamp_from_vertical_deg", "lamp_azimuth_deg", "lamp_distance_cm"),
                *("camera_from_vertical_deg", "camera_azimuth_deg", "camera_distance_cm"),
                "expected_error_percent",
            ]
        )
        for k, s in enumerate(plan.stances):
            table.writerow(
                [
                    *(k + 1, f"{s.turn_deg:g}", f"{s.wedge_deg:g}"),
                    *(f"{s.lamp_from_vertical_deg:g}", f"{s.lamp_azimuth_deg:g}"),
                    f"{s.lamp_distance_mm / 10:g}",
                    *(f"{s.camera_from_vertical_deg:g}", f"{s.camera_azimuth_deg:g}"),
                    f"{s.camera_distance_mm / 10:g}",
                    f"{100 * plan.expected[k + 1]:.2f}",
                ]
            )


def read_plan(path: PathLike) -> PlanFile:
    """Read a plan.

    Raises:
        InputError: not such a file.
    """
    return read_result(path, KIND, PlanFile)
