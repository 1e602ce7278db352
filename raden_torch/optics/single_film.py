"""One film between two media: Airy's sum of the beams that go to and fro in it.

    r = r₀₁ + t₀₁ t₁₀ r₁₂ e^{2iδ} (1 + r₁₀ r₁₂ e^{2iδ} + …)
      = (r₀₁ + r₁₂ e^{2iδ}) / (1 + r₀₁ r₁₂ e^{2iδ}),
    t = t₀₁ t₁₂ e^{iδ} / (1 + r₀₁ r₁₂ e^{2iδ}),   δ = 2π k_z d / λ

(Born & Wolf, *Principles of Optics*, §1.6.4, eqs (55) to (59), and §7.6 for the sum). The same as
`films` gives for a stack of one, without a stack: one expression, which broadcasts over everything.
Conventions, arguments and libraries as there; the amplitudes are those of the tangential E.
"""

from __future__ import annotations

import math

from raden_torch.errors import InputError
from raden_torch.optics.array_library import Array, as_complex, as_real, library_of
from raden_torch.optics.films import (
    Medium,
    Polarisation,
    admittance,
    check_passive,
    interface_reflection,
    normal_index,
)


def airy_amplitudes(
    above: Medium,
    film: Medium,
    below: Medium,
    thickness_nm: Array,
    wavelength_nm: Array,
    q: Array,
    polarisation: Polarisation,
) -> tuple[Array, Array]:
    """What the film reflects and passes of the tangential E: complex, all arguments broadcast.

    Args:
        above, film, below: complex indices n + ik, k of at least 0; isotropic, or uniaxial with the
            axis along the normal.
        thickness_nm: 0 or more; 0 is the face between `above` and `below`.
        wavelength_nm: in vacuum, above 0.
        q: tangential index n sin θ, with n and θ of the medium above.
        polarisation: "s" or "p".

    Raises:
        InputError: a thickness below 0, a wavelength that is not above 0, a medium that amplifies.
    """
    indices = [n for medium in (above, film, below) for n in medium]
    like = (thickness_nm, wavelength_nm, q, *indices)
    thickness, wavelength = (as_real(x, *like) for x in (thickness_nm, wavelength_nm))
    if not bool(((thickness >= 0) & (thickness < math.inf)).all()):
        raise InputError("film: thickness_nm: expected numbers of 0 or more, got one that is not")
    if not bool(((wavelength > 0) & (wavelength < math.inf)).all()):
        raise InputError("film: wavelength_nm: expected numbers above 0, got one that is not")
    check_passive(indices)
    first, inner, last = (
        as_complex(admittance(m, q, polarisation), *like) for m in (above, film, below)
    )
    r_01, r_12 = interface_reflection(first, inner), interface_reflection(inner, last)
    delta = (
        2
        * math.pi
        / wavelength
        * thickness
        * as_complex(normal_index(film, q, polarisation), *like)
    )
    once = library_of(delta).exp(1j * delta)
    resonance = 1 + r_01 * r_12 * once**2
    return (r_01 + r_12 * once**2) / resonance, (1 + r_01) * (1 + r_12) * once / resonance


def airy(
    above: Medium,
    film: Medium,
    below: Medium,
    thickness_nm: Array,
    wavelength_nm: Array,
    q: Array,
    polarisation: Polarisation,
) -> tuple[Array, Array]:
    """The shares of power that one film reflects and that arrive below it; as `airy_amplitudes`.

    Examples:
        A quarter wave of magnesium fluoride on glass (n 1.38 and 1.52):

        >>> from raden_torch.optics.films import isotropic
        >>> air, fluoride, glass = (isotropic(n) for n in (1.0, 1.38, 1.52))
        >>> r, t = airy(air, fluoride, glass, 550 / 4 / 1.38, 550.0, 0.0, "s")
        >>> round(float(r), 4), round(float(t), 4)
        (0.0126, 0.9874)
    """
    r, t = airy_amplitudes(above, film, below, thickness_nm, wavelength_nm, q, polarisation)
    first, last = (as_complex(admittance(m, q, polarisation), r).real for m in (above, below))
    return r.real**2 + r.imag**2, last / first * (t.real**2 + t.imag**2)
