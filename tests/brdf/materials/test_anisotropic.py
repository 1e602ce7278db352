"""A model for each azimuth: which one a tangent chooses, frames, and invalid tangents."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
import torch
from torch import Tensor

import raden_torch as rt
from raden_torch.brdf.fitting.by_azimuth import fit_by_azimuth
from raden_torch.brdf.materials.anisotropic import AnisotropicBrdf, sample_azimuth
from raden_torch.brdf.materials.palette import Palette
from raden_torch.brdf.model.reflectance_table import ReflectanceTable
from raden_torch.brdf.shading.eager import shade_eagerly
from raden_torch.brdf.shading.fused import shade_turned
from raden_torch.errors import InputError
from raden_torch.geometry import normalised


def lit(model, gbuffer: rt.GBuffer, lights) -> tuple[Tensor, Tensor]:
    """By the fused kernel, and by the eager form in double precision."""
    with torch.no_grad():
        fused = shade_turned(model, gbuffer, lights)
        assert fused is not None
        wide = {k: v.double() for k, v in vars(gbuffer).items() if isinstance(v, Tensor)}
        return fused, shade_eagerly(model, replace(gbuffer, **wide), lights)


def flat(value: float) -> rt.RadenBrdf:
    table = ReflectanceTable(torch.full((3, 5, 5, 3), value), (0.0, -70, -70), (35.0, 35.0, 35.0))
    return rt.RadenBrdf(None, table).double()


@pytest.fixture(scope="module")
def turned() -> AnisotropicBrdf:
    return AnisotropicBrdf([flat(x) for x in (0.0, 1.0, 4.0, 9.0)], (0, 90, 180, 270))


def goniometer(a: float, r: float, t: float, azimuth: float) -> tuple[Tensor, ...]:
    """N, L, V as `geometry` places them, and the mark on a sample that stands turned by `azimuth`
    about N: at 0 it points across N, in the measuring plane, to the viewer's side."""
    angles = (torch.tensor(math.radians(x)).double().view(1, 1, 1, 1) for x in (a, r, t))
    n, l, v = rt.vectors_from_angles(*angles)  # noqa: E741
    p = torch.linalg.cross(l, v, dim=1)
    if (p * torch.linalg.cross(l, n, dim=1)).sum() < 0:
        p = -p
    x = normalised(torch.linalg.cross(p, n, dim=1))
    y = torch.linalg.cross(n, x, dim=1)
    turn = math.radians(azimuth)
    return n, l, v, math.cos(turn) * x + math.sin(turn) * y


GEOMETRIES = [(20.0, 40.0, 10.0), (50.0, -10.0, -30.0), (10.0, -45.0, 20.0), (30.0, 30.0, 0.0)]


@pytest.mark.parametrize("geometry", GEOMETRIES)
@pytest.mark.parametrize(
    ("azimuth", "expected"), [(0, 0), (45, 0.5), (90, 1), (200, 46 / 9), (315, 4.5)]
)
def test_the_tangent_chooses_the_azimuth(turned, geometry, azimuth, expected) -> None:
    """Linear between the azimuths of a model, around the circle; of any length and lean."""
    n, l, v, tangent = goniometer(*geometry, azimuth)  # noqa: E741
    with torch.no_grad():
        found = turned(n, l, v, tangent * 7 + 3 * n)
    assert found.flatten().tolist() == pytest.approx([expected] * 3, abs=1e-6)


def test_the_picture_turns_with_the_frame(turned, random_vectors) -> None:
    n, l, v, t = (random_vectors(2000, seed) for seed in (1, 2, 3, 4))  # noqa: E741
    q, _ = torch.linalg.qr(torch.randn(3, 3, generator=torch.Generator().manual_seed(1)).double())
    q = q * torch.linalg.det(q)
    with torch.no_grad():
        before = turned(n, l, v, t)
        after = turned(*(torch.einsum("ij,bjhw->bihw", q, m) for m in (n, l, v, t)))
    torch.testing.assert_close(after, before, rtol=1e-7, atol=1e-7)
    assert float(before.std()) > 0.5


def test_without_a_tangent_it_is_the_mean_and_half_a_turn_is_a_period(turned) -> None:
    n, l, v, tangent = goniometer(20, 40, 10, 30)  # noqa: E741
    with torch.no_grad():
        assert turned(n, l, v).flatten().tolist() == pytest.approx([3.5] * 3)
        half = AnisotropicBrdf([flat(1.0), flat(2.0)], (0, 90), period_deg=180)
        torch.testing.assert_close(half(n, l, v, tangent), half(n, l, v, -tangent))


def test_shade_reads_the_tangents_of_a_gbuffer(turned) -> None:
    n, l, v, tangent = goniometer(20, 40, 10, 90)  # noqa: E741
    lamp = rt.DirectionalLight(tuple(l.flatten().tolist()), irradiance=1.0)
    gbuffer = rt.GBuffer(n, v, tangent=tangent)
    with torch.no_grad():
        image = rt.shade(turned, gbuffer, lamp)
        none = rt.shade(turned, rt.GBuffer(n, v), lamp)
    cosine = float((n * l).sum())
    assert image.flatten().tolist() == pytest.approx([cosine] * 3)
    assert none.flatten().tolist() == pytest.approx([3.5 * cosine] * 3)


@pytest.mark.parametrize("length", [0.0, math.nan, math.inf, 1.0])
def test_a_tangent_that_is_none_is_an_invalid_pixel(turned, length) -> None:
    """Zero, not finite, or parallel to the normal."""
    n, l, v, _ = goniometer(20, 40, 10, 0)  # noqa: E741
    with torch.no_grad():
        assert (turned(n, l, v, n * length) == 0).all()


def test_lamp_and_viewer_in_one_direction() -> None:
    n, l, _, _ = goniometer(40, -39.999, 0, 0)  # noqa: E741
    across = n - l / (n * l).sum()
    for turn in (0.0, 70.0):
        a = math.radians(turn)
        side = normalised(across)
        tangent = math.cos(a) * side + math.sin(a) * torch.linalg.cross(n, side, dim=1)
        azimuth, valid = sample_azimuth(n, l, l, tangent)
        assert valid.all()
        assert torch.isfinite(azimuth).all()
    azimuth, _ = sample_azimuth(n, n, n, tangent)
    assert azimuth.item() == 0


def test_a_measurement_at_several_azimuths_is_fitted_azimuth_by_azimuth() -> None:
    """Two shells as one sample at two azimuths: with the tangent each is found as if alone."""
    parts = [rt.simulate_specimen(name, step_deg=35) for name in ("akoya", "yakogai")]
    columns = [np.concatenate([m.angles_deg[:, k] for m in parts]) for k in range(3)]
    both = rt.BrdfMeasurement(
        *columns,
        np.concatenate([m.values for m in parts]),
        channels=parts[0].channels,
        azimuth_deg=np.repeat([0.0, 90.0], [len(m) for m in parts]),
    )
    result = fit_by_azimuth(both)
    model = result.model
    assert model.azimuth_deg == (0.0, 90.0)
    assert model.period_deg == 180.0
    assert list(result.report.each) == [0.0, 90.0]
    assert "azimuth 90 deg\n" in str(result.report)
    for turn, part in zip((0, 90), parts, strict=True):
        n, l, v, tangent = (m.float() for m in goniometer(20, 30, 5, turn))  # noqa: E741
        with torch.no_grad():
            alone = rt.fit(part).model(n, l, v)  # on its own nodes, not those of both
            torch.testing.assert_close(model(n, l, v, tangent), alone, rtol=2e-3, atol=1e-6)
    with pytest.raises(InputError, match="expected readings at several sample azimuths, got 1"):
        fit_by_azimuth(parts[0])


@pytest.mark.parametrize(
    ("azimuths", "period", "message"),
    [((0,), 360, "two or more"), ((0, 360), 360, "differ within 360"), ((0, 180), 180, "differ"),
     ((0, 90), 90, "expected 180 or 360"), ((0, math.nan), 360, "azimuth_deg")],
)  # fmt: skip
def test_bad_azimuths_are_one_line(azimuths, period, message) -> None:
    with pytest.raises(InputError, match=message) as error:
        AnisotropicBrdf([flat(1.0)] * len(azimuths), azimuths, period_deg=period)
    assert "\n" not in str(error.value)


@pytest.fixture(scope="module")
def uneven() -> AnisotropicBrdf:
    """Three shells at azimuths that are not evenly spaced."""
    shells = [
        rt.fit(rt.simulate_specimen(name, step_deg=35), interpolation="trilinear").model
        for name in ("akoya", "yakogai", "abalone")
    ]
    return AnisotropicBrdf(shells, (10.0, 100.0, 310.0))


def scene(
    random_vectors, *, layers: bool = False, one_tangent: bool = False
) -> tuple[rt.GBuffer, list[rt.Light]]:
    """90 pixels in no order, some below the horizon, masked out or without a tangent."""
    normal, position, tangent, lean = (
        random_vectors(90, seed).float().view(1, 3, 9, 10) for seed in (1, 2, 3, 4)
    )
    normal[:, 2] = normal[:, 2].abs() + 0.3
    tangent[..., 0, 0] = normal[..., 0, 0]
    tangent[..., 1, 0] = math.nan
    mask = torch.rand(1, 1, 9, 10, generator=torch.Generator().manual_seed(5))
    mask[..., 2, :] = 0
    gbuffer = rt.GBuffer(
        normal,
        position=position,
        camera=(0.1, 0.2, 5.0),
        mask=mask,
        layer_normal=normal + 0.2 * lean if layers else None,
        tangent=tangent[..., 3:4, 3:4] if one_tangent else tangent,
    )
    lights = [
        rt.DirectionalLight((1.0, 0.5, 2.0)),
        rt.PointLight((0.5, -0.4, 3.0), (5.0, 4.0, 3.0)),
        rt.SpotLight((1.0, 1.0, 3.0), (-0.3, -0.3, -1.0), 9.0, 20.0, 40.0),
    ]
    return gbuffer, lights


@pytest.mark.parametrize("layers", [False, True])
@pytest.mark.parametrize("one_tangent", [False, True])
def test_the_fused_kernel_is_the_eager_form(uneven, random_vectors, layers, one_tangent) -> None:
    gbuffer, lights = scene(random_vectors, layers=layers, one_tangent=one_tangent)
    fused, eager = lit(uneven, gbuffer, lights)
    assert float(eager.max()) > 0.01
    torch.testing.assert_close(fused.double(), eager, rtol=1e-4, atol=1e-6)
    with torch.no_grad():
        assert torch.equal(rt.shade(uneven, gbuffer, lights), fused)
    if not one_tangent:
        if not layers:  # parallel to the normal that the table is read by
            assert (fused[..., 0, 0] == 0).all()
        assert (fused[..., 1, 0] == 0).all()  # not a number


def test_a_mask_changes_no_other_pixel(uneven, random_vectors) -> None:
    """Bit for bit, where it cuts the tiles whose pixels are then shaded together."""
    _, lights = scene(random_vectors)
    normal, tangent = (random_vectors(2000, k).float().view(1, 3, 8, 250) for k in (1, 3))
    gbuffer = rt.GBuffer(normal, position=0.1 * tangent, camera=(0.1, 0.2, 5.0), tangent=tangent)
    mask = (torch.rand(1, 1, 8, 250, generator=torch.Generator().manual_seed(6)) < 0.2).float()
    with torch.no_grad():
        image = shade_turned(uneven, gbuffer, lights)
        found = shade_turned(uneven, replace(gbuffer, mask=mask), lights)
    assert image is not None
    assert found is not None
    assert torch.equal(found, image * mask)
    assert float(found.max()) > 0


def test_even_azimuths_take_another_way_in_the_kernel_to_the_same(random_vectors, uneven) -> None:
    gbuffer, lights = scene(random_vectors)
    for azimuths, period in (((30.0, 150.0, 270.0), 360.0), ((0.0, 60.0, 120.0), 180.0)):
        even = AnisotropicBrdf(list(uneven), azimuths, period_deg=period)
        fused, eager = lit(even, gbuffer, lights)
        torch.testing.assert_close(fused.double(), eager, rtol=1e-4, atol=1e-6)


def test_without_a_tangent_the_picture_is_that_of_the_mean_model(uneven, random_vectors) -> None:
    gbuffer, lights = scene(random_vectors)
    plain = replace(gbuffer, tangent=None)
    with torch.no_grad():
        image = rt.shade(uneven, plain, lights)
        assert torch.equal(image, rt.shade(uneven.mean(), plain, lights))
        each = []
        for model in uneven:
            model.layout = uneven.layout
            each.append(rt.shade(model, plain, lights))
    torch.testing.assert_close(image, torch.stack(each).mean(0), rtol=1e-4, atol=1e-6)


def test_gradients_reach_the_models_and_the_tangent() -> None:
    model = AnisotropicBrdf([flat(1.0), flat(2.0)], (0, 90), period_deg=180)
    n, l, v, tangent = goniometer(20, 40, 10, 30)  # noqa: E741
    tangent = tangent.clone().requires_grad_()
    f = model(n, l, v, tangent).sum()
    f.backward()
    for part in model:
        assert float(part.table.values.grad.abs().sum()) > 0
    # a third of the way from 1 to 2; turned by one radian about N it is 2/π further
    turn = torch.linalg.cross(n, tangent.detach(), dim=1)
    assert float((tangent.grad * turn).sum()) == pytest.approx(3 * 2 / math.pi, rel=1e-5)


def test_a_palette_may_hold_one(uneven, random_vectors) -> None:
    gbuffer, lights = scene(random_vectors)
    index = torch.arange(90).view(1, 1, 9, 10) % 2
    palette = Palette([uneven, uneven.models[0]])
    with torch.no_grad():
        both = rt.shade(palette, replace(gbuffer, material=index), lights)
        alone = rt.shade(uneven, gbuffer, lights)
    torch.testing.assert_close(both * (index == 0), alone * (index == 0), rtol=1e-5, atol=1e-7)


def two_shells(azimuths: tuple[float, ...], steps: tuple[float, ...]) -> rt.BrdfMeasurement:
    parts = [
        rt.simulate_specimen("yakogai", step_deg=step, azimuth_deg=(azimuth,))
        for azimuth, step in zip(azimuths, steps, strict=True)
    ]
    angles = np.concatenate([m.angles_deg for m in parts]).T
    return rt.BrdfMeasurement(
        *angles,
        np.concatenate([m.values for m in parts]),
        azimuth_deg=np.concatenate([m.azimuth_deg for m in parts]),
    )


def test_azimuths_may_have_other_grids_and_are_read_by_an_encoder() -> None:
    result = fit_by_azimuth(two_shells((359.9, 90.0), (35.0, 17.5)), interpolation="trilinear")
    assert result.model.azimuth_deg == pytest.approx((90.0, 179.9))
    assert tuple(result.report.each) == result.model.azimuth_deg
    assert len({model.layout for model in result.model}) == 1
    jitter = two_shells((0.0, 0.1), (35.0, 35.0))
    with pytest.raises(InputError, match="several sample azimuths, got 1"):
        fit_by_azimuth(jitter)


@pytest.mark.parametrize(
    ("azimuths", "period"), [((300, 0, 60), 180), ((0, 120, 240), 360), ((0, 180), 360)]
)
def test_azimuths_within_half_a_turn_have_half_a_turn_as_their_period(azimuths, period) -> None:
    measurement = two_shells(azimuths, (35.0,) * len(azimuths))
    assert fit_by_azimuth(measurement, interpolation="trilinear").model.period_deg == period


def test_an_azimuth_of_few_readings_is_named() -> None:
    whole = two_shells((0.0, 45.0), (35.0, 35.0))
    few = whole.select(np.arange(len(whole)) < len(whole) // 2 + 1)
    with pytest.raises(InputError, match=r"^sample azimuth 45 degrees: ") as error:
        fit_by_azimuth(few)
    assert "\n" not in str(error.value)


@pytest.mark.slow
def test_a_shell_of_known_planes_is_found_at_its_azimuths() -> None:
    """Yakogai's planes lean along y: turned by 90 degrees it is seen across them. On a grid of 10
    degrees its lobes are known to some percent."""
    azimuths = (0.0, 90.0)
    shell = rt.simulate_specimen("yakogai", step_deg=10, azimuth_deg=azimuths)
    model = fit_by_azimuth(shell, interpolation="cubic").model
    angles = np.array([[20.0, 20.0, 10.0], [30.0, 50.0, 0.0]])
    for azimuth in azimuths:
        true = rt.simulate_specimen("yakogai", geometries_deg=angles, azimuth_deg=(azimuth,))
        for row, geometry in enumerate(angles):
            n, l, v, tangent = (m.float() for m in goniometer(*geometry, azimuth))  # noqa: E741
            with torch.no_grad():
                found = 100 * math.pi * model(n, l, v, tangent).flatten().numpy()
                mean = 100 * math.pi * model(n, l, v).flatten().numpy()
            wanted = true.as_rgb().values[row]
            assert np.abs(found - wanted).max() < 0.06 * wanted.max()
            assert np.abs(mean - wanted).max() > 0.1 * wanted.max()
