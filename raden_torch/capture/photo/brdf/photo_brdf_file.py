"""What `raden capture brdf` found, as a result file for a person and for the next step."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from raden_torch.capture.photo.checking_picture import picture_path
from raden_torch.capture.photo.result_file import check_result_path, write_result
from raden_torch.files import check_output
from raden_torch.reflectance.regions import regions

if TYPE_CHECKING:
    from raden_torch.capture.photo.capture_brdf import CapturedBrdf

PathLike = str | os.PathLike[str]

KIND = "brdf"


def output_paths(output: Path, picture: PathLike | None) -> tuple[Path, Path]:
    """The result's and the picture's path; raises InputError where something could not be
    written."""
    check_output(output, (".csv",))
    report = output.with_suffix(".json")
    check_result_path(report)
    return report, picture_path(picture, output)


def write_brdf(found: CapturedBrdf, report: Path) -> None:
    """Write coverage, white, budget, agreement and suggestion beside the measurement."""
    scale, cover = found.found.scale, found.coverage
    content: dict[str, Any] = {
        "shape": found.shape,
        "grid_step_deg": found.grid.step_deg,
        "grid_limit_deg": found.grid.limit_deg,
        "samples": found.found.samples,
        "samples_left_out_share": round(found.found.left_out, 5),
        "cells": found.grid.cells,
        "cells_covered": int(cover.covered.sum()),
        "coverage": round(cover.share, 5),
        "coverage_of_reachable": round(cover.share_of_reachable, 5),
        "white_xyz": np.round(scale.xyz, 4),
        "next": [
            {
                "text": stance.text,
                "direction_to_lamp": np.round(stance.lamp, 6),
                "direction_to_camera": None
                if stance.camera is None
                else np.round(stance.camera, 6),
                "more_cells": stance.gain,
            }
            for stance in cover.next
        ],
        "median_relative_std_percent": budget_table(found),
        "photographs": [
            {
                "file": shot.name,
                "lamp": shot.lamp + 1,
                "white_read": bool(scale.measured[k]),
                "white_rgb": np.round(scale.rgb[k], 7),
                "brighter_than_the_others_percent": _percent(found.agreement.brighter[k]),
                "chi2": _rounded(found.agreement.chi2[k]),
                "lamp_std_deg": _rounded(found.lamps[k].std_deg),
                "lamp_seems_off_deg": _rounded(found.places.offset_deg[k]),
            }
            for k, shot in enumerate(found.shots)
        ],
        "notes": list(found.notes),
    }
    files = [path for shot in found.shots for path in shot.files]
    write_result(report, KIND, content, made_from=files)


def budget_table(found: CapturedBrdf) -> dict[str, dict[str, float]]:
    """Median over the covered cells of each region: each term, per cent of the value."""
    level = np.abs(found.measurement.values).mean(axis=1)
    table = {}
    for name, where in regions(found.measurement.angles_deg).items():
        cells = where & found.measurement.valid & (level > 0)
        if not cells.any():
            continue
        terms = found.budget.terms() | {"total": found.budget.total}
        table[name] = {
            term: round(float(100 * np.median(std[cells].mean(axis=1) / level[cells])), 4)
            for term, std in terms.items()
        }
    return table


def _percent(share: float) -> float | None:
    return round(100 * float(share), 3) if np.isfinite(share) else None


def _rounded(value: float) -> float | None:
    return round(float(value), 3) if np.isfinite(value) else None
