"""The whole chain obeys the physics of its specimen: frames, reciprocity, energy, Lambert."""

from __future__ import annotations

import math

import pytest
import torch

import raden_torch as rt


@pytest.fixture(scope="module")
def shell() -> rt.RadenBrdf:
    return rt.fit(rt.simulate_specimen("yakogai"), interpolation="trilinear").model


def directions(n: int, seed: int) -> torch.Tensor:
    """Uniform over the upper hemisphere, `[1, 3, n, 1]`."""
    generator = torch.Generator().manual_seed(seed)
    v = torch.randn(1, 3, n, 1, generator=generator, dtype=torch.float64)
    v[:, 2] = v[:, 2].abs()
    return torch.nn.functional.normalize(v, dim=1)


UP = torch.tensor([0.0, 0.0, 1.0], dtype=torch.float64).view(1, 3, 1, 1)


def test_turning_the_scene_changes_nothing(shell: rt.RadenBrdf) -> None:
    """Rationale: f_r knows only the angles between N, L and V. Expected: equal to rounding."""
    vectors = [directions(2000, seed) for seed in (1, 2, 3)]
    q, _ = torch.linalg.qr(
        torch.randn(3, 3, dtype=torch.float64, generator=torch.Generator().manual_seed(4))
    )
    q = q * torch.sign(torch.linalg.det(q))
    turned = [torch.einsum("ij,bjhw->bihw", q, v) for v in vectors]
    torch.testing.assert_close(shell(*turned), shell(*vectors), atol=1e-9, rtol=1e-7)


def test_a_mirror_image_changes_nothing_in_plane(shell: rt.RadenBrdf) -> None:
    """In the plane of N the tilt is 0: nothing tells left from right."""
    n = 500
    light, view = directions(n, 5), directions(n, 6)
    light[:, 1] = view[:, 1] = 0
    flip = torch.tensor([-1.0, 1, 1], dtype=torch.float64).view(1, 3, 1, 1)
    torch.testing.assert_close(shell(UP, light * flip, view * flip), shell(UP, light, view))


def test_reciprocal_specimen_gives_a_reciprocal_model(shell: rt.RadenBrdf) -> None:
    """Rationale: the simulated shell is reciprocal, and so is its grid. Expected: what is left is
    the interpolation between nodes, which treats incidence and receiving alike."""
    light, view = directions(20_000, 7), directions(20_000, 8)
    inside = (light[:, 2:] > 0.5) & (view[:, 2:] > 0.5)
    there, back = shell(UP, light, view), shell(UP, view, light)
    difference = (there - back).abs().mean(1, keepdim=True)[inside]
    assert difference.mean() < 0.01 * there.mean(1, keepdim=True)[inside].mean()


def test_no_more_light_leaves_than_came(shell: rt.RadenBrdf) -> None:
    """Directional-hemispherical reflectance ≤ 1, by Monte Carlo with cosine weights."""
    n = 50_000
    view = directions(n, 9)
    for incidence in (0, 30, 60, 80):
        a = math.radians(incidence)
        light = torch.tensor([math.sin(a), 0, math.cos(a)], dtype=torch.float64).view(1, 3, 1, 1)
        with torch.no_grad():
            f = shell(UP, light, view)
        reflectance = 2 * math.pi * (f * view[:, 2:]).mean(dim=(0, 2, 3))
        luminance = (reflectance * torch.tensor([0.2126, 0.7152, 0.0722])).sum()
        assert 0.01 < luminance < 1


def test_a_lambertian_sample_returns_its_own_reflectance(analytic) -> None:
    """Body only: f_r = ρ/π inside the box, in every direction."""
    model = rt.fit(analytic(body=50.0, peak=0.0), interpolation="trilinear").model
    light, view = directions(20_000, 10), directions(20_000, 11)
    use = ((light[:, 2:] > 0.5) & (view[:, 2:] > 0.5)).expand(1, 3, -1, 1)
    # X = Y = Z = 50 is not white: the colour follows the matrix
    rgb = analytic(50.0, 0.0).as_rgb().values[0] / 100
    f = math.pi * model(UP, light, view)
    expected = torch.from_numpy(rgb).view(1, 3, 1, 1).expand_as(f)
    torch.testing.assert_close(f[use], expected[use], rtol=1e-6, atol=0)


def test_the_two_peaks_lie_along_the_tilt(shell: rt.RadenBrdf) -> None:
    """Take (2012), fig. 9: at incidence 20 the mirror direction has two maxima, one a side."""
    tilt = torch.deg2rad(torch.arange(-40.0, 41.0, dtype=torch.float64)).view(1, -1, 1)
    at = torch.full_like(tilt, math.radians(20))
    green = shell.at_angles(at, at, tilt)[1].flatten()
    peaks = [i for i in range(1, 80) if green[i] > green[i - 1] and green[i] >= green[i + 1]]
    assert len(peaks) == 2
    assert peaks[0] < 40 < peaks[1]
    assert green[40] < 0.7 * green[peaks[0]]


def test_the_colour_travels_with_the_angle(shell: rt.RadenBrdf) -> None:
    """Iridescence: the chromaticity of the peak moves far between incidence 5 and 65."""
    a = torch.deg2rad(torch.tensor([5.0, 65.0], dtype=torch.float64)).view(1, 2, 1)
    rgb = shell.at_angles(a, a, torch.full_like(a, math.radians(12.5)))[:, :, 0].T
    to_xyz = torch.tensor(
        [[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]]
    ).double()
    xyz = rgb @ to_xyz.T
    uv = (
        torch.stack([4 * xyz[:, 0], 9 * xyz[:, 1]], 1)
        / (xyz @ torch.tensor([1.0, 15, 3]).double())[:, None]
    )
    assert (uv[0] - uv[1]).norm() > 0.05
