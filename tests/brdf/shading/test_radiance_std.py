"""Standard deviations of a picture: against Monte Carlo, by hand, and in the two forms."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from torch import Tensor

import raden_torch as rt
from raden_torch.brdf.fitting.interpolated_table import make_table
from raden_torch.brdf.fitting.tabulate import tabulate
from raden_torch.brdf.materials.palette import Palette
from raden_torch.brdf.model import simd
from raden_torch.brdf.model.model import RadenBrdf
from raden_torch.brdf.model.table_errors import TableErrors
from raden_torch.brdf.shading.environment import EnvironmentLight
from raden_torch.brdf.shading.radiance_std import RadianceStd
from raden_torch.brdf.shading.sphere_gbuffer import sphere
from raden_torch.errors import InputError
from raden_torch.measurement.error_parts import error_parts, zero_effects
from raden_torch.measurement.systematic_errors import SystematicErrors

STATED = SystematicErrors(scale_std=0.02, zero_std_deg=(0.2, 0.2, 0.2), white_deg=(45.0, 0.0, 0.0))
LAMP = rt.DirectionalLight((1.0, 1.0, 2.0))
FAR = rt.DirectionalLight((-1.0, -1.0, 2.0))
NEAR = rt.DirectionalLight((1.05, 1.05, 2.0))
DRAWS = 150


def stated(own: float = 0.01, common: SystematicErrors = STATED) -> rt.BrdfMeasurement:
    """A simulated shell in 405 geometries, with standard deviations."""
    m = rt.simulate_specimen("yakogai", step_deg=17.5)
    m = replace(m, metadata=replace(m.metadata, systematic=common))
    zeros = zero_effects(m) if any(common.zero_std_deg) else np.zeros((*m.values.shape, 3))
    return replace(m, std=np.sqrt((own * abs(m.values)) ** 2 + (zeros**2).sum(-1)))


@pytest.fixture(scope="module")
def fitted() -> tuple[rt.BrdfMeasurement, RadenBrdf]:
    m = stated()
    return m, rt.fit(m, interpolation="trilinear", outside="diffuse", std=True).model


@pytest.fixture(scope="module")
def model(fitted) -> RadenBrdf:
    return fitted[1]


@pytest.fixture(scope="module")
def ball() -> rt.GBuffer:
    return sphere(64, samples=1)


def shaded(model: RadenBrdf, gbuffer: rt.GBuffer, *lights) -> tuple[Tensor, RadianceStd]:
    with torch.no_grad():
        return rt.shade(model, gbuffer, list(lights), return_std=True)


def drawn(m: rt.BrdfMeasurement, kind: str) -> np.ndarray:
    """`[DRAWS, N, 3]` readings whose errors are as stated."""
    parts, random = error_parts(m, m.channels), np.random.default_rng(5)
    if kind == "own":
        noise = random.normal(size=(DRAWS, *parts.values.shape))
        return parts.values + np.sqrt(parts.variance) * noise
    common = random.normal(size=(DRAWS, 4))
    common -= common.mean(0)  # with exactly the stated covariance
    common = common @ np.linalg.inv(np.linalg.cholesky(common.T @ common / DRAWS)).T
    moved = parts.values + np.einsum("ncz,dz->dnc", parts.zeros, common[:, 1:])
    return moved * (1 + STATED.scale_std * common[:, :1, None])


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["own", "systematic"])
def test_it_is_what_pictures_of_drawn_measurements_scatter_by(fitted, ball, kind: str) -> None:
    """Rationale: measurements drawn from the stated errors, tabulated and shaded, in the box.

    Expected: propagated / scatter within 5 % in the median. In nine of ten pixels within 45 % for
    own errors: between the nodes their variance is read linearly, and its scatter over 150 draws is
    itself uncertain by 6 %. Within 5 % for systematic ones, which are drawn exactly.
    """
    m, model = fitted
    inside = _inside(ball, model)
    for lights in ([LAMP], [LAMP, FAR]):
        pictures = []
        for values in drawn(m, kind):
            table = tabulate(replace(m, values=values, std=None))
            other = RadenBrdf(
                model.diffuse,
                make_table(table, table.values, "trilinear", "diffuse"),
                layout=model.layout,
            )
            with torch.no_grad():
                pictures.append(rt.shade(other, ball, lights)[0][:, inside])
        scatter = torch.stack(pictures).double().std(0)
        image, std = shaded(model, ball, *lights)
        found = getattr(std, kind)[0][:, inside].double()
        ratio = found / scatter
        assert float(ratio.median()) == pytest.approx(1.0, abs=0.05)
        low, high = ratio.flatten().quantile(torch.tensor([0.05, 0.95], dtype=torch.float64))
        width = 0.45 if kind == "own" else 0.05
        assert 1 - width < float(low) < float(high) < 1 + width
        assert torch.equal(std.total, torch.hypot(std.own, std.systematic))
        assert float((image[0][:, inside] > 0).float().mean()) > 0.99


def _inside(gbuffer: rt.GBuffer, model: RadenBrdf) -> Tensor:
    """`[H, W]`: lit by either lamp within the measured box, a step from its faces."""
    inside = gbuffer.mask[0, 0] > 0
    for lamp in (LAMP, FAR):
        light = torch.tensor(lamp.direction).view(1, 3, 1, 1).expand_as(gbuffer.normal)
        angles = rt.raden_angles(gbuffer.normal, light, gbuffer.view_map(gbuffer.normal))
        for angle, (low, high) in zip(angles, model.measured_box_deg, strict=True):
            degrees = torch.rad2deg(angle[0, 0])
            inside &= (degrees >= low) & (degrees <= high)
    assert inside.sum() > 300
    return inside


def test_the_scale_alone_is_a_share_of_the_image(ball) -> None:
    m = stated(own=0.0, common=SystematicErrors(scale_std=0.03, white_mean_std=0.04))
    model = rt.fit(m, interpolation="trilinear", outside="diffuse", std=True).model
    image, std = shaded(model, ball, LAMP, FAR)
    torch.testing.assert_close(std.systematic, 0.05 * image.abs(), rtol=1e-5, atol=1e-7)
    assert float(std.own.max()) < 1e-6 * float(image.max())


def test_lamps_that_read_other_cells_err_by_themselves_and_near_ones_together(model, ball) -> None:
    (_, one), (_, other), (_, near) = (shaded(model, ball, x) for x in (LAMP, FAR, NEAR))
    far = shaded(model, ball, LAMP, FAR)[1].own
    torch.testing.assert_close(far, torch.hypot(one.own, other.own), rtol=1e-4, atol=1e-7)
    together = shaded(model, ball, NEAR, FAR, LAMP)[1].own
    wanted = torch.hypot(one.own + near.own, other.own)
    torch.testing.assert_close(together, wanted, rtol=1e-4, atol=1e-7)


@pytest.mark.skipif(not simd.LEVELS, reason="the kernel was not built here")
@pytest.mark.parametrize("level", simd.LEVELS)
def test_the_kernel_and_the_eager_form_agree(model, ball, level: str) -> None:
    """Rationale: a visibility of 1 everywhere is shaded in torch."""
    generator = torch.Generator().manual_seed(2)
    tilted = ball.normal + 0.1 * torch.randn(ball.normal.shape, generator=generator)
    gbuffer = replace(ball, layer_normal=tilted, mask=0.7 * ball.mask)
    lights = [LAMP, rt.PointLight((0.5, 1.0, 3.0)), rt.SpotLight((-1.0, 0.0, 3.0), (0, 0, 0))]
    with simd.using(level):
        image, fused = shaded(model, gbuffer, *lights)
    seen = torch.ones_like(ball.mask)
    again, eager = shaded(model, gbuffer, *(replace(x, visibility=seen) for x in lights))
    with torch.no_grad():
        plain = rt.shade(model, gbuffer, lights)
    torch.testing.assert_close(image, plain, rtol=1e-5, atol=1e-6)
    torch.testing.assert_close(again, plain, rtol=1e-5, atol=1e-6)
    for part in ("own", "systematic"):
        mine, theirs = getattr(fused, part), getattr(eager, part)
        torch.testing.assert_close(mine, theirs, rtol=1e-4, atol=1e-6)
        assert bool((mine >= 0).all())
        assert not mine[(ball.mask == 0).expand_as(mine)].any()
        assert float((mine > 0).float().mean()) > 0.3


def test_a_frame_that_is_not_whole_tiles(model) -> None:
    """Rationale: 37 columns with holes; each pixel as in a frame of its own."""
    gbuffer = sphere(37, samples=1)
    image, std = shaded(model, gbuffer, LAMP)
    row = rt.GBuffer(
        gbuffer.normal[:, :, 20, 10:11, None],
        view=gbuffer.view_map(gbuffer.normal)[:, :, 20, 10:11, None],
    )
    alone, of_it = shaded(model, row, LAMP)
    for mine, theirs in ((image, alone), (std.own, of_it.own), (std.systematic, of_it.systematic)):
        torch.testing.assert_close(mine[0, :, 20, 10], theirs[0, :, 0, 0], rtol=1e-5, atol=1e-7)


@pytest.mark.skipif(not simd.LEVELS, reason="the kernel was not built here")
@pytest.mark.parametrize("level", simd.LEVELS)
@pytest.mark.parametrize("share", [0.02, 0.3, 0.9])
def test_a_mask_changes_no_other_pixel(model, level: str, share: float) -> None:
    """Rationale: pixels of tiles that a mask cuts are shaded together. Expected: all three images
    times the mask, bit for bit, in rows that follow one another and in a part of each."""
    whole = sphere(200, samples=1)
    mask = (torch.rand(1, 1, 200, 200, generator=torch.Generator().manual_seed(4)) < share).float()
    for columns in (slice(None), slice(3, 190)):
        part = rt.GBuffer(whole.normal[..., columns], view=(0.0, 0.3, 1.0))
        kept = mask[..., columns]
        with simd.using(level):
            image, std = shaded(model, part, LAMP, FAR)
            found, of_it = shaded(model, replace(part, mask=kept), LAMP, FAR)
        assert torch.equal(found, image * kept)
        assert torch.equal(of_it.own, std.own * kept)
        assert torch.equal(of_it.systematic, std.systematic * kept)
        assert float(found.max()) > 0


def test_without_lights_it_is_dark(model) -> None:
    image, std = rt.shade(model, sphere(70, samples=1), [], return_std=True)
    for each in (image, std.own, std.systematic):
        assert each.shape == (1, 3, 70, 70)
        assert not each.any()


def test_gradients_reach_the_image_and_not_the_std(model) -> None:
    normal = torch.tensor([0.1, 0.2, 1.0]).view(1, 3, 1, 1).requires_grad_()
    image, std = rt.shade(model, rt.GBuffer(normal, view=(0, 0, 1)), LAMP, return_std=True)
    image.sum().backward()
    assert normal.grad is not None
    assert bool((normal.grad != 0).any())
    assert not std.own.requires_grad
    assert not std.systematic.requires_grad


def test_a_file_keeps_them(model, ball, tmp_path: Path) -> None:
    path = tmp_path / "shell.safetensors"
    rt.save_model(model, path)
    loaded = rt.load_model(path)
    for mine, theirs in zip(shaded(model, ball, LAMP), shaded(loaded, ball, LAMP), strict=True):
        if isinstance(mine, Tensor):
            assert torch.equal(mine, theirs)
        else:
            assert torch.equal(mine.own, theirs.own)
            assert torch.equal(mine.systematic, theirs.systematic)
    rt.save_model(RadenBrdf(model.diffuse, model.table, layout=model.layout), path)
    assert rt.load_model(path).errors is None


def test_what_it_does_not_know_is_refused(model, ball) -> None:
    def refused(by: str, material=model, gbuffer=ball, light=LAMP) -> None:
        with pytest.raises(InputError, match=by) as caught:
            rt.shade(material, gbuffer, light, return_std=True)
        assert "\n" not in str(caught.value)

    without = RadenBrdf(model.diffuse, model.table, layout=model.layout)
    refused("fit --std", material=without)
    refused("got Palette", material=Palette([model]))
    refused("got EnvironmentLight", light=EnvironmentLight(torch.ones(3, 8, 16)))
    refused("without gains", gbuffer=replace(ball, specular_gain=torch.ones_like(ball.mask)))
    dimmed = RadenBrdf(
        model.diffuse, model.table, specular_gain=0.5, layout=model.layout, errors=model.errors
    )
    refused("both gains", material=dimmed)
    small = torch.zeros(3, 3, 3, 3)
    other = RadenBrdf(
        model.diffuse, model.table, layout=model.layout, errors=TableErrors(small, small[None], 0.0)
    )
    refused("layout", material=other)


@pytest.mark.parametrize(
    ("own", "shared", "scale", "message"),
    [
        (torch.zeros(3, 3, 3, 2), torch.zeros(0, 3, 3, 3, 2), 0.0, "expected own"),
        (torch.zeros(3, 3, 3, 3), torch.zeros(4, 3, 3, 3, 3), 0.0, "at most 3"),
        (-torch.ones(3, 3, 3, 3), torch.zeros(0, 3, 3, 3, 3), 0.0, "0 or more"),
        (torch.zeros(3, 3, 3, 3), torch.zeros(0, 3, 3, 3, 3), 1.5, "scale_std"),
    ],
)
def test_tables_that_are_none(own: Tensor, shared: Tensor, scale: float, message: str) -> None:
    with pytest.raises(InputError, match=message):
        TableErrors(own, shared, scale)


def test_a_measurement_that_states_nothing_is_refused() -> None:
    plain = rt.simulate_specimen("yakogai", step_deg=35)
    with pytest.raises(InputError, match="std_X"):
        rt.fit(plain, std=True)
    random = np.random.default_rng(0)
    scattered = replace(
        stated(),
        incidence_deg=np.clip(stated().incidence_deg + random.uniform(0, 3, 405), 0, 70),
    )
    with pytest.raises(InputError, match="got scattered ones"):
        rt.fit(scattered, std=True)
