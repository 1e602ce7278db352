"""Exported shells in Mitsuba 3: how far its pictures are from ours, how well the plugin samples.

python benchmarks/in_mitsuba.py [--out benchmarks/results] [--size 128] [--picture mitsuba.png]
    [--models shell.safetensors ...]

For each model, by default those of the simulated shells, three pictures of the sphere of `raden
render` with its lamp: ours, the plugin's (`raden export -o .xml`) and that of Mitsuba's `measured`
(`-o .bsdf`). Told are the mean relative difference of the lit pixels; the p-values of Mitsuba's
chi-square test; and, of the sphere in two light setups, seen by samples of the BSDF alone, the mean
variance of a pixel with the cosine's directions over that with the plugin's, and with `measured`'s,
at equal samples. Writes in_mitsuba.json and, where asked, the pictures side by side. Needs the
extra `simulate` and LLVM.
"""

from __future__ import annotations

import argparse
import json
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
import torch

import raden_torch as rt
from raden_torch.arrays import Floats
from raden_torch.brdf.files.display import auto_exposure_ev, to_display, write_picture
from raden_torch.brdf.shading.light_setups import LightSetup, light_setup
from raden_torch.capture.photo.simulation.variants import LLVM
from raden_torch.export.measured.measured_file import export_measured
from raden_torch.export.mitsuba import plugin
from raden_torch.export.mitsuba.check import INCIDENCES_DEG, chi_square, load
from raden_torch.export.mitsuba.lit_sphere import mean_relative_difference, render_sphere
from raden_torch.export.mitsuba.plugin_file import export_plugin
from raden_torch.optics.specimens import SPECIMENS
from raden_torch.pictures import render_shape

SEEDS, SPP = 24, 16
SETUPS: tuple[LightSetup, ...] = ("tent", "window")


def ours(model: rt.RadenBrdf, size: int) -> Floats:
    return render_shape(model, "sphere", size=size)[0].movedim(0, -1).double().numpy()


def variance(mi: Any, bsdf: Any, setup: LightSetup, size: int) -> float:
    """The mean over the sphere and the channels of a pixel's variance, for one sample a pixel."""
    radiance = light_setup(setup).radiance.movedim(0, -1).contiguous().numpy()
    lamp = {"type": "envmap", "bitmap": mi.Bitmap(radiance)}
    by_bsdf = {"type": "direct", "emitter_samples": 0, "bsdf_samples": 1, "hide_emitters": True}
    pictures = np.stack(
        [
            render_sphere(mi, bsdf, size, emitter=lamp, spp=SPP, seed=seed, integrator=by_bsdf)
            for seed in range(SEEDS)
        ]
    )
    return float(SPP * pictures.var(0, ddof=1).mean())


def over_cosine(mi: Any, bsdf: Any, measured: Any, setup: LightSetup) -> dict[str, float]:
    share, plugin.COSINE_SHARE = plugin.COSINE_SHARE, 1.0
    cosine = variance(mi, bsdf, setup, 48)
    plugin.COSINE_SHARE = share
    each = {"plugin": bsdf, "measured": measured}
    return {who: cosine / variance(mi, own, setup, 48) for who, own in each.items()}


def compared(
    name: str, model: rt.RadenBrdf, folder: Path, size: int
) -> tuple[dict[str, Any], list[Floats]]:
    xml, file = folder / f"{name}.xml", folder / f"{name}.bsdf"
    export_plugin(model, xml)
    report = export_measured(model, file)
    bsdf = load(xml, LLVM)
    import mitsuba as mi

    measured = mi.load_dict({"type": "measured", "filename": str(file)})
    pictures = [ours(model, size), *(render_sphere(mi, b, size) for b in (bsdf, measured))]
    own, of_plugin, of_file = pictures
    p_values = {f"{angle:g}": chi_square(bsdf, angle) for angle in INCIDENCES_DEG}
    efficiency = {setup: over_cosine(mi, bsdf, measured, setup) for setup in SETUPS}
    row = {
        "name": name,
        "plugin": mean_relative_difference(of_plugin, own),
        "file": mean_relative_difference(of_file, own),
        "file_report": report.error,
        "file_bytes": report.bytes,
        "chi_square_p": p_values,
        "variance_cosine_over": efficiency,
    }
    return row, pictures


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("benchmarks/results"))
    parser.add_argument("--size", type=int, default=128)
    parser.add_argument("--picture", type=Path)
    parser.add_argument("--models", type=Path, nargs="*", default=[])
    options = parser.parse_args()
    models = {path.stem: rt.load_model(path) for path in options.models}
    if not models:
        models = {name: rt.fit(rt.simulate_specimen(name)).model for name in SPECIMENS}
    rows, columns = [], []
    with tempfile.TemporaryDirectory() as folder:
        for name, model in models.items():
            row, pictures = compared(name, model, Path(folder), options.size)
            rows.append(row)
            print(json.dumps(row), flush=True)
            columns.append(np.concatenate(pictures, 0))
    options.out.mkdir(parents=True, exist_ok=True)
    (options.out / "in_mitsuba.json").write_text(json.dumps(rows, indent=1))
    if options.picture:
        image = torch.from_numpy(np.concatenate(columns, 1)).float().movedim(-1, 0)[None]
        # each model by its own exposure; a strip below for the caption
        each = [to_display(one, auto_exposure_ev(one))[0] for one in image.split(options.size, 3)]
        picture = torch.nn.functional.pad(torch.cat(each, 2), (0, 0, 0, 24))
        simulated = [name for name, model in models.items() if model.provenance.simulated]
        others = [name for name in models if name not in simulated]
        caption = "; ".join(
            [
                *([f"simulated: {', '.join(simulated)}"] if simulated else []),
                *([f"measured: {', '.join(others)}"] if others else []),
                "rows: raden render, Mitsuba's plugin, its measured material",
            ]
        )
        write_picture(picture, options.picture, caption)


if __name__ == "__main__":
    main()
