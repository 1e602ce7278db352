"""A photographed inlay whose shells are learnt from the photographs, relit under lamps that were
held out, against the truth; beside it the same with the shells' models given.

    python benchmarks/learnt_inlay.py -o learnt_inlay.json

The photographs are those of `benchmarks/inlay.py`, simulated. One lamp is held out that stands
among the others, one at 75 degrees from the camera's axis, where no lamp stands. The photographs'
value of a white diffuser is given (`white`), so that the scale is the truth's.
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
from inlay import SHELLS, artwork, delta_e, fitted, photographed, radiance, relit
from stereo import lamps_around

from raden_torch.artwork.cutting import PieceMaps
from raden_torch.stereo.capture_texture import TextureOptions, capture_texture
from raden_torch.stereo.inlay_file import write_inlay

Array = np.ndarray
CASES = ((True, True), (False, True), (True, False))
"""With a map, and with a normal a pixel."""
OUTSIDE = np.array([np.sin(np.radians(75)), 0.0, np.cos(np.radians(75))])


def white_of(maps: PieceMaps, lamps: Array) -> float:
    """What the photographs of `photographed` show of a white diffuser that faces the lamp."""
    bright = np.stack([radiance(maps, lamp) for lamp in lamps]).max(-1)
    return float(0.9 / np.quantile(bright, 0.995))


def case(
    folder: Path, maps: PieceMaps, count: int, models: tuple[Path, ...], by_map: bool, pixel: bool
) -> dict:
    solid = maps.coverage[0].numpy() > 0.99
    lamps = lamps_around(count + 1)
    out, lamps = lamps[count // 2], np.delete(lamps, count // 2, 0)
    photos = photographed(folder, maps, lamps)
    index = np.array([1 + SHELLS.index(name) for name in maps.shells])[maps.shell[0].numpy()]
    shown = np.where(maps.coverage[0].numpy() > 0.5, index, 0).astype(np.uint8)
    cv2.imwrite(str(folder / "map.png"), shown)
    options = TextureOptions(
        models,
        shells=None if models else len(SHELLS),
        white=None if models else white_of(maps, lamps),
        map=folder / "map.png" if by_map else None,
        per_pixel=pixel,
        coded="linear",
    )
    started = time.perf_counter()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        found = capture_texture(photos, folder / "lights.json", None, options)
    row = {
        "simulated": True,
        "lamps": count,
        "palette": "given" if models else "learnt",
        "map": by_map,
        "per_pixel": pixel,
        "shell_right": round(_right(found.inlay.material.numpy(), index.ravel(), solid), 4),
        "seconds": round(time.perf_counter() - started),
    }
    write_inlay(found, folder, photos, options)
    for name, lamp in (("", out), ("outside_", OUTSIDE)):
        off = delta_e(relit(folder, lamp), radiance(maps, lamp))[solid]
        row[f"{name}median_de2000"] = round(float(np.median(off)), 2)
        row[f"{name}q95_de2000"] = round(float(np.quantile(off, 0.95)), 2)
    print(json.dumps(row), flush=True)
    return row


def _right(found: Array, true: Array, solid: Array) -> float:
    """The share of right pixels, each learnt shell being the one that most of its pixels show."""
    found, true = found[solid.ravel()], true[solid.ravel()]
    most = {
        k: np.bincount(true[found == k], minlength=len(SHELLS) + 1).argmax()
        for k in np.unique(found)
        if k > 0
    }
    return float(np.mean([most.get(k, 0) == t for k, t in zip(found, true, strict=True)]))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("-o", "--output", type=Path, required=True)
    parser.add_argument("--side", type=int, default=112)
    parser.add_argument("--lamps", type=int, nargs="+", default=[5, 8, 12, 24])
    parser.add_argument("--learnt-only", action="store_true")
    options = parser.parse_args()
    maps, rows = artwork(options.side), []
    with TemporaryDirectory() as made:
        given = () if options.learnt_only else fitted(Path(made))
        for count in options.lamps:
            for models in ((), given) if given else ((),):
                for by_map, pixel in CASES:
                    rows.append(case(Path(made), maps, count, models, by_map, pixel))
    options.output.write_text(json.dumps(rows, indent=1) + "\n")


if __name__ == "__main__":
    main()
