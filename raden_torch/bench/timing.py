"""How long each form of the model takes."""

from __future__ import annotations

import platform
import statistics
import time
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import torch
from torch import Tensor

from raden_torch.bench.forms import NAIVE, PRECISIONS, Form, without_gradients
from raden_torch.brdf.model.model import RadenBrdf

SCALING = (64, 256, 1024, 2048)
"""Sides of square frames, in pixels."""

_LEAST_S = 0.03
"""How long a form is run at least to be timed once."""


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


def time_ratios(
    forms: Sequence[Form], vectors: tuple[Tensor, Tensor, Tensor], runs: int
) -> list[tuple[float, float]]:
    """Run time of each form over the floor and over the naive form, medians.

    The floor is timed beside every form, so that a busy machine hits both.
    """
    copy = _copy(vectors)
    maps = {name: [m.to(dtype) for m in vectors] for name, dtype in PRECISIONS.items()}
    floor: list[float] = []
    taken: list[list[float]] = [[] for _ in forms]
    for _ in range(runs):
        for form, seconds in zip(forms, taken, strict=True):
            floor.append(_seconds(copy))
            seconds.append(_seconds(partial(form.shader, *maps[form.precision])))
    medians = [statistics.median(seconds) for seconds in taken]
    naive = next(m for form, m in zip(forms, medians, strict=True) if form.backend == NAIVE)
    return [(median / statistics.median(floor), median / naive) for median in medians]


def _copy(vectors: tuple[Tensor, Tensor, Tensor]) -> Callable[[], object]:
    """Moves as many bytes as three maps read and one written: two thirds of them there and back."""
    source = torch.cat([m.flatten() for m in vectors])
    part = source[: len(source) * 2 // 3]
    return partial(torch.empty_like(part).copy_, part)


def _seconds(work: Callable[[], object]) -> float:
    """Of one call; short ones are repeated."""
    work()  # what ran before has left its own memory behind
    start, calls, elapsed = time.perf_counter(), 0, 0.0
    while elapsed < _LEAST_S:
        work()
        calls += 1
        elapsed = time.perf_counter() - start
    return elapsed / calls


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
