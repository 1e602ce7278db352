"""Normals by a model against simulated truth: analytic shells, film optics, shadows, few lamps."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from raden_torch.brdf.materials.simulated_shell import SimulatedShell
from raden_torch.brdf.materials.urushi import Lambertian
from raden_torch.capture.photo.ball import ball_from_mask
from raden_torch.capture.photo.capture_lights import capture_lights
from raden_torch.capture.photo.lamps import write_lamps
from raden_torch.capture.photo.matt_reference import angle_deg, sphere_normals
from raden_torch.capture.photo.photo_set import read_mask
from raden_torch.capture.photo.photometric_stereo import solve_normals
from raden_torch.errors import InputError
from raden_torch.measurement.colour_conversion import xyz_to_rgb_matrix
from raden_torch.optics.specimens import SPECIMENS, reflectance_factors
from raden_torch.stereo.alternating import alternate
from raden_torch.stereo.capture_model_normals import ModelOptions, capture_model_normals
from raden_torch.stereo.lamp_assignment import check_order
from raden_torch.stereo.normal_refine import refine
from raden_torch.stereo.normal_search import hemisphere, tangents
from raden_torch.stereo.observed_light import ObservedLight, shown
from raden_torch.stereo.solve import learnt, residuals, solve_by_model
from tests.stereo.scenes import (
    VIEW,
    Scene,
    Shell,
    lamps_around,
    off_deg,
    photographed,
    shell,
    sphere,
    unit,
)


def matt_error(scene: Scene) -> float:
    """Median, in degrees, by the Lambertian law, robustly."""
    light = scene.light
    saturated = light.usable[:, :, None] == 0
    found = solve_normals(
        light.value[:, :, None], torch.tensor(scene.lamps).float(), saturated=saturated
    )
    return float(np.median(off_deg(found.normal[0, :, 0], scene.true)))


def yakogai(n: np.ndarray, to: np.ndarray) -> np.ndarray:
    """f_r of films under a clear coat, by the library's optics and angles of its own."""
    axis = unit(np.cross(to, VIEW))
    lean = (n * axis).sum(-1)
    flat = unit(n - lean[:, None] * axis)

    def turned(a: np.ndarray, b: np.ndarray) -> np.ndarray:
        return np.arctan2((np.cross(a, b) * axis).sum(-1), (a * b).sum(-1))

    view = np.broadcast_to(VIEW, n.shape)
    a = turned(to, flat)
    angles = np.stack([a, turned(flat, view), np.arcsin(lean.clip(-1, 1))], -1)
    angles = np.degrees(angles) * np.where(a < 0, -1, 1)[:, None]
    return reflectance_factors(SPECIMENS["yakogai"], angles) @ xyz_to_rgb_matrix().T / 314.16


def test_a_model_halves_the_error(scene: Scene) -> None:
    """Expected: no more than half of what the Lambertian law gives, and errors as they are said."""
    found = solve_by_model([Shell()], scene.light)
    off = off_deg(found.normal, scene.true)
    said = found.error_deg.numpy()
    assert np.median(off) < 0.5 * matt_error(scene)
    assert np.median(off) < 0.2
    assert (off < 2 * said).mean() > 0.9
    assert np.median(said) < 8 * np.median(off)
    sure = said < np.median(said)
    assert np.median(off[sure]) < np.median(off[~sure])


def test_film_optics_by_a_baked_table() -> None:
    """Yakogai: photographs by film optics at the true angles, a model read from a table."""
    normal, mask = sphere(24)
    lamps = lamps_around(12)

    scene = Scene(photographed(normal, mask, lamps, yakogai), lamps, normal, mask)
    found = solve_by_model([SimulatedShell("yakogai")], scene.light)
    assert np.median(off_deg(found.normal, scene.true)) < 0.5 * matt_error(scene)


def test_shadows_and_strange_light_do_not_matter(scene: Scene) -> None:
    """A tenth of all values black or bright, as cast shadows and other lamps' images are."""
    rng = np.random.default_rng(3)
    linear = scene.linear.copy()
    spoilt = rng.random(linear.shape[:3]) < 0.1
    linear[spoilt] = rng.choice([0.0, 0.6], spoilt.sum())[:, None]
    found = solve_by_model([Shell()], replace(scene, linear=linear).light)
    assert np.median(off_deg(found.normal, scene.true)) < 0.4


def test_each_pixel_takes_the_material_that_fits(scene: Scene) -> None:
    """Left half one shell, right half another: an index a pixel."""
    other = photographed(scene.normal, scene.mask, scene.lamps, lambda n, to: shell(n, to, 2.0))
    right = np.arange(scene.mask.shape[1]) >= scene.mask.shape[1] / 2
    mixed = np.where(right[None, None, :, None], other, scene.linear)
    found = solve_by_model([Shell(), Shell(2.0)], replace(scene, linear=mixed).light)
    truth = np.broadcast_to(right, scene.mask.shape)[scene.mask]
    assert (found.member.numpy() == truth).mean() > 0.97
    assert np.median(off_deg(found.normal, scene.true)) < 0.3


def test_few_lamps_are_less_sure() -> None:
    """Three lamps beside each other leave more open than ten all around, and that is said."""
    normal, mask = sphere(24)
    lamps = unit(np.array([[0.5, 0.0, 1.0], [0.55, 0.05, 1.0], [0.5, 0.1, 1.0]]))
    scene = Scene(photographed(normal, mask, lamps, shell), lamps, normal, mask)
    few = solve_by_model([Shell()], scene.light)
    around = lamps_around(10)
    scene_10 = Scene(photographed(normal, mask, around, shell), around, normal, mask)
    many = solve_by_model([Shell()], scene_10.light)
    assert few.error_deg.median() > 4 * many.error_deg.median()
    assert few.confidence.median() < many.confidence.median()


def test_a_table_without_variation_says_so() -> None:
    """A matt material under one lamp seen three times: which way the normal turns is not told."""
    lamp = torch.tensor([[0.0], [0.0], [1.0]]).expand(3, 3, 1)
    view = torch.tensor([[0.0], [0.0], [1.0]])
    normal = unit(np.array([[0.4, 0.0, 1.0], [0.0, -0.6, 1.0]])).T
    material = Lambertian((0.5, 0.5, 0.5))
    light = ObservedLight(
        torch.zeros(3, 3, 2), torch.ones(3, 1, 2), lamp, torch.ones(3, 1, 1), view, 1e-3
    )
    light = replace(light, value=shown(material, torch.tensor(normal).float(), light))
    found = solve_by_model([material], light)
    assert (found.error_deg > 15).all(), found.error_deg


@settings(max_examples=20, deadline=None)
@given(
    x=st.floats(-0.7, 0.7),
    y=st.floats(-0.7, 0.7),
    turn=st.floats(0, 6.28),
    gain=st.floats(0.05, 20),
)
def test_refinement_comes_back(x: float, y: float, turn: float, gain: float) -> None:
    """Without noise, from 2 degrees away and a wrong scale, it finds normal and scale again."""
    normal = torch.tensor(unit(np.array([x, y, 1.0]))).float()[:, None]
    lamps = torch.tensor(lamps_around(10)).float()[:, :, None]
    view = torch.tensor([[0.0], [0.0], [1.0]])
    strength = torch.ones(10, 1, 1)
    light = ObservedLight(
        torch.zeros(10, 3, 1), torch.ones(10, 1, 1), lamps, strength, view, 1e-3 * gain
    )
    light = replace(light, value=gain * shown(Shell(), normal, light))
    a, b = tangents(normal)
    start = normal + 0.035 * (np.cos(turn) * a + np.sin(turn) * b)
    start = start / start.norm(dim=0)
    found = refine(Shell(), light, start, torch.tensor([1.3 * gain]), rounds=20)
    assert off_deg(found.normal, normal.double().numpy().T)[0] < 0.05
    assert float(found.gain) == pytest.approx(gain, rel=0.01)


def test_a_hemisphere_is_even() -> None:
    """Every direction within 80 degrees of the axis has a normal within 2/3 of the step."""
    axis = torch.nn.functional.normalize(torch.tensor([0.3, -0.2, 1.0]), dim=0)
    normals = hemisphere(axis, 3.0)
    v = torch.nn.functional.normalize(torch.randn(3, 500), dim=0)
    v = v[:, (axis @ v) > np.cos(np.radians(80))]
    assert (v.T @ normals).amax(1).min() > np.cos(np.radians(2.4))


def test_normals_and_material_in_turn(scene: Scene) -> None:
    """Without a model: far better than the Lambertian law, and it says that it is; films that lie
    under a clear face are told from a bare surface."""
    found = alternate(scene.light)
    assert found.is_better
    assert found.table.index == 1.0
    assert np.median(off_deg(found.found.normal, scene.true)) < 0.25 * matt_error(scene)
    lamps = lamps_around(12)
    linear = photographed(scene.normal, scene.mask, lamps, yakogai)
    coated = replace(scene, linear=linear, lamps=lamps)
    found = alternate(coated.light)
    assert found.is_better
    assert found.table.index == 1.5
    assert np.median(off_deg(found.found.normal, scene.true)) < 0.35 * matt_error(coated)


def test_background_and_uneven_brightness_do_not_matter(scene: Scene) -> None:
    uneven = np.where(np.indices(scene.mask.shape).sum(0) // 4 % 2, 1.0, 0.35)[..., None]
    everything = np.ones_like(scene.mask)
    light = replace(scene, linear=scene.linear * uneven, mask=everything).light
    found = alternate(light)
    assert found.is_better
    assert found.table.index == 1.0
    normal = found.found.normal[:, torch.tensor(scene.mask.ravel())]
    assert np.median(off_deg(normal, scene.true)) < 0.35 * matt_error(scene)


def test_a_gloss_that_few_lamps_show_is_a_material(scene: Scene) -> None:
    def gloss(n: np.ndarray, to: np.ndarray) -> np.ndarray:
        miss = np.linalg.norm(np.cross(n, unit(to + VIEW)), axis=-1, keepdims=True)
        return np.tile(0.06 * (1 + 8 * np.exp(-((miss / 0.08) ** 2) / 2)), 3)

    linear = photographed(scene.normal, scene.mask, scene.lamps, gloss)
    assert alternate(replace(scene, linear=linear).light).is_better


def test_photographs_without_light_are_refused(scene: Scene) -> None:
    with pytest.raises(InputError, match="expected pixels that are lit and not clipped, got none"):
        alternate(replace(scene, linear=np.zeros_like(scene.linear)).light)


def test_of_a_body_that_is_nearly_matt_it_is_said(shared: Path, tmp_path: Path) -> None:
    """A real grey sphere, whose outline tells its normals: 4.0 degrees by the Lambertian law."""
    data, lights = shared / "data/photometric_stereo", tmp_path / "lights.json"
    chrome, grey = ([data / f"{n}.{k}.png" for k in range(12)] for n in ("chrome", "gray"))
    lamps = capture_lights(chrome, [data / "chrome.mask.png"], coded="linear").lamps
    write_lamps(lamps, lights, made_from=chrome)
    outline = read_mask(data / "gray.mask.png", (340, 512))
    ball = ball_from_mask(outline, name="gray.mask.png")
    true, _ = sphere_normals(ball, outline.shape)
    inside = ball.inside(outline.shape, 0.95)
    with pytest.warns(UserWarning, match="hardly better than a matt body"):
        found = capture_model_normals(
            grey, lights, data / "gray.mask.png", ModelOptions(coded="linear")
        )
    off = angle_deg(found.surface.normal[0][:, inside], true[0][:, inside])
    assert float(off.median()) < 3.7


def test_what_cannot_be_found_in_turn_is_said(scene: Scene) -> None:
    matt = photographed(scene.normal, scene.mask, scene.lamps, lambda n, to: np.full(n.shape, 0.2))
    assert not alternate(replace(scene, linear=matt).light).is_better
    few = replace(scene, linear=scene.linear[:5], lamps=scene.lamps[:5])
    with pytest.raises(InputError, match="at least 6 to find normals and material together, got 5"):
        alternate(few.light)
    flat = np.zeros_like(scene.normal) + VIEW
    linear = photographed(flat, scene.mask, scene.lamps, shell)
    with pytest.raises(InputError, match="expected normals that spread by 10 degrees"):
        alternate(replace(scene, linear=linear).light)


def test_exchanged_photographs_are_named(scene: Scene) -> None:
    order = np.arange(10)
    names = [Path(f"photo{k:02d}.png") for k in range(10)]
    for swapped in (False, True):
        if swapped:
            order[[2, 7]] = order[[7, 2]]
        light = replace(scene, linear=scene.linear[order]).light
        found = solve_by_model([Shell()], light, known=learnt([Shell()], light))
        radiance, _ = residuals([Shell()], light, found)
        said = check_order(radiance, light, names)
        assert (said is None) is not swapped
    assert "photo02.png under lamp 8, photo07.png under lamp 3" in said
