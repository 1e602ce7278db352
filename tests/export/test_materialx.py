"""OpenPBR: its formula against physics and MaterialX's own shader, its fit, the file."""

from __future__ import annotations

from dataclasses import asdict, replace
from xml.etree import ElementTree

import numpy as np
import pytest
import torch

import raden_torch as rt
from raden_torch.brdf.materials import microfacet
from raden_torch.brdf.model.model import Provenance
from raden_torch.cli.export_commands import export
from raden_torch.errors import InputError
from raden_torch.export import material_fit
from raden_torch.export.gltf_brdf import schlick
from raden_torch.export.lit_sphere import SphereDifference, sphere_difference
from raden_torch.export.material_fit import Nearest
from raden_torch.export.materialx_file import (
    MaterialXReport,
    export_materialx,
    materialx_document,
    nearest_openpbr,
)
from raden_torch.export.openpbr_brdf import (
    XYZ_TO_CIE_RGB,
    OpenPbrMaterial,
    film_on_dielectric,
    fresnel,
    fresnel_polarised,
)
from tests.export.browser import needs_browser
from tests.export.materialx_shader import document, drawn

PLAIN = OpenPbrMaterial((0.5, 0.4, 0.3), 0.0, 0.5, 1.5, 0.0, 0.4, 1.4, 0.0, 0.3, 1.6)
FILM = replace(PLAIN, thin_film_weight=0.8, thin_film_thickness=0.42)
MATERIALS = {
    "plain": PLAIN,
    "film": FILM,
    "film on metal": replace(FILM, base_metalness=1.0, thin_film_weight=1.0),
    "film denser than the base": replace(FILM, thin_film_ior=2.2, thin_film_thickness=0.9),
    "all": replace(FILM, coat_weight=0.7, coat_ior=2.4, base_metalness=0.4),
}


def vectors(count: int, seed: int = 5) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Normals, lights and views `[N, 3]`, the latter within 85° of the normal."""
    random = np.random.default_rng(seed)

    def unit(low: float) -> np.ndarray:
        z, azimuth = random.uniform(low, 1, count), random.uniform(0, 2 * np.pi, count)
        sine = np.sqrt(1 - z**2)
        return np.stack([sine * np.cos(azimuth), sine * np.sin(azimuth), z], 1)

    light, view = unit(0.09), unit(0.09)
    return np.broadcast_to([0.0, 0.0, 1.0], light.shape), light, view


def cosines(n: np.ndarray, l: np.ndarray, v: np.ndarray) -> list[np.ndarray]:  # noqa: E741
    h = (l + v) / np.linalg.norm(l + v, axis=1, keepdims=True)
    return [(a * b).sum(1) for a, b in ((n, l), (n, v), (n, h), (v, h))]


def written(material: OpenPbrMaterial, **source) -> str:
    report = MaterialXReport(Nearest(material, 0.25, 0.2), SphereDifference(3.0, 9.0))
    return materialx_document(report, Provenance(**source))


def test_a_bare_dielectric_is_a_microfacet_face_over_a_matt_base() -> None:
    """Rationale: GGX, Smith and Fresnel of the library's own microfacet face, apart from the energy
    compensation, which is small for a smooth face seen from above."""
    material = replace(PLAIN, specular_roughness=0.2, base_color=(0.0, 0.0, 0.0))
    geometry = vectors(400)
    maps = [torch.from_numpy(np.array(v.T))[None, :, None] for v in geometry]
    face = microfacet.lobe(*maps, 0.04, lambda c: microfacet.fresnel(c, 1.5))[0, 0, 0].numpy()
    at = cosines(*geometry)
    steep = at[1] > 0.4
    np.testing.assert_allclose(material.f_r(*at)[steep, 0], face[steep], rtol=0.02)


def test_a_bare_metal_is_schlicks() -> None:
    geometry = vectors(400)
    metal = replace(PLAIN, base_metalness=1.0, specular_roughness=0.2)
    white = replace(metal, base_color=(1.0, 1.0, 1.0))
    at = cosines(*geometry)
    got, steep = metal.f_r(*at) / white.f_r(*at), at[1] > 0.4
    known = schlick(np.array(metal.base_color), at[3][:, None])
    np.testing.assert_allclose(got[steep], known[steep], rtol=0.02)


def test_fresnels_equations() -> None:
    cosine = np.linspace(0, 1, 50)
    for ior in (1.0, 1.3, 2.4):
        known = microfacet.fresnel(torch.from_numpy(cosine), ior).numpy()
        np.testing.assert_allclose(fresnel(cosine, ior)[1:], known[1:], atol=1e-12)
    p, s = fresnel_polarised(np.array([0.3, 0.9]), 0.7)  # from within glass
    np.testing.assert_allclose([p[0], s[0]], 1)
    assert s[1] < 0.1


@pytest.mark.parametrize("thickness_nm", [0.0, 250.0, 500.0])
def test_a_film_at_normal_incidence_is_airys(thickness_nm: float) -> None:
    """Rationale: there is no polarisation, and two orders are nearly all; red, green and blue of
    CIE RGB add to one for an even spectrum."""
    colour = pytest.importorskip("colour", reason="colour-science is not installed")
    cmfs = colour.MSDS_CMFS["CIE 1931 2 Degree Standard Observer"]
    wavelength, weights = np.asarray(cmfs.wavelengths) * 1e-9, np.asarray(cmfs.values)
    weights = weights / weights[:, 1].sum() @ XYZ_TO_CIE_RGB.T
    for film, base in ((1.4, 1.6), (1.7, 1.5)):
        first, second = (1 - film) / (1 + film), (film - base) / (film + base)
        turn = np.exp(4j * np.pi * film * thickness_nm * 1e-9 / wavelength)
        exact = abs((first + second * turn) / (1 + first * second * turn)) ** 2 @ weights
        got = film_on_dielectric(np.ones(1), film, thickness_nm * 1e-9, base)[0]
        np.testing.assert_allclose(got, exact, atol=0.01)


@pytest.mark.parametrize("name", MATERIALS)
def test_little_more_is_reflected_than_arrives(name: str) -> None:
    """Rationale: a white furnace. MaterialX's own formula is not exact there: its albedo is a fit,
    and a film's reflection does not dim the base, which a dense film shows by 10 %."""
    most = 1.11 if name == "film denser than the base" else 1.02
    white = replace(MATERIALS[name], base_color=(1.0, 1.0, 1.0))
    square, turn = np.meshgrid((np.arange(64) + 0.5) / 64, (np.arange(96) + 0.5) / 96)
    radius, azimuth = np.sqrt(square.ravel()), 2 * np.pi * turn.ravel()
    light = np.stack(
        [radius * np.cos(azimuth), radius * np.sin(azimuth), np.sqrt(1 - radius**2)], 1
    )
    n = np.broadcast_to([0.0, 0.0, 1.0], light.shape)
    for angle in np.deg2rad([0, 30, 60, 75, 85]):
        view = np.broadcast_to([np.sin(angle), 0, np.cos(angle)], light.shape)
        f = white.f_r(*cosines(n, light, view))
        assert np.isfinite(f).all()
        assert f.min() >= 0
        assert (np.pi * f.mean(0) < most).all()


def test_materialx_validates_the_document() -> None:
    pytest.importorskip("MaterialX", reason="MaterialX is not installed")
    text = written(MATERIALS["all"], sample="aogai", simulated=True, measurement_sha256="ab" * 32)
    found = document(text)
    valid, message = found.validate()
    assert valid, message
    assert found.getColorSpace() == "lin_rec709"
    material = found.getNode("raden_shell")
    (surface,) = (one.getConnectedNode() for one in material.getInputs())
    assert surface.getCategory() == "open_pbr_surface"
    assert surface.getNodeDef() is not None
    for key, value in asdict(MATERIALS["all"]).items():
        held = surface.getInputValue(key)
        np.testing.assert_allclose(tuple(held) if key == "base_color" else held, value, rtol=1e-6)
    assert surface.getInputValue("coat_darkening") == 0
    assert material.getAttribute("raden_approximates") == "aogai (simulated)"
    assert material.getAttribute("raden_simulated") == "true"
    assert material.getAttribute("raden_measurement_sha256") == "ab" * 32
    assert float(material.getAttribute("raden_delta_e2000_median")) == 3.0
    assert "25% of the reflection" in material.getDocString()
    declared = {one.getAttrName() for one in found.getAttributeDefs()}
    assert {n for n in material.getAttributeNames() if n.startswith("raden_")} <= declared


def test_a_broken_document_is_not_valid() -> None:
    """Rationale: a check that passes everything would say nothing."""
    pytest.importorskip("MaterialX", reason="MaterialX is not installed")
    broken = written(PLAIN).replace('name="coat_ior" type="float"', 'name="coat_ior" type="color3"')
    assert not document(broken).validate()[0]


class OfMaterial:
    """A material of the format as if it were a model's runtime form."""

    def __init__(self, material: OpenPbrMaterial) -> None:
        self.material = material

    def of_unit_vectors(self, n, l, v):  # noqa: E741
        h = torch.nn.functional.normalize(l + v, dim=1)
        pairs = ((n, l), (n, v), (n, h), (v, h))
        at = [(a * b).sum(1).flatten().clamp(1e-4, 1).double().numpy() for a, b in pairs]
        return torch.from_numpy(self.material.f_r(*at).T).reshape(1, 3, *l.shape[2:])


def test_a_sphere_differs_from_itself_by_nothing() -> None:
    same = sphere_difference(OfMaterial(FILM), FILM)  # type: ignore[arg-type]
    assert same.most < 1e-3
    other = sphere_difference(OfMaterial(FILM), MATERIALS["film on metal"])  # type: ignore[arg-type]
    assert other.most > other.median > 5


@pytest.mark.slow
def test_a_material_of_the_format_is_found_again() -> None:
    film = replace(FILM, thin_film_weight=1.0, thin_film_ior=1.6, specular_ior=2.2)
    found = nearest_openpbr(OfMaterial(film))  # type: ignore[arg-type]
    assert found.error < 0.02
    assert sphere_difference(OfMaterial(film), found.material).most < 1.5  # type: ignore[arg-type]


def test_the_command_writes_a_file_that_says_its_error(monkeypatch, capsys, tmp_path) -> None:
    """Rationale: a fit that is broken off early says its error all the same."""
    monkeypatch.setattr(material_fit, "_FIRST_STEPS", 2)
    monkeypatch.setattr(material_fit, "_STEPS", 4)
    model = rt.fit(rt.simulate_specimen("akoya", step_deg=35)).model
    rt.save_model(model, tmp_path / "shell.safetensors")
    export(tmp_path / "shell.safetensors", output=tmp_path / "shell.mtlx")
    said = capsys.readouterr().out
    assert said.startswith("the nearest OpenPBR: off by ")
    assert "ΔE2000" in said.splitlines()[0]
    root = ElementTree.parse(tmp_path / "shell.mtlx").getroot()
    material = root.find("surfacematerial")
    assert material is not None
    assert material.get("raden_approximates") == "akoya (simulated)"
    assert 0.01 < float(material.get("raden_rms_error_over_rms", "")) < 1
    assert 0 < float(material.get("raden_delta_e2000_median", "")) < 30


def test_bad_input(tmp_path) -> None:
    model = rt.fit(rt.simulate_specimen("akoya", step_deg=35)).model
    with pytest.raises(InputError, match=r"expected .*\.mtlx"):
        export_materialx(model, tmp_path / "shell.xml")
    with pytest.raises(InputError, match="model: expected RadenBrdf"):
        export_materialx("shell", tmp_path / "shell.mtlx")  # type: ignore[arg-type]


@needs_browser
@pytest.mark.slow
def test_materialx_own_shader_gives_the_same(tmp_path) -> None:
    """Rationale: a fit to another formula than the one that programs run would be of no use."""
    pytest.importorskip("MaterialX", reason="MaterialX is not installed")
    geometry = vectors(3000)
    at = cosines(*geometry)
    theirs = drawn([written(m) for m in MATERIALS.values()], tmp_path, *geometry)
    for (name, material), f in zip(MATERIALS.items(), theirs, strict=True):
        np.testing.assert_allclose(f, material.f_r(*at), rtol=1e-3, atol=1e-5, err_msg=name)
