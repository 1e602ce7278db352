"""Lamps with a shape over a white diffuser, against closed forms of the irradiance."""

from __future__ import annotations

import math

import pytest
import torch

import raden_torch as rt
from raden_torch.brdf.shading.area_lights import DiscLight, RectangleLight, SphereLight
from raden_torch.errors import InputError


class White:
    """f_r = 1/π, so that radiance is irradiance / π."""

    def working_dtype(self, *maps):
        return torch.float64

    def of_unit_vectors(self, n, l, v):  # noqa: E741
        return torch.full_like(n + l, 1 / math.pi)


def irradiance(light, normal=(0.0, 0.0, 1.0)) -> float:
    n = torch.tensor(normal, dtype=torch.float64).view(1, 3, 1, 1)
    gbuffer = rt.GBuffer(n, view=normal, position=torch.zeros(1, 3, 1, 1, dtype=torch.float64))
    return float(rt.shade(White(), gbuffer, light)[0, 1]) * math.pi


@pytest.mark.parametrize("height", [0.7, 1.5, 6.0])
def test_a_rectangle_has_its_form_factor(height) -> None:
    """Rationale: a patch parallel to a corner's quarter sees 1/(2π) Σ a/√(1+a²) atan(b/√(1+a²))."""
    light = RectangleLight((0, 0, height), (2, 0, 0), (0, -1, 0), 3.0)
    a, b = 1 / height, 0.5 / height
    corner = a / math.hypot(1, a) * math.atan(b / math.hypot(1, a))
    corner += b / math.hypot(1, b) * math.atan(a / math.hypot(1, b))
    assert irradiance(light) == pytest.approx(3 * 4 * corner / 2, rel=0.01)
    assert irradiance(RectangleLight((0, 0, height), (2, 0, 0), (0, 1, 0))) == 0  # its back


@pytest.mark.parametrize("height", [0.7, 1.5, 6.0])
def test_a_disc_on_its_axis(height) -> None:
    light = DiscLight((0, 0, height), (0, 0, -2), 0.5, 2.0)
    expected = 2 * math.pi * 0.25 / (0.25 + height**2)
    assert irradiance(light) == pytest.approx(expected, rel=0.01)


@pytest.mark.parametrize("angle_deg", [0, 40])
def test_a_ball_falls_with_the_square_of_the_distance(angle_deg) -> None:
    """Rationale: above the horizon, E = π L (r/d)² cos θ, exactly."""
    angle = math.radians(angle_deg)
    light = SphereLight((2 * math.sin(angle), 0, 2 * math.cos(angle)), 0.6)
    expected = math.pi * 0.3**2 * math.cos(angle)
    assert irradiance(light) == pytest.approx(expected, rel=0.01)


def test_far_away_it_is_a_distant_lamp() -> None:
    light = RectangleLight((0, 300, 400), (5, 0, 0), (0, -4, 3), 10.0)
    area_vector = 25 * 10.0 / 500**2  # it faces the pixel
    distant = rt.DirectionalLight((0, 3, 4), area_vector)
    assert irradiance(light) == pytest.approx(irradiance(distant), rel=1e-3)


def test_bad_lamps_are_refused() -> None:
    with pytest.raises(InputError, match="span an area"):
        RectangleLight((0, 0, 1), (1, 0, 0), (2, 0, 0))
    with pytest.raises(InputError, match="radius above 0"):
        SphereLight((0, 0, 1), 0.0)
    with pytest.raises(InputError, match="radius above 0"):
        DiscLight((0, 0, 1), (0, 0, 1), math.nan)
    up = torch.tensor([0.0, 0.0, 1.0]).view(1, 3, 1, 1)
    with pytest.raises(InputError, match="expected a G-buffer with position"):
        rt.shade(White(), rt.GBuffer(up, view=(0, 0, 1)), SphereLight((0, 0, 1), 0.1))
