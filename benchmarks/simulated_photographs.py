"""Where does the error of a BRDF from photographs come from? On simulated photographs, whose truth
is known: measured as a person would, then with the true camera, lamps and colours in turn.

    raden capture simulate -o DIR --material yakogai     (and the commands that it prints, in DIR)
    python benchmarks/simulated_photographs.py DIR …
"""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import numpy as np

from raden_torch.measurement import native_csv

STEPS = {"camera": "camera.json", "lamps": "lights.json", "colours": "colour.json"}
RUNS = {"as found": (), **{f"true {step}": (step,) for step in STEPS}, "all true": tuple(STEPS)}


def main(folders: list[str]) -> None:
    for folder in map(Path, folders):
        truth = json.loads((folder / "truth.json").read_text())
        write_true_files(folder, truth)
        print(f"{folder.name}: {truth['material']}; median relative error, % (bias, %)")
        for name, true in RUNS.items():
            print(f"  {name:14s}", "  ".join(errors(folder, truth, true)), flush=True)


def write_true_files(folder: Path, truth: dict) -> None:
    """What the earlier steps would have written if they made no error."""
    found = {step: json.loads((folder / file).read_text()) for step, file in STEPS.items()}
    found["camera"]["camera_matrix_px"] = truth["camera"]["matrix"]
    found["camera"]["distortion"] = truth["camera"]["distortion"]
    found["lamps"]["camera_matrix_px"] = truth["camera"]["matrix"]
    found["lamps"]["camera_distortion"] = truth["camera"]["distortion"]
    for lamp, true in zip(found["lamps"]["lamps"], truth["lamps"], strict=True):
        lamp["direction_to_lamp"] = true["direction_from_specimen"]
        lamp["intensity"] = true["irradiance"] / np.pi
    found["colours"]["method"] = "least squares"
    found["colours"]["matrix"] = np.linalg.inv(truth["camera"]["rgb_from_xyz"]).tolist()
    for step, content in found.items():
        (folder / f"true_{STEPS[step]}").write_text(json.dumps(content))


def errors(folder: Path, truth: dict, true: tuple[str, ...]) -> list[str]:
    """By region, of the measurement made with some true files."""
    files = {step: ("true_" if step in true else "") + file for step, file in STEPS.items()}
    photos = sorted(p.name for p in folder.glob("lamp_??.png"))
    sample, white = ["--shape", "sphere", "--mask", "mask_specimen.png"], ["--white-mask"]
    sample += ["--radius", str(truth["specimen"]["radius_mm"])]
    white += ["mask_white.png", "--white-factor", str(truth["white_factor"])]
    made_with = ["--camera", files["camera"], "--lights", files["lamps"]]
    made_with += ["--colour", files["colours"], "--simulated", "-o", "true_brdf.csv"]
    command = [sys.executable, "-m", "raden_torch.cli", "capture", "brdf", *photos]
    subprocess.run([*command, *sample, *white, *made_with], cwd=folder, check=True,
                   capture_output=True)  # fmt: skip
    found = native_csv.read(folder / "true_brdf.csv")
    wanted = native_csv.read(folder / truth["measurement"])
    a, r, t = found.incidence_deg, found.receiving_deg, found.tilt_deg
    off = found.values / wanted.values[rows(wanted, found)] - 1
    grazing = np.maximum(np.maximum(a, abs(r)), abs(t)) >= 60
    ridge, retro = (abs(r - a) < 10) & ~grazing, (abs(r + a) < 10) & ~grazing
    regions = {"ridge": ridge, "body": ~(ridge | retro | grazing), "grazing": grazing,
               "retro": retro}  # fmt: skip
    return [
        f"{name} {100 * np.median(abs(off[use])):.2f} ({100 * np.median(off[use]):+.2f}, "
        f"{use.sum()} cells)"
        for name, inside in regions.items()
        for use in [inside & found.valid]
    ]


def rows(wanted: native_csv.BrdfMeasurement, found: native_csv.BrdfMeasurement) -> list[int]:
    angles = [
        np.round(np.stack([m.incidence_deg, m.receiving_deg, m.tilt_deg], 1), 3).tolist()
        for m in (wanted, found)
    ]
    number = {tuple(row): k for k, row in enumerate(angles[0])}
    return [number[tuple(row)] for row in angles[1]]


if __name__ == "__main__":
    main(sys.argv[1:])
