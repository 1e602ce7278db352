"""Tables of materials: what the fused kernel reads, against the formulas; their white furnace."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import torch
from torch import Tensor

import raden_torch as rt
from raden_torch.brdf.materials.coat import Coated
from raden_torch.brdf.materials.metal import Foil, Powder
from raden_torch.brdf.materials.palette import Palette
from raden_torch.brdf.materials.urushi import Lambertian, black_urushi
from raden_torch.brdf.model import shading_kernel, simd
from raden_torch.errors import InputError

UP = torch.tensor([0.0, 0.0, 1.0], dtype=torch.float64).view(1, 3, 1, 1)
WHITE = Lambertian((1.0, 1.0, 1.0))
SPRINKLED = Powder(Foil("gold", 0.4), Foil("silver", 0.2), 0.3)
MATERIALS: dict[str, Any] = {
    "narrow mirror": Foil("mirror", 0.07),
    "mirror": Foil("mirror", 0.3),
    "coat over white": Coated(WHITE, roughness=0.07),
    "coat over mirror": Coated(Foil("mirror", 0.4, 1.53), roughness=0.3),
    "gold": Foil("gold"),
    "powder": SPRINKLED,
}
NODES = {"narrow mirror": 400, "coat over white": 260}
"""Of the furnace's quadrature, for lobes of α 0.07; 160 for wider ones."""


def luminous_albedo(material: Any, degrees: float, nodes: int) -> float:
    """By Gauss-Legendre in the polar angle and the midpoint rule in the azimuth: about the normal,
    where the tables are bounded by a rule about the mirror direction."""
    x, weight = np.polynomial.legendre.leggauss(nodes)
    theta = torch.from_numpy((x + 1) * math.pi / 4)[:, None]
    phi = (torch.arange(nodes, dtype=torch.float64) + 0.5) / nodes * math.pi
    view = torch.stack(
        [theta.sin() * phi.cos(), theta.sin() * phi.sin(), theta.cos().expand(-1, nodes)]
    )[None]
    share = theta.cos() * theta.sin() * torch.from_numpy(weight)[:, None] * math.pi**2 / 2 / nodes
    a = math.radians(degrees)
    light = torch.tensor([math.sin(a), 0, math.cos(a)], dtype=torch.float64).view(1, 3, 1, 1)
    rgb = (material.of_unit_vectors(UP, light, view) * share).sum((0, 2, 3))
    return float(rgb @ torch.tensor([0.2126, 0.7152, 0.0722], dtype=torch.float64))


@pytest.mark.parametrize("name", MATERIALS)
def test_no_table_reflects_more_than_all_light(name: str) -> None:
    """Rationale: white furnace of what `shade` reads. Expected: at most 1, but for 0.2 % of the
    quadrature; what loses nothing, 1 within 2 %."""
    lossless = name not in ("gold", "powder")
    for degrees in (0.0, 0.3, 4.0, 30.0, 75.0, 85.0):
        found = luminous_albedo(MATERIALS[name], degrees, NODES.get(name, 160))
        assert found < 1.002, degrees
        assert found > (0.98 if lossless else 0.7), degrees


@pytest.mark.parametrize("name", ["gold", "powder", "mirror"])
def test_a_metals_table_is_its_formula(name: str, random_vectors) -> None:
    """Expected: 1 % of f_r on average in all but grazing geometries, as of a coat."""
    material = MATERIALS[name]
    light, view = random_vectors(4000, 1), random_vectors(4000, 2)
    inside = ((light[:, 2:] > 0.3) & (view[:, 2:] > 0.3)).expand(-1, 3, -1, -1)
    f, read = (
        x[inside]
        for x in (material.formula(UP, light, view), material.of_unit_vectors(UP, light, view))
    )
    assert ((read - f).abs() / f).mean() < 0.01
    assert not torch.equal(read, f)


def test_nothing_is_infinite_where_lamp_and_viewer_graze_together() -> None:
    """Rationale: a lobe over cos θi cos θr is infinite there, and a node that held it would shine
    over its whole cell."""
    for material in (MATERIALS["mirror"], MATERIALS["coat over white"]):
        largest = material.runtime_brdf().values.amax((1, 2, 3))
        assert largest[0] < 100
        assert (largest[0] < 20 * largest[1:].amin()).all()


def frame() -> tuple[rt.GBuffer, list[Any]]:
    generator = torch.Generator().manual_seed(3)
    normal = torch.randn(1, 3, 20, 70, generator=generator) * 0.3 + UP.float()
    lights = [rt.DirectionalLight((0.3, 0.2, 1)), rt.PointLight((0, 1, 3), 4.0)]
    position = torch.zeros_like(normal)
    return rt.GBuffer(normal, position=position, camera=(0, 0, 4)), lights


@pytest.mark.skipif(not simd.LEVELS, reason="the kernel was not built here")
@pytest.mark.parametrize("name", ["gold", "powder"])
def test_metals_are_shaded_by_the_fused_kernel(name: str, monkeypatch) -> None:

    gbuffer, lights = frame()
    double = {k: m.double() if isinstance(m, Tensor) else m for k, m in vars(gbuffer).items()}
    exact = rt.shade(MATERIALS[name], rt.GBuffer(**double), lights)
    calls, one = [], shading_kernel.shade
    monkeypatch.setattr(shading_kernel, "shade", lambda *a: (calls.append(a), one(*a))[1])
    found = rt.shade(MATERIALS[name], gbuffer, lights)
    assert len(calls) == 1
    torch.testing.assert_close(found.double(), exact, rtol=1e-3, atol=1e-5)


def test_a_map_of_powder_is_the_mean_of_two_images(monkeypatch) -> None:
    """In one pass of the kernel, where it was built."""

    calls, several = [], shading_kernel.shade_several
    monkeypatch.setattr(
        shading_kernel, "shade_several", lambda *a: (calls.append(a), several(*a))[1]
    )
    gbuffer, lights = frame()
    density = torch.linspace(-0.3, 1.3, 70).clamp(0, 1).expand(1, 1, 20, 70).clone()
    mask = (torch.rand(1, 1, 20, 70, generator=torch.Generator().manual_seed(1)) > 0.4).float()
    flakes, ground = Foil("gold", 0.4), black_urushi(0.3)
    for cut in (gbuffer, replace(gbuffer, mask=mask)):
        ends = [rt.shade(x, cut, lights) for x in (ground, flakes)]
        found = rt.shade(Powder(flakes, ground, density), cut, lights)
        torch.testing.assert_close(found, torch.lerp(*ends, density), rtol=1e-5, atol=1e-7)
    one = rt.shade(Powder(flakes, ground, torch.full((1, 1, 1, 1), 0.25)), gbuffer, lights)
    torch.testing.assert_close(
        one, rt.shade(Powder(flakes, ground, 0.25), gbuffer, lights), rtol=0.02, atol=1e-4
    )
    assert len(calls) == (3 if simd.LEVELS else 0)


def test_the_gradient_of_a_map_of_powder_is_the_difference() -> None:
    gbuffer, lights = frame()
    density = torch.full((1, 1, 20, 70), 0.4, requires_grad=True)
    flakes, ground = Foil("gold", 0.4), Lambertian((0.1, 0.1, 0.1))
    rt.shade(Powder(flakes, ground, density), gbuffer, lights).sum().backward()
    gold, grey = (rt.shade(x, gbuffer, lights).sum(1, keepdim=True) for x in (flakes, ground))
    torch.testing.assert_close(density.grad, gold - grey, rtol=1e-4, atol=1e-4)


def test_a_map_of_powder_of_another_size_is_one_line() -> None:
    gbuffer, lights = frame()
    powder = Powder(Foil("gold"), WHITE, torch.zeros(1, 1, 3, 4))
    with pytest.raises(InputError, match=r"^density: expected a map \[1, 1, 20, 70\][^\n]*$"):
        rt.shade(powder, gbuffer, lights)
    chosen = replace(gbuffer, material=torch.zeros(1, 1, 20, 70, dtype=torch.long))
    with pytest.raises(InputError, match=r"in a palette, give flakes and ground"):
        rt.shade(Palette([powder, WHITE]), chosen, lights)
