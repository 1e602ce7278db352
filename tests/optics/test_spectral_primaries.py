"""The spectra of the primaries: a colour's own under D65, within what reflects."""

from __future__ import annotations

import numpy as np

from raden_torch.optics.spectral_colour import spectrum_to_rgb
from raden_torch.optics.spectral_primaries import primary_spectra

NM = np.arange(380.0, 781.0, 1.0)


def test_colours_come_back_under_d65() -> None:
    """Iridescent ones, whose channels leave 0…1, too."""
    colours = np.random.default_rng(1).uniform(-0.3, 1.5, (50, 3))
    spectra = colours @ primary_spectra(NM).T
    np.testing.assert_allclose(spectrum_to_rgb(spectra, NM), colours, atol=1e-6)


def test_they_reflect_between_nothing_and_all_and_sum_to_all() -> None:
    spectra = primary_spectra(NM)
    assert spectra.min() > -1e-9
    assert spectra.max() < 1 + 1e-9
    np.testing.assert_allclose(spectra.sum(1), 1, atol=1e-12)
    ends = primary_spectra(np.array([300.0, 380.0, 780.0, 900.0]))
    np.testing.assert_array_equal(ends[[0, 3]], ends[[1, 2]])
