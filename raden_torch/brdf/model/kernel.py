"""The fused kernels: one pass over the pixels instead of a hundred torch operations.

They read the runtime form. `RadenBrdf` and `shade` take them by themselves where the tensors are on
the CPU (C++, in `kernel/`) or on an NVIDIA GPU (`triton_launch.py`) in single (or half) precision.
Eager torch stays the reference: the kernels compute the same formulas (`runtime_table.py`) and
their gradients, and are tested against it.

f_r is registered as the torch operators `raden_torch::brdf` and, its gradient,
`raden_torch::brdf_backward`, so that `torch.compile` and `torch.export` see one node each;
`shading_kernel.py` has those of pictures.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import torch
from torch import Tensor
from torch.autograd import forward_ad

from raden_torch.brdf.model import simd
from raden_torch.brdf.model.runtime_table import read
from raden_torch.geometry import XYZ_DIM, normalised

if TYPE_CHECKING:
    from raden_torch.brdf.model.model import RadenBrdf

extension: Any
"""The compiled module; None where it was not built."""
try:
    from raden_torch.brdf import _kernel  # type: ignore[attr-defined, unused-ignore]

    extension = _kernel
except ImportError:
    extension = None

PRECISIONS = (torch.float32, torch.float16, torch.bfloat16)
CPU = torch.device("cpu")
"""Said wherever a tensor is made: the default device may be another."""

LARGEST_SUMS = 2**28
"""Bytes of table gradients, one for each thread, that a backward pass may take."""

FIXED_SLICES = 8
"""Of the pixels, each with a sum and a thread of its own, where torch has to be deterministic."""

_SUM_CHANNELS = 4
"""Of a node's sums: three, and one that makes them as wide as the processor's registers."""

TABLE_ARGUMENTS = "Tensor table, float[] warp"
torch.library.define(
    "raden_torch::brdf", f"(Tensor normal, Tensor light, Tensor view, {TABLE_ARGUMENTS}) -> Tensor"
)
torch.library.define(
    "raden_torch::brdf_backward",
    f"(Tensor gradient, Tensor normal, Tensor light, Tensor view, {TABLE_ARGUMENTS}, "
    "bool[] wanted) -> Tensor[]",
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
    image = torch.empty(maps[0].shape, dtype=torch.float32, device=CPU)
    if image.numel() == 0:
        return image
    maps = [_four_dimensions(m) for m in maps]
    held = table.detach().float().contiguous()
    b, _, h, w = maps[0].shape
    extension.reflect(
        *runtime_form(held, warp),
        *map(address, maps),
        (b, h, w),
        image.data_ptr(),
        instruction_set(),
        torch.get_num_threads(),
    )
    return image


def _brdf_in_triton(*arguments: Any) -> Tensor:
    from raden_torch.brdf.model import triton_launch

    return triton_launch.brdf(*arguments)


def _brdf_backward_in_triton(gradient: Tensor, *arguments: Any) -> list[Tensor]:
    from raden_torch.brdf.model import triton_launch

    *inputs, warp, wanted = arguments
    return triton_launch.brdf_backward(gradient, inputs, warp, wanted)


def _brdf_shape(normal: Tensor, light: Tensor, view: Tensor, *table: Any) -> Tensor:
    shape = torch.broadcast_shapes(normal.shape, light.shape, view.shape)
    return normal.new_empty(shape, dtype=torch.float32)


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
        torch.empty(shape if want else 0, dtype=torch.float32, device=CPU) for want in wanted[:3]
    ]
    table = inputs[3].detach().float().contiguous()
    in_any = torch.are_deterministic_algorithms_enabled()  # the same bits by any number of threads
    slices = max(1, min(FIXED_SLICES if in_any else torch.get_num_threads(), b * h * w // 4096))
    node_sums = (*table.shape[:3], _SUM_CHANNELS)
    if wanted[3]:
        slices = max(1, min(slices, LARGEST_SUMS // (4 * math.prod(node_sums))))
    sums = torch.zeros((slices, *node_sums) if wanted[3] else 0, dtype=torch.float32, device=CPU)
    if gradient.numel() > 0:
        extension.differentiate(
            *runtime_form(table, warp),
            *(address(m) for m in (*broadcast[1:], broadcast[0])),
            (b, h, w),
            tuple(m.data_ptr() if m.numel() > 0 else 0 for m in full),
            sums.data_ptr() if wanted[3] else 0,
            slices,
            instruction_set(),
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
torch.library.impl("raden_torch::brdf_backward", "CUDA", _brdf_backward_in_triton)
torch.library.register_fake("raden_torch::brdf", _brdf_shape)
torch.library.register_fake("raden_torch::brdf_backward", _brdf_backward_shape)
torch.library.register_autograd("raden_torch::brdf", _gradient, setup_context=_keep_inputs)


def runtime_form(table: Tensor, warp: Sequence[float]) -> tuple[tuple[int, ...], tuple[float, ...]]:
    """A runtime table as the kernel takes it: where it is and its nodes; and its warp."""
    return (table.data_ptr(), *table.shape[:3]), tuple(warp)


def _four_dimensions(m: Tensor) -> Tensor:
    return m[None] if m.ndim == 3 else m.flatten(0, XYZ_DIM - 1) if m.ndim > 4 else m


def address(m: Tensor) -> tuple[int, ...]:
    return (m.data_ptr(), *m.stride())


def instruction_set() -> str:
    """A call that `takes` agreed to may come after the kernel was switched off: compiled code."""
    level = simd.level()
    return level if level != simd.OFF else simd.LEVELS[-1]
