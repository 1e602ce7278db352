"""How well does footage by hand measure a flat piece? All of it is simulated.

    python benchmarks/handheld.py -o handheld.json [--frames 120] [--counts 20 40 100]

The footage is that of the caster in tests/capture/photo/handheld: three films of a phone, each
under one lamp beside the card, in Motion JPEG with a tone curve, noise, lens distortion, a wrong
white balance, automatic exposure, and some frames shaken or out of focus; the shell is an analytic
one, isotropic and reciprocal. `raden capture handheld` finds camera, lamps and tone curve, `raden
capture brdf --scattered` measures, `raden fit --assume isotropic+reciprocal` fits. The error is
that of Y at 4000 random pairs of directions within 80 degrees of the normal, over Y, or over 1 % of
the highest Y where it is darker. Cases: with grey patches; without (sRGB assumed); a ball of 8 mm
radius in place of 15 mm; a flash on the camera.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
import torch

import raden_torch as rt
from raden_torch.files import written_beside

sys.path.insert(0, str(Path(__file__).parents[1]))
from tests.capture.photo.brdf.conftest import shell
from tests.capture.photo.handheld import simulated_scene as simulated

LAMPS_M = ((-0.12, -0.05, -0.30), (0.30, 0.10, -0.25), (0.10, 0.35, -0.22))
FLASH_M = (0.014, -0.006, 0.0)
GREY_M = simulated.rectangle(0.02, 0.118, 0.09, 0.132)
REGION = "0.056,0.052 0.108,0.052 0.108,0.090 0.056,0.090"
WHITE = "0.120,0.053 0.140,0.053 0.140,0.089 0.120,0.089"
MIDDLE_M = np.array([0.082, 0.071, 0.0])


def main() -> None:
    options = argparse.ArgumentParser(description=__doc__)
    options.add_argument("-o", "--output", type=Path, required=True)
    options.add_argument("--frames", type=int, default=120)
    options.add_argument("--counts", nargs="*", type=int, default=[20, 40, 100])
    options.add_argument("--cases", nargs="*", default=["greys", "srgb", "small ball", "flash"])
    said = options.parse_args()
    rows = []
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        large = footage(folder / "large", said.frames, 0.015)
        for case in said.cases:
            films = large
            if case in ("small ball", "flash"):
                films = footage(folder / case.replace(" ", "_"), said.frames,
                                0.008 if case == "small ball" else 0.015,
                                flash=case == "flash")  # fmt: skip
            for count in said.counts if case == "greys" else said.counts[-1:]:
                row = {"simulated": True, "case": case} | measured(folder, films, case, count)
                print(json.dumps(row), flush=True)
                rows.append(row)
    with written_beside(said.output) as path:
        path.write_text(json.dumps(rows, indent=1) + "\n")


def footage(folder: Path, frames: int, radius_m: float, *, flash: bool = False) -> list[Path]:
    """Films, one a lamp."""
    folder.mkdir(parents=True)
    phone = simulated.Phone(balance=(1.25, 1.0, 0.8))
    paths = []
    for k, lamp in enumerate(LAMPS_M[:1] if flash else LAMPS_M):
        scene = simulated.Scene(
            lamp_m=None if flash else np.array(lamp),
            flash_m=np.array(FLASH_M) if flash else None,
            grey_m=GREY_M,
            balls_m=((0.155, 0.03, radius_m),),
        )
        path = simulated.hand_path(
            frames, seed=k, shaken=(30, 31, 32, 90), defocused={60: 4.0, 61: 4.0}
        )
        gain = simulated.auto_gains(scene, phone, path, level=0.6, drift=0.01, seed=k)
        out = folder / f"walk{k + 1}.avi"
        paths.append(simulated.write_clip(out, scene, phone, path, gain=gain, seed=k))
    return paths


def measured(folder: Path, films: list[Path], case: str, count: int) -> dict[str, object]:
    """By the commands, as a person would."""
    out, shown = folder / "out", "camera" if case == "flash" else "board"
    radius = 8 if case == "small ball" else 15
    patches = simulated.patches(GREY_M).mean(axis=1)
    greys = [
        f"--grey={x:.5f},{y:.5f},{100 * grey:g}"
        for (x, y), grey in zip(patches, simulated.GREYS, strict=True)
    ]
    said = raden(
        "capture", "handheld", *films, "--squares", "11x9", "--square", "0.016", "--marker",
        "0.012", "--region", REGION, "--white-region", WHITE, "--ball", f"0.156,0.0315,{radius}",
        "--lamps-stand", shown, "--photographs", count, *([] if case == "srgb" else greys),
        "-o", out,
    )  # fmt: skip
    found = json.loads((out / "handheld.json").read_text())
    frames = sorted((out / "frames").iterdir())
    first = next(each["picture"] for each in found["pictures"] if each["kept"])
    stand = [] if case == "flash" else ["--lamps-stand", "board", "--lights-seen-in", first]
    curve = [] if case == "srgb" else ["--response-file", out / "response.json"]
    raden(
        "capture", "brdf", *frames, "--camera", out / "camera.json", "--lights",
        out / "lights.json", *stand, *curve, "--shape", "plane", "--region", REGION,
        "--white-region", WHITE, "--white-factor", "90", "--scattered", "--simulated", "--go-on",
        "-o", folder / "shell.csv",
    )  # fmt: skip
    raden("fit", folder / "shell.csv", "--assume", "isotropic+reciprocal", "-o",
          folder / "shell.safetensors")  # fmt: skip
    lamps = [np.array(lamp["position_m"]) for lamp in found["lamps"]]
    true = [FLASH_M] if case == "flash" else LAMPS_M
    row: dict[str, object] = {
        "photographs": sum(each["kept"] for each in found["pictures"]),
        "looked_at": len(found["pictures"]),
        "said": said.splitlines()[0],
        "lamp_std_deg": [lamp["direction_std_deg"] for lamp in found["lamps"]],
    }
    if case == "flash":
        row["lamp_off_mm"] = (1000 * (lamps[0] - FLASH_M)).round(1).tolist()
    else:
        row["lamp_off_deg"] = [off_deg(a, b) for a, b in zip(lamps, true, strict=True)]
    return row | errors(folder / "shell.safetensors")


def raden(*words: object) -> str:
    command = [sys.executable, "-m", "raden_torch", *map(str, words)]
    done = subprocess.run(command, capture_output=True, text=True)
    if done.returncode:
        raise SystemExit(f"{' '.join(command[:6])} …: {done.stderr.strip()}")
    return done.stdout


def off_deg(found: np.ndarray, true: tuple[float, ...]) -> float:
    a, b = found - MIDDLE_M, np.array(true) - MIDDLE_M
    return round(float(np.degrees(np.arctan2(np.linalg.norm(np.cross(a, b)), a @ b))), 2)


def errors(path: Path) -> dict[str, object]:
    """At random pairs of directions."""
    random = np.random.default_rng(0)
    light, view = (_directions(random, 4000) for _ in range(2))
    normal = np.broadcast_to([0.0, 0.0, 1.0], light.shape)

    def tensor(v: np.ndarray) -> torch.Tensor:
        return torch.tensor(np.ascontiguousarray(v.T[None, :, :, None]), dtype=torch.float32)

    model = rt.load_model(path)
    with torch.no_grad():
        got = model(tensor(normal), tensor(light), tensor(view))[0, :, :, 0].T.double().numpy()
    weights = np.array([0.2126, 0.7152, 0.0722])
    truth, found = shell(normal, light, view) @ weights, got @ weights
    error = abs(found - truth) / np.maximum(truth, 0.01 * truth.max())
    far = np.degrees(np.arccos(np.minimum(light[:, 2], view[:, 2]))) > 70
    return {
        "median": round(float(np.median(error)), 4),
        "p90": round(float(np.quantile(error, 0.9)), 4),
        "within_70_deg": round(float(np.median(error[~far])), 4),
        "beyond": round(float(np.median(error[far])), 4),
    }


def _directions(random: np.random.Generator, count: int) -> np.ndarray:
    z = random.uniform(np.cos(np.radians(80)), 1, count)
    turn, sine = random.uniform(0, 2 * np.pi, count), np.sqrt(1 - z * z)
    return np.stack([sine * np.cos(turn), sine * np.sin(turn), z], 1)


if __name__ == "__main__":
    main()
