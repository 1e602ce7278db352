"""The nodes of a runtime table moved a little, so that the mean between them is right."""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor

from raden_torch.brdf.model import kernel

_MOST_BALANCE = 0.05
"""By what share of its value `balanced` may change a node."""


def balanced(values: Tensor) -> Tensor:
    """Nodes `[U, V, W, C]` that make the mean between them right instead of the nodes themselves.

    A chord lies above a function of second difference D, on average by D/12 of that axis: taking
    this off each node is to second order the least-squares fit, whose RMS error is 0.41 of the
    chord's. Beside a highlight narrower than the nodes are apart D says nothing: no value changes
    by more than 5 %, and none its sign.
    """
    if torch.compiler.is_compiling() or kernel.within_transform():
        return _balanced(values)
    return _Balanced.apply(values)


def _balanced(values: Tensor) -> Tensor:
    """`balanced` in operators that have derivatives of any order."""
    total = torch.zeros_like(values)
    for axis, count in enumerate(values.shape[:3]):
        before, here, after = (values.narrow(axis, first, count - 2) for first in range(3))
        second = before - 2 * here + after
        ends = torch.zeros_like(values.narrow(axis, 0, 1))
        total = total + torch.cat([ends, second, ends], axis)
    most = _MOST_BALANCE * values.abs()
    return values - torch.clamp(total / 12, -most, most)


class _Balanced(torch.autograd.Function):
    """`balanced` and its gradient in few passes over the nodes."""

    @staticmethod
    def forward(ctx: Any, values: Tensor) -> Tensor:
        total, most = _twelfth_of_differences(values), values.abs().mul_(_MOST_BALANCE)
        if ctx.needs_input_grad[0]:
            free = total.abs() <= most
            sign = torch.where(free, 0, total.sign().mul_(values.sign()))  # 0 of a value of 0, too
            ctx.save_for_backward(values, free, sign)
        return values - torch.clamp(total, most.neg(), most, out=total)

    @staticmethod
    def backward(ctx: Any, *gradients: Tensor) -> Tensor:
        (values, free, sign), (gradient,) = ctx.saved_tensors, gradients
        if torch.is_grad_enabled():  # somebody wants the gradient of the gradient
            (found,) = torch.autograd.grad(_balanced(values), values, gradient, create_graph=True)
            return found
        within = torch.where(free, gradient, 0)
        held = sign.mul(gradient).mul_(_MOST_BALANCE)
        return torch.sub(gradient, held, out=held).sub_(_twelfth_of_differences(within, True))


def _twelfth_of_differences(values: Tensor, transposed: bool = False) -> Tensor:
    """The sum of the second differences along the axes, 0 at an axis's ends, over 12, to the same
    bits as `_balanced`; or the transposed map of `values`, as the gradient has it."""
    total = torch.zeros_like(values)
    for axis, count in enumerate(values.shape[:3]):
        inner = count - 2
        if transposed:
            of = values.narrow(axis, 1, inner)
            for first, factor in enumerate((1, -2, 1)):
                total.narrow(axis, first, inner).add_(of, alpha=factor)
        else:
            before, here, after = (values.narrow(axis, first, inner) for first in range(3))
            second = torch.sub(before, here, alpha=2).add_(after)
            total.narrow(axis, 1, inner).add_(second)
    return total.div_(12)
