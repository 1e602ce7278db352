// The gradient of f_r: what a change of the image asks of the vectors and of the table.
//
// The address of runtime_table.py, by d = V − L, Y = N·d, Z = N·(L × d), δ = |d|, m = min(N·L, N·V),
// M = N·L + N·V, with P = |Y| + cδm and Q = |Z| + kδM:
//   du/dδ = 2/(|L + V| (2 + |L + V|))
//   dv = (cδm dY − cY (m dδ + δ dm))/P²,  dw = (kδM dZ − kZ (M dδ + δ dM))/Q²
// and dY = d·dN + N·dd, dZ = (L×d)·dN + (d×N)·dL + (N×L)·dd, dδ = d·dd/δ, dd = dV − dL.
// The reference is what torch's autograd makes of runtime_table.py.
#pragma once
#include <initializer_list>

#include "tile.h"

namespace raden {

// The same tiles as `reflect`, in one slice: a thread with sums of its own.
template <class V>
struct GradientTile : Tile<V> {
    using Tile<V>::groups;
    using Tile<V>::count;
    using Tile<V>::cells;
    using Tile<V>::scene;

    const Gradient& wanted;
    const Slice& slice;
    const float *normals[3], *lights[3], *views[3], *changes[3];

    GradientTile(const Scene& s, const Gradient& g, const Slice& mine, long b, long y, long x)
        : Tile<V>(s, b, y, x), wanted(g), slice(mine) {}

    // `beside`'s part of g taken off, over the length of `raw`: the gradient of the normalisation.
    static Vector3<V> before_normalising(const Vector3<V>& g, const Vector3<V>& of,
                                         const Vector3<V>& raw, const typename V::Mask& valid) {
        const V along = dot(g, of);
        const V square = dot(raw, raw);
        const auto usual = both(V(1e-30f) < square, square < 1e30f);
        if (bits(usual) == all_lanes(square)) {
            const V shrink = select(valid, V(1.0f) / root(square), 0.0f);
            return scaled({fnma(along, of.x, g.x), fnma(along, of.y, g.y), fnma(along, of.z, g.z)},
                          shrink, valid);
        }
        const V largest = greatest(greatest(magnitude(raw.x), magnitude(raw.y)), magnitude(raw.z));
        const V by = select(valid, greatest(largest, tiny), 1.0f);
        const Vector3<V> s{raw.x / by, raw.y / by, raw.z / by};
        const V shrink = select(valid, V(1.0f) / (greatest(root(dot(s, s)), tiny) * by), 0.0f);
        return scaled({fnma(along, of.x, g.x), fnma(along, of.y, g.y), fnma(along, of.z, g.z)}, shrink,
                      valid);
    }

    // v · by; 0 where that is not finite, and in other lanes.
    static Vector3<V> scaled(const Vector3<V>& v, const V& by, const typename V::Mask& lanes) {
        const auto finite = [&](const V& x) {
            const V y = x * by;
            return select(both(lanes, magnitude(y) <= FLT_MAX), y, 0.0f);
        };
        return {finite(v.x), finite(v.y), finite(v.z)};
    }

    void write(float* map, int g, const Vector3<V>& v) const {
        if (!map) return;
        const V parts[3] = {v.x, v.y, v.z};
        const int i = g * V::lanes;
        for (int c = 0; c < 3; ++c) {
            float* to = map + ((this->image * 3 + c) * scene.rows + this->row) * scene.columns +
                        this->first + i;
            if (i + V::lanes <= count) {
                Tile<V>::write(parts[c], to);
            } else if (i < count) {
                alignas(64) float lane[V::lanes];
                parts[c].store(lane);
                for (int k = 0; i + k < count; ++k) to[k] = lane[k];
            }
        }
    }

    void differentiate_group(int g) {
        const Table& table = scene.table;
        const int i = g * V::lanes;
        const Vector3<V> raw_n = Tile<V>::load(normals, i), raw_l = Tile<V>::load(lights, i),
                         raw_v = Tile<V>::load(views, i);
        const Vector3<V> n = unit(raw_n), l = unit(raw_l), v = unit(raw_v);
        const V cos_i = dot(n, l), cos_r = dot(n, v);
        const auto above = both(V(0.0f) < cos_i, V(0.0f) < cos_r);
        const unsigned lanes = bits(above);
        if (lanes == 0) {
            const V zero = 0.0f;
            for (float* map : {wanted.normal, wanted.light, wanted.view})
                write(map, g, {zero, zero, zero});
            return;
        }
        V change[3];
        for (int c = 0; c < 3; ++c) change[c] = select(above, V::load(changes[c] + i), 0.0f);
        const Address<V> at(table, n, l, v, cos_i, cos_r, lanes);
        const Place<V> place(table, at);
        Visit visit;
        for (int c = 0; c < 3; ++c) {
            change[c].store(visit.change[c]);
            place.fraction[c].store(visit.at[c]);
        }
        place.first(table).store_int(cells.first + i);
        if (slice.table)
            for (unsigned left = lanes; left != 0; left &= left - 1) {
                const int k = lowest(left);
                add_to_nodes(change[0], table, cells.first[i + k], visit, k, slice.table);
            }
        if (!wanted.normal && !wanted.light && !wanted.view) return;
        V by_address[3];
        differentiate_address(g, lanes, visit, change, by_address);
        Vector3<V> to_n, to_l, to_v;
        along_vectors(at, n, l, v, cos_i, cos_r, lanes, by_address, to_n, to_l, to_v);
        if (wanted.normal) write(wanted.normal, g, before_normalising(to_n, n, raw_n, above));
        if (wanted.light) write(wanted.light, g, before_normalising(to_l, l, raw_l, above));
        if (wanted.view) write(wanted.view, g, before_normalising(to_v, v, raw_v, above));
    }

    // The slopes of Σ g f along u, v and w.
    void differentiate_address(int g, unsigned lanes, const Visit& visit, const V change[3], V by_address[3]) {
        const Table& table = scene.table;
        const int i = g * V::lanes;
        alignas(64) float slopes[3][4 * V::lanes];
        for (int k = 0; k < V::lanes; ++k) {
            float* const here[3] = {slopes[0] + 4 * k, slopes[1] + 4 * k, slopes[2] + 4 * k};
            if (lanes >> k & 1)
                slopes_at(change[0], table, cells.first[i + k], visit, k, here);
            else
                for (float* p : here)
                    for (int c = 0; c < 4; ++c) p[c] = 0.0f;
        }
        const float per_node[3] = {table.last[0], 0.5f * table.last[1], 0.5f * table.last[2]};
        for (int k = 0; k < 3; ++k) {
            V of[3];
            planes(slopes[k], of[0], of[1], of[2]);
            by_address[k] = fma(change[2], of[2], fma(change[1], of[1], change[0] * of[0])) * per_node[k];
        }
    }

    static Vector3<V> sum(const V& a, const Vector3<V>& x, const V& b, const Vector3<V>& y) {
        return {fma(a, x.x, b * y.x), fma(a, x.y, b * y.y), fma(a, x.z, b * y.z)};
    }

    static Vector3<V> added(const Vector3<V>& x, const V& a, const Vector3<V>& y) {
        return {fma(a, y.x, x.x), fma(a, y.y, x.y), fma(a, y.z, x.z)};
    }

    void along_vectors(const Address<V>& at, const Vector3<V>& n, const Vector3<V>& l,
                       const Vector3<V>& v, const V& n_l, const V& n_v, unsigned lanes,
                       const V by_address[3], Vector3<V>& to_n, Vector3<V>& to_l,
                       Vector3<V>& to_v) const {
        const Table& table = scene.table;
        const V c = table.warp[0], k = table.warp[1];
        const V across = by_address[1] / (at.across_scale * at.across_scale);
        const V along = by_address[2] / (at.along_scale * at.along_scale);
        const V by_y = across * c * at.delta * at.lower, by_z = along * k * at.delta * at.middle;
        const V pull = V(0.0f) - across * c * at.y, lean = V(0.0f) - along * k * at.z;
        const V by_lower = pull * at.delta, by_middle = lean * at.delta;
        const V opposite = at.opposite * (at.opposite + 2.0f);
        const V by_delta_over_delta =
            fma(fma(pull, at.lower, lean * at.middle), opposite, by_address[0] * 2.0f) /
            (opposite * at.delta);
        const auto light_is_lower = n_l < n_v;
        const V by_n_l = by_middle + select(light_is_lower, by_lower, 0.0f);
        const V by_n_v = by_middle + select(light_is_lower, V(0.0f), by_lower);
        to_n = added(added(sum(by_y, at.d, by_z, at.normal), by_n_l, l), by_n_v, v);
        const bool all_apart = (bits(at.apart) & lanes) == lanes;
        if (all_apart && !wanted.light && !wanted.view) return;
        const Vector3<V> to_d = added(sum(by_y, n, by_z, cross(n, l)), by_delta_over_delta, at.d);
        to_l = added(added(sum(by_n_l, n, V(-1.0f), to_d), by_z, cross(at.d, n)), V(0.0f), n);
        to_v = added(to_d, by_n_v, n);
        if (all_apart) return;
        // L ∥ V: Y = sin θ and δ = 1; the two cosines are one
        const auto askew = V(0.0f) < at.y;
        const V turn = select(askew, by_y * n_l / select(askew, at.y, 1.0f), 0.0f);
        const V both_ways = by_lower + by_middle + by_middle - turn;
        const V none = 0.0f;
        to_n = {select(at.apart, to_n.x, both_ways * l.x), select(at.apart, to_n.y, both_ways * l.y),
                select(at.apart, to_n.z, both_ways * l.z)};
        to_l = {select(at.apart, to_l.x, both_ways * n.x), select(at.apart, to_l.y, both_ways * n.y),
                select(at.apart, to_l.z, both_ways * n.z)};
        to_v = {select(at.apart, to_v.x, none), select(at.apart, to_v.y, none),
                select(at.apart, to_v.z, none)};
    }

    void differentiate() {
        this->planes_of(scene.normal, 0, normals);
        this->planes_of(scene.light, 1, lights);
        this->planes_of(scene.view, 2, views);
        this->planes_of(wanted.image, 3, changes);
        for (int g = 0; g < groups; ++g) differentiate_group(g);
    }
};

template <class V>
void differentiate_tiles(const Scene& scene, const Gradient& wanted, const Slice& slice) {
    const long across = tiles_per_row(scene);
    for (long i = slice.first_tile; i < slice.last_tile; ++i) {
        const long line = i / across;
        GradientTile<V> tile(scene, wanted, slice, line / scene.rows, line % scene.rows,
                             i % across * tile_pixels);
        tile.select_pixels();
        tile.differentiate();
    }
    V::fence();
}

}  // namespace raden
