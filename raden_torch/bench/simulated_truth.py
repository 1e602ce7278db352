"""What a fit is held against: the simulated shell off the grid, and a sphere of it."""

from __future__ import annotations

import numpy as np
import torch
from numpy.typing import NDArray

from raden_torch import geometry
from raden_torch.brdf.model.model import RadenBrdf
from raden_torch.brdf.shading.gbuffer import GBuffer
from raden_torch.brdf.shading.lights import DirectionalLight
from raden_torch.brdf.shading.shade import shade
from raden_torch.brdf.shading.sphere_gbuffer import sphere
from raden_torch.measurement import BrdfMeasurement
from raden_torch.measurement.colour_conversion import xyz_to_rgb_matrix
from raden_torch.measurement.readings import FACTOR_PER_SR
from raden_torch.optics import simulate_specimen
from raden_torch.packages import require

SPECIMEN = "yakogai"

_OFF_GRID = 4000
_LIGHT = (1.0, 1.0, 2.0)


def simulated_pair() -> tuple[BrdfMeasurement, BrdfMeasurement]:
    """The built-in shell on its grid, and off it."""
    u = np.random.default_rng(0).random((_OFF_GRID, 3))
    geometries = u * [70.0, 140.0, 140.0] - [0.0, 70.0, 70.0]
    return simulate_specimen(SPECIMEN), simulate_specimen(SPECIMEN, geometries_deg=geometries)


def sphere_delta_e(model: RadenBrdf, size: int = 96) -> float:
    """Mean ΔE2000 of a lit sphere against the simulation itself, evaluated at each pixel.

    Both are exposed so that the simulated sphere's 99.5 % quantile is white.
    """
    require("colour differences", "spectral")
    import colour

    gbuffer = sphere(size, samples=1)
    light = DirectionalLight(_LIGHT)
    with torch.no_grad():
        image = shade(model, gbuffer, light)
    truth, seen = _simulated_sphere(gbuffer)
    got = image[0].movedim(0, -1).reshape(-1, 3).numpy()[seen]
    white = np.quantile(truth @ np.linalg.inv(xyz_to_rgb_matrix())[1], 0.995)
    to_lab = [
        colour.XYZ_to_Lab(np.maximum(rgb @ np.linalg.inv(xyz_to_rgb_matrix()).T / white, 0))
        for rgb in (got, truth)
    ]
    return float(np.mean(colour.delta_E(*to_lab, method="CIE 2000")))


def _simulated_sphere(gbuffer: GBuffer) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """`[P, 3]` radiance of the pixels inside the measured box, and which pixels these are."""
    normal = gbuffer.normal
    light = torch.tensor(_LIGHT).view(1, 3, 1, 1).expand_as(normal)
    view = gbuffer.view_map(normal)
    angles = torch.cat(geometry.raden_angles(normal.double(), light.double(), view.double()), 1)
    degrees = torch.rad2deg(angles)[0].reshape(3, -1).T.numpy()
    cosine = geometry.dot(normal, torch.nn.functional.normalize(light, dim=1)).flatten().numpy()
    on = (gbuffer.mask > 0).flatten().numpy() if gbuffer.mask is not None else cosine > 0
    seen = on & (cosine > 0) & (degrees[:, 0] <= 70) & (abs(degrees[:, 1:]) <= 70).all(axis=1)
    rgb = simulate_specimen(SPECIMEN, geometries_deg=degrees[seen]).as_rgb().values
    return rgb / FACTOR_PER_SR * np.pi * cosine[seen, None], seen
