"""Lat-long maps of the whole sphere: directions, solid angles, blur, rotation.

The first row is up (+y), the middle column lies along −z, x grows to the right: what a viewer who
looks along −z sees, unmirrored, as in Debevec's light probes.
"""

from __future__ import annotations

import math

import torch
from torch import Tensor

_FINEST = 513
"""Nodes along each side of the finest octahedral map."""
_ROWS_KEPT = 512
"""A finer map is halved before it is blurred."""


def directions(height: int, width: int) -> Tensor:
    """`[3, H, W]` float64 unit vectors to the middle of every texel."""
    polar = (torch.arange(height, dtype=torch.float64) + 0.5) * (math.pi / height)
    turn = ((torch.arange(width, dtype=torch.float64) + 0.5) / width - 0.5) * (2 * math.pi)
    polar, turn = torch.meshgrid(polar, turn, indexing="ij")
    return torch.stack([polar.sin() * turn.sin(), polar.cos(), -polar.sin() * turn.cos()])


def solid_angles(height: int, width: int) -> Tensor:
    """`[H, 1]` float64, of one texel of each row; all together are 4π."""
    edges = torch.cos(torch.arange(height + 1, dtype=torch.float64) * (math.pi / height))
    return ((edges[:-1] - edges[1:]) * (2 * math.pi / width))[:, None]


def about_y(degrees: float) -> Tensor:
    """`[3, 3]` float64: turns vectors about +y, counter-clockwise seen from above."""
    c, s = math.cos(math.radians(degrees)), math.sin(math.radians(degrees))
    return torch.tensor([[c, 0, s], [0, 1, 0], [-s, 0, c]], dtype=torch.float64)


class SphereBlur:
    """A lat-long map, blurred by Gaussians.

    Around, a Gaussian is a factor of each row's Fourier series, wider in degrees near the poles;
    up and down it is a matrix, which goes on beyond a pole on the other side (there, odd terms
    change sign).
    """

    def __init__(self, radiance: Tensor) -> None:
        image = radiance.detach().double().cpu()[None]
        while image.shape[2] > _ROWS_KEPT:
            # rows in pairs, by solid angle; an odd last row is kept as it is
            image = _halved(image)
        self.terms = torch.fft.rfft(image[0], dim=2)
        self.width = image.shape[3]

    def octahedral(self, sigma: float, spacing: float = 1.5) -> Tensor:
        """`[3, S, S]` float32: blurred by `sigma` radians, at the nodes of an octahedral map.

        Args:
            spacing: of the nodes, in `sigma`; no closer than the texels.
        """
        blurred = self(sigma).float()
        texel = math.pi / blurred.shape[1]
        side = min(_FINEST, 2 * math.ceil(math.pi / max(spacing * sigma, texel)) + 1)
        x, y, z = octahedral_directions(side).float()
        # a column more on each side, so that reading goes around
        wide = torch.cat([blurred[..., -1:], blurred, blurred[..., :1]], dim=2)
        turn = torch.atan2(x, -z) / math.pi * (self.width / (self.width + 2))
        polar = torch.atan2(torch.hypot(x, z), y)
        at = torch.stack([turn, polar * (2 / math.pi) - 1], dim=-1)[None]
        grid = torch.nn.functional.grid_sample
        return grid(wide[None], at, align_corners=False, padding_mode="border")[0]

    def __call__(self, sigma: float) -> Tensor:
        """`[3, H, W]` float64."""
        height, count = self.terms.shape[1:]
        polar = (torch.arange(height, dtype=torch.float64) + 0.5) * (math.pi / height)
        m = torch.arange(count, dtype=torch.float64)
        around = torch.exp(-((m * sigma / polar.sin()[:, None]) ** 2) / 2)
        between = polar[:, None] - polar
        beyond = [polar[:, None] + polar, 2 * math.pi - polar[:, None] - polar]

        def bell(angle: Tensor) -> Tensor:
            return torch.exp(-((angle / sigma) ** 2) / 2) * polar.sin()

        # a Gaussian narrower than a row is no blur
        direct = bell(between) + torch.diag(1e-12 + 0 * polar)
        folded = bell(beyond[0]) + bell(beyond[1])
        total = (direct + folded).sum(1, keepdim=True)
        even, odd = ((direct + sign * folded) / total for sign in (1, -1))
        terms = self.terms * around
        out = torch.empty_like(terms)
        out[..., 0::2] = even.to(terms.dtype) @ terms[..., 0::2]
        out[..., 1::2] = odd.to(terms.dtype) @ terms[..., 1::2]
        return torch.fft.irfft(out, n=self.width, dim=2)


def _halved(image: Tensor) -> Tensor:
    """`[1, 3, H, W]` with half as many rows and columns; sides that do not divide are cropped by
    interpolation first."""
    height, width = image.shape[2] // 2 * 2, image.shape[3] // 4 * 4
    if (height, width) != tuple(image.shape[2:]):
        image = torch.nn.functional.interpolate(image, size=(height, 2 * height), mode="area")
    weight = solid_angles(height, image.shape[3])
    pool = torch.nn.functional.avg_pool2d
    return pool(image * weight, 2) / pool(weight.expand(1, 1, -1, 2), 2)


def octahedral_directions(side: int) -> Tensor:
    """`[3, S, S]` float64 unit vectors of an octahedral map's nodes, the outermost on its edge."""
    at = torch.linspace(-1, 1, side, dtype=torch.float64)
    y, x = torch.meshgrid(at, at, indexing="ij")
    z = 1 - x.abs() - y.abs()
    fold = (-z).clamp(min=0)
    x, y = x - fold * torch.where(x < 0, -1.0, 1.0), y - fold * torch.where(y < 0, -1.0, 1.0)
    return torch.nn.functional.normalize(torch.stack([x, y, z]), dim=0)


def octahedral(x: Tensor, y: Tensor, z: Tensor) -> tuple[Tensor, Tensor]:
    """Where unit vectors lie in an octahedral map, −1…1 each (Engelhardt, Dachsbacher 2008)."""
    scale = 1 / (x.abs() + y.abs() + z.abs())
    u, v = x * scale, y * scale
    fold = (-z * scale).clamp(min=0)
    return u + torch.copysign(fold, u), v + torch.copysign(fold, v)
