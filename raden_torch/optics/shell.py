"""One simulated shell: nacre whose tablets change with the planes' slope, lacquered over."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from scipy.ndimage import map_coordinates

from raden_torch.arrays import Floats
from raden_torch.optics import lacquered
from raden_torch.optics.lacquered import Facets
from raden_torch.optics.nacre import ARAGONITE_N_O, Stack, mean_reflectance, wavelength_across

BANDS_NM = np.arange(380.0, 781.0, 5.0)

_TABLE_STEP_NM = 4.0  # in vacuum, at normal incidence
_MARGIN = 0.04  # of wavelength, for the neighbouring angle
_Q_SQUARED = np.linspace(0.0, 1.0, 11)


@dataclass(frozen=True)
class Specimen:
    """A lacquered slice of shell.

    The slice cuts curved layers, so a plane that stands at an angle to the surface belongs to
    another growth layer: the tablets' thickness changes smoothly with the planes' slope [A].

    Attributes:
        stack: tablets where the planes lie in the surface.
        steep_tablet_nm: what the thickness tends to where the planes stand steep.
        facets: populations of planes; their shares sum to at most 1.
        half_slope: the slope at which the thickness has gone half of that way.
        body_albedo: diffuse reflectance of what lies below the films, at 550 nm.
        body_warmth: relative change of that albedo from 550 nm to 1100 nm, were it straight.
        coat_n: index of the urushi over the slice; 1.52…1.54 [M].
        source: where the numbers come from, for the metadata.
        stacks: how many random stacks lie side by side; their mean is what is seen.
        stack_seed: which they are. The same in every call.
    """

    stack: Stack
    steep_tablet_nm: float
    facets: tuple[Facets, ...]
    source: str
    half_slope: float = math.tan(math.radians(13))
    body_albedo: float = 0.35
    body_warmth: float = 0.30
    coat_n: float = 1.53
    stacks: int = 300
    stack_seed: int = 20120301


def brdf_per_sr(shell: Specimen, light: Floats, view: Floats) -> Floats:
    """`[M, bands]` spectral BRDF of a specimen, without the cosine.

    Args:
        light, view: `[M, 3]` unit vectors in the sample's frame, on or above the surface.
    """
    return composed(
        shell,
        light,
        view,
        lambda q_squared, gone: film_reflectance(shell, q_squared, tablet_nm_at(shell, gone)),
        lambda cos_light, cos_view: body_per_sr(shell, cos_light, cos_view),
    )


Part = Callable[[Floats, Floats], Floats]


def composed(shell: Specimen, light: Floats, view: Floats, films: Part, body: Part) -> Floats:
    """`[M, channels]` films on facets over a body, seen through the coat.

    Args:
        light, view: as for `brdf_per_sr`.
        films: reflectance of a facet by (n sin θ)² and by how far its tablets have gone from flat
            to steep, 0…1, `[M]` each.
        body: as `body_per_sr`, by the cosines outside of the coat.
    """
    n = shell.coat_n
    cos_light, cos_view = np.maximum(light[..., 2], 0), np.maximum(view[..., 2], 0)
    light, view = lacquered.refracted(light, n), lacquered.refracted(view, n)
    passed = lacquered.coat_transmittance(cos_light, light[..., 2], n)
    passed = passed * lacquered.coat_transmittance(cos_view, view[..., 2], n)
    slope_x, slope_y = lacquered.facet_slopes(light, view)
    density = lacquered.slope_density(shell.facets, slope_x, slope_y)
    # half the angle between L and V is the angle on the facet: sin² = (1 − L·V)/2
    q_squared = n**2 * (1 - np.sum(light * view, axis=-1)) / 2
    slope_squared = slope_x**2 + slope_y**2
    gone = slope_squared / (slope_squared + shell.half_slope**2)
    brdf = lacquered.facet_brdf(density, films(q_squared, gone), light, view)
    brdf = brdf + body(cos_light, cos_view)
    # radiance falls by n² on leaving the coat
    return np.asarray(brdf * (passed / n**2)[..., None])


def body_per_sr(shell: Specimen, cos_light: Floats, cos_view: Floats) -> Floats:
    """`[…, bands]` what the body below the films gives back, within the coat, in 1/sr."""
    flat_nm = np.full(cos_light.shape, shell.stack.tablet_nm)
    albedo = shell.body_albedo * (1 + shell.body_warmth * (BANDS_NM / 550 - 1))
    reflected_in = film_reflectance(shell, 1 - cos_light**2, flat_nm)
    reflected_out = film_reflectance(shell, 1 - cos_view**2, flat_nm)
    return lacquered.body_brdf(albedo, reflected_in, reflected_out, shell.coat_n)


def tablet_nm_at(shell: Specimen, gone: Floats) -> Floats:
    """Thickness of the tablets that have gone so far, 0…1, from flat to steep."""
    return shell.stack.tablet_nm + (shell.steep_tablet_nm - shell.stack.tablet_nm) * gone


def film_reflectance(shell: Specimen, q_squared: Floats, tablet_nm: Floats) -> Floats:
    """`[M, bands]` by linear interpolation in the table of one thickness.

    Films scale: s times the thickness (tablets and sheets alike) reflects what the films reflect
    where the wavelength across them is s times as long.
    """
    table, first, step = _table(shell)
    across = wavelength_across(BANDS_NM, q_squared[..., None])
    column = (across * (shell.stack.tablet_nm / tablet_nm)[..., None] - first) / step
    row = np.broadcast_to(q_squared[..., None] * (len(_Q_SQUARED) - 1), column.shape)
    return np.asarray(map_coordinates(table, [row, column], order=1, mode="nearest"))


@lru_cache(maxsize=32)
def _table(shell: Specimen) -> tuple[Floats, float, float]:
    """`[Q, W]` reflectance under the coat at `_Q_SQUARED`; the first of its W wavelengths across
    the films, and their step.

    Along this wavelength the peaks stand still as the angle changes, so that few angles do. What
    no band can ask for is left 0.
    """
    scale = shell.stack.tablet_nm / shell.steep_tablet_nm
    low, high = BANDS_NM[0] * min(scale, 1), BANDS_NM[-1] * max(scale, 1)
    vacuum = np.arange((1 - _MARGIN) * low, (1 + _MARGIN) * high)
    step = _TABLE_STEP_NM / ARAGONITE_N_O
    first = float(wavelength_across(vacuum[0], 0.0))
    last = float(wavelength_across(vacuum[-1], 1.0))
    across = np.arange(first, last, step)
    table = np.zeros((len(_Q_SQUARED), len(across)))
    for row, q_squared in enumerate(_Q_SQUARED):
        known = wavelength_across(vacuum, q_squared)
        used = (across >= known[0]) & (across <= known[-1])
        table[row, used] = mean_reflectance(
            shell.stack,
            np.interp(across[used], known, vacuum),
            np.array([q_squared]),
            ambient_n=shell.coat_n,
            stacks=shell.stacks,
            seed=shell.stack_seed,
        )[0]
    return table, first, step
