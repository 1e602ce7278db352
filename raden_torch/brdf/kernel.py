"""The fused CPU kernel: one pass over the pixels instead of a hundred torch operations.

`RadenBrdf` and `shade` take it by themselves where no gradient is asked for and the tensors are on
the CPU in single (or half) precision. The eager torch form stays the reference: the kernel computes
the same formulas (`geometry.py`, `diffuse.py`, `table.py`) and is tested against it.

It is registered as the torch operators `raden_torch::brdf` and `raden_torch::shade`, so that
`torch.compile` and `torch.export` see one node. The environment variable RADEN_TORCH_SIMD chooses
its instruction set: avx512, avx2, portable, or off for the eager form.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

import numpy as np
import torch
from torch import Tensor
from torch.autograd import forward_ad

from raden_torch.errors import InputError
from raden_torch.geometry import XYZ_DIM

if TYPE_CHECKING:
    from raden_torch.brdf.model import RadenBrdf

try:
    from raden_torch.brdf import _kernel  # type: ignore[attr-defined, unused-ignore]

    LEVELS: tuple[str, ...] = tuple(_kernel.levels())
    """The instruction sets that this machine can run, the fastest last; empty if not built."""
except ImportError:
    _kernel, LEVELS = None, ()

OFF = "off"
VARIABLE = "RADEN_TORCH_SIMD"
PRECISIONS = (torch.float32, torch.float16, torch.bfloat16)
LARGEST_TABLE = 2**24
"""Nodes: the kernel counts them in single precision, which is exact up to here."""

CUTS = 4
"""Where the operator's list of tensors stands among its arguments."""

_MODEL = (
    "Tensor? table, Tensor[] cuts, float[] first_deg, float[] step_deg, Tensor? scale, "
    "Tensor? exponent, float diffuse_gain, float specular_gain"
)
torch.library.define(
    "raden_torch::brdf", f"(Tensor normal, Tensor light, Tensor view, {_MODEL}) -> Tensor"
)
torch.library.define(
    "raden_torch::shade",
    "(Tensor normal, Tensor? view, Tensor? position, Tensor? camera, Tensor? mask, Tensor lights, "
    f"{_MODEL}) -> Tensor",
)


def _level_asked_for() -> str:
    asked = os.environ.get(VARIABLE, "")
    choices = (*LEVELS, OFF)
    if asked and asked not in choices:
        raise InputError(f"{VARIABLE}={asked}: one of {', '.join(choices)} was wanted here")
    return asked or (LEVELS[-1] if LEVELS else OFF)


_level = _level_asked_for()


def level() -> str:
    """The instruction set in use, or "off"."""
    return _level


@contextmanager
def using(name: str) -> Iterator[None]:
    """Within the block, take this instruction set; "off" takes the eager form."""
    global _level
    if name not in (*LEVELS, OFF):
        raise InputError(f"kernel {name}: one of {', '.join((*LEVELS, OFF))} was wanted here")
    before, _level = _level, name
    try:
        yield
    finally:
        _level = before


def system_report() -> str:
    """Which form of the model runs here, one fact a line."""
    if _level != OFF:
        form = f"fused kernel, {_level} (this machine has {', '.join(LEVELS)})"
    elif LEVELS:
        form = f"eager torch: {VARIABLE}={OFF}"
    else:
        form = "eager torch: the kernel was not built (no C++ compiler at install time?)"
    return "\n".join(
        (
            f"evaluation: {form}",
            "with gradients, in float64 and on other devices: eager torch",
            f"threads: {torch.get_num_threads()}",
            f"torch: {torch.__version__}",
        )
    )


def takes(model: RadenBrdf, *inputs: Tensor | None) -> bool:
    """Whether the kernel can stand in for the eager form of this model on these tensors."""
    if _level == OFF or torch.onnx.is_in_onnx_export() or _is_transformed():
        return False
    parameters = list(model.parameters())
    tensors = [t for t in (*inputs, *parameters) if t is not None]
    if torch.is_grad_enabled() and any(t.requires_grad for t in tensors):
        return False
    if any(t.device.type != "cpu" or t.dtype not in PRECISIONS for t in tensors):
        return False
    table = model.table
    return table is None or (
        table.values.shape[-1] == 3 and table.values.numel() <= 3 * LARGEST_TABLE
    )


def brdf(model: RadenBrdf, normal: Tensor, light: Tensor, view: Tensor) -> Tensor:
    """`model(normal, light, view)` by the kernel; `takes` has to agree first."""
    return torch.ops.raden_torch.brdf(normal, light, view, *_arguments(model))


def shade(
    model: RadenBrdf,
    normal: Tensor,
    view: Tensor | None,
    position: Tensor | None,
    camera: Tensor | None,
    mask: Tensor | None,
    lights: Tensor,
) -> Tensor:
    """The radiance of a G-buffer by the kernel; `takes` has to agree first.

    Args:
        model: the reflection model.
        normal, view, position, mask: as in `GBuffer`, maps `[B, C, H, W]`.
        camera: `[1 or B, 3]`; the view is camera − position where no view is given.
        lights: `[lights, 1 or B, 12]` as `lights.packed` makes it.
    """
    maps = (normal, view, position, camera, mask, lights)
    return torch.ops.raden_torch.shade(*maps, *_arguments(model))


def _is_transformed() -> bool:
    """Within torch.func's transforms or forward-mode differentiation."""
    if torch.compiler.is_compiling():
        return False
    level = forward_ad._current_level
    return level >= 0 or torch._C._functorch.peek_interpreter_stack() is not None


def _arguments(model: RadenBrdf) -> tuple[Any, ...]:
    table = model.table if model.specular_gain != 0 else None
    diffuse = model.diffuse
    return (
        None if table is None else table.values,
        () if table is None else table.cuts,
        () if table is None else table.first_deg,
        () if table is None else table.step_deg,
        None if diffuse is None else diffuse.scale,
        None if diffuse is None else diffuse.exponent,
        model.diffuse_gain,
        model.specular_gain,
    )


@torch.library.impl("raden_torch::brdf", "CPU")
def _brdf(normal: Tensor, light: Tensor, view: Tensor, *model: Any) -> Tensor:
    maps = torch.broadcast_tensors(normal.float(), light.float(), view.float())
    image = torch.empty(maps[0].shape, dtype=torch.float32)
    if image.numel() == 0:
        return image
    maps = [_four_dimensions(m) for m in maps]
    held, packed = _packed(*model)
    b, _, h, w = maps[0].shape
    _kernel.reflect(
        packed,
        *map(_address, maps),
        (b, h, w),
        image.data_ptr(),
        _level_that_is_on(),
        torch.get_num_threads(),
    )
    del held
    return image


@torch.library.impl("raden_torch::shade", "CPU")
def _shade(
    normal: Tensor,
    view: Tensor | None,
    position: Tensor | None,
    camera: Tensor | None,
    mask: Tensor | None,
    lights: Tensor,
    *model: Any,
) -> Tensor:
    b, h, w = _image_size(normal, view, position, camera, mask, lights)
    size = (b, 3, h, w)
    # fresh zero pages cost nothing until they are written, and what is masked out never is
    masked = mask is not None and mask.numel() > 0
    if masked:
        image = torch.from_numpy(np.zeros(size, np.float32))
    else:
        image = torch.empty(size, dtype=torch.float32)
    if image.numel() == 0:
        return image
    maps = [
        None if m is None else m.float().expand(b, -1, h, w)
        for m in (normal, view, position, None if camera is None else camera[..., None, None], mask)
    ]
    lamps = lights.float().expand(-1, b, -1).contiguous()
    held, packed = _packed(*model)
    _kernel.shade(
        packed,
        *(None if m is None else _address(m) for m in maps),
        lamps.data_ptr(),
        len(lamps),
        (b, h, w),
        image.data_ptr(),
        _level_that_is_on(),
        torch.get_num_threads(),
    )
    del held
    return image


def _brdf_shape(normal: Tensor, light: Tensor, view: Tensor, *model: Any) -> Tensor:
    shape = torch.broadcast_shapes(normal.shape, light.shape, view.shape)
    return normal.new_empty(shape, dtype=torch.float32)


def _shade_shape(
    normal: Tensor,
    view: Tensor | None,
    position: Tensor | None,
    camera: Tensor | None,
    mask: Tensor | None,
    lights: Tensor,
    *model: Any,
) -> Tensor:
    b, h, w = _image_size(normal, view, position, camera, mask, lights)
    return normal.new_empty((b, 3, h, w), dtype=torch.float32)


def _image_size(
    normal: Tensor,
    view: Tensor | None,
    position: Tensor | None,
    camera: Tensor | None,
    mask: Tensor | None,
    lights: Tensor,
) -> tuple[int, int, int]:
    views = [m[:, :1] for m in (normal, view, position, mask) if m is not None]
    batches = [len(camera)] if camera is not None else []
    views += [normal.new_empty(n, 1, 1, 1) for n in (*batches, lights.shape[1])]
    # not broadcast_shapes, which imports sympy when it is first called: half a second
    b, _, h, w = torch.broadcast_tensors(*views)[0].shape
    return b, h, w


def _keep_inputs(ctx: Any, inputs: tuple[Any, ...], output: Tensor) -> None:
    tensors = [x for x in inputs if isinstance(x, Tensor)]
    ctx.save_for_backward(*tensors)
    ctx.others = [None if isinstance(x, Tensor) else x for x in inputs]
    ctx.is_tensor = [isinstance(x, Tensor) for x in inputs]


def _brdf_backward(ctx: Any, gradient: Tensor) -> tuple[Any, ...]:
    """The gradient of the eager form, evaluated again."""
    saved = iter(ctx.saved_tensors)
    inputs = [
        next(saved).detach().requires_grad_(ctx.needs_input_grad[i]) if is_tensor else other
        for i, (is_tensor, other) in enumerate(zip(ctx.is_tensor, ctx.others, strict=True))
    ]
    wanted = [i for i, needed in enumerate(ctx.needs_input_grad) if needed is True]
    with torch.enable_grad():
        f = _eager(*inputs)
        found = torch.autograd.grad(f, [inputs[i] for i in wanted], gradient, allow_unused=True)
    by_input = dict(zip(wanted, found, strict=True))
    no_cuts = [None] * len(inputs[CUTS])
    return tuple(no_cuts if i == CUTS else by_input.get(i) for i in range(len(inputs)))


torch.library.register_fake("raden_torch::brdf", _brdf_shape)
torch.library.register_fake("raden_torch::shade", _shade_shape)
torch.library.register_autograd("raden_torch::brdf", _brdf_backward, setup_context=_keep_inputs)


def _eager(normal: Tensor, light: Tensor, view: Tensor, *arguments: Any) -> Tensor:
    """The eager form as a function of the operator's arguments."""
    from raden_torch.brdf.model import CosineDiffuse, RadenBrdf
    from raden_torch.brdf.table import ReflectanceTable

    values, cuts, first_deg, step_deg, scale, exponent, diffuse_gain, specular_gain = arguments
    pieces: Any = tuple(tuple(int(n) for n in c[:, 1].tolist()) for c in cuts) or None
    tensors = {"table.values": values, "diffuse.scale": scale, "diffuse.exponent": exponent}
    tensors = {name: t for name, t in tensors.items() if t is not None}
    model = RadenBrdf(
        None if scale is None else CosineDiffuse(scale.detach(), exponent.detach()),
        None if values is None else ReflectanceTable(values.detach(), first_deg, step_deg, pieces),
        diffuse_gain=diffuse_gain,
        specular_gain=specular_gain,
    )
    with using(OFF):
        return torch.func.functional_call(model, tensors, (normal, light, view))


def _packed(
    values: Tensor | None,
    cuts: list[Tensor],
    first_deg: list[float],
    step_deg: list[float],
    scale: Tensor | None,
    exponent: Tensor | None,
    diffuse_gain: float,
    specular_gain: float,
) -> tuple[list[Tensor], Any]:
    """The model as the kernel takes it, and the tensors that it points into."""
    model = _kernel.Model()
    held = []
    if values is not None:
        table = values.detach().float().contiguous()
        held = [table, *(c.detach().float().contiguous() for c in cuts)]
        model.table = table.data_ptr()
        model.cuts = [c.data_ptr() for c in held[1:]]
        model.cells = [len(c) for c in cuts]
        model.nodes = tuple(table.shape[:3])
        model.first_deg, model.step_deg = tuple(first_deg), tuple(step_deg)
    if scale is not None and exponent is not None:
        model.has_diffuse = True
        model.scale, model.exponent = tuple(scale.tolist()), tuple(exponent.tolist())
    model.diffuse_gain, model.specular_gain = diffuse_gain, specular_gain
    return held, model


def _four_dimensions(m: Tensor) -> Tensor:
    return m[None] if m.ndim == 3 else m.flatten(0, XYZ_DIM - 1) if m.ndim > 4 else m


def _address(m: Tensor) -> tuple[int, ...]:
    return (m.data_ptr(), *m.stride())


def _level_that_is_on() -> str:
    return _level if _level != OFF else LEVELS[-1]
