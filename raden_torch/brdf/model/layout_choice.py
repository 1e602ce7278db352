"""Which runtime table suits a model: nodes along each axis, and how close to the highlight.

Along each axis, for several counts and warps, the error of reading linearly between two nodes is
measured at sampled geometries; the errors of the axes add up. Of all layouts with as many nodes as
are allowed, the one of least error is taken.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from itertools import product
from typing import TYPE_CHECKING

import numpy as np
import torch
from torch import Tensor

from raden_torch.brdf.model.runtime_table import RuntimeLayout, address_of_angles, angles_of
from raden_torch.errors import InputError
from raden_torch.measurement.colour_conversion import xyz_to_rgb_matrix
from raden_torch.measurement.readings import FACTOR_PER_SR
from raden_torch.reflectance.log_readings import LUMINANCE

if TYPE_CHECKING:
    from raden_torch.brdf.model.model import RadenBrdf

NODES = 150_000
"""How many nodes a runtime table may have: 1.8 MB in float32, near the size of a core's cache."""

_COUNTS = (
    (16, 20, 24, 28, 32, 40, 48, 64),
    (25, 33, 41, 49, 57, 69, 81, 97, 117, 137),
    (25, 33, 41, 49, 57, 69, 81, 97, 117, 137),
)
_WARPS = (0.1, 0.2, 0.3, 0.45, 0.7)
_LEAST_SHARE = 0.7  # of the nodes that are allowed
_SAMPLES = 1200  # of each kind
_USUAL_WARP = 0.4  # while another axis is looked at

Angles = tuple[Tensor, Tensor, Tensor]


@dataclass(frozen=True)
class BakeError:
    """How far the runtime form is from the fit form, in luminance Y.

    Attributes:
        rms: over the 99.9 % quantile of Y.
        log_error: mean |Δ log(1 + Y)|, Y being 100 for the perfect diffuser.
    """

    rms: float
    log_error: float


def bake_errors(model: RadenBrdf, seed: int = 1) -> dict[str, BakeError]:
    """The runtime form's errors: "box", evenly in all angles to 70°; "hemisphere", evenly along the
    axes of a runtime table, grazing geometries included; "highlight", within a few degrees of the
    mirror."""
    found = {}
    for name, angles in _samples(seed).items():
        truth, read = (
            _luminance(form, model, angles) for form in (model.fit_form, model.at_angles)
        )
        square, log = _difference(read, truth)
        found[name] = BakeError(float(square.sqrt()), float(log))
    return found


def choose_layout(model: RadenBrdf, nodes: int = NODES, seed: int = 0) -> RuntimeLayout:
    """The layout of at most `nodes` nodes that reads the model's fit form best.

    Raises:
        InputError: too few nodes for any layout, or too many (10,000 to 1,700,000 do).
    """
    a, r, t = (torch.cat(each) for each in zip(*_samples(seed).values(), strict=True))
    angles = a, r, t
    truth = _luminance(model.fit_form, model, angles)
    errors: list[dict[tuple[int, float], Tensor]] = [{}, {}, {}]  # by axis, then count and warp
    for axis, counts in enumerate(_COUNTS):
        for count, warp in product(counts, _WARPS if axis else (_USUAL_WARP,)):
            read = _read_along(model, angles, axis, count, warp)
            errors[axis][count, warp] = torch.stack(
                [_difference(r, y) for r, y in zip(read.chunk(3), truth.chunk(3), strict=True)]
            )
    best, chosen = math.inf, None
    for (u, e_u), (v, e_v), (w, e_w) in product(*(e.items() for e in errors)):
        size = u[0] * v[0] * w[0]
        if not _LEAST_SHARE * nodes <= size <= nodes:
            continue
        square, log = (e_u + e_v + e_w).unbind(-1)
        cost = float((square.sqrt() + log).sum())
        if cost < best:
            best, chosen = cost, RuntimeLayout((u[0], v[0], w[0]), (v[1], w[1]))
    if chosen is None:
        raise InputError(f"runtime table: expected 10,000 to 1,700,000 nodes, got {nodes}")
    return chosen


def _samples(seed: int) -> dict[str, Angles]:
    """Geometries by the names of `bake_errors`."""
    random = torch.Generator("cpu").manual_seed(seed)

    def uniform(low: float, high: float) -> Tensor:
        return low + (high - low) * torch.rand(
            _SAMPLES, generator=random, dtype=torch.float64, device="cpu"
        )

    at = math.radians(70)
    box = uniform(0, at), uniform(-at, at), uniform(-at, at)
    u, v, w = uniform(0, 0.92), uniform(-1, 1), uniform(-1, 1)
    whole = angles_of((0.7, 0.7), u, 0.98 * v, 0.9 * w)
    mirror = angles_of((1.0, 1.0), u, 0.1 * v, 0.1 * w)
    return {"box": box, "hemisphere": whole, "highlight": mirror}


def _luminance(form: Callable[..., Tensor], model: RadenBrdf, angles: Angles) -> Tensor:
    """Y as a reflectance factor, the perfect diffuser being 100."""
    like = next(model.parameters(), torch.zeros((), device="cpu"))
    with torch.no_grad():
        f = form(*(a.to(like)[None, :, None] for a in angles))[:, :, 0].double().cpu()
    to_y = np.linalg.inv(xyz_to_rgb_matrix())[LUMINANCE]
    return torch.from_numpy(to_y) @ f * FACTOR_PER_SR


def _read_along(model: RadenBrdf, angles: Angles, axis: int, count: int, warp: float) -> Tensor:
    """Luminance read linearly between the two nodes beside each geometry along one axis."""
    warps = (warp, warp) if axis else (_USUAL_WARP, _USUAL_WARP)
    at = list(address_of_angles(warps, *angles))
    low, high = (-1.0, 1.0) if axis else (0.0, 1.0)
    position = (at[axis] - low) / (high - low) * (count - 1)
    node = position.floor().clamp(0, count - 2)
    read = torch.zeros_like(position)
    for end, weight in ((node, 1 - (position - node)), (node + 1, position - node)):
        at[axis] = low + (high - low) * end / (count - 1)
        read = read + weight * _luminance(model.fit_form, model, angles_of(warps, *at))
    return read


def _difference(read: Tensor, y: Tensor) -> Tensor:
    """Mean square error over the square of the 99.9 % quantile; mean |Δ log(1+Y)|."""
    level = torch.quantile(y.abs(), 0.999).clamp(min=1e-9)
    log = (torch.log1p(read.clamp(min=0)) - torch.log1p(y.clamp(min=0))).abs()
    return torch.stack([((read - y) / level).square().mean(), log.mean()])
