"""The glTF material: its film against physics, its fit, and the file."""

from __future__ import annotations

import base64
import json
from dataclasses import replace

import numpy as np
import pytest
import torch

import raden_torch as rt
from raden_torch.colorimetry import XYZ_TO_SRGB
from raden_torch.errors import InputError
from raden_torch.export.gltf_brdf import GltfMaterial, film_reflectance, schlick, sensitivity

PLAIN = GltfMaterial((0.5, 0.4, 0.3), 0.0, 0.5, 1.5, 0.0, 1.3, 300.0)


def observer() -> tuple[np.ndarray, np.ndarray]:
    """Wavelengths in metres, and weights to linear RGB with an even spectrum at Y = 1."""
    colour = pytest.importorskip("colour", reason="colour-science is not installed")
    cmfs = colour.MSDS_CMFS["CIE 1931 2 Degree Standard Observer"]
    weights = np.asarray(cmfs.values)
    return np.asarray(cmfs.wavelengths) * 1e-9, weights / weights[:, 1].sum() @ XYZ_TO_SRGB.T


def test_the_sensitivity_is_the_observers() -> None:
    """Rationale: the Gaussians stand for the CIE's observer in the frequency domain."""
    wavelength, weights = observer()
    path = np.linspace(0, 2e-6, 41)
    for shift in (0.0, np.pi):
        wave = np.cos(2 * np.pi * path[:, None] / wavelength + shift)
        got = sensitivity(path, np.full(3, shift))
        off = abs(got - wave @ weights)
        assert off.max() < 0.2
        assert off.mean() < 0.06
        assert off[path < 2e-7].max() < 0.05


def test_a_film_at_normal_incidence_is_airys() -> None:
    """Rationale: there Schlick's approximation is exact, and Airy's sum has no polarisation."""
    wavelength, weights = observer()
    for film, base, thickness in ((1.33, 1.6, 320.0), (1.7, 1.4, 500.0), (1.5, 2.2, 250.0)):
        first, second = (1 - film) / (1 + film), (film - base) / (film + base)
        turn = np.exp(4j * np.pi * film * thickness * 1e-9 / wavelength)
        exact = abs((first + second * turn) / (1 + first * second * turn)) ** 2 @ weights
        f0 = np.full(3, ((base - 1) / (base + 1)) ** 2)
        got = film_reflectance(np.ones(1), film, thickness, f0)[0]
        assert abs(got - np.maximum(exact, 0)).max() < 0.03


def test_a_material_without_a_film_is_the_specifications() -> None:
    """Rationale: appendix B by hand for one geometry, light and viewer at 30°, N along H."""
    c = np.cos(np.deg2rad(30))
    f = PLAIN.f_r(*(np.array([x]) for x in (c, c, 1.0, c)))[0]
    alpha = 0.25
    fresnel = schlick(0.04, c)
    masking = 4 * c * c / (c + np.sqrt(alpha**2 + (1 - alpha**2) * c * c)) ** 2
    lobe = fresnel / (np.pi * alpha**2) * masking / (4 * c * c)
    np.testing.assert_allclose(f, (1 - fresnel) * np.array([0.5, 0.4, 0.3]) / np.pi + lobe)


def test_materials_are_finite_and_reciprocal() -> None:
    random = np.random.default_rng(3)
    n_l, n_v, n_h, v_h = random.uniform(1e-4, 1, (4, 2000))
    for metallic in (0.0, 1.0):
        film = replace(PLAIN, metallic=metallic, iridescence=1.0, film_ior=1.8)
        there, back = film.f_r(n_l, n_v, n_h, v_h), film.f_r(n_v, n_l, n_h, v_h)
        assert np.isfinite(there).all()
        np.testing.assert_allclose(there, back, rtol=1e-12)


class Film(torch.nn.Module):
    """A material of the format as if it were a model's runtime form."""

    def __init__(self, material: GltfMaterial) -> None:
        super().__init__()
        self.material = material

    def of_unit_vectors(self, n, l, v):  # noqa: E741
        h = torch.nn.functional.normalize(l + v, dim=1)
        pairs = ((n, l), (n, v), (n, h), (v, h))
        cosines = ((a * b).sum(1).flatten().clamp(1e-4, 1).double().numpy() for a, b in pairs)
        f = self.material.f_r(*cosines)
        return torch.from_numpy(f.T).reshape(1, 3, *l.shape[2:])


@pytest.mark.slow
def test_a_material_of_the_format_is_found_again() -> None:
    from raden_torch.export.gltf_file import nearest_material

    film = replace(PLAIN, iridescence=1.0, film_ior=1.6, roughness=0.5, thickness_nm=420.0, ior=2.0)
    report = nearest_material(Film(film))  # type: ignore[arg-type]
    assert report.error < 0.02
    assert report.highlight_error < 0.02


@pytest.mark.slow
def test_the_command_writes_a_file_that_says_its_error(raden, tmp_path) -> None:
    model = rt.fit(rt.simulate_specimen("yakogai", step_deg=10)).model
    rt.save_model(model, tmp_path / "shell.safetensors")
    done = raden("export", tmp_path / "shell.safetensors", "-o", tmp_path / "shell.gltf")
    assert done.returncode == 0, done.stderr
    assert "the nearest KHR_materials_iridescence: off by" in done.stdout
    document = json.loads((tmp_path / "shell.gltf").read_text())
    (material,) = document["materials"]
    extras = material["extras"]
    assert extras["approximates"] == "yakogai"
    assert extras["simulated"] is True
    assert 0.01 < extras["rms_error_over_rms"] < 1
    assert set(material["extensions"]) == set(document["extensionsUsed"])
    data = base64.b64decode(document["buffers"][0]["uri"].split(",")[1])
    positions, corners = document["accessors"]
    split = document["bufferViews"][1]["byteOffset"]
    points = np.frombuffer(data[:split], "<f4").reshape(positions["count"], 3)
    triangles = np.frombuffer(data[split:], "<u2").reshape(-1, 3)
    assert triangles.size == corners["count"]
    np.testing.assert_allclose(np.linalg.norm(points, axis=1), 1, rtol=1e-6)
    a, b, c = (points[triangles[:, k]].astype(float) for k in range(3))
    volume = (a * np.cross(b, c)).sum() / 6  # positive: seen from outside, anticlockwise
    assert 0.97 < volume / (4 * np.pi / 3) < 1
    done = raden(
        "export", tmp_path / "shell.safetensors", "-o", tmp_path / "a.gltf", "--opset", "19"
    )
    assert done.returncode == 2
    assert "--opset: expected with an .onnx file, got .gltf" in done.stderr


def test_another_suffix_is_refused(tmp_path) -> None:
    from raden_torch.export.gltf_file import export_gltf

    model = rt.RadenBrdf(rt.fit(rt.simulate_specimen("akoya", step_deg=35)).model.diffuse, None)
    with pytest.raises(InputError, match=r"shell\.glb"):
        export_gltf(model, tmp_path / "shell.glb")
