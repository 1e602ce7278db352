"""Coats, grounds and metals: energy, reciprocity, known values, and what is refused."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import torch

import raden_torch as rt
from raden_torch.brdf.materials import coat
from raden_torch.brdf.materials.coat import Coated, refracted
from raden_torch.brdf.materials.metal import (
    Foil,
    Powder,
    coverage,
    facet_reflectance,
    fresnel_conductor,
)
from raden_torch.brdf.materials.microfacet import albedo, fresnel, ggx
from raden_torch.brdf.materials.surface import Surface
from raden_torch.brdf.materials.urushi import Lambertian, black_urushi, vermilion_urushi
from raden_torch.brdf.model.runtime_table import RuntimeLayout
from raden_torch.errors import InputError
from raden_torch.geometry import dot

UP = torch.tensor([0.0, 0.0, 1.0], dtype=torch.float64).view(1, 3, 1, 1)
WHITE = Lambertian((1.0, 1.0, 1.0))
ROUGH = 0.3  # wide enough for the quadrature of these tests


def towards(degrees: float) -> torch.Tensor:
    a = math.radians(degrees)
    return torch.tensor([math.sin(a), 0, math.cos(a)], dtype=torch.float64).view(1, 3, 1, 1)


def reflected_share(f: Callable[..., Any], degrees: float, nodes: int = 80) -> torch.Tensor:
    """`[3]` directional albedo by Gauss-Legendre in the polar angle and the midpoint rule in the
    azimuth: of nothing that the materials themselves compute."""
    x, weight = np.polynomial.legendre.leggauss(nodes)
    theta = torch.from_numpy((x + 1) * math.pi / 4)
    phi = (torch.arange(nodes, dtype=torch.float64) + 0.5) / nodes * math.pi
    t, p = torch.meshgrid(theta, phi, indexing="ij")
    light = torch.stack([t.sin() * p.cos(), t.sin() * p.sin(), t.cos()])[None]
    share = t.cos() * t.sin() * torch.from_numpy(weight)[:, None] * math.pi / 4
    return (f(UP, light, towards(degrees)) * share).sum((0, 2, 3)) * 2 * math.pi / nodes


@pytest.fixture(scope="module")
def shell() -> rt.RadenBrdf:
    return rt.fit(rt.simulate_specimen("yakogai", step_deg=35), interpolation="trilinear").model


@pytest.fixture
def few_nodes(monkeypatch: pytest.MonkeyPatch) -> None:
    """For tests that ask whether a table is made, not how accurate it is."""
    layout = RuntimeLayout((12, 21, 15), (0.4, 0.4))
    monkeypatch.setattr(coat, "layout_for", lambda roughness: layout)


LOSSLESS = {
    "coat over white": Coated(WHITE, roughness=ROUGH),
    "coat over rough mirror": Coated(Foil("mirror", 0.4, 1.53), roughness=ROUGH),
    "mirror": Foil("mirror", ROUGH),
    "very rough mirror": Foil("mirror", 1.0),
    "coat over mirrors on white": Coated(
        Powder(Foil("mirror", 0.4, 1.53), WHITE, 0.3), roughness=ROUGH
    ),
}
LOSSY = {
    "black": black_urushi(ROUGH),
    "vermilion": vermilion_urushi(ROUGH),
    "coat over gold": Coated(Foil("gold", 0.4, 1.53), roughness=ROUGH, absorption=3, thickness=0.1),
    "silver": Foil("silver", ROUGH),
}


def formula_of(material: Any) -> Callable[..., torch.Tensor]:
    """The coat's own formula, solved once; what needs no table is its formula."""
    if isinstance(material, Coated):
        return material._parts(UP, once=True, gloss=True)
    return getattr(material, "formula", material.of_unit_vectors)


@pytest.mark.parametrize("name", LOSSLESS)
def test_what_loses_nothing_returns_everything(name: str) -> None:
    """Rationale: white furnace. Expected: 1 within 2 %; above it, the quadrature."""
    f = formula_of(LOSSLESS[name])
    for degrees in (0.0, 45.0, 75.0, 85.0):
        share = reflected_share(f, degrees)
        assert share.min() > 0.98
        assert share.max() < 1.005


@pytest.mark.parametrize("name", LOSSY)
def test_what_absorbs_returns_less_than_everything(name: str) -> None:
    """In luminance: red of gold lies outside sRGB."""
    f = formula_of(LOSSY[name])
    weights = torch.tensor([0.2126, 0.7152, 0.0722], dtype=torch.float64)
    for degrees in (0.0, 60.0, 85.0):
        share = reflected_share(f, degrees)
        assert 0.03 < share @ weights < 0.995
        assert share.min() > 0


def test_a_raden_under_a_coat_gives_back_no_more_than_it_gets(shell: rt.RadenBrdf) -> None:
    for base_in in ("coat", "air"):
        f = formula_of(Coated(shell.double(), roughness=ROUGH, base_in=base_in))
        with torch.no_grad():
            assert all(reflected_share(f, x).max() < 1 for x in (0.0, 60.0, 80.0))


@pytest.mark.parametrize("material", [*LOSSLESS.values(), *LOSSY.values()])
def test_light_and_viewer_change_places(material: Any, random_vectors) -> None:
    light, view = random_vectors(4000, 1), random_vectors(4000, 2)
    f = formula_of(material)
    there, back = f(UP, light, view), f(UP, view, light)
    torch.testing.assert_close(there, back, rtol=1e-4, atol=1e-6)
    assert (there >= 0).all()
    assert (f(UP, light, -view) == 0).all()


def test_saunderson_over_lamberts_base() -> None:
    """T(l) T(v) ρ / (π η² (1 − ρ R)), R = 1 − (1 − F̄)/η² (Saunderson 1942), of a smooth face."""
    index, rho = 1.5, 0.6
    coated = Coated(Lambertian((rho,) * 3), index=index, roughness=0.001)
    cosine = torch.linspace(0, 1, 200_001, dtype=torch.float64)
    mean = 2 * torch.trapezoid(cosine * fresnel(cosine, index), cosine)
    inner = 1 - (1 - mean) / index**2
    for a, b in ((0, 0), (30, 60), (70, 10)):
        light, view = towards(a), towards(-b + 3)
        t = [1 - fresnel(dot(UP, w), index) for w in (light, view)]
        expected = t[0] * t[1] * rho / (math.pi * index**2 * (1 - rho * inner))
        body = coated.formula(UP, light, view) - coated.gloss(UP, light, view)
        torch.testing.assert_close(body, expected.expand(body.shape), rtol=2e-3, atol=0)


def test_absorption_is_by_the_length_of_the_path() -> None:
    """Over a base that is nearly black, one reflection counts: exp(−σ d (1/cos l′ + 1/cos v′))."""
    base = Lambertian((1e-4,) * 3)
    clear = Coated(base)
    brown = Coated(base, absorption=(1, 4, 9), thickness=0.05)
    light, view = towards(50), towards(-20)
    ratio = (brown.formula(UP, light, view) - brown.gloss(UP, light, view)) / (
        clear.formula(UP, light, view) - clear.gloss(UP, light, view)
    )
    path = sum(1 / math.sqrt(1 - (math.sin(math.radians(x)) / 1.53) ** 2) for x in (50, 20))
    expected = torch.tensor([1.0, 4, 9], dtype=torch.float64) * -0.05 * path
    torch.testing.assert_close(ratio.flatten(), expected.exp(), rtol=1e-3, atol=0)
    thin = replace(brown, thickness=0.0)
    torch.testing.assert_close(thin.formula(UP, light, view), clear.formula(UP, light, view))


def test_refraction_obeys_snell(random_vectors) -> None:
    w = random_vectors(500, 5)
    inside = refracted(UP, w, dot(UP, w), 1.53)
    torch.testing.assert_close(inside.norm(dim=1), torch.ones_like(inside[:, 0]))
    torch.testing.assert_close(inside[:, :2] * 1.53, w[:, :2])


def test_the_table_is_the_formula(random_vectors) -> None:
    """Expected: 1 % of f_r in all but grazing geometries, where a lobe is steep."""
    coated = vermilion_urushi()
    light, view = random_vectors(4000, 1), random_vectors(4000, 2)
    inside = ((light[:, 2:] > 0.3) & (view[:, 2:] > 0.3)).expand(-1, 3, -1, -1)
    f, read = (x[inside] for x in (coated.formula(UP, light, view),
                                   coated.of_unit_vectors(UP, light, view)))  # fmt: skip
    assert ((read - f).abs() / f).mean() < 0.01


def test_layers_that_lean_under_the_coat(shell: rt.RadenBrdf) -> None:
    """Where they lean by nothing the two ways to the image agree; where they do, it changes."""
    coated = Coated(shell.double())
    light, view = towards(40), towards(10)
    flat = Surface(UP, view)
    with torch.no_grad():
        whole = coated.of_surface(flat, light)
        same = coated.of_surface(replace(flat, layer_normal=UP), light)
        leaning = coated.of_surface(replace(flat, layer_normal=towards(20)), light)
    torch.testing.assert_close(same, whole, rtol=0.05, atol=0)
    assert not torch.allclose(leaning, whole, rtol=0.05)


@pytest.mark.usefixtures("few_nodes")
def test_shade_reads_a_coat_by_the_fused_kernel(shell: rt.RadenBrdf) -> None:
    """In single precision by the kernel, in double light by light: the same image."""
    coated = Coated(shell.float(), absorption=(1, 2, 3), thickness=0.1)
    normal = torch.nn.functional.normalize(torch.randn(1, 3, 8, 8) * 0.2 + UP.float(), dim=1)
    lights = [rt.DirectionalLight((0.3, 0.2, 1)), rt.PointLight((0, 1, 3), 4.0)]
    with torch.no_grad():
        assert coated.runtime_brdf() is not None
        images = [
            rt.shade(coated, rt.GBuffer(m, position=torch.zeros_like(m), camera=(0, 0, 4)), lights)
            for m in (normal, normal.double())
        ]
    torch.testing.assert_close(images[0].double(), images[1], rtol=1e-3, atol=1e-5)
    assert images[0].min() > 0


@pytest.mark.usefixtures("few_nodes")
def test_a_changed_base_is_baked_again_and_has_gradients(shell: rt.RadenBrdf) -> None:
    coated = Coated(shell.double())
    light, view = towards(20), towards(-15)
    with torch.no_grad():
        before = coated.of_unit_vectors(UP, light, view)
        shell.specular_gain = 0.5
        after = coated.of_unit_vectors(UP, light, view)
    assert (after < before).all()
    shell.specular_gain = 1.0
    f = coated.of_unit_vectors(UP, light, view)
    values = shell.table.values
    (gradient,) = torch.autograd.grad(f.sum(), values)
    assert torch.isfinite(gradient).all()
    assert gradient.abs().sum() > 0


def test_metals_as_they_are_known() -> None:
    """Normal reflectance of gold and silver at two wavelengths from n and k by hand, and what
    everybody knows of them: gold reflects red, silver everything."""
    for index, expected in ((0.43 + 2.455j, 0.796), (0.06 + 3.586j, 0.983)):
        by_hand = ((index.real - 1) ** 2 + index.imag**2) / ((index.real + 1) ** 2 + index.imag**2)
        assert fresnel_conductor(np.array(1.0), np.array(index)) == pytest.approx(by_hand)
        assert by_hand == pytest.approx(expected, abs=0.02)
    one = torch.ones(1, 1, 1, 1, dtype=torch.float64)
    red, green, blue = facet_reflectance("gold")(one).flatten().tolist()
    assert 1.0 < red < 1.1  # outside sRGB
    assert 0.7 < green < 0.82
    assert 0.25 < blue < 0.45
    assert facet_reflectance("silver")(one).min() > 0.94
    assert torch.allclose(facet_reflectance("gold")(0 * one), one.expand(1, 3, 1, 1))


def test_fresnel_and_ggx_at_their_known_points() -> None:
    """Normal incidence ((n−1)/(n+1))²; grazing 1; at Brewster's angle p vanishes. ∫ D cos θ dω = 1
    (Walter et al. 2007, eq. 4)."""
    index = 1.53
    at = lambda degrees: fresnel(torch.tensor(degrees).deg2rad().cos().double(), index).item()  # noqa: E731
    assert at(0.0) == pytest.approx(((index - 1) / (index + 1)) ** 2)
    assert at(90.0) == pytest.approx(1, abs=1e-6)
    brewster = math.atan(index)
    s = math.sin(brewster - math.asin(math.sin(brewster) / index)) ** 2
    assert at(math.degrees(brewster)) == pytest.approx(s / 2, rel=1e-5)
    theta = (torch.arange(200_000, dtype=torch.float64) + 0.5) / 200_000 * math.pi / 2
    for alpha in (0.05, 0.3, 0.8):
        integrand = ggx(theta.cos(), alpha) * theta.cos() * theta.sin()
        assert 2 * math.pi * integrand.mean() * math.pi / 2 == pytest.approx(1, rel=1e-3)


def test_albedo_is_the_integral_of_the_lobe() -> None:
    from raden_torch.brdf.materials.microfacet import lobe

    for alpha in (0.3, 1.0):
        for degrees in (0.0, 60.0, 85.0):
            brute = reflected_share(
                lambda *vectors, a=alpha: lobe(*vectors, a, torch.ones_like), degrees, 160
            )
            own = albedo(alpha)(towards(degrees)[:, 2:])
            assert own.item() == pytest.approx(brute[0].item(), abs=2e-3)


def test_powder_is_the_mean_by_area() -> None:
    flakes, ground = Foil("gold", 0.4), WHITE
    map_ = torch.tensor([0.0, 0.25, 1.0], dtype=torch.float64).view(1, 1, 1, 3)
    light, view = towards(30), towards(-40)
    f = Powder(flakes, ground, map_).of_unit_vectors(UP, light, view)
    ends = [x.of_unit_vectors(UP, light, view) for x in (ground, flakes)]
    torch.testing.assert_close(f[..., :1], ends[0].expand(1, 3, 1, 1))
    torch.testing.assert_close(f[..., 2:], ends[1])
    torch.testing.assert_close(f[..., 1:2], 0.75 * ends[0] + 0.25 * ends[1])
    assert coverage(torch.tensor([0.0, 1.0]))[1] == pytest.approx(1 - math.exp(-1))


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Coated(WHITE, absorption=-1.0), "absorption: .* gain"),
        (lambda: Coated(WHITE, absorption=(1, 2)), "absorption: expected one number or three"),
        (lambda: Coated(WHITE, absorption=(1, 2, math.nan)), "absorption"),
        (lambda: Coated(WHITE, thickness=-0.1), "thickness: expected 0 mm or more"),
        (lambda: Coated(WHITE, index=0.9), "index: expected 1…4"),
        (lambda: Coated(WHITE, roughness=0.0), "roughness: .* above 0"),
        (lambda: Coated(WHITE, roughness=1.5), "roughness: .* at most 1"),
        (lambda: Coated("shell"), "base: expected a material"),
        (lambda: Coated(WHITE, base_in="water"), "base_in"),
        (lambda: Foil("brass"), "metal: expected one of gold, silver, mirror"),
        (lambda: Foil("gold", roughness=2.0), "roughness"),
        (lambda: Foil("gold", medium=0.5), "medium: expected an index in 1…4"),
        (lambda: Powder(Foil("gold"), WHITE, -0.1), "density: expected 0…1"),
        (lambda: Powder(Foil("gold"), WHITE, torch.full((1, 1, 2, 2), math.nan)), "density"),
        (lambda: Coated(WHITE, thickness=math.inf), "thickness: expected 0 mm or more"),
        (lambda: Coated(WHITE, absorption=math.inf), "absorption"),
        (lambda: Lambertian((1.2, 0, 0)), "albedo"),
        (lambda: Powder(Foil("gold"), WHITE, 1.2), "density: expected 0…1"),
        (lambda: Powder(Foil("gold"), WHITE, torch.full((1, 1, 2, 2), 1.01)), "density"),
        (lambda: Powder(Foil("gold"), WHITE, torch.zeros(2, 2)), r"density: .* \[B, 1, H, W\]"),
    ],
)
def test_what_cannot_be_is_refused(make: Callable[[], Any], message: str) -> None:
    with pytest.raises(InputError, match=message):
        make()


def test_a_base_that_makes_light_is_refused() -> None:
    class Gain(Lambertian):
        def __post_init__(self) -> None:
            pass

    with pytest.raises(InputError, match="reflects less than all light"):
        Coated(Gain((3.0, 1.0, 1.0))).formula(UP, UP, towards(10))
