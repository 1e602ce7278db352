"""The model on a GPU: one pass over the pixels, in Triton.

The formulas are those of `runtime_table.py`, and their derivatives those of `kernel/gradient.h`;
`triton_launch.py` makes the arguments, and `triton_address.py` says what they are. A program takes
BLOCK pixels of one image.
"""

from __future__ import annotations

import triton
import triton.language as tl

from raden_torch.brdf.model.triton_address import (
    _LARGEST,
    _LEAST_NORMAL,
    _added,
    _address,
    _at,
    _chosen,
    _cross,
    _difference,
    _dot,
    _f_r,
    _load,
    _node,
    _pixels,
    _place,
    _scale,
    _scaled,
    _store,
    _unit,
)


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


@triton.jit
def _extent(p, seen):
    """Least and largest of one coordinate of what is seen."""
    kept = seen & (tl.abs(p) <= _LARGEST)
    return tl.min(tl.where(kept, p, _LARGEST), 0), tl.max(tl.where(kept, p, -_LARGEST), 0)


@triton.jit
def _square_beside(at, low, high):
    """Of the distance between a lamp's coordinate and a block's extent."""
    beside = tl.maximum(tl.maximum(low - at, at - high), 0.0)
    return beside * beside


@triton.jit
def _reach(lamp, extent, POSITION: tl.constexpr):
    """The most that a lamp can add to a block, over what may be lost."""
    reach = tl.load(lamp + 12)
    if POSITION:
        if (tl.load(lamp) > 0) & (reach < _LARGEST):
            square = _square_beside(tl.load(lamp + 1), extent[0], extent[1])
            square += _square_beside(tl.load(lamp + 2), extent[2], extent[3])
            square += _square_beside(tl.load(lamp + 3), extent[4], extent[5])
            reach = reach / tl.maximum(square, _LEAST_NORMAL)
    return reach


@triton.jit
def _by_lamp(
    table,
    lamp,
    n,
    leaning,
    v,
    n_v,
    at,
    seen,
    LAYERS: tl.constexpr,
    POSITION: tl.constexpr,
    BLOCK: tl.constexpr,
):
    """f_r E cos θi of one lamp: red, green and blue."""
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
    if LAYERS:
        n_l = _dot(leaning, to)
        lit = lit & (n_l > 0)
    f = _f_r(table, leaning, to, v, n_l, n_v, lit, BLOCK)
    strength = tl.where(lit, strength, 0.0)
    return (
        strength * f[0] * tl.load(lamp + 4),
        strength * f[1] * tl.load(lamp + 5),
        strength * f[2] * tl.load(lamp + 6),
    )


@triton.jit(do_not_specialize=["lamp_count"])
def shade(
    normal,
    layers,
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
    LAYERS: tl.constexpr,
    CAMERA: tl.constexpr,
    POSITION: tl.constexpr,
    MASK: tl.constexpr,
    ONE_ROW: tl.constexpr,
    WIDE: tl.constexpr,
    BLOCK: tl.constexpr,
):
    """Σ f_r E cos θi, times the mask; what is not finite is 0. With CAMERA, `view` is the camera
    and the view camera − position. With LAYERS, these are the normals that the table is read with.
    A block of which nothing is seen does nothing, and lamps are left out as long as all that they
    can add to it, their reach, fits into what may be lost."""
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
    leaning = n
    if LAYERS:
        leaning = _unit(_load(layers, b, y, x, worth))
        n_v = _dot(leaning, v)
        seen = seen & (n_v > 0)
    red = tl.zeros((BLOCK,), tl.float32)
    green, blue = red, red
    lit_by = tl.where(tl.max(seen.to(tl.int32), 0) > 0, lamp_count, 0)
    lost = tl.full((), 0.0, tl.float32)
    low_x, high_x, low_y = lost, lost, lost
    high_y, low_z, high_z = lost, lost, lost
    # without a tolerance every reach is the largest number
    if POSITION:
        if (lit_by > 0) & (tl.load(lamps + 12, mask=lit_by > 0, other=0.0) < _LARGEST):
            low_x, high_x = _extent(at[0], seen)
            low_y, high_y = _extent(at[1], seen)
            low_z, high_z = _extent(at[2], seen)
    extent = (low_x, high_x, low_y, high_y, low_z, high_z)
    for k in range(lit_by):
        lamp = lamps + b * lamp_image_stride + k * lamp_stride
        reach = _reach(lamp, extent, POSITION)
        left_out = lost + reach <= 1.0
        lost = tl.where(left_out, lost + reach, lost)
        if not left_out:
            more = _by_lamp(table, lamp, n, leaning, v, n_v, at, seen, LAYERS, POSITION, BLOCK)
            red += more[0]
            green += more[1]
            blue += more[2]
    red = tl.where(tl.abs(red) <= _LARGEST, red * share, 0.0)
    green = tl.where(tl.abs(green) <= _LARGEST, green * share, 0.0)
    blue = tl.where(tl.abs(blue) <= _LARGEST, blue * share, 0.0)
    _store(image, b, y, x, kept, red, green, blue)


@triton.jit
def _add(sums, node, values, scale, kept):
    """To a node of each pixel: in no order, so whole numbers where every run has to agree."""
    if sums.dtype.element_ty == tl.int64:
        values = (values * scale).to(tl.int64)
    tl.atomic_add(_node(sums, node), values, mask=kept, sem="relaxed")


@triton.jit
def _slopes_and_sums(table, place, g, sums, scale, above, TABLE: tl.constexpr):
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
    whole = tl.load(scale) if TABLE else 1.0
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
            _add(sums, node, (weight * (1.0 - z))[:, None] * g4, whole, kept)
            _add(sums, node + 1, (weight * z)[:, None] * g4, whole, kept)
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
    scale,
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
    """The gradient of `reflect`: into maps, and added to `sums` `[U, V, W, 4]`, floats, or
    multiples of 1 / `scale` in 64-bit integers, whose sum is the same in any order."""
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
    by_u, by_v, by_w = _slopes_and_sums(table, place, g, sums, scale, above, TABLE)
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
