"""A photographed inlay, relit under a lamp that was held out, against the truth.

    python benchmarks/inlay.py -o inlay.json [--picture inlay.jpg]

The photographs are simulated: pieces of three shells cut by `artwork.cutting`, whose layers lean
within each piece as they do in its sheet, and black urushi around them; film optics of the built-in
shells between the true directions (for the lacquer its own formula), photon noise, 16 bits. The
models are fitted to `simulate_specimen` on its grid of 5 degrees. ΔE2000 is taken with the perfect
diffuser that faces the lamp as white.
"""

from __future__ import annotations

import argparse
import json
import time
import warnings
from pathlib import Path
from tempfile import TemporaryDirectory

import colour
import cv2
import numpy as np
import torch
from stereo import lamps_around, raden_angles, unit, write_lights

import raden_torch as rt
from raden_torch.artwork.cutting import PieceMaps, cut
from raden_torch.artwork.flowers import butterfly, chrysanthemum
from raden_torch.brdf.files.gbuffer_file import read_gbuffer
from raden_torch.brdf.materials.urushi import black_urushi
from raden_torch.measurement.colour_conversion import xyz_to_rgb_matrix
from raden_torch.optics.specimens import SPECIMENS, reflectance_factors
from raden_torch.stereo.capture_texture import TextureOptions, capture_texture
from raden_torch.stereo.inlay_file import write_inlay

Array = np.ndarray
SHELLS = ("yakogai", "awabi", "mexican")
VIEW = np.array([0.0, 0.0, 1.0])


def artwork(side: int) -> PieceMaps:
    at = (torch.arange(side, dtype=torch.float64) + 0.5) / (side / 2) - 1
    y, x = torch.meshgrid(-at, at, indexing="ij")
    pieces = [
        *butterfly(0.5, 0.5, 0.45, 2.4, shell="mexican"),
        *butterfly(-0.5, -0.55, 0.45, 0.4, shell="awabi"),
        *chrysanthemum(-0.42, 0.42, 0.5, 8),
    ]
    return cut(pieces, x, y, pixel=2 / side, seed=1)


def radiance(maps: PieceMaps, lamp: Array) -> Array:
    """`[H, W, 3]` of white 1: scene-linear RGB under a lamp of irradiance pi."""
    slope = maps.layer_slope.numpy()
    layers = unit(np.stack([-slope[0], -slope[1], np.ones_like(slope[0])], -1))
    share = maps.coverage[0].numpy()[..., None]
    shell, made = maps.shell[0].numpy(), np.zeros((*share.shape[:2], 3))
    there = (share[..., 0] > 0) & ((layers @ lamp) > 1e-3)
    for place, name in enumerate(maps.shells):
        of = there & (shell == place)
        light, view = (np.broadcast_to(d, (of.sum(), 3)) for d in (lamp, VIEW))
        xyz = reflectance_factors(SPECIMENS[name], raden_angles(layers[of], light, view)) / 100
        made[of] = xyz @ xyz_to_rgb_matrix().T
    maps_of = [torch.tensor(d).float().view(1, 3, 1, 1) for d in (VIEW, lamp, VIEW)]
    ground = np.pi * black_urushi().of_unit_vectors(*maps_of)[0, :, 0, 0].numpy()
    return (share * made + (1 - share) * ground) * lamp[2]


def delta_e(made: Array, true: Array) -> Array:
    to_xyz = np.linalg.inv(xyz_to_rgb_matrix())
    lab = [colour.XYZ_to_Lab(m.clip(0) @ to_xyz.T, [0.3127, 0.329]) for m in (made, true)]
    return colour.delta_E(*lab, method="CIE 2000")


def relit(folder: Path, lamp: Array) -> Array:
    palette = rt.load_model(folder / "palette.safetensors")
    gbuffer = read_gbuffer(folder / "inlay.exr", palette=palette)
    with torch.no_grad():
        image = rt.shade(palette, gbuffer, rt.DirectionalLight(tuple(lamp)))
    return image[0].movedim(0, -1).numpy()


def photographed(folder: Path, maps: PieceMaps, lamps: Array) -> list[Path]:
    rng = np.random.default_rng(len(lamps))
    linear = np.stack([radiance(maps, lamp) for lamp in lamps])
    linear *= 0.9 / np.quantile(linear.max(-1), 0.995)
    linear += 0.002 * np.sqrt(abs(linear) + 0.01) * rng.normal(size=linear.shape)
    photos = []
    for k, picture in enumerate(np.rint(65535 * linear.clip(0, 1)).astype(np.uint16)):
        photos.append(folder / f"photo{k:02d}.png")
        cv2.imwrite(str(photos[-1]), picture[..., ::-1])
    write_lights(folder / "lights.json", lamps)
    return photos


def case(
    folder: Path, maps: PieceMaps, count: int, models: tuple[Path, ...], how: dict
) -> tuple[dict, Array, Array]:
    """A row of the result, and the inlay under the lamp that was held out, as found and true."""
    solid = maps.coverage[0].numpy() > 0.99
    lamps = lamps_around(count + 1)
    out, lamps = lamps[count // 2], np.delete(lamps, count // 2, 0)
    photos, true = photographed(folder, maps, lamps), radiance(maps, out)
    wanted = np.array(maps.shells)[maps.shell[0].numpy()]
    index = np.array([1 + SHELLS.index(name) for name in maps.shells])[maps.shell[0].numpy()]
    shown = np.where(maps.coverage[0].numpy() > 0.5, index, 0).astype(np.uint8)
    cv2.imwrite(str(folder / "map.png"), shown)
    given = folder / "map.png" if how["map"] else None
    options = TextureOptions(models, coded="linear", **{**how, "map": given})
    started = time.perf_counter()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        found = capture_texture(photos, folder / "lights.json", None, options)
    seconds = time.perf_counter() - started
    write_inlay(found, folder, photos, options)
    image = relit(folder, out)
    off = delta_e(image, true)
    names = np.array(["ground", *SHELLS])[found.inlay.material.reshape(solid.shape).numpy()]
    row = {
        "simulated": True,
        "lamps": count,
        **how,
        "shell_right": round(float((names == wanted)[solid].mean()), 4),
        "shell_median_de2000": round(float(np.median(off[solid])), 3),
        "shell_q95_de2000": round(float(np.quantile(off[solid], 0.95)), 3),
        "all_median_de2000": round(float(np.median(off)), 3),
        "pixels_per_s": round(off.size / seconds),
    }
    print(json.dumps(row), flush=True)
    return row, image, true


HOW = (
    {"map": False, "per_pixel": False, "gain": False},
    {"map": False, "per_pixel": False, "gain": True},
    {"map": False, "per_pixel": True, "gain": False},
    {"map": True, "per_pixel": False, "gain": False},
    {"map": True, "per_pixel": True, "gain": False},
)


def fitted(folder: Path) -> tuple[Path, ...]:
    models = tuple(folder / f"{name}.safetensors" for name in SHELLS)
    for name, path in zip(SHELLS, models, strict=True):
        rt.save_model(rt.fit(rt.simulate_specimen(name)).model, path)
    return models


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("-o", "--output", type=Path, required=True)
    parser.add_argument("--picture", type=Path)
    parser.add_argument("--side", type=int, default=112)
    options = parser.parse_args()
    maps, rows, pictures = artwork(options.side), [], []
    with TemporaryDirectory() as made:
        models = fitted(Path(made))
        for count in (5, 8, 12):
            for how in HOW:
                row, image, true = case(Path(made), maps, count, models, how)
                rows.append(row)
                if count == 8 and how["map"]:
                    pictures += [image] if pictures else [true, image]
    options.output.write_text(json.dumps(rows, indent=1) + "\n")
    if options.picture is not None:
        write_picture(pictures, options.picture)


def write_picture(pictures: list[Array], path: Path) -> None:
    shown = np.concatenate(pictures, 1) / np.quantile(pictures[0].max(-1), 0.995)
    coded = np.rint(255 * shown.clip(0, 1) ** (1 / 2.2)).astype(np.uint8)
    large = cv2.resize(coded[..., ::-1], None, fx=2, fy=2, interpolation=cv2.INTER_NEAREST)
    cv2.imwrite(str(path), large, [cv2.IMWRITE_JPEG_QUALITY, 90])


if __name__ == "__main__":
    main()
