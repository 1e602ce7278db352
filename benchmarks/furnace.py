"""White furnace: what each composition of lacquer and metal reflects of light from one direction.

    python benchmarks/furnace.py

A Markdown table of directional albedos (luminance Y), by quadrature over the hemisphere, for
docs/lacquer_and_metal.md: of the formula, then of the runtime table that `shade` reads.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import torch

from raden_torch.brdf.materials.coat import Coated
from raden_torch.brdf.materials.metal import Foil, Powder
from raden_torch.brdf.materials.urushi import Lambertian, black_urushi, vermilion_urushi

INCIDENCE = (0, 30, 60, 75, 85)
NODES = 160
LUMINANCE = torch.tensor([0.2126, 0.7152, 0.0722], dtype=torch.float64)
UP = torch.tensor([0.0, 0.0, 1.0], dtype=torch.float64).view(1, 3, 1, 1)
WHITE = Lambertian((1.0, 1.0, 1.0))

MATERIALS: dict[str, tuple[Any, bool]] = {
    "coat (α 0.3) over white": (Coated(WHITE, roughness=0.3), True),
    "coat (α 0.15) over white": (Coated(WHITE, roughness=0.15), True),
    "coat over rough mirror": (Coated(Foil("mirror", 0.4, 1.53), roughness=0.3), True),
    "mirror foil (α 0.3)": (Foil("mirror", 0.3), True),
    "mirror powder (α 1)": (Foil("mirror", 1.0), True),
    "coat over mirror powder on white": (
        Coated(Powder(Foil("mirror", 0.4, 1.53), WHITE, 0.4), roughness=0.3), True),
    "black urushi": (black_urushi(0.15), False),
    "vermilion urushi": (vermilion_urushi(0.15), False),
    "gold foil (α 0.15)": (Foil("gold"), False),
    "silver foil (α 0.15)": (Foil("silver"), False),
    "gold powder on black, coated": (
        Coated(Powder(Foil("gold", 0.4, 1.53), black_urushi().base, 0.5), roughness=0.15), False),
}  # fmt: skip


def quadrature() -> tuple[torch.Tensor, torch.Tensor]:
    """Directions `[1, 3, NODES, NODES]` and their weights, cos θ dω."""
    x, weight = np.polynomial.legendre.leggauss(NODES)
    theta = torch.from_numpy((x + 1) * math.pi / 4)
    phi = (torch.arange(NODES, dtype=torch.float64) + 0.5) / NODES * math.pi
    t, p = torch.meshgrid(theta, phi, indexing="ij")
    share = t.cos() * t.sin() * torch.from_numpy(weight)[:, None] * math.pi / 4 * 2 * math.pi
    return torch.stack([t.sin() * p.cos(), t.sin() * p.sin(), t.cos()])[None], share / NODES


def main() -> None:
    light, share = quadrature()
    print("| composition | loses nothing |" + "".join(f" {a}° |" for a in INCIDENCE))
    print("|---|---|" + "---|" * len(INCIDENCE))
    for name, (material, lossless) in MATERIALS.items():
        coated = isinstance(material, Coated)
        formula = material._parts(UP, once=True, gloss=True) if coated else material.formula
        cells = []
        for degrees in INCIDENCE:
            a = math.radians(degrees)
            view = torch.tensor([math.sin(a), 0, math.cos(a)], dtype=torch.float64)
            albedos = (
                (f(UP, light, view.view(1, 3, 1, 1)) * share).sum((0, 2, 3)) @ LUMINANCE
                for f in (formula, material.of_unit_vectors)
            )
            cells.append(" {:.3f} {:.3f} |".format(*albedos))
        print(f"| {name} | {'yes' if lossless else ''} |{''.join(cells)}", flush=True)


if __name__ == "__main__":
    main()
