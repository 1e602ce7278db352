"""A photographed inlay, piece by piece: which shell each piece shows, and how its layers lean.

The surface is known and polished; in each piece the film layers lean as they were cut. Every pixel
is solved for the layers' normal with each of the shells (`solve.py`); a piece then takes the shell
that fits all of its pixels best, and the mean of their normals, or each pixel keeps its own.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from raden_torch.brdf.materials.surface import Reflection
from raden_torch.stereo.observed_light import ObservedLight, shown
from raden_torch.stereo.photographed import Photographed
from raden_torch.stereo.solve import ModelNormals, learnt, solve_by_model

_ERODED_PX = 1
"""At its rim a pixel shows lacquer, too."""
_MOST = 1 << 12
"""Pixels of a piece that decide about it."""
_GAIN = (0.2, 5.0)


@dataclass(frozen=True, eq=False)
class Piece:
    """One connected piece.

    Attributes:
        pixels: how many; `material`: of the palette, the ground being 0.
        layer_normal: x, y, z; None where each pixel has its own.
        error_deg: the standard error of the layers' normal.
        residual: the weighted root mean square of what the model leaves, in standard deviations.
        runner_up: that of the shell that fits second best; None with one shell.
    """

    pixels: int
    material: int
    layer_normal: tuple[float, float, float] | None
    error_deg: float
    residual: float
    runner_up: float | None


@dataclass(frozen=True, eq=False)
class Inlay:
    """What was found; maps over H·W.

    Attributes:
        material: `[H·W]` of the palette.
        layer_normal: `[3, H·W]`, the surface's where there is no shell.
        gain: `[C, H·W]`, the factor on what the palette reflects, 1 in the mean.
        error_deg: `[H·W]` of the layers' normal.
        exposure: the photographs' value for a radiance of 1.
        pieces: by falling area.
    """

    material: Tensor
    layer_normal: Tensor
    gain: Tensor
    error_deg: Tensor
    exposure: float
    pieces: tuple[Piece, ...]


@torch.no_grad()
def find_inlay(
    seen: Photographed,
    shells: Sequence[Reflection],
    pieces: NDArray[np.int32],
    surface: Tensor,
    *,
    given: NDArray[np.int64] | None = None,
    per_pixel: bool = False,
    progress: Callable[[float], None] | None = None,
) -> Inlay:
    """Which shell each piece shows, and how its layers lean.

    Args:
        seen: the photographs.
        shells: the palette without its ground.
        pieces: `[H, W]` numbers from 1, 0 for the ground; by falling area.
        surface: `[3, H·W]` unit normals of the polished surface.
        given: `[pieces]` which shell each is, from 0, where that is known.
        per_pixel: each pixel keeps its own layers.
        progress: called with the share that is done, 0…1.
    """
    done = progress or (lambda share: None)
    number = torch.from_numpy(pieces.reshape(-1).astype(np.int64))
    inner = torch.from_numpy(_inner(pieces).reshape(-1))
    count = int(number.max())
    chosen = [_some((inner == k + 1).nonzero()[:, 0], number, k + 1) for k in range(count)]
    index = torch.cat(chosen)
    light = replace(seen.at(index), surface=surface[:, index])
    known = learnt(shells, _thin(light))
    fits = []
    for place, shell in enumerate(shells):

        def share(part: float, before: int = place) -> None:
            done(0.8 * (before + part) / len(shells))

        fits.append(solve_by_model([shell], light, known=known, progress=share))
    material = torch.zeros(number.shape, dtype=torch.long)
    layers, error = surface.clone(), torch.zeros(number.shape)
    found, start = [], 0
    for k, own in enumerate(chosen):
        of = slice(start, start + len(own))
        start += len(own)
        known_shell = None if given is None else int(given[k])
        part = light.at(torch.arange(of.start, of.stop))
        piece = _piece(shells, fits, part, of, known_shell)
        everywhere = number == k + 1
        material[everywhere] = piece.material
        if piece.layer_normal is not None:
            layers[:, everywhere] = torch.tensor(piece.layer_normal)[:, None]
        error[everywhere] = piece.error_deg
        found.append(replace(piece, pixels=int(everywhere.sum())))
        if per_pixel:
            rest = everywhere.nonzero()[:, 0]
            whole = replace(seen.at(rest), surface=surface[:, rest])
            own_fit = solve_by_model([shells[piece.material - 1]], whole, known=known)
            layers[:, rest], error[rest] = own_fit.normal, own_fit.error_deg
            found[-1] = replace(found[-1], layer_normal=None)
        done(0.8 + 0.1 * (k + 1) / count)
    gain, exposure = _gains(seen, shells, material, layers, surface)
    return Inlay(material, layers, gain, error, exposure, tuple(found))


def _piece(
    shells: Sequence[Reflection],
    fits: Sequence[ModelNormals],
    light: ObservedLight,
    of: slice,
    given: int | None,
) -> Piece:
    """The shell whose pixels, with the piece's one normal, are nearest to the photographs."""
    tried = []
    for place, (shell, fit) in enumerate(zip(shells, fits, strict=True)):
        if given is not None and place != given:
            continue
        normals, weight = fit.normal[:, of], 1 / (fit.error_deg[of] ** 2 + 0.01)
        middle = normals.median(1, keepdim=True).values
        for _ in range(4):  # the outliers' weight falls with their distance
            apart = torch.rad2deg((normals - middle).norm(dim=0))
            sure = weight / (1 + (apart / 2) ** 2)
            middle = (normals * sure).sum(1, keepdim=True)
            middle = middle / middle.norm(dim=0)
        gain = fit.gain[of].median()
        radiance = shown(shell, middle.expand_as(normals), light)
        residual = ((gain * radiance - light.value) * light.weight).clamp(-30, 30)
        rms = float(residual.square().mean().sqrt())
        # neighbours err together, and the model's own error is all of the pixels'
        scatter = float(1.4826 * apart.median()) / max(len(apart) / 9, 1) ** 0.5
        error = (scatter**2 + float(fit.error_deg[of].median()) ** 2) ** 0.5
        tried.append((rms, place, middle[:, 0], error))
    tried.sort(key=lambda t: t[0])
    rms, place, normal, error = tried[0]
    x, y, z = (float(c) for c in normal)
    other = tried[1][0] if len(tried) > 1 else None
    return Piece(light.pixels, place + 1, (x, y, z), error, rms, other)


def _gains(
    seen: Photographed,
    shells: Sequence[Reflection],
    material: Tensor,
    layers: Tensor,
    surface: Tensor,
) -> tuple[Tensor, float]:
    """`[C, H·W]` photographs over what the palette shows, 1 in the median and where it is dark;
    and the exposure."""
    gain = torch.ones(len(seen.balance), len(material))
    for place, shell in enumerate(shells):
        for index in (material == place + 1).nonzero()[:, 0].split(1 << 15):
            light = replace(seen.at(index), surface=surface[:, index])
            radiance = shown(shell, layers[:, index], light)
            sure = light.weight**2
            both, own = (sure * radiance * light.value).sum(0), (sure * radiance**2).sum(0)
            gain[:, index] = both / own.clamp(min=1e-30)
    there = material > 0
    exposure = float(gain[:, there].median())
    gain = (gain / max(exposure, 1e-30)).clamp(*_GAIN)
    gain[:, ~there] = 1.0
    return gain, exposure


def _inner(pieces: NDArray[np.int32]) -> NDArray[np.int64]:
    """The pieces without their rims, but where nothing would be left."""
    import cv2

    kernel = np.ones((2 * _ERODED_PX + 1,) * 2, np.uint8)
    numbers = pieces.astype(np.float32)
    low, high = cv2.erode(numbers, kernel), cv2.dilate(numbers, kernel)
    return np.where(low == high, pieces, 0).astype(np.int64)


def _some(inner: Tensor, number: Tensor, piece: int) -> Tensor:
    """No more than `_MOST` pixels of a piece, at least one."""
    own = inner if len(inner) else (number == piece).nonzero()[:, 0]
    return own[:: max(1, -(-len(own) // _MOST))]


def _thin(light: ObservedLight) -> ObservedLight:
    return light.at(torch.arange(0, light.pixels, max(1, light.pixels >> 11)))
