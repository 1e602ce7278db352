"""Adding to a catalogue, and finding in it, as it grows: `python benchmarks/catalogue.py [shells]`.

The shells are simulated: models of the five specimens whose channels are scaled at random, so that
each is another file. Times are wall times on this machine, medians over each part of the catalogue;
`write` is an addition without looking at the shell (its colours, its thumbnail): the index, the
file and five fsyncs.
"""

from __future__ import annotations

import json
import platform
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from unittest import mock

import numpy as np
import torch

import raden_torch as rt
from raden_torch.catalogue import Catalogue, ColourQuery, Geometry, indexing
from raden_torch.catalogue.lab_grid import nodes_deg
from raden_torch.geometry import vectors_from_angles
from raden_torch.optics import SPECIMENS

PARTS = 4
SEED = 0
REPEATS = 7


def shells(count: int, folder: Path) -> Iterator[Path]:
    """Simulated models, one file each; the file before is removed."""
    rng = np.random.default_rng(SEED)
    fitted = [
        rt.fit(rt.simulate_specimen(name, step_deg=10), interpolation="trilinear").model
        for name in SPECIMENS
    ]
    bases = [model.table.values.clone() for model in fitted]
    for number in range(count):
        model, base = fitted[number % len(fitted)], bases[number % len(fitted)]
        gain = torch.from_numpy(rng.uniform(0.6, 1.4, 3)).float()
        with torch.no_grad():
            model.table.values.copy_(base * gain)
        path = folder / f"shell_{number:05d}.safetensors"
        rt.save_model(model, path)
        yield path
        path.unlink()


def index_error(model: rt.RadenBrdf, indexed: indexing.Indexed) -> list[float]:
    """ΔE*ab between the index and the model itself at 500 random geometries within 60°."""
    from raden_torch.brdf.materials.surface import Surface, reflected
    from raden_torch.catalogue.lab_grid import (
        INCIDENCE,
        columns_at,
        lab_of_f_r,
        within,
    )

    rng = np.random.default_rng(SEED)
    a = rng.uniform(0, 60, 500)
    kinds = {"mirror direction": a, "anywhere": rng.uniform(-60, 60, 500)}
    errors = []
    for r in kinds.values():
        t = np.zeros(500) if r is a else rng.uniform(-45, 45, 500)
        maps = torch.from_numpy(np.deg2rad([a, r, t])).view(3, 1, 1, -1, 1)
        n, light, view = vectors_from_angles(*maps)
        with torch.no_grad():
            true = lab_of_f_r(reflected(model, Surface(n, view), light)[0, :, :, 0].T.numpy())
        names = [f"lab_{x:02.0f}" for x in INCIDENCE]
        found = []
        for one in zip(a, r, t, strict=True):
            at = Geometry(*map(float, one))
            parts = columns_at(at).items()
            found.append(
                sum(w * within(indexed.lab[None, names.index(c)], at) for c, w in parts)[0]
            )
        errors.append(float(np.median(np.linalg.norm(np.array(found) - true, axis=1))))
    return errors


def timed(work) -> float:
    """Seconds, the median of `REPEATS`."""
    taken = []
    for _ in range(REPEATS):
        start = time.perf_counter()
        work()
        taken.append(time.perf_counter() - start)
    return float(np.median(taken))


def main(count: int) -> None:
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        catalogue = Catalogue(folder / "shells", create=True)
        whole, written = [], []
        look = indexing.index_file
        for path in shells(count, folder):
            start = time.perf_counter()
            looked = 0.0

            def index_file(path, assume=None):
                nonlocal looked
                begun = time.perf_counter()
                found = look(path, assume)
                looked = time.perf_counter() - begun
                return found

            with mock.patch.object(indexing, "index_file", index_file):
                catalogue.add(path)
            whole.append(time.perf_counter() - start)
            written.append(whole[-1] - looked)
        for part in range(PARTS):
            rows = slice(part * count // PARTS, (part + 1) * count // PARTS)
            print(
                f"shells {rows.start:5}…{rows.stop:5}: add {1e3 * np.median(whole[rows]):6.1f} ms, "
                f"of which write {1e3 * np.median(written[rows]):5.1f} ms (mean "
                f"{1e3 * np.mean(written[rows]):.1f}, most {1e3 * np.max(written[rows]):.1f})"
            )
        green = ColourQuery.read("green")
        for text, work in {
            "find green at 40": lambda: catalogue.find(green, Geometry(40), limit=10),
            "find green at 42, receiving 30": lambda: catalogue.find(
                green, Geometry(42, 30), limit=10
            ),
            "find #3fa27c at 40": lambda: catalogue.find(ColourQuery.read("#3fa27c"), limit=10),
            "find all": lambda: catalogue.find(),
        }.items():
            print(f"{text}: {1e3 * timed(work):.1f} ms")
        index = sum(f.stat().st_size for f in (folder / "shells" / "index").iterdir())
        contents = json.loads((folder / "shells" / "catalogue.json").read_text())
        print(f"index: {index / count / 1e3:.1f} kB a shell in {len(contents['segments'])} files")
        measured = rt.simulate_specimen("yakogai", step_deg=5)
        start = time.perf_counter()
        one = rt.fit(measured).model
        fit_s = time.perf_counter() - start
        print(f"a fit takes as long as {fit_s / np.median(whole):.0f} additions of a model")
        rt.save_model(one, folder / "one.safetensors")
        errors = index_error(one, look(folder / "one.safetensors"))
        print("yakogai, ΔE*ab of the index, median: mirror {:.2f}, anywhere {:.2f}".format(*errors))
    print(f"{len(nodes_deg())} nodes; {platform.processor()}, {torch.get_num_threads()} threads")


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 2000)
