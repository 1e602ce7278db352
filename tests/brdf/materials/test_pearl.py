"""A simulated pearl: energy, reciprocity, where its colours are, its command, bad input."""

from __future__ import annotations

import math

import cv2
import numpy as np
import pytest
import torch

import raden_torch as rt
from raden_torch.brdf.materials.pearl import (
    BODY,
    NACRE_INDEX,
    NacreLayers,
    layer_reflectance,
    pearl,
)
from raden_torch.errors import InputError
from raden_torch.optics.nacre import Stack

UP = torch.tensor([0.0, 0.0, 1.0], dtype=torch.float64).view(1, 3, 1, 1)
THIN = Stack(tablet_nm=360.0, tablet_spread=0.03, tablets=40)  # as a pearl, in less time
WHITE = (1.0, 1.0, 1.0)


def at(theta_deg, phi_deg=0.0):
    theta, phi = math.radians(theta_deg), math.radians(phi_deg)
    xyz = [math.sin(theta) * math.cos(phi), math.sin(theta) * math.sin(phi), math.cos(theta)]
    return torch.tensor(xyz, dtype=torch.float64).view(1, 3, 1, 1)


def all_directions(nodes=160):
    """Directions `[1, 3, nodes, nodes]` and cos θ dω."""
    x, weight = np.polynomial.legendre.leggauss(nodes)
    theta = torch.from_numpy((x + 1) * math.pi / 4)
    phi = (torch.arange(nodes, dtype=torch.float64) + 0.5) / nodes * math.pi
    t, p = torch.meshgrid(theta, phi, indexing="ij")
    share = t.cos() * t.sin() * torch.from_numpy(weight)[:, None] * math.pi**2 / 2 / nodes
    return torch.stack([t.sin() * p.cos(), t.sin() * p.sin(), t.cos()])[None], share


@pytest.mark.parametrize("incidence", [0, 40, 75])
def test_layers_over_white_reflect_all_light(incidence):
    """Rationale: what the films do not reflect the white body returns. Expected: 1 within 2 %."""
    light, share = all_directions()
    layers = NacreLayers(THIN, body=WHITE)
    albedo = (layers.of_unit_vectors(UP, light, at(incidence)) * share).sum((0, 2, 3))
    torch.testing.assert_close(albedo, torch.ones(3, dtype=torch.float64), atol=0.02, rtol=0)


@pytest.mark.parametrize("incidence", [0, 50, 75])
def test_a_pearl_reflects_no_more_than_arrives(incidence):
    light, share = all_directions()
    whole = pearl(THIN, body=WHITE, gloss_roughness=0.2).formula(UP, light, at(incidence))
    albedo = (whole * share).sum((0, 2, 3))
    torch.testing.assert_close(albedo, torch.ones(3, dtype=torch.float64), atol=0.02, rtol=0)
    dark = pearl(THIN, body=(0.0, 0.0, 0.0), gloss_roughness=0.2).formula(UP, light, at(incidence))
    less = (dark * share).sum((0, 2, 3))
    assert (less > 0.05).all()
    assert (less < 0.9).all()


def test_reciprocal():
    layers = NacreLayers(THIN)
    for a, b in ((at(20), at(65, 130)), (at(5, 40), at(80))):
        torch.testing.assert_close(
            layers.of_unit_vectors(UP, a, b), layers.of_unit_vectors(UP, b, a), rtol=1e-12, atol=0
        )
    assert (layers.of_unit_vectors(UP, at(100), at(20)) == 0).all()


def test_rose_at_the_middle_and_greener_towards_the_rim():
    """Akoya pearls are described with a rosé overtone seen straight on, and green around it.

    The films alone: red and blue over green at normal incidence; green over both at 70° in air.
    """
    films = layer_reflectance(Stack(tablet_nm=360.0, tablet_spread=0.03))
    outside = torch.tensor([0.0, 70.0], dtype=torch.float64).deg2rad()
    inside = torch.sqrt(1 - (outside.sin() / NACRE_INDEX) ** 2)
    middle, rim = films(inside.view(1, 1, 1, 2))[0, :, 0].T
    assert middle[0] > 1.5 * middle[1]
    assert middle[2] > 1.2 * middle[1]
    assert rim[1] > max(rim[0], rim[2]) + 0.1


def test_shade_takes_it():
    """The body's colour away from the highlight; the highlight is brighter than that; f32 maps."""
    made = pearl(THIN)
    gbuffer = rt.GBuffer(UP.float(), view=(0, 0, 1))
    facing = rt.shade(made, gbuffer, rt.DirectionalLight((0, 0, 1))).flatten()
    aside = rt.shade(made, gbuffer, rt.DirectionalLight((1, 0, 1))).flatten() * 2**0.5
    assert facing.min() > 10 * aside.max()
    body = torch.tensor(BODY)
    assert (aside > 0.4 * body).all()
    assert (aside < 1.1 * body).all()
    assert aside[0] > aside[2]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"body": (1.2, 0, 0)}, "albedo: expected three numbers in 0…1"),
        ({"layer_roughness": 0.0}, "roughness: expected GGX α above 0"),
        ({"stack": "akoya"}, "stack: expected Stack, got str"),
    ],
)
def test_bad_input_is_one_line(arguments, message):
    with pytest.raises(InputError, match=message) as error:
        pearl(**arguments)
    assert "\n" not in str(error.value)


@pytest.mark.slow
def test_the_command_lights_a_pearl(raden, tmp_path):
    picture = tmp_path / "pearl.png"
    done = raden("render", "pearl", "--shape", "sphere", "--size", 96, "-o", picture)
    assert done.returncode == 0, done.stderr
    image = cv2.imread(str(picture)).astype(float)
    assert image.max() == 255
    # a quarter of the sphere, away from the highlight: cream, red over blue
    aside = image[50:70, 20:40].mean((0, 1))
    assert aside[2] > aside[0] > 10
    plate = raden("render", "pearl", "--shape", "plate", "-o", tmp_path / "none.png")
    assert (plate.returncode, "expected sphere" in plate.stderr) == (2, True)
    missing = raden("render", "perl", "-o", tmp_path / "none.png", cwd=tmp_path)
    assert missing.returncode == 2
    assert "perl" in missing.stderr
