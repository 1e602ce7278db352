"""A model as a shader in Open Shading Language: the nearest sum of closures.

Source: Open Shading Language, Language Specification (closures `diffuse` and `microfacet`, the
latter with α along two axes). In Cycles `microfacet` has no Fresnel term where its index is 0.
"""

from __future__ import annotations

import math
import os
from dataclasses import dataclass

from raden_torch import __version__
from raden_torch.brdf.model.model import Provenance, RadenBrdf
from raden_torch.export.closure_fit import LAST_DEG, VIEWS, ClosureFit, Lobe, fit_closures
from raden_torch.export.forms import runtime_form
from raden_torch.files import check_output, written_beside

_SHADER = """\
// {title}
// Written by raden_torch {version}: an approximation. A closure is not told where the light is, so
// this is the nearest sum of {count} closures whose weights follow the viewing angle:
// off by {error:.0%} of the reflection (RMS over the hemisphere). {source}
// Linear RGB, sRGB primaries; colours that these cannot show are cut at 0.

shader raden_shell(
    color Tint = 1,
    normal Normal = N,
    output closure color BSDF = 0)
{{
    // {views} viewing angles from 0 to {last:g} degrees, {count} closures each
    float weights[{size}] = {{
{weights}
    }};
    vector view = dot(I, Normal) < 0 ? -I : I;
    // x towards the viewer along the surface
    float cosine = dot(view, Normal);
    vector x = view - cosine * Normal;
    float place = min(atan2(length(x), cosine) / {last_radians:.9g}, 1) * {spans};
    int first = min((int)place, {spans} - 1);
    float share = place - first;

    vector other = fabs(Normal[0]) < 0.7 ? vector(1, 0, 0) : vector(0, 1, 0);
    x = normalize(dot(x, x) > 1e-8 ? x : cross(other, Normal));
    vector y = cross(Normal, x);

    color w[{count}];
    for (int k = 0; k < {count}; ++k) {{
        int at = (first * {count} + k) * 3;
        color near = color(weights[at], weights[at + 1], weights[at + 2]);
        at += {count} * 3;
        color far = color(weights[at], weights[at + 1], weights[at + 2]);
        w[k] = Tint * mix(near, far, share);
    }}
    BSDF = {closures};
}}
"""


@dataclass(frozen=True)
class OslReport:
    """What was written: `fit`, and how far it is from the model."""

    fit: ClosureFit

    def __str__(self) -> str:
        return (
            f"the nearest sum of {len(self.fit.lobes)} closures: off by {self.fit.error:.0%} of "
            "the reflection (RMS over the hemisphere)"
        )


def export_osl(model: RadenBrdf, path: str | os.PathLike[str]) -> OslReport:
    """Write a shader for renderers that run OSL, as Blender's Cycles does.

    Args:
        model: on the CPU.
        path: ends in .osl.

    Raises:
        InputError: another suffix, or the file cannot be written.

    Examples:
        >>> import raden_torch as rt
        >>> from raden_torch.export.osl_file import export_osl
        >>> model = rt.fit(rt.simulate_specimen("akoya", step_deg=35)).model
        >>> report = export_osl(model, "shell.osl")
        >>> 0 < report.fit.error < 0.5
        True
    """
    form = runtime_form(model)
    target = check_output(path, (".osl",))
    fit = fit_closures(form)
    with written_beside(target) as temporary:
        temporary.write_text(shader_text(fit, model.provenance), "utf-8")
    return OslReport(fit)


def shader_text(fit: ClosureFit, source: Provenance) -> str:
    """The shader's text."""
    rows = [
        "        " + ", ".join(f"{x:.4g}" for x in row) for row in fit.weights.reshape(VIEWS, -1)
    ]
    name = source.sample or "unnamed sample"
    return _SHADER.format(
        title=f"{name}{' (simulated)' if source.simulated else ''}",
        version=__version__,
        count=len(fit.lobes),
        error=fit.error,
        source=f"Measurement {source.measurement_sha256[:12] or 'unknown'}.",
        views=VIEWS,
        last=LAST_DEG,
        last_radians=math.radians(LAST_DEG),
        spans=VIEWS - 1,
        size=fit.weights.size,
        weights=",\n".join(rows),
        closures="\n        + ".join(_closure(k, lobe) for k, lobe in enumerate(fit.lobes)),
    )


def _closure(number: int, lobe: Lobe) -> str:
    if lobe.alpha == 0:
        return f"w[{number}] * diffuse(Normal)"
    x, y, z = lobe.normal
    normal = "Normal"
    if lobe.lean_deg:
        normal = f"normalize({x:.6f} * x + {y:.6f} * y + {z:.6f} * Normal)"
    a = f"{lobe.alpha:g}"
    return f'w[{number}] * microfacet("ggx", {normal}, vector(0), {a}, {a}, 0, 0)'
