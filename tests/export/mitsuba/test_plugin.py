"""The plugin: torch's reflection in every variant, and samples that follow their density."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import scipy.stats
import torch

import raden_torch as rt
from raden_torch.brdf.fitting import fit as fit_module
from raden_torch.brdf.materials.runtime import RuntimeBrdf
from raden_torch.brdf.model.runtime_table import RuntimeLayout
from raden_torch.export.mitsuba import plugin
from raden_torch.export.mitsuba.check import INCIDENCES_DEG, chi_square, load
from raden_torch.export.mitsuba.lit_sphere import mean_relative_difference, render_sphere
from raden_torch.export.mitsuba.plugin_file import export_plugin
from raden_torch.export.table_file import read_form
from raden_torch.export.whole_reflection import view_albedo
from raden_torch.optics.specimens import SPECIMENS
from raden_torch.optics.spectral_colour import spectrum_to_rgb
from raden_torch.pictures import render_shape
from tests.export.mitsuba.shells import simulated_shell, unit

VIEW, LIGHT = unit(0.4, 0.1, 0.8), unit(-0.5, 0.3, 0.7)
TESTS = len(INCIDENCES_DEG) * (len(SPECIMENS) + 1)
SIGNIFICANCE = 1 - (1 - 0.01) ** (1 / TESTS)


def reflected(mi: Any, bsdf: Any, view: Any, light: Any, mode: Any = None) -> Any:
    si = mi.SurfaceInteraction3f()
    si.wi = mi.Vector3f(view)
    context = mi.BSDFContext() if mode is None else mi.BSDFContext(mode)
    return bsdf.eval(context, si, mi.Vector3f(light))


def in_torch(path: Path, view: Any, light: Any) -> np.ndarray:
    n, l, v = (torch.tensor(w).view(1, 3, 1, 1) for w in ((0.0, 0.0, 1.0), light, view))  # noqa: E741
    return read_form(path.with_suffix(".json")).of_unit_vectors(n, l, v).flatten().numpy()


@pytest.mark.parametrize("name", SPECIMENS)
def test_samples_follow_their_density_by_mitsubas_own_test(
    name: str, llvm: Any, tmp_path: Path
) -> None:
    """Expected: no p-value below the significance of 1 % of all shells and incidences together."""
    export_plugin(simulated_shell(name), tmp_path / "shell.xml")
    bsdf = load(tmp_path / "shell.xml", "llvm_ad_rgb")
    found = {angle: chi_square(bsdf, angle) for angle in INCIDENCES_DEG}
    assert min(found.values()) > SIGNIFICANCE, found


def test_samples_of_a_measured_paint_follow_their_density(
    llvm: Any, shared: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    layout = RuntimeLayout((48, 41, 69), (0.45, 0.7))  # what `fit` chooses, in seconds
    monkeypatch.setattr(fit_module, "choose_layout", lambda model: layout)
    measured = rt.load_measurement(shared / "data/measured_brdf/pearl-paint.csv")
    export_plugin(rt.fit(measured, interpolation="trilinear").model, tmp_path / "paint.xml")
    bsdf = load(tmp_path / "paint.xml", "llvm_ad_rgb")
    found = {angle: chi_square(bsdf, angle) for angle in INCIDENCES_DEG}
    assert min(found.values()) > SIGNIFICANCE, found


def test_it_passes_the_test_over_cells_of_equal_solid_angle(llvm: Any, exported: Path) -> None:
    """Mitsuba's own domain and adapter, as its documents show them."""
    from mitsuba.chi2 import BSDFAdapter, ChiSquareTest, SphericalDomain

    about = {"type": "raden", "filename": str(exported.with_suffix(".json"))}
    sample, density = BSDFAdapter("raden", about, wi=unit(0.7, 0.2, 0.5))
    test = ChiSquareTest(
        SphericalDomain(), sample, density, sample_dim=3, sample_count=200_000, res=51, ires=16
    )
    assert test.run(quiet=True), test.messages


def test_the_chi_square_test_finds_a_density_that_is_off(llvm: Any, exported: Path) -> None:
    bsdf = load(exported, "llvm_ad_rgb")
    own, cosine = bsdf.pdf, llvm.warp.square_to_cosine_hemisphere_pdf
    bsdf.pdf = lambda context, si, wo: 0.9 * own(context, si, wo) + 0.1 * cosine(wo)
    assert chi_square(bsdf, 30.0) < 1e-6


@pytest.mark.parametrize("incidence_deg", [20.0, 75.0])
def test_samples_follow_their_density_without_llvm(
    scalar: Any, exported: Path, incidence_deg: float
) -> None:
    """Expected counts are the density's integrals over 6 x 12 cells of equal solid angle."""
    mi, bsdf = scalar, load(exported, "scalar_rgb")
    rows, columns, parts, count = 6, 12, 8, 6000
    angle = np.deg2rad(incidence_deg)
    si = mi.SurfaceInteraction3f()
    si.wi = mi.Vector3f(float(np.sin(angle)), 0.0, float(np.cos(angle)))
    context, random = mi.BSDFContext(), np.random.default_rng(7)
    seen = np.zeros((rows, columns))
    lost = 0
    for a, b, c in random.random((count, 3)).tolist():
        found, weight = bsdf.sample(context, si, a, mi.Point2f(b, c))
        if found.pdf == 0:
            lost += 1
            continue
        wo = found.wo
        assert np.isfinite([*weight]).all()
        assert abs(bsdf.pdf(context, si, wo) - found.pdf) < 1e-3 * found.pdf
        turn = np.arctan2(wo.y, wo.x) / (2 * np.pi) % 1
        seen[min(int(wo.z * rows), rows - 1), min(int(turn * columns), columns - 1)] += 1
    z, turn = np.meshgrid(
        (np.arange(rows * parts) + 0.5) / (rows * parts),
        (np.arange(columns * parts) + 0.5) / (columns * parts),
        indexing="ij",
    )
    sine = np.sqrt(1 - z**2)
    around = np.stack([sine * np.cos(2 * np.pi * turn), sine * np.sin(2 * np.pi * turn), z], -1)
    flat = around.reshape(-1, 3).tolist()
    density = np.array([bsdf.pdf(context, si, mi.Vector3f(wo)) for wo in flat]).reshape(z.shape)
    shares = density.reshape(rows, parts, columns, parts).mean((1, 3)) * 2 * np.pi / seen.size
    assert abs(shares.sum() + lost / count - 1) < 0.01
    wanted = shares / shares.sum() * seen.sum()
    full = wanted > 5
    statistic = ((seen - wanted)[full] ** 2 / wanted[full]).sum()
    assert scipy.stats.chi2.sf(statistic, full.sum() - 1) > 0.005


def test_the_mean_weight_is_the_albedo(llvm: Any, exported: Path) -> None:
    """Rationale: E[f cos/pdf] = ∫ f cos dω, whatever the density is. Expected: four standard
    errors; a weight is at most what a share of the cosine's directions leaves."""
    import drjit as dr

    mi, bsdf = llvm, load(exported, "llvm_ad_rgb")
    form = read_form(exported.with_suffix(".json"))
    albedos = np.array(view_albedo(form))
    cosines = 1 - np.linspace(0, 1, len(albedos)) ** 2
    for place in (0, 16, 24, 30):
        count = 200_000
        numbers = mi.PCG32(size=count, initstate=place)
        draws = [numbers.next_float32() for _ in range(3)]
        si = dr.zeros(mi.SurfaceInteraction3f, count)
        si.wi = mi.Vector3f(float(np.sqrt(1 - cosines[place] ** 2)), 0, float(cosines[place]))
        _, weight = bsdf.sample(mi.BSDFContext(), si, draws[0], mi.Point2f(draws[1], draws[2]))
        found = np.array(weight)
        error = found.std(1) / np.sqrt(count)
        assert (abs(found.mean(1) - albedos[place]) < 4 * error + 3e-3 * albedos[place]).all()
        peak = float(form.table.abs().max())
        assert found.max() <= peak * np.pi / plugin.COSINE_SHARE * 1.001


def test_it_samples_better_than_the_cosine(llvm: Any, exported: Path) -> None:
    """Rationale: under even light the variance of an estimate is that of the weight f cos/pdf.
    Expected: at most half of what the cosine's directions have, seen at 30 degrees."""
    import drjit as dr

    mi, bsdf = llvm, load(exported, "llvm_ad_rgb")
    count = 100_000
    numbers = mi.PCG32(size=count)
    draws = [numbers.next_float32() for _ in range(3)]
    si = dr.zeros(mi.SurfaceInteraction3f, count)
    si.wi = mi.Vector3f(0.5, 0, 0.75**0.5)
    place = mi.Point2f(draws[1], draws[2])
    _, weight = bsdf.sample(mi.BSDFContext(), si, draws[0], place)
    wo = mi.warp.square_to_cosine_hemisphere(place)
    even = bsdf.eval(mi.BSDFContext(), si, wo) * dr.pi / wo.z
    assert np.array(weight).var(1).sum() < np.array(even).var(1).sum() / 2


def test_its_sphere_is_the_renders(scalar: Any, shell: RuntimeBrdf, exported: Path) -> None:
    """Expected: within 1 % in the mean; it is the rounding of the table and of the rays."""
    own = render_shape(shell, "sphere", size=20)[0].movedim(0, -1).double().numpy()
    picture = render_sphere(scalar, load(exported, "scalar_rgb"), 20)
    assert (own.sum(-1) > 0).mean() > 0.4
    assert mean_relative_difference(picture, own) < 2e-3


@pytest.mark.parametrize("variant", ["scalar_rgb", "scalar_spectral", "scalar_spectral_polarized"])
def test_every_scalar_variant_has_torchs_reflection(variant: str, exported: Path) -> None:
    mi = pytest.importorskip("mitsuba", reason="needs the extra simulate")
    bsdf = load(exported, variant)
    wanted = in_torch(exported, VIEW, LIGHT) * LIGHT[2]
    if variant == "scalar_rgb":
        np.testing.assert_allclose([*reflected(mi, bsdf, VIEW, LIGHT)], wanted, rtol=1e-4)
        return
    nm = np.arange(380.0, 781.0, 10.0)
    nm = np.append(nm, [780.0] * (-len(nm) % 4))
    spectrum = []
    for four in nm.reshape(-1, 4).tolist():
        si = mi.SurfaceInteraction3f()
        si.wi, si.wavelengths = mi.Vector3f(VIEW), mi.UnpolarizedSpectrum(four)
        value = bsdf.eval(mi.BSDFContext(), si, mi.Vector3f(LIGHT))
        spectrum += [*(value[0, 0] if "polarized" in variant else value)]
    np.testing.assert_allclose(
        spectrum_to_rgb(np.array(spectrum[:41]), nm[:41]), wanted, rtol=2e-3, atol=1e-4
    )


def test_the_monochromatic_variant_has_the_luminance(llvm: Any, exported: Path) -> None:
    bsdf = load(exported, "llvm_ad_mono")
    wanted = in_torch(exported, VIEW, LIGHT) @ (0.2126, 0.7152, 0.0722) * LIGHT[2]
    assert abs(float(reflected(llvm, bsdf, VIEW, LIGHT)[0][0]) - wanted) < 1e-4 * wanted


def test_two_sides_are_one_shell_and_no_mirror_image(scalar: Any, exported: Path) -> None:
    """Rationale: the back is the front after half a turn; opposite tilts differ in a shell."""
    mi, name = scalar, str(exported.with_suffix(".json"))
    one, two = (
        mi.load_dict({"type": "raden", "filename": name, "two_sided": both})
        for both in (False, True)
    )
    turned = [[x, -y, -z] for x, y, z in (VIEW, LIGHT)]
    mirrored = [[x, y, -z] for x, y, z in (VIEW, LIGHT)]
    front = np.array([*reflected(mi, two, VIEW, LIGHT)])
    np.testing.assert_allclose([*reflected(mi, one, VIEW, LIGHT)], front, rtol=1e-6)
    np.testing.assert_allclose([*reflected(mi, two, *turned)], front, rtol=1e-5)
    assert not np.allclose([*reflected(mi, two, *mirrored)], front, rtol=1e-3)
    assert [*reflected(mi, one, *turned)] == [0, 0, 0]
    assert [*reflected(mi, two, VIEW, turned[1])] == [0, 0, 0]
    si = mi.SurfaceInteraction3f()
    si.wi = mi.Vector3f(turned[0])
    found, _ = two.sample(mi.BSDFContext(), si, 0.5, mi.Point2f(0.3, 0.6))
    assert found.wo.z < 0
    assert found.pdf > 0


def test_paths_from_the_lamp_see_light_and_viewer_in_their_places(
    scalar: Any, exported: Path
) -> None:
    bsdf = load(exported, "scalar_rgb")
    importance = scalar.TransportMode.Importance
    found = [*reflected(scalar, bsdf, LIGHT, VIEW, importance)]
    np.testing.assert_allclose(found, in_torch(exported, VIEW, LIGHT) * VIEW[2], rtol=1e-4)
    assert not np.allclose(in_torch(exported, VIEW, LIGHT), in_torch(exported, LIGHT, VIEW), 1e-3)


def test_a_table_may_be_optimised(llvm: Any, exported: Path) -> None:
    """Rationale: f_r is linear in the table. Expected: its gradient sums to the cosine, and a
    table that is set is read."""
    import drjit as dr

    mi, bsdf = llvm, load(exported, "llvm_ad_rgb")
    parameters = mi.traverse(bsdf)
    table = parameters["table"]
    before = np.array(reflected(mi, bsdf, VIEW, LIGHT)).ravel()
    dr.enable_grad(table)
    parameters["table"] = table
    parameters.update()
    dr.backward(dr.sum(reflected(mi, bsdf, VIEW, LIGHT)))
    gradient = np.array(dr.grad(table)).reshape(*table.shape)
    np.testing.assert_allclose(gradient.sum((0, 1, 2)), LIGHT[2], rtol=1e-4)
    parameters["table"] = 2 * dr.detach(table)
    parameters.update()
    np.testing.assert_allclose(np.array(reflected(mi, bsdf, VIEW, LIGHT)).ravel(), 2 * before, 1e-5)
