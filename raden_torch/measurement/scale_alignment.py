"""By which factors do the scales of several measurements agree best, as far as they may move?"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from raden_torch.arrays import Floats
from raden_torch.measurement.stack import Stack
from raden_torch.measurement.systematic_errors import SystematicErrors

_ROUNDS = 50
_SETTLED = 1e-12


@dataclass(frozen=True)
class Scales:
    errors: Floats  # [S] e_s, natural logarithms of factors
    remaining: float  # relative standard uncertainty of the result's scale
    share: Floats  # [S] of each measurement's weight in the result


def aligned_scales(stack: Stack, common: list[SystematicErrors]) -> Scales:
    """Gauss–Newton on z; the cells' means are eliminated in each round."""
    effect, sources = _effects(common), len(common)
    z: Floats = np.zeros(effect.shape[1])
    for _ in range(_ROUNDS):
        values, weight = stack.rescaled(effect @ z)
        mean = stack.total(values * weight) / stack.total(weight)
        pull = (weight * mean[stack.cell] * (values - mean[stack.cell])).sum(axis=1)
        right = np.bincount(stack.source, pull, sources)
        normal = effect.T @ _information(stack, mean, weight, sources) @ effect
        system = np.eye(len(z)) + normal
        before = z
        z = np.asarray(np.linalg.solve(system, effect.T @ right + normal @ z), np.float64)
        if abs(z - before).max(initial=0.0) < _SETTLED:
            break
    share = np.bincount(stack.source, (weight * mean[stack.cell] ** 2).sum(axis=1), sources)
    mixed = effect.T @ (share / share.sum())
    remaining = float(np.sqrt(mixed @ np.linalg.solve(system, mixed)))
    return Scales(effect @ z, remaining, share / share.sum())


def _effects(common: list[SystematicErrors]) -> Floats:
    """`[S, G]`: what one standard deviation of each independent scale does to each measurement."""
    references = [one.scale_reference or f"\0{number}" for number, one in enumerate(common)]
    names = sorted(set(references))
    effect = np.zeros((len(common), len(names) + len(common)))
    for row, (reference, one) in enumerate(zip(references, common, strict=True)):
        effect[row, names.index(reference)] = one.scale_std
        effect[row, len(names) + row] = one.white_mean_std
    return effect


def _information(stack: Stack, mean: Floats, weight: Floats, sources: int) -> Floats:
    """`[S, S]`: how well the shared cells know the scales against each other; 0 on their sum."""
    cells = len(stack.angles)
    total = np.zeros((sources, sources))
    for channel in range(len(stack.channels)):
        each = np.bincount(
            stack.cell * sources + stack.source, weight[:, channel], cells * sources
        ).reshape(cells, sources)
        square = mean[:, channel] ** 2
        total += np.diag(square @ each)
        total -= each.T @ (each * (square / each.sum(axis=1))[:, None])
    return total
