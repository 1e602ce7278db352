"""From scene-linear RGB to a picture: the display transform, which comes last, and the file."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from raden_torch.errors import InputError
from raden_torch.files import check_writable
from raden_torch.images.pixels import draw_caption, write_pixels
from raden_torch.packages import require

PICTURE_SUFFIXES = (".png", ".jpg", ".jpeg")


def to_display(image: Tensor, exposure_ev: float = 0.0) -> Tensor:
    """Scene-linear `[B, 3, H, W]` → sRGB in 0…1: exposure in stops, clipping, the sRGB curve.

    Out-of-gamut (negative) values are kept up to here and clipped here.
    """
    from kornia.color import linear_rgb_to_rgb

    return linear_rgb_to_rgb((image.float() * 2.0**exposure_ev).clamp(0, 1))


def auto_exposure_ev(image: Tensor, white: float = 0.9, share: float = 0.995) -> float:
    """Stops that bring the `share` quantile of the lit pixels' largest channel to `white`."""
    brightest = image.detach().float().amax(dim=-3).flatten()
    lit = brightest[brightest > 0]
    if not len(lit):
        return 0.0
    level = float(np.quantile(lit.cpu().numpy(), share))
    return float(np.log2(white / level))


def check_picture_path(
    path: str | os.PathLike[str], suffixes: tuple[str, ...] = PICTURE_SUFFIXES
) -> None:
    """Raise InputError where a picture could not be written, so before the work is done."""
    require("pictures", "images")
    path = Path(path)
    if path.suffix.lower() not in suffixes:
        wanted = ", ".join(suffixes)
        raise InputError(f"{path}: suffix: expected one of {wanted}, got {path.suffix or '(none)'}")
    check_writable(path)


def write_picture(
    picture: Tensor, path: str | os.PathLike[str], caption: str | None = None
) -> None:
    """Write one display-referred `[3, H, W]` picture (0…1) as an 8-bit PNG or JPEG.

    Args:
        caption: a small line drawn into the lower left corner, as "simulated specimen".

    Raises:
        InputError: a suffix that is no picture's, or a folder that does not exist.
    """
    check_picture_path(path)
    rgb = (picture.detach().clamp(0, 1) * 255).round().to(torch.uint8).movedim(0, -1).cpu().numpy()
    if caption:
        rgb = np.ascontiguousarray(rgb)
        draw_caption(rgb, caption)
    write_pixels(rgb, path)
