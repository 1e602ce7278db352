"""Which pinhole camera sees a position map: from directions to pixels."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from raden_torch.errors import InputError

_PIXELS = 4096
"""That it is fitted to, at most."""
_LARGEST_MISS = 0.5
"""Pixels between where a position lies and where the camera sees it, in the median."""
_LEAST_SPREAD = 1e-12
"""Of the second smallest eigenvalue to the largest: below, more than one camera fits."""


@dataclass(frozen=True)
class PinholeFit:
    """A pinhole at the origin.

    Attributes:
        matrix: `[3, 3]`, point → homogeneous pixel (column, row, 1) times planar depth.
        pixel: side of a pixel at depth 1.
    """

    matrix: Tensor
    pixel: float


def fit_pinhole(where: str, rays: Tensor, there: Tensor) -> PinholeFit:
    """The camera that sees each point in its own pixel, by the direct linear transform.

    Hartley, Zisserman, "Multiple View Geometry", 2nd ed., section 4.1: each pair of direction d
    and pixel (x, y) gives d·(m₁ − x m₃) = 0 and d·(m₂ − y m₃) = 0; the smallest eigenvector of
    their normal equations solves them.

    Args:
        where: what it is, for messages.
        rays: `[3, H, W]` points from the camera.
        there: `[H, W]` bool, which count; where none does, any camera fits.

    Raises:
        InputError: no single camera fits.
    """
    height, width = there.shape
    pixels = there.flatten().nonzero()[:, 0]
    if not len(pixels):
        return PinholeFit(torch.eye(3).to(rays), 1.0)
    pixels = pixels[:: max(1, len(pixels) // _PIXELS)]
    d = rays.flatten(1)[:, pixels].T.double()
    d = d / d.norm(dim=1, keepdim=True).clamp(min=1e-300)
    half = max(height, width) / 2
    middle = d.new_tensor([(width - 1) / 2, (height - 1) / 2])
    at = torch.stack([pixels % width, pixels // width], dim=1).double()
    x, y = ((at - middle) / half).T[..., None]
    zero = torch.zeros_like(d)
    rows = torch.cat([torch.cat([d, zero, -x * d], 1), torch.cat([zero, d, -y * d], 1)])
    values, vectors = torch.linalg.eigh((rows.T @ rows).cpu())
    if len(pixels) < 4 or float(values[1]) <= _LEAST_SPREAD * float(values[-1]):
        raise InputError(
            f"{where}: expected surface in pixels all over the picture, got {int(there.sum())} "
            "pixels, which more than one camera sees so"
        )
    fitted = vectors[:, 0].view(3, 3).to(d)
    fitted = fitted / fitted[2].norm()
    if float((d @ fitted[2]).mean()) < 0:
        fitted = -fitted
    to_pixels = d.new_tensor([[half, 0, middle[0]], [0, half, middle[1]], [0, 0, 1]])
    matrix = to_pixels @ fitted
    seen = d @ matrix.T
    miss = float((seen[:, :2] / seen[:, 2:] - at).norm(dim=1).median())
    if not miss <= _LARGEST_MISS:
        raise InputError(
            f"{where}: expected positions that a pinhole at `camera` sees in their pixels, got "
            f"some {miss:.3g} pixels beside them"
        )
    sides = torch.linalg.inv(matrix)[:, :2].norm(dim=0)
    return PinholeFit(matrix.to(rays), float(sides.mean()))
