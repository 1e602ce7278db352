"""Dressings: the built-in artwork of a box, and layers from files over it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import torch
from torch import Tensor

from raden_torch.artwork.box import FRONT, LID, Box
from raden_torch.artwork.box_decoration import GOLD, SEAM, Chart, decorated
from raden_torch.brdf.files.image_file import read_mask, read_normal_map
from raden_torch.brdf.materials.coat import Coated
from raden_torch.brdf.materials.urushi import black_urushi
from raden_torch.errors import InputError
from raden_torch.scene.coverings import POLISH, MaterialNames, Named
from raden_torch.scene.dressing import Dressing
from raden_torch.scene.scene_file import LayerTable, ObjectTable

ARTWORK_SHELLS = ("yakogai", "mexican", "awabi", "akoya")
_FLATTEST = 0.05
"""z of a normal below which its slope is cut."""


def artwork_dressing(table: ObjectTable, box: Box, texel: float, names: MaterialNames) -> Dressing:
    """The maki-e box with each of its materials by name."""
    shells = {name: names.of(name) for name in ARTWORK_SHELLS}
    scales = {name: shell.scales for name, shell in shells.items()}
    last = [names.of(GOLD), names.of(table.ground), names.of(SEAM)]
    coverings = [c for named in (*shells.values(), *last) for c in named.coverings]
    charts = {
        part: decorated(box, part, texel, scales, table.seed)
        for part in (LID, *range(FRONT, FRONT + 4))
    }
    return Dressing(tuple(coverings), charts, len(coverings) - 2, polish_of(last[1]))


def plain_dressing(table: ObjectTable, names: MaterialNames) -> Dressing:
    """All ground."""
    ground = names.of(table.ground)
    return Dressing(ground.coverings, {}, 0, polish_of(ground))


def polish_of(ground: Named) -> Coated:
    """The face above a ground, and above the shells in it."""
    return ground.polish or black_urushi(POLISH)


def layered(
    dressing: Dressing,
    layers: Sequence[LayerTable],
    folder: Path,
    names: MaterialNames,
    size: tuple[int, int] | None = None,
) -> Dressing:
    """A dressing whose lid is covered by layers from files, the first on top.

    Args:
        size: width and height that the maps must have; None: those of the first.

    Raises:
        InputError: a map of another size.
    """
    if not layers:
        return dressing
    coverings, parts, slopes = list(dressing.coverings), [], None
    open_share: Tensor | None = None
    first = folder / layers[0].mask
    for layer in layers:
        path = folder / layer.mask
        mask = read_mask(path)[0]
        size = size or (mask.shape[2], mask.shape[1])
        _check_size(path, mask, size, first)
        open_share = torch.ones_like(mask) if open_share is None else open_share
        share = mask * open_share
        open_share = open_share - share
        named = names.of(layer.material)
        parts.append(share.expand(len(named.coverings), -1, -1) / len(named.coverings))
        coverings += named.coverings
        slopes = torch.zeros(2, *mask.shape[1:]) if slopes is None else slopes
        if layer.normal is not None:
            slope = slopes_of(folder / layer.normal, size, first)
            slopes = torch.where(share > 0.5, slope, slopes)
    assert open_share is not None
    assert slopes is not None
    below = dressing.charts.get(LID)
    if below is None:
        base = torch.zeros(len(dressing.coverings), *open_share.shape[1:])
        base[dressing.ground] = 1
        below = Chart(base, torch.zeros_like(slopes), torch.zeros_like(slopes))
    below = resized(below, open_share.shape[-2:])
    weights = torch.cat([below.weights * open_share, *parts])
    bare = (open_share > 0.5).to(slopes)
    chart = Chart(weights, slopes + bare * below.layers, below.flakes)
    charts = {part: _widened(c, len(coverings)) for part, c in dressing.charts.items()}
    return replace(dressing, coverings=tuple(coverings), charts={**charts, LID: chart})


def slopes_of(path: Path, size: tuple[int, int], like: Path) -> Tensor:
    """`[2, H, W]` slopes to the right and up of a normal map."""
    normal = read_normal_map(path)[0]
    _check_size(path, normal, size, like)
    return -normal[:2] / normal[2:].clamp(min=_FLATTEST)


def resized(chart: Chart, size: Sequence[int]) -> Chart:
    if tuple(chart.weights.shape[-2:]) == tuple(size):
        return chart

    def to(maps: Tensor) -> Tensor:
        return torch.nn.functional.interpolate(
            maps[None], size=tuple(size), mode="bilinear", antialias=True
        )[0]

    return Chart(to(chart.weights), to(chart.layers), to(chart.flakes))


def _widened(chart: Chart, count: int) -> Chart:
    more = chart.weights.new_zeros(count - len(chart.weights), *chart.weights.shape[1:])
    return replace(chart, weights=torch.cat([chart.weights, more]))


def _check_size(path: Path, maps: Tensor, size: tuple[int, int], like: Path) -> None:
    height, width = maps.shape[-2:]
    if (width, height) != size:
        raise InputError(
            f"{path}: expected {size[0]} x {size[1]} pixels, as {like} has, got {width} x {height}"
        )


def texel_for(box: Box, nearest: float, pixel: float) -> float:
    """The size of the maps' samples: a pixel where the box is nearest, 1/4000 of it at least."""
    return max(nearest * pixel, 2 * max(box.half) / 4000) if math.isfinite(nearest) else 0.002
