"""The formula of the highlights: the logarithm of a sum of lobes, and its derivative."""

from __future__ import annotations

import numpy as np

from raden_torch.arrays import Floats


def log_sum(
    amplitude: Floats,
    shape: Floats,
    centres: Floats,
    base: float,
    s: Floats,
    u: Floats,
    t: Floats,
    amplitude_hats: Floats,
    shape_hats: Floats,
) -> Floats:
    """`[N]`: the formula at the head of `lobes.py`, at N places (s, u, t) with the hats of both
    kinds of knots, `[N, n]` and `[N, m]`."""
    strength, scale, kappa, b = _shape_at(shape, shape_hats)
    sign = _side(s, u)
    z = np.full(np.shape(s), base)
    for row, (u0, t0) in zip(amplitude, centres, strict=True):
        q = ((u - sign * u0) ** 2 + kappa * (t - sign * t0) ** 2) * scale
        z = np.logaddexp(z, amplitude_hats @ row - strength * _barron(q, b))
    return z


def log_sum_slopes(
    amplitude: Floats,
    shape: Floats,
    centres: Floats,
    base: float,
    s: Floats,
    u: Floats,
    t: Floats,
    amplitude_hats: Floats,
    shape_hats: Floats,
) -> Floats:
    """`[N, parameters]`: the derivative of `log_sum` by amplitudes, shape, centres and base."""
    strength, scale, kappa, b = _shape_at(shape, shape_hats)
    sign = _side(s, u)
    z = log_sum(amplitude, shape, centres, base, s, u, t, amplitude_hats, shape_hats)
    by_amplitude, by_centre = [], []
    by_shape = np.zeros((4, len(s)))  # log k, log c, b, log κ
    for row, (u0, t0) in zip(amplitude, centres, strict=True):
        du, dt = u - sign * u0, t - sign * t0
        along, across = du**2 * scale, kappa * dt**2 * scale
        rho, rho_q, rho_b = _barron_slopes(along + across, b)
        share = np.exp(amplitude_hats @ row - strength * rho - z)  # of this lobe in the sum
        drop = -strength * share
        by_amplitude.append(share[:, None] * amplitude_hats)
        by_centre += [-2 * drop * rho_q * sign * scale * d for d in (du, kappa * dt)]
        by_shape += drop * np.stack([rho, -2 * rho_q * (along + across), rho_b, rho_q * across])
    return np.concatenate(
        [
            *by_amplitude,
            *(slope[:, None] * shape_hats for slope in by_shape),
            np.stack([*by_centre, np.exp(base - z)], axis=1),
        ],
        axis=1,
    )


def _shape_at(shape: Floats, hats: Floats) -> tuple[Floats, Floats, Floats, Floats]:
    """k, 1/c², κ and b at each place, from their logarithms (b's own values) at the knots."""
    log_k, log_c, b, log_kappa = (hats @ row for row in shape)
    return np.exp(log_k), np.exp(-2 * log_c), np.exp(log_kappa), b


def _side(s: Floats, u: Floats) -> Floats:
    """−1 below incidence 0, where (a, r, t) ≡ (−a, −r, −t); else 1."""
    return np.where(s - u < 0, -1.0, 1.0)


def _barron_slopes(q: Floats, b: Floats) -> tuple[Floats, Floats, Floats]:
    """`_barron`, and its derivatives by q and by b."""
    b = np.where(abs(b) < 1e-3, 1e-3, b)
    k, k_b = abs(b - 2) + 1e-3, np.where(b > 2, 1.0, -1.0)
    w = q / k + 1
    power = w ** (b / 2)
    rho = k / b * (power - 1)
    rho_b = (k_b - k / b) / b * (power - 1) + power * (k / b * np.log(w) - k_b * q / (k * w)) / 2
    return rho, power / (2 * w), rho_b


def _barron(q: Floats, b: Floats) -> Floats:
    """Barron (2019), "A general and adaptive robust loss function", eq. (8), with q = (x/c)²."""
    b = np.where(abs(b) < 1e-3, 1e-3, b)
    k = abs(b - 2) + 1e-3
    return k / b * ((q / k + 1) ** (b / 2) - 1)


def hats_of(x: Floats, knots: Floats) -> Floats:
    """`[..., n]`: the weights of linear interpolation between knots, constant beyond them."""
    x = np.clip(x, knots[0], knots[-1])
    i = np.clip(np.searchsorted(knots, x, side="right") - 1, 0, len(knots) - 2)
    f = (x - knots[i]) / (knots[i + 1] - knots[i])
    hats = np.zeros((*np.shape(x), len(knots)))
    np.put_along_axis(hats, i[..., None], (1 - f)[..., None], -1)
    np.put_along_axis(hats, i[..., None] + 1, f[..., None], -1)
    return hats
