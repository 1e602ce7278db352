"""`RadenBrdf`: the horizon, the gains, its parts, its gradients, and its file."""

from __future__ import annotations

import json
import struct
from pathlib import Path

import pytest
import torch

import raden_torch as rt
from raden_torch.brdf.model.model import CosineDiffuse
from raden_torch.errors import InputError


@pytest.fixture(scope="module")
def model() -> rt.RadenBrdf:
    """A small random model: every branch is reached, nothing is smooth."""
    from raden_torch.brdf.model.model import Provenance
    from raden_torch.brdf.model.reflectance_table import ReflectanceTable

    generator = torch.Generator().manual_seed(0)
    table = torch.rand(8, 15, 15, 3, generator=generator)
    diffuse = CosineDiffuse(torch.tensor([0.1, 0.2, 0.3]), torch.tensor([0.5, 1.0, 2.0]))
    return rt.RadenBrdf(
        diffuse,
        ReflectanceTable(table, (0.0, -70.0, -70.0), (10.0, 10.0, 10.0)),
        provenance=Provenance(
            "random", "none", True, "abc", {"warnings": ["w"], "asymmetry": None}
        ),
    )


def one(*xyz: float, dtype: torch.dtype = torch.float64) -> torch.Tensor:
    return torch.tensor(xyz, dtype=dtype).view(1, 3, 1, 1)


def test_nothing_is_seen_or_lit_below_the_horizon(model, random_vectors) -> None:
    up = one(0, 0, 1)
    above = random_vectors(500)
    assert (model(up, above, above.flip(2)) != 0).any()
    for light, view in ((-above, above), (above, -above), (-above, -above)):
        assert (model(up, light, view) == 0).all()


def test_invalid_vectors_give_zero_and_no_nan(model, dtype: torch.dtype) -> None:
    good = one(0.2, 0.1, 1, dtype=dtype)
    for bad in (one(0, 0, 0), one(float("nan"), 0, 1), one(0, 0, float("inf"))):
        bad = bad.to(dtype)
        for vectors in ((bad, good, good), (good, bad, good), (good, good, bad)):
            assert (model(*vectors) == 0).all()


def test_gains_are_those_of_equation_two(model, random_vectors) -> None:
    vectors = [random_vectors(300, seed) for seed in (1, 2, 3)]
    whole = model(*vectors)
    parts = []
    for gains in ((1.0, 0.0), (0.0, 1.0), (2.0, 3.0)):
        model.diffuse_gain, model.specular_gain = gains
        parts.append(model(*vectors))
    model.diffuse_gain = model.specular_gain = 1.0
    diffuse, specular, mixed = parts
    torch.testing.assert_close(diffuse + specular, whole)
    torch.testing.assert_close(2 * diffuse + 3 * specular, mixed)
    assert (diffuse > 0).any()
    assert (specular != 0).any()


def test_a_model_may_lack_a_part(model, random_vectors) -> None:
    vectors = [random_vectors(300, seed) for seed in (1, 2, 3)]
    diffuse_only = rt.RadenBrdf(model.diffuse, None)(*vectors)
    assert (diffuse_only > 0).any()
    table_only = rt.RadenBrdf(None, model.table)(*vectors)
    assert (table_only > 0).any()
    assert (rt.RadenBrdf(None, None)(*vectors) == 0).all()


def test_outside_the_box_only_the_diffuse_part_is_left(model) -> None:
    at = lambda *deg: [torch.tensor(d).deg2rad().view(1, 1, 1).double() for d in deg]  # noqa: E731
    for far in ((85.0, 0.0, 0.0), (20.0, 82.0, 0.0), (20.0, -82.0, 0.0), (20.0, 0.0, 81.0)):
        angles = at(*far)
        torch.testing.assert_close(model.fit_form(*angles), model.diffuse(*angles))
    edge = at(70.0, 70.0, -70.0)
    torch.testing.assert_close(
        model.fit_form(*edge).flatten(), model.table.values[-1, -1, 0].double()
    )


def test_half_precision_gbuffers_are_computed_in_float32(model, random_vectors) -> None:
    for half in (torch.bfloat16, torch.float16):
        vectors = [random_vectors(100, seed).to(half) for seed in (1, 2, 3)]
        found = model(*vectors)
        assert found.dtype == torch.float32
        assert torch.equal(found, model(*(v.float() for v in vectors)))


def test_float32_agrees_with_float64(model, random_vectors) -> None:
    vectors = [random_vectors(20_000, seed).float() for seed in (1, 2, 3)]
    error = (model(*vectors) - model(*(v.double() for v in vectors))).abs()
    assert error.flatten().quantile(0.999) < 2e-5
    assert error.max() < 1e-3


def test_gradients_agree_with_differences(model, random_vectors) -> None:
    vectors = [random_vectors(6, seed).requires_grad_() for seed in (4, 5, 6)]
    parameters = {name: p.detach().double() for name, p in model.named_parameters()}
    names = ["diffuse.scale", "diffuse.exponent", "table.values"]
    tensors = [parameters[name].requires_grad_() for name in names]

    def evaluate(*inputs: torch.Tensor) -> torch.Tensor:
        given = dict(zip(names, inputs[3:], strict=True))
        return torch.func.functional_call(model, given, inputs[:3])

    assert torch.autograd.gradcheck(evaluate, (*vectors, *tensors), fast_mode=True)


def test_gradients_are_finite_in_float32_at_every_special_case(model) -> None:
    special = torch.tensor(
        [
            [0, 0, 1],
            [0, 0, -1],
            [1, 0, 0],
            [0.6, 0, 0.8],
            [1e-08, 0, 1],
            [0, 0, 0],
            [float("nan"), 0, 1],
            [1e-40, 0, 0],
            [1e38, 0, 1e38],
            [1, 0, 1e-08],
        ]
    ).T
    n = special.shape[1]
    maps = [
        special.view(3, *shape).expand(3, n, n, n).reshape(3, -1, 1).clone().requires_grad_()
        for shape in ((n, 1, 1), (1, n, 1), (1, 1, n))
    ]
    f = model(*maps)
    assert torch.isfinite(f).all()
    f.sum().backward()
    assert all(torch.isfinite(m.grad).all() for m in maps)
    assert all(torch.isfinite(p.grad).all() for p in model.parameters())
    model.zero_grad()


def test_constant_maps_are_broadcast(model, random_vectors) -> None:
    normal = random_vectors(12).view(1, 3, 3, 4)
    light, view = one(0.1, 0.3, 1), one(0, 0, 1)
    whole = model(normal, light, view)
    assert whole.shape == (1, 3, 3, 4)
    expanded = [v.expand_as(normal).contiguous() for v in (light, view)]
    torch.testing.assert_close(whole, model(normal, *expanded))
    assert model(
        torch.zeros(2, 3, 0, 5), torch.zeros(1, 3, 1, 1), torch.zeros(1, 3, 1, 1)
    ).shape == (
        2,
        3,
        0,
        5,
    )


def test_wrong_shapes_are_one_line(model) -> None:
    with pytest.raises(InputError, match=r"which broadcast, got .*light \[3, 3, 4, 4\]"):
        model(torch.ones(2, 3, 4, 4), torch.ones(3, 3, 4, 4), torch.ones(2, 3, 4, 4))


def test_a_saved_model_comes_back_equal(model, tmp_path: Path, random_vectors) -> None:
    model.diffuse_gain = 0.5
    path = tmp_path / "m.safetensors"
    rt.save_model(model, path)
    model.diffuse_gain, again = 1.0, rt.load_model(path)
    assert (again.diffuse_gain, again.specular_gain) == (0.5, 1.0)
    assert again.provenance == model.provenance
    again.diffuse_gain = 1.0
    vectors = [random_vectors(300, seed) for seed in (1, 2, 3)]
    assert torch.equal(again(*vectors), model(*vectors))
    rt.save_model(rt.RadenBrdf(None, None), path)
    assert rt.load_model(path).table is None


def rewrite(path: Path, change) -> None:
    """Change the JSON header of a safetensors file in place."""
    data = path.read_bytes()
    length = struct.unpack("<Q", data[:8])[0]
    header = json.loads(data[8 : 8 + length])
    about = json.loads(header["__metadata__"]["about"])
    change(header, about)
    header["__metadata__"]["about"] = json.dumps(about)
    text = json.dumps(header).encode()
    path.write_bytes(struct.pack("<Q", len(text)) + text + data[8 + length :])


def test_foreign_and_damaged_files_are_refused(model, tmp_path: Path) -> None:
    path = tmp_path / "m.safetensors"

    def refused(words: str) -> None:
        with pytest.raises(InputError) as error:
            rt.load_model(path)
        assert words in str(error.value)
        assert str(path) in str(error.value)
        assert "\n" not in str(error.value)

    refused("No such file")
    for foreign, what in (
        (b"", "an empty file"),
        (b"x", "text that begins with 'x'"),
        (b"incidence_deg,receiving_deg\n" * 10, "text that begins with 'incidence_deg,"),
        (struct.pack("<Q", 10**10) + b"{", "another file"),
    ):
        path.write_bytes(foreign)
        refused(f"expected a model of raden_torch, got {what}")
    from safetensors.torch import save_file

    save_file({"a": torch.ones(1)}, path)
    refused("expected a model of raden_torch, got another file")
    rt.save_model(model, path)
    whole = path.read_bytes()
    path.write_bytes(whole[:-100])
    refused("got a damaged one")
    path.write_bytes(whole)
    rewrite(path, lambda header, about: about.update(version=99))
    refused("model format: expected up to 3, got 99")
    path.write_bytes(whole)
    rewrite(path, lambda header, about: about.pop("step_deg"))
    refused("got a damaged one")
    path.write_bytes(whole)
    rewrite(path, lambda header, about: about.pop("version"))
    refused("got damaged ones")
    with torch.no_grad():
        model.diffuse.scale[0] = float("nan")
    rt.save_model(model, path)
    refused("diffuse.scale: expected finite values")
    with torch.no_grad():
        model.diffuse.scale[0] = 0.1
