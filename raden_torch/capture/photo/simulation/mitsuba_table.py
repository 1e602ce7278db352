"""A measurement on a regular grid as a truth: f_r between its nodes, and as a BSDF of Mitsuba's."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from raden_torch.arrays import Floats
from raden_torch.capture.photo.simulation.colours import white_xyz
from raden_torch.capture.photo.simulation.simulated_angles import angles
from raden_torch.errors import InputError
from raden_torch.measurement import BrdfMeasurement
from raden_torch.measurement.readings import FACTOR_PER_SR


@dataclass(frozen=True, eq=False)
class Table:
    """f_r on a regular grid, trilinear between its nodes, constant beyond its edges.

    Attributes:
        first, step: `[3]` of incidence, receiving and tilt, radians.
        values: `[A, R, T, 3]` f_r in 1/sr, in the simulation's channels (X, Y, Z over white's).
    """

    first: Floats
    step: Floats
    values: NDArray[np.float32]

    def at(self, light: Floats, view: Floats) -> Floats:
        """`[M, 3]` f_r of unit directions `[M, 3]`, the normal being +z; 0 below the horizon."""
        from scipy.ndimage import map_coordinates

        place = (np.stack(angles(light, view)) - self.first[:, None]) / self.step[:, None]
        found = [map_coordinates(self.values[..., c], place, order=1, mode="nearest")
                 for c in range(3)]  # fmt: skip
        up = (light[:, 2] > 0) & (view[:, 2] > 0)
        return np.where(up[:, None], np.stack(found, -1), 0.0)


def table_of(measurement: BrdfMeasurement, name: str) -> Table:
    """The table of a measurement that fills a regular grid.

    Cells without a value take the nearest one's.

    Raises:
        InputError: readings that are no regular grid, no colours, or no value at all.
    """
    grid = measurement.as_xyz().grid()
    axes = grid.axes_deg
    steps = [np.diff(axis) for axis in axes]
    if any(len(s) == 0 or np.ptp(s) > 1e-4 for s in steps):
        raise InputError(
            f"{name}: expected a regular grid (evenly spaced incidence, receiving and tilt, two "
            "or more of each), got readings off such a grid"
        )
    if not grid.measured.any():
        raise InputError(f"{name}: expected a measurement, got no reading with a value")
    f_r = grid.values / (FACTOR_PER_SR * white_xyz())
    step = np.array([s.mean() for s in steps])
    first = np.array([axis[0] for axis in axes])
    return Table(np.radians(first), np.radians(step), _filled(f_r).astype(np.float32))


def table_bsdf(mi: Any, table: Table) -> Any:
    """A BSDF of Mitsuba's current variant that evaluates a table.

    Written with Mitsuba's own vectors and texture, apart from `Table.at`.
    """
    import drjit as dr

    class TableBsdf(mi.BSDF):  # type: ignore[misc]
        def __init__(self, props: Any) -> None:
            mi.BSDF.__init__(self, props)
            self.m_components = [mi.BSDFFlags.GlossyReflection | mi.BSDFFlags.FrontSide]
            self.m_flags = self.m_components[0]
            self.texture = mi.Texture3f(
                _tensor(mi, table.values),
                use_accel=False,
                filter_mode=dr.FilterMode.Linear,
                wrap_mode=dr.WrapMode.Clamp,
            )

        def sample(self, ctx: Any, si: Any, sample1: Any, sample2: Any, active: Any = True) -> Any:
            out = mi.BSDFSample3f()
            out.wo = mi.warp.square_to_cosine_hemisphere(sample2)
            out.pdf = mi.warp.square_to_cosine_hemisphere_pdf(out.wo)
            out.eta, out.sampled_component = 1.0, 0
            out.sampled_type = +mi.BSDFFlags.GlossyReflection
            weight = self.eval(ctx, si, out.wo, active) / dr.maximum(out.pdf, 1e-8)
            return out, dr.select(out.pdf > 0, weight, 0)

        def eval(self, ctx: Any, si: Any, wo: Any, active: Any = True) -> Any:
            up = (wo.z > 0) & (si.wi.z > 0) & active
            n, step = table.values.shape[:3], table.step
            found = [
                (angle - first) / each + 0.5
                for angle, first, each in zip(
                    self.angles(wo, si.wi), table.first, step, strict=True
                )
            ]
            a, r, t = (f / size for f, size in zip(found, n, strict=True))
            f_r = mi.Color3f(self.texture.eval(mi.Point3f(t, r, a)))
            return dr.select(up, f_r * wo.z, 0)

        def angles(self, light: Any, view: Any) -> tuple[Any, Any, Any]:
            axis = dr.cross(light, view)
            length = dr.norm(axis)
            one = length < 1e-6
            p = axis / dr.select(one, 1, length)
            in_plane = mi.Vector3f(0, 0, 1) - p.z * p
            a = dr.atan2(dr.dot(p, dr.cross(light, in_plane)), dr.dot(light, in_plane))
            r = dr.atan2(dr.dot(p, dr.cross(in_plane, view)), dr.dot(view, in_plane))
            t = dr.atan2(p.z, dr.norm(in_plane))
            side = dr.select(a < 0, -1, 1)
            theta = dr.atan2(dr.norm(mi.Vector2f(light.x, light.y)), light.z)
            return (
                dr.select(one, theta, side * a),
                dr.select(one, -theta, side * r),
                dr.select(one, 0, side * t),
            )

        def pdf(self, ctx: Any, si: Any, wo: Any, active: Any = True) -> Any:
            return dr.select(active & (wo.z > 0), wo.z / dr.pi, 0)

        def eval_pdf(self, ctx: Any, si: Any, wo: Any, active: Any = True) -> Any:
            return self.eval(ctx, si, wo, active), self.pdf(ctx, si, wo, active)

        def to_string(self) -> str:
            return f"TableBsdf[{table.values.shape}]"

    mi.register_bsdf("raden_table", TableBsdf)
    return mi.load_dict({"type": "raden_table"})


def _tensor(mi: Any, values: NDArray[np.float32]) -> Any:
    from drjit import scalar

    kind = scalar.TensorXf if mi.variant().startswith("scalar") else mi.TensorXf
    return kind(np.ascontiguousarray(values))


def _filled(values: Floats) -> Floats:
    from scipy.ndimage import distance_transform_edt

    empty = np.isnan(values).any(axis=-1)
    if not empty.any():
        return values
    nearest = distance_transform_edt(empty, return_distances=False, return_indices=True)
    return np.asarray(values[tuple(nearest)])
