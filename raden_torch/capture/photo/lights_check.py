"""Do directions to lamps determine a normal?"""

from __future__ import annotations

import torch
from torch import Tensor

from raden_torch.errors import InputError

MIN_LAMPS = 3
MIN_SPREAD = 0.03
"""Smallest singular value of the unit directions over √K below which they count as coplanar: errors
of the photographs would reach the normals thirtyfold."""


def check_lights(lights: Tensor, name: object = "lights") -> None:
    """Raise InputError unless `[K, 3]` directions (or their means) determine a normal.

    Args:
        name: of the file or argument they come from, for messages.
    """
    count = len(lights)
    if count < MIN_LAMPS:
        raise InputError(f"{name}: expected at least {MIN_LAMPS} lamps, not in a row, got {count}")
    directions = lights.detach().double().cpu()
    length = directions.norm(dim=1, keepdim=True)
    if not bool(torch.isfinite(directions).all()) or bool((length == 0).any()):
        raise InputError(
            f"{name}: expected vectors to the lamps, got a direction that is zero or not finite"
        )
    spread = float(torch.linalg.svdvals(directions / length)[-1]) / count**0.5
    if spread < MIN_SPREAD:
        raise InputError(
            f"{name}: expected lamps of spread {MIN_SPREAD} or more, got {spread:.3f}: they lie "
            "in one plane with the object; move one of them out of the row"
        )
