"""A measurement or a model, seen as what the graphs need of it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import torch

from raden_torch.arrays import Floats
from raden_torch.brdf.fitting.diffuse_fit import DiffuseParameters, fit_diffuse
from raden_torch.brdf.model.model import CosineDiffuse, RadenBrdf
from raden_torch.errors import InputError
from raden_torch.measurement import BrdfMeasurement
from raden_torch.measurement.readings import FACTOR_PER_SR, RGB
from raden_torch.plots.cuts import (
    ANGLES,
    GridSamples,
    ModelSamples,
    Samples,
    ScatteredSamples,
    model_factors,
)

_GREEN_NM = 550.0


@dataclass(frozen=True)
class View:
    """What the panels draw.

    Attributes:
        source: what was asked for.
        samples: what its values are cut from; they are linear RGB, three equal ones where grey.
        bands: the channels' names: R, G, B, or one band's.
        colourless: why it has no colour; empty where it has.
        note: what else a reader has to know; may be empty.
        by_hand: S and n of the diffuse part, where they are not the source's own.
    """

    source: BrdfMeasurement | RadenBrdf
    samples: Samples
    bands: tuple[str, ...] = RGB
    colourless: str = ""
    note: str = ""
    by_hand: DiffuseParameters | None = None

    @property
    def is_model(self) -> bool:
        return isinstance(self.source, RadenBrdf)

    @property
    def has_std(self) -> bool:
        """Whether standard deviations are stated, or kept of those that were."""
        if isinstance(self.source, RadenBrdf):
            return self.source.errors is not None
        return self.source.std is not None

    @property
    def sample(self) -> str:
        source = self.source
        about = source.provenance if isinstance(source, RadenBrdf) else source.metadata
        return about.sample or "an unnamed sample"

    @property
    def simulated(self) -> bool:
        source = self.source
        about = source.provenance if isinstance(source, RadenBrdf) else source.metadata
        return about.simulated

    @property
    def shown(self) -> int:
        """The channel that stands for all where one only is drawn: green, as in the paper."""
        return 1 if len(self.bands) == 3 else 0

    def diffuse_factors(self, deg: Mapping[str, Floats]) -> Floats | None:
        """`[..., 3]` reflectance factors of the diffuse part at angles in degrees, or None."""
        return None if self._diffuse is None else model_factors(self._diffuse, deg)

    @cached_property
    def _diffuse(self) -> RadenBrdf | None:
        """The diffuse part alone: by hand, the model's own, or the fit to the valid readings."""
        if self.by_hand is not None:
            return _diffuse_model(self.by_hand)
        if isinstance(self.source, RadenBrdf):
            if self.source.diffuse is None:
                return None
            return RadenBrdf(self.source.diffuse, None, diffuse_gain=self.source.diffuse_gain)
        rgb = _coloured(self.source)[0]
        rgb = rgb.select(rgb.valid)
        angles = [np.deg2rad(getattr(rgb, f"{name}_deg")) for name in ANGLES]
        found = fit_diffuse((angles[0], angles[1], angles[2]), rgb.values / FACTOR_PER_SR)
        return _diffuse_model(found)


def _diffuse_model(found: DiffuseParameters) -> RadenBrdf:
    parameters = (torch.tensor(v, dtype=torch.float64) for v in (found.scale, found.exponent))
    return RadenBrdf(CosineDiffuse(*parameters), None)


def view_of(source: BrdfMeasurement | RadenBrdf | View) -> View:
    """The view of a measurement or a model; a view is its own view.

    Raises:
        InputError: no valid reading.
    """
    if isinstance(source, View):
        return source
    if isinstance(source, RadenBrdf):
        return View(source, ModelSamples(source))
    if not source.valid.any():
        raise InputError("plot: expected a measurement with a valid reading, got none")
    readings, bands, colourless = _coloured(source)
    try:
        return View(source, GridSamples(readings.grid(), _std_on_grid(readings)), bands, colourless)
    except InputError:
        azimuth = source.azimuth_deg
        mixed = azimuth is not None and np.ptp(azimuth) > 0
        note = "scattered readings" + (", all sample azimuths together" if mixed else "")
        return View(source, ScatteredSamples(readings), bands, colourless, note)


def _std_on_grid(readings: BrdfMeasurement) -> Floats | None:
    """`[A, R, T, 3]`, as the grid's values; NaN where none is stated."""
    if readings.std is None:
        return None
    known = readings.valid & np.isfinite(readings.std).all(axis=1)
    std = np.where(known[:, None], readings.std, np.nan)
    return replace(readings, values=std, std=None, valid=known).grid().values


def _coloured(source: BrdfMeasurement) -> tuple[BrdfMeasurement, tuple[str, ...], str]:
    """Linear RGB readings, the names of the bands, and why these are no colour (or "")."""
    if not source.is_spectral:
        return source.as_rgb(), RGB, ""
    try:
        return source.as_rgb(), RGB, ""
    except InputError:
        band = int(np.argmin(abs(source.wavelengths_nm - _GREEN_NM)))
        one = len(source.channels) == 1
        why = "one band has no colour" if one else "these bands make no colour"
        grey = np.repeat(source.values[:, band : band + 1], 3, axis=1)
        readings = replace(source, values=grey, channels=RGB, std=None)
        return readings, (source.channels[band],), why
