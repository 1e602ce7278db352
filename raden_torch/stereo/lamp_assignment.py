"""Are the photographs in the lamps' order? By a model: which lamp explains which photograph."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import torch

from raden_torch.brdf.materials.surface import Reflection
from raden_torch.errors import InputError
from raden_torch.stereo.observed_light import ObservedLight
from raden_torch.stereo.solve import ModelNormals, residuals

_CLEARLY = 1.25
_MOST_OFF = 3.0
"""A relative residual counts no more than this."""


def check_order(
    materials: Sequence[Reflection],
    light: ObservedLight,
    found: ModelNormals,
    photographs: Sequence[Path],
) -> str | None:
    """What to say where another order of the lamps fits clearly better.

    Every photograph is compared with what the surface found shows under every lamp. A few that were
    exchanged hardly bend the normals, which the others hold.

    Returns:
        None where the order is right, as far as can be told.
    """
    from scipy.optimize import linear_sum_assignment

    radiance, _ = residuals(materials, light, found)
    usual = radiance.mean((0, 1)).clamp(min=1e-12)
    cost = torch.stack(
        [
            ((radiance - photo).abs().mean(1) / usual).clamp(max=_MOST_OFF).mean(1)
            for photo in light.value
        ]
    ).double()
    rows, lamps = linear_sum_assignment(cost.numpy())
    given, best = float(cost.diagonal().sum()), float(cost[rows, lamps].sum())
    moved = [k for k in range(len(lamps)) if lamps[k] != k]
    if not moved or given < _CLEARLY * best:
        return None
    shown = ", ".join(f"{photographs[k].name} under lamp {lamps[k] + 1}" for k in moved[:4])
    more = " …" if len(moved) > 4 else ""
    return (
        f"the photographs seem to be in another order than the lamps: they differ from the model "
        f"{given / best:.1f} times less with {shown}{more}"
    )


def refuse(text: str, first: Path) -> InputError:
    """The error of such a finding."""
    return InputError(f"{first}: {text}; give them in the lamps' order, or say --keep-order")
