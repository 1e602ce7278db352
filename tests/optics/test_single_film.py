"""One film by Airy's sum: published values, the sum beam by beam, the transfer matrix, tmm."""

from __future__ import annotations

import numpy as np
import pytest
import tmm
import torch

from raden_torch.errors import InputError
from raden_torch.optics.films import (
    POLARISATIONS,
    Films,
    Medium,
    interface_reflection,
    isotropic,
    normal_index,
    reflectance,
    transmittance,
)
from raden_torch.optics.single_film import airy, airy_amplitudes

WAVELENGTHS_NM = np.linspace(380.0, 780.0, 41)
AIR = isotropic(1.0)
Q = np.sin(np.radians([0.0, 30.0, 60.0, 85.0]))[:, None]
LOSSY = isotropic(1.68 + 0.03j)


@pytest.mark.parametrize("polarisation", POLARISATIONS)
@pytest.mark.parametrize(
    "film",
    [isotropic(1.38), LOSSY, isotropic(0.15 + 3.2j), Medium(1.6834 + 5e-4j, 1.53 + 5e-4j)],
    ids=["dielectric", "lossy", "metal", "uniaxial"],
)
def test_agrees_with_the_transfer_matrix(film, polarisation):
    glass, thickness = isotropic(1.52), np.array([30.0, 400.0, 3e4])
    r, t = airy(AIR, film, glass, thickness[:, None, None], WAVELENGTHS_NM, Q, polarisation)
    assert r.shape == (3, 4, 41)
    films = Films([AIR, film, glass], [0, 1, 2], thickness[None])
    for ours, compute in ((r, reflectance), (t, transmittance)):
        expected = compute(films, WAVELENGTHS_NM, Q, polarisation)
        np.testing.assert_allclose(ours, expected, atol=1e-12)


@pytest.mark.parametrize("polarisation", POLARISATIONS)
def test_agrees_with_tmm(polarisation):
    for theta_deg in (0.0, 45.0, 80.0):
        theta = np.radians(theta_deg)
        theirs = tmm.coh_tmm(
            polarisation, [1.0, 1.68 + 0.03j, 2.1 + 0.4j], [np.inf, 310.0, np.inf], theta, 520.0
        )
        r, t = airy(AIR, LOSSY, isotropic(2.1 + 0.4j), 310.0, 520.0, np.sin(theta), polarisation)
        assert float(r) == pytest.approx(theirs["R"], abs=1e-12)
        assert float(t) == pytest.approx(theirs["T"], abs=1e-12)


def test_is_the_sum_of_its_beams():
    """Rationale: the closed form stands for infinitely many reflections, summed here one by one."""
    media, q = (AIR, isotropic(2.3), isotropic(1.52)), 0.5
    n_z = [normal_index(m, q, "s") for m in media]
    r_01, r_12 = interface_reflection(n_z[0], n_z[1]), interface_reflection(n_z[1], n_z[2])
    turn = np.exp(4j * np.pi * n_z[1] * 180.0 / WAVELENGTHS_NM)
    total, beam = r_01 + 0 * turn, (1 - r_01**2) * r_12 * turn
    for _ in range(60):
        total, beam = total + beam, beam * (-r_01 * r_12 * turn)
    found, _ = airy_amplitudes(*media, 180.0, WAVELENGTHS_NM, q, "s")
    np.testing.assert_allclose(found, total, atol=1e-14)


def test_quarter_wave_of_magnesium_fluoride_on_glass():
    """Hecht, Optics, §9.7: ((n_s − n²)/(n_s + n²))², 1.3 % in place of the 4.3 % of bare glass;
    and none where n² is the glass's index."""
    glass = isotropic(1.52)
    r, _ = airy(AIR, isotropic(1.38), glass, 550 / 4 / 1.38, 550.0, 0.0, "s")
    assert float(r) == pytest.approx(((1.52 - 1.38**2) / (1.52 + 1.38**2)) ** 2, abs=1e-14)
    assert float(r) == pytest.approx(0.0126, abs=5e-5)
    bare, _ = airy(AIR, isotropic(1.38), glass, 0.0, 550.0, 0.0, "s")
    assert float(bare) == pytest.approx((0.52 / 2.52) ** 2, abs=1e-14)
    none, _ = airy(AIR, isotropic(1.52**0.5), glass, 550 / 4 / 1.52**0.5, 550.0, 0.0, "p")
    assert float(none) < 1e-30


def test_soap_film():
    """Born & Wolf §7.6.1: bright where 2 n d cos θ′ = (m − ½) λ, 4ρ/(1 + ρ)² with ρ Fresnel's;
    dark where it is m λ, and where the film is much thinner than light: the black film."""
    soap, water = isotropic(1.33), 1.33
    rho = ((water - 1) / (water + 1)) ** 2
    for order, wavelength in ((1, 4 * water * 110.0), (2, 4 * water * 300.0 / 3)):
        thickness = (order - 0.5) * wavelength / 2 / water
        bright, _ = airy(AIR, soap, AIR, thickness, wavelength, 0.0, "s")
        assert float(bright) == pytest.approx(4 * rho / (1 + rho) ** 2, abs=1e-14)
        dark, _ = airy(
            AIR, soap, AIR, 2 * thickness * order / (2 * order - 1), wavelength, 0.0, "p"
        )
        assert float(dark) < 1e-25
    black, _ = airy(AIR, soap, AIR, 5.0, WAVELENGTHS_NM, 0.0, "s")
    assert black.max() < 2e-3


def test_gradients_are_those_of_differences():
    def power(thickness, n, k, wavelength, q):
        film = isotropic(torch.complex(n, k))
        return tuple(
            x
            for p in POLARISATIONS
            for x in airy(AIR, film, isotropic(1.52), thickness, wavelength, q, p)
        )

    values = ([120.0, 410.0], [1.38, 1.9], [0.01, 0.2], [450.0, 610.0], [0.2, 0.7])
    inputs = [torch.tensor(v, dtype=torch.float64, requires_grad=True) for v in values]
    assert torch.autograd.gradcheck(power, inputs)


def test_tensors_give_numpys_numbers(dtype):
    thickness = np.linspace(0, 900, 7)[:, None]
    expected = airy(AIR, LOSSY, isotropic(1.52), thickness, WAVELENGTHS_NM, 0.6, "p")
    tensors = (torch.as_tensor(x, dtype=dtype) for x in (thickness, WAVELENGTHS_NM))
    ours = airy(AIR, LOSSY, isotropic(1.52), *tensors, 0.6, "p")
    tolerance = {torch.float64: 1e-13, torch.float32: 2e-5}[dtype]
    for found, wanted in zip(ours, expected, strict=True):
        assert found.dtype == dtype
        np.testing.assert_allclose(found.numpy(), wanted, atol=tolerance)


@pytest.mark.parametrize(
    ("film", "thickness", "wavelength", "message"),
    [
        (LOSSY, -1.0, 550.0, "thickness_nm: expected numbers of 0 or more"),
        (LOSSY, float("nan"), 550.0, "thickness_nm: expected numbers of 0 or more"),
        (LOSSY, 100.0, 0.0, "wavelength_nm: expected numbers above 0"),
        (isotropic(1.5 - 0.1j), 100.0, 550.0, "amplifies"),
    ],
)
def test_bad_input_is_one_line(film, thickness, wavelength, message):
    with pytest.raises(InputError, match=message) as error:
        airy(AIR, film, AIR, thickness, wavelength, 0.0, "s")
    assert "\n" not in str(error.value)
