"""Plane waves in a stack of thin films: the transfer-matrix method.

The textbook method (Born & Wolf, *Principles of Optics*, §1.6; Yeh, *Optical Waves in Layered
Media*, ch. 5; Macleod, *Thin-Film Optical Filters*, ch. 2), for isotropic films, and for uniaxial
ones whose optic axis is perpendicular to them.

Convention: waves go as exp(i(k·x − ωt)), so an absorbing medium has the index n + ik with k ≥ 0.
Directions enter through q = n sin θ, the tangential index, which is the same in every film.
Wavelengths, directions and indices broadcast against each other; random stacks are axes of their
own, which stand first in every result.

Arguments are NumPy arrays or torch tensors, and so is what comes back; with tensors everything has
a gradient.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from itertools import pairwise
from typing import Any, Literal, NamedTuple

import numpy as np

from raden_torch.errors import InputError
from raden_torch.optics.array_library import (
    Array,
    as_complex,
    as_real,
    library_of,
    outer,
    product_with_rows,
    sum_with_product,
)

Polarisation = Literal["s", "p"]
POLARISATIONS: tuple[Polarisation, ...] = ("s", "p")

_INTERFACES_BETWEEN_SCALINGS = 32  # the waves grow at most 2-fold at each


class Medium(NamedTuple):
    """A uniaxial medium, its optic axis perpendicular to the films; isotropic where both are equal.

    Attributes:
        n_o: complex index of a field in the film plane.
        n_e: complex index of a field along the film normal.
    """

    n_o: Array
    n_e: Array


class Films(NamedTuple):
    """A stack of films, or many with the same order of media.

    Attributes:
        media: the distinct media.
        order: which medium follows which: the first is where the light comes from, the last is the
            substrate, the J between are the films.
        thickness_nm: `[J, ...]`, the films' thicknesses, above 0; further axes are stacks.
    """

    media: Sequence[Medium]
    order: Sequence[int]
    thickness_nm: Array


def isotropic(n: Array) -> Medium:
    """The medium of one complex index `n`."""
    return Medium(n, n)


def normal_index(medium: Medium, q: Array, polarisation: Polarisation) -> Array:
    """k_z / k_0, the wave vector's component along the film normal over the vacuum wave number.

    s feels n_o alone: k_z² / n_o² + q² / n_o² = 1. p is the extraordinary wave:
    k_z² / n_o² + q² / n_e² = 1. Of the two roots, the one that decays forward (Yeh, §9.6).
    """
    n_o, n_e, q = (as_complex(x, *medium, q) for x in (*medium, q))
    xp = library_of(q)
    if polarisation == "s":
        return xp.sqrt(n_o**2 - q**2)
    return n_o / n_e * xp.sqrt(n_e**2 - q**2)


def admittance(medium: Medium, q: Array, polarisation: Polarisation) -> Array:
    """Tangential H over tangential E of a forward wave, in the vacuum's unit (Macleod, §2.3)."""
    kz = normal_index(medium, q, polarisation)
    return kz if polarisation == "s" else as_complex(medium.n_o, kz) ** 2 / kz


def interface_reflection(above: Array, below: Array) -> Array:
    """Fresnel's amplitude reflection of the tangential E, from the two admittances."""
    return (above - below) / (above + below)


def reflectance(films: Films, wavelength_nm: Array, q: Array, polarisation: Polarisation) -> Array:
    """The share of power that a stack reflects, 0…1: `[stacks…, wavelengths and directions…]`.

    Args:
        wavelength_nm: in vacuum.
        q: tangential index n sin θ, with n and θ of the first medium.
        polarisation: "s" or "p".

    Raises:
        InputError: a thickness that is not above 0, a medium that amplifies, an order that does
            not fit.
    """
    forward, backward, _ = _waves(films, wavelength_nm, q, polarisation)
    return _power(backward) / _power(forward)


def transmittance(
    films: Films, wavelength_nm: Array, q: Array, polarisation: Polarisation
) -> Array:
    """The share of power that arrives in the last medium; arguments as for `reflectance`."""
    forward, _, log_scale = _waves(films, wavelength_nm, q, polarisation)
    xp = library_of(forward)
    admitted = [as_complex(admittance(m, q, polarisation), forward) for m in films.media]
    order = films.order
    # logarithms, as one factor alone may leave the range of numbers
    crossed = -log_scale
    for above, below in pairwise(order):
        rho = interface_reflection(admitted[above], admitted[below])
        crossed = crossed + xp.log(_power(1 + rho)) / 2
    for _, turn, thickness in _by_medium(films, wavelength_nm, q, polarisation):
        crossed = crossed + outer(thickness.sum(0), turn.real / 2)
    power = xp.exp(2 * crossed) / _power(forward)
    return admitted[order[-1]].real / admitted[order[0]].real * power


def _power(amplitude: Array) -> Array:
    return amplitude.real**2 + amplitude.imag**2


def _waves(
    films: Films, wavelength_nm: Array, q: Array, polarisation: Polarisation
) -> tuple[Array, Array, Array]:
    """Forward and backward tangential E at the top, over a common real `scale`, and the scale.

    Where the last medium has (1, 0) at its top, and one common factor is left out: (1 + reflection)
    of every interface and the forward phase exp(−i k_z d) of every film. So nothing grows in an
    absorbing film, and what grows at the interfaces is scaled away.
    """
    _check(films)
    order = films.order
    turned, shape = _round_trips(films, wavelength_nm, q, polarisation)
    one = as_complex(1.0, films.thickness_nm, wavelength_nm, q, *_indices(films))
    admitted = [as_complex(admittance(m, q, polarisation), one) for m in films.media]
    rho = {(i, j): interface_reflection(admitted[i], admitted[j]) for i, j in set(pairwise(order))}
    xp = library_of(one)
    forward = xp.broadcast_to(one, shape)
    backward, log_scale = 0 * forward, 0 * forward.real
    for above in range(len(order) - 2, -1, -1):
        here = rho[order[above], order[above + 1]]
        forward, backward = (
            sum_with_product(forward, here, backward),
            sum_with_product(backward, here, forward),
        )
        if above > 0:
            backward = product_with_rows(backward, *turned[above - 1])
        if above % _INTERFACES_BETWEEN_SCALINGS == 1:
            size = abs(forward)
            forward, backward = forward / size, backward / size
            log_scale = log_scale + xp.log(size)
    return forward, backward, log_scale


def _round_trips(
    films: Films, wavelength_nm: Array, q: Array, polarisation: Polarisation
) -> tuple[list[tuple[Array, Any]], tuple[int, ...]]:
    """exp(2i k_z d) of each film, as a table and its rows; and the shape of the waves.

    The exponential takes most of the time. NumPy's are computed once for all films of the same
    thickness; with tensors each film has its own, for the gradient's sake.
    """
    shape = np.broadcast_shapes(
        np.shape(wavelength_nm), np.shape(q), *(np.shape(n) for n in _indices(films))
    )
    turned: dict[int, tuple[Array, Any]] = {}
    for which, turn, thickness in _by_medium(films, wavelength_nm, q, polarisation):
        xp = library_of(turn)
        levels, rows = thickness, np.arange(len(which))
        if xp is np:
            levels, inverse = np.unique(thickness, return_inverse=True)
            rows = inverse.reshape(thickness.shape)
        table = xp.exp(outer(levels, xp.broadcast_to(turn, shape)))
        turned |= {film: (table, row) for film, row in zip(which, rows, strict=True)}
    stacks = np.shape(films.thickness_nm)[1:]
    return [turned[film] for film in range(len(turned))], (*stacks, *shape)


def _by_medium(
    films: Films, wavelength_nm: Array, q: Array, polarisation: Polarisation
) -> Iterator[tuple[list[int], Array, Array]]:
    """For each medium: which of the J films it makes, 2i k_z, and their thicknesses `[F, ...]`."""
    like = (films.thickness_nm, wavelength_nm, q, *_indices(films))
    k0 = 2 * math.pi / as_real(wavelength_nm, *like)
    thickness = as_real(films.thickness_nm, *like)
    inner = films.order[1:-1]
    for index in sorted(set(inner)):
        which = [film for film, medium in enumerate(inner) if medium == index]
        kz = as_complex(normal_index(films.media[index], q, polarisation), *like)
        yield which, 2j * k0 * kz, thickness[which]


def _indices(films: Films) -> list[Array]:
    return [n for medium in films.media for n in medium]


def _check(films: Films) -> None:
    """Refuse what is no passive stack."""
    count = len(films.thickness_nm)
    if count != len(films.order) - 2:
        raise InputError(
            f"films: expected a thickness for each of the {len(films.order) - 2} films between "
            f"the first and the last medium, got {count}"
        )
    thickness = as_real(films.thickness_nm)
    if count and not bool(((thickness > 0) & (thickness < math.inf)).all()):
        raise InputError("films: thickness_nm: expected numbers above 0, got one that is not")
    check_passive(_indices(films))


def check_passive(indices: Sequence[Array]) -> None:
    """Raise InputError for an index of 0, or of a medium that amplifies."""
    for n in indices:
        index = as_complex(n)
        if not bool(((index.imag >= 0) & (abs(index) > 0)).all()):
            raise InputError(
                "films: media: expected indices n + ik with k of at least 0, got a k below 0 "
                "(a medium that amplifies; the waves go as exp(-iωt) here) or an index of 0"
            )
