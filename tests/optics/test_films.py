"""The transfer-matrix method against closed forms and against the `tmm` package."""

from __future__ import annotations

import numpy as np
import pytest
import tmm
from hypothesis import given, settings
from hypothesis import strategies as st

from raden_torch.optics.films import Films, Medium, isotropic, reflectance, transmittance

WAVELENGTHS_NM = np.array([380.0, 470.0, 560.0, 780.0])
POLARISATIONS = ("s", "p")


@pytest.mark.parametrize("polarisation", POLARISATIONS)
@pytest.mark.parametrize("theta_deg", [0.0, 20.0, 45.0, 70.0, 85.0])
@pytest.mark.parametrize("loss", [0.0, 5e-4, 0.3])
def test_isotropic_stack_agrees_with_tmm(polarisation, theta_deg, loss):
    rng = np.random.default_rng(7)
    films, n = 41, [1.0, 1.68 + 1j * loss, 1.50 + 2j * loss, 1.52]
    order = [0, *(1 + film % 2 for film in range(films)), 3]
    thickness = rng.uniform(20, 500, films)
    theta = np.radians(theta_deg)
    ours = Films([isotropic(x) for x in n], order, thickness)
    r = reflectance(ours, WAVELENGTHS_NM, np.sin(theta), polarisation)
    t = transmittance(ours, WAVELENGTHS_NM, np.sin(theta), polarisation)
    for i, wavelength in enumerate(WAVELENGTHS_NM):
        theirs = tmm.coh_tmm(
            polarisation,
            [n[medium] for medium in order],
            [np.inf, *thickness, np.inf],
            theta,
            wavelength,
        )
        assert r[i] == pytest.approx(theirs["R"], abs=1e-9)
        assert t[i] == pytest.approx(theirs["T"], abs=1e-9)


@settings(max_examples=60, deadline=None)
@given(
    n=st.lists(st.floats(1.2, 2.5), min_size=2, max_size=4),
    n_e=st.floats(1.2, 2.5),
    thickness=st.lists(st.floats(1, 800), min_size=1, max_size=12),
    q=st.floats(0.0, 0.99),
    polarisation=st.sampled_from(POLARISATIONS),
)
def test_without_loss_all_power_is_reflected_or_passed(n, n_e, thickness, q, polarisation):
    media = [isotropic(1.0), Medium(n[0], n_e), *(isotropic(x) for x in n[1:])]
    order = [0, *(1 + film % len(n) for film in range(len(thickness))), len(n)]
    films = Films(media, order, thickness)
    r = reflectance(films, WAVELENGTHS_NM, q, polarisation)
    t = transmittance(films, WAVELENGTHS_NM, q, polarisation)
    np.testing.assert_allclose(r + t, 1.0, atol=1e-10)


@pytest.mark.parametrize("polarisation", POLARISATIONS)
def test_bare_interface_is_fresnels(polarisation):
    theta = np.radians(np.linspace(0, 89, 20))
    inside = np.arcsin(np.sin(theta) / 1.5)
    numerator, denominator = {
        "s": (np.cos(theta) - 1.5 * np.cos(inside), np.cos(theta) + 1.5 * np.cos(inside)),
        "p": (1.5 * np.cos(theta) - np.cos(inside), 1.5 * np.cos(theta) + np.cos(inside)),
    }[polarisation]
    films = Films([isotropic(1.0), isotropic(1.5)], [0, 1], [])
    r = reflectance(films, 550.0, np.sin(theta), polarisation)
    np.testing.assert_allclose(r, (numerator / denominator) ** 2, atol=1e-14)


def test_one_film_is_airys():
    n, d = np.array([1.0, 1.7, 1.4]), 230.0
    first, second = -np.diff(n) / (n[1:] + n[:-1])
    turn = np.exp(4j * np.pi * n[1] * d / WAVELENGTHS_NM)
    airy = np.abs((first + second * turn) / (1 + first * second * turn)) ** 2
    films = Films([isotropic(x) for x in n], [0, 1, 2], [d])
    np.testing.assert_allclose(reflectance(films, WAVELENGTHS_NM, 0.0, "s"), airy, atol=1e-14)


@pytest.mark.parametrize("pairs", [1, 4, 12])
def test_quarter_wave_stack_is_the_closed_form(pairs):
    high, low, substrate = 2.3, 1.38, 1.52
    layers = [550 / 4 / high, 550 / 4 / low] * pairs
    media = [isotropic(x) for x in (1.0, high, low, substrate)]
    films = Films(media, [0, *[1, 2] * pairs, 3], layers)
    y = (high / low) ** (2 * pairs) * substrate
    assert reflectance(films, 550.0, 0.0, "p") == pytest.approx(((1 - y) / (1 + y)) ** 2, abs=1e-12)


def test_uniaxial_interface_is_the_closed_form():
    """Lekner, J. Phys. Condens. Matter 3, 6121 (1991), the optic axis along the normal."""
    n_o, n_e, theta = 1.6834, 1.530, np.radians(np.linspace(0, 88, 23))
    root = np.sqrt(n_e**2 - np.sin(theta) ** 2)
    closed = (n_o * n_e * np.cos(theta) - root) / (n_o * n_e * np.cos(theta) + root)
    films = Films([isotropic(1.0), Medium(n_o, n_e)], [0, 1], [])
    r = reflectance(films, 550.0, np.sin(theta), "p")
    np.testing.assert_allclose(r, closed**2, atol=1e-14)
    as_if_isotropic = Films([isotropic(1.0), isotropic(n_o)], [0, 1], [])
    s = reflectance(films, 550.0, np.sin(theta), "s")
    np.testing.assert_allclose(s, reflectance(as_if_isotropic, 550.0, np.sin(theta), "s"))


def test_uniaxial_film_delays_p_by_the_extraordinary_wave():
    """A lossless film of whole half waves of p is absent to p, and only to p."""
    n_o, n_e, q, wavelength = 1.6834, 1.530, 0.8, 550.0
    # the index ellipse: sin² of the wave normal's angle, and the index along it
    s = q**2 / (n_o**2 + q**2 * (1 - n_o**2 / n_e**2))
    n_of_the_ray = 1 / np.sqrt((1 - s) / n_o**2 + s / n_e**2)
    across = n_of_the_ray * np.sqrt(1 - s)
    film = [3 * wavelength / 2 / across]
    bare = Films([isotropic(1.0), isotropic(1.52)], [0, 1], [])
    covered = Films([isotropic(1.0), Medium(n_o, n_e), isotropic(1.52)], [0, 1, 2], film)
    absent = reflectance(bare, wavelength, q, "p")
    assert reflectance(covered, wavelength, q, "p") == pytest.approx(absent, abs=1e-12)
    s_change = reflectance(covered, wavelength, q, "s") - reflectance(bare, wavelength, q, "s")
    assert abs(s_change) > 0.005


def test_thick_absorbing_film_hides_what_lies_below():
    lossy = isotropic(1.6 + 0.5j)
    hidden = Films([isotropic(1.0), lossy, isotropic(3.0)], [0, 1, 2], [1e6])
    bare = Films([isotropic(1.0), lossy], [0, 1], [])
    for polarisation in POLARISATIONS:
        r = reflectance(hidden, WAVELENGTHS_NM, 0.6, polarisation)
        assert np.isfinite(r).all()
        np.testing.assert_allclose(r, reflectance(bare, 550.0, 0.6, polarisation), atol=1e-14)


def test_stacks_angles_and_wavelengths_are_axes():
    media = [isotropic(1.0), Medium(np.linspace(1.6, 1.7, 4), 1.53), isotropic(1.52)]
    q, thickness = np.array([[0.0], [0.5], [0.9]]), np.array([[300.0, 400.0]])
    together = reflectance(Films(media, [0, 1, 2], thickness), WAVELENGTHS_NM, q, "p")
    assert together.shape == (2, 3, 4)
    alone = Films([media[0], Medium(media[1].n_o[3], 1.53), media[2]], [0, 1, 2], [400.0])
    assert together[1, 2, 3] == pytest.approx(float(reflectance(alone, 780.0, 0.9, "p")), abs=1e-14)
