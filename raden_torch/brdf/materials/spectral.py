"""`SpectralBrdf`: f_r of every band; under one illuminant it is an ordinary material.

Shading is linear in f_r: L = Σ f_r E cos θi. So for lights of one spectrum, shading band after band
and integrating at the end,

    rgb = Σ over bands of weight[band] · shade(table[band]),

is shading the table Σ weight[band] · table[band] once. `under` makes that table, and `shade`,
palettes, masks and lamps take it as any other (decision 39). `shade_bands` is the long way round.
"""

from __future__ import annotations

import os

import numpy as np
import torch
from torch import Tensor, nn

from raden_torch.arrays import Floats
from raden_torch.brdf.materials.runtime import RuntimeBrdf
from raden_torch.brdf.model.model import Provenance
from raden_torch.brdf.model.runtime_table import RuntimeLayout
from raden_torch.errors import InputError
from raden_torch.measurement.illuminants import Illuminant


class SpectralBrdf(nn.Module):
    """A runtime table of bands, as `fit_spectral` makes it. It is no material before a light's
    spectrum is known: `under` gives one.

    Attributes:
        wavelengths_nm: the bands' centres, rising.
        layout: the nodes of the table.
        values: `[U, V, W, N]` f_r in 1/sr.
        provenance: what the model was fitted to.

    Raises:
        InputError: values that are not of this layout, or wavelengths that do not rise or are not
            as many.

    Examples:
        >>> import raden_torch as rt
        >>> from raden_torch.brdf.fitting.spectral_fit import fit_spectral
        >>> bands = rt.simulate_specimen("akoya", step_deg=35, spectral=True)
        >>> model = fit_spectral(bands).model
        >>> len(model.wavelengths_nm)
        81
        >>> up = torch.tensor([0.0, 0.0, 1.0]).view(1, 3, 1, 1)
        >>> gbuffer = rt.GBuffer(up, view=(0, 0, 1))
        >>> image = rt.shade(model.under("A"), gbuffer, rt.DirectionalLight((0, 0, 1)))
        >>> list(image.shape)
        [1, 3, 1, 1]
    """

    values: Tensor

    def __init__(
        self,
        values: Tensor,
        layout: RuntimeLayout,
        wavelengths_nm: Floats,
        provenance: Provenance | None = None,
    ) -> None:
        super().__init__()
        self.wavelengths_nm = np.asarray(wavelengths_nm, np.float64)
        wanted = [*layout.shape, self.wavelengths_nm.size]
        if list(values.shape) != wanted:
            raise InputError(f"values: expected shape {wanted}, got {list(values.shape)}")
        if len(self.wavelengths_nm) < 3 or not (np.diff(self.wavelengths_nm) > 0).all():
            raise InputError(
                "wavelengths_nm: expected three or more that rise, got "
                f"{self.wavelengths_nm.tolist()!r:.80}"
            )
        self.layout = layout
        self.provenance = provenance or Provenance()
        self.register_buffer("values", values)

    def __len__(self) -> int:
        return len(self.wavelengths_nm)

    def under(
        self,
        illuminant: str | os.PathLike[str] | Illuminant = "D65",
        *,
        white: str | os.PathLike[str] | Illuminant | None = None,
    ) -> RuntimeBrdf:
        """A material for `shade`, in linear RGB, whose lights are all of this illuminant.

        A light's `irradiance` or `intensity` then says how much there is of it: π makes a perfect
        white diffuser shine with Y = 1. For lights of different illuminants add their images, made
        with one `white`.

        Args:
            illuminant: see `Illuminant.of`.
            white: the illuminant that the eye is adapted to (Bradford); this one itself unless
                stated, so that a white diffuser stays white. "D65" adapts nothing.

        Raises:
            InputError: an illuminant that is not known.
        """
        light = _of(illuminant)
        weights = light.rgb_weights(self.wavelengths_nm, None if white is None else _of(white))
        with torch.no_grad():
            values = self.values @ torch.from_numpy(weights).to(self.values)
        return RuntimeBrdf(values, self.layout, self.provenance)

    def three_bands(self, first: int) -> RuntimeBrdf:
        """The bands `first`, `first` + 1 and `first` + 2 as if they were red, green and blue."""
        values = self.values[..., first : first + 3].contiguous()
        return RuntimeBrdf(values, self.layout, self.provenance)

    def extra_repr(self) -> str:
        kind = "simulated " if self.provenance.simulated else ""
        low, high = self.wavelengths_nm[[0, -1]]
        return f"{kind}{self.provenance.sample!r}, {len(self)} bands, {low:g}…{high:g} nm"


def _of(illuminant: str | os.PathLike[str] | Illuminant) -> Illuminant:
    return illuminant if isinstance(illuminant, Illuminant) else Illuminant.of(illuminant)
