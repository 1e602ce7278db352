"""Specimens: BSDFs of Mitsuba's own by name, simulated shells, and measurement files."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from raden_torch.arrays import Floats
from raden_torch.capture.photo.simulation.colours import white_xyz
from raden_torch.capture.photo.simulation.mitsuba_table import Table, table_bsdf, table_of
from raden_torch.capture.photo.simulation.simulated_angles import directions
from raden_torch.errors import InputError
from raden_torch.measurement import BrdfMeasurement, Metadata, native_csv
from raden_torch.measurement.readings import FACTOR_PER_SR
from raden_torch.optics.specimens import SPECIMENS, simulate_specimen

PLUGINS: dict[str, dict[str, Any]] = {
    "rough-plastic": {
        "type": "roughplastic",
        "distribution": "ggx",
        "alpha": 0.25,
        "diffuse_reflectance": {"type": "rgb", "value": [0.42, 0.33, 0.16]},
    },
    "rough-conductor": {
        "type": "roughconductor",
        "distribution": "ggx",
        "alpha": 0.35,
        "eta": {"type": "rgb", "value": [0.45, 0.70, 1.30]},
        "k": {"type": "rgb", "value": [3.4, 2.7, 2.3]},
    },
    "clear-coat": {
        "type": "principled",
        "base_color": {"type": "rgb", "value": [0.16, 0.28, 0.45]},
        "roughness": 0.45,
        "metallic": 0.2,
        "specular": 0.5,
        "clearcoat": 1.0,
        "clearcoat_gloss": 0.0,
    },
    "white": {"type": "diffuse", "reflectance": {"type": "rgb", "value": 1.0}},
}
"""By name; colours in the simulation's channels. "white" is the perfect reflecting diffuser."""

_SHELL_STEP_DEG = 2.5
_RADEN_GRID_DEG = (np.arange(0, 71, 5.0), np.arange(-70, 71, 5.0), np.arange(-70, 71, 5.0))


@dataclass(frozen=True, eq=False)
class Material:
    """What a specimen is made of.

    Attributes:
        name: as the user gave it.
        plugin: of Mitsuba's own, or None where a table is the material.
        table: f_r on a grid, or None.
        source: in words.
    """

    name: str
    plugin: dict[str, Any] | None
    table: Table | None
    source: str

    def bsdf(self, mi: Any) -> Any:
        """The BSDF in Mitsuba's current variant."""
        if self.table is not None:
            return table_bsdf(mi, self.table)
        return mi.load_dict(self.plugin)


def material_of(name: str) -> Material:
    """A material by name, or the measurement of a file.

    Raises:
        InputError: neither, or a measurement that fills no regular grid.
    """
    if name in PLUGINS:
        return Material(name, PLUGINS[name], None, f"Mitsuba's {PLUGINS[name]['type']}")
    if name in tuple(SPECIMENS):
        source = (
            f"simulated shell {name}, trilinear between nodes {_SHELL_STEP_DEG:g} degrees apart"
        )
        return Material(name, None, _shell(name), source)
    if not name.lower().endswith((".csv", ".csv.gz")):
        known = ", ".join([*PLUGINS, *SPECIMENS])
        raise InputError(f"material: expected {known}, or a measurement (.csv), got {name!r}")
    measured = native_csv.read(name)
    source = f"{Path(name).name}, trilinear between its nodes"
    return Material(Path(name).stem, None, table_of(measured, name), source)


@cache
def _shell(name: str) -> Table:
    return table_of(simulate_specimen(name, step_deg=_SHELL_STEP_DEG), name)


def truth_of(mi: Any, material: Material) -> BrdfMeasurement:
    """The material's reflectance factors (X, Y, Z) on the raden grid, by `bsdf.eval` alone."""
    a, r, t = (axis.ravel() for axis in np.meshgrid(*_RADEN_GRID_DEG, indexing="ij"))
    f_r = evaluated(mi, material.bsdf(mi), *directions(*np.radians([a, r, t])))
    meta = Metadata(
        sample=material.name,
        instrument="Mitsuba 3, bsdf.eval",
        simulated=True,
        notes=(f"the truth of simulated photographs: {material.source}",),
    )
    return BrdfMeasurement(a, r, t, FACTOR_PER_SR * f_r * white_xyz(), metadata=meta)


def evaluated(mi: Any, bsdf: Any, light: Floats, view: Floats) -> Floats:
    """`[M, 3]` f_r = bsdf.eval / cos θi of unit directions `[M, 3]`, the normal being +z."""
    context = mi.BSDFContext()
    cosine = light[:, 2:]
    if not mi.variant().startswith("scalar"):
        point = mi.SurfaceInteraction3f()
        point.wi = mi.Vector3f(*np.asarray(view.T, np.float32))
        value = bsdf.eval(context, point, mi.Vector3f(*np.asarray(light.T, np.float32)))
        return np.asarray(value).T.reshape(-1, 3) / cosine
    out = np.empty((len(light), 3))
    point = mi.SurfaceInteraction3f()
    for row, (to_light, to_view) in enumerate(zip(light.tolist(), view.tolist(), strict=True)):
        point.wi = mi.Vector3f(to_view)
        out[row] = bsdf.eval(context, point, mi.Vector3f(to_light))
    return out / cosine
