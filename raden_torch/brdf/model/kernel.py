"""The fused kernels: one pass over the pixels instead of a hundred torch operations.

They read the runtime form. `RadenBrdf` and `shade` take them by themselves where the tensors are on
the CPU (C++, in `kernel/`) or on an NVIDIA GPU (`triton_launch.py`) in single (or half) precision.
Eager torch stays the reference: the kernels compute the same formulas (`runtime_table.py`) and
their gradients, and are tested against it.

It is registered as the torch operators `raden_torch::brdf`, its gradient
`raden_torch::brdf_backward`, and `raden_torch::shade` (which has none: with gradients `shade` calls
the model light by light), so that `torch.compile` and `torch.export` see one node each.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, cast

import torch
from torch import Tensor
from torch.autograd import forward_ad

from raden_torch.brdf.model import simd
from raden_torch.brdf.model.runtime_table import read
from raden_torch.geometry import XYZ_DIM, normalised

if TYPE_CHECKING:
    from raden_torch.brdf.model.model import RadenBrdf
    from raden_torch.brdf.shading.lit_sphere import LitSphere

try:
    from raden_torch.brdf import _kernel  # type: ignore[attr-defined, unused-ignore]
except ImportError:
    _kernel = None

PRECISIONS = (torch.float32, torch.float16, torch.bfloat16)
_CPU = torch.device("cpu")
"""Said wherever a tensor is made: the default device may be another."""

LARGEST_SUMS = 2**28
"""Bytes of table gradients, one for each thread, that a backward pass may take."""

FIXED_SLICES = 8
"""Of the pixels, each with a sum and a thread of its own, where torch has to be deterministic."""

MOST_WEIGHTS = 32
"""So many models `shade_several` mixes (`most_weights` in kernel/scene.h)."""

_SUM_CHANNELS = 4
"""Of a node's sums: three, and one that makes them as wide as the processor's registers."""

_TABLE_ARGUMENTS = "Tensor table, float[] warp"
torch.library.define(
    "raden_torch::brdf", f"(Tensor normal, Tensor light, Tensor view, {_TABLE_ARGUMENTS}) -> Tensor"
)
torch.library.define(
    "raden_torch::brdf_backward",
    f"(Tensor gradient, Tensor normal, Tensor light, Tensor view, {_TABLE_ARGUMENTS}, "
    "bool[] wanted) -> Tensor[]",
)
_SHADE_ARGUMENTS = (
    "Tensor normal, Tensor? layers, Tensor? view, Tensor? position, Tensor? camera, Tensor? mask, "
    "Tensor lights"
)
_MAPS = 7
"""How many these are."""
torch.library.define(
    "raden_torch::shade",
    f"({_SHADE_ARGUMENTS}, {_TABLE_ARGUMENTS}) -> Tensor",
)
torch.library.define(
    "raden_torch::shade_several",
    f"({_SHADE_ARGUMENTS}, Tensor choice, Tensor?[] tables, float[] warps) -> Tensor",
)


def takes(model: RadenBrdf, *inputs: Tensor | None) -> bool:
    """Whether the kernel can stand in for the eager form of this model on these tensors."""
    if not takes_tensors(*inputs, *model.parameters()):
        return False
    return model.table is None or model.table.values.shape[-1] == 3


def takes_tensors(*tensors: Tensor | None) -> bool:
    """Whether the kernel can stand in for the eager form: maps and what is behind the table."""
    if torch.onnx.is_in_onnx_export() or within_transform():
        return False
    given = [t for t in tensors if t is not None]
    device = given[0].device
    if any(t.device != device or t.dtype not in PRECISIONS for t in given):
        return False
    return _runs_on(device)


def _runs_on(device: torch.device) -> bool:
    if device.type == "cuda":
        return simd.triton_runs(str(device))
    return device.type == "cpu" and simd.level() != simd.OFF


def look_up(sphere: LitSphere, normal: Tensor, mask: Tensor | None) -> Tensor:
    """The radiance of a lit sphere at each normal, 0 behind it, times the mask.

    Args:
        normal, mask: `[B, 3, H, W]` and `[B or 1, 1, H or 1, W or 1]` on the CPU.
    """
    b, _, h, w = normal.shape
    image = torch.empty(normal.shape, dtype=torch.float32, device=_CPU)
    maps = [None if m is None else m.float().expand(b, -1, h, w) for m in (normal, mask)]
    if image.numel() > 0:
        _kernel.look_up(
            *(None if m is None else _address(m) for m in maps),
            sphere.radiance.data_ptr(),
            len(sphere.radiance),
            tuple(sphere.frame.flatten().tolist()),
            (b, h, w),
            image.data_ptr(),
            _level(),
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
    image = torch.empty(normal.shape, dtype=torch.float32, device=_CPU)
    given = (normal, view, position, _as_map(camera), mask)
    maps = [None if m is None else m.float().expand(b, -1, h, w) for m in given]
    if image.numel() > 0:
        _kernel.look_up_mirror(
            *(None if m is None else _address(m) for m in maps),
            table.data_ptr(),
            nodes,
            tuple(grid),
            (b, h, w),
            image.data_ptr(),
            _level(),
            torch.get_num_threads(),
        )
    return image


def asks_for_gradient(model: RadenBrdf, *inputs: Tensor | None) -> bool:
    """Whether autograd records what is done with these."""
    tensors = (*inputs, *model.parameters(), model.diffuse_gain, model.specular_gain)
    return torch.is_grad_enabled() and any(
        isinstance(t, Tensor) and t.requires_grad for t in tensors
    )


def brdf(
    table: Tensor, warp: tuple[float, float], normal: Tensor, light: Tensor, view: Tensor
) -> Tensor:
    """`model(normal, light, view)` by the kernel, from the model's runtime table; `takes` has to
    agree first."""
    return torch.ops.raden_torch.brdf(normal, light, view, table, warp)


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
    own, shared = (torch.empty((b, 3, h, w), dtype=torch.float32, device=_CPU) for _ in range(2))
    of = nodes.data_ptr(), own.data_ptr(), shared.data_ptr(), scale_std, list(map(int, ends))
    return _shade_by(maps, [nodes], warp, None, of), own, shared


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


def is_transformed(*values: float | Tensor) -> bool:
    """Whether torch.func's transforms or forward-mode differentiation act on one of these."""
    return within_transform() and any(
        isinstance(x, Tensor)
        and (
            torch._C._functorch.is_functorch_wrapped_tensor(x)
            or forward_ad.unpack_dual(x).tangent is not None
        )
        for x in values
    )


def within_transform() -> bool:
    """Within torch.func's transforms or forward-mode differentiation."""
    if torch.compiler.is_compiling():
        return False
    level = forward_ad._current_level
    return level >= 0 or torch._C._functorch.peek_interpreter_stack() is not None


@torch.library.impl("raden_torch::brdf", "CPU")
def _brdf(
    normal: Tensor, light: Tensor, view: Tensor, table: Tensor, warp: Sequence[float]
) -> Tensor:
    maps = torch.broadcast_tensors(normal.float(), light.float(), view.float())
    image = torch.empty(maps[0].shape, dtype=torch.float32, device=_CPU)
    if image.numel() == 0:
        return image
    maps = [_four_dimensions(m) for m in maps]
    held = table.detach().float().contiguous()
    b, _, h, w = maps[0].shape
    _kernel.reflect(
        *_runtime_form(held, warp),
        *map(_address, maps),
        (b, h, w),
        image.data_ptr(),
        _level(),
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
    image = torch.empty(size, dtype=torch.float32, device=_CPU)
    if image.numel() == 0:
        return image
    maps = [
        None if m is None else m.float().expand(b, -1, h, w)
        for m in (normal, layers, view, position, _as_map(camera), mask)
    ]
    index, weights = _index_or_weights(choice, size)
    lamps = lights.float().expand(-1, b, -1).contiguous()
    held = [None if t is None else t.detach().float().contiguous() for t in tables]
    _kernel.shade(
        [(0, 0, 0, 0) if t is None else (t.data_ptr(), *t.shape[:3]) for t in held],
        list(zip(warps[::2], warps[1::2], strict=True)),
        *(None if m is None else _address(m) for m in maps),
        None if index is None else _index_address(index),
        None if weights is None else _address(weights),
        0 if weights is None else weights.shape[1],
        lamps.data_ptr(),
        len(lamps),
        (b, h, w),
        image.data_ptr(),
        errors,
        _level(),
        torch.get_num_threads(),
    )
    return image


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
    image = torch.empty((b, 3, h, w), dtype=torch.float32, device=_CPU)
    if image.numel() == 0:
        return image
    held = [
        None if m is None else m.detach().float().expand(b, -1, h, w)
        for m in (tangent, normal, layers, view, position, _as_map(camera), mask)
    ]
    lamps = lights.detach().float().expand(-1, b, -1).contiguous()
    values = tables.detach().float().contiguous()
    _kernel.shade_turned(
        *_runtime_form(values[0], warp),
        list(turns[0]),
        turns[1],
        *(None if m is None else _address(m) for m in held),
        lamps.data_ptr(),
        len(lamps),
        (b, h, w),
        image.data_ptr(),
        _level(),
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


def _brdf_in_triton(*arguments: Any) -> Tensor:
    from raden_torch.brdf.model import triton_launch

    return triton_launch.brdf(*arguments)


def _shade_in_triton(*arguments: Any) -> Tensor:
    from raden_torch.brdf.model import triton_launch

    *maps, lights = arguments[:_MAPS]
    size = _image_size(*arguments[:_MAPS])
    return triton_launch.shade(size, maps, lights, *arguments[_MAPS:])


def _brdf_backward_in_triton(gradient: Tensor, *arguments: Any) -> list[Tensor]:
    from raden_torch.brdf.model import triton_launch

    *inputs, warp, wanted = arguments
    return triton_launch.brdf_backward(gradient, inputs, warp, wanted)


def _brdf_shape(normal: Tensor, light: Tensor, view: Tensor, *table: Any) -> Tensor:
    shape = torch.broadcast_shapes(normal.shape, light.shape, view.shape)
    return normal.new_empty(shape, dtype=torch.float32)


def _shade_shape(normal: Tensor, *others: Any) -> Tensor:
    b, h, w = _image_size(normal, *others[: _MAPS - 1])
    return normal.new_empty((b, 3, h, w), dtype=torch.float32)


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


_DIFFERENTIABLE = 4
"""The operator's first arguments, which have a gradient: normal, light, view, table."""


def _keep_inputs(ctx: Any, inputs: tuple[Any, ...], output: Tensor) -> None:
    *tensors, ctx.warp = inputs
    ctx.save_for_backward(*tensors)


def _gradient(ctx: Any, gradient: Tensor) -> tuple[Tensor | None, ...]:
    inputs = ctx.saved_tensors
    wanted = [need is True for need in ctx.needs_input_grad[:_DIFFERENTIABLE]]
    if torch.is_grad_enabled():  # somebody wants the gradient of the gradient
        of = [x for x, want in zip(inputs, wanted, strict=True) if want]
        n, l, v, table = inputs  # noqa: E741
        unit = (normalised(m.to(table.dtype)) for m in torch.broadcast_tensors(n, l, v))
        f = read(table, tuple(ctx.warp), *unit)
        found = torch.autograd.grad(f, of, gradient, create_graph=True, allow_unused=True)
    else:
        found = torch.ops.raden_torch.brdf_backward(gradient, *inputs, ctx.warp, wanted)
    each = iter(found)
    return (*(next(each) if want else None for want in wanted), None)


@torch.library.impl("raden_torch::brdf_backward", "CPU")
def _brdf_backward(gradient: Tensor, *arguments: Any) -> list[Tensor]:
    *inputs, warp, wanted = arguments
    shape = gradient.shape
    broadcast = [_four_dimensions(m.float().expand(shape)) for m in (gradient, *inputs[:3])]
    b, _, h, w = broadcast[0].shape
    full = [
        torch.empty(shape if want else 0, dtype=torch.float32, device=_CPU) for want in wanted[:3]
    ]
    table = inputs[3].detach().float().contiguous()
    in_any = torch.are_deterministic_algorithms_enabled()  # the same bits by any number of threads
    slices = max(1, min(FIXED_SLICES if in_any else torch.get_num_threads(), b * h * w // 4096))
    node_sums = (*table.shape[:3], _SUM_CHANNELS)
    if wanted[3]:
        slices = max(1, min(slices, LARGEST_SUMS // (4 * math.prod(node_sums))))
    sums = torch.zeros((slices, *node_sums) if wanted[3] else 0, dtype=torch.float32, device=_CPU)
    if gradient.numel() > 0:
        _kernel.differentiate(
            *_runtime_form(table, warp),
            *(_address(m) for m in (*broadcast[1:], broadcast[0])),
            (b, h, w),
            tuple(m.data_ptr() if m.numel() > 0 else 0 for m in full),
            sums.data_ptr() if wanted[3] else 0,
            slices,
            _level(),
        )
    of_table = sums.sum(0)[..., :3].contiguous() if wanted[3] else sums
    return [
        g.sum_to_size(x.shape).to(x.dtype)
        for g, x, want in zip((*full, of_table), inputs, wanted, strict=True)
        if want
    ]


def _brdf_backward_shape(gradient: Tensor, *arguments: Any) -> list[Tensor]:
    *inputs, _, wanted = arguments
    of = (x for x, want in zip(inputs, wanted, strict=True) if want)
    return [x.new_empty(x.shape) for x in of]


torch.library.impl("raden_torch::brdf", "CUDA", _brdf_in_triton)
torch.library.impl("raden_torch::shade", "CUDA", _shade_in_triton)
torch.library.impl("raden_torch::brdf_backward", "CUDA", _brdf_backward_in_triton)
torch.library.register_fake("raden_torch::brdf", _brdf_shape)
torch.library.register_fake("raden_torch::brdf_backward", _brdf_backward_shape)
torch.library.register_fake("raden_torch::shade", _shade_shape)
torch.library.register_fake("raden_torch::shade_several", _shade_shape)
torch.library.register_autograd("raden_torch::brdf", _gradient, setup_context=_keep_inputs)


def _runtime_form(
    table: Tensor, warp: Sequence[float]
) -> tuple[tuple[int, ...], tuple[float, ...]]:
    """A runtime table as the kernel takes it: where it is and its nodes; and its warp."""
    return (table.data_ptr(), *table.shape[:3]), tuple(warp)


def _four_dimensions(m: Tensor) -> Tensor:
    return m[None] if m.ndim == 3 else m.flatten(0, XYZ_DIM - 1) if m.ndim > 4 else m


def _address(m: Tensor) -> tuple[int, ...]:
    return (m.data_ptr(), *m.stride())


def _level() -> str:
    """A call that `takes` agreed to may come after the kernel was switched off: compiled code."""
    level = simd.level()
    return level if level != simd.OFF else simd.LEVELS[-1]
