"""What a fit makes its table of: linear RGB, or the bands of a spectral measurement.

Interpolators take reflectance factors whose second channel is Y, which decides for all of them
where nodes lie and which lobes there are. For RGB these are X, Y, Z; for bands they are X, Y, Z and
the bands themselves.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from raden_torch.arrays import Floats
from raden_torch.measurement import BrdfMeasurement
from raden_torch.measurement.colour_conversion import f_r_of_xyz, xyz_of_f_r
from raden_torch.measurement.readings import FACTOR_PER_SR, RGB, XYZ


@dataclass(frozen=True, eq=False)
class Channels:
    """Linear RGB, or bands.

    Attributes:
        bands_to_xyz: `[3, N]` of reflectance factors; None for RGB.
    """

    bands_to_xyz: Floats | None = None

    def of(self, measurement: BrdfMeasurement) -> tuple[BrdfMeasurement, list[str]]:
        """The measurement in these channels; RGB of bands that make no colour is a grey, with a
        warning."""
        if self.bands_to_xyz is not None:
            return measurement, []
        if measurement.is_spectral and not measurement.has_colour:
            bands = ", ".join(measurement.channels[:4])
            grey = np.repeat(measurement.values.mean(axis=1, keepdims=True), 3, axis=1)
            warning = f"the bands ({bands}) make no colour: the model is grey"
            return replace(measurement, values=grey, channels=RGB, std=None), [warning]
        return measurement.as_rgb(), []

    def factors_of(self, measurement: BrdfMeasurement) -> tuple[Floats, Floats | None]:
        """`[M, K]` factors of the valid readings and `[M, 3]` the standard deviation of X, Y, Z, as
        far as it was stated of what was measured."""
        known = measurement.select(measurement.valid)
        if self.bands_to_xyz is not None:
            xyz = known.as_xyz()
            return np.concatenate([xyz.values, known.values], axis=1), xyz.std
        grey = known.is_spectral and not known.has_colour
        xyz = self.of(known)[0].as_xyz() if grey else known.as_xyz()
        assert xyz.channels == XYZ
        return xyz.values, xyz.std

    def factors(self, f_r: Floats) -> Floats:
        """f_r `[…, C]` in 1/sr → factors `[…, K]`."""
        if self.bands_to_xyz is None:
            return xyz_of_f_r(f_r)
        bands = f_r * FACTOR_PER_SR
        return np.concatenate([bands @ self.bands_to_xyz.T, bands], axis=-1)

    def f_r(self, factors: Floats) -> Floats:
        """Factors `[…, K]` → f_r `[…, C]` in 1/sr."""
        if self.bands_to_xyz is None:
            return f_r_of_xyz(factors)
        return np.asarray(factors[..., 3:] / FACTOR_PER_SR)


IN_RGB = Channels()
