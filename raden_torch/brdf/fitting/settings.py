"""How models are fitted, as plain data: of one measurement, or of each of many."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal

from raden_torch.brdf.fitting.by_azimuth import AzimuthFit, fit_by_azimuth
from raden_torch.brdf.fitting.diffuse_fit import DiffuseParameters
from raden_torch.brdf.fitting.fit import FitResult, fit
from raden_torch.brdf.fitting.spectral_fit import SpectralFit, fit_spectral

if TYPE_CHECKING:
    from raden_torch.measurement import BrdfMeasurement


@dataclass(frozen=True)
class FitSettings:
    """As the arguments of `fit`, `fit_by_azimuth` and `fit_spectral`.

    Attributes:
        by_azimuth: a model that turns.
        std: keep what the stated errors of the measurement do; of one azimuth and RGB alone.
        spectral: keep the bands; then `diffuse` and `outside` are not looked at.
    """

    diffuse: DiffuseParameters | Literal["floor", "surface"] = "floor"
    interpolation: str = "auto"
    assume: Literal["isotropic", "isotropic+reciprocal"] | None = None
    by_azimuth: bool = False
    spectral: bool = False
    outside: Literal["continued", "diffuse"] = "continued"
    std: bool = False

    def fitted(
        self, measurement: BrdfMeasurement, validation: BrdfMeasurement | None = None
    ) -> FitResult | AzimuthFit | SpectralFit:
        """The model of a measurement, with its report.

        Args:
            validation: readings off the grid, by which the interpolation is chosen.

        Raises:
            InputError: as the functions that fit.
        """
        if self.spectral:
            return fit_spectral(
                measurement,
                interpolation=self.interpolation,
                validation=validation,
                assume=self.assume,
            )
        asked: dict[str, Any] = {
            "diffuse": self.diffuse,
            "interpolation": self.interpolation,
            "validation": validation,
            "assume": self.assume,
            "outside": self.outside,
        }
        if self.by_azimuth:
            return fit_by_azimuth(measurement, **asked)
        return fit(measurement, **asked, std=self.std)
