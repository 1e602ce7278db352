"""A coat over a measured shell against path tracing of a real slab by Mitsuba 3.

python benchmarks/coat_in_mitsuba.py [--out benchmarks/results] [--log2-paths 21]

The slab: a dielectric face a little above a base that evaluates a measurement's table, in Mitsuba's
own vectors and texture (`table_bsdf`). Radiance towards a viewer under a disc of light of 12°
radius, by paths, against `Coated`'s formula, which has the same table (`Table.at`) as its base,
integrated over the disc. Writes coat_in_mitsuba.json: each geometry and face, three channels,
with the standard error of the paths. Needs the extra `simulate`.
"""

from __future__ import annotations

import argparse
import json
import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

import raden_torch as rt
from raden_torch.brdf.materials.coat import Coated
from raden_torch.capture.photo.simulation.mitsuba_table import Table, table_bsdf, table_of
from raden_torch.capture.photo.simulation.variants import LLVM, mitsuba

INDEX = 1.53
DISC_DEG = 12.0
DISTANCE, HEIGHT = 100.0, 0.01
PAIRS = ((0, 35, 40), (0, 60, 200), (30, 20, 150), (30, 50, 90), (60, 10, 0), (60, 45, 120))
"""Polar angles of viewer and light, and the azimuth between them, degrees: no mirror directions."""
FACES = {"smooth": 0.0, "rough (α 0.1)": 0.1}
_BATCHES = 16
UP = torch.tensor([0.0, 0.0, 1.0], dtype=torch.float64).view(1, 3, 1, 1)


@dataclass(frozen=True, eq=False)
class TableBase:
    """The table as a material, for the normal +z alone."""

    table: Table

    def working_dtype(self, *maps: Tensor) -> torch.dtype:
        return torch.float64

    def of_unit_vectors(self, n: Tensor, l: Tensor, v: Tensor) -> Tensor:  # noqa: E741
        l, v = torch.broadcast_tensors(l.double(), v.double())  # noqa: E741
        rows = [m[0].flatten(1).T.numpy() for m in (l, v)]
        found = torch.from_numpy(np.ascontiguousarray(self.table.at(*rows))).double()
        return found.T.reshape(1, 3, *l.shape[2:])


def direction(polar_deg: float, azimuth_deg: float) -> np.ndarray[Any, Any]:
    a, p = math.radians(polar_deg), math.radians(azimuth_deg)
    return np.array([math.sin(a) * math.cos(p), math.sin(a) * math.sin(p), math.cos(a)])


def formula(table: Table, alpha: float) -> Any:
    """f_r of the coat; without the gloss of a smooth face, which these discs do not show."""
    coated = Coated(TableBase(table), index=INDEX, roughness=alpha or 1e-3)
    return coated._parts(UP, once=True, gloss=alpha > 0)


def expected(f: Any, view: Any, light: Any) -> np.ndarray[Any, Any]:
    """`[3]` radiance by the formula, over the disc."""
    node, weight = np.polynomial.legendre.leggauss(24)
    reach = math.tan(math.radians(DISC_DEG))
    radius = ((node + 1) / 2 * reach)[:, None]
    turn = (np.arange(48) + 0.5)[None] / 48 * 2 * math.pi
    x = np.cross(light, (0.3, 0.5, 0.8))
    x /= np.linalg.norm(x)
    y = np.cross(light, x)
    to = light[:, None, None] + radius * (
        np.cos(turn) * x[:, None, None] + np.sin(turn) * y[:, None, None]
    )
    length = np.linalg.norm(to, axis=0)
    to = to / length
    # dω = dA cos/d²: both the cosine and the distance grow from the disc's centre
    share = weight[:, None] / 2 * reach * radius * 2 * math.pi / 48 / length**3
    l, v = torch.from_numpy(to)[None], torch.from_numpy(view).view(1, 3, 1, 1)  # noqa: E741
    share = torch.from_numpy(share * to[2].clip(0))
    return np.asarray((f(UP, l, v) * share).sum((0, 2, 3)))


def traced(
    mi: Any, table: Table, alpha: float, view: Any, light: Any, paths: int
) -> tuple[Any, Any]:
    """`[3]` radiance by paths, and its standard error."""
    face: dict[str, Any] = {"type": "dielectric", "int_ior": INDEX, "ext_ior": 1.0}
    if alpha:
        face |= {"type": "roughdielectric", "distribution": "ggx", "alpha": alpha}
    to = mi.ScalarTransform4f
    radius = DISTANCE * math.tan(math.radians(DISC_DEG))
    at = (DISTANCE * light).tolist()
    scene = mi.load_dict(
        {
            "type": "scene",
            "integrator": {"type": "path", "max_depth": 64, "rr_depth": 24},
            "base": {
                "type": "rectangle",
                "to_world": to().scale([1e3, 1e3, 1]),
                "bsdf": table_bsdf(mi, table),
            },
            "face": {
                "type": "rectangle",
                "to_world": to().translate([0, 0, HEIGHT]).scale([1e3, 1e3, 1]),
                "bsdf": face,
            },
            "lamp": {
                "type": "disk",
                "to_world": to().look_at(origin=at, target=[0, 0, 0], up=[0.3, 0.5, 0.8])
                @ to().scale([radius, radius, 1]),
                "emitter": {"type": "area", "radiance": {"type": "rgb", "value": [1.0] * 3}},
            },
            "sensor": {
                "type": "radiancemeter",
                "origin": (10 * view).tolist(),
                "direction": (-view).tolist(),
                "film": {
                    "type": "hdrfilm", "width": 1, "height": 1, "pixel_format": "rgb",
                    "component_format": "float32", "rfilter": {"type": "box"},
                },
            },
        }
    )  # fmt: skip
    found = np.array(
        [
            np.array(mi.render(scene, spp=paths // _BATCHES, seed=seed)).reshape(3)
            for seed in range(_BATCHES)
        ]
    )
    return found.mean(0), found.std(0, ddof=1) / math.sqrt(_BATCHES)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("benchmarks/results"))
    parser.add_argument("--log2-paths", type=int, default=21)
    parser.add_argument("--pairs", type=int, default=len(PAIRS), help="how many geometries")
    parser.add_argument("--faces", nargs="+", choices=FACES, default=list(FACES))
    options = parser.parse_args()
    mi = mitsuba(LLVM)
    table = table_of(rt.simulate_specimen("yakogai", step_deg=10), "yakogai")
    rows = []
    for name in options.faces:
        f = formula(table, FACES[name])
        for polar_v, polar_l, turn in PAIRS[: options.pairs]:
            view, light = direction(polar_v, 0.0), direction(polar_l, float(turn))
            paths, error = traced(mi, table, FACES[name], view, light, 2**options.log2_paths)
            own = expected(f, view, light)
            geometry = {"view_deg": polar_v, "light_deg": polar_l, "azimuth_deg": turn}
            values = {"paths": paths, "error": error, "formula": own, "off": own / paths - 1}
            rows.append({"face": name, **geometry, **{k: x.tolist() for k, x in values.items()}})
            off = ", ".join(
                f"{100 * x:+.2f} ± {100 * e:.2f}"
                for x, e in zip(own / paths - 1, error / paths, strict=True)
            )
            print(f"{name}, v {polar_v}°, l {polar_l}°, {turn}°: {off} %", flush=True)
    options.out.mkdir(parents=True, exist_ok=True)
    (options.out / "coat_in_mitsuba.json").write_text(json.dumps(rows, indent=1))


if __name__ == "__main__":
    main()
