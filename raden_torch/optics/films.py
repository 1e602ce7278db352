"""Plane waves in a stack of thin films: the transfer-matrix method.

The textbook method (Born & Wolf, *Principles of Optics*, §1.6; Yeh, *Optical Waves in Layered
Media*, ch. 5; Macleod, *Thin-Film Optical Filters*, ch. 2), for isotropic films, and for uniaxial
ones whose optic axis is perpendicular to them.

Convention: waves go as exp(i(k·x − ωt)), so an absorbing medium has the index n + ik with k ≥ 0.
Directions enter through q = n sin θ, the tangential index, which is the same in every film.
Wavelengths, directions and indices broadcast against each other; random stacks are axes of their
own, which stand first in every result.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import pairwise
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from raden_torch.arrays import Floats, Ints

Complexes = NDArray[np.complex128]
Polarisation = Literal["s", "p"]
POLARISATIONS: tuple[Polarisation, ...] = ("s", "p")


class Medium(NamedTuple):
    """A uniaxial medium, its optic axis perpendicular to the films; isotropic where both are equal.

    Attributes:
        n_o: complex index of a field in the film plane.
        n_e: complex index of a field along the film normal.
    """

    n_o: ArrayLike
    n_e: ArrayLike


class Films(NamedTuple):
    """A stack of films, or many with the same order of media.

    Attributes:
        media: the distinct media.
        order: which medium follows which: the first is where the light comes from, the last is the
            substrate, the J between are the films.
        thickness_nm: `[J, ...]`, the films' thicknesses; further axes are stacks.
    """

    media: Sequence[Medium]
    order: Sequence[int]
    thickness_nm: ArrayLike


def isotropic(n: ArrayLike) -> Medium:
    """The medium of one complex index `n`."""
    return Medium(n, n)


def normal_index(medium: Medium, q: ArrayLike, polarisation: Polarisation) -> Complexes:
    """k_z / k_0, the wave vector's component along the film normal over the vacuum wave number.

    s feels n_o alone: k_z² / n_o² + q² / n_o² = 1. p is the extraordinary wave:
    k_z² / n_o² + q² / n_e² = 1. Of the two roots, the one that decays forward (Yeh, §9.6).
    """
    n_o, n_e = np.asarray(medium.n_o, complex), np.asarray(medium.n_e, complex)
    q = np.asarray(q, complex)
    if polarisation == "s":
        return np.asarray(np.sqrt(n_o**2 - q**2))
    return np.asarray(n_o / n_e * np.sqrt(n_e**2 - q**2))


def admittance(medium: Medium, q: ArrayLike, polarisation: Polarisation) -> Complexes:
    """Tangential H over tangential E of a forward wave, in the vacuum's unit (Macleod, §2.3)."""
    kz = normal_index(medium, q, polarisation)
    return kz if polarisation == "s" else np.asarray(np.asarray(medium.n_o, complex) ** 2 / kz)


def interface_reflection(above: Complexes, below: Complexes) -> Complexes:
    """Fresnel's amplitude reflection of the tangential E, from the two admittances."""
    return np.asarray((above - below) / (above + below))


def reflectance(
    films: Films, wavelength_nm: ArrayLike, q: ArrayLike, polarisation: Polarisation
) -> Floats:
    """The share of power that a stack reflects, 0…1: `[stacks…, wavelengths and directions…]`.

    Args:
        wavelength_nm: in vacuum.
        q: tangential index n sin θ, with n and θ of the first medium.
        polarisation: "s" or "p".
    """
    forward, backward = _waves(films, wavelength_nm, q, polarisation)
    r = backward / forward
    return np.asarray(r.real**2 + r.imag**2)


def transmittance(
    films: Films, wavelength_nm: ArrayLike, q: ArrayLike, polarisation: Polarisation
) -> Floats:
    """The share of power that arrives in the last medium; arguments as for `reflectance`."""
    forward, _ = _waves(films, wavelength_nm, q, polarisation)
    crossed = np.ones((), complex)
    admitted = [admittance(films.media[which], q, polarisation) for which in films.order]
    for above, below in pairwise(admitted):
        crossed = crossed * (1 + interface_reflection(above, below))
    for turn, thickness, which in _films_by_medium(films, wavelength_nm, q, polarisation):
        through = thickness[which].sum(axis=0)
        crossed = crossed * np.exp(np.multiply.outer(through, turn / 2))
    power = np.abs(crossed / forward) ** 2
    return np.asarray(admitted[-1].real / admitted[0].real * power)


def _waves(
    films: Films, wavelength_nm: ArrayLike, q: ArrayLike, polarisation: Polarisation
) -> tuple[Complexes, Complexes]:
    """Forward and backward tangential E at the top, where the last medium has (1, 0) at its top.

    Both lack one common factor: (1 + reflection) of every interface and the forward phase
    exp(−i k_z d) of every film. So nothing grows in an absorbing film, and their ratio needs no
    more.
    """
    order = films.order
    admitted = [admittance(medium, q, polarisation) for medium in films.media]
    interfaces = {
        (i, j): interface_reflection(admitted[i], admitted[j]) for i, j in set(pairwise(order))
    }
    turned, shape = _round_trips(films, wavelength_nm, q, polarisation)
    forward, backward = np.ones(shape, complex), np.zeros(shape, complex)
    to_forward, to_backward = np.empty(shape, complex), np.empty(shape, complex)
    for above in range(len(order) - 2, -1, -1):
        rho = interfaces[order[above], order[above + 1]]
        np.multiply(rho, backward, out=to_forward)
        np.multiply(rho, forward, out=to_backward)
        forward += to_forward
        backward += to_backward
        if above > 0:
            table, rows = turned[above - 1]
            backward *= np.take(table, rows, axis=0, out=to_backward, mode="clip")
    return forward, backward


def _round_trips(
    films: Films, wavelength_nm: ArrayLike, q: ArrayLike, polarisation: Polarisation
) -> tuple[list[tuple[Complexes, Ints]], tuple[int, ...]]:
    """exp(2i k_z d) of each film, as the rows of a table; and the shape of the waves.

    A thickness that many films share is computed once: the exponential is what takes the time.
    """
    stacks = np.shape(films.thickness_nm)[1:]
    shape = np.broadcast_shapes(
        np.shape(wavelength_nm), np.shape(q), *(np.shape(n) for m in films.media for n in m)
    )
    turned: dict[int, tuple[Complexes, Ints]] = {}
    for turn, thickness, which in _films_by_medium(films, wavelength_nm, q, polarisation):
        levels, rows = np.unique(thickness[which], return_inverse=True)
        table = np.exp(np.multiply.outer(levels, np.broadcast_to(turn, shape)))
        for film, row in zip(which, rows.reshape(len(which), *stacks), strict=True):
            turned[int(film)] = (table, row)
    return [turned[film] for film in range(len(turned))], (*stacks, *shape)


def _films_by_medium(
    films: Films, wavelength_nm: ArrayLike, q: ArrayLike, polarisation: Polarisation
) -> Iterator[tuple[Complexes, Floats, Ints]]:
    """Each medium's 2i k_z, all the thicknesses `[J, ...]`, and which of the J films it makes."""
    k0 = 2 * np.pi / np.asarray(wavelength_nm, float)
    thickness = np.asarray(films.thickness_nm, float)
    inner = np.asarray(films.order[1:-1], int)
    for index in sorted(set(films.order[1:-1])):
        turn = 2j * k0 * normal_index(films.media[index], q, polarisation)
        yield turn, thickness, np.flatnonzero(inner == index)
