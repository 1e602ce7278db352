"""A value between scattered readings: a quadratic through the nearest, weighed by distance."""

from __future__ import annotations

import numpy as np

from raden_torch.arrays import Floats

NUMBERS = 10
"""Of a quadratic in three angles."""


def local_quadratic(offsets: Floats, away: Floats, values: Floats) -> tuple[Floats, Floats]:
    """Weights `[N, K]` of neighbours in the value at 0, and what it is uncertain by `[N, C]`."""
    reach = away[:, -1:] * 1.05 + 1e-9
    kernel = (1 - (away / reach) ** 3) ** 1.5  # the square root of the tricube
    x = offsets / reach[..., None]
    products = [x[..., i] * x[..., j] for i in range(3) for j in range(i, 3)]
    design = np.concatenate([np.ones_like(x[..., :1]), x, np.stack(products, -1)], axis=-1)
    solved = np.linalg.pinv(design * kernel[..., None], rcond=1e-6)
    residual = values - design @ (solved @ (values * kernel[..., None]))
    squares = (residual**2 * kernel[..., None] ** 2).sum(axis=1)
    freedom = (kernel**2).sum(axis=1) * (1 - NUMBERS / kernel.shape[1])
    return solved[:, 0] * kernel, np.sqrt(squares / freedom[:, None])
