"""`export_measured`: a model as a `.bsdf` tensor file, and what is lost by it."""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, cast

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from raden_torch import __version__
from raden_torch.arrays import Floats
from raden_torch.brdf.materials.anisotropic import AnisotropicBrdf
from raden_torch.brdf.materials.palette import Palette
from raden_torch.brdf.materials.runtime import models_of
from raden_torch.brdf.materials.surface import Reflection, Surface
from raden_torch.brdf.model.model import Provenance, RadenBrdf
from raden_torch.capture.exchange.tensor_fields import write_fields
from raden_torch.errors import InputError
from raden_torch.export.forms import RuntimeForm, form_of
from raden_torch.export.measured.fields import Measured, Reflectance, fields_of
from raden_torch.files import check_output
from raden_torch.optics.spectral_colour import VISIBLE_NM
from raden_torch.optics.spectral_primaries import STEP_NM, primary_spectra

LIMIT = 0.03
"""The largest loss that is written unasked: Σ|difference| over Σ|f_r cos θi|."""

_GOOD = 0.01
_SIZES = ((32, 64), (48, 96), (64, 128))
_PAIRS = 20_000


@dataclass(frozen=True)
class MeasuredReport:
    """What was written.

    Attributes:
        viewers, side: how many incidences, and nodes along each side of the square of each.
        bands: 3, or the wavelengths of a file with spectra.
        bytes: of the file.
        error: Σ|difference| over Σ|f_r cos θi| to the model, for pairs of directions spread evenly
            by projected solid angle; of an averaged sample, to the sample at every azimuth.
        averaged: how many azimuths it is the mean of; 1 of an isotropic model.
    """

    viewers: int
    side: int
    bands: int
    bytes: int
    error: float
    averaged: int

    def __str__(self) -> str:
        bands = "RGB" if self.bands == 3 else f"{self.bands} wavelengths"
        mean = f", the mean of {self.averaged} azimuths" if self.averaged > 1 else ""
        return (
            f"measured BSDF: {self.viewers} incidences x {self.side} x {self.side} x {bands}, "
            f"{self.bytes} bytes{mean}; off by {self.error:.2%} of the reflection"
        )


def export_measured(
    model: Reflection,
    path: str | os.PathLike[str],
    *,
    spectra: bool = False,
    average: bool = False,
) -> MeasuredReport:
    """Write a `.bsdf` file, which the material `measured` of Mitsuba 3 or pbrt-v4 reads.

    The format holds every reflection that does not change when light and viewer turn together, f_r
    of opposite tilts apart, too: only its resolution loses, and the report says what.

    Args:
        model: of the three angles; on the CPU.
        path: ends in .bsdf.
        spectra: a spectrum of `spectral_primaries` for each colour, for pbrt-v4 and Mitsuba's
            spectral variants; otherwise RGB, for Mitsuba's RGB variants. No file is for both.
        average: write the mean over the azimuths of an anisotropic sample, and what is off by more
            than 3 %.

    Raises:
        InputError: another suffix, a palette, an anisotropic sample or a lobe too narrow for the
            format without `average`, or the file cannot be written.

    Examples:
        >>> import raden_torch as rt
        >>> from raden_torch.export.measured.measured_file import export_measured
        >>> model = rt.fit(rt.simulate_specimen("akoya", step_deg=35)).model
        >>> export_measured(model, "shell.bsdf").error < 0.03
        True
    """
    target = check_output(path, (".bsdf",))
    if isinstance(model, Palette):
        raise InputError(f"model: expected one material, got a palette of {len(model)}")
    if isinstance(model, AnisotropicBrdf):
        made, error = _made(_reflectance(model.of_unit_vectors), _turned_reflectance(model))
    else:
        form = form_of(model, "runtime")
        assert isinstance(form, RuntimeForm)
        f_r = _reflectance(form.of_unit_vectors)
        made, error = _made(f_r, f_r)
    if not np.isfinite(made.values).all():
        raise InputError("model: expected a finite f_r in every geometry, got one that is not")
    if error > LIMIT and not average:
        raise InputError(_refusal(model, error))
    source = _provenance(model)
    bands, data = _bands(made, spectra)
    size = write_fields(target, _arrays(made, data, source))
    return MeasuredReport(
        len(made.theta_i),
        made.luminance.shape[1],
        bands,
        size,
        error,
        len(model.azimuth_deg) if isinstance(model, AnisotropicBrdf) else 1,
    )


def _made(f_r: Reflectance, reference: Reflectance) -> tuple[Measured, float]:
    """The smallest of the sizes that loses little, and its loss."""
    light, view = _pairs()
    wanted, own = (f(light, view) * light[:, 2:] for f in (reference, f_r))
    for size in _SIZES:
        made = fields_of(f_r, *size)
        found = made.f_r(light, view) * light[:, 2:]
        if _share(found - own, own) <= _GOOD:
            break
    return made, _share(found - wanted, wanted)


def _share(off: Floats, wanted: Floats) -> float:
    return float(np.abs(off).sum() / max(np.abs(wanted).sum(), 1e-300))


def _refusal(model: Reflection, error: float) -> str:
    if isinstance(model, AnisotropicBrdf):
        return (
            f"model: expected an isotropic sample, got one of {len(model.azimuth_deg)} azimuths, "
            f"whose mean is off by {error:.1%} of the reflection; --average writes it"
        )
    return (
        f"model: expected a reflection that the format holds within {LIMIT:.0%}, got one that it "
        f"has off by {error:.1%}: its highlight is too narrow; --average writes it all the same"
    )


def _reflectance(of_unit_vectors: Callable[[Tensor, Tensor, Tensor], Tensor]) -> Reflectance:
    def f_r(light: Floats, view: Floats) -> Floats:
        normal, *maps = _maps(light, view)
        with torch.no_grad():
            return of_unit_vectors(normal, *maps)[0, :, 0].T.numpy()

    return f_r


def _turned_reflectance(model: AnisotropicBrdf) -> Reflectance:
    """The sample at azimuths that are spread evenly over the pairs."""

    def f_r(light: Floats, view: Floats) -> Floats:
        normal, to_light, v = _maps(light, view)
        turn = np.random.default_rng(3).random(len(light)) * 2 * np.pi
        along = np.stack([np.cos(turn), np.sin(turn), np.zeros_like(turn)], 1)
        tangent = _maps(along, along)[1]
        with torch.no_grad():
            surface = Surface(normal.expand_as(v), v, tangent=tangent)
            return model.of_surface(surface, to_light)[0, :, 0].T.numpy()

    return f_r


def _maps(light: Floats, view: Floats) -> list[Tensor]:
    normal = torch.tensor([0.0, 0.0, 1.0], dtype=torch.float64).view(1, 3, 1, 1)
    rows = (np.ascontiguousarray(w.T) for w in (light, view))
    return [normal, *(torch.from_numpy(w)[None, :, None] for w in rows)]


def _pairs() -> tuple[Floats, Floats]:
    random = np.random.default_rng(2)
    square, azimuth = random.random((2, _PAIRS)), 2 * np.pi * random.random((2, _PAIRS))
    radius = np.sqrt(square)
    both = [radius * np.cos(azimuth), radius * np.sin(azimuth), np.sqrt(1 - square)]
    light, view = np.stack(both, -1)
    return light, view


def _bands(made: Measured, spectra: bool) -> tuple[int, dict[str, Floats]]:
    if not spectra:
        return 3, {"rgb": made.values}
    nm = np.arange(VISIBLE_NM[0], VISIBLE_NM[1] + 1, STEP_NM)
    values = np.einsum("wc,tcyx->twyx", primary_spectra(nm), made.values)
    return len(nm), {"wavelengths": nm, "spectra": values}


def _arrays(
    made: Measured, bands: dict[str, Floats], source: Provenance
) -> dict[str, NDArray[Any]]:
    sample = source.sample or "unnamed sample"
    words = [
        f"{sample}{', SIMULATED' if source.simulated else ''}",
        source.instrument,
        source.measurement_sha256 and f"readings {source.measurement_sha256}",
        f"raden_torch {__version__}",
    ]
    described = "; ".join(" ".join(word.split()) for word in words if word)
    floats = {
        "theta_i": made.theta_i,
        "phi_i": np.zeros(1),
        "ndf": made.ndf,
        "sigma": made.sigma,
        "vndf": made.warp.density[None],
        "luminance": made.luminance[None],
    }
    for name, values in bands.items():
        floats[name] = values if name == "wavelengths" else values[None]
    # pbrt-v4 does not look at `jacobian`, and multiplies as for 1
    return {
        "description": np.frombuffer(described.encode(), np.uint8),
        "jacobian": np.ones(1, np.uint8),
        **{name: values.astype("<f4") for name, values in floats.items()},
    }


def _provenance(model: Reflection) -> Provenance:
    own = cast(RadenBrdf, model.models[0]) if isinstance(model, AnisotropicBrdf) else model
    models = models_of(own)
    return models[0].provenance if models else Provenance()
