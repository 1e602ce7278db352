"""What a fit is held against: readings that it has not seen, and a simulated sphere."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
import torch
from numpy.typing import NDArray

from raden_torch import geometry
from raden_torch.arrays import Floats
from raden_torch.bench.forms import Shader
from raden_torch.brdf.shading.sphere_gbuffer import sphere
from raden_torch.measurement import BrdfMeasurement
from raden_torch.measurement.colour_conversion import xyz_to_rgb_matrix
from raden_torch.measurement.readings import FACTOR_PER_SR
from raden_torch.optics import simulate_specimen
from raden_torch.packages import require

SPECIMEN = "yakogai"

_READINGS = 4000  # inside the box, and outside it
_BOX_DEG = 70.0
_FARTHEST_DEG = 80.0  # of light and viewer from the normal
_LIGHT = (1.0, 1.0, 2.0)


def simulated_pair(specimen: str = SPECIMEN) -> tuple[BrdfMeasurement, BrdfMeasurement]:
    """A built-in shell on its grid, and off it: 4000 readings evenly in the angles of the measured
    box, then 4000 outside it, where light and viewer are even over the directions to 80 degrees
    from the normal."""
    random = np.random.default_rng(0)
    inside = random.random((_READINGS, 3)) * [70.0, 140.0, 140.0] - [0.0, 70.0, 70.0]
    angles = _even_directions_deg(random, 6 * _READINGS)
    beyond = angles[(abs(angles) > _BOX_DEG).any(axis=1)][:_READINGS]
    readings = simulate_specimen(specimen, geometries_deg=np.concatenate([inside, beyond]))
    return simulate_specimen(specimen), readings


def _even_directions_deg(random: np.random.Generator, count: int) -> Floats:
    """`[count, 3]` incidence, receiving, tilt of lights and viewers even over directions."""
    cosine = 1 - random.random((count, 2)) * (1 - np.cos(np.radians(_FARTHEST_DEG)))
    sine, turn = np.sqrt(1 - cosine**2), 2 * np.pi * random.random((count, 2))
    xyz = torch.from_numpy(np.stack([sine * np.cos(turn), sine * np.sin(turn), cosine]))
    up = torch.tensor([0.0, 0.0, 1.0], dtype=torch.float64).view(3, 1, 1)
    light, view = (xyz[:, :, i, None] for i in range(2))
    angles = torch.cat(geometry.raden_angles(up, light, view))
    return np.asarray(torch.rad2deg(angles)[:, :, 0].T.numpy())


def sphere_delta_e(shader: Shader, size: int = 96) -> float:
    """Mean ΔE2000 of a lit sphere against the simulation itself, evaluated at each pixel.

    Both are exposed so that the simulated sphere's 99.5 % quantile is white.
    """
    require("colour differences", "spectral")
    import colour

    gbuffer = sphere(size, samples=1)
    normal = torch.nn.functional.normalize(gbuffer.normal, dim=1)
    light = torch.nn.functional.normalize(torch.tensor(_LIGHT).view(1, 3, 1, 1), dim=1)
    view = torch.nn.functional.normalize(gbuffer.view_map(normal), dim=1)
    f = shader(normal, light.expand_as(normal), view.expand_as(normal))
    image = np.pi * f * geometry.dot(normal, light).clamp(min=0)
    truth, seen = _simulated_sphere(size)
    got = image[0].movedim(0, -1).reshape(-1, 3).numpy()[seen]
    white = np.quantile(truth @ np.linalg.inv(xyz_to_rgb_matrix())[1], 0.995)
    to_lab = [
        colour.XYZ_to_Lab(np.maximum(rgb @ np.linalg.inv(xyz_to_rgb_matrix()).T / white, 0))
        for rgb in (got, truth)
    ]
    return float(np.mean(colour.delta_E(*to_lab, method="CIE 2000")))


@lru_cache(maxsize=1)
def _simulated_sphere(size: int) -> tuple[Floats, NDArray[np.bool_]]:
    """`[P, 3]` radiance of the pixels inside the measured box, and which pixels these are."""
    gbuffer = sphere(size, samples=1)
    normal = gbuffer.normal
    light = torch.tensor(_LIGHT).view(1, 3, 1, 1).expand_as(normal)
    view = gbuffer.view_map(normal)
    angles = torch.cat(geometry.raden_angles(normal.double(), light.double(), view.double()), 1)
    degrees = torch.rad2deg(angles)[0].reshape(3, -1).T.numpy()
    cosine = geometry.dot(normal, torch.nn.functional.normalize(light, dim=1)).flatten().numpy()
    on = (gbuffer.mask > 0).flatten().numpy() if gbuffer.mask is not None else cosine > 0
    seen = on & (cosine > 0) & (abs(degrees) <= _BOX_DEG).all(axis=1)
    rgb = simulate_specimen(SPECIMEN, geometries_deg=degrees[seen]).as_rgb().values
    return rgb / FACTOR_PER_SR * np.pi * cosine[seen, None], seen
