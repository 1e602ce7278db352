"""Are the photographs in the lamps' order? By a model: which lamp explains which photograph."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import torch
from torch import Tensor

from raden_torch.brdf.materials.surface import Reflection
from raden_torch.capture.photo.capture_normals import odd_lamps
from raden_torch.capture.photo.lamp_order import under_lamps
from raden_torch.errors import InputError
from raden_torch.stereo.observed_light import ObservedLight
from raden_torch.stereo.solve import ModelNormals, residuals

_CLEARLY = 1.25
_MOST_OFF = 3.0
"""A relative residual counts no more than this."""


def agreement(
    materials: Sequence[Reflection],
    light: ObservedLight,
    found: ModelNormals,
    photographs: Sequence[Path],
    *,
    keep_order: bool,
) -> tuple[Tensor, list[str]]:
    """How far each photograph is from what was found, `[K]`, and what to warn of.

    The first is the median over the pixels, each relative to its mean over the lamps.

    Raises:
        InputError: another order of the lamps fits clearly better, unless `keep_order`.
    """
    radiance, off = residuals(materials, light, found)
    residual = torch.nanmedian(off, dim=1).values
    wrong = check_order(radiance, light, photographs)
    if wrong is not None and not keep_order:
        raise InputError(
            f"{photographs[0]}: {wrong}; give them in the lamps' order, or say --keep-order"
        )
    return residual, [*([wrong] if wrong else []), *odd_lamps(residual, photographs)]


def check_order(radiance: Tensor, light: ObservedLight, photographs: Sequence[Path]) -> str | None:
    """What to say where another order of the lamps fits clearly better.

    Every photograph is compared with what the surface found shows under every lamp. A few that were
    exchanged hardly bend the normals, which the others hold.

    Args:
        radiance: `[K, C, P]`, what the surface found shows under each lamp.

    Returns:
        None where the order is right, as far as can be told.
    """
    from scipy.optimize import linear_sum_assignment

    usual = radiance.mean((0, 1)).clamp(min=1e-12)
    cost = torch.stack(
        [
            ((radiance - photo).abs().mean(1) / usual).clamp(max=_MOST_OFF).mean(1)
            for photo in light.value
        ]
    ).double()
    rows, lamps = linear_sum_assignment(cost.numpy())
    given, best = float(cost.diagonal().sum()), float(cost[rows, lamps].sum())
    if given <= _CLEARLY * best:
        return None
    return (
        f"the photographs seem to be in another order than the lamps: they differ from the model "
        f"{given / best:.1f} times less with "
        f"{under_lamps(lamps, photographs)}"
    )
