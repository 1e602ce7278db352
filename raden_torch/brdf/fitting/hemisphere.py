"""A model over the whole hemisphere: how much of it was measured, how much it reflects."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from raden_torch import geometry
from raden_torch.arrays import Floats
from raden_torch.brdf.fitting.tabulate import Tabulated
from raden_torch.brdf.model.model import RadenBrdf

INCIDENCES_DEG = (0.0, 15.0, 30.0, 45.0, 60.0, 70.0, 80.0, 85.0)
"""Where the directional albedo is computed."""

GUESS = 0.1
"""An expected error of Y over Y: a table that is less sure of a node has guessed it."""

_PAIRS = 20_000
_COSINES, _AZIMUTHS = 48, 180


@dataclass(frozen=True)
class Shares:
    """Shares of all pairs of directions to light and viewer above the horizon, by solid angle.

    Attributes:
        measured: nearest to a node that was measured.
        filled: within the measured box otherwise.
        outside: beyond it.
        guessed: those of `filled` whose expected error is above `GUESS`, of a table from few
            readings.
        expected_error: median of the expected standard deviation of Y over Y, within the box; NaN
            where it is not known.
    """

    measured: float
    filled: float
    outside: float
    guessed: float = 0.0
    expected_error: float = float("nan")


def shares(table: Tabulated) -> Shares:
    """By 20,000 random pairs of directions."""
    light, view = _random_directions(1), _random_directions(2)
    normal = light.new_tensor([0.0, 0.0, 1.0]).view(3, 1, 1).expand_as(light)
    angles = geometry.raden_angles(normal, light, view)
    pairs = np.rad2deg(np.stack([angle.numpy().ravel() for angle in angles], axis=1))
    inside = table.grid.contains(pairs)
    node = np.rint(table.grid.positions(pairs[inside])).astype(int)
    read = table.measured[tuple(node.T)]
    measured, within = float(read.sum()) / len(pairs), float(inside.mean())
    if table.std is None:
        return Shares(measured, within - measured, 1 - within)
    std = table.std[tuple(node.T)]
    guessed = float((~read & (std > GUESS)).sum()) / len(pairs)
    return Shares(measured, within - measured, 1 - within, guessed, float(np.median(std)))


def directional_albedo(model: RadenBrdf) -> dict[float, float]:
    """∫ f_r cos θr dω by incidence in degrees, in the channel where it is highest."""
    cosines = np.cos(np.deg2rad(INCIDENCES_DEG))
    with torch.no_grad():
        totals = sums_over_directions(model, cosines).amax(dim=1)
    return dict(zip(INCIDENCES_DEG, totals.tolist(), strict=True))


def sums_over_directions(f: Callable[[Tensor, Tensor, Tensor], Tensor], cosines: Floats) -> Tensor:
    """∫ f cos θ dω over the hemisphere, by Gauss-Legendre quadrature over cos θ and equal steps of
    the azimuth, in float64.

    Args:
        f: of the normal, one direction and all directions, `[1, 3, H, W]` each.
        cosines: between the normal and the one direction, `[N]`.

    Returns:
        `[N, 3]`.
    """
    points, weights = np.polynomial.legendre.leggauss(_COSINES)
    cosine, weight = torch.from_numpy((points + 1) / 2), torch.from_numpy(weights / 2)
    azimuth = torch.from_numpy(2 * np.pi * (np.arange(_AZIMUTHS) + 0.5) / _AZIMUTHS)
    sine = (1 - cosine**2).sqrt()[:, None]
    rows = (sine * azimuth.cos(), sine * azimuth.sin(), cosine[:, None].expand(-1, _AZIMUTHS))
    around = torch.stack(rows)[None]  # [1, 3, cosines, azimuths]
    normal = around.new_tensor([0.0, 0.0, 1.0]).view(1, 3, 1, 1)
    sums = []
    for one in cosines:
        fixed = around.new_tensor([np.sqrt(max(1 - one**2, 0.0)), 0.0, one]).view(1, 3, 1, 1)
        values = f(normal, fixed, around) * (cosine * weight)[:, None]
        sums.append(values.sum(dim=(2, 3))[0] * 2 * torch.pi / _AZIMUTHS)
    return torch.stack(sums)


def _random_directions(seed: int) -> Tensor:
    """`[3, 1, M]` unit vectors above the horizon, uniform by solid angle."""
    generator = np.random.default_rng(seed)
    z, azimuth = generator.random(_PAIRS), 2 * np.pi * generator.random(_PAIRS)
    sine = np.sqrt(1 - z**2)
    return torch.from_numpy(np.stack([sine * np.cos(azimuth), sine * np.sin(azimuth), z]))[:, None]
