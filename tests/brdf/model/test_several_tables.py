"""Several tables in one pass of the fused kernel: chosen by an index, or mixed by weights."""

from __future__ import annotations

from collections.abc import Callable

import pytest
import torch
from torch import Tensor

import raden_torch as rt
from raden_torch.brdf.model import shading_kernel, simd
from raden_torch.brdf.model.reflectance_table import ReflectanceTable
from raden_torch.brdf.model.runtime_table import RuntimeLayout
from raden_torch.brdf.shading.lights import KernelLight, packed

pytestmark = [
    pytest.mark.skipif(not simd.LEVELS, reason="the kernel was not built here"),
    pytest.mark.parametrize("level", simd.LEVELS),
]

SIZE = (2, 9, 150)
LIGHTS: dict[str, list[KernelLight]] = {
    "directional": [rt.DirectionalLight((0.3, 0.2, 1.0), (1.0, 2.0, 3.0))],
    "of each image": [rt.DirectionalLight(torch.tensor([[1.0, 0.0, 1.0], [0.0, 1.0, 1.0]]))],
    "point and spot": [
        rt.PointLight((0.3, 0.2, 2.0), (3.0, 2.0, 1.0)),
        rt.SpotLight((0.3, 0.2, 2.0), (0.0, 0.0, 0.0), inner_deg=5, outer_deg=40),
    ],
    "none": [],
}
Maps = tuple[Tensor | None, ...]


@pytest.fixture(scope="module")
def models() -> list[rt.RadenBrdf]:
    """Small random tables; the first two have one layout."""
    generator = torch.Generator().manual_seed(0)
    layouts = [((9, 11, 7), (0.5, 0.4)), ((5, 7, 13), (0.3, 0.7)), ((12, 5, 5), (0.2, 0.2))]
    made = []
    for shape, warp in (layouts[0], *layouts):
        values = torch.rand(4, 7, 7, 3, generator=generator)
        table = ReflectanceTable(values, (0.0, -60.0, -60.0), (20.0, 20.0, 20.0))
        made.append(rt.RadenBrdf(None, table, layout=RuntimeLayout(shape, warp)))
    return [model.requires_grad_(False) for model in made]


def maps(lights: str = "directional", *, layers: bool = False, mask: bool = False) -> Maps:
    """As `shading_kernel.shade_several` takes them."""
    b, h, w = SIZE
    generator = torch.Generator().manual_seed(6)
    normal, leaning = (
        0.5 * torch.randn(b, 3, h, w, generator=generator)
        + torch.tensor([0.0, 0.0, 1.0]).view(3, 1, 1)
        for _ in range(2)
    )
    position = torch.rand(b, 3, h, w, generator=generator) - 0.5
    covered = (torch.rand(b, 1, h, w, generator=generator) - 0.4).clamp(0, 0.5)
    covered[..., :70] = 1  # whole tiles, too
    camera = torch.tensor([[0.0, 0.0, 3.0]])
    lamps = packed(LIGHTS[lights], position, normal)
    own_layers, own_mask = leaning if layers else None, covered if mask else None
    return normal, own_layers, None, position, camera, own_mask, lamps


def alone(model: rt.RadenBrdf, given: Maps) -> Tensor:
    normal, layers, view, position, camera, mask, lamps = given
    assert normal is not None
    assert lamps is not None
    return shading_kernel.shade(model, normal, view, position, camera, mask, lamps, layers)


def indices(count: int) -> dict[str, Tensor]:
    b, h, w = SIZE
    generator = torch.Generator().manual_seed(1)
    scattered = torch.randint(0, count, (b, 1, h, w), generator=generator)
    pieces = (torch.arange(w) // 47 + torch.arange(h)[:, None] // 3) % count
    return {
        "scattered": scattered,
        "pieces": pieces.expand(1, 1, h, w).contiguous(),
        "bytes": scattered.to(torch.uint8),
        "pieces in bytes": pieces.expand(b, 1, h, w).to(torch.uint8),
        "32 bits": scattered.int(),
        "columns": scattered[:1, :, :1],
        "one row a pixel": scattered[:1, :, :, :1],
        "transposed": scattered.transpose(2, 3).contiguous().transpose(2, 3),
        "every other": scattered.repeat_interleave(2, 3)[..., ::2],
        "one": torch.ones(1, 1, 1, 1, dtype=torch.long),
    }


@pytest.mark.parametrize("lights", LIGHTS)
@pytest.mark.parametrize("layers", [False, True])
@pytest.mark.parametrize("mask", [False, True])
def test_each_pixel_is_that_of_its_table_alone(models, level, lights, layers, mask) -> None:
    """Bit for bit, whatever its neighbours read, and however the index lies in memory."""
    given = maps(lights, layers=layers, mask=mask)
    with simd.using(level):
        images = torch.stack([alone(model, given) for model in models])
        for name, index in indices(len(models)).items():
            found = shading_kernel.shade_several(models, index, given)
            at = index.long().expand(SIZE[0], 1, *SIZE[1:]).expand_as(found)
            assert torch.equal(found, images.gather(0, at[None])[0]), name
    assert (images != 0).any() == (lights != "none")


def test_the_error_is_that_of_the_eager_form(models, level) -> None:
    """Against float64 on the same single-precision inputs: at most twice, as of one table."""
    index = indices(len(models))["scattered"]
    gbuffer = {"normal": maps()[0], "position": maps()[3], "camera": (0.0, 0.0, 3.0)}
    lights = [*LIGHTS["directional"], *LIGHTS["point and spot"]]

    def shaded(model: rt.RadenBrdf, dtype: torch.dtype) -> Tensor:
        given = {k: m.to(dtype) if isinstance(m, Tensor) else m for k, m in gbuffer.items()}
        return rt.shade(model, rt.GBuffer(**given), lights)

    def each(image_of: Callable[[rt.RadenBrdf], Tensor]) -> Tensor:
        images = torch.stack([image_of(model) for model in models])
        return images.gather(0, index.expand(-1, 3, -1, -1)[None])[0]

    exact = each(lambda model: shaded(model, torch.float64))
    with simd.using(simd.OFF):
        eager = (each(lambda model: shaded(model, torch.float32)) - exact).abs()
    given = list(maps())
    given[-1] = packed(lights, given[3], gbuffer["normal"])
    with simd.using(level):
        found = (shading_kernel.shade_several(models, index, tuple(given)) - exact).abs()
    rounding = 3e-7 * float(exact.max())
    assert found.mean() <= 2 * eager.mean() + rounding
    for share in (0.9, 0.999):
        assert found.flatten().quantile(share) <= 2 * eager.flatten().quantile(share) + rounding


@pytest.mark.parametrize("integer", [torch.int64, torch.uint8])
def test_an_index_of_no_table_is_black(models, level, integer) -> None:
    """Rationale: what is masked may hold anything, and a table may be missing. Expected: 0 there,
    and all else as before."""
    given, index = maps(), indices(len(models))["scattered"]
    index[0, 0, 0] = 2  # tiles of nothing but what is missing
    far = torch.tensor([-1, 4, 255, -(2**62), 2**40]).to(integer)
    some = torch.rand(index.shape, generator=torch.Generator().manual_seed(4)) < 0.3
    odd = torch.where(some, far[index], index.to(integer))
    odd[0, 0, 1] = far[2]
    there = [models[0], models[1], None, models[3]]
    with simd.using(level):
        images = torch.stack([alone(model, given) for model in models])
        images[2] = 0
        found = shading_kernel.shade_several(there, odd, given)
    known = (odd.long() >= 0) & (odd.long() < 4)
    expected = images.gather(0, (odd.long() * known).expand_as(found)[None])[0] * known
    assert torch.equal(found, expected)


@pytest.mark.parametrize("rest", [False, True])
@pytest.mark.parametrize("mask", [False, True])
def test_weights_mix_the_images(models, level, rest, mask) -> None:
    """Also of tables of one layout, which are read at one place; where a weight is 0, and where all
    but the last are given. Expected: the sum of the images, to a few roundings."""
    b, h, w = SIZE
    generator = torch.Generator().manual_seed(2)
    weights = torch.softmax(2 * torch.randn(b, 4, h, w, generator=generator), 1)
    weights[:, 0, :, :70] = 0
    weights[:, 1:, 5] = 0
    if rest:
        weights[:, 3] = 1 - weights[:, :3].sum(1)
    given = maps("point and spot", layers=True, mask=mask)
    choice = weights[:, :3] if rest else weights
    with simd.using(level):
        expected = sum(weights[:, k : k + 1] * alone(m, given) for k, m in enumerate(models))
        assert isinstance(expected, Tensor)
        for made in (choice, choice.contiguous(memory_format=torch.channels_last)):
            found = shading_kernel.shade_several(models, made, given)
            torch.testing.assert_close(found, expected, rtol=3e-6, atol=1e-6)
        single = shading_kernel.shade_several(models[:2], torch.full((1, 1, 1, 1), 0.25), given)
        both = 0.25 * alone(models[0], given) + 0.75 * alone(models[1], given)
    torch.testing.assert_close(single, both, rtol=3e-6, atol=1e-6)


def test_the_operator_is_registered_as_torch_wants_it(models, level) -> None:
    given = [m if m is None else m[:, :, :3, :5] if m.ndim == 4 else m for m in maps()]
    tables = [models[0].runtime_table(), None]
    for choice in (torch.zeros(1, 1, 3, 5, dtype=torch.long), torch.ones(1, 1, 3, 5)):
        torch.library.opcheck(
            torch.ops.raden_torch.shade_several.default,
            (*given, choice, tables[:1] if choice.is_floating_point() else tables, [0.5] * 4),
            test_utils=("test_schema", "test_autograd_registration", "test_faketensor"),
        )
