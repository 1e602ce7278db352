"""Where light that a model reflects to a viewer comes from, as a density to sample from.

With m the half vector of light and viewer, θm its angle to the normal and φ its azimuth from the
viewer's, the unit square is

    x = ln(1 + s/b) / ln(1 + 1/b) with s = 1 − cos θm,    y = φ/2π + 1/2.

Near the normal x goes as s, so that equal steps are equal solid angles; from s = b on the steps
widen as s does. A density p(x, y) is one of light directions o, for a viewer i, by
dω_m = 2π (s + b) ln(1 + 1/b) dx dy and dω_o = 4 (i·m) dω_m (Walter et al. 2007, eqs (13), (14)).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import torch

from raden_torch.arrays import Floats, Floats32
from raden_torch.export.forms import RuntimeForm
from raden_torch.export.whole_reflection import highlight_roughness

_SHAPE = (24, 64, 64)
"""Viewers, and nodes along y and x."""
_FLOOR = 1e-6
_LAST_DEG = 89.5
"""The most grazing viewer that is tabulated; beyond it, its density serves."""


@dataclass(frozen=True, eq=False)
class Lobes:
    """A density of half vectors for each of some viewers.

    Attributes:
        b: where the steps along x begin to widen, in 1 − cos θm.
        cosines: of the viewers, rising, `[T]`.
        density: at the nodes of y and x, linear between them, of any scale, `[T, Y, X]`.
    """

    b: float
    cosines: Floats
    density: Floats32


def lobes_of(form: RuntimeForm, shape: tuple[int, int, int] = _SHAPE) -> Lobes:
    """The density that follows Σ|f_r| cos θi, over the channels.

    Where a viewer sees nothing at all, it is even.
    """
    b = highlight_roughness(form) ** 2 / 2
    viewers, rows, columns = shape
    cosines = np.cos(np.deg2rad(np.linspace(_LAST_DEG, 0, viewers)))
    s = b * np.expm1(np.linspace(0, 1, columns) * math.log1p(1 / b))
    s[-1] = 1.0
    azimuth = 2 * np.pi * (np.linspace(0, 1, rows)[:, None] - 0.5)
    sine = np.sqrt(s * (2 - s))
    m = np.stack(np.broadcast_arrays(sine * np.cos(azimuth), sine * np.sin(azimuth), 1 - s))
    normal = torch.tensor([0.0, 0.0, 1.0]).view(1, 3, 1, 1)
    found = []
    for cosine in cosines:
        view = np.array([math.sqrt(1 - cosine**2), 0.0, cosine])
        along = np.tensordot(view, m, 1)
        light = 2 * along * m - view[:, None, None]
        maps = (torch.from_numpy(x).float()[None] for x in (light, view[:, None, None]))
        with torch.no_grad():
            f = form.of_unit_vectors(normal, *maps)[0].abs().sum(0).numpy()
        found.append(f * (light[2].clip(0) * along.clip(0) * (s + b)))
    density = np.array(found)
    dark = density.sum((1, 2)) <= 0
    density[dark] = 1.0
    density /= density.mean((1, 2), keepdims=True)
    density = np.maximum(density, _FLOOR)  # a patch without density cannot be inverted
    return Lobes(b, cosines, density.astype(np.float32))
