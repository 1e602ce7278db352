"""A model as the nearest glTF 2.0 material with KHR_materials_iridescence, on a sphere."""

from __future__ import annotations

import base64
import json
import os
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from raden_torch import __version__
from raden_torch.arrays import Floats
from raden_torch.brdf.model.model import Provenance, RadenBrdf
from raden_torch.export.forms import RuntimeForm, runtime_form
from raden_torch.export.gltf_brdf import GltfMaterial
from raden_torch.export.material_fit import Parameters, matt_colour, nearest
from raden_torch.export.whole_reflection import highlight_roughness
from raden_torch.files import check_output, written_beside

_THICKNESSES_NM = (150.0, 300.0, 450.0, 600.0, 800.0, 1000.0)
_LOW = np.array([0, 0, 0, 0, 0.05, 1.0, 0, 1.0, 50.0])
_HIGH = np.array([1, 1, 1, 1, 1.0, 3.0, 1, 3.0, 1500.0])
_SLICES, _STACKS = 48, 24


@dataclass(frozen=True)
class GltfReport:
    """What was written, and how far it is from the model.

    Attributes:
        material: the factors.
        error: RMS of the difference of f_r cos θi over the RMS of the model's, for pairs of
            directions spread evenly by projected solid angle.
        highlight_error: the same where the half vector is within some 20° of the normal.
    """

    material: GltfMaterial
    error: float
    highlight_error: float

    def __str__(self) -> str:
        m = self.material
        return (
            f"the nearest KHR_materials_iridescence: off by {self.error:.0%} of the reflection "
            f"(RMS over the hemisphere), {self.highlight_error:.0%} in the highlight; film of "
            f"{m.thickness_nm:.0f} nm, index {m.film_ior:.2f}, roughness {m.roughness:.2f}"
        )


def export_gltf(model: RadenBrdf, path: str | os.PathLike[str]) -> GltfReport:
    """Write a .gltf file with a sphere of the nearest material that the format has.

    One film over a base cannot be a shell, whose films are many and uneven: the report, and
    `extras` in the file, say how far it is off. Nothing is added to the format.

    Args:
        model: on the CPU.
        path: ends in .gltf.

    Raises:
        InputError: another suffix, or the file cannot be written.

    Examples:
        >>> import raden_torch as rt
        >>> from raden_torch.export.gltf_file import export_gltf
        >>> model = rt.fit(rt.simulate_specimen("akoya", step_deg=35)).model
        >>> report = export_gltf(model, "shell.gltf")
        >>> 0 < report.error < 1
        True
    """
    form = runtime_form(model)
    target = check_output(path, (".gltf",))
    report = nearest_material(form)
    text = json.dumps(_document(report, model.provenance), indent=1)
    with written_beside(target) as temporary:
        temporary.write_text(text + "\n", "utf-8")
    return report


def nearest_material(form: RuntimeForm) -> GltfReport:
    """The material whose f_r cos θi is nearest in the least-squares sense."""
    roughness = min(max(np.sqrt(highlight_roughness(form)), _LOW[4]), 1.0)
    colour = matt_colour(form)
    starts = [
        np.array([*colour, 0.3, roughness, 1.5, 0.7, 1.5, thickness])
        for thickness in _THICKNESSES_NM
    ]
    steps = np.where(_HIGH > 100, 100.0, 0.3)
    found = nearest(form, Parameters(_LOW, _HIGH, steps, _material), starts)
    return GltfReport(found.material, found.error, found.highlight_error)


def _material(x: Floats) -> GltfMaterial:
    red, green, blue, metallic, roughness, ior, iridescence, film_ior, thickness = map(float, x)
    colour = (red, green, blue)
    return GltfMaterial(colour, metallic, roughness, ior, iridescence, film_ior, thickness)


def _document(report: GltfReport, source: Provenance) -> dict[str, Any]:
    m, name = report.material, source.sample or "unnamed sample"
    normals, corners = _sphere()
    data = normals.astype("<f4").tobytes() + corners.astype("<u2").tobytes()
    extensions = {
        "KHR_materials_ior": {"ior": round(m.ior, 5)},
        "KHR_materials_iridescence": {
            "iridescenceFactor": round(m.iridescence, 5),
            "iridescenceIor": round(m.film_ior, 5),
            "iridescenceThicknessMinimum": round(m.thickness_nm, 3),
            "iridescenceThicknessMaximum": round(m.thickness_nm, 3),
        },
    }
    about = {
        "approximates": name,
        "simulated": source.simulated,
        "measurement_sha256": source.measurement_sha256,
        "rms_error_over_rms": round(report.error, 4),
        "rms_error_over_rms_in_highlight": round(report.highlight_error, 4),
    }
    material = {
        "name": f"{name} (approximation)",
        "pbrMetallicRoughness": {
            "baseColorFactor": [*(round(c, 5) for c in m.base_colour), 1.0],
            "metallicFactor": round(m.metallic, 5),
            "roughnessFactor": round(m.roughness, 5),
        },
        "extensions": extensions,
        "extras": about,
    }
    uri = "data:application/octet-stream;base64," + base64.b64encode(data).decode()
    split = normals.size * 4
    vertices = {"bufferView": 0, "componentType": 5126, "count": len(normals), "type": "VEC3"}
    return {
        "asset": {"version": "2.0", "generator": f"raden_torch {__version__}"},
        "extensionsUsed": list(extensions),
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0, "name": name}],
        "meshes": [
            {
                "primitives": [
                    {"attributes": {"POSITION": 0, "NORMAL": 0}, "indices": 1, "material": 0}
                ]
            }
        ],
        "materials": [material],
        "accessors": [
            vertices | {"min": normals.min(0).tolist(), "max": normals.max(0).tolist()},
            {"bufferView": 1, "componentType": 5123, "count": corners.size, "type": "SCALAR"},
        ],
        "bufferViews": [
            {"buffer": 0, "byteOffset": 0, "byteLength": split, "target": 34962},
            {"buffer": 0, "byteOffset": split, "byteLength": len(data) - split, "target": 34963},
        ],
        "buffers": [{"byteLength": len(data), "uri": uri}],
    }


def _sphere() -> tuple[NDArray[np.float32], NDArray[np.int64]]:
    """Vertices of the unit sphere, `[N, 3]`, which are its normals, and triangles `[M, 3]`."""
    polar = np.linspace(0, np.pi, _STACKS + 1)[:, None]
    around = np.linspace(0, 2 * np.pi, _SLICES + 1)
    sine = np.sin(polar)
    rows = np.broadcast_arrays(sine * np.sin(around), np.cos(polar), sine * np.cos(around))
    at = np.arange((_STACKS + 1) * (_SLICES + 1)).reshape(_STACKS + 1, _SLICES + 1)
    a, b, c, d = at[:-1, :-1], at[1:, :-1], at[1:, 1:], at[:-1, 1:]
    corners = np.concatenate([np.stack(t, -1).reshape(-1, 3) for t in ((a, b, c), (a, c, d))])
    return np.stack(rows, -1).reshape(-1, 3).astype(np.float32), corners
