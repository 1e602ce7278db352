"""Runs the kernel, built with sanitizers, over shapes, strides and masks: python THIS KERNEL.so.

`test_sanitizers.py` calls it. Every tensor is as large as what it holds, so that a read beyond its
end meets the allocator's red zone.
"""

from __future__ import annotations

import importlib.machinery
import importlib.util
import sys
from dataclasses import replace
from itertools import product

import torch

loader = importlib.machinery.ExtensionFileLoader("raden_torch.brdf._kernel", sys.argv[1])
spec = importlib.util.spec_from_loader(loader.name, loader)
module = importlib.util.module_from_spec(spec)
sys.modules[loader.name] = module
loader.exec_module(module)

import raden_torch as rt  # noqa: E402
import raden_torch.brdf  # noqa: E402

raden_torch.brdf._kernel = module

from raden_torch.brdf.model import simd  # noqa: E402
from raden_torch.brdf.model.reflectance_table import ReflectanceTable  # noqa: E402
from raden_torch.brdf.model.runtime_table import RuntimeLayout  # noqa: E402
from raden_torch.brdf.model.shading_kernel import shade_several  # noqa: E402
from raden_torch.brdf.shading.lights import KernelLight, packed  # noqa: E402
from raden_torch.brdf.shading.stress_geometries import regions  # noqa: E402

SHAPES = ((1, 1), (1, 7), (3, 64), (2, 65), (5, 131), (130, 1), (33, 33))


def layouts(m: torch.Tensor):
    """The same map in several strides."""
    yield m
    yield m.permute(0, 2, 3, 1).contiguous().permute(0, 3, 1, 2)  # channels last
    yield m.transpose(2, 3).contiguous().transpose(2, 3)
    yield torch.cat([m, m], 3)[..., ::2][..., : m.shape[3]]  # every second column
    yield m[..., :1, :1].expand_as(m)


def main() -> None:
    torch.manual_seed(0)
    table = ReflectanceTable(torch.rand(4, 7, 7, 3), (0.0, -60.0, -60.0), (20.0, 20.0, 20.0))
    for shape, level in product(((3, 3, 3), (5, 9, 7)), simd.LEVELS):
        model = rt.RadenBrdf(None, table, layout=RuntimeLayout(shape, (0.3, 0.5)))
        with simd.using(level):
            for size in SHAPES:
                calls(model, size)
            for vectors in regions(100).values():
                maps = [v.float().clone().requires_grad_() for v in vectors]
                model(*maps).sum().backward()
                with torch.no_grad():
                    model(*(v.float() * torch.nan for v in vectors))
                    model(*(v.float() * torch.inf for v in vectors))
    print("ran through")


def calls(model: rt.RadenBrdf, size: tuple[int, int]) -> None:
    n, l, v, p = (torch.randn(2, 3, *size) for _ in range(4))  # noqa: E741
    lights = [
        rt.DirectionalLight((0.1, 0.2, 1.0), (1.0, 1.0, 1.0)),
        rt.PointLight((0.0, 0.0, 3.0), (1.0, 1.0, 1.0)),
    ]
    for maps in zip(layouts(n), layouts(l), layouts(v), layouts(p), strict=True):
        with torch.no_grad():
            model(*maps[:3])
            for share in (None, 0.0, 0.1, 1.0):
                mask = None if share is None else (torch.rand(2, 1, *size) < share).float()
                buffer = rt.GBuffer(normal=maps[0], view=maps[2], position=maps[3], mask=mask)
                rt.shade(model, buffer, lights)
                rt.shade(model, buffer, lights, tolerance=0.01)
                rt.shade(model, replace(buffer, layer_normal=maps[1]), lights)
                if share in (None, 0.1):
                    several(model, buffer, lights)
        leaves = [m.detach().requires_grad_() for m in maps[:3]]
        model(*leaves).sum().backward()


def several(model: rt.RadenBrdf, buffer: rt.GBuffer, lights: list[KernelLight]) -> None:
    """An index that may be of no table or far beyond them, and weights, in several strides."""
    b, _, h, w = buffer.normal.shape
    position = buffer.position
    lamps = packed(lights, position, buffer.normal)
    maps = (buffer.normal, None, buffer.view, position, None, buffer.mask, lamps)
    other = rt.RadenBrdf(None, model.table, layout=RuntimeLayout((4, 3, 6), (0.7, 0.2)))
    for high in (2, 300):
        for index in layouts(torch.randint(-high // 100, high, (b, 1, h, w))):
            shade_several([model, other, None], index, maps)
            shade_several([model, other], index.to(torch.uint8), maps)
    for weights in layouts(torch.rand(b, 2, h, w) - 0.2):
        shade_several([other, model], weights, maps)
        shade_several([other, model], weights[:, :1], maps)


if __name__ == "__main__":
    main()
