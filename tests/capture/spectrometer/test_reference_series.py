"""The dark and white series: interpolated between, divided by, and their own uncertainty."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from raden_torch.capture.spectrometer.journal import Reference
from raden_torch.capture.spectrometer.ports import ColorReading, Range, Target
from raden_torch.capture.spectrometer.reference_series import ReferenceSeries
from raden_torch.capture.spectrometer.stated_uncertainty import StatedUncertainty
from raden_torch.errors import InputError

BANDS = np.arange(380.0, 781.0, 5.0)
LAMP = 1.0 + (BANDS - 380) / 100  # a reddish one


def xyz(level: float) -> ColorReading:
    return ColorReading(np.array([0.9, 1.0, 1.1]) * level)


def spectrum(radiance: np.ndarray) -> ColorReading:
    return ColorReading(np.full(3, radiance.mean()), wavelengths_nm=BANDS, radiance=radiance)


def series(*references: Reference) -> ReferenceSeries:
    return ReferenceSeries(SimpleNamespace(taken=[], references=list(references)))


def dark(number: int, time_s: float, reading: ColorReading) -> Reference:
    return Reference(number, Target.DARK, reading, time_s)


def white(number: int, time_s: float, reading: ColorReading) -> Reference:
    return Reference(number, Target.WHITE, reading, time_s)


@pytest.fixture
def fading() -> ReferenceSeries:
    """A lamp that falls from 100 to 80 in 200 s, over a darkness of 2 that grows to 4."""
    return series(
        dark(1, 0.0, xyz(2.0)),
        white(2, 0.0, xyz(102.0)),
        dark(3, 200.0, xyz(4.0)),
        white(4, 200.0, xyz(84.0)),
    )


@pytest.mark.parametrize(
    ("time_s", "darkness", "level"), [(-50, 2, 100), (0, 2, 100), (50, 2.5, 95), (999, 4, 80)]
)
def test_levels_are_linear_between_series_and_constant_beyond(
    fading: ReferenceSeries, time_s: float, darkness: float, level: float
) -> None:
    at = np.array([float(time_s)])
    np.testing.assert_allclose(fading.dark(at)[0], np.array([0.9, 1.0, 1.1]) * darkness)
    np.testing.assert_allclose(fading.white(at)[0], np.array([0.9, 1.0, 1.1]) * level)


def test_drift_is_that_of_an_even_distribution(fading: ReferenceSeries) -> None:
    """The lamp changed by 20 %: between the series it may have done so at any time."""
    np.testing.assert_allclose(fading.white_level, [[1, 1, 1], [0.8, 0.8, 0.8]])
    np.testing.assert_allclose(fading.drift(np.array([100.0])), 0.2 / np.sqrt(12))


def test_a_ratio_of_xyz_is_each_components(fading: ReferenceSeries) -> None:
    white_there = fading.white(np.array([0.0]))
    np.testing.assert_allclose(fading.ratio(0.3 * white_there, white_there), 0.3)
    assert fading.wavelengths_nm is None
    stated = StatedUncertainty(xyz_std=0.02)
    error = fading.colour_error(0.3 * white_there, white_there, stated)
    np.testing.assert_allclose(error, 0.02 * 0.3)


def test_noise_is_that_of_single_readings_in_their_series() -> None:
    """Readings of 99, 100 and 101 % have a standard deviation of 1 %, over two degrees of
    freedom each; means of three are √3 better."""
    found = series(
        dark(1, 0.0, xyz(0.0)),
        *(white(2, 0.0, xyz(level)) for level in (99.0, 100.0, 101.0)),
        *(white(3, 50.0, xyz(level)) for level in (49.5, 50.0, 50.5)),
    )
    np.testing.assert_allclose(found.white_single_std, 0.01)
    np.testing.assert_allclose(found.white_share(np.array([25.0]))[:, 0, 0], 0.5 / np.sqrt(3))
    np.testing.assert_allclose(found.white_weight(np.array([10.0]))[:, 0, 0], [0.8, 0.2])
    assert found.white_mean_std(0.0) == pytest.approx(0.01 / np.sqrt(6))
    moved = np.hypot(0.01 / np.sqrt(6), 0.02 / np.sqrt(2))
    assert found.white_mean_std(0.02) == pytest.approx(moved)


def test_the_lamps_spectrum_cancels() -> None:
    """Of a grey sample, whatever the lamp; of a coloured one, it is weighed by D65, not by it."""
    found = series(dark(1, 0.0, spectrum(0 * LAMP)), white(2, 0.0, spectrum(LAMP)))
    other = series(dark(1, 0.0, spectrum(0 * LAMP)), white(2, 0.0, spectrum(LAMP[::-1].copy())))
    at = np.array([0.0])
    np.testing.assert_allclose(found.ratio(0.3 * found.white(at), found.white(at)), 0.3)
    reflectance = np.linspace(0.2, 0.9, len(BANDS))
    ratios = [lit.ratio(reflectance * lit.white(at), lit.white(at)) for lit in (found, other)]
    np.testing.assert_allclose(ratios[0], ratios[1], rtol=1e-12)
    assert ratios[0][0, 0] > ratios[0][0, 2]  # more red than blue: more X than Z


def test_wavelengths_that_are_off_move_a_sloping_reflectance() -> None:
    """A slope of 0.1 % a nanometre, read 0.5 nm off: 0.05 %, in X, Y and Z alike."""
    found = series(dark(1, 0.0, spectrum(0 * LAMP)), white(2, 0.0, spectrum(LAMP)))
    signal = found.white(np.array([0.0])) * (0.5 + 0.001 * (BANDS - 380))
    stated = StatedUncertainty(wavelength_std_nm=0.5)
    error = found.colour_error(signal, found.white(np.array([0.0])), stated)
    np.testing.assert_allclose(error, 0.0005, rtol=1e-9)


def test_bands_without_light_are_left_out() -> None:
    """Below a thousandth of the strongest band a ratio is noise: it takes no part."""
    lamp = np.where(BANDS < 420, 1e-6, LAMP)
    found = series(dark(1, 0.0, spectrum(0 * lamp)), white(2, 0.0, spectrum(lamp)))
    at = found.white(np.array([0.0]))
    signal = 0.4 * at
    signal[:, BANDS < 420] = 1e3
    np.testing.assert_allclose(found.ratio(signal, at), 0.4)


def test_one_reading_without_a_spectrum_makes_it_xyz() -> None:
    found = series(dark(1, 0.0, spectrum(0 * LAMP)), white(2, 0.0, xyz(100.0)))
    assert found.wavelengths_nm is None


def test_a_dark_under_the_range_is_0() -> None:
    nothing = ColorReading(np.full(3, np.nan), Range.UNDER)
    found = series(dark(1, 0.0, nothing), white(2, 0.0, xyz(100.0)))
    np.testing.assert_array_equal(found.dark(np.array([5.0])), np.zeros((1, 3)))


@pytest.mark.parametrize(
    ("references", "message"),
    [
        ([white(1, 0.0, xyz(100.0))], "no dark or no white reading"),
        ([dark(1, 0.0, xyz(1.0))], "no dark or no white reading"),
        ([dark(1, 0.0, xyz(5.0)), white(2, 0.0, xyz(5.0))], "no more light than the dark one"),
    ],
)
def test_what_nothing_can_be_divided_by(references: list[Reference], message: str) -> None:
    with pytest.raises(InputError, match=message):
        series(*references)
