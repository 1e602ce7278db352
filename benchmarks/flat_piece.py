"""How many photographs of a flat, or bent, piece give the hemisphere? All of it is simulated.

    python benchmarks/flat_piece.py --shell yakogai --out DIR
    python benchmarks/flat_piece.py --choices --out DIR
    python benchmarks/flat_piece.py --photographs FOLDER --out DIR

Each plan is `raden capture guide`'s. The photographs are those of the ray caster in
tests/capture/photo/brdf/conftest.py, or (`--photographs`) of a folder that `raden capture simulate
--plan` made and its commands went through; `raden capture brdf --scattered` and `raden fit --assume
isotropic+reciprocal` do the rest. The error is that of Y at 4000 random pairs of directions within
80 degrees of the normal, over Y, or over 1 % of the highest Y where it is darker. `--choices`
compares ways to choose the places, on readings of the shell's own values with 1 % of noise.
`--materials` takes, of real materials that were measured in 12,000 directions, those nearest to
what the photographs of one plan hold, declared isotropic, and reciprocal, too; the rest is the
score.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import torch

import raden_torch as rt
from raden_torch.capture.exchange import load_measurement
from raden_torch.capture.photo.capture_brdf import capture_brdf
from raden_torch.capture.photo.guide.choice import hemisphere_deg
from raden_torch.capture.photo.guide.piece import Piece
from raden_torch.capture.photo.guide.plan import Plan, plan_photographs
from raden_torch.capture.photo.guide.set_up import SetUp, stances
from raden_torch.capture.photo.simulation.materials import material_of
from raden_torch.capture.photo.simulation.mitsuba_table import Table
from raden_torch.capture.photo.simulation.simulated_angles import directions
from raden_torch.colorimetry import D65_XYZ
from raden_torch.files import written_beside
from raden_torch.measurement import BrdfMeasurement, Metadata
from raden_torch.measurement.colour_conversion import xyz_of_f_r
from raden_torch.reflectance.log_readings import FLOOR, LogReadings
from raden_torch.reflectance.symmetric_kriging import ISOTROPIC, RECIPROCAL, SymmetricKriging

sys.path.insert(0, str(Path(__file__).parents[1] / "tests/capture/photo/brdf"))

DATA = Path(__file__).resolve().parents[2] / "shared/data/whole_hemisphere"
COUNTS = (10, 20, 40, 70, 100)
FLOOR_SHARE = 0.01
SET_UPS = {
    "hand": (Piece.flat(100, 80), SetUp("hand", 350.0)),
    "turntable": (Piece.flat(100, 80), SetUp("turntable", 350.0)),
    "rod": (Piece.rod(100, 20), SetUp("still", 350.0)),
}
_QUERIES = hemisphere_deg(4000, seed=5)
_LIGHT, _VIEW = directions(*np.radians(_QUERIES.T))
_TABLE_STEP_DEG, _TABLE_TO_DEG = 2.5, 85.0


def main() -> None:
    options = argparse.ArgumentParser(description=__doc__)
    options.add_argument("--out", type=Path, default=Path())
    options.add_argument("--shell", default="yakogai")
    options.add_argument("--set-up", nargs="*", default=list(SET_UPS))
    options.add_argument("--counts", nargs="*", type=int, default=list(COUNTS))
    options.add_argument("--choices", action="store_true")
    options.add_argument("--materials", action="store_true")
    options.add_argument("--photographs", type=Path)
    said = options.parse_args()
    said.out.mkdir(parents=True, exist_ok=True)
    rows: list[dict[str, object]] = []
    if said.choices:
        rows = choices(said.shell)
        name = f"choices_{said.shell}"
    elif said.materials:
        rows = materials()
        name = "materials"
    elif said.photographs is not None:
        rows = of_folder(said.photographs, said.counts)
        name = "mitsuba"
    else:
        for set_up in said.set_up:
            rows += analytic(said.shell, set_up, said.counts)
        name = f"flat_{said.shell}"
    with written_beside(said.out / f"{name}.json") as temporary:
        temporary.write_text(json.dumps(rows, indent=1) + "\n")
    if not said.materials:
        draw([said.out / f"{name}.json"], said.out / f"{name}.png")


def report(row: dict[str, object]) -> dict[str, object]:
    print({k: round(v, 4) if isinstance(v, float) else v for k, v in row.items()}, flush=True)
    return row


def errors(found: np.ndarray, truth: np.ndarray) -> dict[str, float]:
    """Median and 90 % quantile, and the median in the box of 70 degrees and outside it."""
    off = abs(found - truth) / np.maximum(truth, FLOOR_SHARE * truth.max())
    box = (abs(_QUERIES) <= 70).all(axis=1)
    return {
        "median": float(np.median(off)),
        "p90": float(np.quantile(off, 0.9)),
        "within_70_deg": float(np.median(off[box])),
        "beyond": float(np.median(off[~box])),
    }


def fitted(measurement: BrdfMeasurement, truth: np.ndarray) -> dict[str, object]:
    """The error of the model that is fitted to a measurement."""
    result = rt.fit(measurement, assume=RECIPROCAL)
    at = (torch.from_numpy(np.radians(column))[None, :, None] for column in _QUERIES.T)
    with torch.no_grad():
        f_r = result.model.fit_form(*at)[:, :, 0].T.numpy()
    shares = result.report.hemisphere
    return {
        "readings": int(measurement.valid.sum()),
        **errors(xyz_of_f_r(f_r)[:, 1], truth),
        "expected": shares.expected_error,
        "measured_share": shares.measured,
        "guessed_share": shares.guessed,
    }


@cache
def shell_table(name: str) -> Table:
    """A shell's f_r to 85 degrees, trilinear, for the ray caster: X, Y, Z over the white's."""
    a = np.arange(0, _TABLE_TO_DEG + 1, _TABLE_STEP_DEG)
    both = np.arange(-_TABLE_TO_DEG, _TABLE_TO_DEG + 1, _TABLE_STEP_DEG)
    t = both[both >= 0]  # the shells look the same from either side
    nodes = np.stack(np.meshgrid(a, both, t, indexing="ij"), -1)
    half = rt.simulate_specimen(name, geometries_deg=nodes.reshape(-1, 3)).values
    half = (half / (np.pi * D65_XYZ)).reshape(*nodes.shape[:3], 3)
    whole = np.concatenate([half[:, :, :0:-1], half], axis=2)
    first = np.radians([0, -_TABLE_TO_DEG, -_TABLE_TO_DEG])
    return Table(first, np.radians([_TABLE_STEP_DEG] * 3), whole.astype(np.float32))


def analytic(shell: str, set_up: str, counts: list[int]) -> list[dict[str, object]]:
    """Photographs of the ray caster by one plan; the first of them, and more and more."""
    piece, how = SET_UPS[set_up]
    plan = plan_photographs(piece, how, max(counts), assume=RECIPROCAL, name=shell)
    table = shell_table(shell)
    # the channels stand for R, G and B: Y of the model is that of the same mixture
    truth = xyz_of_f_r(table.at(_LIGHT, _VIEW))[:, 1]
    rows = []
    with tempfile.TemporaryDirectory() as folder:
        series = cast(Path(folder), plan, table)
        for count in counts:
            measured = measure(series, count, rod=set_up == "rod")
            row = {"shell": shell, "set_up": set_up, "photographs": count}
            rows.append(report(row | {"forecast": float(plan.expected[count])}
                               | fitted(measured, truth)))  # fmt: skip
    return rows


def cast(folder: Path, plan: Plan, table: Table) -> object:
    """The ray caster's photographs."""
    import conftest as caster

    rod = plan.piece.shape == "cylinder"
    top = np.array([0.07, 0.06, -caster.ROD_RADIUS_M if rod else 0.0])
    lamps, poses = caster.planned_places(plan.stances, top)

    def brdf(normal: np.ndarray, light: np.ndarray, view: np.ndarray) -> np.ndarray:
        helper = np.where(abs(normal[:, :1]) < 0.7, [[1.0, 0, 0]], [[0.0, 1, 0]])
        x = caster.unit(np.cross(helper, normal))
        frame = np.stack([x, np.cross(normal, x), normal], 1)
        light, view = ((frame @ way[..., None])[..., 0] for way in (light, view))
        return table.at(light, view)

    return caster.board_photographs(folder, lamps, poses, rod=rod, brdf=brdf)


def measure(series: object, count: int, *, rod: bool) -> BrdfMeasurement:
    """`raden capture brdf --scattered` of the first photographs; camera and lamps are known."""
    import conftest as caster

    of = caster.board_setup(series, rod=rod)
    of["photographs"] = series.photos[:count]
    of["setup"] = replace(of["setup"], lamps=tuple(range(1, count + 1)))
    metadata = Metadata("shell", simulated=True)
    return capture_brdf(**of, scattered=True, go_on=True, metadata=metadata).read


def of_folder(folder: Path, counts: list[int]) -> list[dict[str, object]]:
    """Of a folder of `raden capture simulate --plan` in which its commands were given: measured
    again from the first photographs, from the command line."""
    truth = json.loads((folder / "truth.json").read_text())
    table = material_of(truth["material"]).table
    assert table is not None
    y = 100 * np.pi * table.at(_LIGHT, _VIEW)[:, 1]
    region, white = (" ".join(f"{a:g},{b:g}" for a, b in truth[what]["region_m"])
                     for what in ("specimen", "white"))  # fmt: skip
    command = [sys.executable, "-m", "raden_torch.cli", "capture", "brdf"]
    options = ["--shape", "plane", "--region", region, "--white-region", white]
    options += ["--camera", "poses.json", "--lights", "lights.json", "--lamps-stand", "board"]
    options += ["--lights-seen-in", "chart_2.png", "--colour", "colour.json", "--scattered"]
    options += ["--white-factor", str(truth["white_factor"]), "--simulated", "--plan", "plan.json"]
    poses = json.loads((folder / "poses.json").read_text())["poses"]
    posed = {pose["file"] for pose in poses}  # the board is not found in every photograph
    rows = []
    for count in counts:
        kept = [k + 1 for k in range(count) if f"view_{k + 1:03d}.png" in posed]
        out = f"first_{count}.csv"
        while True:
            photos = [f"view_{k:03d}.png" for k in kept]
            numbers = [word for k in kept for word in ("--lamp", str(k))]
            done = subprocess.run(
                [*command, *photos, *numbers, *options, "-o", out],
                cwd=folder, check=False, capture_output=True, text=True,
            )  # fmt: skip
            if done.returncode == 0:
                break
            print(done.stderr.strip(), flush=True)
            wrong = next(k for k in kept if f"view_{k:03d}.png: " in done.stderr)
            kept.remove(wrong)  # as a person does whose lamp was not found where it stood
        row = {"shell": truth["material"], "set_up": "hand, Mitsuba", "photographs": count}
        row |= {"used": len(kept)}
        rows.append(report(row | fitted(load_measurement(folder / out), y)))
    return rows


def choices(shell: str) -> list[dict[str, object]]:
    """Expected error, new cells, and chance, of the same places of camera and lamp."""
    piece, how = SET_UPS["hand"]
    plan = plan_photographs(piece, how, max(COUNTS), assume=RECIPROCAL)
    places = stances(how, piece.reach_mm)
    every = [piece.angles_deg(np.array(s.lamp_mm), np.array(s.camera_mm)) for s in places]
    orders = {
        "expected error": plan.readings,
        "new cells": [every[k] for k in most_new_cells(every, max(COUNTS))],
        "chance": [every[k] for k in np.random.default_rng(1).permutation(len(every))],
    }
    truth = rt.simulate_specimen(shell, geometries_deg=_QUERIES).values[:, 1]
    rows = []
    for name, readings in orders.items():
        for count in COUNTS:
            angles = np.concatenate(readings[:count])
            measured = rt.simulate_specimen(shell, geometries_deg=angles, noise=0.01)
            logs = LogReadings.of(angles, measured.values, measured.std)
            process = SymmetricKriging.of(logs, RECIPROCAL)
            found = np.exp(process(_QUERIES)[:, 1]) - FLOOR
            row = {"shell": shell, "set_up": name, "photographs": count, "readings": len(angles)}
            rows.append(report(row | errors(found, truth)))
    return rows


def materials() -> list[dict[str, object]]:
    """Of 100 photographs of one plan, by what is declared."""
    from scipy.spatial import cKDTree

    piece, how = SET_UPS["hand"]
    plan = plan_photographs(piece, how, max(COUNTS), assume=RECIPROCAL)
    wanted = np.concatenate(plan.readings)
    rows = []
    for path in sorted(DATA.glob("*.hemisphere.csv")):
        measured = load_measurement(path)
        angles, values = measured.angles_deg, measured.values
        near = np.unique(cKDTree(angles).query(wanted)[1])
        rest = np.setdiff1d(np.arange(len(angles)), near)
        truth = values[rest, 1]
        for assume in (ISOTROPIC, RECIPROCAL):
            process = SymmetricKriging.of(LogReadings.of(angles[near], values[near]), assume)
            found = np.maximum(np.exp(process(angles[rest])[:, 1]) - FLOOR, 0)
            off = abs(found - truth) / np.maximum(truth, FLOOR_SHARE * truth.max())
            row = {"shell": path.name.split(".")[0], "set_up": assume, "photographs": 100}
            row |= {"readings": len(near), "median": float(np.median(off))}
            rows.append(report(row | {"p90": float(np.quantile(off, 0.9))}))
    return rows


def most_new_cells(every: list[np.ndarray], count: int) -> list[int]:
    """Greedy by cells of 5 degrees that no photograph has read, as `raden capture brdf` suggests;
    the declared symmetries' images count as read."""
    from raden_torch.reflectance.symmetric_kriging import symmetric_images

    cells = [{tuple(c) for c in np.rint(symmetric_images(a, RECIPROCAL) / 5).astype(int).tolist()}
             for a in every]  # fmt: skip
    read: set[tuple[int, ...]] = set()
    chosen = []
    for _ in range(count):
        best = max(range(len(cells)), key=lambda k: len(cells[k] - read))
        chosen.append(best)
        read |= cells[best]
    return chosen


def draw(files: list[Path], path: Path) -> None:
    """Median error against photographs, a line a set-up."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(6.4, 4.2), dpi=120, layout="constrained")
    ax = figure.subplots()
    rows = [row for file in files for row in json.loads(file.read_text())]
    names = list(dict.fromkeys((row["shell"], row["set_up"]) for row in rows))
    for shell, set_up in names:
        of = [row for row in rows if (row["shell"], row["set_up"]) == (shell, set_up)]
        ax.plot([row["photographs"] for row in of], [100 * row["median"] for row in of], "o-",
                markersize=4, label=f"{shell}, {set_up}")  # fmt: skip
    ax.set_xlabel("photographs")
    ax.set_ylabel("median error of Y over the hemisphere (%)")
    ax.set_yscale("log")
    ax.set_xlim(0)
    ax.set_yticks([0.2, 0.3, 0.5, 1, 2, 3, 5])
    ax.yaxis.set_major_formatter("{x:g}")
    ax.yaxis.set_minor_formatter("")
    ax.grid(color="0.9", linewidth=0.5)
    ax.legend(fontsize=8)
    ax.set_title("simulated shells", fontsize=9)
    figure.savefig(path)


if __name__ == "__main__":
    main()
