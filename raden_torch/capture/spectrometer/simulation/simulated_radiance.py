"""What light the simulated colorimeter sees.

Radiance = f_r(incidence, receiving, tilt) · E · cos θi, with cos θi = cos incidence · cos tilt: a
collimated lamp of irradiance E on a plane that faces it, wider than the spot that is measured. The
lamp's spectrum is D65's. A measurement's three numbers X, Y, Z become the smoothest spectral
reflectance that has them.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from raden_torch.arrays import Floats
from raden_torch.capture.spectrometer.spectrum import (
    LUMINOUS_EFFICACY_LM_PER_W,
    colour_matching,
)
from raden_torch.errors import InputError
from raden_torch.measurement import BrdfMeasurement
from raden_torch.packages import require

FIRST_NM, LAST_NM = 380, 780


@dataclass(frozen=True)
class Scene:
    """A sample's reflectance factors on a grid, and the lamp.

    Attributes:
        axes_deg: incidence, receiving and tilt of the grid, ascending, two values or more each.
        xyz: `(A, R, T, 3)` reflectance factors for D65, the perfect diffuser Y = 100.
        reflectance_of_xyz: `(401, 3)`: spectral reflectance (perfect diffuser 1) = this @ XYZ.
        lamp: `(401,)` spectral radiance of the perfect diffuser at normal incidence, W/(sr·m²·nm).
        colour_matching: `(401, 3)`.
    """

    axes_deg: tuple[Floats, Floats, Floats]
    xyz: Floats
    reflectance_of_xyz: Floats
    lamp: Floats
    colour_matching: Floats

    def save(self, path: Path) -> None:
        a, r, t = self.axes_deg
        np.savez(
            path,
            incidence=a,
            receiving=r,
            tilt=t,
            xyz=self.xyz,
            reflectance_of_xyz=self.reflectance_of_xyz,
            lamp=self.lamp,
            colour_matching=self.colour_matching,
        )

    def xyz_of(self, radiance: Floats) -> Floats:
        """`(3,)` in cd/m², as `spectrum.xyz_of` without the slow import."""
        return LUMINOUS_EFFICACY_LM_PER_W * radiance @ self.colour_matching


def load_scene(path: Path) -> Scene:
    """What `Scene.save` wrote."""
    with np.load(path, allow_pickle=False) as f:
        return Scene(
            (f["incidence"], f["receiving"], f["tilt"]),
            f["xyz"],
            f["reflectance_of_xyz"],
            f["lamp"],
            f["colour_matching"],
        )


def make_scene(measurement: BrdfMeasurement, luminance_cd_m2: float) -> Scene:
    """The scene of a sample; a perfect diffuser at normal incidence has the luminance given.

    Cells of the grid without a valid reading get the nearest one's.

    Raises:
        InputError: the readings are scattered, or make no colour.
    """
    require("simulated rigs", "spectrometer")
    import colour
    from scipy.ndimage import distance_transform_edt

    grid = measurement.as_xyz().grid()
    if not grid.measured.any():
        raise InputError(
            "measurement: expected a valid reading to simulate a sample with, got none"
        )
    missing = ~grid.measured
    nearest = distance_transform_edt(missing, return_distances=False, return_indices=True)
    values = grid.values[tuple(nearest)]
    axes = []
    for dim, axis in enumerate(grid.axes_deg):
        if len(axis) == 1:  # the interpolator wants two; the sample does not change along it
            axis, values = np.append(axis, axis + 1.0), np.repeat(values, 2, axis=dim)
        axes.append(axis)
    cmf = colour_matching(FIRST_NM, LAST_NM)
    d65 = colour.SDS_ILLUMINANTS["D65"].copy().align(colour.SpectralShape(FIRST_NM, LAST_NM, 1))
    spectrum = np.asarray(d65.values, np.float64)
    lamp = spectrum * luminance_cd_m2 / (LUMINOUS_EFFICACY_LM_PER_W * spectrum @ cmf[:, 1])
    to_xyz = 100.0 * (cmf * spectrum[:, None]).T / (spectrum @ cmf[:, 1])
    return Scene((axes[0], axes[1], axes[2]), values, _smoothest(to_xyz), lamp, cmf)


def _smoothest(to_xyz: Floats) -> Floats:
    """`(n, 3)`: of all spectra with given XYZ, the one with the least second differences.

    min |D ρ|² with C ρ = XYZ, by its multipliers: (DᵀD, Cᵀ; C, 0) (ρ; μ) = (0; XYZ). Grey is flat.
    """
    n = to_xyz.shape[1]
    second = np.diff(np.eye(n), 2, axis=0)
    system = np.block([[second.T @ second, to_xyz.T], [to_xyz, np.zeros((3, 3))]])
    wanted = np.vstack([np.zeros((n, 3)), np.eye(3)])
    return np.asarray(np.linalg.solve(system, wanted)[:n])
