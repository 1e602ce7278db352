"""Where a cell's standard deviation comes from, term by term.

Type A terms are found in the photographs, type B terms are stated (JCGM 100:2008, 4.2 and 4.3). All
are standard uncertainties (k = 1), in the terms of the spectrometer path where they are the same:

| term | type | what it is | shared with |
|---|---|---|---|
| noise | A | of the node's value, by the scatter of its samples around the fit | nothing |
| place | A | by the slopes within the cell that no sample tells of | nothing |
| white | A | of the white in the photographs, or the lamps' intensities | cells of like lamps |
| geometry | B | of the lamps' directions and the sample's normals | cells of like lamps |
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
from raden_torch.capture.photo.brdf.cell_sums import NodeValues
from raden_torch.capture.photo.brdf.node_colour import NodeColour
from raden_torch.capture.photo.brdf.photo_cells import CellGrid
from raden_torch.capture.photo.brdf.photo_passes import AccumulatedCells
from raden_torch.capture.photo.brdf.photo_white import Scale
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
    found: AccumulatedCells,
    grid: CellGrid,
    colour: NodeColour,
    *,
    lamp_std_deg: Floats,
    normal_std_deg: float,
    scale_std: float,
) -> PhotoBudget:
    """The terms of every cell, in the channels of the result.

    Args:
        lamp_std_deg: `[K]` of the lamps' directions.
        normal_std_deg: of the sample's normals.
        scale_std: of the white's reflectance factor, relative.
    """
    nodes = found.nodes
    slopes = colour.slopes(nodes.value)
    factors = colour.factors(nodes.value)
    share = found.shots / np.maximum(found.shots.sum(axis=0), 1)
    luminance = factors[:, 1] if colour.correction else factors.mean(axis=1)
    of_colour = relative_colour(luminance, colour.left_out_delta_e)[:, None]
    of_white = abs(nodes.value) * relative_white(share, found.scale)
    geometry = of_geometry(nodes, grid, share, lamp_std_deg, normal_std_deg)
    return PhotoBudget(
        noise=_independent(slopes, nodes.noise),
        place=_common(slopes, nodes.place),
        white=_independent(slopes, of_white),
        geometry=_common(slopes, geometry),
        colour=abs(factors) * of_colour,
        scale=abs(factors) * scale_std,
    )


def _independent(slopes: Floats, term: Floats) -> Floats:
    """`[M, 3]` of the factors, where the camera's channels have independent errors."""
    return np.sqrt(np.einsum("mkc,mc->mk", slopes**2, term**2))


def _common(slopes: Floats, term: Floats) -> Floats:
    """`[M, 3]` of the factors, where one error is in all of the camera's channels."""
    return np.asarray(abs(np.einsum("mkc,mc->mk", slopes, term)))


def direction_slopes(value: Floats, slope: Floats, nodes_deg: Floats) -> Floats:
    """`[M, 3]`: how much values change when their lamp, or the normal, leans by a degree.

    What is taken for incidence a and was a − δ is placed δ R' too low and, divided by cos a
    instead of cos(a − δ), δ tan a R too high; in the same way for the tilt, which a lean across the
    plane of incidence changes by about as much.

    Args:
        value: `[M, 3]`.
        slope: `[M, 3, 3]` of each channel, a degree of incidence, receiving and tilt.
        nodes_deg: `[M, 3]`.
    """
    tangent = np.tan(np.radians(nodes_deg))
    degree = np.radians(1.0) * value
    along = degree * tangent[:, :1] - slope[..., 0]
    across = degree * tangent[:, 2:] - slope[..., 2]
    return np.hypot(along, across)


def of_geometry(
    nodes: NodeValues, grid: CellGrid, share: Floats, lamp_std_deg: Floats, normal_std_deg: float
) -> Floats:
    """`[cells, 3]` in the unit of the values.

    The lamps' errors are independent: a cell seen under several has the less. The normals' are not.

    Args:
        share: `[K, cells]` of the samples of each cell that each shot gave.
        lamp_std_deg: `[K]` of the lamps' directions.
        normal_std_deg: of the sample's normals, from its outline.
    """
    per_degree = direction_slopes(
        np.nan_to_num(nodes.value), np.nan_to_num(nodes.slope), grid.nodes_deg()
    )
    lamps = np.sqrt(((share * lamp_std_deg[:, None]) ** 2).sum(axis=0))
    return np.asarray(per_degree * np.hypot(lamps, normal_std_deg)[:, None])


def relative_white(weight: Floats, scale: Scale) -> Floats:
    """`[cells, 3]` relative, by the white of the shots that each cell was seen in."""
    square = np.zeros((weight.shape[1], 3))
    for share, std in zip(weight, scale.std, strict=True):
        square += (share[:, None] * std) ** 2
    return np.sqrt(square)


def relative_colour(luminance: Floats, left_out_delta_e: float) -> Floats:
    """`[cells]` relative: ΔE2000 as lightness, L* = 116 (Y/100)^⅓ − 16, dY/Y = 3 dL*/(L* + 16)."""
    lightness = 116 * np.cbrt(np.maximum(luminance, 1e-3) / 100)
    return np.asarray(3 * left_out_delta_e * _OF_LIGHTNESS / lightness)
