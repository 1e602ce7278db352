"""The model on a GPU: one pass over the pixels, in Triton.

The formulas are those of `runtime_table.py`, and their derivatives those of `kernel/gradient.h`;
`triton_launch.py` makes the arguments. A program takes BLOCK pixels of one image.

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


@triton.jit
def reflect(
    normal,
    light,
    view,
    table,
    image,
    count,
    columns,
    ONE_ROW: tl.constexpr,
    WIDE: tl.constexpr,
    BLOCK: tl.constexpr,
):
    """f_r of three maps."""
    b, y, x, kept = _pixels(count, columns, ONE_ROW, WIDE, BLOCK)
    n = _unit(_load(normal, b, y, x, kept))
    l = _unit(_load(light, b, y, x, kept))  # noqa: E741
    v = _unit(_load(view, b, y, x, kept))
    n_l, n_v = _dot(n, l), _dot(n, v)
    f = _f_r(table, n, l, v, n_l, n_v, (n_l > 0) & (n_v > 0), BLOCK)
    _store(image, b, y, x, kept, f[0], f[1], f[2])


@triton.jit
def _towards(lamp, kind, position):
    """Direction to a point or spot light and how much of it arrives, without its colour."""
    at = (tl.load(lamp + 1), tl.load(lamp + 2), tl.load(lamp + 3))
    to = _difference(at, position)
    square = _dot(to, to)
    apart = square > _LEAST_NORMAL
    strength = tl.where(apart, 1.0 / tl.where(apart, square, 1.0), 0.0)
    if kind == 2:
        axis = (tl.load(lamp + 7), tl.load(lamp + 8), tl.load(lamp + 9))
        outer, inner = tl.load(lamp + 10), tl.load(lamp + 11)
        length = tl.sqrt(square * _dot(axis, axis))
        cosine = -_dot(to, axis) / tl.maximum(length, _LEAST_NORMAL)
        s = tl.minimum(tl.maximum((cosine - outer) / (inner - outer), 0.0), 1.0)
        strength *= s * s * (3.0 - 2.0 * s)
    return _unit(to), strength


@triton.jit(do_not_specialize=["lamp_count"])
def shade(
    normal,
    view,
    position,
    mask,
    lamps,
    lamp_count,
    lamp_stride,
    lamp_image_stride,
    table,
    image,
    count,
    columns,
    CAMERA: tl.constexpr,
    POSITION: tl.constexpr,
    MASK: tl.constexpr,
    ONE_ROW: tl.constexpr,
    WIDE: tl.constexpr,
    BLOCK: tl.constexpr,
):
    """Σ f_r E cos θi, times the mask; what is not finite is 0. With CAMERA, `view` is the camera
    and the view camera − position. A block of which nothing is seen does nothing."""
    b, y, x, kept = _pixels(count, columns, ONE_ROW, WIDE, BLOCK)
    worth = kept
    share = tl.full((BLOCK,), 1.0, tl.float32)
    if MASK:
        share = tl.load(_at(mask, b, y, x), mask=kept, other=0.0).to(tl.float32)
        worth = share > 0  # not NaN either
        share = tl.where(worth, tl.minimum(share, 1.0), 0.0)
    n = _unit(_load(normal, b, y, x, worth))
    v = _load(view, b, y, x, worth)
    at = (0.0, 0.0, 0.0)
    if POSITION:
        at = _load(position, b, y, x, worth)
    if CAMERA:
        v = _difference(v, at)
    v = _unit(v)
    n_v = _dot(n, v)
    seen = worth & (n_v > 0)
    red = tl.zeros((BLOCK,), tl.float32)
    green, blue = red, red
    lit_by = tl.where(tl.max(seen.to(tl.int32), 0) > 0, lamp_count, 0)
    for k in range(lit_by):
        lamp = lamps + b * lamp_image_stride + k * lamp_stride
        to = (
            tl.zeros((BLOCK,), tl.float32) + tl.load(lamp + 1),
            tl.zeros((BLOCK,), tl.float32) + tl.load(lamp + 2),
            tl.zeros((BLOCK,), tl.float32) + tl.load(lamp + 3),
        )
        strength = tl.full((BLOCK,), 1.0, tl.float32)
        if POSITION:
            kind = tl.load(lamp)
            if kind > 0:
                to, strength = _towards(lamp, kind, at)
        n_l = _dot(n, to)
        strength *= n_l
        lit = seen & (n_l > 0) & (strength > 0)
        f = _f_r(table, n, to, v, n_l, n_v, lit, BLOCK)
        strength = tl.where(lit, strength, 0.0)
        red += strength * f[0] * tl.load(lamp + 4)
        green += strength * f[1] * tl.load(lamp + 5)
        blue += strength * f[2] * tl.load(lamp + 6)
    red = tl.where(tl.abs(red) <= _LARGEST, red * share, 0.0)
    green = tl.where(tl.abs(green) <= _LARGEST, green * share, 0.0)
    blue = tl.where(tl.abs(blue) <= _LARGEST, blue * share, 0.0)
    _store(image, b, y, x, kept, red, green, blue)


@triton.jit
def _slopes_and_sums(table, place, g, sums, above, TABLE: tl.constexpr):
    """The slopes of Σ g f along the axes, in nodes; and what g gives to the eight nodes."""
    first, x, y, z = place
    kept = above[:, None]
    # channels as in the table: red, green, blue, nothing
    g4 = tl.reshape(
        tl.join(tl.join(g[0], g[2]), tl.join(g[1], tl.zeros_like(g[1]))), (first.shape[0], 4)
    )
    values, row = table[0], table[3]
    slab = row * table[2]
    by_x, by_y, by_z = tl.zeros_like(x), tl.zeros_like(x), tl.zeros_like(x)
    for corner in tl.static_range(4):
        up, right = corner // 2, corner % 2
        node = first + up * slab + right * row
        near = tl.sum(tl.load(_node(values, node), mask=kept, other=0.0) * g4, 1)
        far = tl.sum(tl.load(_node(values, node + 1), mask=kept, other=0.0) * g4, 1)
        line = near + z * (far - near)
        along_x = x if up else 1.0 - x
        along_y = y if right else 1.0 - y
        by_x += (line if up else -line) * along_y
        by_y += (line if right else -line) * along_x
        by_z += (far - near) * along_x * along_y
        if TABLE:
            weight = along_x * along_y
            tl.atomic_add(
                _node(sums, node), (weight * (1.0 - z))[:, None] * g4, mask=kept, sem="relaxed"
            )
            tl.atomic_add(
                _node(sums, node + 1), (weight * z)[:, None] * g4, mask=kept, sem="relaxed"
            )
    return by_x, by_y, by_z


@triton.jit
def _before_normalising(g, of, raw, valid):
    """`of`'s part of g taken off, over the length of `raw`: the gradient of the normalisation."""
    scale = _scale(raw)
    s = _chosen(valid & (scale > 0), _scaled(scale, raw), (1.0, 0.0, 0.0))
    shrink = scale * tl.rsqrt(_dot(s, s))
    a, b, c = _scaled(shrink, _added(g, -_dot(g, of), of))
    return (
        tl.where(valid & (tl.abs(a) <= _LARGEST), a, 0.0),
        tl.where(valid & (tl.abs(b) <= _LARGEST), b, 0.0),
        tl.where(valid & (tl.abs(c) <= _LARGEST), c, 0.0),
    )


@triton.jit
def differentiate(
    gradient,
    normal,
    light,
    view,
    table,
    to_normal,
    to_light,
    to_view,
    sums,
    count,
    columns,
    NORMAL: tl.constexpr,
    LIGHT: tl.constexpr,
    VIEW: tl.constexpr,
    TABLE: tl.constexpr,
    ONE_ROW: tl.constexpr,
    WIDE: tl.constexpr,
    BLOCK: tl.constexpr,
):
    """The gradient of `reflect`: into maps, and added to `sums` `[U, V, W, 4]`."""
    b, y, x, kept = _pixels(count, columns, ONE_ROW, WIDE, BLOCK)
    raw_n = _load(normal, b, y, x, kept)
    raw_l = _load(light, b, y, x, kept)
    raw_v = _load(view, b, y, x, kept)
    n, l, v = _unit(raw_n), _unit(raw_l), _unit(raw_v)  # noqa: E741
    n_l, n_v = _dot(n, l), _dot(n, v)
    above = (n_l > 0) & (n_v > 0)
    g = _load(gradient, b, y, x, above)
    at_u, at_y, at_z, across, along, delta, opposite, apart = _address(table, n, l, v, n_l, n_v)
    place = _place(table, at_u, at_y / across, at_z / along)
    by_u, by_v, by_w = _slopes_and_sums(table, place, g, sums, above, TABLE)
    if NORMAL or LIGHT or VIEW:
        lower, middle = tl.minimum(n_l, n_v), n_l + n_v
        c, k = table[4], table[5]
        by_u *= table[1] - 1
        by_v = by_v * ((table[2] - 1) * 0.5) / across / across
        by_w = by_w * ((table[3] - 1) * 0.5) / along / along
        by_y, by_z = by_v * c * delta * lower, by_w * k * delta * middle
        pull, lean = -by_v * c * at_y, -by_w * k * at_z
        by_lower, by_middle = pull * delta, lean * delta
        by_delta = pull * lower + lean * middle + by_u * 2.0 / (opposite * (opposite + 2.0))
        by_n_l = by_middle + tl.where(n_l < n_v, by_lower, 0.0)
        by_n_v = by_middle + tl.where(n_l < n_v, 0.0, by_lower)
        d = _difference(v, l)
        to_d = _added(_scaled(by_y, n), by_z, _cross(n, l))
        to_d = _added(to_d, by_delta / delta, d)
        # L ∥ V: y = sin θ and δ = 1; the two cosines are one
        askew = at_y > 0
        turn = tl.where(askew, by_y * n_l / tl.where(askew, at_y, 1.0), 0.0)
        both = by_lower + 2.0 * by_middle - turn
        if NORMAL:
            to = _added(_scaled(by_y, d), by_z, _cross(l, d))
            to = _added(_added(to, by_n_l, l), by_n_v, v)
            to = _chosen(apart, to, _scaled(both, l))
            to = _before_normalising(to, n, raw_n, above)
            _store(to_normal, b, y, x, kept, to[0], to[1], to[2])
        if LIGHT:
            to = _added(_added(_scaled(by_n_l, n), -1.0, to_d), by_z, _cross(d, n))
            to = _chosen(apart, to, _scaled(both, n))
            to = _before_normalising(to, l, raw_l, above)
            _store(to_light, b, y, x, kept, to[0], to[1], to[2])
        if VIEW:
            to = _chosen(apart, _added(to_d, by_n_v, n), (0.0, 0.0, 0.0))
            to = _before_normalising(to, v, raw_v, above)
            _store(to_view, b, y, x, kept, to[0], to[1], to[2])
