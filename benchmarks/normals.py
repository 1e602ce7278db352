"""Photometric stereo of 12 photographs of 2 megapixels: this library against NumPy's least squares.

The scene is simulated: a bumpy plate under 12 lamps with highlights. Each form is run after a
warm-up, in turns, so that what else the machine does reaches all of them; the best and the median
are printed, and the ratio to `numpy.linalg.lstsq`, which solves all pixels at once without regard
to shadows or highlights.
"""

from __future__ import annotations

import argparse
import platform
import statistics
import time
from collections.abc import Callable

import numpy as np
import torch

from raden_torch.capture.photo.lambert_fit import METHODS
from raden_torch.capture.photo.matt_reference import angle_deg
from raden_torch.capture.photo.photometric_stereo import solve_normals


def scene(height: int, width: int, count: int) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """`[K, 1, H, W]` photographs, `[K, 3]` lights and `[1, 3, H, W]` true normals (simulated)."""
    y, x = torch.meshgrid(-torch.arange(height), torch.arange(width), indexing="ij")
    p, q = 0.5 * torch.cos(0.12 * x), -0.4 * torch.sin(0.17 * y)
    normal = torch.nn.functional.normalize(torch.stack([-p, -q, torch.ones_like(p)])[None], dim=1)
    k = torch.arange(count)
    turn, up = 2.4 * k, torch.deg2rad(45 + 20 * torch.sin(1.7 * k))
    lights = torch.stack([up.cos() * turn.cos(), up.cos() * turn.sin(), up.sin()], dim=1)
    images = torch.empty(count, 1, height, width)
    for lamp, image in zip(lights, images, strict=True):
        half = torch.nn.functional.normalize(lamp + torch.tensor([0.0, 0.0, 1.0]), dim=0)
        image[0] = 0.6 * torch.einsum("c,chw->hw", lamp, normal[0]).clamp(min=0)
        image[0] += 0.7 * torch.einsum("c,chw->hw", half, normal[0]).clamp(min=0) ** 200
    return images, lights, normal


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--runs", type=int, default=5)
    parser.add_argument("--height", type=int, default=1200)
    parser.add_argument("--width", type=int, default=1700)
    options = parser.parse_args()
    images, lights, normal = scene(options.height, options.width, 12)
    flat, matrix = images.flatten(1).numpy(), lights.numpy()

    def by_numpy() -> torch.Tensor:
        b = np.linalg.lstsq(matrix, flat, rcond=None)[0]
        b /= np.maximum(np.linalg.norm(b, axis=0), 1e-12)
        return torch.from_numpy(b)

    def by_torch(method: str) -> Callable[[], torch.Tensor]:
        def run() -> torch.Tensor:
            return solve_normals(images, lights, method=method).normal[0].flatten(1)  # type: ignore[arg-type]

        return run

    forms = {"numpy lstsq": by_numpy} | {method: by_torch(method) for method in METHODS}
    seconds: dict[str, list[float]] = {name: [] for name in forms}
    off = {}
    for turn in range(options.runs + 1):
        for name, run in forms.items():
            start = time.perf_counter()
            found = run()
            if turn:  # the first one warms up
                seconds[name].append(time.perf_counter() - start)
            else:
                off[name] = float(angle_deg(found, normal[0].flatten(1)).mean())
    print(f"{platform.processor() or platform.machine()}, {torch.get_num_threads()} threads")
    print(f"12 photographs of {options.width} x {options.height}, {options.runs} runs; simulated")
    print(f"{'form':14} {'best':>8} {'median':>8} {'ratio':>7} {'mean error':>11}")
    for name, taken in seconds.items():
        ratio = statistics.median(a / b for a, b in zip(taken, seconds["numpy lstsq"], strict=True))
        best, median = min(taken), statistics.median(taken)
        print(f"{name:14} {best:7.2f}s {median:7.2f}s {ratio:7.1f} {off[name]:9.2f}°")


if __name__ == "__main__":
    main()
