"""Does the surface look as if its depth were the distance along the ray, not planar z?

Points back-projected from the right reading of a plane or a sphere lie on a plane or a sphere;
from the other they lie on neither. A part of the image indicates distances where its points
fit one of the two `CLEARER` times better by it; nothing else about a surface is assumed, so most
pictures say nothing.
"""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray
from torch import Tensor

CLEARER = 10.0
SAMPLES_ACROSS = 192
"""The picture is thinned out to so many samples along its longer side."""
LEAST_SAMPLES = 100
LEAST_MISFIT, MOST_MISFIT = 2e-5, 5e-3
"""Beside the part's extent: what a reading that is wrong has at least, one that is right at most.
"""
LEAST_SHARE = 0.25
"""Of the samples must speak for the distance."""
_JUMP = 0.05
_TILES = 6

Points = NDArray[np.float64]


def warn_of_other_kind(path: object, depth: Tensor, there: Tensor, rays: Tensor) -> None:
    """Warn where depth that was read as planar z is the distance along the ray, by its shapes.

    Args:
        depth, there: `[1, 1, H, W]`; rays: `[1, 3, H, W]` with −1 along z.
    """
    found = shape_by_distance(depth, there, rays)
    if found is not None:
        shape, misfit = found
        warnings.warn(
            f"{path}: the depth was read as planar z, but as the distance along the ray the "
            f"surface is a {shape}, to {max(misfit, 1e-6):.1g} of its size; "
            'if so, give `depth="distance"`',
            stacklevel=6,
        )


def shape_by_distance(depth: Tensor, there: Tensor, rays: Tensor) -> tuple[str, float] | None:
    """The shape, plane or sphere, and its misfit, that indicates distances; None for none.

    Arguments as for `warn_of_other_kind`.
    """
    step = -(-max(depth.shape[-2:]) // SAMPLES_ACROSS)
    thin = (0, slice(None), slice(step // 2, None, step), slice(step // 2, None, step))
    mask = there[thin][0].cpu().numpy()
    d = np.where(mask, depth[thin][0].double().cpu().numpy(), 0.0)
    r = rays[thin].double().cpu().numpy()
    planar = d * r
    distance = planar / np.linalg.norm(r, axis=0)
    for_distance = for_planar = 0
    best = ("", 0.0, 0)
    for part in _parts(d, mask):
        here, other = _misfits(planar[:, part].T), _misfits(distance[:, part].T)
        shape, size = min(other, key=lambda name: other[name]), int(part.sum())
        if _is_clearer(other[shape], than=min(here.values())):
            for_distance += size
            best = max(best, (shape, other[shape], size), key=lambda b: b[2])
        elif _is_clearer(min(here.values()), than=other[shape]):
            for_planar += size
    # every sample is in two parts, a region and a tile of it
    least = max(LEAST_SHARE * 2 * int(mask.sum()), CLEARER * for_planar, 1)
    return None if for_distance < least else best[:2]


def _is_clearer(misfit: float, *, than: float) -> bool:
    return misfit < MOST_MISFIT and than > max(LEAST_MISFIT, CLEARER * misfit)


def _parts(d: Points, mask: NDArray[np.bool_]) -> Iterator[NDArray[np.bool_]]:
    """The regions without jumps in depth, and tiles of them: a room's walls meet without a jump."""
    from scipy import ndimage

    smooth = mask.copy()
    for axis in (0, 1):
        a, b = (np.take(d, range(k, d.shape[axis] - 1 + k), axis) for k in (0, 1))
        jump = np.abs(a - b) > _JUMP * np.minimum(a, b)
        pad = [(0, 0), (0, 0)]
        pad[axis] = (0, 1)
        smooth &= ~np.pad(jump, pad)
        pad[axis] = (1, 0)
        smooth &= ~np.pad(jump, pad)
    labels: NDArray[Any] = ndimage.label(smooth)[0]
    rows, columns = (np.arange(n) * _TILES // n for n in d.shape)
    tiles = labels * _TILES**2 + rows[:, None] * _TILES + columns
    for names in (labels, tiles):
        sizes = np.bincount(names[smooth].ravel())
        for name in np.nonzero(sizes >= LEAST_SAMPLES)[0]:
            yield smooth & (names == name)


def _misfits(points: Points) -> dict[str, float]:
    """RMS distance of `[n, 3]` points from the plane and sphere that fit them, over their extent.

    The sphere is the one with the least Σ (|p|² − 2 p·c − k)², which is linear in centre and k.
    """
    centred = points - points.mean(axis=0)
    extent = float(np.sqrt((centred**2).sum(axis=1).mean())) or 1.0
    p = centred / extent
    plane = float(np.sqrt(np.linalg.eigvalsh(p.T @ p / len(p))[0].clip(0)))
    columns = np.column_stack([2 * p, np.ones(len(p))])
    solution = np.linalg.lstsq(columns, (p**2).sum(axis=1), rcond=None)[0]
    radius = np.sqrt(max(solution[3] + solution[:3] @ solution[:3], 0.0))
    off = np.linalg.norm(p - solution[:3], axis=1) - radius
    return {"plane": plane, "sphere": float(np.sqrt((off**2).mean()))}
