"""Photometric stereo against known truth: made scenes with shadows, highlights and near lamps, and
the grey sphere of the shared photographs. Made scenes are simulated by the formulas below."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
import torch
from torch import Tensor

from raden_torch.capture.photo.ball import ball_from_mask
from raden_torch.capture.photo.highlight import find_highlight
from raden_torch.capture.photo.lambert_fit import METHODS
from raden_torch.capture.photo.lamp_order import check_order
from raden_torch.capture.photo.lamps import Lamps, lamps_from_balls
from raden_torch.capture.photo.matt_reference import (
    angle_deg,
    fit_response,
    relative_intensities,
    sphere_normals,
)
from raden_torch.capture.photo.photometric_stereo import solve_normals
from raden_torch.capture.photo.reference_body import normals_by_body
from raden_torch.errors import InputError

N = 96


def ring(count: int = 12, elevation_deg: float = 45.0) -> Tensor:
    """Two uneven rings of unit directions to lamps."""
    k = torch.arange(count, dtype=torch.float64)
    turn, up = 2.4 * k, torch.deg2rad(elevation_deg + 20 * torch.sin(1.7 * k))
    return torch.stack([up.cos() * turn.cos(), up.cos() * turn.sin(), up.sin()], dim=1)


def sphere() -> tuple[Tensor, Tensor]:
    x = (torch.arange(N, dtype=torch.float64) + 0.5) / N * 2.1 - 1.05
    y, x = torch.meshgrid(-x, x, indexing="ij")
    square = x * x + y * y
    mask = (square < 0.9)[None, None].double()
    return torch.stack([x, y, (1 - square).clamp(min=0).sqrt()])[None] * mask, mask


def waves() -> tuple[Tensor, Tensor, Tensor]:
    """A bumpy plate: normals, mask and height, in pixels."""
    x = torch.arange(N, dtype=torch.float64)
    y, x = torch.meshgrid(-x, x, indexing="ij")
    a, b, height = 0.12, 0.17, 4.0
    z = height * torch.sin(a * x) * torch.cos(b * y)
    p = height * a * torch.cos(a * x) * torch.cos(b * y)
    q = -height * b * torch.sin(a * x) * torch.sin(b * y)
    normal = torch.stack([-p, -q, torch.ones_like(p)])[None]
    return normal / normal.norm(dim=1, keepdim=True), torch.ones(1, 1, N, N).double(), z


def matt(normal: Tensor, lights: Tensor, albedo: float | Tensor = 0.6) -> Tensor:
    """`[K, 1, H, W]`: a Lambertian surface with attached shadows."""
    where = lights[:, :, None, None] if lights.ndim == 2 else lights
    return albedo * (where * normal).sum(1, keepdim=True).clamp(min=0)


def shine(normal: Tensor, lights: Tensor, power: float = 200.0) -> Tensor:
    """Blinn's highlight around the half vector, as bright as white."""
    half = lights + torch.tensor([0.0, 0.0, 1.0])
    half = half / half.norm(dim=1, keepdim=True)
    return (half[:, :, None, None] * normal).sum(1, keepdim=True).clamp(min=0) ** power


def cast(z: Tensor, lights: Tensor) -> Tensor:
    """`[K, 1, H, W]`, 0 where the height field hides the lamp: marching along the ray."""
    lit = torch.ones(len(lights), 1, *z.shape, dtype=torch.float64)
    grid = torch.stack(torch.meshgrid(*[torch.arange(n) for n in z.shape], indexing="ij")).double()
    for k, (x, y, up) in enumerate(lights.tolist()):
        for step in range(1, 60):
            row = (grid[0] - y * step).round().long().clamp(0, z.shape[0] - 1)
            column = (grid[1] + x * step).round().long().clamp(0, z.shape[1] - 1)
            lit[k, 0][z[row, column] > z + up * step + 0.3] = 0
    return lit


def errors(found: Tensor, true: Tensor, mask: Tensor) -> Tensor:
    inside = mask[0, 0] > 0.5
    return angle_deg(found[0].double()[:, inside], true[0][:, inside])


@pytest.mark.parametrize("method", METHODS)
def test_a_matt_sphere(method, dtype: torch.dtype, device: torch.device) -> None:
    """Rationale: where every pixel is matt and three lamps light it, the law is exact."""
    normal, mask = sphere()
    lights = ring()
    albedo = torch.linspace(0.2, 0.9, N, dtype=torch.float64)[None, None, None]
    images = matt(normal, lights, albedo).to(device, dtype)
    found = solve_normals(images, lights.to(device), mask.to(device), method=method, shadow=0.02)
    assert found.normal.dtype == dtype
    off = errors(found.normal.cpu(), normal, mask)
    assert off.median() < 0.01
    inside = (mask > 0) & (found.lamps_used.cpu() >= 5)
    close = (found.albedo.cpu().double() / albedo - 1).abs()[inside]
    assert close.median() < 1e-3
    assert (found.normal.cpu()[(mask == 0).expand_as(normal)] == 0).all()
    assert (found.confidence.cpu()[mask == 0] == 0).all()
    assert found.confidence.cpu()[inside].quantile(0.1) > 0.8


def test_robust_methods_survive_shadows_and_highlights() -> None:
    """Expected: plain least squares with all lamps is off by degrees; both others stay near."""
    normal, mask, z = waves()
    lights = ring(elevation_deg=40.0)
    images = matt(normal, lights) * cast(z, lights) + 0.7 * shine(normal, lights)
    rng = torch.Generator().manual_seed(0)
    images = images + 0.003 * torch.randn(images.shape, generator=rng)
    off = {
        method: errors(
            solve_normals(images, lights, method=method, shadow=shadow).normal, normal, mask
        )
        for method, shadow in (("least-squares", 0.0), ("robust", 0.1), ("selection", 0.1))
    }
    assert off["least-squares"].median() > 3.0
    assert off["robust"].median() < 0.8
    assert off["selection"].median() < 0.8
    assert off["robust"].quantile(0.95) < 0.3 * off["least-squares"].quantile(0.95)


def test_confidence_knows_where_the_normals_are_worse() -> None:
    normal, mask, z = waves()
    lights = ring(elevation_deg=40.0)
    images = matt(normal, lights) * cast(z, lights) + 0.7 * shine(normal, lights)
    found = solve_normals(images, lights)
    off = errors(found.normal, normal, mask)
    sure = found.confidence[0, 0].flatten() > found.confidence.median()
    assert off[sure].mean() < 0.6 * off[~sure].mean()
    assert ((found.confidence >= 0) & (found.confidence <= 1)).all()


def test_the_standard_error_is_about_right_for_noise() -> None:
    normal, mask = sphere()
    lights = ring()
    rng = torch.Generator().manual_seed(1)
    images = matt(normal, lights) + 0.02 * torch.randn(12, 1, N, N, generator=rng)
    found = solve_normals(images, lights, mask, method="least-squares")
    off = errors(found.normal, normal, mask)
    said = found.error_deg[0, 0][mask[0, 0] > 0]
    ratio = float((off**2).mean().sqrt() / (said.double() ** 2).mean().sqrt())
    assert 0.6 < ratio < 1.4


def test_slightly_wrong_intensities_are_refined() -> None:
    normal, mask, _ = waves()
    lights = ring()
    rng = torch.Generator().manual_seed(2)
    true = 1 + 0.15 * (torch.rand(12, generator=rng) - 0.5)
    true = true / true.mean()
    images = matt(normal, lights) * true.view(-1, 1, 1, 1)
    plain = errors(solve_normals(images, lights).normal, normal, mask)
    refined = solve_normals(images, lights, refine_intensity=True)
    told = errors(solve_normals(images, lights, intensity=true).normal, normal, mask)
    assert (refined.intensity - true).abs().max() < 0.01
    assert errors(refined.normal, normal, mask).median() < 0.05 * plain.median()
    assert told.median() < 0.02


def test_near_lamps_need_their_positions() -> None:
    normal, mask, z = waves()
    v, u = torch.meshgrid(torch.arange(N), torch.arange(N), indexing="ij")
    points = torch.stack([u.double(), -v.double(), z]).numpy()
    middle = points.reshape(3, -1).mean(1)
    direction = ring(8, 50.0).numpy()
    lamps = Lamps(direction, np.ones(8), position=middle + 150 * direction)
    near = torch.from_numpy(lamps.towards(points))
    images = matt(normal, near)
    flat = np.where(np.arange(3)[:, None, None] == 2, 0.0, points)
    far = errors(solve_normals(images, torch.from_numpy(direction)).normal, normal, mask)
    known = errors(
        solve_normals(images, torch.from_numpy(lamps.towards(flat))).normal, normal, mask
    )
    exact = errors(solve_normals(images, near).normal, normal, mask)
    assert far.median() > 4.0
    assert known.median() < 1.5  # the plate's own height is not known
    assert exact.median() < 0.05


def test_saturated_values_are_left_out() -> None:
    normal, mask = sphere()
    lights = ring()
    images = matt(normal, lights, 1.0)
    clipped = images.clamp(max=0.8)
    full = clipped >= 0.8
    kept = errors(solve_normals(clipped, lights, mask).normal, normal, mask)
    out = errors(solve_normals(clipped, lights, mask, saturated=full).normal, normal, mask)
    assert out.median() < 0.01
    assert out.mean() < 0.5 * kept.mean()


def test_a_response_is_found_on_known_normals() -> None:
    normal, mask = sphere()
    lights = ring()
    images = matt(normal, lights) ** (1 / 1.8)
    fit = fit_response(images, lights, normal.float(), mask > 0)
    assert fit.exponent == pytest.approx(1.8, abs=0.03)
    assert fit.error_deg < 0.2 < fit.error_linear_deg
    assert "1.8" in str(fit)


@pytest.mark.parametrize("uneven", [0.0, 0.4])
def test_a_response_beside_a_highlight_and_a_lamp_that_moved(uneven: float) -> None:
    """Simulated: an exponent alone would be bent by both; of unequal lamps none is thought to have
    moved for its brightness."""
    normal, mask = sphere()
    lights = ring(12, 60.0)
    moved = lights.clone()
    moved[4] = torch.tensor([0.17, -0.17, 0.0]) + lights[4]
    moved[4] /= moved[4].norm()
    half = moved + torch.tensor([0.0, 0.0, 1.0])
    half = half / half.norm(dim=1, keepdim=True)
    square = 2 * (1 - (half[:, :, None, None] * normal).sum(1, keepdim=True))
    facing = matt(normal, moved, 1.0)
    lit = facing + 0.15 * torch.exp(-square / (2 * np.radians(15) ** 2)) * (facing > 0)
    bright = (1 + uneven * torch.linspace(-1, 1, 12).double()).view(-1, 1, 1, 1)
    images = (0.6 * bright * lit) ** (1 / 1.2)
    fit = fit_response(images, lights, normal.float(), mask > 0)
    assert fit.exponent == pytest.approx(1.2, abs=0.01)
    assert fit.body.height == pytest.approx(0.15, abs=0.01)
    assert fit.body.width_deg == pytest.approx(15, abs=1)
    assert np.flatnonzero(fit.body.moved).tolist() == [4]
    assert fit.error_deg < 0.3 < 2.0 < fit.error_linear_deg
    assert "highlight" in str(fit)


def test_intensities_from_a_card_and_a_stained_sphere() -> None:
    lights = ring(8, 55.0)
    true = torch.linspace(0.8, 1.2, 8, dtype=torch.float64)
    card = torch.tensor([0.0, 0.0, 1.0], dtype=torch.float64).view(1, 3, 1, 1)
    images = matt(card.expand(1, 3, N, N), lights) * true.view(-1, 1, 1, 1)
    everywhere = torch.ones(1, 1, N, N, dtype=torch.bool)
    found = relative_intensities(images, lights, card, everywhere)
    torch.testing.assert_close(found, true / true.mean())
    normal, mask = sphere()
    stains = 0.3 + 0.6 * torch.rand(1, 1, N, N, generator=torch.Generator().manual_seed(3)).double()
    images = matt(normal, lights, stains) * true.view(-1, 1, 1, 1)
    found = relative_intensities(images, lights, normal, mask > 0)
    torch.testing.assert_close(found, true / true.mean(), rtol=1e-6, atol=1e-6)
    with pytest.raises(InputError, match="lit well by lamp 1"):
        relative_intensities(images, lights, -normal, mask > 0)


def test_invalid_pixels_have_no_normal() -> None:
    normal, mask = sphere()
    lights = ring()
    images = matt(normal, lights)
    images[:, :, 40:44, 40:44] = 0
    images[3, :, 50, 50] = torch.nan
    found = solve_normals(images, lights, mask)
    assert torch.isfinite(found.normal).all()
    assert (found.normal[:, :, 40:44, 40:44] == 0).all()
    assert (found.confidence[:, :, 40:44, 40:44] == 0).all()
    assert found.normal[0, :, 50, 50].norm() == pytest.approx(1.0)


BAD = {
    "two lamps": (
        lambda p, d: (p[:2], d[:2], {}),
        "expected at least 3 lamps, not in a row, got 2",
    ),
    "lamps in a plane": (lambda p, d: (p, d * torch.tensor([1.0, 0, 1]), {}), "in one plane"),
    "a lamp too few": (lambda p, d: (p, d[:-1], {}), "12 photographs"),
    "a zero direction": (lambda p, d: (p, d * (torch.arange(12) > 0)[:, None], {}), "zero"),
    "whole numbers": (lambda p, d: ((p * 255).byte(), d, {}), "floating-point"),
    "an empty mask": (lambda p, d: (p, d, {"mask": torch.zeros(1, 1, N, N)}), "empty"),
    "another mask": (
        lambda p, d: (p, d, {"mask": torch.ones(1, 1, N, 9)}),
        r"mask: expected shape \[1, 1, 96, 96\], got \[1, 1, 96, 9\]",
    ),
    "a dark lamp": (lambda p, d: (p, d, {"intensity": torch.zeros(12)}), "positive"),
    "a method": (lambda p, d: (p, d, {"method": "magic"}), "robust, least-squares"),
    "a shadow": (lambda p, d: (p, d, {"shadow": 1.0}), "share"),
    "an exponent": (lambda p, d: (p, d, {"exponent": 0.0}), "response"),
}


@pytest.mark.parametrize("name", BAD)
def test_bad_input(name: str) -> None:
    make, message = BAD[name]
    normal, _ = sphere()
    images, lights, options = make(matt(normal, ring()), ring())
    with pytest.raises(InputError, match=message):
        solve_normals(images, lights, **options)


@pytest.mark.parametrize("swap", [(0, 5), (2, 9), (3, 4)])
def test_swapped_photographs_are_named(swap: tuple[int, int]) -> None:
    normal, mask, _ = waves()
    lights = ring()
    images = matt(normal, lights)
    right = check_order(images, lights, mask)
    assert right is not None
    assert not right.uncertain
    assert right.moved() == []
    order = list(range(12))
    order[swap[0]], order[swap[1]] = swap[1], swap[0]
    wrong = check_order(images[order], lights, mask)
    assert wrong is not None
    assert wrong.doubtful
    assert wrong.moved() == list(swap)
    assert check_order(images[:4], lights[:4], mask) is None


@pytest.fixture(scope="module")
def real(shared: Path) -> tuple[Path, Lamps]:
    folder = shared / "data/photometric_stereo"
    ball = ball_from_mask(cv2.imread(str(folder / "chrome.mask.png"), cv2.IMREAD_GRAYSCALE))
    rows = [
        [find_highlight(cv2.imread(str(folder / f"chrome.{k}.png")) / 255, ball)] for k in range(12)
    ]
    return folder, lamps_from_balls([ball], rows)


def stack(folder: Path, name: str) -> tuple[Tensor, Tensor]:
    read = [cv2.imread(str(folder / f"{name}.{k}.png")) for k in range(12)]
    images = torch.from_numpy(np.stack(read)).movedim(-1, 1).float() / 255
    mask = cv2.imread(str(folder / f"{name}.mask.png"), cv2.IMREAD_GRAYSCALE) > 127
    return images, torch.from_numpy(mask)[None, None].float()


def test_the_real_grey_sphere_with_nothing_fitted(real) -> None:
    """Expected: plain least squares 4.5…5 degrees, the robust form at most 4.3."""
    folder, lamps = real
    images, mask = stack(folder, "gray")
    lights = torch.from_numpy(lamps.direction)
    truth, inside = sphere_normals(ball_from_mask(mask[0, 0].numpy()), images.shape[2:])
    plain = solve_normals(images, lights, mask, method="least-squares", shadow=0.0)
    assert 4.4 < errors(plain.normal, truth, inside).median() < 5.0
    robust = solve_normals(images, lights, mask)
    assert errors(robust.normal, truth, inside).median() < 4.15
    selection = solve_normals(images, lights, mask, method="selection")
    assert errors(selection.normal, truth, inside).median() < 4.3
    assert int(robust.lamp_residual.argmax()) == 2  # its lamp had moved since the chrome ball
    intensity = relative_intensities(images, lights, truth, inside)
    assert (intensity - 1).abs().max() < 0.05


@pytest.mark.slow
@pytest.mark.parametrize(
    ("side", "matt", "limit"),
    [("left", 3.3, 2.4), ("right", 2.6, 2.2), ("top", 1.6, 1.55), ("bottom", 4.9, 2.9)],
)
def test_the_real_grey_sphere_with_its_response(real, side: str, matt: float, limit: float) -> None:
    """Fitted on one half, tested on the other, by the matt law and with the fitted highlight.

    The bottom half hardly sees the highlight, so that the top stays the worst."""
    folder, lamps = real
    images, mask = stack(folder, "gray")
    lights = torch.from_numpy(lamps.direction)
    ball = ball_from_mask(mask[0, 0].numpy())
    truth, inside = sphere_normals(ball, images.shape[2:])
    left = torch.arange(images.shape[3]) < ball.x_px
    top = torch.arange(images.shape[2])[:, None] < ball.y_px
    half = inside & {"left": left, "right": ~left, "top": top, "bottom": ~top}[side]
    fit = fit_response(images, lights, truth, half)
    assert fit.exponent == pytest.approx(1.145, abs=0.03)  # an exponent alone: 1.07 to 1.15
    assert fit.body.moved[2]
    other = inside & ~half
    moved = torch.from_numpy(fit.body.moved).view(-1, 1, 1, 1).expand_as(images[:, :1])
    found = solve_normals(
        images, lights, other.float(), exponent=fit.exponent, saturated=moved
    ).normal
    assert errors(found, truth, other).median() < matt
    there = other[0, 0]
    linear = images[:, :, there].mean(1).double().numpy() ** fit.exponent
    usable = linear > 0.1 * np.sort(linear, axis=0)[-3]
    view = np.array([[0.0], [0.0], [1.0]])
    by_body = normals_by_body(
        fit.body,
        linear,
        lights.double().numpy()[:, :, None],
        view,
        found[0][:, there].double().numpy(),
        usable,
    )
    assert angle_deg(torch.from_numpy(by_body), truth[0][:, there].double()).median() < limit


@pytest.mark.slow
def test_the_order_of_the_real_photographs(real) -> None:
    folder, lamps = real
    lights = torch.from_numpy(lamps.direction)
    for name in ("gray", "buddha"):
        images, mask = stack(folder, name)
        right = check_order(images, lights, mask)
        assert right is not None
        assert right.moved() == []
        wrong = check_order(images.flip(0), lights, mask)
        assert wrong is not None
        assert wrong.doubtful
        assert wrong.order == tuple(range(11, -1, -1))


def test_lamps_on_opposite_sides_are_compared_through_those_between() -> None:
    """No pixel of a ball is lit by the first lamp and by the last."""
    normal, mask = sphere()
    phase = torch.linspace(-75, 110, 12, dtype=torch.float64).deg2rad()
    lights = torch.stack([phase.sin(), 0.1 * phase.cos(), phase.cos()], 1)
    lights = lights / lights.norm(dim=1, keepdim=True)
    true = torch.linspace(0.7, 1.3, 12, dtype=torch.float64)
    stains = 0.3 + 0.6 * torch.rand(1, 1, N, N, generator=torch.Generator().manual_seed(4)).double()
    images = matt(normal, lights, stains) * true.view(-1, 1, 1, 1)
    found = relative_intensities(images, lights, normal, mask > 0)
    torch.testing.assert_close(found, true / true.mean(), rtol=1e-3, atol=1e-3)
