"""Fit form → runtime form: the model at every node of a `RuntimeLayout`, eq. (2) and all.

What a node holds is linear in the fit form's table T: I_d d + I_s w (M T − d), with the diffuse
part d, the table's weight w, and a matrix M of eight entries a row, which is made once per layout;
then `balanced` moves the nodes a little. It is the torch operator `raden_torch::bake`,
differentiable in the table and the diffuse parameters.
"""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import TYPE_CHECKING, Any

import torch
from torch import Tensor

from raden_torch.brdf.model.balance import balanced
from raden_torch.brdf.model.diffuse import diffuse
from raden_torch.brdf.model.reflectance_table import Pieces, ReflectanceTable, corners
from raden_torch.brdf.model.runtime_table import RuntimeLayout, node_angles

if TYPE_CHECKING:
    from raden_torch.brdf.model.model import RadenBrdf

Triple = tuple[float, float, float]

_ARGUMENTS = (
    "Tensor? table, Tensor? scale, Tensor? exponent, float diffuse_gain, float specular_gain, "
    "Tensor[] cuts, float[] first_deg, float[] step_deg, int[] shape, float[] warp"
)
torch.library.define("raden_torch::bake", f"({_ARGUMENTS}) -> Tensor")
torch.library.define(
    "raden_torch::bake_backward", f"(Tensor gradient, {_ARGUMENTS}, bool[] wanted) -> Tensor[]"
)
_CUTS = 5
_DIFFERENTIABLE = 3
"""The first arguments, which have a gradient: table, scale, exponent."""
_DEVICES = ("CPU", "CUDA", "XPU", "MPS")


def bake(model: RadenBrdf, layout: RuntimeLayout) -> Tensor:
    """The runtime table of a model, `[U, V, W, 3]` f_r in 1/sr: float64 where the model is, else
    float32."""
    table, part = model.table, model.diffuse
    if table is None and part is None:
        return torch.zeros(*layout.shape, 3, device="cpu")
    # the operator, which computes all once more for its gradient, is for graphs and shapes alone
    in_graph = torch.compiler.is_compiling() or any(p.is_meta for p in model.parameters())
    form = torch.ops.raden_torch.bake if in_graph else _bake
    return form(
        None if table is None else table.values,
        None if part is None else part.scale,
        None if part is None else part.exponent,
        model.diffuse_gain,
        model.specular_gain,
        () if table is None else table.cuts,
        () if table is None else table.first_deg,
        () if table is None else table.step_deg,
        layout.shape,
        layout.warp,
    )


@dataclass(frozen=True)
class _Source:
    """A fit form's table without its values, and a layout: what M depends on."""

    nodes: tuple[int, int, int]
    first_deg: Triple
    step_deg: Triple
    pieces: Pieces | None
    layout: RuntimeLayout
    device: str
    dtype: torch.dtype


class _NodeMap:
    """M and w of one `_Source`.

    It outlives the call that made it, so it is made as any other tensor also in
    `torch.inference_mode`.
    """

    @torch.inference_mode(False)
    @torch.no_grad()
    def __init__(self, source: _Source) -> None:
        unread = torch.zeros((), device=source.device).expand(*source.nodes, 1)
        table = ReflectanceTable(unread, source.first_deg, source.step_deg, source.pieces)
        angles = (angle.flatten() for angle in node_angles(source.layout, source.device))
        positions, weight = table.positions(*angles)
        pairs = list(corners(source.nodes, *positions))
        self.columns = torch.stack([index for index, _ in pairs], 1).flatten().long()
        self.entries = torch.stack([entry for _, entry in pairs], 1).flatten().to(source.dtype)
        self.weight = weight.to(source.dtype)[:, None]
        self.is_whole = bool((self.weight == 1).all())
        self.size = (len(weight), source.nodes[0] * source.nodes[1] * source.nodes[2])

    @cached_property
    @torch.inference_mode(False)
    def matrix(self) -> Tensor:
        starts = torch.arange(0, len(self.columns) + 1, 8, device=self.columns.device)
        return _csr(starts, self.columns, self.entries, self.size)

    @cached_property
    @torch.inference_mode(False)
    def transposed(self) -> Tensor:
        order = torch.argsort(self.columns, stable=True)
        counts = torch.bincount(self.columns, minlength=self.size[1])
        starts = torch.cat([counts.new_zeros(1), counts.cumsum(0)])
        return _csr(starts, order // 8, self.entries[order], (self.size[1], self.size[0]))


@lru_cache(maxsize=4)  # some 20 MB each
def _node_map(source: _Source) -> _NodeMap:
    return _NodeMap(source)


def _csr(starts: Tensor, columns: Tensor, entries: Tensor, size: tuple[int, int]) -> Tensor:
    if len(columns) < 2**31:  # as MKL has them: 64 bits would be converted for each product
        starts, columns = starts.int(), columns.int()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # torch calls all of its CSR tensors beta
        return torch.sparse_csr_tensor(
            starts, columns, entries, size, device=entries.device, check_invariants=False
        )


class _Linear(torch.autograd.Function):
    """M x, whose gradient is Mᵀ g, whose gradient is M h, and so on."""

    @staticmethod
    def forward(x: Tensor, source: _Source, transposed: bool) -> Tensor:
        found = _node_map(source)
        return (found.transposed if transposed else found.matrix) @ x

    @staticmethod
    def setup_context(ctx: Any, inputs: tuple[Any, ...], output: Tensor) -> None:
        _, ctx.source, ctx.transposed = inputs

    @staticmethod
    def backward(ctx: Any, *gradients: Tensor) -> tuple[Any, ...]:
        return _Linear.apply(gradients[0], ctx.source, not ctx.transposed), None, None

    @staticmethod
    def jvp(ctx: Any, *tangents: Any) -> Tensor:
        return _Linear.apply(tangents[0], ctx.source, ctx.transposed)

    @staticmethod
    def vmap(
        info: Any, in_dims: tuple[int | None, ...], x: Tensor, source: _Source, transposed: bool
    ) -> tuple[Tensor, int | None]:
        if in_dims[0] is None:
            return _Linear.apply(x, source, transposed), None
        columns = x.movedim(in_dims[0], -1)
        found = _Linear.apply(columns.flatten(1), source, transposed)
        return found.unflatten(1, columns.shape[1:]), -1


def _bake(
    table: Tensor | None,
    scale: Tensor | None,
    exponent: Tensor | None,
    diffuse_gain: float | Tensor,
    specular_gain: float | Tensor,
    cuts: Sequence[Tensor],
    first_deg: Sequence[float],
    step_deg: Sequence[float],
    shape: Sequence[int],
    warp: Sequence[float],
) -> Tensor:
    """The formula in plain torch, with derivatives of any order; the arguments are `_ARGUMENTS`."""
    layout = RuntimeLayout((shape[0], shape[1], shape[2]), (warp[0], warp[1]))
    like = table if table is not None else scale
    assert like is not None
    dtype = like.dtype if like.dtype == torch.float64 else torch.float32
    # where torch has no sparse matrices, the CPU does it
    device = like.device if like.device.type in ("cpu", "cuda") else torch.device("cpu")
    channels = like.shape[-1]
    shape_of_f = (*layout.shape, channels)
    f = torch.zeros((), dtype=dtype, device=device).expand(shape_of_f)
    weight, is_whole = None, False
    if table is not None and specular_gain != 0:
        pieces: Any = tuple(tuple(int(n) for n in c[:, 1].tolist()) for c in cuts) or None
        nodes = table.shape[:3]
        source = _Source(
            (nodes[0], nodes[1], nodes[2]),
            (first_deg[0], first_deg[1], first_deg[2]),
            (step_deg[0], step_deg[1], step_deg[2]),
            pieces,
            layout,
            str(device),
            dtype,
        )
        rows = table.to(device, dtype).reshape(-1, channels)
        nodes_of = _node_map(source)
        weight, is_whole = nodes_of.weight.reshape(*layout.shape, 1), nodes_of.is_whole
        cancels = is_whole and not isinstance(specular_gain, Tensor)
        cancels = cancels and bool(diffuse_gain == specular_gain)
        if cancels and scale is not None and exponent is not None:
            rows = rows + 0 * (scale.sum() + exponent.sum()).to(rows)  # so their gradient is 0
            scale = exponent = None
        total = _Linear.apply(rows, source, False).reshape(shape_of_f)
        f = balanced(total if is_whole else weight * total)
        if isinstance(specular_gain, Tensor) or specular_gain != 1:
            f = specular_gain * f
    if scale is None or exponent is None:
        return f.to(like.device)
    # the two terms are balanced one by one, so that eq. (2) stays linear in its gains
    a, r, t = (angle.flatten()[None, :, None] for angle in node_angles(layout, device))
    part = diffuse(a, r, t, scale.to(device).double(), exponent.to(device).double())
    body = part[:, :, 0].T.to(dtype).reshape(f.shape)
    f = f + diffuse_gain * balanced(body)
    if weight is not None:
        f = f - specular_gain * balanced(body if is_whole else weight * body)
    return f.to(like.device)


@torch.library.impl("raden_torch::bake", _DEVICES)
def _bake_op(*arguments: Any) -> Tensor:
    return _bake(*arguments).contiguous()


@torch.library.impl("raden_torch::bake_backward", _DEVICES)
def _bake_backward(gradient: Tensor, *arguments: Any) -> list[Tensor]:
    *inputs, wanted = arguments
    with torch.enable_grad():
        of = [
            inputs[i].detach().requires_grad_() if want else inputs[i]
            for i, want in enumerate(wanted)
        ]
        f = _bake(*of, *inputs[_DIFFERENTIABLE:])
    of = [x for x, want in zip(of, wanted, strict=True) if want]
    found: Sequence[Tensor | None] = [None] * len(of)
    if f.requires_grad:
        found = torch.autograd.grad(f, of, gradient, allow_unused=True)
    return [
        torch.zeros_like(x) if g is None else g.contiguous() for g, x in zip(found, of, strict=True)
    ]


def _bake_shape(table: Tensor | None, scale: Tensor | None, *others: Any) -> Tensor:
    like = table if table is not None else scale
    assert like is not None
    dtype = like.dtype if like.dtype == torch.float64 else torch.float32
    return like.new_empty((*others[-2], like.shape[-1]), dtype=dtype)


def _bake_backward_shape(gradient: Tensor, *arguments: Any) -> list[Tensor]:
    *inputs, wanted = arguments
    return [x.new_empty(x.shape) for x, want in zip(inputs, wanted, strict=False) if want]


def _keep(ctx: Any, inputs: tuple[Any, ...], output: Tensor) -> None:
    tensors = [x for x in inputs if isinstance(x, Tensor)]
    ctx.save_for_backward(*tensors, *inputs[_CUTS])
    ctx.inputs = [None if isinstance(x, Tensor) else x for x in inputs]
    ctx.is_tensor = [isinstance(x, Tensor) for x in inputs]


def _gradient(ctx: Any, gradient: Tensor) -> tuple[Any, ...]:
    saved = iter(ctx.saved_tensors)
    inputs = [
        next(saved) if is_tensor else x
        for x, is_tensor in zip(ctx.inputs, ctx.is_tensor, strict=True)
    ]
    inputs[_CUTS] = list(saved)
    wanted = [need is True for need in ctx.needs_input_grad[:_DIFFERENTIABLE]]
    if torch.is_grad_enabled():  # somebody wants the gradient of the gradient
        of = [x for x, want in zip(inputs, wanted, strict=False) if want]
        f = _bake(*inputs)
        found = torch.autograd.grad(f, of, gradient, create_graph=True, allow_unused=True)
    else:
        found = torch.ops.raden_torch.bake_backward(gradient, *inputs, wanted)
    each = iter(found)
    # a list of tensors takes a list of gradients, and torch takes any empty list for one
    others = [
        [None] * len(x) if isinstance(x, list) and (i == _CUTS or not x) else None
        for i, x in enumerate(inputs)
    ]
    return (*(next(each) if want else None for want in wanted), *others[_DIFFERENTIABLE:])


torch.library.register_fake("raden_torch::bake", _bake_shape)
torch.library.register_fake("raden_torch::bake_backward", _bake_backward_shape)
torch.library.register_autograd("raden_torch::bake", _gradient, setup_context=_keep)
