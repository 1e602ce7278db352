"""Normals of shells from simulated photographs, by every method, against the truth; and the shared
photographs of real objects.

    python benchmarks/stereo.py -o stereo.json [--shared ../shared]

The photographs are made here: a far camera, film optics of the built-in shells between the true
directions (no model and no table of this library), cast shadows of the plate, photon noise, 8 bits
of sRGB or 16 linear. The models are fitted to `simulate_specimen` on its grid of 5 degrees.
"""

from __future__ import annotations

import argparse
import json
import time
import warnings
from pathlib import Path
from tempfile import TemporaryDirectory

import cv2
import numpy as np
import torch

import raden_torch as rt
from raden_torch.brdf.files.display import srgb_coded
from raden_torch.capture.photo.ball import ball_from_mask
from raden_torch.capture.photo.capture_lights import capture_lights
from raden_torch.capture.photo.capture_normals import capture_normals, read_lit_set
from raden_torch.capture.photo.lamps import Lamps, write_lamps
from raden_torch.capture.photo.matt_reference import angle_deg, sphere_normals
from raden_torch.capture.photo.photometric_stereo import solve_normals
from raden_torch.measurement.colour_conversion import xyz_to_rgb_matrix
from raden_torch.optics.specimens import SPECIMENS, reflectance_factors
from raden_torch.stereo.alternating import alternate
from raden_torch.stereo.capture_model_normals import ModelOptions, capture_model_normals
from raden_torch.stereo.observed_light import sampled, shown
from raden_torch.stereo.photographed import Photographed

Array = np.ndarray
MATT = ("least-squares", "selection", "robust")
CASES = [
    *((name, "sphere", 12, bits) for name in ("yakogai", "awabi") for bits in (8, 16)),
    *((name, "plate", 12, bits) for name in ("yakogai", "awabi") for bits in (8, 16)),
    *(("yakogai", "plate", count, 16) for count in (3, 4, 6, 24)),
]


def unit(v: Array) -> Array:
    return v / np.linalg.norm(v, axis=-1, keepdims=True)


def raden_angles(normal: Array, light: Array, view: Array) -> Array:
    """`[P, 3]` incidence, receiving, tilt in degrees, by signed angles about L × V."""
    axis = unit(np.cross(light, view))
    lean = (normal * axis).sum(-1)
    flat = unit(normal - lean[:, None] * axis)

    def turned(a: Array, b: Array) -> Array:
        return np.arctan2((np.cross(a, b) * axis).sum(-1), (a * b).sum(-1))

    a, r = turned(light, flat), turned(flat, view)
    found = np.stack([a, r, np.arcsin(np.clip(lean, -1, 1))], -1)
    return np.degrees(np.where(a < 0, -1, 1)[:, None] * found)


def lamps_around(count: int) -> Array:
    """`[count, 3]`: 15 to 65 degrees from the camera's axis, on all sides."""
    k = np.arange(count)
    away, turn = np.radians(15 + 50 * (0.618 * k % 1)), 2 * np.pi * k / count + 0.3 * (k % 2)
    return np.stack([np.sin(away) * np.cos(turn), np.sin(away) * np.sin(turn), np.cos(away)], 1)


def sphere(side: int) -> tuple[Array, Array, Array | None]:
    x = (np.arange(side) + 0.5) / side * 2.1 - 1.05
    y, x = np.meshgrid(-x, x, indexing="ij")
    square = x * x + y * y
    return np.stack([x, y, np.sqrt(np.clip(1 - square, 0, None))], -1), square < 0.97, None


def plate(side: int) -> tuple[Array, Array, Array | None]:
    """Bumps up to 38 degrees steep, and their height in pixels, for cast shadows."""
    x = np.arange(side) * 96 / side
    y, x = np.meshgrid(-x, x, indexing="ij")
    a, b, high = 0.12, 0.17, 4.0
    height = high * np.sin(a * x) * np.cos(b * y)
    p = high * a * np.cos(a * x) * np.cos(b * y)
    q = -high * b * np.sin(a * x) * np.sin(b * y)
    normal = unit(np.stack([-p, -q, np.ones_like(p)], -1))
    return normal, np.ones((side, side), bool), height * side / 96


def unshadowed(height: Array, light: Array) -> Array:
    row, column = np.indices(height.shape)
    lit = np.ones(height.shape)
    for step in range(1, 60):
        r = np.clip(np.rint(row - light[1] * step), 0, len(height) - 1).astype(int)
        c = np.clip(np.rint(column + light[0] * step), 0, len(height) - 1).astype(int)
        lit[height[r, c] > height + light[2] * step + 0.3] = 0
    return lit


def photographed(folder: Path, name: str, shape: str, count: int, bits: int, side: int) -> Array:
    """Write photographs, lights.json and mask.png; returns the true normals `[H, W, 3]`."""
    normal, mask, height = {"sphere": sphere, "plate": plate}[shape](side)
    lamps, rng = lamps_around(count), np.random.default_rng(count + bits)
    view = np.array([0.0, 0.0, 1.0])
    pictures = np.zeros((count, side, side, 3))
    for lamp, picture in zip(lamps, pictures, strict=True):
        facing = (normal @ lamp).clip(0) * (1 if height is None else unshadowed(height, lamp))
        lit = mask & (facing > 1e-3)
        light, to = (np.broadcast_to(d, (lit.sum(), 3)) for d in (lamp, view))
        xyz = reflectance_factors(SPECIMENS[name], raden_angles(normal[lit], light, to)) / 100
        picture[lit] = (xyz @ xyz_to_rgb_matrix().T) * facing[lit][:, None]
    linear = pictures * 0.9 / np.quantile(pictures[:, mask].max(-1), 0.99)
    linear += 0.002 * np.sqrt(abs(linear) + 0.01) * rng.normal(size=linear.shape)
    linear = linear.clip(0, 1)
    if bits == 8:
        stored = np.rint(255 * srgb_coded(torch.from_numpy(linear)).numpy()).astype(np.uint8)
    else:
        stored = np.rint(65535 * linear).astype(np.uint16)
    for k, picture in enumerate(stored):
        cv2.imwrite(str(folder / f"photo{k:02d}.png"), picture[..., ::-1])
    cv2.imwrite(str(folder / "mask.png"), 255 * mask.astype(np.uint8))
    write_lights(folder / "lights.json", lamps)
    return normal


def write_lights(path: Path, lamps: Array) -> None:
    names = tuple(f"photo{k:02d}.png" for k in range(len(lamps)))
    write_lamps(Lamps(lamps, np.ones(len(lamps)), names=names), path)


def off_deg(found: torch.Tensor, true: Array, mask: Array) -> Array:
    there = found[0, :, torch.from_numpy(mask)].double()
    return angle_deg(there, torch.from_numpy(true[mask].T)).numpy()


def solved(
    folder: Path, photos: list[Path], mask: Path, method: str, coded: str, model: Path | None
) -> rt.GBuffer:
    lights = folder / "lights.json"
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        if method in MATT:
            return capture_normals(
                photos, lights, mask, method=method, coded=coded, keep_order=True
            ).surface
        chosen = None if method == "alternating" else model
        options = ModelOptions(model=chosen, coded=coded, keep_order=True)
        return capture_model_normals(photos, lights, mask, options).surface


def simulated_case(models: dict[str, Path], case: tuple, side: int) -> dict:
    name, shape, count, bits = case
    row = {"material": name, "shape": shape, "lamps": count, "bits": bits, "simulated": True}
    with TemporaryDirectory() as made:
        folder = Path(made)
        true = photographed(folder, *case, side)
        photos, mask = sorted(folder.glob("photo*.png")), folder / "mask.png"
        inside = cv2.imread(str(mask), 0) > 127
        for method in (*MATT, "alternating", "model"):
            if method == "alternating" and count < 6:
                continue
            started = time.perf_counter()
            coded = "srgb" if bits == 8 else "linear"
            found = solved(folder, photos, mask, method, coded, models[name])
            seconds = time.perf_counter() - started
            off = off_deg(found.normal, true, inside)
            said = found.error_deg[0, 0].numpy()[inside]
            row[method] = {
                "median_deg": round(float(np.median(off)), 3),
                "q95_deg": round(float(np.quantile(off, 0.95)), 3),
                "said_median_deg": round(float(np.median(said)), 3),
                "within_said": round(float((off < said).mean()), 3),
                "within_twice_said": round(float((off < 2 * said).mean()), 3),
                "pixels_per_s": round(len(off) / seconds),
            }
    print(json.dumps(row), flush=True)
    return row


def grey_sphere(shared: Path) -> dict:
    """The shared photographs of a grey sphere, whose outline tells its normals."""
    data, row = shared / "data/photometric_stereo", {"object": "grey sphere (real)"}
    with TemporaryDirectory() as made:
        folder = Path(made)
        chrome, grey = ([data / f"{n}.{k}.png" for k in range(12)] for n in ("chrome", "gray"))
        lamps = capture_lights(chrome, [data / "chrome.mask.png"], coded="linear").lamps
        write_lamps(lamps, folder / "lights.json", made_from=chrome)
        mask = data / "gray.mask.png"
        picture = cv2.imread(str(mask), 0).astype(np.float32) / 255
        normal, _ = sphere_normals(ball_from_mask(picture, name=mask), picture.shape)
        true = normal[0].movedim(0, -1).double().numpy()
        inside = (true[..., 2] > np.sqrt(1 - 0.95**2)) & (picture > 0.5)
        for method in (*MATT, "alternating"):
            found = solved(folder, grey, mask, method, "linear", None)
            off = off_deg(found.normal, true, inside)
            row[method] = {
                "median_deg": round(float(np.median(off)), 3),
                "q95_deg": round(float(np.quantile(off, 0.95)), 3),
            }
    print(json.dumps(row), flush=True)
    return row


def held_out(shared: Path, name: str) -> dict:
    """Real photographs without known normals: each is left out in turn and predicted from the
    others, by its lamp; the error is relative to the mean of what was photographed."""
    data, row = shared / "data/photometric_stereo", {"object": f"{name} (real), held out"}
    off: dict[str, list[Array]] = {"robust": [], "alternating": []}
    mask = data / f"{name}.mask.png"
    with TemporaryDirectory() as made, warnings.catch_warnings():
        warnings.simplefilter("ignore")
        folder, every = Path(made), list(range(12))
        chrome = [data / f"chrome.{k}.png" for k in every]
        lamps = capture_lights(chrome, [data / "chrome.mask.png"], coded="linear").lamps
        photos = [data / f"{name}.{k}.png" for k in every]
        write_lamps(lamps, folder / "lights.json")
        seen = Photographed.of(read_lit_set(photos, folder / "lights.json", mask, coded="linear"))
        light = sampled(seen.sample, 2000)
        for out in every:
            kept, left = light.under([k for k in every if k != out]), light.under([out])
            matt = solve_normals(
                kept.value[:, :, None],
                kept.light[:, :, 0],
                intensity=kept.strength[:, 0, 0],
                saturated=kept.usable[:, :, None] == 0,
            )
            normal, albedo = matt.normal[0, :, 0], matt.albedo[0, :, 0]
            facing = (normal * left.light[0]).sum(0).clamp(min=0) * left.strength[0]
            found = alternate(kept)
            radiance = shown(found.table.material, found.found.normal, left)[0] * found.found.gain
            true = left.value[0]
            for method, predicted in (("robust", albedo * facing), ("alternating", radiance)):
                off[method].append(((predicted - true).abs().mean(0) / true.mean()).numpy())
    for method, each in off.items():
        row[method] = {
            "median": round(float(np.median(np.concatenate(each))), 4),
            "q90": round(float(np.quantile(np.concatenate(each), 0.9)), 4),
            "median_of_each": [round(float(np.median(one)), 4) for one in each],
        }
    print(json.dumps(row), flush=True)
    return row


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("-o", "--output", type=Path, required=True)
    parser.add_argument("--shared", type=Path, default=Path("../shared"))
    parser.add_argument("--side", type=int, default=64)
    options = parser.parse_args()
    with TemporaryDirectory() as made:
        models = {}
        for name in ("yakogai", "awabi"):
            models[name] = Path(made) / f"{name}.safetensors"
            rt.save_model(rt.fit(rt.simulate_specimen(name)).model, models[name])
        rows = [simulated_case(models, case, options.side) for case in CASES]
    if (options.shared / "data/photometric_stereo").is_dir():
        rows.append(grey_sphere(options.shared))
        rows += [held_out(options.shared, name) for name in ("buddha", "gray")]
    options.output.write_text(json.dumps(rows, indent=1) + "\n")


if __name__ == "__main__":
    main()
