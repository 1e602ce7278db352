"""A palette that is learnt from the inlay's own photographs: `learn_shell.py` for each shell.

What cannot be told from them is how bright the shells are beside a white surface: the scale comes
from the photographs' value of one, or from an albedo that is typical of shell.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from raden_torch.brdf.model.model import RadenBrdf
from raden_torch.errors import InputError
from raden_torch.stereo.inlay import without_rims
from raden_torch.stereo.learn_shell import MOST_PIXELS, LearntShell, learn_shell
from raden_torch.stereo.learnt_model import TYPICAL_ALBEDO, albedo_of, learnt_model
from raden_torch.stereo.observed_light import thinned
from raden_torch.stereo.photographed import Photographed

MIN_LAMPS, MIN_PIXELS = 5, 60
_LEAST_SPREAD_DEG = 2.0


@dataclass(frozen=True, eq=False)
class LearntPalette:
    """The shells of an inlay.

    Attributes:
        models: one a shell; `shells`: what is known of each.
        exposure: the photographs' value for a radiance of 1, which the models' scale rests on.
        notes: what to warn of.
    """

    models: tuple[RadenBrdf, ...]
    shells: tuple[LearntShell, ...]
    exposure: float
    notes: tuple[str, ...]


@torch.no_grad()
def learn_palette(
    seen: Photographed,
    pieces: NDArray[np.int32],
    shell_of: NDArray[np.int64],
    surface: Tensor,
    names: Sequence[str],
    photographs: Sequence[str],
    *,
    white: float | None = None,
    progress: Callable[[float], None] | None = None,
) -> LearntPalette:
    """A model of each shell.

    Args:
        seen: the photographs.
        pieces: `[H, W]` numbers from 1, 0 for the ground.
        shell_of: `[pieces]` which shell each is, from 0.
        surface: `[3, H·W]` unit normals of the polished surface.
        names: of the shells; `photographs`: of the pictures, for the models' provenance.
        white: the photographs' value of a white diffuser that faces the lamp; without it the
            brightest shell's albedo is taken as 0.4.
        progress: called with the share that is done, 0…1.

    Raises:
        InputError: fewer than `MIN_LAMPS` lamps, or `MIN_PIXELS` pixels of a shell; more light
            reflected than there is.
    """
    if len(photographs) < MIN_LAMPS:
        raise InputError(
            f"photographs: expected at least {MIN_LAMPS} to learn the shells from, better 8 or "
            f"more, got {len(photographs)}; take more, or give a model of each shell"
        )
    number = torch.from_numpy(without_rims(pieces).reshape(-1))
    shell = torch.from_numpy(np.concatenate([[-1], shell_of]))[number]
    found: list[LearntShell] = []
    for place, name in enumerate(names):
        index = (shell == place).nonzero()[:, 0]
        if len(index) < MIN_PIXELS:
            raise InputError(
                f"{name}: expected at least {MIN_PIXELS} pixels within its pieces to learn it "
                f"from, got {len(index)}; larger photographs, or a model of it, would help"
            )
        index = thinned(index, MOST_PIXELS)
        light = replace(seen.at(index), surface=surface[:, index])

        def done(share: float, before: int = place) -> None:
            if progress is not None:
                progress((before + share) / len(names))

        found.append(learn_shell(light, done))
    exposure = _exposure(found, white)
    models = tuple(
        _model(shell, exposure, name, photographs) for shell, name in zip(found, names, strict=True)
    )
    return LearntPalette(models, tuple(found), exposure, _notes(found, names))


def _model(shell: LearntShell, exposure: float, name: str, photographs: Sequence[str]) -> RadenBrdf:
    said = {**shell.as_dict(), "photographs": list(photographs)}
    scale = shell.scale / exposure
    return learnt_model(shell.table.values, scale, name, said, shell.box_deg)


def _exposure(found: Sequence[LearntShell], white: float | None) -> float:
    """The photographs' value for a radiance of 1."""
    albedo = max(shell.scale * albedo_of(shell.table.values) for shell in found)
    if white is None:
        return albedo / TYPICAL_ALBEDO
    if albedo > math.pi * white:
        raise InputError(
            f"white: expected the photographs' value of a white surface, got {white:g}, beside "
            "which the shells would reflect more than all light"
        )
    return math.pi * white


def _notes(found: Sequence[LearntShell], names: Sequence[str]) -> tuple[str, ...]:
    return tuple(
        f"{name}: its layers lean by only {shell.spread_deg:.1f} degrees to and fro, so that its "
        "model holds near these lamps and this camera only"
        for name, shell in zip(names, found, strict=True)
        if shell.spread_deg < _LEAST_SPREAD_DEG
    )
