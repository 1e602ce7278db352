"""A model for each azimuth: which one a tangent chooses, frames, and invalid tangents."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch
from torch import Tensor

import raden_torch as rt
from raden_torch.brdf.fitting.by_azimuth import fit_by_azimuth
from raden_torch.brdf.materials.anisotropic import AnisotropicBrdf, sample_azimuth
from raden_torch.brdf.model.reflectance_table import ReflectanceTable
from raden_torch.errors import InputError
from raden_torch.geometry import normalised


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
    model = fit_by_azimuth(both)
    assert model.azimuth_deg == (0.0, 90.0)
    assert model.period_deg == 180.0
    for turn, part in zip((0, 90), parts, strict=True):
        n, l, v, tangent = (m.float() for m in goniometer(20, 30, 5, turn))  # noqa: E741
        with torch.no_grad():
            alone = rt.fit(part).model(n, l, v)
            torch.testing.assert_close(model(n, l, v, tangent), alone, rtol=1e-4, atol=1e-6)
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
