"""Makes lid.jpg: the lid of a maki-e box in four simulated shells and gold (some minutes).

python docs/pictures/lid.py [--width 1400] [--out lid.jpg]
"""

import argparse
from pathlib import Path

import torch
from torch import Tensor
from torch.nn.functional import avg_pool2d, normalize

import raden_torch as rt
from raden_torch.artwork.board import broad_light
from raden_torch.artwork.makie import LID, lid
from raden_torch.brdf.files.display import Display
from raden_torch.brdf.materials.coat import Coated
from raden_torch.brdf.materials.metal import Foil
from raden_torch.brdf.materials.palette import Palette
from raden_torch.brdf.materials.urushi import URUSHI_INDEX, black_urushi

SCALES = {
    "yakogai": (0.93, 1.0, 1.07),
    "awabi": (0.92, 1.0, 1.08),
    "akoya": (0.94, 1.0, 1.06),
    "mexican": (0.9, 1.0, 1.1, 1.2),
}
CAMERA = (0.0, -2.9, 5.2)
DOME = 0.06  # lids are a little domed
SAMPLES = 2


def palette() -> Palette:
    """The shells at all their thicknesses, in the order of the weights."""
    models, names = [], []
    for shell, scales in SCALES.items():
        for scale in scales:
            measured = rt.simulate_specimen(shell, tablet_scale=scale, step_deg=10)
            models.append(rt.fit(measured, interpolation="cubic").model)
            names.append(f"{shell} {scale:g}")
    return Palette(models, names)


def normals(slope: Tensor) -> Tensor:
    """`[1, 3, H, W]` of a height field's slopes `[2, H, W]`."""
    return normalize(torch.cat([-slope, torch.ones_like(slope[:1])])[None], dim=1).float()


@torch.no_grad()
def picture(shells: Palette, width: int) -> Tensor:
    """`[1, 3, H, width]`, scene-linear."""
    pixel = 2 * LID[0] / (width * SAMPLES)
    across = (torch.arange(width * SAMPLES, dtype=torch.float64) + 0.5) * pixel - LID[0]
    rows = round(2 * LID[1] / pixel / SAMPLES) * SAMPLES
    down = LID[1] - (torch.arange(rows, dtype=torch.float64) + 0.5) * pixel
    y, x = torch.meshgrid(down, across, indexing="ij")
    maps = lid(x, y, pixel)
    slope = torch.stack([-DOME * x, -DOME * y])
    place = torch.stack([x, y, torch.zeros_like(x)])[None].float()
    covered, gold = maps.shell.coverage.float()[None], maps.gold.float()[None]
    weights = maps.shell.weights(SCALES).float()[None]
    raden = rt.GBuffer(
        normals(slope + maps.shell.layer_slope),
        position=place,
        camera=CAMERA,
        mask=covered,
        material=weights,
    )
    makie = rt.GBuffer(
        normals(slope),
        position=place,
        camera=CAMERA,
        mask=1 - covered,
        material=torch.cat([1 - gold, gold], dim=1),
    )
    ground = Palette([black_urushi(), Coated(Foil("gold", 0.35, URUSHI_INDEX))], ["urushi", "gold"])
    lights = broad_light()
    return avg_pool2d(rt.shade(shells, raden, lights) + rt.shade(ground, makie, lights), SAMPLES)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--width", type=int, default=1400)
    parser.add_argument("--out", type=Path, default=Path(__file__).with_suffix(".jpg"))
    options = parser.parse_args()
    image = picture(palette(), options.width)
    display = Display("auto", tone="neutral")
    display.write(image[0], options.out, "simulated specimens: " + ", ".join(SCALES))


if __name__ == "__main__":
    main()
