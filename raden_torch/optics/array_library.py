"""NumPy or torch, whichever the arguments are of: the optics' formulas are written once for both.

torch is not imported: who has a tensor has torch (decision 24).
"""

from __future__ import annotations

import sys
from typing import Any

import numpy as np

Array = Any
"""A NumPy array, a torch tensor, or a number; a function gives back what it was given."""


def library_of(*arrays: Array) -> Any:
    """torch where one of the arrays is a tensor, else NumPy."""
    torch = sys.modules.get("torch")
    if torch is not None and any(isinstance(array, torch.Tensor) for array in arrays):
        return torch
    return np


def as_real(array: Array, *like: Array) -> Array:
    """A floating array of the library, and on the device, of all arguments; complex ones stay.

    float64 in NumPy; of tensors the highest precision among them.
    """
    xp = library_of(array, *like)
    if xp is np:
        return np.asarray(array, None if np.iscomplexobj(array) else np.float64)
    tensors = [a for a in (array, *like) if isinstance(a, xp.Tensor)]
    if isinstance(array, xp.Tensor) and array.is_complex():
        return array
    floating = [a.dtype.to_real() for a in tensors if a.is_floating_point() or a.is_complex()]
    dtype = max(floating, key=lambda d: d.itemsize, default=xp.get_default_dtype())
    return xp.as_tensor(array, dtype=dtype, device=tensors[0].device)


def as_complex(array: Array, *like: Array) -> Array:
    """The same, complex."""
    xp = library_of(array, *like)
    if xp is np:
        return np.asarray(array, np.complex128)
    if isinstance(array, (complex, np.ndarray)):
        dtype = as_real(0.0, *like).dtype.to_complex()
        device = as_real(0.0, *like).device
        return xp.as_tensor(array, dtype=dtype, device=device)
    number = as_real(array, *like)
    return number.to(number.dtype.to_complex())


def outer(a: Array, b: Array) -> Array:
    """`[a…, b…]`: every element of one times every element of the other."""
    return a.reshape((*a.shape, *(1,) * b.ndim)) * b


def sum_with_product(a: Array, x: Array, y: Array) -> Array:
    """a + x y, with one array made on the way."""
    xp = library_of(a, x, y)
    if xp is not np:
        return xp.addcmul(a, x, y)
    product = x * y
    product += a
    return product


def product_with_rows(a: Array, table: Array, rows: Any) -> Array:
    """a · table[rows], with one array made on the way."""
    if library_of(a, table) is not np:
        return a * table[rows]
    product = np.take(table, rows, axis=0, mode="clip")
    product *= a
    return product
