"""The torch operators of `kernel.py` on a GPU: arguments for the kernels of `triton_kernels.py`.

Nothing here waits for the GPU or depends on values, so that calls may be captured in a CUDA graph
(after one call with the same kinds of maps, which compiles and picks a block size). Maps are read
as they are: of any floating-point type up to float32, with any strides. A map of more than 2³¹
elements is addressed in 64 bits.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from threading import Lock
from typing import Any

import torch
import triton
from torch import Tensor

from raden_torch.brdf.model import triton_kernels

BLOCKS = (64, 128, 256)
"""Pixels of a program that are tried, one for each thread."""
OPTIONS = {"enable_fp_fusion": True}
"""Of the compiler: a product and a sum are one operation, as in the CPU kernel."""
_INTERPRETED = triton.knobs.runtime.interpret
_INTERPRETED_BLOCK = 2048
_INT32 = 2**31 - 1

FLAGS = {
    "reflect": (),
    "shade": ("LAYERS", "CAMERA", "POSITION", "MASK"),
    "differentiate": ("NORMAL", "LIGHT", "VIEW", "TABLE"),
}


def _tuned(name: str) -> Any:
    """The kernel with its block size picked at the first call of its kind, and kept on disk."""
    kernel = getattr(triton_kernels, name)
    if _INTERPRETED:
        return kernel
    return triton.autotune(
        [triton.Config({"BLOCK": block}, num_warps=block // 32) for block in BLOCKS],
        key=["ONE_ROW", "WIDE", *FLAGS[name]],
        reset_to_zero=["sums"] if name == "differentiate" else None,
        cache_results=True,
    )(kernel)


KERNELS = {name: _tuned(name) for name in FLAGS}
_ONE_AT_A_TIME = Lock()
"""Triton's tuner keeps a call's arguments while it picks."""


Size = tuple[int, int, int]
"""Images, rows, columns."""
Arranged = tuple[Any, ...]
"""A map as the kernels take it."""


def brdf(
    normal: Tensor, light: Tensor, view: Tensor, table: Tensor, warp: Sequence[float]
) -> Tensor:
    """`raden_torch::brdf`."""
    maps = torch.broadcast_tensors(normal, light, view)
    image = normal.new_empty(maps[0].shape, dtype=torch.float32)
    if image.numel() > 0:
        size, (n, l, v, to), wide = _arranged([*map(_images, maps), _images(image)])  # noqa: E741
        _launch("reflect", size, wide, n, l, v, _runtime_form(table, warp), to)
    return image


def shade(
    size: Size,
    maps: Sequence[Tensor | None],
    lights: Tensor,
    table: Tensor,
    warp: Sequence[float],
) -> Tensor:
    """`raden_torch::shade`.

    Args:
        size: of the image.
        maps: normal, layers, view, position, camera and mask.
    """
    b, h, w = size
    normal, layers, view, position, camera, mask = maps
    image = lights.new_empty((b, 3, h, w), dtype=torch.float32)
    if image.numel() == 0:
        return image
    seen_from = view if camera is None else camera[..., None, None]
    full = [
        None if m is None else m.expand(b, -1, h, w)
        for m in (normal, layers, seen_from, position, mask)
    ]
    size, (n, leaning, v, p, share, to), wide = _arranged([*full, image], join_images=False)
    lamps = lights.float().contiguous().expand(-1, b, -1)
    given = (leaning, camera, p, share)
    flags = {f: m is not None for f, m in zip(FLAGS["shade"], given, strict=True)}
    held = _runtime_form(table, warp)
    lamp = (lamps, len(lamps), lamps.stride(0), lamps.stride(1))
    _launch("shade", size, wide, n, leaning or n, v, p or n, share or n, *lamp, held, to, **flags)
    return image


def brdf_backward(
    gradient: Tensor,
    inputs: Sequence[Tensor],
    warp: Sequence[float],
    wanted: Sequence[bool],
) -> list[Tensor]:
    """`raden_torch::brdf_backward` of normal, light, view and table.

    The table's gradient is added up by atomics, in no order. Where torch has to be deterministic
    (`torch.use_deterministic_algorithms`) they add whole numbers, so that no order matters.
    """
    maps = [m.expand(gradient.shape) for m in (gradient, *inputs[:3])]
    full = [
        gradient.new_empty(gradient.shape if want else 0, dtype=torch.float32)
        for want in wanted[:3]
    ]
    table = inputs[3].detach()
    exact = wanted[3] and torch.are_deterministic_algorithms_enabled()
    sums = gradient.new_zeros(
        (*table.shape[:3], 4) if wanted[3] else 1, dtype=torch.int64 if exact else torch.float32
    )
    scale = _scale(gradient) if exact else gradient.new_ones((), dtype=torch.float32)
    if gradient.numel() > 0 and any(wanted):
        size, arranged, wide = _arranged(
            [*map(_images, maps), *(_images(m) if m.numel() > 0 else None for m in full)]
        )
        first = arranged[0]
        flags = dict(zip(FLAGS["differentiate"], wanted, strict=True))
        targets = (m or first for m in arranged[4:])
        held = _runtime_form(table, warp)
        _launch("differentiate", size, wide, *arranged[:4], held, *targets, sums, scale, **flags)
    by_table = sums[..., :3]
    if exact:
        by_table = torch.where(scale > 0, (by_table.double() / scale.double()).float(), math.nan)
    return [
        g.sum_to_size(x.shape).to(x.dtype)
        for g, x, want in zip((*full, by_table), inputs, wanted, strict=True)
        if want
    ]


def _scale(gradient: Tensor) -> Tensor:
    """A power of two by which even the sum of all pixels stays in 62 bits; no value is waited for.

    A quarter of a billion pixels leave 32 bits for one of them, which are more than a float has.
    """
    if gradient.numel() == 0:
        return gradient.new_ones((), dtype=torch.float32)
    largest = torch.linalg.vector_norm(gradient.float(), torch.inf)
    bits = 61 - math.ceil(math.log2(gradient.numel()))
    power = (bits - torch.log2(largest).ceil()).clamp(-126, 126)
    # 0 where it is not finite, which makes the sums NaN
    return torch.where(torch.isfinite(largest), torch.exp2(power), 0.0)


def _images(m: Tensor) -> Tensor:
    """`[..., 3, H, W]` → `[B, 3, H, W]`."""
    return m.reshape(-1, *m.shape[-3:])


def _runtime_form(table: Tensor, warp: Sequence[float]) -> Arranged:
    held = torch.nn.functional.pad(table.detach().float(), (0, 1))
    return (held, *table.shape[:3], warp[0], warp[1] / 2)


def _arranged(
    maps: Sequence[Tensor | None], *, join_images: bool = True
) -> tuple[Size, list[Arranged | None], bool]:
    """The maps, the last of which is the image, as the kernels take them.

    Rows that follow each other without a gap in every map are one long row, and one column is a
    row.

    Args:
        maps: `[B, C, H, W]` of one size.

    Returns:
        the size; the maps; and whether their elements have to be counted in 64 bits.
    """
    b, _, h, w = next(m for m in reversed(maps) if m is not None).shape
    steps = [
        None if m is None else [s if n > 1 else 0 for n, s in zip(m.shape, m.stride(), strict=True)]
        for m in maps
    ]
    given = [s for s in steps if s is not None]
    if w == 1:
        for s in given:
            s[2], s[3] = 0, s[2]
        h, w = 1, h
    elif h > 1 and all(s[2] == s[3] * w for s in given):
        for s in given:
            s[2] = 0
        h, w = 1, h * w
    if h * w == 1 and join_images:
        for s in given:
            s[0], s[3] = 0, s[0]
        b, w = 1, b
    furthest = max(2 * s[1] + (h - 1) * s[2] + (w - 1) * s[3] for s in given)
    arranged = [
        None if m is None or s is None else (m, *s) for m, s in zip(maps, steps, strict=True)
    ]
    return (b, h, w), arranged, max(furthest, h * w) > _INT32 - max(*BLOCKS, _INTERPRETED_BLOCK)


def _launch(name: str, size: Size, wide: bool, *arguments: Any, **flags: bool) -> None:
    images, rows, columns = size
    count = rows * columns

    def grid(chosen: dict[str, Any]) -> tuple[int]:
        return (images * triton.cdiv(count, chosen["BLOCK"]),)

    form: dict[str, Any] = {"ONE_ROW": rows == 1, "WIDE": wide, **flags}
    if _INTERPRETED:
        form["BLOCK"] = _INTERPRETED_BLOCK
    else:
        form |= OPTIONS
    with _ONE_AT_A_TIME, torch.cuda.device_of(arguments[0][0]):
        KERNELS[name][grid](*arguments, count, columns, **form)
