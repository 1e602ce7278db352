"""What the Triton kernels are made of: pixels of maps, vectors, the address, and the table's read.

The formulas are those of `runtime_table.py`.

A map is (pointer, strides of image, channel, row, column), in elements and 0 where it is broadcast.
The runtime table is (pointer, nodes along u, v, w, c, k/2): `[U, V, W, 4]`, one 16-byte load a
node; the fourth number is not used.
"""

from __future__ import annotations

from typing import Any

import triton
import triton.language as tl

_EPS: Any = tl.constexpr(2.0**-23)
_LARGEST: Any = tl.constexpr(3.4028234663852886e38)
_LEAST_NORMAL: Any = tl.constexpr(2.0**-126)
_TINY: Any = tl.constexpr(2.0**-63)  # the root of the least normal number
_SMALLEST: Any = tl.constexpr(1e-30)  # keeps a quotient of numbers that underflow finite
_FAR: Any = tl.constexpr(2.0**60)  # squares of what lies between its inverse and it are normal
_BACK: Any = tl.constexpr(2.0**-100)


@triton.jit
def _pixels(count, columns, ONE_ROW: tl.constexpr, WIDE: tl.constexpr, BLOCK: tl.constexpr):
    """Image, rows and columns of this program's pixels, and which of them exist."""
    tiles = tl.cdiv(count, BLOCK)
    image = tl.program_id(0) // tiles
    tile = tl.program_id(0) - image * tiles
    if WIDE:
        tile = tile.to(tl.int64)
    i = tile * BLOCK + tl.arange(0, BLOCK)
    if ONE_ROW:
        y, x = 0, i
    else:
        y = i // columns
        x = i - y * columns
    return image.to(tl.int64), y, x, i < count


@triton.jit
def _at(m, image, y, x):
    return m[0] + image * m[1] + (y * m[3] + x * m[4])


@triton.jit
def _load(m, image, y, x, kept):
    p = _at(m, image, y, x)
    q = p + m[2]
    return (
        tl.load(p, mask=kept, other=0.0).to(tl.float32),
        tl.load(q, mask=kept, other=0.0).to(tl.float32),
        tl.load(q + m[2], mask=kept, other=0.0).to(tl.float32),
    )


@triton.jit
def _store(m, image, y, x, kept, a, b, c):
    p = _at(m, image, y, x)
    q = p + m[2]
    tl.store(p, a, mask=kept)
    tl.store(q, b, mask=kept)
    tl.store(q + m[2], c, mask=kept)


@triton.jit
def _dot(a, b):
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@triton.jit
def _cross(a, b):
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


@triton.jit
def _scaled(s, a):
    return s * a[0], s * a[1], s * a[2]


@triton.jit
def _added(a, s, b):
    """a + s b."""
    return a[0] + s * b[0], a[1] + s * b[1], a[2] + s * b[2]


@triton.jit
def _chosen(which, a, b):
    return tl.where(which, a[0], b[0]), tl.where(which, a[1], b[1]), tl.where(which, a[2], b[2])


@triton.jit
def _scale(a):
    """A power of two that brings the squares of these components into range; 0 where one is not
    finite or all are 0."""
    largest = tl.maximum(tl.maximum(tl.abs(a[0]), tl.abs(a[1])), tl.abs(a[2]))
    finite = (tl.abs(a[0]) <= _LARGEST) & (tl.abs(a[1]) <= _LARGEST) & (tl.abs(a[2]) <= _LARGEST)
    scale = tl.where(largest > _FAR, _BACK, tl.where(largest < 1.0 / _FAR, 1.0 / _BACK, 1.0))
    return tl.where(finite & (largest > 0), scale, 0.0)


@triton.jit
def _unit(a):
    """`geometry.normalised`: what is unit to a few roundings stays; what is not valid becomes 0."""
    scale = _scale(a)
    s = _chosen(scale > 0, _scaled(scale, a), (0.0, 0.0, 0.0))
    square = _dot(s, s)
    stays = (tl.abs(square - 1.0) < 16 * _EPS) | (square == 0)
    return _scaled(tl.where(stays, 1.0, tl.rsqrt(tl.where(stays, 1.0, square))), s)


@triton.jit
def _difference(a, b):
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]


@triton.jit
def _address(table, n, l, v, n_l, n_v):  # noqa: E741
    """Of `runtime_table.address`: u, y, z, |y| + c m, |z| + k x, δ, |L + V|, and whether L ∦ V."""
    d = _difference(v, l)
    square = _dot(d, d)
    apart = square > 16 * _EPS * _EPS
    lower = tl.minimum(n_l, n_v)
    middle = n_l + n_v
    # what d has along L + V is rounding: unit vectors are so to a few roundings
    radial = _dot(d, _added(l, 1.0, v))
    side = _cross(n, l)  # L ∥ V: the plane of L and N
    y = tl.where(apart, _dot(n, d) - 0.25 * middle * radial, tl.sqrt(_dot(side, side)))
    z = tl.where(apart, _dot(n, _cross(l, d)), 0.0)
    opposite = tl.sqrt(tl.maximum(4.0 - square, _TINY))
    delta = tl.sqrt(tl.where(apart, square, 1.0))
    u = tl.where(apart, delta / (opposite + 2.0), 0.0)
    across = tl.maximum(tl.abs(y) + table[4] * delta * lower, _SMALLEST)
    along = tl.maximum(tl.abs(z) + table[5] * delta * middle, _SMALLEST)
    return u, y, z, across, along, delta, opposite, apart


@triton.jit
def _low(position, nodes):
    return tl.minimum(tl.maximum(tl.floor(position), 0.0), (nodes - 2).to(tl.float32))


@triton.jit
def _place(table, u, v, w):
    """The node below an address, and the fractions above it."""
    last_u, half_v, half_w = table[1] - 1, (table[2] - 1) * 0.5, (table[3] - 1) * 0.5
    x, y, z = u * last_u, v * half_v + half_v, w * half_w + half_w
    i, j, k = _low(x, table[1]), _low(y, table[2]), _low(z, table[3])
    first = (i.to(tl.int32) * table[2] + j.to(tl.int32)) * table[3] + k.to(tl.int32)
    return first, x - i, y - j, z - k


@triton.jit
def _node(values, first):
    return values + first[:, None] * 4 + tl.arange(0, 4)[None, :]


@triton.jit
def _line(values, first, near, far, kept):
    """Between two neighbours along w, `[BLOCK, 4]`."""
    a = tl.load(_node(values, first), mask=kept, other=0.0)
    b = tl.load(_node(values, first + 1), mask=kept, other=0.0)
    return near * a + far * b


@triton.jit
def _read(table, place, above, BLOCK: tl.constexpr):
    """Trilinearly, three channels."""
    first, x, y, z = place
    kept, near, far = above[:, None], (1.0 - z)[:, None], z[:, None]
    values, row = table[0], table[3]
    slab = row * table[2]
    f = ((1.0 - x) * (1.0 - y))[:, None] * _line(values, first, near, far, kept)
    f += ((1.0 - x) * y)[:, None] * _line(values, first + row, near, far, kept)
    f += (x * (1.0 - y))[:, None] * _line(values, first + slab, near, far, kept)
    f += (x * y)[:, None] * _line(values, first + slab + row, near, far, kept)
    even, odd = tl.split(tl.reshape(f, (BLOCK, 2, 2)))
    red, blue = tl.split(even)
    green, _ = tl.split(odd)
    return red, green, blue


@triton.jit
def _f_r(table, n, l, v, n_l, n_v, above, BLOCK: tl.constexpr):  # noqa: E741
    """f_r of unit vectors, 0 where not above."""
    u, y, z, across, along, _delta, _opposite, _apart = _address(table, n, l, v, n_l, n_v)
    place = _place(table, u, y / across, z / along)
    return _chosen(above, _read(table, place, above, BLOCK), (0.0, 0.0, 0.0))
