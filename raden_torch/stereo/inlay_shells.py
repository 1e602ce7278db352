"""The shells of an inlay, given or learnt, and which piece is of which."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from torch import Tensor

from raden_torch.brdf.materials.surface import Reflection
from raden_torch.stereo.learnt_palette import LearntPalette, learn_palette
from raden_torch.stereo.photographed import Photographed
from raden_torch.stereo.split_pieces import split_pieces

_MOVED = 0.02
"""Where a larger share of the pixels turns out to be another shell, all are learnt once more."""


@dataclass(frozen=True, eq=False)
class InlayShells:
    """Shells and pieces.

    Attributes:
        shells: none before they are learnt.
        pieces: `[H, W]` numbers from 1, 0 for the ground.
        shell_of: `[pieces]` which shell each is, from 0.
        learnt: None where they were given.
    """

    shells: Sequence[Reflection]
    pieces: NDArray[np.int32]
    shell_of: NDArray[np.int64]
    learnt: LearntPalette | None = None

    @property
    def map(self) -> NDArray[np.int64]:
        """`[H, W]` which shell each pixel is, from 0; 0 on the ground, too."""
        return np.asarray(self.shell_of[self.pieces - 1] * (self.pieces > 0))


def find_shells(
    start: InlayShells,
    seen: Photographed,
    surface: Tensor,
    names: Sequence[str],
    photographs: Sequence[Path],
    *,
    white: float | None,
    split_px: int | None,
    progress: Callable[[float], None],
) -> InlayShells:
    """Learn the shells where none is given, and tell pieces apart that touch.

    Args:
        start: the pieces by a map or by their colours.
        surface: `[3, H·W]` unit normals of the polished surface.
        names: of the shells.
        white: as for `learn_palette`.
        split_px: pixels of the smallest part that a piece is cut into; None: none is cut.
        progress: called with the share that is done, 0…1.
    """

    def learn(at: InlayShells, done: Callable[[float], None]) -> InlayShells:
        found = learn_palette(
            seen,
            at.pieces,
            at.shell_of,
            surface,
            names,
            [path.name for path in photographs],
            white=white,
            progress=done,
        )
        return replace(at, shells=found.models, learnt=found)

    told = start if start.shells else learn(start, progress)
    if split_px is None or len(names) == 1:
        return told
    pieces, shell_of = split_pieces(
        seen, told.shells, told.pieces, surface, split_px, lambda share: None
    )
    split = replace(told, pieces=pieces, shell_of=shell_of)
    moved = (told.map != split.map).sum() / (pieces > 0).sum()
    if told.learnt is not None and moved > _MOVED:  # what they were learnt from was mixed
        return learn(split, lambda share: None)
    return split
