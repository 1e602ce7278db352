"""A photographed inlay, piece by piece: which shell each piece shows, and how its layers lean.

The surface is known and polished; in each piece the film layers lean as they were cut. Every pixel
is solved for the layers' normal with each of the shells (`solve.py`); a piece then takes the shell
that fits all of its pixels best, and the mean of their normals, or each pixel keeps its own.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from raden_torch.brdf.materials.surface import Reflection
from raden_torch.stereo.observed_light import ObservedLight, shown, thinned
from raden_torch.stereo.photographed import AT_ONCE, Photographed
from raden_torch.stereo.solve import Known, ModelNormals, learnt, solve_by_model

_ERODED_PX = 1
"""At its rim a pixel shows lacquer, too."""
_MOST, _MOST_OF_ALL, _LEAST = 1 << 12, 1 << 18, 32
"""Pixels of a piece that decide about it; of all pieces; of a piece where there are many."""
_GAIN = (0.2, 5.0)


@dataclass(frozen=True, eq=False)
class Piece:
    """One connected piece.

    Attributes:
        pixels: how many; `material`: of the palette, the ground being 0.
        layer_normal: x, y, z, the mean of its pixels'.
        error_deg: the standard error of the layers' normal.
        varies_deg: how far its pixels' own normals are from it, as a standard deviation.
        residual: what the shell leaves with each pixel's own layers, in standard deviations.
        runner_up: that of the shell that fits second best; None with one shell.
    """

    pixels: int
    material: int
    layer_normal: tuple[float, float, float]
    error_deg: float
    varies_deg: float
    residual: float
    runner_up: float | None


@dataclass(frozen=True, eq=False)
class Inlay:
    """What was found; maps over H·W.

    Attributes:
        material: `[H·W]` of the palette.
        layer_normal: `[3, H·W]`, the surface's where there is no shell.
        gain: `[C, H·W]`, the factor on what the palette reflects, 1 in the median over the shells'
            pixels; no less than 0.2, no more than 5, and 1 where there is no shell.
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
    inner = torch.from_numpy(without_rims(pieces).reshape(-1))
    count = int(number.max())
    most = max(_LEAST, min(_MOST, _MOST_OF_ALL // count))
    pixels = _by_piece(number, count)
    some = [
        thinned(own if len(own) else whole, most)  # the rim where a piece has nothing else
        for own, whole in zip(_by_piece(inner, count), pixels, strict=True)
    ]
    index = torch.cat(some)
    light = replace(seen.at(index), surface=surface[:, index])
    known = learnt(shells, light)
    places = torch.arange(len(index)).split([len(own) for own in some])
    fits = _fits(shells, light, places, known, given, lambda share: done(0.8 * share))
    material = torch.zeros(number.shape, dtype=torch.long)
    layers, error = surface.clone(), torch.zeros(number.shape)
    found = []
    for k, everywhere in enumerate(pixels):
        piece = _piece(fits[k], light.counted[places[k]], len(everywhere))
        found.append(piece)
        material[everywhere] = piece.material
        for part in everywhere.split(AT_ONCE):
            if not per_pixel:
                layers[:, part] = torch.tensor(piece.layer_normal)[:, None]
                error[part] = piece.error_deg
                continue
            whole = replace(seen.at(part), surface=surface[:, part])
            fit = solve_by_model([shells[piece.material - 1]], whole, known=known)
            layers[:, part], error[part] = fit.normal, fit.error_deg
        done(0.8 + 0.1 * (k + 1) / count)
    gain, exposure = _gains(seen, shells, material, layers, surface)
    return Inlay(material, layers, gain, error, exposure, tuple(found))


def _fits(
    shells: Sequence[Reflection],
    light: ObservedLight,
    places: Sequence[Tensor],
    known: Known,
    given: NDArray[np.int64] | None,
    done: Callable[[float], None],
) -> list[dict[int, ModelNormals]]:
    """Each piece's pixels, which are at these places of the light, with each shell, or the given
    one, by material."""
    found: list[dict[int, ModelNormals]] = [{} for _ in places]
    for shell, material in enumerate(shells):
        own = [k for k in range(len(places)) if given is None or given[k] == shell]

        def share(part: float, before: int = shell) -> None:
            done((before + part) / len(shells))

        if not own:
            continue
        some = light.at(torch.cat([places[k] for k in own]))
        fit = solve_by_model([material], some, known=known, progress=share)
        for k, normals in zip(own, fit.split([len(places[k]) for k in own]), strict=True):
            found[k][shell + 1] = normals
    return found


def _piece(fits: Mapping[int, ModelNormals], counted: Tensor, pixels: int) -> Piece:
    """The shell whose pixels, each with its own layers, are nearest to the photographs.

    Args:
        fits: by material.
        counted: how many values of each pixel that was fitted count.
        pixels: of all the piece.
    """
    tried = []
    for material, fit in fits.items():
        normals, weight = fit.normal, 1 / (fit.error_deg**2 + 0.01)
        middle = normals.median(1, keepdim=True).values
        for _ in range(4):  # the outliers' weight falls with their distance
            apart = torch.rad2deg((normals - middle).norm(dim=0))
            sure = weight / (1 + (apart / 2) ** 2)
            middle = (normals * sure).sum(1, keepdim=True)
            middle = middle / middle.norm(dim=0)
        residual = float((2 * fit.cost / counted.clamp(min=1)).mean().sqrt())
        varies = float(1.4826 * apart.median())
        # neighbours err together, and the model's own error is all of the pixels'
        scatter = varies / max(len(apart) / 9, 1) ** 0.5
        error = (scatter**2 + float(fit.error_deg.median()) ** 2) ** 0.5
        x, y, z = (float(c) for c in middle[:, 0])
        tried.append(Piece(pixels, material, (x, y, z), error, varies, residual, None))
    best, *others = sorted(tried, key=lambda piece: piece.residual)
    return replace(best, runner_up=others[0].residual if others else None)


def _gains(
    seen: Photographed,
    shells: Sequence[Reflection],
    material: Tensor,
    layers: Tensor,
    surface: Tensor,
) -> tuple[Tensor, float]:
    """`Inlay.gain` and `Inlay.exposure`: photographs over what the palette shows."""
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


def without_rims(pieces: NDArray[np.int32]) -> NDArray[np.int64]:
    """The pieces without their rims: of a narrow one nothing is left."""
    import cv2

    kernel = np.ones((2 * _ERODED_PX + 1,) * 2, np.uint8)
    numbers = pieces.astype(np.float32)
    low, high = cv2.erode(numbers, kernel), cv2.dilate(numbers, kernel)
    return np.where(low == high, pieces, 0).astype(np.int64)


def _by_piece(number: Tensor, count: int) -> Sequence[Tensor]:
    """The pixels of each piece, in order."""
    there = number.nonzero()[:, 0]
    sizes = torch.bincount(number[there], minlength=count + 1)[1:]
    return there[torch.argsort(number[there], stable=True)].split(sizes.tolist())
