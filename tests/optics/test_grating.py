"""Orders of a grating: directions, efficiencies against Fourier transforms and published values."""

from __future__ import annotations

import math

import numpy as np
import pytest
import scipy.special
import torch

from raden_torch.errors import InputError
from raden_torch.optics.grating import (
    bessel_j,
    blazed_efficiency,
    conserving,
    lamellar_efficiency,
    outcrop_spacing_nm,
    reflected_orders,
    relief_phase,
    sinusoidal_efficiency,
)

ORDERS = np.arange(-40, 41)
X = (np.arange(5000) + 0.5) / 5000
PROFILES = {
    "sinusoidal": (sinusoidal_efficiency, lambda phi: phi / 2 * np.sin(2 * np.pi * X)),
    "blazed": (blazed_efficiency, lambda phi: phi * X),
    "lamellar": (lamellar_efficiency, lambda phi: phi * (X < 0.5)),
    "narrow lines": (lambda p, m: lamellar_efficiency(p, m, 0.2), lambda phi: phi * (X < 0.2)),
}


@pytest.mark.parametrize("name", PROFILES)
@pytest.mark.parametrize("phase", [0.0, 0.7, math.pi, 5.5, 2 * math.pi])
def test_efficiencies_are_those_of_a_fourier_transform(name, phase):
    """Rationale: the closed forms stand for the transform, here by NumPy's FFT of the profile."""
    efficiency, profile = PROFILES[name]
    spectrum = np.abs(np.fft.fft(np.exp(1j * profile(phase)))) ** 2 / len(X) ** 2
    np.testing.assert_allclose(efficiency(phase, ORDERS), spectrum[ORDERS], atol=2e-6)


@pytest.mark.parametrize("name", PROFILES)
def test_all_orders_together_take_all_light(name):
    many = np.arange(-4000, 4001)
    phases = np.array([0.3, 2.0, 6.0])[:, None]
    efficiency = PROFILES[name][0]
    if name == "sinusoidal":
        many = many[abs(many) < 60]  # no light beyond, and Bessel's sum has a node for each
    np.testing.assert_allclose(efficiency(phases, many).sum(axis=-1), 1, atol=2e-4)


def test_published_greatest_efficiencies():
    """Goodman: 33.9 % of a sinusoidal, 40.5 % of a binary grating; a blazed one gives all."""
    phase = np.linspace(0, 2 * math.pi, 20001)
    sinusoidal = sinusoidal_efficiency(phase, 1)
    assert sinusoidal.max() == pytest.approx(0.3386, abs=5e-5)
    assert phase[sinusoidal.argmax()] / 2 == pytest.approx(1.8412, abs=1e-3)  # of J₁
    assert lamellar_efficiency(phase, 1).max() == pytest.approx(4 / math.pi**2, abs=1e-9)
    assert blazed_efficiency(2 * math.pi * 3, 3) == pytest.approx(1, abs=1e-14)
    assert sinusoidal_efficiency(2 * 2.404825557695773, 0) < 1e-25  # the first zero of J₀


def test_bessel_functions_are_scipys(dtype):
    m, x = np.arange(-30, 31)[:, None], np.linspace(-45, 45, 181)
    expected = scipy.special.jv(m, x)
    np.testing.assert_allclose(bessel_j(m, x), expected, atol=1e-13)
    ours = bessel_j(torch.as_tensor(m), torch.as_tensor(x, dtype=dtype))
    assert ours.dtype == dtype
    tolerance = {torch.float64: 1e-13, torch.float32: 2e-5}[dtype]
    np.testing.assert_allclose(ours.numpy(), expected, atol=tolerance)


def test_in_plane_orders_are_the_grating_equation_s():
    """sin θm = sin θi + m λ/Λ of a 1200 lines/mm grating; Littrow's order comes back."""
    spacing, wavelength = 1e6 / 1200, 632.8
    littrow = math.asin(wavelength / 2 / spacing)  # 22.31° in catalogues
    assert math.degrees(littrow) == pytest.approx(22.31, abs=0.01)
    light = np.array([math.sin(littrow), 0.0, math.cos(littrow)])
    view, goes = reflected_orders(light, wavelength, spacing, np.array([0, 1, 2, -1]))
    np.testing.assert_allclose(view[0], light * [-1, 1, 1], atol=1e-15)
    np.testing.assert_allclose(view[1], light, atol=1e-15)
    assert goes.tolist() == [True, True, False, False]
    np.testing.assert_allclose(np.linalg.norm(view, axis=-1), 1, atol=1e-14)
    assert (view[2:, 2] == 0).all()


def test_conical_orders_lie_on_a_cone_around_the_lines():
    rng = np.random.default_rng(2)
    light = rng.normal(size=(50, 1, 3))
    light[..., 2] = abs(light[..., 2])
    light /= np.linalg.norm(light, axis=-1, keepdims=True)
    view, goes = reflected_orders(light, 550.0, 3500.0, np.arange(-12, 13))
    assert view.shape == (50, 25, 3)
    along = np.broadcast_to(-light[..., 1], view.shape[:-1])
    np.testing.assert_allclose(view[..., 1][goes], along[goes], atol=1e-15)
    # reciprocal: light that comes the way of an order leaves by the same one
    back, again = reflected_orders(view[goes], 550.0, 3500.0, np.broadcast_to(
        np.arange(-12, 13), goes.shape)[goes])  # fmt: skip
    assert again.all()
    np.testing.assert_allclose(back, np.broadcast_to(light, view.shape)[goes], atol=1e-12)


def test_propagating_orders_share_all_light():
    light = np.array([0.6, 0.2, math.sqrt(1 - 0.4)])
    _, goes = reflected_orders(light, 550.0, 1200.0, ORDERS)
    shares = conserving(sinusoidal_efficiency(4.0, ORDERS), goes)
    assert shares.sum() == pytest.approx(1, abs=1e-14)
    assert (shares[~goes] == 0).all()
    assert conserving(np.zeros(3), np.zeros(3, bool)).tolist() == [0, 0, 0]


def test_layers_blaze_where_they_are_mirrors():
    """The saw-tooth of outcropping layers sends most light where each layer's plane mirrors it."""
    angle, period, wavelength = math.radians(8), 490.0, 550.0
    spacing = outcrop_spacing_nm(period, angle)
    view, goes = reflected_orders(np.array([0.0, 0, 1]), wavelength, spacing, ORDERS)
    height = spacing * math.tan(angle)
    phase = relief_phase(height, wavelength, 1.0, view[:, 2])
    best = ORDERS[np.where(goes, blazed_efficiency(phase, ORDERS), 0).argmax()]
    mirror = math.sin(2 * angle) * spacing / wavelength
    assert abs(best - mirror) < 0.5


def test_gradients_are_those_of_differences():
    def all_of(light, wavelength, spacing, phase):
        order = torch.tensor([-1.0, 0.0, 2.0], dtype=torch.float64)
        view, _ = reflected_orders(light, wavelength, spacing, order)
        made = [f(phase, order) for f in (sinusoidal_efficiency, blazed_efficiency)]
        return view, *made, lamellar_efficiency(phase, order, 0.3)

    values = ([0.48, 0.36, 0.8], 550.0, 2100.0, [1.3, 0.4, 2.9])
    inputs = [torch.tensor(v, dtype=torch.float64, requires_grad=True) for v in values]
    assert torch.autograd.gradcheck(all_of, inputs)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: outcrop_spacing_nm(400.0, 0.0), "angle: expected radians above 0"),
        (lambda: reflected_orders(np.ones(3), 550.0, 0.0, 1), "spacing_nm: expected numbers above"),
        (lambda: reflected_orders(np.ones(3), np.nan, 9.0, 1), "wavelength_nm: expected numbers"),
        (lambda: reflected_orders(np.ones(2), 550.0, 9.0, 1), r"light: expected shape \[..., 3\]"),
        (lambda: lamellar_efficiency(1.0, 1, 1.2), "duty: expected a share in 0…1"),
        (lambda: bessel_j(0, 1e9), "below 1e5"),
    ],
)
def test_bad_input_is_one_line(call, message):
    with pytest.raises(InputError, match=message) as error:
        call()
    assert "\n" not in str(error.value)
