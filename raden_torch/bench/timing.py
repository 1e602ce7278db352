"""Every way of this machine to evaluate a model, and how long each takes."""

from __future__ import annotations

import platform
import statistics
import time
from collections.abc import Callable
from functools import partial
from typing import Any

import torch
from torch import Tensor

from raden_torch.bench.naive_form import naive, reference_naive
from raden_torch.brdf.model import simd
from raden_torch.brdf.model.model import RadenBrdf

SCALING = (64, 256, 1024, 2048)
"""Sides of square frames, in pixels."""

PRECISIONS = {
    "float32": torch.float32,
    "float64": torch.float64,
    "float16": torch.float16,
    "bfloat16": torch.bfloat16,
}
"""Of the maps; half precision is computed in float32."""

_RUNS = 9

Shader = Callable[[Tensor, Tensor, Tensor], Tensor]


def machine() -> dict[str, Any]:
    return {
        "processor": platform.processor() or platform.machine(),
        "threads": torch.get_num_threads(),
        "torch": torch.__version__,
        "python": platform.python_version(),
    }


def frame_vectors(height: int, width: int) -> tuple[Tensor, Tensor, Tensor]:
    """Normal, light and view of a wavy surface under a near lamp: coherent, as pictures are."""
    y, x = torch.meshgrid(
        torch.linspace(-1, 1, height), torch.linspace(-1, 1, width), indexing="ij"
    )
    slope_x, slope_y = 0.5 * torch.sin(9 * x + 3 * y), 0.5 * torch.cos(7 * y - 2 * x)
    normal = torch.stack([slope_x, slope_y, torch.ones_like(x)])[None]
    position = torch.stack([x, y, torch.zeros_like(x)])[None]
    light = torch.tensor([0.7, 0.9, 1.6]).view(1, 3, 1, 1) - position
    view = torch.tensor([0.0, 0.0, 3.0]).view(1, 3, 1, 1) - position
    unit = torch.nn.functional.normalize
    return unit(normal, dim=1), unit(light, dim=1), unit(view, dim=1)


def backends(model: RadenBrdf, compiled: bool = False) -> dict[tuple[str, str], Shader]:
    """Every way of this machine to evaluate a model without gradients, by backend and precision.

    `compiled` adds the eager form under torch.compile, which needs a compiler and its time.
    """
    found: dict[tuple[str, str], Shader] = {}
    for level in reversed(simd.LEVELS):
        found[level, "float32"] = without_gradients(model, level)
    for precision in PRECISIONS:
        found["eager", precision] = without_gradients(model, simd.OFF)
    if compiled:
        torch.compiler.reset()  # else the models before this one count as its recompilations
        found["compiled", "float32"] = without_gradients(torch.compile(model), simd.OFF)
    if simd.LEVELS:
        found[simd.LEVELS[-1], "float16"] = without_gradients(model, simd.LEVELS[-1])
    if model.table is not None and model.table.pieces is None:
        found["naive", "float32"] = torch.no_grad()(partial(naive, model))
    return found


def without_gradients(model: Shader, level: str | None = None) -> Shader:
    """The model without gradients, by the kernel's instruction set; by what it takes where None."""

    def shader(normal: Tensor, light: Tensor, view: Tensor) -> Tensor:
        with torch.no_grad(), simd.using(level or simd.level()):
            return model(normal, light, view)

    return shader


def time_ratios(
    shaders: dict[tuple[str, str], Shader], vectors: tuple[Tensor, Tensor, Tensor]
) -> dict[tuple[str, str], tuple[float, float]]:
    """Run time over the floor and over the naive form, all in turn, medians."""
    source = torch.cat([m.flatten() for m in vectors])
    # as many bytes as three maps read and one written: two thirds of them there and back
    part = source[: len(source) * 2 // 3]
    target = torch.empty_like(part)
    maps = {name: [m.to(dtype) for m in vectors] for name, dtype in PRECISIONS.items()}
    floor, naive = ("floor", ""), ("naive", "float32")
    work: dict[tuple[str, str], Callable[[], object]] = {floor: partial(target.copy_, part)}
    work |= {key: partial(shader, *maps[key[1]]) for key, shader in shaders.items()}
    if naive not in work:
        work[naive] = partial(reference_naive(), *vectors)
    times: dict[tuple[str, str], list[float]] = {key: [] for key in work}
    for _ in range(_RUNS):
        for name, run in work.items():
            run()  # what ran before has left its own memory behind
            start = time.perf_counter()
            run()
            times[name].append(time.perf_counter() - start)
    median = {name: statistics.median(taken) for name, taken in times.items()}
    return {k: (median[k] / median[floor], median[k] / median[naive]) for k in shaders}


def scaling(model: RadenBrdf) -> list[dict[str, float]]:
    """Nanoseconds per pixel over the frame's size."""
    shader, rows = without_gradients(model), []
    for side in SCALING:
        vectors = frame_vectors(side, side)
        taken = []
        for turn in range(4):
            start = time.perf_counter()
            shader(*vectors)
            if turn:
                taken.append(time.perf_counter() - start)
        rows.append({"pixels": side * side, "ns_per_pixel": min(taken) / side**2 * 1e9})
    return rows
