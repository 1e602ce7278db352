"""The fused CPU kernel: one pass over the pixels instead of a hundred torch operations.

`RadenBrdf` and `shade` take it by themselves where the tensors are on the CPU in single (or half)
precision. The eager torch form stays the reference: the kernel computes the same formulas
(`geometry.py`, `diffuse.py`, `reflectance_table.py`) and their gradients, and is tested against it.

It is registered as the torch operators `raden_torch::brdf`, its gradient
`raden_torch::brdf_backward`, and `raden_torch::shade` (which has none: with gradients `shade` calls
the model light by light), so that `torch.compile` and `torch.export` see one node each.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import torch
from torch import Tensor
from torch.autograd import forward_ad

from raden_torch.brdf.model import simd
from raden_torch.geometry import XYZ_DIM

if TYPE_CHECKING:
    from raden_torch.brdf.model.model import RadenBrdf
    from raden_torch.brdf.shading.lit_sphere import LitSphere

try:
    from raden_torch.brdf import _kernel  # type: ignore[attr-defined, unused-ignore]
except ImportError:
    _kernel = None

PRECISIONS = (torch.float32, torch.float16, torch.bfloat16)
LARGEST_TABLE = 2**24
"""Nodes: the kernel counts them in single precision, which is exact up to here."""

_CPU = torch.device("cpu")
"""Said wherever a tensor is made: the default device may be another."""

LARGEST_SUMS = 2**28
"""Bytes of table gradients, one for each thread, that a backward pass may take."""

_MODEL = (
    "Tensor? table, Tensor[] cuts, float[] first_deg, float[] step_deg, Tensor? scale, "
    "Tensor? exponent, float diffuse_gain, float specular_gain"
)
torch.library.define(
    "raden_torch::brdf", f"(Tensor normal, Tensor light, Tensor view, {_MODEL}) -> Tensor"
)
torch.library.define(
    "raden_torch::brdf_backward",
    f"(Tensor gradient, Tensor normal, Tensor light, Tensor view, {_MODEL}, bool[] wanted)"
    " -> Tensor[]",
)
torch.library.define(
    "raden_torch::shade",
    "(Tensor normal, Tensor? view, Tensor? position, Tensor? camera, Tensor? mask, Tensor lights, "
    f"{_MODEL}) -> Tensor",
)
_MAPS = 6
"""The arguments of `shade` before the model's."""


def takes(model: RadenBrdf, *inputs: Tensor | None) -> bool:
    """Whether the kernel can stand in for the eager form of this model on these tensors."""
    if simd.level() == simd.OFF or torch.onnx.is_in_onnx_export() or _is_transformed():
        return False
    if isinstance(model.diffuse_gain, Tensor) or isinstance(model.specular_gain, Tensor):
        return False
    tensors = [t for t in (*inputs, *model.parameters()) if t is not None]
    if any(t.device.type != "cpu" or t.dtype not in PRECISIONS for t in tensors):
        return False
    table = model.table
    return table is None or (
        table.values.shape[-1] == 3 and table.values.numel() <= 3 * LARGEST_TABLE
    )


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


def asks_for_gradient(model: RadenBrdf, *inputs: Tensor | None) -> bool:
    """Whether autograd records what is done with these."""
    tensors = (t for t in (*inputs, *model.parameters()) if t is not None)
    return torch.is_grad_enabled() and any(t.requires_grad for t in tensors)


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
        lights: `[lights, 1 or B, 13]` as `lights.packed` makes it.
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
    image = torch.empty(maps[0].shape, dtype=torch.float32, device=_CPU)
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
        _level(),
        torch.get_num_threads(),
    )
    del held
    return image


@torch.library.impl("raden_torch::shade", "CPU")
def _shade(*arguments: Any) -> Tensor:
    (normal, view, position, camera, mask, lights), model = arguments[:_MAPS], arguments[_MAPS:]
    b, h, w = _image_size(*arguments[:_MAPS])
    size = (b, 3, h, w)
    image = torch.empty(size, dtype=torch.float32, device=_CPU)
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
        _level(),
        torch.get_num_threads(),
    )
    del held
    return image


def _brdf_shape(normal: Tensor, light: Tensor, view: Tensor, *model: Any) -> Tensor:
    shape = torch.broadcast_shapes(normal.shape, light.shape, view.shape)
    return normal.new_empty(shape, dtype=torch.float32)


def _shade_shape(normal: Tensor, *others: Any) -> Tensor:
    b, h, w = _image_size(normal, *others[: _MAPS - 1])
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


# the operator's tensors that have a gradient, by their place among its arguments
_NORMAL, _LIGHT, _VIEW, _TABLE, _CUTS, _SCALE, _EXPONENT = 0, 1, 2, 3, 4, 7, 8
_DIFFERENTIABLE = (_NORMAL, _LIGHT, _VIEW, _TABLE, _SCALE, _EXPONENT)


def _keep_inputs(ctx: Any, inputs: tuple[Any, ...], output: Tensor) -> None:
    tensors = [x for x in inputs if isinstance(x, Tensor)]
    ctx.save_for_backward(*tensors, *inputs[_CUTS])
    ctx.others = [None if isinstance(x, Tensor) else x for x in inputs]
    ctx.is_tensor = [isinstance(x, Tensor) for x in inputs]


def _gradient(ctx: Any, gradient: Tensor) -> tuple[Any, ...]:
    saved = iter(ctx.saved_tensors)
    inputs = [
        next(saved) if is_tensor else other
        for is_tensor, other in zip(ctx.is_tensor, ctx.others, strict=True)
    ]
    inputs[_CUTS] = list(saved)
    wanted = [ctx.needs_input_grad[i] is True for i in _DIFFERENTIABLE]
    if torch.is_grad_enabled():  # somebody wants the gradient of the gradient
        of = [inputs[i] for i, want in zip(_DIFFERENTIABLE, wanted, strict=True) if want]
        f = _eager(*inputs)
        found = torch.autograd.grad(f, of, gradient, create_graph=True, allow_unused=True)
    else:
        found = torch.ops.raden_torch.brdf_backward(gradient, *inputs, wanted)
    # torch counts an empty list as one of tensors, too
    by_input: list[Any] = [
        [None] * len(x) if isinstance(x, list) and (i == _CUTS or not x) else None
        for i, x in enumerate(inputs)
    ]
    places = (i for i, want in zip(_DIFFERENTIABLE, wanted, strict=True) if want)
    for i, g in zip(places, found, strict=True):
        by_input[i] = g
    return tuple(by_input)


@torch.library.impl("raden_torch::brdf_backward", "CPU")
def _brdf_backward(gradient: Tensor, *arguments: Any) -> list[Tensor]:
    *inputs, wanted = arguments
    shape = gradient.shape
    broadcast = [_four_dimensions(m.float().expand(shape)) for m in (gradient, *inputs[:3])]
    b, _, h, w = broadcast[0].shape
    full = [
        torch.zeros(shape if want else 0, dtype=torch.float32, device=_CPU) for want in wanted[:3]
    ]
    held, packed = _packed(*inputs[3:])
    table = inputs[_TABLE]
    sums = table is not None and wanted[3]
    slices = max(1, min(torch.get_num_threads(), b * h * w // 4096))
    if sums:
        slices = max(1, min(slices, LARGEST_SUMS // (4 * table.numel())))
    tables = torch.zeros((slices, *table.shape) if sums else 0, dtype=torch.float32, device=_CPU)
    body = torch.zeros(slices, 2, 3, dtype=torch.float64, device=_CPU)
    if gradient.numel() > 0:
        _kernel.differentiate(
            packed,
            *(_address(m) for m in (*broadcast[1:], broadcast[0])),
            (b, h, w),
            tuple(m.data_ptr() if m.numel() > 0 else 0 for m in full),
            tables.data_ptr() if sums else 0,
            body.data_ptr(),
            slices,
            _level(),
        )
    del held
    return [
        g.sum_to_size(inputs[i].shape).to(inputs[i].dtype)
        for i, g, want in zip(
            _DIFFERENTIABLE, (*full, tables.sum(0), *body.sum(0)), wanted, strict=True
        )
        if want
    ]


def _brdf_backward_shape(gradient: Tensor, *arguments: Any) -> list[Tensor]:
    *inputs, wanted = arguments
    of = (inputs[i] for i, want in zip(_DIFFERENTIABLE, wanted, strict=True) if want)
    return [x.new_empty(x.shape) for x in of]


torch.library.register_fake("raden_torch::brdf", _brdf_shape)
torch.library.register_fake("raden_torch::brdf_backward", _brdf_backward_shape)
torch.library.register_fake("raden_torch::shade", _shade_shape)
torch.library.register_autograd("raden_torch::brdf", _gradient, setup_context=_keep_inputs)


def _eager(normal: Tensor, light: Tensor, view: Tensor, *arguments: Any) -> Tensor:
    """The eager form as a function of the operator's arguments, for gradients of gradients."""
    from raden_torch.brdf.model.model import CosineDiffuse, RadenBrdf
    from raden_torch.brdf.model.reflectance_table import ReflectanceTable

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
    with simd.using(simd.OFF):
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
        held = [table, *(c.float().contiguous() for c in cuts)]
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


def _level() -> str:
    """A call that `takes` agreed to may come after the kernel was switched off: compiled code."""
    level = simd.level()
    return level if level != simd.OFF else simd.LEVELS[-1]
