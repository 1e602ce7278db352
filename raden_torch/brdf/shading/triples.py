"""Three numbers of a light or a camera: a place, a direction, a colour."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import torch
from torch import Tensor

from raden_torch.errors import InputError
from raden_torch.geometry import dot

Triple = Tensor | Sequence[float]
"""Three numbers, or a tensor `[3]` or `[B, 3]` (one for each image of a batch)."""
Colour = Triple | float
"""A `Triple` of linear RGB; one number is the same in all three channels."""


def as_map(value: Colour, like: Tensor) -> Tensor:
    """One number, `[3]` or `[B, 3]` → `[1 or B, 3, 1, 1]`, as `like` is."""
    tensor = torch.as_tensor(_own(value), dtype=like.dtype, device=like.device)
    return (tensor.expand(3) if tensor.ndim == 0 else tensor).reshape(-1, 3, 1, 1)


def _own(value: Any) -> Any:
    """NumPy's arrays as torch takes them: of any dtype, reversed, read-only."""
    if isinstance(value, (np.ndarray, np.generic)):
        return torch.from_numpy(np.array(value, np.float64))
    return value


def inverse_square(to_light: Tensor) -> Tensor:
    """1/d², 0 at d = 0 (a lamp in the surface lights nothing)."""
    square = dot(to_light, to_light)
    apart = square > torch.finfo(square.dtype).tiny
    return torch.where(apart, 1 / torch.where(apart, square, torch.ones_like(square)), 0)


def check_direction(where: str, value: Triple) -> None:
    """Raise InputError unless it is three finite numbers (for each image), not all of them 0."""
    if bool((checked(where, value) == 0).all(dim=-1).any()):
        raise InputError(f"{where}: expected a direction, got zero")


def checked(where: str, value: Colour, *, may_be_one: bool = False) -> Tensor:
    """A `Triple` as a tensor in double precision on the CPU.

    Args:
        where: what it is, for messages.
        may_be_one: one number stands for three.

    Raises:
        InputError: other shapes, or numbers that are not finite.
    """
    try:
        tensor = torch.as_tensor(_own(value), dtype=torch.float64, device="cpu")
    except (TypeError, ValueError, OverflowError, RuntimeError):
        raise InputError(f"{where}: expected three numbers, got {value!r}") from None
    if tensor.ndim == 0 and may_be_one:
        tensor = tensor.expand(3)
    if tensor.ndim not in (1, 2) or tensor.shape[-1] != 3:
        raise InputError(f"{where}: expected shape [3] or [B, 3], got {list(tensor.shape)}")
    # a graph that is traced knows no values
    if not torch.compiler.is_compiling() and torch._C._functorch.is_batchedtensor(tensor):
        raise InputError(
            f"{where}: expected numbers that can be read, got a tensor within torch.func.vmap; "
            "give all of them at once, [B, 3]"
        )
    if not torch.compiler.is_compiling() and not torch.isfinite(tensor).all():
        raise InputError(f"{where}: expected three finite numbers, got {value!r}")
    return tensor
