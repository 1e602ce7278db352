"""What renderers ask of a reflection as a whole: what it reflects of light from all around, and how
wide its highlight is."""

from __future__ import annotations

import math

import numpy as np
import torch

from raden_torch.brdf.fitting.hemisphere import sums_over_directions
from raden_torch.export.forms import RuntimeForm

ALBEDO_NODES = 32
_GRAZING = 1e-3
"""The least N·V: at 0 nothing is seen."""
_HALF_ANGLE = math.radians(30.0)
"""Half the angle between light and viewer where the highlight is measured."""
_TILTS = 400
_ROUGHNESS = (0.02, 1.0)


def view_albedo(form: RuntimeForm) -> list[list[float]]:
    """∫ f_r cos θi dω over all light, linear RGB, for viewers at √(1 − N·V) = i/(n − 1), of which
    there are `ALBEDO_NODES`, n. Times an even radiance from all around it is what the surface
    shows."""
    cosines = np.maximum(1 - np.linspace(0, 1, ALBEDO_NODES) ** 2, _GRAZING)
    with torch.no_grad():
        sums = sums_over_directions(lambda n, v, to: form.of_unit_vectors(n, to, v), cosines)
    return [[float(f"{x:.6g}") for x in row] for row in sums.tolist()]


def highlight_roughness(form: RuntimeForm) -> float:
    """GGX's α with a peak as wide at half its height as the highlight's at an angle of 60° between
    light and viewer, above what is reflected far from it; within 0.02…1.

    GGX's density of slopes is half its peak where tan² θh = α² (√2 − 1) (Walter et al. 2007,
    eq. (33)).
    """
    tilt = torch.linspace(0, math.pi / 2 - _HALF_ANGLE, _TILTS + 1, dtype=torch.float64)[:-1]
    zero = torch.zeros_like(tilt)

    def at(angle: torch.Tensor) -> torch.Tensor:
        return torch.stack([angle.sin(), zero, angle.cos()])[None, :, None]

    profile = zero
    with torch.no_grad():
        for side in (1.0, -1.0):
            light, view = (at(zero + side * sign * _HALF_ANGLE) for sign in (1.0, -1.0))
            f = form.of_unit_vectors(at(tilt), light, view)[0, :, 0]
            profile = profile + f.sum(dim=0)
    above = profile - profile.min()
    below_half = (above < above[0] / 2).nonzero()
    half = float(tilt[below_half[0]]) if len(below_half) else float(tilt[-1])
    least, most = _ROUGHNESS
    return min(max(math.tan(half) / math.sqrt(math.sqrt(2) - 1), least), most)
