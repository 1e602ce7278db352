"""Nacre's indices and its averaged spectra against values computed independently for it."""

from __future__ import annotations

import numpy as np
import pytest

from raden_torch.measurement import BrdfMeasurement
from raden_torch.optics.films import Films, isotropic, reflectance
from raden_torch.optics.nacre import (
    ORGANIC_N,
    URUSHI_N,
    Stack,
    aragonite,
    calcite_index,
    mean_reflectance,
    random_thicknesses,
)

BANDS_NM = np.arange(380.0, 781.0, 5.0)
ANGLES_DEG = (0, 20, 40, 60)
# specular linear sRGB under D65, a perfect mirror = 1, from air at 0, 20, 40 and 60 degrees;
# rounded to 0.01 and from other random stacks
MIRROR_RGB = {
    440: ((-0.01, 0.26, 0.11), (-0.02, 0.22, 0.12), (0.04, 0.13, 0.21), (0.21, 0.11, 0.30)),
    460: ((0.07, 0.26, 0.14), (0.02, 0.26, 0.11), (0.01, 0.18, 0.14), (0.13, 0.13, 0.29)),
    480: ((0.20, 0.21, 0.20), (0.13, 0.24, 0.16), (0.01, 0.23, 0.12), (0.09, 0.17, 0.23)),
    500: ((0.31, 0.13, 0.26), (0.25, 0.17, 0.23), (0.06, 0.25, 0.13), (0.07, 0.20, 0.18)),
    520: ((0.31, 0.10, 0.25), (0.31, 0.11, 0.26), (0.16, 0.21, 0.18), (0.07, 0.24, 0.16)),
}


def q_squared(angles_deg):
    return np.sin(np.radians(angles_deg)) ** 2


@pytest.mark.parametrize("tablet_nm", MIRROR_RGB)
def test_mirror_colours(tablet_nm):
    spectra = mean_reflectance(Stack(tablet_nm), BANDS_NM, q_squared(ANGLES_DEG))
    angles, zero = np.array(ANGLES_DEG, float), np.zeros(4)
    names = tuple(f"{band:g}nm" for band in BANDS_NM)
    rgb = BrdfMeasurement(angles, angles, zero, spectra, names).as_rgb().values
    np.testing.assert_allclose(rgb, MIRROR_RGB[tablet_nm], atol=0.025)


@pytest.mark.parametrize(("tablets", "peak"), [(5, 0.20), (10, 0.37), (20, 0.67), (40, 0.94)])
def test_perfect_stack_peak(tablets, peak):
    stack = Stack(300, tablet_spread=0, organic_spread=0, tablets=tablets, loss=0)
    wavelength = np.arange(500.0, 600.0)
    spectrum = mean_reflectance(stack, wavelength, np.zeros(1), stacks=1)[0]
    assert spectrum.max() == pytest.approx(peak, abs=0.01)


def test_perfect_stack_peaks_where_two_half_waves_fit():
    stack = Stack(300, tablet_spread=0, organic_spread=0, tablets=160, loss=0)
    wavelength = np.arange(500.0, 600.0, 0.5)
    spectrum = mean_reflectance(stack, wavelength, np.zeros(1), stacks=1)[0]
    band = wavelength[spectrum > 0.99]
    assert (band[0] + band[-1]) / 2 == pytest.approx(544, abs=1)


def test_disorder_lowers_and_widens_the_peak():
    wavelength = np.arange(460.0, 640.0, 2.0)
    heights, widths = [], []
    for spread in (0.02, 0.04, 0.06, 0.09):
        stack = Stack(300, spread, tablets=165)
        spectrum = mean_reflectance(stack, wavelength, np.zeros(1))[0]
        heights.append(spectrum.max())
        widths.append(2.0 * np.sum(spectrum > spectrum.max() / 2))
    assert (np.diff(heights) < 0).all()
    assert (np.diff(widths) > 0).all()
    # the wide ones are known to be 0.71, 0.60, 0.43
    np.testing.assert_allclose(heights[1:], (0.71, 0.60, 0.43), atol=0.06)


def test_peak_travels_to_the_blue_with_the_angle():
    stack = Stack(300, tablet_spread=0.05, tablets=100, loss=0)
    wavelength = np.arange(400.0, 620.0, 2.0)
    spectra = mean_reflectance(stack, wavelength, q_squared(ANGLES_DEG))
    smooth = np.stack([np.convolve(row, np.ones(11) / 11, "same") for row in spectra])
    peaks = wavelength[smooth.argmax(axis=1)]
    np.testing.assert_allclose(peaks, (548, 532, 500, 456), atol=6)


def test_birefringence_moves_the_p_peak_at_large_angles():
    """At 60 degrees and 460 nm tablets: 450 nm, where an isotropic tablet would give 468 nm."""
    wavelength = np.arange(420.0, 500.0, 2.0)
    tablet = aragonite(wavelength, 5e-4)
    thickness = random_thicknesses(Stack(460), 150, np.random.default_rng(0))
    order = [0, *(1 + film % 2 for film in range(len(thickness))), 3]
    peaks = []
    for n_e in (tablet.n_e, tablet.n_o):
        media = [
            isotropic(1.0),
            tablet._replace(n_e=n_e),
            isotropic(ORGANIC_N),
            isotropic(URUSHI_N),
        ]
        films = Films(media, order, thickness)
        spectrum = reflectance(films, wavelength, np.sin(np.radians(60)), "p").mean(axis=0)
        weight = np.where(spectrum > spectrum.max() / 2, spectrum, 0)
        peaks.append(weight @ wavelength / weight.sum())
    np.testing.assert_allclose(peaks, (450, 468), atol=3)


def test_calcite_index_is_the_published_one():
    """Textbook calcite at the sodium line: 1.658 and 1.486."""
    ordinary = (0.73358749, 0.96464345, 1.94325203e-2, 1.82831454, 120.0)
    extraordinary = (0.35859695, 0.82427830, 1.06689543e-2, 0.14429128, 120.0)
    assert calcite_index(589.3, ordinary) == pytest.approx(1.6584, abs=5e-4)
    assert calcite_index(589.3, extraordinary) == pytest.approx(1.4864, abs=5e-4)


def test_aragonite_has_its_indices_at_the_sodium_line_and_normal_dispersion():
    medium = aragonite(np.array([400.0, 589.3, 700.0]), loss=5e-4)
    assert medium.n_o[1] == pytest.approx(1.6834 + 5e-4j)
    assert medium.n_e[1] == pytest.approx(1.530 + 5e-4j)
    assert (np.diff(medium.n_o.real) < 0).all()
    assert (np.diff(medium.n_e.real) < 0).all()


def test_random_thicknesses_have_the_stack_s_mean_and_spread():
    draws = random_thicknesses(Stack(480, 0.05), 200, np.random.default_rng(1))
    assert draws.shape == (339, 200)
    assert draws[0::2].mean() == pytest.approx(480, abs=1)
    assert draws[0::2].std() == pytest.approx(24, rel=0.03)
    assert draws[1::2].mean() == pytest.approx(25, abs=0.2)
    assert draws.min() > 0
