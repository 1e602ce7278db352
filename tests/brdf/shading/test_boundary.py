"""What a caller gives in another form: masks, colours and layouts."""

from __future__ import annotations

import numpy as np
import pytest
import torch

import raden_torch as rt
from raden_torch.errors import InputError

FLAT = torch.tensor([0.0, 0.0, 1.0]).view(1, 3, 1, 1).expand(1, 3, 4, 5)
FLAT_SCENE = rt.GBuffer(FLAT, view=(0.0, 0.0, 1.0))
LAMP = rt.DirectionalLight((0.2, 0.1, 1.0))


@pytest.fixture(scope="module")
def model() -> rt.RadenBrdf:
    m = rt.simulate_specimen("yakogai", step_deg=10.0)
    return rt.fit(m, interpolation="trilinear").model


def shaded(model: rt.RadenBrdf, mask: torch.Tensor | None, lamp=LAMP) -> torch.Tensor:
    gbuffer = rt.GBuffer(FLAT, view=(0.0, 0.3, 1.0), mask=mask)
    with torch.no_grad():
        return rt.shade(model, gbuffer, [lamp])


@pytest.mark.parametrize("stored", [0, 51, 128, 255])
def test_an_8_bit_mask_is_scaled(model: rt.RadenBrdf, stored: int) -> None:
    mask = torch.full((1, 1, 4, 5), 255, dtype=torch.uint8)
    mask[..., 1] = stored
    whole = shaded(model, None)
    expected = whole.clone()
    expected[..., 1] *= stored / 255
    torch.testing.assert_close(shaded(model, mask), expected)


@pytest.mark.parametrize("kind", [torch.bool, torch.uint8, torch.int64, torch.float32])
def test_a_mask_of_0_and_1_is_taken_as_it_is(model: rt.RadenBrdf, kind: torch.dtype) -> None:
    mask = torch.ones(1, 1, 4, 5, dtype=kind)
    mask[..., 2:] = 0
    expected = shaded(model, None)
    expected[..., 2:] = 0
    torch.testing.assert_close(shaded(model, mask), expected)


def test_integers_without_a_known_scale_are_refused() -> None:
    with pytest.raises(InputError, match=r"mask: expected bool.*got torch.int64 up to 7"):
        rt.GBuffer(FLAT, view=(0.0, 0.0, 1.0), mask=torch.full((1, 1, 4, 5), 7))


@pytest.mark.parametrize("value", [2.0, torch.tensor(2.0)])
def test_one_number_is_the_same_in_all_channels(model: rt.RadenBrdf, value) -> None:
    lamp = rt.DirectionalLight((0.2, 0.1, 1.0), irradiance=value)
    three = rt.DirectionalLight((0.2, 0.1, 1.0), irradiance=(2.0, 2.0, 2.0))
    assert torch.equal(shaded(model, None, lamp), shaded(model, None, three))


def test_a_gbuffer_is_one_line() -> None:
    text = repr(rt.GBuffer(FLAT, view=(0.0, 0.0, 1.0)))
    assert text == "GBuffer(normal=[1, 3, 4, 5], view=[1, 3, 1, 1], torch.float32, cpu)"


@pytest.mark.parametrize(
    ("given", "call", "convert"),
    [
        (
            np.ones((4, 5, 3)),
            "torch.from_numpy(x).movedim(-1, 0)[None]",
            lambda x: torch.from_numpy(x).movedim(-1, 0)[None],
        ),
        (torch.ones(4, 5, 3), "x.movedim(-1, 0)[None]", lambda x: x.movedim(-1, 0)[None]),
        (torch.ones(1, 4, 5, 3), "x.movedim(-1, 1)", lambda x: x.movedim(-1, 1)),
        (torch.ones(7, 3), "x.T[None, :, :, None]", lambda x: x.T[None, :, :, None]),
    ],
)
def test_the_error_names_the_call_that_converts(given, call: str, convert) -> None:
    view = torch.ones(1, 3, 1, 1)
    with pytest.raises(InputError) as caught:
        rt.raden_angles(given, view, view)
    assert str(caught.value).endswith(f"; convert it by {call}")
    assert rt.raden_angles(convert(given), view, view)[0].shape[0] == 1


def test_a_lamp_below_the_horizon_is_said(model: rt.RadenBrdf) -> None:
    from raden_torch.brdf.shading.shade import warn_if_black

    lamp = rt.DirectionalLight((0.0, 0.0, -1.0))
    image = shaded(model, None, lamp)
    assert not image.any()
    with pytest.warns(UserWarning, match=r"black: no lamp \(DirectionalLight 0,0,-1\)"):
        warn_if_black(image, [lamp])
    warn_if_black(shaded(model, None), [LAMP])
    warn_if_black(image, [])


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (
            lambda m: rt.fit("shell.csv"),
            "measurement: expected BrdfMeasurement, got str; load",
        ),
        (lambda m: rt.shade(m, FLAT, [LAMP]), "gbuffer: expected GBuffer, got Tensor; make it by"),
        (lambda m: rt.shade(m, FLAT_SCENE, None), "lights: expected Sequence or .*, got NoneType"),
        (lambda m: rt.shade(m, FLAT_SCENE, [(0, 0, 1)]), r"lights\[0\]: expected .*, got tuple"),
        (lambda m: rt.shade(m, FLAT_SCENE, [LAMP], tolerance="x"), "tolerance: expected float"),
        (lambda m: rt.shade(m, FLAT_SCENE, [LAMP], tolerance=-1), "tolerance: expected a radiance"),
        (lambda m: rt.export_onnx("m.safetensors", "m.onnx"), "model: expected RadenBrdf, got str"),
        (
            lambda m: rt.save_model(None, "m.safetensors"),
            "model: expected RadenBrdf or Palette or SpectralBrdf, got NoneType",
        ),
        (
            lambda m: rt.GBuffer(FLAT, view=(0.0, 0.0, 1.0), mask=np.ones((1, 1, 4, 5))),
            r"GBuffer mask: expected Tensor, got ndarray; convert it by torch\.as_tensor",
        ),
        (lambda m: rt.GBuffer(FLAT, view=(0, 0, 1), mask=[1.0]), "mask: expected Tensor, got list"),
        (
            lambda m: rt.GBuffer.from_depth(torch.ones(1, 1, 4, 5), np.eye(3)),
            "intrinsics: expected Tensor, got ndarray",
        ),
        (
            lambda m: rt.GBuffer.from_depth([1.0], torch.eye(3)),
            "depth: expected Tensor, got list",
        ),
    ],
)
def test_another_type_is_named(model: rt.RadenBrdf, call, message: str) -> None:
    with pytest.raises(InputError, match=message):
        call(model)


def test_numpy_numbers_are_numbers(model: rt.RadenBrdf) -> None:
    with torch.no_grad():
        expected = rt.shade(model, FLAT_SCENE, [LAMP], tolerance=0.25)
        found = rt.shade(model, FLAT_SCENE, [LAMP], tolerance=np.float32(0.25))
    assert torch.equal(found, expected)
