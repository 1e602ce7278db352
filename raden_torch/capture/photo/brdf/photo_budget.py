"""Where a cell's standard deviation comes from, term by term.

Type A terms are found in the photographs, type B terms are stated (JCGM 100:2008, 4.2 and 4.3). All
are standard uncertainties (k = 1), in the terms of the spectrometer path where they are the same:

| term | type | what it is | shared with |
|---|---|---|---|
| noise | A | of the node's value, by the scatter of its samples around the fit | nothing |
| place | A | by the slopes within the cell that no sample tells of | nothing |
| white | A | of the white in the photographs, or the lamps' intensities | cells of like lamps |
| geometry | B | of the lamps' directions, the sample's place, the board's poses | like lamps |
| colour | B | of the map from camera RGB to XYZ, by its left-out patches | cells of like colour |
| scale | B | R u(certificate) | all cells; not in `total` |

The noise holds photon noise, rounding, the sample's texture, and what a quadratic cannot follow.
There is no drift: the white is in every photograph, and where it is not, the doubt of the lamps'
intensities is in `white`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from raden_torch.arrays import Floats
from raden_torch.capture.photo.brdf.node_colour import NodeColour
from raden_torch.capture.photo.brdf.photo_passes import AccumulatedCells
from raden_torch.capture.photo.brdf.shared_errors import SharedErrors
from raden_torch.measurement.budget_terms import BudgetTerms

_OF_LIGHTNESS = 1 / np.sqrt(3.0)
"""Share of a colour difference that is one of lightness, where nothing is known of its kind."""


@dataclass(frozen=True, eq=False)
class PhotoBudget(BudgetTerms):
    """Standard deviations (k = 1) of the reflectance factors, term by term, `[M, 3]` each.

    What each is, and what it is shared with, is in the module's table.
    """

    noise: Floats
    place: Floats
    white: Floats
    geometry: Floats
    colour: Floats


def budget_of(
    found: AccumulatedCells, colour: NodeColour, shared: SharedErrors, *, scale_std: float
) -> PhotoBudget:
    """The terms of every cell, in the channels of the result.

    Args:
        shared: what the errors of lamps, places and white do.
        scale_std: of the white's reflectance factor, relative.
    """
    nodes = found.nodes
    slopes = colour.slopes(nodes.value)
    factors = colour.factors(nodes.value)
    luminance = factors[:, 1] if colour.correction else factors.mean(axis=1)
    of_colour = relative_colour(luminance, colour.left_out_delta_e)[:, None]
    return PhotoBudget(
        noise=_independent(slopes, nodes.noise),
        place=_common(slopes, nodes.place),
        white=shared.white,
        geometry=shared.geometry,
        colour=abs(factors) * of_colour,
        scale=abs(factors) * scale_std,
    )


def _independent(slopes: Floats, term: Floats) -> Floats:
    """`[M, 3]` of the factors, where the camera's channels have independent errors."""
    return np.sqrt(np.einsum("mkc,mc->mk", slopes**2, term**2))


def _common(slopes: Floats, term: Floats) -> Floats:
    """`[M, 3]` of the factors, where one error is in all of the camera's channels."""
    return np.asarray(abs(np.einsum("mkc,mc->mk", slopes, term)))


def relative_colour(luminance: Floats, left_out_delta_e: float) -> Floats:
    """`[cells]` relative: ΔE2000 as lightness, L* = 116 (Y/100)^⅓ − 16, dY/Y = 3 dL*/(L* + 16)."""
    lightness = 116 * np.cbrt(np.maximum(luminance, 1e-3) / 100)
    return np.asarray(3 * left_out_delta_e * _OF_LIGHTNESS / lightness)
