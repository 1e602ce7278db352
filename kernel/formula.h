// The model's formulas for one vector of pixels. The reference is geometry.py, diffuse.py, reflectance_table.py.
#pragma once
#include <cfloat>

#include "scene.h"

namespace raden {

constexpr float eps = FLT_EPSILON;
constexpr float tiny = 1.0842022e-19f;  // the root of the least normal float
constexpr float least_power = 1e-30f;   // below this, 1 − cos a counts as 0

template <class V>
struct Vector3 {
    V x, y, z;
};

template <class V>
inline V dot(const Vector3<V>& a, const Vector3<V>& b) {
    return fma(a.z, b.z, fma(a.y, b.y, a.x * b.x));
}

template <class V>
inline Vector3<V> cross(const Vector3<V>& a, const Vector3<V>& b) {
    return {fms(a.y, b.z, a.z * b.y), fms(a.z, b.x, a.x * b.z), fms(a.x, b.y, a.y * b.x)};
}

template <class V>
inline unsigned all_lanes(const V&) {
    return (1u << V::lanes) - 1;
}

// `normalised` for huge, denormal, zero and non-finite vectors: by the largest component first.
template <class V>
Vector3<V> unit_of_any_length(const Vector3<V>& v) {
    const V ax = magnitude(v.x), ay = magnitude(v.y), az = magnitude(v.z);
    const V largest = greatest(greatest(ax, ay), az);
    auto valid = both(both(ax <= FLT_MAX, ay <= FLT_MAX), az <= FLT_MAX);
    valid = both(valid, V(0.0f) < largest);
    const V by = select(valid, largest, 1.0f);
    const Vector3<V> s{v.x / by, v.y / by, v.z / by};
    const V length = root(dot(s, s));
    return {select(valid, s.x / length, 0.0f), select(valid, s.y / length, 0.0f),
            select(valid, s.z / length, 0.0f)};
}

// `normalised`: what is unit to a few roundings stays; zero and non-finite vectors become zero.
// Every lane's value is independent of its neighbours'; only the cost depends on them.
template <class V>
inline Vector3<V> unit(const Vector3<V>& v) {
    const V square = dot(v, v);
    const auto is_unit = magnitude(square - 1.0f) < 16 * eps;
    if (bits(is_unit) == all_lanes(square)) return v;
    const V inverse = V(1.0f) / root(square);
    Vector3<V> u{select(is_unit, v.x, v.x * inverse), select(is_unit, v.y, v.y * inverse),
                 select(is_unit, v.z, v.z * inverse)};
    const auto usual = both(V(1e-30f) < square, square < 1e30f);
    if (bits(usual) == all_lanes(square)) return u;
    const Vector3<V> other = unit_of_any_length(v);
    return {select(usual, u.x, other.x), select(usual, u.y, other.y), select(usual, u.z, other.z)};
}

// Tangents of the half angles, after the flip that makes a ≥ 0.
template <class V>
struct HalfAngles {
    V a, r, t;
};

// `angles_from_unit_vectors`, everything times s = |L×V| so that one division is left per angle.
// Only lanes above the horizon count: there every tangent lies in −1…1.
template <class V>
inline HalfAngles<V> half_angles(const Vector3<V>& n, const Vector3<V>& l, const Vector3<V>& v,
                                 const V& n_l, const V& n_v, unsigned lanes) {
    const auto opposed = dot(l, v) < 0.0f;
    const Vector3<V> d{v.x - negated_where(opposed, l.x), v.y - negated_where(opposed, l.y),
                       v.z - negated_where(opposed, l.z)};
    const Vector3<V> p = cross(l, d);
    const V square = dot(p, p), s = root(square), n_d = dot(n, d);
    const V across_l = fnma(dot(d, l), n_l, n_d);
    const V across_v = negated_where(opposed, fnma(dot(d, v), n_v, n_d));
    const V h = root(fma(across_l, across_l, square * fma(n_l, n_l, tiny)));  // s cos t
    const auto flip = across_l < 0.0f;
    const V floor = eps * s;
    HalfAngles<V> half;
    half.a = magnitude(across_l) / greatest(fma(s, n_l, h), floor);
    half.r = V(0.0f) - negated_where(flip, across_v) / greatest(fma(s, n_v, h), floor);
    half.r = greatest(least(half.r, 1.0f), -1.0f);
    half.t = negated_where(flip, dot(n, p)) / (s + h);
    const auto apart = V(4 * eps) < s;
    if ((bits(apart) & lanes) == lanes) return half;
    // L ∥ V: the plane of L and N
    const Vector3<V> m = cross(n, l);
    const V theta = root(dot(m, m)) / (n_l + 1.0f);
    const V back = select(opposed, V(1.0f) / greatest(theta, eps), V(0.0f) - theta);
    half.a = select(apart, half.a, theta);
    half.r = select(apart, half.r, least(back, 1.0f));
    half.t = select(apart, half.t, 0.0f);
    return half;
}

// atan on −1…1 to 6e-9 (a minimax polynomial).
template <class V>
inline V arctan(const V& x) {
    const V y = x * x;
    V p = fma(y, V(2.456722070e-03f), V(-1.440134825e-02f));
    p = fma(p, y, 3.978120843e-02f);
    p = fma(p, y, -7.234856126e-02f);
    p = fma(p, y, 1.049894551e-01f);
    p = fma(p, y, -1.416122905e-01f);
    p = fma(p, y, 1.998590675e-01f);
    p = fma(p, y, -3.333259703e-01f);
    p = fma(p, y, 9.999998864e-01f);
    return p * x;
}

// log2(m) for m in 0.75…1.5 (a minimax polynomial).
template <class V>
inline V log2_of_mantissa(const V& m) {
    const V f = m - 1.0f;
    V p = fma(f, V(1.272945444e-01f), V(-2.097150150e-01f));
    p = fma(p, f, 2.163230008e-01f);
    p = fma(p, f, -2.385791169e-01f);
    p = fma(p, f, 2.877978695e-01f);
    p = fma(p, f, -3.607200621e-01f);
    p = fma(p, f, 4.809160872e-01f);
    p = fma(p, f, -7.213471324e-01f);
    p = fma(p, f, 1.442694948e+00f);
    return p * f;
}

// 2^f for f in −1…1/2 around a whole number n (a minimax polynomial).
template <class V>
inline V power_of_two(const V& n, const V& f) {
    const V whole = nearest(f), x = f - whole;
    V p = fma(x, V(1.534581204e-04f), V(1.339993136e-03f));
    p = fma(p, x, 9.618488958e-03f);
    p = fma(p, x, 5.550328777e-02f);
    p = fma(p, x, 2.402264689e-01f);
    p = fma(p, x, 6.931472057e-01f);
    p = fma(p, x, 1.0f);
    return scaled(p, n + whole);
}

// Eq. (5): (1 − cos a)^n with 1 − cos a = 2 sin²(a/2) = 2τ²/(1 + τ²), as 2^(n log2). The exponent's
// part of the product is exact, so that no digits are lost where a is small.
template <class V>
struct IncidenceTerm {
    V exponent, fraction;
    typename V::Mask positive;

    explicit IncidenceTerm(const V& tangent) {
        const V square = tangent * tangent;
        const V x = (square + square) / (square + 1.0f);
        positive = V(least_power) < x;
        fraction = log2_of_mantissa(split(select(positive, x, 1.0f), exponent));
    }

    V power(float n) const {
        const V whole = nearest(exponent * n);
        const V rest = fma(fraction, V(n), fms(exponent, V(n), whole));
        return select(positive, power_of_two(whole, rest), 0.0f);
    }
};

// Along one axis of the table: the position in measured cells, held to the box, and how many of them
// it lay beyond the box, signed.
template <class V>
inline V inside_box(const Table& table, int axis, const V& radians, V& beyond) {
    const V x = fma(radians, V(table.per_radian[axis]), V(table.offset[axis]));
    const V inside = least(greatest(x, 0.0f), table.box[axis]);
    beyond = x - inside;
    return inside;
}

// The weight of one axis: it fades to 0 over one measured cell outside the box.
template <class V>
inline V fade_beyond(const V& beyond) {
    return greatest(V(1.0f) - magnitude(beyond), 0.0f);
}

// Measured cells → nodes, of a baked table; and into how many nodes this cell is cut.
template <class V>
inline V cut(const Table& table, int axis, const V& x, V& pieces) {
    const V cell = least(greatest(floor_of(x), 0.0f), table.last_cell[axis]);
    pieces = lookup(table.pieces[axis], table.blocks[axis], cell);
    return fma(x - cell, pieces, lookup(table.start[axis], table.blocks[axis], cell));
}

// The node below, and the fraction above it.
template <class V>
inline V node(const Table& table, int axis, const V& x, V& fraction) {
    const V low = least(greatest(floor_of(x), 0.0f), table.nodes[axis] - 2);
    fraction = x - low;
    return low;
}

}  // namespace raden
