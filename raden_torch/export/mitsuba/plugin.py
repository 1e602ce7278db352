"""The BSDF `raden` of Mitsuba 3, written on Dr.Jit's arrays.

It reads the runtime table (formulas: `brdf/model/runtime_table.py`) as a 3-D texture, and samples
half vectors from `half_vectors.Lobes`, with a share of the cosine's directions beside them.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np

from raden_torch.errors import InputError
from raden_torch.export.forms import RuntimeForm
from raden_torch.export.mitsuba.half_vectors import lobes_of
from raden_torch.export.mitsuba.spectra import spectrum_of, tensor
from raden_torch.export.table_file import read_form
from raden_torch.packages import require

NAME = "raden"
COSINE_SHARE = 0.05
"""Of the samples that follow the cosine: what the lobes miss between their nodes is found, too."""

_PARALLEL = (4 * float(np.finfo(np.float32).eps)) ** 2
_LEAST = 1e-30


def register() -> Any:
    """Make `<bsdf type="raden">` known to Mitsuba in its current variant.

    Call it after `mitsuba.set_variant`, and again after another one.

    Returns:
        Mitsuba.

    Raises:
        InputError: Mitsuba is not installed, or no variant is set.

    Examples:
        >>> import mitsuba as mi
        >>> mi.set_variant("scalar_rgb")
        >>> register().variant()
        'scalar_rgb'
    """
    require("Mitsuba's plugins", "simulate")
    import mitsuba as mi

    if mi.variant() is None:
        raise InputError(
            "Mitsuba: expected a variant, got none: mitsuba.set_variant('llvm_ad_rgb') first"
        )
    mi.register_bsdf(NAME, _plugin_class(mi))
    return mi


def _plugin_class(mi: Any) -> Any:
    """The class for Mitsuba's current variant: its base and its types are this variant's."""
    import drjit as dr

    class RadenBsdf(mi.BSDF):  # type: ignore[misc]
        """Properties: `filename`, a table's .json file or a model file; `two_sided`, false."""

        def __init__(self, props: Any) -> None:
            mi.BSDF.__init__(self, props)
            self.name = str(props["filename"])
            self.two_sided = bool(props.get("two_sided", False))
            form = read_form(Path(str(mi.file_resolver().resolve(self.name))))
            flags = mi.BSDFFlags.GlossyReflection | mi.BSDFFlags.FrontSide
            if self.two_sided:
                flags = flags | mi.BSDFFlags.BackSide
            self.m_components = [flags]
            self.m_flags = flags
            self._take(form)

        def _take(self, form: RuntimeForm) -> None:
            self.warp, self.shape = form.warp, form.layout.shape
            self.table = tensor(mi, form.table.numpy())
            self.texture = mi.Texture3f(
                tensor(mi, form.table.numpy()),
                use_accel=False,
                filter_mode=dr.FilterMode.Linear,
                wrap_mode=dr.WrapMode.Clamp,
            )
            lobes = lobes_of(form)
            # opaque: shells that differ in numbers alone share a compiled kernel
            numbers = (lobes.b, math.log1p(1 / lobes.b))
            self.b, self.widening = (dr.opaque(mi.Float, x) for x in numbers)
            self.lobes = mi.Hierarchical2D1(lobes.density, [lobes.cosines.tolist()])
            self.to_spectrum = spectrum_of(mi)

        def sample(self, ctx: Any, si: Any, sample1: Any, sample2: Any, active: Any = True) -> Any:
            wi, side = self._upright(si.wi)
            active = active & (wi.z > 0) & ctx.is_enabled(mi.BSDFFlags.GlossyReflection)
            around = mi.warp.square_to_cosine_hemisphere(sample2)
            place, _ = self.lobes.sample(sample2, [wi.z], active)
            wo = dr.select(sample1 < COSINE_SHARE, around, self._light(wi, place))
            pdf = self._pdf(wi, wo)
            active = active & (wo.z > 0) & (pdf > 0)
            out = dr.zeros(mi.BSDFSample3f)
            out.wo, out.pdf = self._turned(wo, side), dr.select(active, pdf, 0)
            out.eta, out.sampled_component = 1.0, 0
            out.sampled_type = mi.UInt32(+mi.BSDFFlags.GlossyReflection)
            value = self._reflected(ctx, si, wi, wo, active)
            return out, dr.select(active, value / dr.select(active, pdf, 1), 0)

        def eval(self, ctx: Any, si: Any, wo: Any, active: Any = True) -> Any:
            return self.eval_pdf(ctx, si, wo, active)[0]

        def pdf(self, ctx: Any, si: Any, wo: Any, active: Any = True) -> Any:
            wi, side = self._upright(si.wi)
            wo = self._turned(wo, side)
            active = active & (wi.z > 0) & (wo.z > 0)
            active = active & ctx.is_enabled(mi.BSDFFlags.GlossyReflection)
            return dr.select(active, self._pdf(wi, wo), 0)

        def eval_pdf(self, ctx: Any, si: Any, wo: Any, active: Any = True) -> Any:
            wi, side = self._upright(si.wi)
            turned = self._turned(wo, side)
            active = active & (wi.z > 0) & (turned.z > 0)
            active = active & ctx.is_enabled(mi.BSDFFlags.GlossyReflection)
            value = self._reflected(ctx, si, wi, turned, active)
            return value, dr.select(active, self._pdf(wi, turned), 0)

        def traverse(self, callback: Any) -> None:
            callback.put("table", self.table, mi.ParamFlags.Differentiable)

        def parameters_changed(self, keys: Any = ()) -> None:
            self.texture.set_tensor(self.table)

        def to_string(self) -> str:
            return f"RadenBsdf[filename={self.name}, table={list(self.shape)}]"

        def _upright(self, wi: Any) -> tuple[Any, Any]:
            """The viewer on the side that is lit, and whether that is the front."""
            front = (wi.z >= 0) | (not self.two_sided)
            return self._turned(wi, front), front

        def _turned(self, w: Any, front: Any) -> Any:
            """Half a turn about x for the back, which is the shell and not its mirror image."""
            return dr.select(front, w, mi.Vector3f(w.x, -w.y, -w.z))

        def _reflected(self, ctx: Any, si: Any, wi: Any, wo: Any, active: Any) -> Any:
            """f_r cos θ as a value of this variant; paths from the lamp have `wi` towards it."""
            swap = ctx.mode == mi.TransportMode.Importance
            light, view = (wi, wo) if swap else (wo, wi)
            rgb = mi.Color3f(self.texture.eval(self._texel(light, view), active))
            return dr.select(active, self.to_spectrum(rgb * dr.maximum(wo.z, 0), si.wavelengths), 0)

        def _texel(self, light: Any, view: Any) -> Any:
            """Where the table is read: `runtime_table.address`, the normal being +z."""
            c, k = self.warp
            middle = light.z + view.z
            d = view - light
            square = dr.squared_norm(d)
            apart = square > _PARALLEL
            delta = dr.sqrt(dr.select(apart, square, 1))
            sine = dr.norm(mi.Vector2f(light.x, light.y))
            y = dr.select(apart, d.z - 0.25 * middle * dr.dot(d, light + view), sine)
            z = dr.select(apart, light.x * d.y - light.y * d.x, 0)
            u = dr.select(apart, delta / (2 + dr.sqrt(dr.maximum(4 - square, 1e-12))), 0)
            least = dr.maximum(dr.minimum(light.z, view.z), 0)
            v = y / dr.maximum(dr.abs(y) + c * delta * least, _LEAST)
            w = z / dr.maximum(dr.abs(z) + 0.5 * k * delta * dr.maximum(middle, 0), _LEAST)
            nodes = zip((0.5 * w + 0.5, 0.5 * v + 0.5, u), reversed(self.shape), strict=True)
            return mi.Point3f(*((at * (n - 1) + 0.5) / n for at, n in nodes))

        def _light(self, wi: Any, place: Any) -> Any:
            """The direction to the light of a point of the unit square."""
            s = self.b * (dr.exp(place.x * self.widening) - 1)
            s = dr.clip(s, 0, 1)
            sine = dr.sqrt(s * (2 - s))
            turn_sine, turn_cosine = dr.sincos(2 * dr.pi * (place.y - 0.5))
            x, y = sine * turn_cosine, sine * turn_sine
            along = self._heading(wi)
            m = mi.Vector3f(x * along.x - y * along.y, x * along.y + y * along.x, 1 - s)
            return dr.normalize(2 * dr.dot(wi, m) * m - wi)

        def _pdf(self, wi: Any, wo: Any) -> Any:
            """The density of `wo`, both above the horizon, per steradian."""
            m = dr.normalize(wi + wo)
            s = (m.x * m.x + m.y * m.y) / (1 + dr.maximum(m.z, 0))
            along = self._heading(wi)
            turn = dr.atan2(m.y * along.x - m.x * along.y, m.x * along.x + m.y * along.y)
            x = dr.log(1 + s / self.b) / self.widening
            p = self.lobes.eval(mi.Point2f(x, turn / (2 * dr.pi) + 0.5), [wi.z])
            by_m = 2 * dr.pi * self.widening * (s + self.b)
            lobe = p / dr.maximum(by_m * 4 * dr.dot(wi, m), _LEAST)
            return (1 - COSINE_SHARE) * lobe + COSINE_SHARE / dr.pi * dr.maximum(wo.z, 0)

        def _heading(self, w: Any) -> Any:
            """The unit vector of a direction's azimuth; x where it has none."""
            length = dr.sqrt(w.x * w.x + w.y * w.y)
            has = length > 1e-6
            by = dr.select(has, length, 1)
            return mi.Vector2f(dr.select(has, w.x / by, 1), dr.select(has, w.y / by, 0))

    return RadenBsdf
