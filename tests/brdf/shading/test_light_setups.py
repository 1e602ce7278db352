"""Light setups: their solid angles against closed forms; their place; the command line."""

from __future__ import annotations

import math

import pytest
import torch

from raden_torch.brdf.shading import latlong
from raden_torch.brdf.shading.light_setups import light_setup
from raden_torch.cli.picture_options import EnvironmentOptions
from raden_torch.errors import InputError


def covered(name: str, above: float) -> float:
    """Solid angle that shines at more than `above`."""
    radiance = light_setup(name).radiance[0].double()
    return float(((radiance > above) * latlong.solid_angles(*radiance.shape)).sum())


def rectangle(wide: float, high: float, distance: float) -> float:
    """Of a rectangle seen from over its middle."""
    a, b, d = wide / 2, high / 2, distance
    return 4 * math.atan(a * b / (d * math.sqrt(a * a + b * b + d * d)))


def test_sizes_are_as_documented() -> None:
    assert covered("softbox", 0.3) == pytest.approx(
        rectangle(0.6, 0.9, math.hypot(0.9, 0.4)), rel=0.03
    )
    away = math.hypot(1.5, 0.6, 0.5)
    panes = rectangle(1.2, 1.5, away) - rectangle(1.2, 0.06, away) - rectangle(0.06, 1.5, away)
    assert covered("window", 0.5) == pytest.approx(panes + rectangle(0.06, 0.06, away), rel=0.05)
    opening = 2 * math.pi * (1 - 0.3 / math.hypot(0.3, 0.06))
    assert 4 * math.pi - covered("tent", 0.2) == pytest.approx(opening, rel=0.1)


@pytest.mark.parametrize(
    ("name", "place"), [("softbox", (0.0, 0.9, -0.4)), ("window", (-1.5, 0.6, 0.5))]
)
def test_they_stand_where_they_are_said_to(name: str, place: tuple[float, float, float]) -> None:
    lamp = light_setup(name).lamps("all")
    weights = lamp.irradiance[:, 0] * (lamp.irradiance[:, 0] > 0.3 * lamp.irradiance[:, 0].max())
    found = torch.nn.functional.normalize((lamp.directions * weights[:, None]).sum(0), dim=0)
    wanted = torch.nn.functional.normalize(torch.tensor(place, dtype=found.dtype), dim=0)
    assert float(found @ wanted) > 0.97


def test_options_choose_one() -> None:
    (light,) = EnvironmentOptions(
        light_setup="tent", rotate_environment=30.0, environment_intensity=2.0
    ).lights()
    assert (light.rotation_deg, light.intensity) == (30.0, 2.0)
    with pytest.raises(InputError, match="give one"):
        EnvironmentOptions(environment="a.hdr", light_setup="tent")
    with pytest.raises(InputError, match="expected one of tent, window, softbox, got 'sun'"):
        light_setup("sun")
