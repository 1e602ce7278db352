"""The runtime form: its address against angles, its bake against the fit form, its nodes."""

from __future__ import annotations

import copy
import json
import math
import struct
from pathlib import Path

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

import raden_torch as rt
from raden_torch.brdf.model.layout_choice import bake_errors, choose_layout
from raden_torch.brdf.model.model import CosineDiffuse
from raden_torch.brdf.model.reflectance_table import ReflectanceTable
from raden_torch.brdf.model.runtime_bake import bake
from raden_torch.brdf.model.runtime_table import (
    RuntimeLayout,
    address,
    address_of_angles,
    angles_of,
    node_angles,
    read_at,
)
from raden_torch.errors import InputError

LAYOUT = RuntimeLayout((16, 33, 33), (0.3, 0.5))


def lobe_model(width_deg: float = 12.0, **options) -> rt.RadenBrdf:
    """A lobe around the mirror over a body, tabulated to the horizon."""
    a, r, t = torch.meshgrid(
        torch.linspace(0, 90, 19, dtype=torch.float64),
        *2 * [torch.linspace(-90, 90, 37, dtype=torch.float64)],
        indexing="ij",
    )
    lobe = torch.exp(-(((r - a) / width_deg) ** 2) - (t / width_deg) ** 2)[..., None]
    values = 0.1 + lobe * torch.tensor([1.0, 1.5, 2.0], dtype=torch.float64)
    table = ReflectanceTable(values, (0.0, -90.0, -90.0), (5.0, 5.0, 5.0))
    scale, exponent = torch.tensor([0.1, 0.2, 0.3]).double(), torch.tensor([0.6, 1.0, 2.0]).double()
    return rt.RadenBrdf(CosineDiffuse(scale, exponent), table, **options)


def maps(n: int, seed: int = 0) -> list[torch.Tensor]:
    generator = torch.Generator().manual_seed(seed)
    found = []
    for _ in range(3):
        v = torch.randn(1, 3, n, 1, generator=generator, dtype=torch.float64)
        v[:, 2] = v[:, 2].abs() + 0.1
        found.append(torch.nn.functional.normalize(v, dim=1))
    return found


unit = st.floats(0.01, 0.99)
signed = st.floats(-0.99, 0.99)
warp = st.floats(0.05, 5)


@settings(max_examples=200, deadline=None)
@given(unit, signed, signed, warp, warp)
def test_an_address_and_its_angles_are_each_others_inverse(u, v, w, c, k) -> None:
    at = [torch.tensor([x], dtype=torch.float64) for x in (u, v, w)]
    angles = angles_of((c, k), *at)
    incidence, receiving, tilt = (float(x) for x in angles)
    assert 0 <= incidence < math.pi / 2
    assert max(abs(receiving), abs(tilt)) < math.pi / 2
    for found, given_ in zip(address_of_angles((c, k), *angles), at, strict=True):
        assert float(found) == pytest.approx(float(given_), rel=1e-9, abs=1e-9)


def test_the_address_of_vectors_is_that_of_their_angles() -> None:
    n, l, v = maps(5000)  # noqa: E741
    *found, above = address(LAYOUT.warp, n, l, v)
    expected = address_of_angles(LAYOUT.warp, *rt.raden_angles(n, l, v))
    assert above.sum() > 2000
    for x, y in zip(found, expected, strict=True):
        torch.testing.assert_close(x[above], y[above], rtol=1e-8, atol=1e-9)


def test_a_turned_scene_has_the_same_addresses() -> None:
    n, l, v = maps(500)  # noqa: E741
    q, _ = torch.linalg.qr(torch.randn(3, 3, generator=torch.Generator().manual_seed(1)).double())
    q = q * torch.linalg.det(q).sign()
    turned = [torch.einsum("ij,bjhw->bihw", q, m) for m in (n, l, v)]
    for x, y in zip(address(LAYOUT.warp, n, l, v), address(LAYOUT.warp, *turned), strict=True):
        torch.testing.assert_close(x, y)


def test_the_ends_of_the_axes_are_the_horizon_and_grazing() -> None:
    a, r, t = node_angles(LAYOUT)
    lower = torch.minimum(a.cos() * t.cos(), r.cos() * t.cos())
    assert (lower > -1e-12).all()  # no node lies below the horizon
    assert lower[:, [0, -1]].abs().max() < 1e-8
    assert (t[:, 1:-1, [0, -1]].abs() - math.pi / 2).abs().max() < 1e-8
    torch.testing.assert_close(((a + r).abs() / 2)[-1], torch.full_like(a[-1], math.pi / 2))


def test_light_and_viewer_in_one_place_take_the_plane_of_the_normal() -> None:
    model = lobe_model(layout=LAYOUT)
    n, l, _ = maps(300)  # noqa: E741
    theta = torch.acos((n * l).sum(1, keepdim=True))
    here = (n * l).sum(1, keepdim=True) > 0
    expected = torch.where(here, model.at_angles(theta, -theta, 0 * theta), 0.0)
    torch.testing.assert_close(model(n, l, l), expected, rtol=1e-6, atol=1e-8)


@pytest.mark.parametrize("apart", [1e-7, 1e-6, 1e-5, 1e-4, 1e-3])
def test_single_precision_keeps_its_digits_where_light_and_viewer_almost_agree(apart) -> None:
    generator = torch.Generator().manual_seed(2)
    n, l, _ = maps(3000)  # noqa: E741
    v = torch.nn.functional.normalize(
        l + apart * torch.randn(l.shape, generator=generator).double(), dim=1
    )
    n, l, v = (m.float() for m in (n, l, v))  # noqa: E741
    *single, above = address(LAYOUT.warp, n, l, v)
    *double, _ = address(
        LAYOUT.warp, *(torch.nn.functional.normalize(m.double(), dim=1) for m in (n, l, v))
    )
    allowed = (
        3e-6 + 3e-13 / apart
    )  # of v and w; where L − V itself is rounding, its direction is noise
    if apart >= 1e-5:
        for x, y in zip(single[1:], double[1:], strict=True):
            assert (x.double() - y)[above].abs().quantile(0.99) < max(allowed, 1e-4 * 1e-5 / apart)
    assert all(torch.isfinite(x).all() for x in single)


def test_a_table_of_one_value_is_that_value_everywhere() -> None:
    table = ReflectanceTable(
        torch.full((2, 3, 3, 3), 1 / math.pi), (0.0, -90.0, -90.0), (90.0,) * 3
    )
    model = rt.RadenBrdf(None, table, layout=LAYOUT)
    n, l, v = (m.float() for m in maps(2000))  # noqa: E741
    f = model(n, l, v)
    above = ((n * l).sum(1) > 0) & ((n * v).sum(1) > 0)
    torch.testing.assert_close(
        f.movedim(1, -1)[above], torch.full_like(f.movedim(1, -1)[above], 1 / math.pi)
    )
    assert (f.movedim(1, -1)[~above] == 0).all()


def test_what_is_linear_along_the_axes_is_read_exactly() -> None:
    u, v, w = (
        torch.linspace(low, 1, n).double() for low, n in zip((0, -1, -1), LAYOUT.shape, strict=True)
    )
    values = (1 + 2 * u[:, None, None] + 3 * v[:, None] - w)[..., None]
    at = [
        torch.rand(1, 50, 1, generator=torch.Generator().manual_seed(i)).double() for i in range(3)
    ]
    at[1], at[2] = 2 * at[1] - 1, 2 * at[2] - 1
    torch.testing.assert_close(read_at(values, *at), 1 + 2 * at[0] + 3 * at[1] - at[2])


def test_the_runtime_form_is_near_the_fit_form_and_nearer_with_more_nodes() -> None:
    model = lobe_model()
    worst = []
    for nodes in (20_000, 75_000, 300_000):
        model.layout = choose_layout(model, nodes)
        assert 0.7 * nodes <= model.layout.nodes <= nodes
        worst.append(max(error.rms for error in bake_errors(model).values()))
    assert worst[0] > worst[1] > worst[2]
    assert worst[2] < 0.004


def test_narrow_highlights_draw_the_nodes_closer() -> None:
    wide, narrow = (choose_layout(lobe_model(width)) for width in (40.0, 6.0))
    assert max(narrow.warp) < min(wide.warp)
    assert choose_layout(lobe_model(6.0)) == narrow  # the same every time


def test_eq_2_is_linear_in_its_gains_and_homogeneous_in_its_table() -> None:
    model = lobe_model(layout=LAYOUT)
    with torch.no_grad():
        whole = bake(model, LAYOUT)
        parts = []
        for gains in ((1.0, 0.0), (0.0, 1.0), (2.0, 3.0)):
            model.diffuse_gain, model.specular_gain = gains
            parts.append(bake(model, LAYOUT))
        torch.testing.assert_close(parts[0] + parts[1], whole)
        torch.testing.assert_close(2 * parts[0] + 3 * parts[1], parts[2])
        model.diffuse_gain = model.specular_gain = 1.0
        model.table.values *= 0.5
        torch.testing.assert_close(bake(model, LAYOUT), whole / 2)


def test_nothing_that_was_not_negative_becomes_so() -> None:
    generator = torch.Generator().manual_seed(3)
    spikes = (torch.rand(8, 15, 15, 3, generator=generator) > 0.95).float() * 100
    table = ReflectanceTable(spikes, (0.0, -70.0, -70.0), (10.0, 10.0, 10.0))
    values = bake(rt.RadenBrdf(None, table), LAYOUT)
    assert (values >= 0).all()
    assert values.max() <= 105


def test_a_change_of_the_model_is_seen() -> None:
    model = lobe_model(layout=LAYOUT)
    n, l, v = maps(100)  # noqa: E741
    with torch.no_grad():
        before = model(n, l, v)
        assert torch.equal(model(n, l, v), before)
        model.table.values[..., 0] *= 2
        doubled = model(n, l, v)
        torch.testing.assert_close(doubled[:, 0], 2 * before[:, 0])
        assert torch.equal(doubled[:, 1:], before[:, 1:])
        model.specular_gain = 0.0
        without = model(n, l, v)
        model.diffuse.scale *= 3
        torch.testing.assert_close(model(n, l, v), 3 * without)
        model.layout = RuntimeLayout((20, 41, 41), (0.3, 0.5))
        assert not torch.equal(model(n, l, v), 3 * without)
        again = copy.deepcopy(model)
        assert torch.equal(again(n, l, v), model(n, l, v))


@pytest.mark.parametrize("trained", [True, False])
def test_what_inference_mode_baked_serves_gradients_too(trained: bool) -> None:
    model = lobe_model(layout=RuntimeLayout((17, 31, 29), (0.35, 0.45))).requires_grad_(trained)
    n, l, v = maps(50)  # noqa: E741
    with torch.inference_mode():
        first = model(n, l, v)
    f = model(n.requires_grad_(), l, v)
    f.sum().backward()
    assert torch.isfinite(n.grad).all()
    assert torch.equal(f.detach(), first)


def test_gradients_through_the_bake_are_those_of_differences() -> None:
    small = RuntimeLayout((4, 5, 5), (0.5, 0.5))
    values = 0.2 + torch.rand(3, 5, 5, 2, generator=torch.Generator().manual_seed(4)).double()
    n, l, v = maps(6)  # noqa: E741

    def f(values, scale, exponent, n):
        table = ReflectanceTable(values.detach(), (0.0, -60.0, -60.0), (30.0, 30.0, 30.0))
        model = rt.RadenBrdf(CosineDiffuse(scale.detach(), exponent.detach()), table, layout=small)
        model.diffuse_gain = 0.7
        tensors = {"table.values": values, "diffuse.scale": scale, "diffuse.exponent": exponent}
        return torch.func.functional_call(model, tensors, (n, l, v))

    scale, exponent = torch.tensor([0.3, 0.4]).double(), torch.tensor([1.2, 0.8]).double()
    inputs = [x.requires_grad_() for x in (values, scale, exponent, n)]
    assert torch.autograd.gradcheck(f, inputs, atol=1e-5)


def test_a_file_keeps_the_choice_and_an_older_file_makes_it(tmp_path: Path) -> None:
    model = lobe_model(layout=LAYOUT).float()
    rt.save_model(model, tmp_path / "m.safetensors")
    assert rt.load_model(tmp_path / "m.safetensors").layout == LAYOUT
    data = (tmp_path / "m.safetensors").read_bytes()
    length = struct.unpack("<Q", data[:8])[0]
    header = json.loads(data[8 : 8 + length])
    about = json.loads(header["__metadata__"]["about"])
    for runtime in (None, {"shape": [5000, 5000, 5000], "warp": [0.3, 0.3]}):
        about.pop("runtime", None)
        if runtime is not None:
            about["runtime"] = runtime
        header["__metadata__"]["about"] = json.dumps(about)
        text = json.dumps(header).encode()
        path = tmp_path / "other.safetensors"
        path.write_bytes(struct.pack("<Q", len(text)) + text + data[8 + length :])
        if runtime is None:
            assert rt.load_model(path).layout == choose_layout(model)
        else:
            with pytest.raises(InputError, match=r"runtime table: expected at most \d+ nodes"):
                rt.load_model(path)


@pytest.mark.parametrize(
    ("shape", "warp", "message"),
    [
        ((2, 9, 9), (0.3, 0.3), "at least 3 nodes"),
        ((999, 999, 999), (0.3, 0.3), "at most 2097152 nodes"),
        ((9, 9, 9), (0.0, 0.3), "two warp constants"),
        ((9, 9, 9), (0.3, float("nan")), "two warp constants"),
    ],
)
def test_layouts_that_are_none(shape, warp, message) -> None:
    with pytest.raises(InputError, match=message):
        RuntimeLayout(shape, warp)


def test_too_few_nodes_for_any_layout() -> None:
    with pytest.raises(InputError, match=r"expected 10,000 to 1,700,000 nodes, got 100"):
        choose_layout(lobe_model(), 100)
