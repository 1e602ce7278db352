"""The solver of photometric stereo, step by step, against NumPy's and SciPy's own."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from scipy.optimize import linprog

from raden_torch.capture.photo.intensity_fit import refined_intensity
from raden_torch.capture.photo.lambert_fit import inverse_moments, scaled_lights, weighted_fit
from raden_torch.capture.photo.lights_check import check_lights
from raden_torch.capture.photo.lit_pixels import LitPixels, PixelStack, sorted_lamps
from raden_torch.capture.photo.tile_threads import in_threads
from raden_torch.errors import InputError

LAMPS, PIXELS = 9, 40


def directions(count: int = LAMPS, seed: int = 0) -> torch.Tensor:
    random = np.random.default_rng(seed)
    v = random.normal(size=(count, 3)) * 0.5 + [0, 0, 1]
    return torch.from_numpy(v / np.linalg.norm(v, axis=1, keepdims=True))


def noisy(lights: torch.Tensor, noise: float = 0.02) -> tuple[LitPixels, np.ndarray]:
    """Pixels of random b = ρ N that all lamps light, and that b."""
    random = np.random.default_rng(1)
    b = random.normal(size=(3, PIXELS)) * 0.2 + np.array([[0], [0], [0.8]])
    clean = np.einsum("kip,ip->kp", lights.reshape(len(lights), 3, -1).expand(-1, -1, PIXELS), b)
    grey = torch.from_numpy(clean + noise * random.normal(size=clean.shape))
    return LitPixels(grey[:, None], grey, lights, torch.ones_like(grey)), b


@pytest.mark.parametrize("near", [False, True], ids=["far", "near"])
def test_least_squares_are_numpy_s(near: bool) -> None:
    lights = directions()
    if near:
        wobble = np.random.default_rng(2).normal(size=(LAMPS, 3, PIXELS)) * 0.05
        lights = lights[..., None] + torch.from_numpy(wobble)
    pixels, _ = noisy(lights)
    found, weight = weighted_fit(pixels, lights, "least-squares")
    assert (weight == 1).all()
    for p in range(PIXELS):
        design = lights.numpy() if not near else lights[..., p].numpy()
        wanted, *_ = np.linalg.lstsq(design, pixels.grey[:, p].numpy(), rcond=None)
        np.testing.assert_allclose(found[:, p], wanted, atol=2e-5)  # a ridge of 1e-6


def test_robust_is_the_smallest_sum_of_absolute_residuals() -> None:
    """Against a linear programme: min Σ e, −e ≤ I − L·b ≤ e; a third of the values are wrong."""
    lights = directions(15)
    pixels, truth = noisy(lights, noise=0.005)
    pixels.grey[::5] += 0.3  # a highlight in every fifth photograph
    found, _ = weighted_fit(pixels, lights, "robust")
    design, k = lights.numpy(), len(lights)
    for p in range(0, PIXELS, 5):
        grey = pixels.grey[:, p].numpy()
        solved = linprog(
            np.r_[np.zeros(3), np.ones(k)],
            A_ub=np.block([[design, -np.eye(k)], [-design, -np.eye(k)]]),
            b_ub=np.r_[grey, -grey],
            bounds=[(None, None)] * 3 + [(0, None)] * k,
        )
        left = np.abs(grey - design @ found[:, p].numpy()).sum()
        assert left < 1.02 * solved.fun
    off = np.linalg.norm(found.numpy() - truth, axis=0)
    squares, _ = weighted_fit(pixels, lights, "least-squares")
    assert np.median(off) < 0.2 * np.median(np.linalg.norm(squares.numpy() - truth, axis=0))


def test_selection_drops_the_lamps_that_agree_least() -> None:
    lights = directions(12)
    pixels, truth = noisy(lights, noise=0.0)
    pixels.grey[[2, 7]] += 0.4
    found, weight = weighted_fit(pixels, lights, "selection")
    assert (weight[[2, 7]] == 0).double().mean() > 0.9
    off = np.linalg.norm(found.numpy() - truth, axis=0)
    assert np.median(off) < 1e-3


def test_the_moments_inverse_is_numpy_s() -> None:
    lights = directions()
    weight = torch.from_numpy(np.random.default_rng(3).random((LAMPS, PIXELS)) + 0.1)
    xx, yy, zz, xy, xz, yz = (m.numpy() for m in inverse_moments(lights, weight))
    found = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    for p in range(PIXELS):
        wanted = np.linalg.inv((weight[:, p].numpy() * lights.numpy().T) @ lights.numpy())
        np.testing.assert_allclose(found[..., p], wanted, rtol=1e-3, atol=1e-4)


@pytest.mark.parametrize("count", [3, 4, 17])
def test_lamps_are_sorted_in_each_pixel(count: int) -> None:
    values = torch.rand(count, 200, generator=torch.Generator().manual_seed(count))
    before = values.clone()
    torch.testing.assert_close(sorted_lamps(values), values.sort(dim=0).values)
    torch.testing.assert_close(values, before)


def test_which_lamps_light_a_pixel() -> None:
    """Below a tenth of the third brightest is shadow; saturated values are not used."""
    images = torch.tensor([[1.0, 0.9, 0.8, 0.06, 0.5], [0.9, 0.8, 0.7, 0.06, 0.0]]).T
    saturated = torch.zeros(5, 2, dtype=torch.bool)
    saturated[0, 0] = True
    stack = PixelStack(images[:, None], saturated, directions(5), 0.1, 1.0, torch.float32)
    lit = stack.at(torch.tensor([0, 1])).lit
    assert lit[:, 0].tolist() == [0, 1, 1, 1, 1]  # above a tenth of 0.5
    assert lit[:, 1].tolist() == [1, 1, 1, 0, 0]
    squared = PixelStack(images[:, None], None, directions(5), 0.1, 2.0, torch.float64)
    np.testing.assert_allclose(squared.at(torch.tensor([0])).grey[:, 0], images[:, 0] ** 2)


def test_intensities_that_are_slightly_wrong_come_out_right() -> None:
    lights = directions(12)
    pixels, _ = noisy(lights, noise=0.001)
    true = torch.from_numpy(1 + 0.08 * np.random.default_rng(4).normal(size=12))
    true = true / true.mean()
    shone = LitPixels(
        pixels.value * true[:, None, None], pixels.grey * true[:, None], lights, pixels.lit
    )
    found = refined_intensity(shone, torch.ones(12, dtype=torch.float64), "least-squares")
    assert float(found.mean()) == pytest.approx(1)
    assert (found - true).abs().max() < 0.02
    assert (found - true).abs().max() < 0.2 * (1 - true).abs().max()
    torch.testing.assert_close(scaled_lights(lights, true)[3], lights[3] * true[3])


def test_lamps_in_one_plane_with_the_object() -> None:
    flat = torch.tensor([[1.0, 0, 1], [0.0, 0, 1], [-1.0, 0, 1], [0.5, 0, 1]])
    with pytest.raises(InputError, match=r"a\.json: expected lamps of spread 0\.03 or more"):
        check_lights(flat, "a.json")
    with pytest.raises(InputError, match="expected at least 3 lamps"):
        check_lights(flat[:2])
    with pytest.raises(InputError, match="a direction that is zero or not finite"):
        check_lights(torch.cat([flat, torch.zeros(1, 3)]))
    check_lights(directions())


def test_tiles_come_back_in_order_and_the_threads_are_torch_s_again() -> None:
    before = torch.get_num_threads()
    tiles = torch.arange(100).split(7)
    found = list(in_threads(lambda tile: tile * 2, tiles, torch.device("cpu")))
    torch.testing.assert_close(torch.cat(found), 2 * torch.arange(100))
    assert torch.get_num_threads() == before
