"""What materials cost: time of a frame over that of the plain model, at equal covered pixels.

python benchmarks/materials.py [--out benchmarks/results]

A wavy plate of 1080p, all of it covered, under one and under eight lamps. All forms are timed by
turns in one run on one thread, in processor time, the least of several. Writes materials.json.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any

import torch
from in_turn import least_cpu_ms
from torch import Tensor

import raden_torch as rt
from raden_torch.brdf.materials.coat import Coated
from raden_torch.brdf.materials.metal import Foil, Powder
from raden_torch.brdf.materials.urushi import black_urushi
from raden_torch.brdf.model import simd

LAMPS = (1, 8)


def normals(height: int, width: int, seed: float) -> Tensor:
    """Normals `[1, 3, H, W]` of a wavy plate."""
    at = torch.linspace(-1, 1, height), torch.linspace(-1.7, 1.7, width)
    y, x = torch.meshgrid(*at, indexing="ij")
    waves = torch.sin((9 + seed) * x), torch.cos((7 + seed) * y), torch.ones_like(x) / 0.2
    return torch.stack(waves)[None] * 0.2


def frames(model: rt.RadenBrdf, height: int, width: int, lamps: int) -> dict[str, Any]:
    """By name: a function that shades the frame."""
    normal = normals(height, width, 0)
    plain = rt.GBuffer(normal, (0, 0, 1))
    leaning = rt.GBuffer(normal, (0, 0, 1), layer_normal=normals(height, width, 5))
    lights = [rt.DirectionalLight((1, k, 2), 1.0) for k in range(lamps)]
    density = (normal[:, :1] * 3 + 0.5).clamp(0, 1)
    thin = torch.full_like(density, 0.3)
    flakes = Coated(Foil("gold", 0.4, 1.53))
    of: dict[str, tuple[Any, rt.GBuffer]] = {
        "plain": (model, plain),
        "layers that lean": (model, leaning),
        "urushi over it": (Coated(model, absorption=(3, 10, 30), thickness=0.03), plain),
        "gold foil": (Foil("gold"), plain),
        "gold powder, one density": (Powder(flakes, black_urushi(), 0.3), plain),
        "gold powder, a map": (Powder(flakes, black_urushi(), density), plain),
        "gold powder, both parts everywhere": (Powder(flakes, black_urushi(), thin), plain),
        "gold powder over it, everywhere": (Powder(flakes, model, thin), plain),
    }
    return {name: lambda x=x: rt.shade(x[0], x[1], lights) for name, x in of.items()}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("benchmarks/results"))
    parser.add_argument("--runs", type=int, default=9)
    parser.add_argument("--size", type=int, nargs=2, default=(1080, 1920))
    options = parser.parse_args()
    model = rt.fit(rt.simulate_specimen("yakogai")).model.requires_grad_(False)
    torch.set_num_threads(1)
    rows = []
    for lamps in LAMPS:
        ms = least_cpu_ms(frames(model, *options.size, lamps), options.runs)
        rows.append({"lamps": lamps, "ms": ms})
        for name, value in ms.items():
            print(f"{lamps} lamp(s), {name}: {value:.1f} ms, {value / ms['plain']:.2f}")
    options.out.mkdir(parents=True, exist_ok=True)
    about = {"kernel": simd.level(), "threads": torch.get_num_threads(), "rows": rows}
    (options.out / "materials.json").write_text(json.dumps(about, indent=1))


if __name__ == "__main__":
    main()
