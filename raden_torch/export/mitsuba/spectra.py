"""Linear RGB as the spectrum type of a variant of Mitsuba."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from raden_torch.colorimetry import SRGB_LUMINANCE
from raden_torch.optics.spectral_colour import VISIBLE_NM
from raden_torch.optics.spectral_primaries import STEP_NM, primary_spectra

_NODES = 1 + round((VISIBLE_NM[1] - VISIBLE_NM[0]) / STEP_NM)


def spectrum_of(mi: Any) -> Callable[[Any, Any], Any]:
    """What turns a colour and `si.wavelengths` into a value of Mitsuba's current variant.

    RGB stays as it is, unclipped; the monochromatic variants get the luminance; the spectral ones
    r R(λ) + g G(λ) + b B(λ) (`optics/spectral_primaries.py`). Polarised variants get a depolariser.
    """
    variant = mi.variant()
    if "_spectral" in variant:
        value = _upsampled(mi)
    elif "_mono" in variant:
        value = _luminance(mi)
    else:
        return lambda rgb, wavelengths: rgb
    if not variant.endswith("_polarized"):
        return value
    return lambda rgb, wavelengths: mi.depolarizer(value(rgb, wavelengths))


def _luminance(mi: Any) -> Callable[[Any, Any], Any]:
    r, g, b = SRGB_LUMINANCE
    return lambda rgb, wavelengths: mi.Color1f(r * rgb.x + g * rgb.y + b * rgb.z)


def _upsampled(mi: Any) -> Callable[[Any, Any], Any]:
    import drjit as dr

    low, high = VISIBLE_NM
    spectra = primary_spectra(np.linspace(low, high, _NODES)).astype(np.float32)
    texture = mi.Texture1f(tensor(mi, spectra), use_accel=False, wrap_mode=dr.WrapMode.Clamp)

    def value(rgb: Any, wavelengths: Any) -> Any:
        places = (wavelengths - low) * ((_NODES - 1) / (high - low) / _NODES) + 0.5 / _NODES
        spectrum = mi.UnpolarizedSpectrum(0)
        for i in range(len(places)):
            shares = texture.eval(mi.Point1f(places[i]))
            spectrum[i] = dr.dot(rgb, mi.Color3f(shares))
        return spectrum

    return value


def tensor(mi: Any, values: Any) -> Any:
    """An array as the tensor type that textures of Mitsuba's current variant take."""
    from drjit import scalar

    kind = scalar.TensorXf if mi.variant().startswith("scalar") else mi.TensorXf
    return kind(np.ascontiguousarray(values))
