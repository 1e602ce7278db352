"""Normals and scales to the minimum of a robust residual: Levenberg–Marquardt, pixel by pixel.

Two parameters turn the normal in its tangent plane, a third is the logarithm of the scale g. The
residual of a value is r = (g p − o)/σ, its cost c² log(1 + (r/c)²)/2 (Cauchy; Holland & Welsch
1977), so that a cast shadow or another lamp's mirror image weighs little. Slopes are differences
over `_DIFFERENCE_DEG`: a table that is read trilinearly has no other slope that means something
over a step, the fused kernel gives them at once, and any material will do.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
from torch import Tensor

from raden_torch.brdf.materials.surface import Reflection
from raden_torch.stereo.normal_search import tangents
from raden_torch.stereo.observed_light import ObservedLight, shown

_DIFFERENCE_DEG = 0.2
_LONGEST_DEG = 4.0
CAUCHY = 2.4
"""Standard deviations beyond which a residual counts little."""
_DAMPING = 1e-2


@dataclass(frozen=True, eq=False)
class Refined:
    """Of P pixels.

    Attributes:
        normal: `[3, P]` unit.
        gain: `[P]`, the scale.
        cost: `[P]`, Σ of the robust costs.
        hessian: `[3, 3, P]` Jᵀ W J at the minimum: turns in radians along `tangents`, log scale.
        spread: `[P]`, the mean robust weight times r², over the degrees of freedom left.
    """

    normal: Tensor
    gain: Tensor
    cost: Tensor
    hessian: Tensor
    spread: Tensor


def refine(
    material: Reflection,
    light: ObservedLight,
    normal: Tensor,
    gain: Tensor,
    *,
    rounds: int,
    prior: tuple[float, float] | None = None,
) -> Refined:
    """From starts `[3, P]` and `[P]`.

    Args:
        prior: mean and standard deviation of log g where other pixels have told it.
    """
    problem = _Problem(material, light, prior)
    log_gain = gain.clamp(min=1e-12).log()
    damping = torch.full_like(log_gain, _DAMPING)
    residual = problem.residual(normal, log_gain)
    cost = problem.cost(residual, log_gain)
    for _ in range(rounds):
        hessian, slope, _ = problem.equations(normal, log_gain, residual)
        step = _solved(hessian, slope, damping)
        tried, tried_gain = _moved(normal, log_gain, step)
        tried_residual = problem.residual(tried, tried_gain)
        tried_cost = problem.cost(tried_residual, tried_gain)
        better = tried_cost < cost
        normal = torch.where(better, tried, normal)
        log_gain = torch.where(better, tried_gain, log_gain)
        residual = torch.where(better, tried_residual, residual)
        cost = torch.where(better, tried_cost, cost)
        damping = torch.where(better, damping / 5, damping * 6).clamp(1e-6, 1e6)
    hessian, _, spread = problem.equations(normal, log_gain, residual)
    return Refined(normal, log_gain.exp(), cost, hessian, spread)


@dataclass(frozen=True, eq=False)
class _Problem:
    material: Reflection
    light: ObservedLight
    prior: tuple[float, float] | None

    def radiance(self, normal: Tensor) -> Tensor:
        return shown(self.material, normal, self.light)

    def residual(self, normal: Tensor, log_gain: Tensor) -> Tensor:
        """`[K, C, P]`"""
        return (self.radiance(normal) * log_gain.exp() - self.light.value) * self.light.weight

    def cost(self, residual: Tensor, log_gain: Tensor) -> Tensor:
        data = cauchy_cost(residual)
        if self.prior is None:
            return data
        return data + ((log_gain - self.prior[0]) / self.prior[1]) ** 2 / 2

    def equations(
        self, normal: Tensor, log_gain: Tensor, residual: Tensor
    ) -> tuple[Tensor, Tensor, Tensor]:
        """Jᵀ W J `[3, 3, P]`, Jᵀ W r `[3, P]` and the weighted mean square of r `[P]`."""
        light = self.light
        step = math.radians(_DIFFERENCE_DEG)
        columns = []
        for across in tangents(normal):
            turned = normal * math.cos(step) + across * math.sin(step)
            columns.append((self.residual(turned, log_gain) - residual) / step)
        columns.append(residual + light.value * light.weight)  # g p/σ
        robust = light.usable / (1 + (residual / CAUCHY) ** 2)
        pixels = residual.shape[-1]
        columns = [c.flatten(0, 1) for c in (*columns, residual)]
        robust = robust.flatten(0, 1)
        moments = residual.new_empty(4, 4, pixels)
        for i, a in enumerate(columns):
            weighted = a * robust
            for j in range(i + 1):
                moments[i, j] = moments[j, i] = (weighted * columns[j]).sum(0)
        hessian, slope = moments[:3, :3], moments[:3, 3]
        if self.prior is not None:
            mean, deviation = self.prior
            hessian[2, 2] += 1 / deviation**2
            slope[2] += (log_gain - mean) / deviation**2
        spread = moments[3, 3] / (light.counted - 3).clamp(min=1)
        return hessian, slope, spread


def _solved(hessian: Tensor, slope: Tensor, damping: Tensor) -> Tensor:
    """The step `[3, P]` of (H + λ diag H) x = −slope; turns no longer than `_LONGEST_DEG`."""
    a = hessian.movedim(-1, 0)
    diagonal = torch.diagonal(a, dim1=1, dim2=2)
    lifted = diagonal * damping[:, None] + 1e-6 + 1e-6 * diagonal.amax(1, keepdim=True)
    a = a + torch.diag_embed(lifted)
    x = torch.linalg.solve_ex(a, -slope.T[..., None])[0][..., 0].T
    x = torch.nan_to_num(x, nan=0.0, posinf=0.0, neginf=0.0)
    turn = x[:2].norm(dim=0)
    x = x * (math.radians(_LONGEST_DEG) / turn.clamp(min=1e-12)).clamp(max=1.0)
    return x.clamp(-1, 1)


def _moved(normal: Tensor, log_gain: Tensor, step: Tensor) -> tuple[Tensor, Tensor]:
    a, b = tangents(normal)
    moved = normal + a * step[0] + b * step[1]
    return moved / moved.norm(dim=0), log_gain + step[2]


def cauchy_cost(residual: Tensor) -> Tensor:
    """`[P]` of residuals `[K, C, P]` in standard deviations."""
    return (torch.log1p((residual / CAUCHY) ** 2) * (CAUCHY**2 / 2)).sum((0, 1))
