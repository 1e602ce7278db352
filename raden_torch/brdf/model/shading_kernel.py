"""The fused kernels for pictures: lamps, mask and camera in the pass that reads the table.

`rt.shade` takes them by itself. `shade` and `shade_several` are torch operators as well, without a
gradient: with gradients `rt.shade` calls the model light by light. What only the CPU has is plain
functions.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, cast

import torch
from torch import Tensor

from raden_torch.brdf.model.kernel import (
    CPU,
    TABLE_ARGUMENTS,
    address,
    extension,
    instruction_set,
    runtime_form,
)

if TYPE_CHECKING:
    from raden_torch.brdf.model.model import RadenBrdf
    from raden_torch.brdf.shading.lit_sphere import LitSphere

MOST_WEIGHTS = 32
"""So many models `shade_several` mixes (`most_weights` in kernel/scene.h)."""

_SHADE_ARGUMENTS = (
    "Tensor normal, Tensor? layers, Tensor? view, Tensor? position, Tensor? camera, Tensor? mask, "
    "Tensor lights"
)
_MAPS = 7
"""How many these are."""
torch.library.define(
    "raden_torch::shade",
    f"({_SHADE_ARGUMENTS}, {TABLE_ARGUMENTS}) -> Tensor",
)
torch.library.define(
    "raden_torch::shade_several",
    f"({_SHADE_ARGUMENTS}, Tensor choice, Tensor?[] tables, float[] warps) -> Tensor",
)


def shade(
    model: RadenBrdf,
    normal: Tensor,
    view: Tensor | None,
    position: Tensor | None,
    camera: Tensor | None,
    mask: Tensor | None,
    lights: Tensor,
    layers: Tensor | None = None,
) -> Tensor:
    """The radiance of a G-buffer by the kernel; `takes` has to agree first.

    Args:
        model: the reflection model.
        normal, view, position, mask: as in `GBuffer`, maps `[B, C, H, W]`.
        camera: `[1 or B, 3]`; the view is camera − position where no view is given.
        lights: `[lights, 1 or B, 13]` as `lights.packed` makes it.
        layers: `layer_normal` of the G-buffer: the table is read with it, and the surface's normal
            keeps the cosine.
    """
    maps = (normal, layers, view, position, camera, mask, lights)
    return torch.ops.raden_torch.shade(*maps, model.runtime_table(), model.layout.warp)


def shade_several(
    models: Sequence[RadenBrdf | None],
    choice: Tensor,
    maps: tuple[Tensor | None, ...],
) -> Tensor:
    """The radiance of a G-buffer of several models in one pass; `takes` has to agree first, for
    each, and the maps are on the CPU.

    Args:
        models: None is 0.
        choice: `[1 or B, 1, H, W]` integers, which model each pixel shows; one that is beyond them
            is 0. Or `[1 or B, K, H, W]` weights of 0 or more, one for each model, of which none is
            None; or one less: the last model has what the others leave of 1.
        maps: normal, layers, view, position, camera, mask and lights, as `shade` takes them.
    """
    # what several models share is one place in memory
    tables = [None if model is None else model.runtime_table() for model in models]
    warps = [c for model in models for c in (model.layout.warp if model else (1.0, 1.0))]
    return torch.ops.raden_torch.shade_several(*maps, choice, tables, warps)


def shade_with_errors(
    nodes: Tensor,
    warp: tuple[float, float],
    maps: tuple[Tensor | None, ...],
    scale_std: float,
    ends: Sequence[bool],
) -> tuple[Tensor, Tensor, Tensor]:
    """The radiance of a G-buffer and its standard deviations by the CPU's kernel; `takes` has to
    agree first.

    Args:
        nodes: `[U, V, W, 16]` float32: f_r, the standard deviation of a node's own error, and its
            change by one standard deviation of each of three errors that all nodes share, in R, G
            and B each; the last number is not looked at.
        maps: normal, layers, view, position, camera, mask and lights, as `shade` takes them.
        scale_std: relative, of all values together.
        ends: of each light, whether the next one's own errors are others.

    Returns:
        `[B, 3, H, W]` each: the image; its standard deviation by own errors, and by shared ones.
    """
    b, h, w = _image_size(*cast(Any, maps))
    own, shared = (torch.empty((b, 3, h, w), dtype=torch.float32, device=CPU) for _ in range(2))
    of = nodes.data_ptr(), own.data_ptr(), shared.data_ptr(), scale_std, list(map(int, ends))
    return _shade_by(maps, [nodes], warp, None, of), own, shared


def shade_turned(
    tables: Tensor,
    warp: tuple[float, float],
    turns: tuple[Sequence[float], float],
    tangent: Tensor,
    maps: Sequence[Tensor | None],
) -> Tensor:
    """The radiance of a G-buffer with tangents by the CPU's kernel; `takes_tensors` has to agree
    first.

    Args:
        tables: `[K, U, V, W, 3]`, one for each azimuth; K U V W below 2²⁴.
        turns: the azimuths, rising, and their period, in radians.
        tangent: `[B, 3, H, W]`, or broadcastable.
        maps: normal, layers, view, position, camera, mask and lights, as for `shade`.
    """
    normal, layers, view, position, camera, mask, lights = maps
    assert normal is not None
    assert lights is not None
    b, h, w = _image_size(normal, layers, view, position, camera, mask, lights)
    image = torch.empty((b, 3, h, w), dtype=torch.float32, device=CPU)
    if image.numel() == 0:
        return image
    held = [
        None if m is None else m.detach().float().expand(b, -1, h, w)
        for m in (tangent, normal, layers, view, position, _as_map(camera), mask)
    ]
    lamps = lights.detach().float().expand(-1, b, -1).contiguous()
    values = tables.detach().float().contiguous()
    extension.shade_turned(
        *runtime_form(values[0], warp),
        list(turns[0]),
        turns[1],
        *(None if m is None else address(m) for m in held),
        lamps.data_ptr(),
        len(lamps),
        (b, h, w),
        image.data_ptr(),
        instruction_set(),
        torch.get_num_threads(),
    )
    return image


def look_up(sphere: LitSphere, normal: Tensor, mask: Tensor | None) -> Tensor:
    """The radiance of a lit sphere at each normal, 0 behind it, times the mask.

    Args:
        normal, mask: `[B, 3, H, W]` and `[B or 1, 1, H or 1, W or 1]` on the CPU.
    """
    b, _, h, w = normal.shape
    image = torch.empty(normal.shape, dtype=torch.float32, device=CPU)
    maps = [None if m is None else m.float().expand(b, -1, h, w) for m in (normal, mask)]
    if image.numel() > 0:
        extension.look_up(
            *(None if m is None else address(m) for m in maps),
            sphere.radiance.data_ptr(),
            len(sphere.radiance),
            tuple(sphere.frame.flatten().tolist()),
            (b, h, w),
            image.data_ptr(),
            instruction_set(),
            torch.get_num_threads(),
        )
    return image


def look_up_mirror(
    table: Tensor,
    nodes: tuple[int, int],
    grid: Sequence[float],
    normal: Tensor,
    view: Tensor | None,
    position: Tensor | None,
    camera: Tensor | None,
    mask: Tensor | None,
) -> Tensor:
    """The radiance of a table over views and mirror directions (`shading/mirror_table.py`), 0
    where the surface is not seen, times the mask; NaN where a node that is NaN is read.

    Args:
        table: `[views · S, S, 3]` with room behind it.
        nodes: views along each side of their grid, and S.
        grid: its axes (9), lowest node (2), step (2); N·V below which R is turned with V.
        normal, view, position, camera, mask: as for `shade`, on the CPU.
    """
    b, _, h, w = normal.shape
    image = torch.empty(normal.shape, dtype=torch.float32, device=CPU)
    given = (normal, view, position, _as_map(camera), mask)
    maps = [None if m is None else m.float().expand(b, -1, h, w) for m in given]
    if image.numel() > 0:
        extension.look_up_mirror(
            *(None if m is None else address(m) for m in maps),
            table.data_ptr(),
            nodes,
            tuple(grid),
            (b, h, w),
            image.data_ptr(),
            instruction_set(),
            torch.get_num_threads(),
        )
    return image


@torch.library.impl("raden_torch::shade", "CPU")
def _shade(*arguments: Any) -> Tensor:
    maps, (table, warp) = arguments[:_MAPS], arguments[_MAPS:]
    return _shade_by(maps, [table], warp, None)


@torch.library.impl("raden_torch::shade_several", "CPU")
def _shade_several(*arguments: Any) -> Tensor:
    maps, (choice, tables, warps) = arguments[:_MAPS], arguments[_MAPS:]
    return _shade_by(maps, tables, warps, choice)


def _shade_by(
    arguments: Sequence[Any],
    tables: Sequence[Tensor | None],
    warps: Sequence[float],
    choice: Tensor | None,
    errors: tuple[Any, ...] | None = None,
) -> Tensor:
    normal, layers, view, position, camera, mask, lights = arguments
    b, h, w = _image_size(*arguments)
    size = (b, 3, h, w)
    image = torch.empty(size, dtype=torch.float32, device=CPU)
    if image.numel() == 0:
        return image
    maps = [
        None if m is None else m.float().expand(b, -1, h, w)
        for m in (normal, layers, view, position, _as_map(camera), mask)
    ]
    index, weights = _index_or_weights(choice, size)
    lamps = lights.float().expand(-1, b, -1).contiguous()
    held = [None if t is None else t.detach().float().contiguous() for t in tables]
    extension.shade(
        [(0, 0, 0, 0) if t is None else (t.data_ptr(), *t.shape[:3]) for t in held],
        list(zip(warps[::2], warps[1::2], strict=True)),
        *(None if m is None else address(m) for m in maps),
        None if index is None else _index_address(index),
        None if weights is None else address(weights),
        0 if weights is None else weights.shape[1],
        lamps.data_ptr(),
        len(lamps),
        (b, h, w),
        image.data_ptr(),
        errors,
        instruction_set(),
        torch.get_num_threads(),
    )
    return image


def _index_or_weights(
    choice: Tensor | None, size: tuple[int, ...]
) -> tuple[Tensor | None, Tensor | None]:
    if choice is None:
        return None, None
    choice = choice.expand(size[0], -1, *size[2:])
    if choice.is_floating_point():
        return None, choice.float()
    return choice if choice.dtype in (torch.uint8, torch.int64) else choice.long(), None


def _index_address(index: Tensor) -> tuple[int, ...]:
    batch, _, row, column = index.stride()
    return index.data_ptr(), index.element_size(), batch, row, column


def _as_map(camera: Tensor | None) -> Tensor | None:
    return None if camera is None else camera[..., None, None]


def _image_size(
    normal: Tensor,
    layers: Tensor | None,
    view: Tensor | None,
    position: Tensor | None,
    camera: Tensor | None,
    mask: Tensor | None,
    lights: Tensor,
) -> tuple[int, int, int]:
    views = [m[:, :1] for m in (normal, layers, view, position, mask) if m is not None]
    batches = [len(camera)] if camera is not None else []
    views += [normal.new_empty(n, 1, 1, 1) for n in (*batches, lights.shape[1])]
    # not broadcast_shapes, which imports sympy when it is first called: half a second
    b, _, h, w = torch.broadcast_tensors(*views)[0].shape
    return b, h, w


def _shade_in_triton(*arguments: Any) -> Tensor:
    from raden_torch.brdf.model import triton_launch

    *maps, lights = arguments[:_MAPS]
    size = _image_size(*arguments[:_MAPS])
    return triton_launch.shade(size, maps, lights, *arguments[_MAPS:])


def _shade_shape(normal: Tensor, *others: Any) -> Tensor:
    b, h, w = _image_size(normal, *others[: _MAPS - 1])
    return normal.new_empty((b, 3, h, w), dtype=torch.float32)


torch.library.impl("raden_torch::shade", "CUDA", _shade_in_triton)
torch.library.register_fake("raden_torch::shade", _shade_shape)
torch.library.register_fake("raden_torch::shade_several", _shade_shape)
