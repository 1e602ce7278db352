"""Makes shells.jpg: the same motif cut of four simulated shells (some minutes).

python docs/pictures/shells.py
"""

from pathlib import Path

import torch

import raden_torch as rt
from raden_torch.artwork.board import shade_board
from raden_torch.brdf.files.display import auto_exposure_ev, to_display, write_picture

SCALES = {
    "yakogai": (0.93, 1.0, 1.07),
    "awabi": (0.92, 1.0, 1.08),
    "akoya": (0.94, 1.0, 1.06),
    "mexican": (0.9, 1.0, 1.1, 1.2),
}


def model(shell: str, scale: float) -> rt.RadenBrdf:
    measured = rt.simulate_specimen(shell, tablet_scale=scale)
    return rt.fit(measured, interpolation="cubic").model


if __name__ == "__main__":
    models = {
        shell: {scale: model(shell, scale) for scale in scales} for shell, scales in SCALES.items()
    }
    with torch.no_grad():
        image = shade_board(models, 1300)
    picture = to_display(image, auto_exposure_ev(image))[0]
    caption = "simulated specimens: " + ", ".join(models)
    write_picture(picture, Path(__file__).with_suffix(".jpg"), caption)
