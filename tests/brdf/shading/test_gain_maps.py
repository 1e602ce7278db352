"""Gains that differ by pixel: eq. (2) with I_d and I_s as maps."""

from __future__ import annotations

import pytest
import torch

import raden_torch as rt
from raden_torch.brdf.materials.palette import Palette
from raden_torch.brdf.materials.urushi import Lambertian
from raden_torch.errors import InputError
from raden_torch.geometry import angles_from_unit_vectors, dot, normalised

LAMP = rt.DirectionalLight((0.4, 0.3, 1.0), 2.0)
UP = torch.tensor([0.0, 0.0, 1.0]).view(1, 3, 1, 1)


@pytest.fixture(scope="module")
def shell() -> rt.RadenBrdf:
    return rt.fit(rt.simulate_specimen("yakogai", step_deg=10), interpolation="trilinear").model


def maps(dtype: torch.dtype = torch.float32) -> dict[str, torch.Tensor]:
    draw = torch.Generator().manual_seed(2)

    def uniform(*shape: int) -> torch.Tensor:
        return torch.rand(*shape, generator=draw, dtype=torch.float64).to(dtype)

    normal = torch.cat([0.6 * uniform(2, 2, 30, 40) - 0.3, torch.ones(2, 1, 30, 40)], 1).to(dtype)
    return {
        "normal": normal,
        "diffuse_gain": 2 * uniform(2, 1, 30, 40),
        "specular_gain": 2 * uniform(1, 3, 30, 40),
    }


def lit(model: object, **more: torch.Tensor) -> torch.Tensor:
    return rt.shade(model, rt.GBuffer(view=(0, 0, 1), **more), LAMP)


def test_they_are_eq_2_itself(shell: rt.RadenBrdf) -> None:
    """Against the fit form, of another code: within what baking adds to the model as it is."""
    given = maps(torch.float64)
    n = normalised(given["normal"])
    toward = torch.tensor(LAMP.direction, dtype=torch.float64).view(1, 3, 1, 1)
    light = (toward / toward.norm()).expand_as(n)
    angles = angles_from_unit_vectors(n, light, UP.double().expand_as(n))
    body = shell.diffuse(*angles)
    total, weight = shell.table(*angles)
    facing = LAMP.irradiance * dot(n, light)

    def by_formula(i_d: torch.Tensor | float, i_s: torch.Tensor | float) -> torch.Tensor:
        return (i_d * body + i_s * weight * (total - body)) * facing

    image = lit(shell, **given)
    error = (image - by_formula(given["diffuse_gain"], given["specular_gain"])).abs()
    plain = (lit(shell, normal=given["normal"]) - by_formula(1.0, 1.0)).abs()
    assert error.mean() < 2 * plain.mean() + 1e-9  # gains to 2
    assert error.max() < 3 * plain.max()
    assert (image - lit(shell, normal=given["normal"])).abs().mean() > 20 * error.mean()


def test_constant_maps_are_the_models_own_gains(shell: rt.RadenBrdf, dtype: torch.dtype) -> None:
    normal = maps(dtype)["normal"]
    full = torch.ones(1, 1, 30, 40, dtype=dtype)
    image = lit(shell, normal=normal, diffuse_gain=0.4 * full, specular_gain=1.7 * full)
    other = rt.RadenBrdf(
        shell.diffuse, shell.table, diffuse_gain=0.4, specular_gain=1.7, layout=shell.layout
    )
    wanted = lit(other, normal=normal)
    scale = float(wanted.detach().abs().max())
    assert (image - wanted).abs().max() < (1e-5 if dtype == torch.float32 else 1e-6) * scale
    # and they multiply these
    again = lit(other, normal=normal, diffuse_gain=0.5 * full, specular_gain=full)
    other.diffuse_gain = 0.2
    assert (again - lit(other, normal=normal)).abs().max() < 1e-5 * scale


def test_a_gain_on_the_whole_and_in_a_palette(shell: rt.RadenBrdf) -> None:
    given = maps()
    gain, normal = given["specular_gain"], given["normal"]
    body = Lambertian((0.2, 0.5, 0.7))
    for model in (shell, body):
        image = lit(model, normal=normal, diffuse_gain=gain, specular_gain=gain)
        torch.testing.assert_close(image, lit(model, normal=normal) * gain)
    index = (torch.arange(40) % 2).view(1, 1, 1, 40)
    both = lit(
        Palette([shell, body]), normal=normal, material=index, diffuse_gain=gain, specular_gain=gain
    )
    for place, model in enumerate((shell, body)):
        wanted = (lit(model, normal=normal) * gain)[..., place::2]
        torch.testing.assert_close(both[..., place::2], wanted)
    apart = lit(Palette([shell]), material=torch.zeros_like(index), **given)
    torch.testing.assert_close(apart, lit(shell, **given))
    with pytest.raises(InputError, match="expected a RadenBrdf, which has the two parts, got Lamb"):
        lit(body, **given)


def test_gradients_reach_the_gains(shell: rt.RadenBrdf) -> None:
    given = maps(torch.float64)
    for name in ("diffuse_gain", "specular_gain"):
        given[name] = given[name][:1, :, :3, :3].requires_grad_()
    normal = given["normal"][:1, :, :3, :3]

    def image(d: torch.Tensor, s: torch.Tensor) -> torch.Tensor:
        return lit(shell, normal=normal, diffuse_gain=d, specular_gain=s)

    inputs = (given["diffuse_gain"], given["specular_gain"])
    assert torch.autograd.gradcheck(image, inputs, eps=1e-5, atol=1e-7)


@pytest.mark.parametrize(
    ("gain", "message"),
    [
        (torch.full((1, 1, 2, 2), -0.1), r"diffuse_gain: expected finite factors of 0 .* got -0.1"),
        (torch.full((1, 3, 2, 2), torch.nan), "expected finite factors of 0 or more, got nan"),
        (
            torch.ones(1, 2, 2, 2),
            r"expected floating-point \[1, 1 or 3, 2, 2\], got .*\[1, 2, 2, 2",
        ),
        (torch.ones(1, 1, 2, 3), r"got torch.float32 \[1, 1, 2, 3\]"),
        (torch.ones(1, 1, 2, 2, dtype=torch.int64), "expected floating-point"),
        (0.5, "GBuffer diffuse_gain: expected Tensor, got float"),
    ],
)
def test_what_is_no_gain(gain: object, message: str) -> None:
    with pytest.raises(InputError, match=message) as error:
        rt.GBuffer(UP.expand(1, 3, 2, 2), (0, 0, 1), diffuse_gain=gain)
    assert "\n" not in str(error.value)
