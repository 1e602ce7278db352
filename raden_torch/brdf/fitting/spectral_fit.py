"""A measurement of spectral bands → one table of all its bands (`SpectralBrdf`)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch

from raden_torch.arrays import Floats
from raden_torch.brdf.fitting.channels import Channels
from raden_torch.brdf.fitting.diffuse_fit import fit_diffuse
from raden_torch.brdf.fitting.fit import FitResult, diffuse_at_nodes, fit, for_diffuse, too_large
from raden_torch.brdf.fitting.fit_report import FitReport
from raden_torch.brdf.fitting.interpolated_table import make_table
from raden_torch.brdf.fitting.tabulate import Tabulated, tabulate
from raden_torch.brdf.materials.spectral import SpectralBrdf
from raden_torch.brdf.model.model import RadenBrdf
from raden_torch.brdf.model.runtime_bake import bake
from raden_torch.errors import InputError, check_type
from raden_torch.measurement import BrdfMeasurement
from raden_torch.measurement.colour_conversion import bands_to_xyz_matrix


@dataclass(frozen=True)
class SpectralFit:
    """A fitted spectral model and how it came about.

    Attributes:
        model: of all bands.
        in_rgb: what `fit` makes of the same readings: its table decided where the nodes are.
    """

    model: SpectralBrdf
    in_rgb: FitResult

    @property
    def report(self) -> FitReport:
        """That of the RGB model, whose choices the bands share."""
        return self.in_rgb.report


def fit_spectral(
    measurement: BrdfMeasurement,
    *,
    interpolation: str = "auto",
    validation: BrdfMeasurement | None = None,
    assume: str | None = None,
) -> SpectralFit:
    """Fit a model that can be lit by any illuminant.

    The readings are first fitted in RGB, as `fit` does it. Then every band is tabulated, filled,
    interpolated and continued to the horizon likewise, with that model's interpolation and nodes.

    Args:
        measurement: as for `fit`; its channels are bands.
        interpolation, validation, assume: as for `fit`.

    Raises:
        InputError: channels that are not bands, or bands that do not span the visible range or are
            far apart; a table too large; what `fit` raises.

    Examples:
        >>> import raden_torch as rt
        >>> found = fit_spectral(rt.simulate_specimen("akoya", step_deg=35, spectral=True))
        >>> found.model
        SpectralBrdf(simulated 'akoya', 81 bands, 380…780 nm)
    """
    hint = "load_measurement reads one from a file"
    check_type("measurement", measurement, BrdfMeasurement, hint)
    if not measurement.is_spectral:
        raise InputError(
            "measurement: expected spectral bands (as 550nm) for a spectral model, got channels "
            f"{', '.join(measurement.channels)}"
        )
    channels = Channels(bands_to_xyz_matrix(measurement))
    in_rgb = fit(measurement, interpolation=interpolation, validation=validation, assume=assume)
    table = tabulate(measurement, assume, channels)
    if size := too_large(table):
        raise InputError(f"measurement: {size}; a spectral model needs a coarser grid")
    scheme = in_rgb.report.interpolation
    fitted = make_table(table, _without_gaps(table), scheme, "continued")
    with torch.no_grad():
        values = bake(RadenBrdf(None, fitted), in_rgb.model.layout)
    model = SpectralBrdf(
        values, in_rgb.model.layout, measurement.wavelengths_nm, in_rgb.model.provenance
    )
    return SpectralFit(model, in_rgb)


def _without_gaps(table: Tabulated) -> Floats:
    """`[A, R, T, N]` f_r; nodes without a measured neighbour take the band's diffuse part."""
    total = table.values
    if not np.isnan(total).any():
        return total
    angles, f_r = for_diffuse(table)
    last = total.shape[-1] - 3
    for first in {*range(0, last, 3), last}:
        three = slice(first, first + 3)
        part = diffuse_at_nodes(table, fit_diffuse(angles, f_r[:, three]))
        total[..., three] = np.where(np.isnan(total[..., three]), part, total[..., three])
    return total
