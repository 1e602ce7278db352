"""The stack with tensors: NumPy's numbers, gradients, and laws that hold for any stack."""

from __future__ import annotations

import colour
import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from raden_torch.errors import InputError
from raden_torch.optics.films import (
    POLARISATIONS,
    Films,
    Medium,
    admittance,
    isotropic,
    reflectance,
    transmittance,
)
from raden_torch.optics.nacre import Stack, aragonite, random_thicknesses

TOLERANCE = {torch.float64: 1e-11, torch.float32: 2e-4}


def a_stack(films=61, loss=1e-3, stacks=(4,), seed=0):
    """In NumPy: a lossy uniaxial medium between isotropic ones, at `[W]` wavelengths."""
    wavelength = np.linspace(380, 780, 9)
    tablet = Medium(1.66 + 5e3 / wavelength**2 + 1j * loss, 1.51 + 4e3 / wavelength**2 + 1j * loss)
    thickness = np.random.default_rng(seed).uniform(20, 500, (films, *stacks))
    order = [0, *(1 + film % 2 for film in range(films)), 3]
    return Films([isotropic(1.0), tablet, isotropic(1.5), isotropic(1.52)], order, thickness), (
        wavelength
    )


def in_torch(films, dtype):
    to = lambda n: torch.as_tensor(n, dtype=dtype.to_complex())  # noqa: E731
    media = [Medium(to(m.n_o), to(m.n_e)) for m in films.media]
    return films._replace(
        media=media, thickness_nm=torch.as_tensor(films.thickness_nm, dtype=dtype)
    )


@pytest.mark.parametrize("polarisation", POLARISATIONS)
@pytest.mark.parametrize("compute", [reflectance, transmittance])
def test_tensors_give_numpys_numbers(compute, polarisation, dtype):
    films, wavelength = a_stack()
    q = np.sin(np.radians(np.array([0.0, 35.0, 70.0])))[:, None]
    ours = compute(
        in_torch(films, dtype),
        torch.as_tensor(wavelength, dtype=dtype),
        torch.as_tensor(q, dtype=dtype),
        polarisation,
    )
    assert ours.dtype == dtype
    assert ours.shape == (4, 3, 9)
    expected = compute(films, wavelength, q, polarisation)
    np.testing.assert_allclose(ours.numpy(), expected, atol=TOLERANCE[dtype])


@pytest.mark.parametrize("polarisation", POLARISATIONS)
@pytest.mark.parametrize("compute", [reflectance, transmittance])
def test_gradients_are_those_of_differences(compute, polarisation):
    """Of thickness, both complex indices, wavelength and direction."""

    def power(thickness, n_o, n_e, wavelength, q):
        media = [isotropic(1.0), Medium(n_o, n_e), isotropic(1.5), isotropic(1.52)]
        return compute(Films(media, [0, 1, 2, 1, 3], thickness), wavelength, q, polarisation)

    double = {"dtype": torch.float64, "requires_grad": True}
    thickness = torch.tensor([[180.0, 240.0], [25.0, 31.0], [210.0, 190.0]], **double)
    n_o = torch.tensor([1.68 + 0.02j, 1.66 + 0.01j], dtype=torch.complex128, requires_grad=True)
    n_e = torch.tensor([1.53 + 0.02j, 1.52 + 0.01j], dtype=torch.complex128, requires_grad=True)
    wavelength = torch.tensor([450.0, 610.0], **double)
    q = torch.tensor([0.2, 0.7], **double)
    assert torch.autograd.gradcheck(power, (thickness, n_o, n_e, wavelength, q), atol=1e-6)


def test_many_layers_stay_in_range_in_single_precision():
    """Rationale: 2,000 strongly reflecting films would overflow float32 as a product."""
    quarter = [550 / 4 / n for n in (2.3, 1.38)] * 1000
    media = [isotropic(n) for n in (1.0, 2.3, 1.38, 1.52)]
    films = Films(media, [0, *[1, 2] * 1000, 3], torch.tensor(quarter))
    for wavelength, mirror in ((550.0, True), (400.0, False)):
        r = reflectance(films, wavelength, 0.0, "s")
        t = transmittance(films, wavelength, 0.0, "s")
        assert r + t == pytest.approx(1, abs=2e-3)
        assert (r > 0.999) == mirror


def test_thousands_of_stacks_at_once():
    films, wavelength = a_stack(films=21, stacks=(3000,))
    many = reflectance(in_torch(films, torch.float64), wavelength, 0.3, "p")
    assert many.shape == (3000, 9)
    one = reflectance(
        films._replace(thickness_nm=films.thickness_nm[:, 2999]), wavelength, 0.3, "p"
    )
    np.testing.assert_allclose(many[2999].numpy(), one, atol=1e-12)


@settings(max_examples=40, deadline=None)
@given(
    seed=st.integers(0, 10_000),
    films=st.integers(1, 30),
    q=st.floats(0.0, 0.99),
    polarisation=st.sampled_from(POLARISATIONS),
)
def test_power_is_kept_and_passes_alike_both_ways(seed, films, q, polarisation):
    """R + T = 1 without absorption, and the transmittance is reciprocal with it (Stokes)."""
    stack, wavelength = a_stack(films, loss=0.0, seed=seed)
    there = in_torch(stack, torch.float64)
    back = there._replace(order=there.order[::-1], thickness_nm=there.thickness_nm.flip(0))
    kept = reflectance(there, wavelength, q, polarisation) + transmittance(
        there, wavelength, q, polarisation
    )
    assert (kept - 1).abs().max() < 1e-10
    lossy = in_torch(a_stack(films, loss=0.02, seed=seed)[0], torch.float64)
    lossy_back = lossy._replace(order=lossy.order[::-1], thickness_nm=lossy.thickness_nm.flip(0))
    for a, b in ((there, back), (lossy, lossy_back)):
        passed = [transmittance(films, wavelength, q, polarisation) for films in (a, b)]
        torch.testing.assert_close(*passed, rtol=1e-9, atol=1e-14)


def test_brewsters_angle():
    brewster = np.arctan(1.68)
    films = Films([isotropic(1.0), isotropic(1.68)], [0, 1], torch.zeros(0, dtype=torch.float64))
    assert reflectance(films, 550.0, np.sin(brewster), "p") < 1e-30
    assert reflectance(films, 550.0, np.sin(brewster), "s") > 0.2


@pytest.mark.parametrize("polarisation", POLARISATIONS)
def test_total_internal_reflection_and_its_frustration(polarisation):
    """All is reflected into glass; what tunnels through a gap falls as exp(−2 κ d)."""
    glass, air, q = isotropic(1.5), isotropic(1.0), 1.2
    bare = Films([glass, air], [0, 1], np.zeros(0))
    assert reflectance(bare, 550.0, q, polarisation) == pytest.approx(1, abs=1e-14)
    assert transmittance(bare, 550.0, q, polarisation) == 0
    gaps = np.array([[800.0, 900.0]])
    r, t = (f(Films([glass, air, glass], [0, 1, 2], gaps), 550.0, q, polarisation)
            for f in (reflectance, transmittance))  # fmt: skip
    np.testing.assert_allclose(r + t, 1, atol=1e-12)
    decay = 2 * 2 * np.pi / 550 * np.sqrt(q**2 - 1) * 100
    assert np.log(t[0] / t[1]) == pytest.approx(decay, rel=1e-4)


@pytest.mark.parametrize("polarisation", POLARISATIONS)
def test_agrees_with_colour_science(polarisation):
    """Four films without dispersion, by colour-science's transfer matrix."""
    n, thickness = [1.0, 1.68, 1.5, 1.9, 1.38, 1.52], [210.0, 40.0, 95.0, 130.0]
    wavelength, theta_deg = np.linspace(380, 780, 41), 40.0
    theirs = colour.phenomena.multilayer_tmm(
        np.array(n), np.array(thickness), wavelength, theta_deg
    )
    films = Films(
        [isotropic(x) for x in n], tuple(range(6)), torch.tensor(thickness, dtype=torch.float64)
    )
    channel = {"s": 0, "p": 1}[polarisation]
    q = np.sin(np.radians(theta_deg))
    for ours, their in zip((reflectance, transmittance), theirs, strict=True):
        found = ours(films, wavelength, q, polarisation).numpy()
        np.testing.assert_allclose(found, their[:, 0, 0, channel], atol=1e-10)


@pytest.mark.parametrize(
    ("films", "message"),
    [
        (Films([isotropic(1), isotropic(1.5)], [0, 1, 1], [0.0]), "thickness_nm: .*above 0"),
        (Films([isotropic(1), isotropic(1.5)], [0, 1, 1], [np.nan]), "thickness_nm: .*above 0"),
        (Films([isotropic(1), isotropic(1.5)], [0, 1, 1], [1.0, 2.0]), "each of the 1 films .*2"),
        (Films([isotropic(1), isotropic(1.5 - 0.1j)], [0, 1], []), "amplifies"),
        (Films([isotropic(1), isotropic(np.nan)], [0, 1], []), "index of 0"),
    ],
)
def test_no_passive_stack_is_refused_in_one_line(films, message):
    with pytest.raises(InputError, match=message) as error:
        reflectance(films, 550.0, 0.0, "s")
    assert "\n" not in str(error.value)


def test_admittance_of_the_vacuum_is_the_cosine():
    assert admittance(isotropic(1.0), 0.6, "s") == pytest.approx(0.8)
    assert admittance(isotropic(1.0), 0.6, "p") == pytest.approx(1 / 0.8)


@pytest.mark.parametrize("polarisation", POLARISATIONS)
def test_nacre_without_loss_keeps_all_power(polarisation):
    """Rationale: R + T = 1 for what the shells are made of: 400 random stacks of 339 films, half of
    them uniaxial, from a medium in which the light is beyond total reflection in the sheets.
    Expected: 1e-10, where 1e-6 is asked for."""
    rng = np.random.default_rng(8)
    thickness = torch.as_tensor(random_thicknesses(Stack(400.0, 0.06), 400, rng))
    wavelength = torch.tensor([400.0, 550.0, 700.0], dtype=torch.float64)
    media = [isotropic(1.66), aragonite(wavelength.numpy()), isotropic(1.5), isotropic(1.52)]
    films = Films(media, [0, *(1 + film % 2 for film in range(339)), 3], thickness)
    q = torch.tensor([[0.0], [1.0], [1.505], [1.6]], dtype=torch.float64)
    r, t = (f(films, wavelength, q, polarisation) for f in (reflectance, transmittance))
    assert r.shape == (400, 4, 3)
    assert (r + t - 1).abs().max() < 1e-10
    assert t[:, :3].max() > 1e-3
    assert (r[:, 3] - 1).abs().max() < 1e-10  # the substrate takes none


@pytest.mark.parametrize("polarisation", POLARISATIONS)
def test_a_thick_absorbing_stack_passes_nothing_and_keeps_its_gradient(polarisation):
    """Metres of absorbing films: no overflow forwards or backwards, and no NaN."""
    for dtype in (torch.float32, torch.float64):
        thickness = torch.full((40,), 1e6, dtype=dtype, requires_grad=True)
        media = [
            isotropic(1.0),
            Medium(1.68 + 0.3j, 1.53 + 0.2j),
            isotropic(0.2 + 3j),
            isotropic(1),
        ]
        films = Films(media, [0, *[1, 2] * 20, 3], thickness)
        q = torch.tensor([0.0, 0.9], dtype=dtype)
        r, t = (f(films, 550.0, q, polarisation) for f in (reflectance, transmittance))
        assert (t == 0).all()
        assert ((r > 0) & (r < 1)).all()
        (gradient,) = torch.autograd.grad((r + t).sum(), thickness)
        assert torch.isfinite(gradient).all()
