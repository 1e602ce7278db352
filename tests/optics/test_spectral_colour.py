"""Colours of spectra: colour-science's tables, its integration, tensors, gradients, bad input."""

from __future__ import annotations

import warnings

import numpy as np
import pytest
import torch

from raden_torch.errors import InputError
from raden_torch.optics.spectral_colour import (
    ILLUMINANTS,
    OBSERVERS,
    spectrum_to_rgb,
    spectrum_to_xyz,
    xyz_weights,
)

with warnings.catch_warnings():
    warnings.simplefilter("ignore")
    import colour

BANDS_NM = np.arange(380.0, 781.0, 5.0)
NAMES = {
    "CIE 1931 2 deg": "CIE 1931 2 Degree Standard Observer",
    "CIE 1964 10 deg": "CIE 1964 10 Degree Standard Observer",
}
SPECTRA = np.stack(
    [
        np.ones(81),
        0.5 + 0.4 * np.cos(2 * np.pi * 4800 / BANDS_NM),  # a film of some orders
        np.exp(-(((BANDS_NM - 545) / 15) ** 2)),
        (BANDS_NM > 600) * 1.0,
    ]
)


@pytest.mark.parametrize("observer", OBSERVERS)
@pytest.mark.parametrize("illuminant", ILLUMINANTS)
def test_equals_colour_sciences_integration(observer, illuminant):
    """Rationale: same sum, same tables. Expected: 1e-7 of the white, the tables' nine digits."""
    shape = colour.SpectralShape(380, 780, 1)
    fine = np.stack([np.interp(shape.wavelengths, BANDS_NM, row) for row in SPECTRA])
    theirs = colour.msds_to_XYZ(
        fine,
        colour.MSDS_CMFS[NAMES[observer]].copy().align(shape),
        colour.SDS_ILLUMINANTS[illuminant].copy().interpolate(shape, colour.LinearInterpolator),
        method="Integration",
        shape=shape,
    )
    ours = spectrum_to_xyz(SPECTRA, BANDS_NM, illuminant=illuminant, observer=observer)
    np.testing.assert_allclose(ours, theirs / 100, atol=1e-7)


def test_is_close_to_astm_e308():
    """colour-science's default, ASTM E308 with its own interpolation of 5 nm: within 6e-4."""
    for spectrum, ours in zip(SPECTRA[:3], spectrum_to_xyz(SPECTRA[:3], BANDS_NM), strict=True):
        sd = colour.SpectralDistribution(spectrum, BANDS_NM)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            theirs = colour.sd_to_XYZ(
                sd, colour.MSDS_CMFS[NAMES["CIE 1931 2 deg"]], colour.SDS_ILLUMINANTS["D65"]
            )
        np.testing.assert_allclose(ours, theirs / 100, atol=6e-4)


@pytest.mark.parametrize("observer", OBSERVERS)
@pytest.mark.parametrize("illuminant", ILLUMINANTS)
def test_white_is_white(observer, illuminant):
    arguments = {"illuminant": illuminant, "observer": observer}
    xyz = spectrum_to_xyz(np.ones(81), BANDS_NM, **arguments)
    x, y = xyz[:2] / xyz.sum()
    assert xyz[1] == pytest.approx(1, abs=1e-12)
    assert (x, y) == pytest.approx(OBSERVERS[observer][illuminant], abs=3e-4)  # D50 to 780 nm
    rgb = spectrum_to_rgb(np.ones(81), BANDS_NM, **arguments)
    np.testing.assert_allclose(rgb, 1, atol=1e-12)


def test_wavelengths_need_not_be_even():
    nodes = np.concatenate([[350.0, 379.0], np.arange(390.0, 700.0, 7.0), [720.0, 755.0, 790.0]])
    smooth = lambda nm: 0.5 + 0.3 * np.sin(nm / 60)  # noqa: E731
    fine = np.arange(380.0, 781.0)
    np.testing.assert_allclose(
        spectrum_to_xyz(smooth(nodes), nodes), spectrum_to_xyz(smooth(fine), fine), atol=1e-3
    )


def test_tensors_and_gradients(dtype):
    batch = torch.as_tensor(np.stack([SPECTRA, SPECTRA[::-1]]).copy(), dtype=dtype)
    found = spectrum_to_xyz(batch, BANDS_NM)
    assert found.shape == (2, 4, 3)
    assert found.dtype == dtype
    tolerance = {torch.float64: 1e-14, torch.float32: 1e-6}[dtype]
    np.testing.assert_allclose(found[0].numpy(), spectrum_to_xyz(SPECTRA, BANDS_NM), atol=tolerance)
    spectrum = torch.as_tensor(SPECTRA, dtype=torch.float64).requires_grad_()
    assert torch.autograd.gradcheck(lambda s: spectrum_to_rgb(s, BANDS_NM), spectrum)


def test_iridescent_colours_leave_the_gamut():
    assert spectrum_to_rgb(SPECTRA[2], BANDS_NM)[0] < 0


@pytest.mark.parametrize(
    ("wavelengths", "arguments", "message"),
    [
        (BANDS_NM, {"illuminant": "F2"}, "illuminant: expected one of A, C, .*got 'F2'"),
        (BANDS_NM, {"observer": "me"}, "observer: expected one of CIE 1931 2 deg, .*got 'me'"),
        (BANDS_NM[::-1], {}, "wavelength_nm: .*that rise"),
        (np.arange(420, 781, 5.0), {}, "expected 400…760 nm or more .*got 420…780 nm"),
        (np.array([380.0, 500, 780]), {}, "steps of up to 280 nm"),
    ],
)
def test_bad_input_is_one_line(wavelengths, arguments, message):
    with pytest.raises(InputError, match=message) as error:
        xyz_weights(wavelengths, **arguments)
    assert "\n" not in str(error.value)
    with pytest.raises(InputError, match=r"spectrum: expected 81 values .* got shape \[3\]"):
        spectrum_to_xyz(np.ones(3), BANDS_NM)
