"""A grating of parallel lines: where its orders go, and how much light each of them takes.

Where a cut slice of nacre has its layers at an angle to the surface, they come out as lines; light
that is reflected there is diffracted (Liu, Shigley & Hurwit, Opt. Express 4, 177 (1999),
10.1364/OE.4.000177). Scalar theory: a thin grating multiplies the wave by exp(iφ(x)), and order m
takes the square of its Fourier coefficient, as of Fraunhofer diffraction. It holds where the
spacing is several wavelengths and the relief less than one; polarisation, shadows and resonances
are beyond it.

Light directions point away from the surface; x is across the lines, y along them, z the normal.
Arguments are NumPy arrays or torch tensors, and so is what comes back, with gradients.
"""

from __future__ import annotations

import math

import numpy as np

from raden_torch.errors import InputError
from raden_torch.optics.array_library import Array, as_real, library_of


def outcrop_spacing_nm(period_nm: Array, angle: Array) -> Array:
    """Distance of the lines in which layers of this period come out of the surface.

    Args:
        period_nm: a tablet and an organic sheet.
        angle: of the layers to the surface, in radians, above 0.

    Examples:
        >>> import math
        >>> [round(float(outcrop_spacing_nm(490.0, math.radians(a)))) for a in (4, 8, 15)]
        [7024, 3521, 1893]
    """
    period, tilt = as_real(period_nm, angle), as_real(angle, period_nm)
    if not bool(((tilt > 0) & (tilt <= math.pi / 2)).all()):
        raise InputError("grating: angle: expected radians above 0 and at most π/2, got others")
    return period / library_of(tilt).sin(tilt)


def reflected_orders(
    light: Array, wavelength_nm: Array, spacing_nm: Array, order: Array
) -> tuple[Array, Array]:
    """Directions of reflected orders, in air, also out of the plane of incidence (conical).

    The wave keeps its component along the lines, and gains m λ / spacing across them (Loewen &
    Popov, *Diffraction Gratings and Applications*, 1997, §2.1): v_x = −l_x + m λ/Λ, v_y = −l_y.

    Args:
        light: `[..., 3]`, unit, towards the lamp.
        wavelength_nm, spacing_nm, order: broadcast to `[...]`; of order 0 the mirror's direction.

    Returns:
        `[..., 3]` unit directions away from the surface, and `[...]` whether the order propagates;
        the direction of one that does not lies in the surface.
    """
    wavelength, spacing = (
        _above_zero(wavelength_nm, "wavelength_nm"),
        _above_zero(spacing_nm, "spacing_nm"),
    )
    light = as_real(light, wavelength, spacing)
    if light.shape[-1:] != (3,):
        raise InputError(f"grating: light: expected shape [..., 3], got {list(light.shape)}")
    xp = library_of(light, wavelength, spacing)
    across = as_real(order, light) * as_real(wavelength, light) / as_real(spacing, light)
    v_x, v_y = (
        xp.broadcast_tensors(across - light[..., 0], -light[..., 1])
        if xp is not np
        else (np.broadcast_arrays(across - light[..., 0], -light[..., 1]))
    )
    upright = 1 - v_x**2 - v_y**2
    goes = upright > 0
    one = xp.ones_like(upright)
    # where it does not propagate, no gradient either
    v_z = xp.where(goes, xp.sqrt(xp.where(goes, upright, one)), 0 * one)
    length = xp.where(goes, one, xp.sqrt(xp.where(goes, one, v_x**2 + v_y**2)))
    return xp.stack([v_x / length, v_y / length, v_z], -1), goes


def relief_phase(height_nm: Array, wavelength_nm: Array, cos_in: Array, cos_out: Array) -> Array:
    """Phase in radians that a reflecting relief of this height gives: 2π h (cos θi + cos θr) / λ.

    Beckmann & Spizzichino, *The Scattering of Electromagnetic Waves from Rough Surfaces* (1963),
    ch. 3; in a coat, with the wavelength and the cosines in it.
    """
    like = (height_nm, wavelength_nm, cos_in, cos_out)
    height, wavelength, into, out = (as_real(x, *like) for x in like)
    return 2 * math.pi * height * (into + out) / wavelength


def sinusoidal_efficiency(phase: Array, order: Array) -> Array:
    """J_m(φ/2)² of a sinusoidal relief, φ its phase from crest to trough in radians.

    Goodman, *Introduction to Fourier Optics*, §4.4.4. At most 0.339 for m = 1.
    """
    return bessel_j(order, as_real(phase, order) / 2) ** 2


def blazed_efficiency(phase: Array, order: Array) -> Array:
    """sinc²(m − φ/2π) of a saw-tooth, φ the phase that its facets rise by: 1 where φ = 2π m.

    Swanson, *Binary Optics Technology* (MIT Lincoln Laboratory TR-854, 1989), eq. (12) with many
    levels.
    """
    m, phi = as_real(order, phase), as_real(phase, order)
    return library_of(m, phi).sinc(m - phi / (2 * math.pi)) ** 2


def lamellar_efficiency(phase: Array, order: Array, duty: Array = 0.5) -> Array:
    """Of lines of two levels that differ by φ, the higher one `duty` of the spacing wide.

    4 f² sinc²(m f) sin²(φ/2); for m = 0: 1 − 4 f (1 − f) sin²(φ/2) (Fourier coefficients of a
    rectangle; Goodman, problem 4-12). 4/π² = 0.405 at most for m = ±1.
    """
    m, phi, share = (as_real(x, order, phase, duty) for x in (order, phase, duty))
    if not bool(((share >= 0) & (share <= 1)).all()):
        raise InputError("grating: duty: expected a share in 0…1, got one that is not")
    xp = library_of(m, phi, share)
    swing = 4 * xp.sin(phi / 2) ** 2
    higher = (share * xp.sinc(m * share)) ** 2 * swing
    return xp.where(m == 0, 1 - share * (1 - share) * swing, higher)


def conserving(efficiency: Array, propagates: Array) -> Array:
    """Shares of orders `[..., M]` where those that do not propagate give theirs to the others.

    Scalar theory gives light to orders below the horizon as well; a lossless grating cannot. All is
    lost only where no order goes.
    """
    xp = library_of(efficiency)
    kept = xp.where(propagates, efficiency, 0 * efficiency)
    total = kept.sum(-1)[..., None]
    return kept / xp.where(total > 0, total, total + 1)


def bessel_j(order: Array, x: Array) -> Array:
    """J_m(x) of whole orders: the mean of cos(m τ − x sin τ) (Abramowitz & Stegun, 9.1.21).

    By the trapezoidal rule, which converges faster than any power for a periodic function: to
    rounding with |m| + |x| + 40 nodes. torch's own J₀ and J₁ have no gradient.
    """
    m, x = as_real(order, x), as_real(x, order)
    xp = library_of(m, x)
    largest = max((_largest(a) for a in (m, x) if np.prod(a.shape)), default=0.0)
    if not largest < 1e5:
        raise InputError(f"bessel_j: expected |m| and |x| below 1e5, got {largest:g}")
    total, nodes = 0 * (m * x), 2 * math.ceil(largest) + 40
    for k in range(nodes):
        tau = 2 * math.pi * (k + 0.5) / nodes
        total = total + xp.cos(m * tau - x * math.sin(tau))
    return total / nodes


def _largest(a: Array) -> float:
    return float(abs(a.detach() if hasattr(a, "detach") else a).max())


def _above_zero(value: Array, name: str) -> Array:
    number = as_real(value)
    if not bool(((number > 0) & (number < math.inf)).all()):
        raise InputError(f"grating: {name}: expected numbers above 0, got one that is not")
    return value
