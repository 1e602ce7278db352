"""A plate of simulated raden in black and in vermilion urushi, with gold powder that thins out.

python benchmarks/lacquer_picture.py OUT.png [--size N]
"""

from __future__ import annotations

import argparse
from pathlib import Path

import torch
from torch import Tensor

import raden_torch as rt
from raden_torch.artwork.plate import InlaidPlate, plate
from raden_torch.brdf.files.image_file import Photograph, write_photograph
from raden_torch.brdf.materials.coat import Coated
from raden_torch.brdf.materials.metal import Foil, Powder, coverage
from raden_torch.brdf.materials.urushi import (
    COAT_MM,
    SUKI_ABSORPTION,
    URUSHI_INDEX,
    black_urushi,
    vermilion_urushi,
)

LAMPS = [
    rt.PointLight((-0.5, 1.2, 3.0), 11.0),
    rt.PointLight((2.2, 0.4, 2.6), 9.0),
    rt.PointLight((-2.4, -1.0, 2.8), 7.0),
]


def powder_over(ground: Coated, made: InlaidPlate) -> Powder:
    """Gold flakes under the ground's own coat, thick at the lower left and none at the middle."""
    position = made.lacquer.position
    assert position is not None
    x, y = position[:, :1], position[:, 1:2]
    strewn = 3.0 * ((-x - y) / 2 - 0.15).clamp(min=0) ** 1.5 * 2
    flakes = Coated(Foil("gold", 0.4, URUSHI_INDEX), URUSHI_INDEX, SUKI_ABSORPTION, COAT_MM / 4)
    return Powder(flakes, ground, coverage(strewn))


@torch.no_grad()
def picture(size: int) -> Tensor:
    """`[1, 3, size, 2 size]`, scene-linear."""
    model = rt.fit(rt.simulate_specimen("yakogai", step_deg=10), interpolation="trilinear").model
    shell = Coated(model, URUSHI_INDEX, base_in="air")
    made = plate(size)
    images = [
        rt.shade(shell, made.shell, LAMPS) + rt.shade(powder_over(g, made), made.lacquer, LAMPS)
        for g in (black_urushi(), vermilion_urushi())
    ]
    return torch.nn.functional.avg_pool2d(torch.cat(images, dim=-1), 2)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("out", type=Path)
    parser.add_argument("--size", type=int, default=420)
    options = parser.parse_args()
    write_photograph(Photograph(picture(options.size).clamp(0, 1), 255), options.out)


if __name__ == "__main__":
    main()
