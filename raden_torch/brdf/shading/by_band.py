"""A spectral model, band by band: what a spectrometer in the place of the eye would see."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor

from raden_torch.brdf.materials.spectral import SpectralBrdf
from raden_torch.brdf.shading.environment import EnvironmentLight
from raden_torch.brdf.shading.gbuffer import GBuffer
from raden_torch.brdf.shading.lights import Light
from raden_torch.brdf.shading.shade import shade
from raden_torch.errors import InputError, check_type


def shade_bands(model: SpectralBrdf, gbuffer: GBuffer, lights: Sequence[Light] | Light) -> Tensor:
    """Outgoing spectral radiance under lights of even spectrum.

    Multiply it by a spectrum of one number a band for lights that have that. Integrated by
    `Illuminant.rgb_weights` it is what `shade(model.under(illuminant), …)` gives, at N/3 times the
    cost and N/3 times the memory.

    Args:
        lights: as for `shade`, grey ones: their irradiance is that of every band.

    Returns:
        `[B, N, H, W]`, in the unit of `shade`; 0 in invalid pixels.

    Raises:
        InputError: a light with a colour; whatever `shade` raises.
    """
    check_type("model", model, SpectralBrdf, "fit_spectral(…).model is one")
    each = list(lights) if isinstance(lights, Sequence) else [lights]
    for place, light in enumerate(each):
        _check_grey(light, place)
    last = len(model) - 3
    parts = {first: shade(model.three_bands(first), gbuffer, each) for first in range(0, last, 3)}
    done = 3 * len(parts)
    parts[last] = shade(model.three_bands(last), gbuffer, each)[:, done - last :]
    return torch.cat(list(parts.values()), dim=1)


def _check_grey(light: Light, place: int) -> None:
    for name in ("irradiance", "intensity", "radiance"):
        value = getattr(light, name, None)
        if value is None:
            continue
        colour = torch.as_tensor(value)
        axis = 0 if isinstance(light, EnvironmentLight) and name == "radiance" else -1
        if colour.ndim and bool((colour != colour.narrow(axis, 0, 1)).any()):
            raise InputError(
                f"lights[{place}]: {name}: expected one number for all bands, got a colour; a "
                "light's colour is its spectrum here"
            )
