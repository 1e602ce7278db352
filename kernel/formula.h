// The model's formulas for one vector of pixels. The reference is runtime_table.py.
#pragma once
#include <cfloat>

#include "scene.h"

namespace raden {

constexpr float eps = FLT_EPSILON;
constexpr float tiny = 1.0842022e-19f;  // the root of the least normal float
constexpr float smallest = 1e-30f;      // keeps a quotient of numbers that underflow finite

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

// What an address takes of a table, each lane of its own one; named as in `Table`.
template <class V>
struct Layouts {
    V last[3], count[2], warp[2];
};

// Where one vector of pixels lies in the runtime table; only lanes above the horizon count. The
// table is one `Table` for all lanes, or `Layouts`.
template <class V>
struct Address {
    Vector3<V> d, normal;         // V − L, L × d
    V delta, opposite;            // |d|, |L + V|
    V y, z, lower, middle;        // N·d, N·(L × d), the lower cosine, the sum of both
    V across_scale, along_scale;  // the denominators of v and w
    typename V::Mask apart;
    V u, v, w;

    template <class Layout>
    Address(const Layout& table, const Vector3<V>& n, const Vector3<V>& l, const Vector3<V>& view,
            const V& n_l, const V& n_v, unsigned lanes) {
        d = {view.x - l.x, view.y - l.y, view.z - l.z};
        normal = cross(l, d);
        const V square = dot(d, d);
        apart = V(16 * eps * eps) < square;
        delta = root(square);
        lower = least(n_l, n_v);
        middle = n_l + n_v;
        // what d has along L + V is rounding: unit vectors are so to a few roundings
        const V radial = dot(d, Vector3<V>{l.x + view.x, l.y + view.y, l.z + view.z});
        y = fnma(V(0.25f) * middle, radial, dot(n, d));
        z = dot(n, normal);
        opposite = root(greatest(V(4.0f) - square, tiny));
        u = delta / (opposite + 2.0f);
        if ((bits(apart) & lanes) != lanes) {
            // L ∥ V: the plane of L and N
            const Vector3<V> m = cross(n, l);
            y = select(apart, y, root(dot(m, m)));
            z = select(apart, z, 0.0f);
            u = select(apart, u, 0.0f);
            delta = select(apart, delta, 1.0f);
        }
        across_scale = greatest(fma(V(table.warp[0]) * delta, lower, magnitude(y)), smallest);
        along_scale = greatest(fma(V(table.warp[1]) * delta, middle, magnitude(z)), smallest);
        v = y / across_scale;
        w = z / along_scale;
    }
};

// The nodes below an address, and the fractions above them.
template <class V>
struct Place {
    V low[3], fraction[3];

    template <class Layout>
    Place(const Layout& table, const Address<V>& at) {
        const V half[2] = {V(0.5f * table.last[1]), V(0.5f * table.last[2])};
        const V position[3] = {at.u * table.last[0], fma(at.v, half[0], half[0]),
                               fma(at.w, half[1], half[1])};
        for (int k = 0; k < 3; ++k) {
            low[k] = least(greatest(floor_of(position[k]), 0.0f), V(table.last[k] - 1.0f));
            fraction[k] = position[k] - low[k];
        }
    }

    template <class Layout>
    V first(const Layout& table) const {
        return fma(fma(low[0], V(table.count[0]), low[1]), V(table.count[1]), low[2]);
    }
};

}  // namespace raden
