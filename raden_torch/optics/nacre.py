"""Nacre as an optical stack: indices, random stacks, their mean reflectance.

Labels used below: [R] read in the source named, [M] from memory, [A] an assumption of this project.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from raden_torch.arrays import Complexes, Floats
from raden_torch.optics.films import POLARISATIONS, Films, Medium, isotropic, reflectance

SODIUM_D_NM = 589.3
ARAGONITE_N_O = 1.6834
"""In the film plane, at 589 nm: between the n_β = 1.680 and n_γ = 1.685 of mineral data [R]."""
ARAGONITE_N_E = 1.530
"""Along the c axis, which stands on the films: n_α of mineral data at 589 nm [R]."""
ORGANIC_N = 1.50
"""The organic sheet between tablets; 1.4…1.57 is published [M]."""
URUSHI_N = 1.52
"""Lacquer under the slice; 1.52…1.54 [M]."""

_CALCITE_O = (0.73358749, 0.96464345, 1.94325203e-2, 1.82831454, 120.0)
_CALCITE_E = (0.35859695, 0.82427830, 1.06689543e-2, 0.14429128, 120.0)
_CELLS_AT_ONCE = 30_000  # complex cells that stay in a processor's cache


@dataclass(frozen=True)
class Stack:
    """One nacre: a random stack of tablets and organic sheets on urushi.

    Attributes:
        tablet_nm: mean tablet thickness.
        tablet_spread: its relative standard deviation within a stack; 0.03…0.09.
        organic_nm, organic_spread: the same for the organic sheets; 25 nm, ± 20 % [M].
        tablets: how many tablets lie on each other. 170 of them are the 80 µm of a thin slice [R].
        loss: imaginary index of both, which stands for scattering [A]: a round trip of 44 µm
            leaves 1/e.
        organic_n: index of the sheets; 1.4…1.57 is published [M].
        dispersion: of the tablets' indices, over calcite's (`aragonite`).
    """

    tablet_nm: float
    tablet_spread: float = 0.04
    organic_nm: float = 25.0
    organic_spread: float = 0.20
    tablets: int = 170
    loss: float = 5e-4
    organic_n: float = ORGANIC_N
    dispersion: float = 1.0


def calcite_index(wavelength_nm: ArrayLike, coefficients: tuple[float, ...]) -> Floats:
    """n² = 1 + A + B λ²/(λ² − C) + D λ²/(λ² − E), λ in µm.

    Source: G. Ghosh, Opt. Commun. 163, 95–102 (1999), 10.1016/S0030-4018(99)00091-7; coefficients
    for 204…2172 nm as refractiveindex.info gives them (CC0).
    """
    a, b, c, d, e = coefficients
    square = (np.asarray(wavelength_nm, float) / 1000) ** 2
    return np.asarray(np.sqrt(1 + a + b * square / (square - c) + d * square / (square - e)))


def aragonite(wavelength_nm: ArrayLike, loss: float = 0.0, dispersion: float = 1.0) -> Medium:
    """Aragonite, taken as uniaxial, with its c axis standing on the films.

    No dispersion of aragonite was found: calcite's is rescaled to the indices at 589 nm [A], and
    `dispersion` times as much of it is taken.
    """

    def rescaled(n_at_sodium: float, coefficients: tuple[float, ...]) -> Complexes:
        shape = calcite_index(wavelength_nm, coefficients)
        at_sodium = calcite_index(SODIUM_D_NM, coefficients)
        return np.asarray(n_at_sodium * (1 + dispersion * (shape / at_sodium - 1)) + 1j * loss)

    return Medium(rescaled(ARAGONITE_N_O, _CALCITE_O), rescaled(ARAGONITE_N_E, _CALCITE_E))


def wavelength_across(wavelength_nm: ArrayLike, q_squared: ArrayLike) -> Floats:
    """λ / (n_o cos θ) = λ / √(n_o² - q²) in aragonite: the wave's length along the film normal."""
    n_o = np.real(aragonite(wavelength_nm).n_o)
    return np.asarray(np.asarray(wavelength_nm) / np.sqrt(n_o**2 - np.asarray(q_squared)))


def random_thicknesses(stack: Stack, stacks: int, rng: np.random.Generator) -> Floats:
    """`[J, stacks]` film thicknesses in nm: tablet, sheet, tablet, …, tablet.

    Independent and normal, rounded to whole nanometres; draws beyond ± 3 standard deviations are
    set to that limit.
    """
    films = 2 * stack.tablets - 1
    draws = np.clip(rng.standard_normal((films, stacks)), -3, 3)
    draws[0::2] = stack.tablet_nm * (1 + stack.tablet_spread * draws[0::2])
    draws[1::2] = stack.organic_nm * (1 + stack.organic_spread * draws[1::2])
    return np.round(draws)


def mean_reflectance(
    stack: Stack,
    wavelength_nm: Floats,
    q_squared: Floats,
    *,
    ambient_n: float = 1.0,
    stacks: int = 200,
    seed: int = 0,
) -> Floats:
    """`[Q, W]` reflectance of unpolarised light, 0…1, averaged over random stacks.

    Intensities are averaged, not amplitudes: neighbouring patches of a shell do not interfere. A
    single stack has a spiky spectrum; their mean is smooth. Both polarisations and every direction
    see the same stacks.

    Args:
        wavelength_nm: `[W]`.
        q_squared: `[Q]` (n sin θ)² of the light.
        ambient_n: index of the medium in front. 1 is air, whose Fresnel reflection is then part of
            the stack's.
    """
    media = [
        isotropic(ambient_n),
        aragonite(wavelength_nm, stack.loss, stack.dispersion),
        isotropic(stack.organic_n + 1j * stack.loss),
        isotropic(URUSHI_N),
    ]
    films = 2 * stack.tablets - 1
    order = [0, *(1 + film % 2 for film in range(films)), 3]
    thicknesses = random_thicknesses(stack, stacks, np.random.default_rng(seed))
    at_once = max(1, _CELLS_AT_ONCE // len(wavelength_nm))
    total = np.zeros((len(q_squared), len(wavelength_nm)))
    for start in range(0, stacks, at_once):
        part = Films(media, order, thicknesses[:, start : start + at_once])
        for row, q in enumerate(np.sqrt(q_squared)):
            for polarisation in POLARISATIONS:
                total[row] += reflectance(part, wavelength_nm, q, polarisation).sum(axis=0)
    return total / (len(POLARISATIONS) * stacks)
