"""A model over the whole hemisphere: how much of it was measured, how much it reflects."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from raden_torch import geometry
from raden_torch.brdf.fitting.tabulate import Tabulated
from raden_torch.brdf.model.model import RadenBrdf

INCIDENCES_DEG = (0.0, 15.0, 30.0, 45.0, 60.0, 70.0, 80.0, 85.0)
"""Where the directional albedo is computed."""

_PAIRS = 20_000
_COSINES, _AZIMUTHS = 48, 180


@dataclass(frozen=True)
class Shares:
    """Shares of all pairs of directions to light and viewer above the horizon, by solid angle.

    Attributes:
        measured: nearest to a node that was measured.
        filled: within the measured box otherwise.
        outside: beyond it.
    """

    measured: float
    filled: float
    outside: float


def shares(table: Tabulated) -> Shares:
    """By 20,000 random pairs of directions."""
    light, view = _random_directions(1), _random_directions(2)
    normal = light.new_tensor([0.0, 0.0, 1.0]).view(3, 1, 1).expand_as(light)
    angles = geometry.raden_angles(normal, light, view)
    pairs = np.rad2deg(np.stack([angle.numpy().ravel() for angle in angles], axis=1))
    inside = table.grid.contains(pairs)
    node = np.rint(table.grid.positions(pairs[inside])).astype(int)
    measured = float(table.measured[tuple(node.T)].sum()) / len(pairs)
    within = float(inside.mean())
    return Shares(measured, within - measured, 1 - within)


def directional_albedo(model: RadenBrdf) -> dict[float, float]:
    """∫ f_r cos θr dω by incidence in degrees, in the channel where it is highest.

    By Gauss-Legendre quadrature over cos θr and equal steps of the azimuth, in float64.
    """
    points, weights = np.polynomial.legendre.leggauss(_COSINES)
    cosine, weight = torch.from_numpy((points + 1) / 2), torch.from_numpy(weights / 2)
    azimuth = torch.from_numpy(2 * np.pi * (np.arange(_AZIMUTHS) + 0.5) / _AZIMUTHS)
    sine = (1 - cosine**2).sqrt()[:, None]
    rows = (sine * azimuth.cos(), sine * azimuth.sin(), cosine[:, None].expand(-1, _AZIMUTHS))
    view = torch.stack(rows)[None]  # [1, 3, cosines, azimuths]
    normal = view.new_tensor([0.0, 0.0, 1.0]).view(1, 3, 1, 1)
    found = {}
    with torch.no_grad():
        for incidence in INCIDENCES_DEG:
            a = np.deg2rad(incidence)
            light = view.new_tensor([np.sin(a), 0.0, np.cos(a)]).view(1, 3, 1, 1)
            f = model(normal, light, view)
            total = (f * (cosine * weight)[:, None]).sum(dim=(2, 3)) * 2 * torch.pi / _AZIMUTHS
            found[incidence] = float(total.max())
    return found


def _random_directions(seed: int) -> Tensor:
    """`[3, 1, M]` unit vectors above the horizon, uniform by solid angle."""
    generator = np.random.default_rng(seed)
    z, azimuth = generator.random(_PAIRS), 2 * np.pi * generator.random(_PAIRS)
    sine = np.sqrt(1 - z**2)
    return torch.from_numpy(np.stack([sine * np.cos(azimuth), sine * np.sin(azimuth), z]))[:, None]
