"""Geometries at which a shader may go wrong: every degenerate case, by region, seeded.

Each backend is measured on them against float64; see `worst_errors`.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import torch
from torch import Tensor

from raden_torch.geometry import dot, normalised, vectors_from_angles

Vectors = tuple[Tensor, Tensor, Tensor]
_HORIZON = 4 * torch.finfo(torch.float32).eps
Shader = Callable[[Tensor, Tensor, Tensor], Tensor]


@dataclass(frozen=True)
class RegionError:
    """How far a shader is from float64 in one region.

    Attributes:
        worst, typical: the largest and the 99 % quantile of |f − f64| cos θi, what an image shows,
            over the peak of f64 over all regions. Directions within rounding of the horizon, where
            f ends at a step, do not count.
        finite: True where nothing but finite values came back.
    """

    worst: float
    typical: float
    finite: bool


def regions(n: int = 2000, seed: int = 0) -> dict[str, Vectors]:
    """Normal, light, view by region, `[1, 3, n, 1]` each, float32 values held in float64.

    Distances from a singularity run from 1e-8 to 1e-2, evenly in their logarithm. Two regions are
    worse by nature: "L near V, too near", where float32 cannot tell L from V and the plane between
    them is noise, and "L near V, not unit", where scaling to unit length rounds them apart. There
    a backend must be finite and within the table's range, not equal to float64.
    """
    make = _MapSampler(n, torch.Generator().manual_seed(seed))
    flip = torch.tensor([-1.0, -1.0, 1.0], dtype=torch.float64).view(1, 3, 1, 1)
    normal, light, view = make.direction(), make.direction(), make.direction()
    light, view = _above(normal, light), _above(normal, view)
    off, box = make.offset(), make.angles(70.0)
    p = normalised(torch.linalg.cross(light, view, dim=1))
    in_plane = normalised(light * make.uniform() + view * make.uniform())
    found: dict[str, Vectors] = {
        "random": (normal, light, view),
        "inside the box": box,
        "L near V": (normal, light, normalised(light + make.direction() * make.log(-4, -2))),
        "L near V, not unit": (normal, 3 * light, light + make.direction() * make.log(-4, -2)),
        "L near V, too near": (normal, light, light + make.direction() * make.log(-8, -5)),
        "L near -V": (p, light, normalised(-light + off)),
        "N near L": (light + off, light, _above(light, view)),
        "N near V": (view + off, _above(view, light), view),
        "mirror": (normal, light, 2 * dot(normal, light) * normal - light + off),
        "N near the plane of L and V": (in_plane + off, light, view),
        "N near p": (p + off, light, view),
        "grazing light": (normal, _grazing(normal, light, make.log(-8, -2)), view),
        "grazing view": (normal, light, _grazing(normal, view, make.log(-8, -2))),
        "incidence near 0": make.angles(70.0, incidence=make.log(-8, -2)),
        "edges of the box": make.angles(70.0, edge=make.signed() * make.log(-8, -2)),
        "nodes": make.nodes(),
        "below the horizon": (normal, light * flip * -1 - normal, view),
        "huge and tiny": (normal * make.log(-18, 18), light * make.log(-18, 18), view * 1e-30),
    }
    return {name: _rounded(vectors) for name, vectors in found.items()}


def worst_errors(shader: Shader, reference: Shader, n: int = 2000) -> dict[str, RegionError]:
    """Run a float32 shader and a float64 reference on every region.

    Args:
        shader: called with float32 vectors.
        reference: called with the same vectors in float64.
    """
    sets = regions(n)
    truths = {name: reference(*vectors) for name, vectors in sets.items()}
    peak = max(float(truth.abs().max()) for truth in truths.values())
    found = {}
    for name, vectors in sets.items():
        value = shader(*(v.float() for v in vectors))
        cosine = dot(normalised(vectors[0]), normalised(vectors[1])).clamp(min=0)
        error = (value.double() - truths[name]).abs() * cosine / peak
        error = torch.where(_at_the_horizon(*vectors), torch.zeros_like(error), error).flatten()
        finite = bool(torch.isfinite(value).all())
        found[name] = RegionError(float(error.max()), float(error.quantile(0.99)), finite)
    return found


def _at_the_horizon(normal: Tensor, light: Tensor, view: Tensor) -> Tensor:
    """Where float32 cannot tell whether light or viewer is above the horizon, below which f is 0:
    their cosine is within rounding of 0."""
    n = normalised(normal)
    cosines = [dot(n, normalised(v)).abs() for v in (light, view)]
    return torch.minimum(*cosines) < _HORIZON


class _MapSampler:
    """Draws `[1, ·, n, 1]` maps in float64."""

    def __init__(self, n: int, generator: torch.Generator) -> None:
        self.n, self.generator = n, generator

    def uniform(self) -> Tensor:
        shape = (1, 1, self.n, 1)
        return torch.rand(shape, generator=self.generator, dtype=torch.float64)

    def signed(self) -> Tensor:
        return torch.where(self.uniform() < 0.5, -1.0, 1.0).double()

    def log(self, low: float, high: float) -> Tensor:
        return 10 ** (low + (high - low) * self.uniform())

    def direction(self) -> Tensor:
        shape = (1, 3, self.n, 1)
        return normalised(torch.randn(shape, generator=self.generator, dtype=torch.float64))

    def offset(self) -> Tensor:
        return self.direction() * self.log(-8, -2)

    def angles(
        self, limit_deg: float, *, incidence: Tensor | None = None, edge: Tensor | None = None
    ) -> Vectors:
        """Vectors at random angles of the box, turned at random."""
        limit = math.radians(limit_deg)
        a = self.uniform() * limit if incidence is None else incidence
        r, t = ((2 * self.uniform() - 1) * limit for _ in range(2))
        if edge is not None:
            which = (3 * self.uniform()).floor()
            a = torch.where(which == 0, limit + edge, a)
            r = torch.where(which == 1, self.signed() * (limit + edge), r)
            t = torch.where(which == 2, self.signed() * (limit + edge), t)
        return self._turned(vectors_from_angles(a, r, t))

    def nodes(self, step_deg: float = 5.0) -> Vectors:
        """Vectors at whole steps."""
        a = (self.uniform() * 15).floor()
        r, t = ((self.uniform() * 29).floor() - 14 for _ in range(2))
        step = math.radians(step_deg)
        return self._turned(vectors_from_angles(a * step, r * step, t * step))

    def _turned(self, vectors: Vectors) -> Vectors:
        q, _ = torch.linalg.qr(torch.randn(3, 3, generator=self.generator, dtype=torch.float64))
        q = q * torch.sign(torch.linalg.det(q))
        normal, light, view = (torch.einsum("ij,bjhw->bihw", q, vector) for vector in vectors)
        return normal, light, view


def _above(normal: Tensor, direction: Tensor) -> Tensor:
    return direction * torch.where(dot(normal, direction) < 0, -1.0, 1.0)


def _grazing(normal: Tensor, direction: Tensor, cosine: Tensor) -> Tensor:
    flat = normalised(direction - dot(normal, direction) * normal)
    return flat * torch.sqrt(1 - cosine**2) + normal * cosine


def _rounded(vectors: Vectors) -> Vectors:
    normal, light, view = (vector.float().double() for vector in vectors)
    return normal, light, view
