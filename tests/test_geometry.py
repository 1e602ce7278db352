"""The three angles: definition, inverse, symmetries, and every degenerate case."""

from __future__ import annotations

import math

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

import raden_torch as rt
from raden_torch.errors import InputError


def as_map(*rows: tuple[float, float, float]) -> torch.Tensor:
    """Directions as `[3, P, 1]`."""
    return torch.tensor(rows, dtype=torch.float64).T[:, :, None].contiguous()


def degrees(angles: tuple[torch.Tensor, ...]) -> list[list[float]]:
    return [torch.rad2deg(angle).flatten().tolist() for angle in angles]


def rotation(seed: int) -> torch.Tensor:
    generator = torch.Generator().manual_seed(seed)
    q, _ = torch.linalg.qr(torch.randn(3, 3, generator=generator, dtype=torch.float64))
    return q * torch.sign(torch.linalg.det(q))


def uniform_angles(n: int, seed: int, limit_deg: float) -> list[torch.Tensor]:
    generator = torch.Generator().manual_seed(seed)
    u = torch.rand(3, 1, n, 1, generator=generator, dtype=torch.float64)
    limit = math.radians(limit_deg)
    return [u[0] * limit, (2 * u[1] - 1) * limit, (2 * u[2] - 1) * limit]


@settings(max_examples=30, deadline=None)
@given(seed=st.integers(0, 2**31 - 1), lengths=st.booleans())
def test_angles_come_back_under_any_rotation(seed: int, lengths: bool) -> None:
    """Rationale: turning the whole scene changes no angle. Expected: the stated accuracies."""
    a, r, t = uniform_angles(2000, seed, 80)
    turned = [
        torch.einsum("ij,jpk->ipk", rotation(seed), v) for v in rt.vectors_from_angles(a, r, t)
    ]
    generator = torch.Generator().manual_seed(seed)
    if lengths:
        turned = [v * (0.01 + 100 * torch.rand(1, 2000, 1, generator=generator)) for v in turned]
    for dtype, accuracy, apart in ((torch.float64, 1e-9, 1e-3), (torch.float32, 1e-5, 0.05)):
        found = rt.raden_angles(*(v.to(dtype) for v in turned))
        use = (a > 1e-3) & ((a + r).abs() > apart)
        for angle, truth in zip(found, (a, r, t), strict=True):
            assert angle.dtype == dtype
            assert (angle - truth).abs()[use].max() < accuracy


def test_float32_stays_accurate_where_light_and_view_almost_agree() -> None:
    generator = torch.Generator().manual_seed(1)
    light, normal, offset = torch.randn(3, 3, 100_000, 1, generator=generator, dtype=torch.float64)
    light = torch.nn.functional.normalize(light, dim=0)
    normal = torch.nn.functional.normalize(normal, dim=0)
    normal = normal * torch.sign((normal * light).sum(0))
    view = torch.nn.functional.normalize(light + 1e-4 * offset, dim=0)
    vectors = [v.float() for v in (normal, light, view)]
    for angle, truth in zip(
        rt.raden_angles(*vectors), rt.raden_angles(*(v.double() for v in vectors)), strict=True
    ):
        assert (angle - truth).abs().flatten().quantile(0.999) < 1e-6


def test_definition_in_the_measuring_plane() -> None:
    """N in the plane of L and V: tilt 0; the mirror has r = a; viewer beside L, r < 0."""
    s, c = math.sin(math.radians(30)), math.cos(math.radians(30))
    normal = as_map((0, 0, 1), (0, 0, 1), (0, 0, 1))
    light = as_map((-s, 0, c), (-s, 0, c), (-s, 0, c))
    view = as_map((s, 0, c), (0, 0, 1), (-math.sin(1), 0, math.cos(1)))
    a, r, t = degrees(rt.raden_angles(normal, light, view))
    assert a == pytest.approx([30, 30, 30])
    assert r == pytest.approx([30, 0, -math.degrees(1)], abs=1e-9)
    assert t == pytest.approx([0, 0, 0], abs=1e-9)


def test_tilt_is_the_normal_out_of_the_plane() -> None:
    """Tilt t turns N by t out of the plane of L and V: sin t = N·p, cosines multiply."""
    a, r, t = uniform_angles(1000, 3, 70)
    normal, light, view = rt.vectors_from_angles(a, r, t)
    dot = lambda x, y: (x * y).sum(0, keepdim=True)  # noqa: E731
    torch.testing.assert_close(dot(normal, light), a.cos() * t.cos())
    torch.testing.assert_close(dot(normal, view), r.cos() * t.cos())
    torch.testing.assert_close(dot(light, view), (a + r).cos())
    p = torch.linalg.cross(light, view, dim=0) * torch.sign(a + r)
    torch.testing.assert_close(dot(normal, p), t.sin() * (a + r).sin().abs())


def test_lamp_on_the_camera_takes_the_plane_of_light_and_normal(dtype: torch.dtype) -> None:
    angles = torch.tensor([0.0, 1e-6, 0.3, 1.2], dtype=dtype)
    light = torch.stack([angles.sin(), torch.zeros_like(angles), angles.cos()])[:, :, None]
    normal = torch.zeros_like(light)
    normal[2] = 1
    a, r, t = rt.raden_angles(normal, light, light)
    torch.testing.assert_close(a[0, :, 0], angles)
    torch.testing.assert_close(r, -a)
    assert (t == 0).all()
    opposite = rt.raden_angles(normal, light, -light)
    assert all(torch.isfinite(angle).all() for angle in opposite)


def test_light_and_viewer_change_places() -> None:
    """(a, r, t) ↔ (r, a, −t) for r ≥ 0 and (−r, −a, t) for r < 0."""
    a, r, t = uniform_angles(5000, 4, 70)
    normal, light, view = rt.vectors_from_angles(a, r, t)
    a2, r2, t2 = rt.raden_angles(normal, view, light)
    forward = r >= 0
    torch.testing.assert_close(a2, torch.where(forward, r, -r), atol=1e-9, rtol=0)
    torch.testing.assert_close(r2, torch.where(forward, a, -a), atol=1e-9, rtol=0)
    torch.testing.assert_close(t2, torch.where(forward, -t, t), atol=1e-9, rtol=0)


@pytest.mark.parametrize("half", [torch.bfloat16, torch.float16])
def test_half_precision_is_computed_in_float32(half: torch.dtype) -> None:
    vectors = [v.to(half) for v in rt.vectors_from_angles(*uniform_angles(1000, 5, 60))]
    found = rt.raden_angles(*vectors)
    expected = rt.raden_angles(*(v.float() for v in vectors))
    for angle, truth in zip(found, expected, strict=True):
        assert angle.dtype == torch.float32
        assert torch.equal(angle, truth)


SPECIAL = [
    (0.0, 0.0, 1.0),
    (0.0, 0.0, -1.0),
    (1.0, 0.0, 0.0),
    (0.0, 1.0, 0.0),
    (0.6, 0.0, 0.8),
    (0.6, 0.0, 0.8 + 1e-7),
    (1e-8, 0.0, 1.0),
    (1.0, 1e-8, 0.0),
    (0.0, 0.0, 0.0),
    (1e-40, 0.0, 1e-40),
    (1e38, 1e38, 1e38),
    (math.nan, 0.0, 1.0),
    (math.inf, 0.0, 1.0),
]


def test_every_special_case_is_finite_with_its_gradient(dtype: torch.dtype) -> None:
    triples = [(n, l, v) for n in SPECIAL for l in SPECIAL for v in SPECIAL]  # noqa: E741
    maps = [as_map(*(triple[k] for triple in triples)).to(dtype).requires_grad_() for k in range(3)]
    angles = rt.raden_angles(*maps)
    assert all(torch.isfinite(angle).all() for angle in angles)
    sum(angle.sum() for angle in angles).backward()
    for m in maps:
        assert torch.isfinite(m.grad).all()


def test_invalid_vectors_give_zero_angles() -> None:
    good = as_map((0.3, 0.1, 1.0), (0.3, 0.1, 1.0), (0.3, 0.1, 1.0))
    bad = as_map((0, 0, 0), (math.nan, 0, 1), (0, math.inf, 1))
    for vectors in ((bad, good, good), (good, bad, good), (bad, bad, bad)):
        a, _, t = rt.raden_angles(*vectors)
        assert torch.isfinite(a).all()
        assert (t == 0).all()


def test_huge_and_tiny_lengths_change_nothing(dtype: torch.dtype) -> None:
    vectors = [v.to(dtype) for v in rt.vectors_from_angles(*uniform_angles(200, 6, 60))]
    expected = rt.raden_angles(*vectors)
    for scale in (1e-30, 1e30):
        found = rt.raden_angles(*(v * scale for v in vectors))
        for angle, truth in zip(found, expected, strict=True):
            torch.testing.assert_close(angle, truth, atol=2e-5, rtol=0)


def test_gradients_agree_with_differences() -> None:
    a, r, t = uniform_angles(20, 7, 60)
    vectors = [v.clone().requires_grad_() for v in rt.vectors_from_angles(a + 0.05, r + 0.1, t)]
    assert torch.autograd.gradcheck(lambda *v: torch.cat(rt.raden_angles(*v)), vectors)
    angles = [x.clone().requires_grad_() for x in (a, r, t)]
    assert torch.autograd.gradcheck(rt.vectors_from_angles, angles)


def test_constant_maps_broadcast() -> None:
    normal = torch.randn(2, 3, 4, 5)
    a, r, t = rt.raden_angles(normal, torch.tensor([0.0, 0, 1]).view(1, 3, 1, 1), normal[:1])
    assert a.shape == r.shape == t.shape == (2, 1, 4, 5)


@pytest.mark.parametrize(
    ("shapes", "words"),
    [
        (([2, 3, 4, 4], [3, 3, 4, 4], [2, 3, 4, 4]), ["light [3, 3, 4, 4]", "broadcast"]),
        (([2, 4, 4], [3, 4, 4], [3, 4, 4]), ["normal", "[2, 4, 4]", "[B, 3, H, W]"]),
        (([3], [3, 1, 1], [3, 1, 1]), ["normal", "[3]"]),
    ],
)
def test_wrong_shapes_are_named(shapes: tuple[list[int], ...], words: list[str]) -> None:
    with pytest.raises(InputError) as error:
        rt.raden_angles(*(torch.ones(shape) for shape in shapes))
    assert all(word in str(error.value) for word in words)
    assert "\n" not in str(error.value)


def test_integer_vectors_are_refused() -> None:
    with pytest.raises(
        InputError, match=r"view: expected a floating-point tensor \[B, 3, H, W\], got torch\.int64"
    ):
        rt.raden_angles(torch.ones(3, 1, 1), torch.ones(3, 1, 1), torch.ones(3, 1, 1).long())
    with pytest.raises(InputError, match="floating-point"):
        rt.vectors_from_angles(*[torch.zeros(1, 1, 1, dtype=torch.int64)] * 3)
    with pytest.raises(InputError, match=r"\[3, 2, 1\]"):
        rt.vectors_from_angles(*[torch.zeros(3, 2, 1)] * 3)
