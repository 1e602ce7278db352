"""A model as a MaterialX document: the nearest `open_pbr_surface`, with a thin film and a coat."""

from __future__ import annotations

import os
from dataclasses import asdict, dataclass
from xml.etree import ElementTree

import numpy as np

from raden_torch import __version__
from raden_torch.arrays import Floats
from raden_torch.brdf.model.model import Provenance, RadenBrdf
from raden_torch.export.forms import RuntimeForm, runtime_form
from raden_torch.export.lit_sphere import SphereDifference, sphere_difference
from raden_torch.export.material_fit import Nearest, Parameters, matt_colour, nearest
from raden_torch.export.openpbr_brdf import OpenPbrMaterial
from raden_torch.export.whole_reflection import highlight_roughness
from raden_torch.files import check_output, written_beside

_THICKNESSES = (0.15, 0.3, 0.45, 0.6, 0.8, 1.0)
# at an index of 1 MaterialX's layers still dim what is below, against Fresnel's equations
_LOW = np.array([0, 0, 0, 0, 0.05, 1.2, 0, 0.05, 1.2, 0, 0.05, 1.2])
_HIGH = np.array([1, 1, 1, 1, 1.0, 3.0, 1, 1.5, 3.0, 1, 1.0, 3.0])
_STEP = np.array([0.3] * 7 + [0.1] + [0.3] * 4)


@dataclass(frozen=True)
class MaterialXReport:
    """What was written, and how far it is from the model.

    Attributes:
        fit: the inputs, and the error of f_r.
        sphere: how unlike both look.
    """

    fit: Nearest[OpenPbrMaterial]
    sphere: SphereDifference

    def __str__(self) -> str:
        return f"the nearest OpenPBR: {self.errors}; {self._film}"

    @property
    def errors(self) -> str:
        """In words."""
        return (
            f"off by {self.fit.error:.0%} of the reflection (RMS over the hemisphere), on a lit "
            f"sphere by ΔE2000 {self.sphere.median:.1f} (median), {self.sphere.most:.1f} (95 %)"
        )

    @property
    def _film(self) -> str:
        m = self.fit.material
        return (
            f"film of {m.thin_film_thickness * 1000:.0f} nm, index {m.thin_film_ior:.2f}, weight "
            f"{m.thin_film_weight:.2f}; coat of index {m.coat_ior:.2f}, weight {m.coat_weight:.2f}"
        )


def export_materialx(model: RadenBrdf, path: str | os.PathLike[str]) -> MaterialXReport:
    """Write a .mtlx file with one material, the nearest that a thin film and a coat can say.

    One film cannot be a shell, whose films are many and uneven: the report, and the file, say how
    far it is off.

    Args:
        model: on the CPU.
        path: ends in .mtlx.

    Raises:
        InputError: another suffix, the file cannot be written, or colour-science is not installed.

    Examples:
        >>> import raden_torch as rt
        >>> from raden_torch.export.materialx_file import export_materialx
        >>> model = rt.fit(rt.simulate_specimen("akoya", step_deg=35)).model
        >>> report = export_materialx(model, "shell.mtlx")
        >>> 0 < report.fit.error < 1
        True
    """
    form = runtime_form(model)
    target = check_output(path, (".mtlx",))
    fit = nearest_openpbr(form)
    report = MaterialXReport(fit, sphere_difference(form, fit.material))
    document = materialx_document(report, model.provenance)
    with written_beside(target) as temporary:
        temporary.write_text(document, "utf-8")
    return report


def nearest_openpbr(form: RuntimeForm) -> Nearest[OpenPbrMaterial]:
    """The inputs whose f_r cos θi is nearest: its square roots in the least-squares sense, so that
    the highlight does not decide alone (docs/renderers.md)."""
    roughness = min(max(np.sqrt(highlight_roughness(form)), 0.05), 1.0)
    colour = matt_colour(form)
    starts = [
        np.array([*colour, metalness, roughness, 2.0, 0.7, thickness, 1.5, 0.1, roughness, 1.5])
        for thickness in _THICKNESSES
        for metalness in (0.1, 0.5)
    ]
    return nearest(form, Parameters(_LOW, _HIGH, _STEP, _material, rooted=True), starts)


def _material(x: Floats) -> OpenPbrMaterial:
    red, green, blue, *rest = map(float, x)
    return OpenPbrMaterial((red, green, blue), *rest)


def materialx_document(report: MaterialXReport, source: Provenance) -> str:
    """The document as XML: attributes of ours are declared, as MaterialX's specification asks."""
    name = (source.sample or "unnamed sample") + (" (simulated)" if source.simulated else "")
    about = {
        "approximates": ("string", name),
        "simulated": ("boolean", str(source.simulated).lower()),
        "measurement_sha256": ("string", source.measurement_sha256),
        "rms_error_over_rms": ("float", f"{report.fit.error:.4f}"),
        "delta_e2000_median": ("float", f"{report.sphere.median:.3f}"),
        "delta_e2000_95_percent": ("float", f"{report.sphere.most:.3f}"),
    }
    doc = f"{name}: an approximation by raden_torch {__version__}, {report.errors}"
    root = ElementTree.Element("materialx", version="1.39", colorspace="lin_rec709", doc=doc)
    for key, (kind, _) in about.items():
        what = {"name": f"AD_raden_{key}", "type": kind, "attrname": f"raden_{key}"}
        ElementTree.SubElement(root, "attributedef", what, elements="surfacematerial")
    shader = {"name": "raden_surface", "type": "surfaceshader"}
    surface = ElementTree.SubElement(root, "open_pbr_surface", shader)
    inputs = asdict(report.fit.material) | {"coat_darkening": 0.0}
    for key, value in inputs.items():
        colour = isinstance(value, tuple)
        text = ", ".join(f"{c:.5f}" for c in value) if colour else f"{value:.5f}"
        what = {"name": key, "type": "color3" if colour else "float", "value": text}
        ElementTree.SubElement(surface, "input", what)
    what = {"name": "raden_shell", "type": "material", "doc": doc}
    what |= {f"raden_{key}": value for key, (_, value) in about.items()}
    material = ElementTree.SubElement(root, "surfacematerial", what)
    link = shader | {"name": "surfaceshader", "nodename": "raden_surface"}
    ElementTree.SubElement(material, "input", link)
    ElementTree.indent(root)
    return '<?xml version="1.0"?>\n' + ElementTree.tostring(root, "unicode") + "\n"
