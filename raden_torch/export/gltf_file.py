"""A model as the nearest glTF 2.0 material with KHR_materials_iridescence, on a sphere."""

from __future__ import annotations

import base64
import json
import os
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.optimize import least_squares
from threadpoolctl import threadpool_limits

from raden_torch import __version__
from raden_torch.arrays import Bools, Floats
from raden_torch.brdf.model.model import Provenance, RadenBrdf
from raden_torch.errors import check_type
from raden_torch.export.forms import RuntimeForm, form_of
from raden_torch.export.gltf_brdf import GltfMaterial
from raden_torch.export.whole_reflection import highlight_roughness
from raden_torch.files import check_output, written_beside

_PAIRS = 800
_HELD_OUT = 4000
_THICKNESSES_NM = (150.0, 300.0, 450.0, 600.0, 800.0, 1000.0)
_LOW = np.array([0, 0, 0, 0, 0.05, 1.0, 0, 1.0, 50.0])
_HIGH = np.array([1, 1, 1, 1, 1.0, 3.0, 1, 3.0, 1500.0])
_STEPS = 60
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
    check_type("model", model, RadenBrdf, "load_model reads one from a file; fit(…).model is one")
    target = check_output(path, (".gltf",))
    form = form_of(model, "runtime")
    assert isinstance(form, RuntimeForm)
    report = nearest_material(form)
    text = json.dumps(_document(report, model.provenance), indent=1)
    with written_beside(target) as temporary:
        temporary.write_text(text + "\n", "utf-8")
    return report


def nearest_material(form: RuntimeForm) -> GltfReport:
    """The material whose f_r cos θi is nearest in the least-squares sense."""
    cosines, wanted = _geometries(form, _PAIRS, seed=1)
    weight = cosines[:, :1]
    scale = np.sqrt(np.mean((wanted * weight) ** 2)) or 1.0

    def residual(x: Floats) -> Floats:
        return ((_material(x).f_r(*cosines.T) - wanted) * weight / scale).ravel()

    roughness = min(max(np.sqrt(highlight_roughness(form)), _LOW[4]), 1.0)
    colour = np.clip(np.pi * np.median(wanted, axis=0), 0.02, 0.98)
    spread = np.where(_HIGH > 100, 100.0, 0.3)
    with threadpool_limits(1):  # the matrices are small
        tried = [
            least_squares(
                residual,
                np.array([*colour, 0.3, roughness, 1.5, 0.7, 1.5, thickness]),
                bounds=(_LOW, _HIGH),
                x_scale=spread,
                max_nfev=_STEPS,
            )
            for thickness in _THICKNESSES_NM
        ]
    material = _material(min(tried, key=lambda found: float(found.cost)).x)
    cosines, wanted = _geometries(form, _HELD_OUT, seed=2)
    off = (material.f_r(*cosines.T) - wanted) * cosines[:, :1]
    wanted = wanted * cosines[:, :1]
    even, near = np.arange(len(off)) < _HELD_OUT // 2, cosines[:, 2] > np.cos(np.deg2rad(20))
    return GltfReport(material, _share(off, wanted, even), _share(off, wanted, near))


def _share(off: Floats, wanted: Floats, where: Bools) -> float:
    whole = np.sqrt(np.mean(wanted[where] ** 2))
    return float(np.sqrt(np.mean(off[where] ** 2)) / whole) if whole else 0.0


def _material(x: Floats) -> GltfMaterial:
    red, green, blue, metallic, roughness, ior, iridescence, film_ior, thickness = map(float, x)
    colour = (red, green, blue)
    return GltfMaterial(colour, metallic, roughness, ior, iridescence, film_ior, thickness)


def _geometries(form: RuntimeForm, count: int, seed: int) -> tuple[Floats, Floats]:
    """`[N, 4]` cosines N·L, N·V, N·H, V·H and the model's f_r `[N, 3]`: half of them pairs of
    directions that are even by projected solid angle, half with the half vector near the normal."""
    random = np.random.default_rng(seed)
    light, view = _projected(random, count // 2), _projected(random, count // 2)
    v = _projected(random, count)
    h = _around(random, count, np.deg2rad(25))
    l = 2 * (v * h).sum(1, keepdims=True) * h - v  # noqa: E741
    seen = np.flatnonzero((l[:, 2] > 0.02) & (v[:, 2] > 0.02))[: count // 2]
    light, view = np.concatenate([light, l[seen]]), np.concatenate([view, v[seen]])
    half = light + view
    half /= np.linalg.norm(half, axis=1, keepdims=True)
    cosines = np.stack([light[:, 2], view[:, 2], half[:, 2], (view * half).sum(1)], axis=1)
    maps = [torch.from_numpy(x.T.copy())[None, :, None] for x in (light, view)]
    normal = maps[0].new_tensor([0.0, 0.0, 1.0]).view(1, 3, 1, 1).expand_as(maps[0])
    with torch.no_grad():
        f = form.of_unit_vectors(normal, *maps)[0, :, 0].T
    return np.clip(cosines, 1e-4, 1), f.numpy()


def _projected(random: np.random.Generator, count: int) -> Floats:
    square, azimuth = random.random(count), 2 * np.pi * random.random(count)
    radius = np.sqrt(square)
    return np.stack([radius * np.cos(azimuth), radius * np.sin(azimuth), np.sqrt(1 - square)], 1)


def _around(random: np.random.Generator, count: int, most: float) -> Floats:
    angle, azimuth = most * random.random(count), 2 * np.pi * random.random(count)
    sine = np.sin(angle)
    return np.stack([sine * np.cos(azimuth), sine * np.sin(azimuth), np.cos(angle)], 1)


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
