"""Repeats of simulated series, to judge a stated standard deviation by: in each, everything that
the budget states an error of is drawn anew.

Lamps stand elsewhere by up to 2.5 degrees and are turned about the camera's axis (or the board's),
so that they are on no node of the grid; they lean at random from where the lights file says. A
sphere's mask is drawn 0.1 px off, a rod's at each of its edges; the board's poses are found by
corners that are each off at random; a rod lies elsewhere than is said, and has another radius.
"""

from __future__ import annotations

import tempfile
import warnings
from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy.stats import norm, qmc

from raden_torch.capture.photo.capture_brdf import CapturedBrdf, capture_brdf
from raden_torch.measurement import BrdfMeasurement
from raden_torch.reflectance.regions import regions
from tests.capture.photo.brdf.conftest import (
    ROD_M,
    ROD_RADIUS_M,
    Array,
    anywhere,
    board_lamps,
    board_photographs,
    board_setup,
    lamp_triples,
    node_truth,
    sphere_photographs,
    sphere_setup,
)

FEWEST = 300
"""Values of a region in all repeats together, below which it is not judged."""
_OUTLINE_PX = 0.1
_AXIS_MM, _RADIUS_MM = 0.2, 0.05


@dataclass(frozen=True)
class Case:
    """One set-up.

    Attributes:
        shape: "sphere", "plane", "rod" (that lies on the board where it is said to) or "edges" (a
            rod that is found by its edges).
        away_deg: of a sphere's lamps from the camera's axis, three at each.
        keep: of these lamps.
        count: of lamps beside a board.
        lean_deg: standard deviation of the lamps' directions.
        corner_px: of the board's corners.
        scattered: values amid each cell's samples.
        options: of the caster.
    """

    shape: str = "sphere"
    away_deg: tuple[float, ...] = (20, 45, 70)
    keep: slice = field(default_factory=lambda: slice(None))
    count: int = 24
    lean_deg: float = 0.5
    corner_px: float = 0.2
    scattered: bool = False
    options: dict[str, Any] = field(default_factory=dict)


CASES = {
    "nine lamps, five times the noise, no lean": Case(lean_deg=0.0, options={"noise": 0.01}),
    "nine lamps": Case(),
    "nine lamps, six radii away": Case(options={"near": 6.0}),
    "nine lamps from 5 degrees off the camera on": Case(away_deg=(5, 35, 65)),
    "three lamps": Case(away_deg=(25, 60), keep=slice(0, 6, 2)),
    "24 lamps": Case(away_deg=(15, 27, 39, 51, 63, 75, 87, 99)),
    "nine lamps, a white of patches that differ by 10 %": Case(options={"stains": 0.1}),
    "plane, amid the samples": Case("plane", scattered=True),
    "plane, amid the samples, lamps that lean by 0.1": Case("plane", lean_deg=0.1, scattered=True),
    "plane": Case("plane", count=30),
    "rod": Case("rod", count=12),
    "rod, lamps that lean by 0.1": Case("rod", count=12, lean_deg=0.1),
    "rod by its edges, lamps that lean by 0.1": Case("edges", count=12, lean_deg=0.1),
}


def repeated(case: Case, seed: int) -> CapturedBrdf:
    """One series of a case, measured."""
    with tempfile.TemporaryDirectory() as folder, warnings.catch_warnings():
        warnings.simplefilter("ignore")  # lamps that seem to stand elsewhere, as they do
        make = _sphere if case.shape == "sphere" else _board
        return capture_brdf(**make(case, seed, Path(folder)), scattered=case.scattered, go_on=True)


def _sphere(case: Case, seed: int, folder: Path) -> dict[str, Any]:
    series = sphere_photographs(
        folder,
        lamps=anywhere(lamp_triples(*case.away_deg)[case.keep], seed),
        radius=60.0,
        outline_error_px=_OUTLINE_PX,
        lamp_error_deg=case.lean_deg,
        seed=seed,
        **case.options,
    )
    return _stated(sphere_setup(series), case)


def _board(case: Case, seed: int, folder: Path) -> dict[str, Any]:
    random = np.random.default_rng([seed, 4])
    middle, up = np.array([0.09, 0.06, 0.0]), np.array([1.0, 1.0, -1.0])
    lamps = middle + 0.3 * up * anywhere(up * (board_lamps(case.count) - middle) / 0.3, seed)
    rod = case.shape != "plane"
    series = board_photographs(
        folder,
        lamps,
        [(random.uniform(-40, 40), random.uniform(20, 30))] * case.count
        if rod
        else _views(case.count, random),
        rod=rod,
        lamp_error_deg=case.lean_deg,
        corner_error_px=case.corner_px,
        edge_error_px=_OUTLINE_PX,
        seed=seed,
        **case.options,
    )
    said = _stated(board_setup(series, rod=rod, axis=case.shape == "rod"), case)
    if rod:
        radius, aside, turned = _evenly_drawn(seed, 3)
        ends = np.array([aside - turned, aside + turned]) / np.sqrt(2)
        said["sample"] = replace(
            said["sample"],
            radius_mm=1000 * ROD_RADIUS_M + _RADIUS_MM * radius,
            axis_m=ROD_M + 1e-3 * _AXIS_MM * ends[:, None] * [0, 1]
            if case.shape == "rod"
            else None,
        )
    return said


def _evenly_drawn(number: int, count: int) -> Array:
    """`[count]` of a normal distribution, by a Halton sequence: few repeats have errors as large as
    many would, where one error is in all cells."""
    points = qmc.Halton(count, seed=0).random(number + 1)
    return np.asarray(norm.ppf(points[-1]))


def _views(count: int, random: Any) -> list[tuple[float, float]]:
    """Places of a camera that moves: azimuth, and away from the normal, degrees."""
    k, turn = np.arange(count), random.uniform(0, 360)
    azimuth = 17.0 * (k // 3) + 20 * (k % 3) - 20 + turn
    away = 10 + 50 * (7 * k % count) / count + random.uniform(-2.5, 2.5, count)
    return list(zip(azimuth.tolist(), away.tolist(), strict=True))


def _stated(arguments: dict[str, Any], case: Case) -> dict[str, Any]:
    lean = max(case.lean_deg, 1e-3)
    return arguments | {"setup": replace(arguments["setup"], lamp_std_deg=lean)}


def errors_over_std(found: BrdfMeasurement) -> Array:
    """`[M, 3]` of the values, whose truth is known."""
    assert found.std is not None
    return (found.values - node_truth(found.angles_deg)) / found.std


def judged(measured: Iterable[BrdfMeasurement]) -> dict[str, dict[str, float]]:
    """Of all repeats together, by region: the root mean square of error over stated deviation, its
    standard deviation by the repeats', the share of errors within two deviations, and the values'
    number, where they are enough."""
    by_region: dict[str, list[Array]] = {}
    for found in measured:
        over = errors_over_std(found)
        for name, where in regions(found.angles_deg).items():
            by_region.setdefault(name, []).append(over[where].ravel())
    out = {}
    for name, each in by_region.items():
        z = np.concatenate(each)
        if len(z) < FEWEST:
            continue
        square = float(np.mean(z**2))
        # the repeats are independent, the cells of one are not
        sums = np.array([np.sum(part**2) - square * len(part) for part in each])
        doubt = np.sqrt((sums**2).sum() * len(each) / max(len(each) - 1, 1)) / len(z)
        out[name] = {
            "rms": round(float(np.sqrt(square)), 3),
            "rms_std": round(float(doubt / (2 * np.sqrt(square))), 3),
            "within_two": round(float(np.mean(abs(z) < 2)), 4),
            "values": len(z),
        }
    return out
