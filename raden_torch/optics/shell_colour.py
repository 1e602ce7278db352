"""A simulated shell's BRDF in XYZ, without its spectrum: from tables over two numbers each.

What the films reflect depends on the angle on the facet and on the facet's slope; what the body
gives back, on the cosines of light and view. Both are integrated over the spectrum at the nodes of
these tables, and read linearly: 20 times as fast as `shell.brdf_per_sr` where many geometries are
asked for.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from scipy.ndimage import map_coordinates

from raden_torch.arrays import Floats
from raden_torch.optics.shell import (
    BANDS_NM,
    Specimen,
    body_per_sr,
    composed,
    film_reflectance,
    tablet_nm_at,
)
from raden_torch.optics.specimens import SPECIMENS, bands_to_xyz, rescaled

_Q_SQUARED, _GONE, _COSINES = 65, 33, 25


@dataclass(frozen=True, eq=False)
class ShellColour:
    """The tables of one specimen, in XYZ, where 1 is the light's own Y.

    Attributes:
        films: `[q², share of the way from flat to steep tablets, 3]`: reflectance of a facet.
        body: `[cosine of light, of view, 3]`: 1/sr, within the coat.
    """

    shell: Specimen
    films: Floats
    body: Floats

    @classmethod
    @lru_cache(maxsize=64)
    def of(cls, name: str, tablet_scale: float = 1.0) -> ShellColour:
        """Of a name in `SPECIMENS`, its tablets this many times as thick."""
        shell = rescaled(SPECIMENS[name], tablet_scale)
        to_xyz = bands_to_xyz() / bands_to_xyz().sum(0)[1]
        q_squared, gone = np.meshgrid(
            np.linspace(0, 1, _Q_SQUARED), np.linspace(0, 1, _GONE, endpoint=False), indexing="ij"
        )
        nm = tablet_nm_at(shell, gone)
        cosine = np.linspace(0, 1, _COSINES)
        grid = np.meshgrid(cosine, cosine, indexing="ij")
        assert len(BANDS_NM) == len(to_xyz)
        return cls(
            shell,
            film_reflectance(shell, q_squared, nm) @ to_xyz,
            body_per_sr(shell, *grid) @ to_xyz,
        )

    def xyz_per_sr(self, light: Floats, view: Floats) -> Floats:
        """`[M, 3]` f_r in 1/sr of light and view `[M, 3]`, unit, on or above the surface."""
        return composed(
            self.shell,
            light,
            view,
            lambda q_squared, gone: _read(self.films, q_squared * (_Q_SQUARED - 1), gone * _GONE),
            lambda *cosines: _read(self.body, *(c * (_COSINES - 1) for c in cosines)),
        )


def _read(table: Floats, row: Floats, column: Floats) -> Floats:
    channels = [
        map_coordinates(table[..., c], [row, column], order=1, mode="nearest") for c in range(3)
    ]
    return np.stack(channels, axis=-1)
