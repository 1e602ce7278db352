// The gradient of f_r: what a change of the image asks of the vectors, the table and the diffuse part.
//
// With p = L×V/s and the axes l⊥ = p×L (towards V) and v⊥ = p×V (away from L), before the flip:
//   da = dN·e/h − dL·l⊥ − (dL·p) tan t cos r/s + (dV·p) tan t cos a/s,  e = cos a l⊥ − sin a L
//   dr = dV·v⊥ − dN·e/h + (dL·p) tan t cos r/s − (dV·p) tan t cos a/s
//   dt = dN·p/h − (dL·p) sin r/s − (dV·p) sin a/s,  h = cos t
// The reference is what torch's autograd makes of geometry.py, diffuse.py and reflectance_table.py.
#pragma once
#include <initializer_list>

#include "tile.h"

namespace raden {

// Where the angles of one vector of pixels lie in the table, and how fast they move there.
template <class V>
struct Placement {
    V low[3], fraction[3];  // in nodes
    V per_angle[3];         // nodes per radian along the axis; 0 where the box's edge holds it
    V fade[3], beyond[3];   // the axis' part of the weight; measured cells outside the box, signed

    Placement(const Table& table, const V angle[3]) {
        V at[3];
        for (int k = 0; k < 3; ++k) {
            at[k] = inside_box(table, k, angle[k], beyond[k]);
            fade[k] = fade_beyond(beyond[k]);
            per_angle[k] = select(magnitude(beyond[k]) <= 0.0f, table.per_radian[k], 0.0f);
        }
        if (table.start[0]) {
            at[1] = at[1] - at[0] + table.box[0];
            for (int k = 0; k < 3; ++k) at[k] = cut(table, k, at[k], pieces[k]);
        }
        for (int k = 0; k < 3; ++k) low[k] = node(table, k, at[k], fraction[k]);
    }

    V weight() const { return fade[0] * fade[1] * fade[2]; }

    // Slopes along the table's axes → slopes along the angles.
    void along_angles(const Table& table, const V by_node[3], V by_angle[3]) const {
        if (!table.start[0]) {
            for (int k = 0; k < 3; ++k) by_angle[k] = by_node[k] * per_angle[k];
            return;
        }
        const V across = by_node[1] * pieces[1];  // along r − a
        by_angle[0] = (by_node[0] * pieces[0] - across) * per_angle[0];
        by_angle[1] = across * per_angle[1];
        by_angle[2] = by_node[2] * pieces[2] * per_angle[2];
    }

private:
    V pieces[3];
};

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
    float body[6] = {0, 0, 0, 0, 0, 0};  // of this tile: scale, exponent

    GradientTile(const Scene& s, const Gradient& g, const Slice& mine, long b, long y, long x)
        : Tile<V>(s, b, y, x), wanted(g), slice(mine) {}

    static void keep_sum(const V& v, float& sum) {
        alignas(64) float lane[V::lanes];
        v.store(lane);
        for (float x : lane) sum += x;
    }

    // `beside`'s part of g taken off, over the length of `raw`: the gradient of the normalisation.
    static Vector3<V> before_normalising(const Vector3<V>& g, const Vector3<V>& of,
                                         const Vector3<V>& raw, const typename V::Mask& valid) {
        const V along = dot(g, of);
        const V largest = greatest(greatest(magnitude(raw.x), magnitude(raw.y)), magnitude(raw.z));
        const V by = select(valid, greatest(largest, tiny), 1.0f);
        const Vector3<V> s{raw.x / by, raw.y / by, raw.z / by};
        const V shrink = select(valid, V(1.0f) / (greatest(root(dot(s, s)), tiny) * by), 0.0f);
        const auto finite = [&](const V& x) {
            const V y = x * shrink;
            return select(both(valid, magnitude(y) <= FLT_MAX), y, 0.0f);
        };
        return {finite(fnma(along, of.x, g.x)), finite(fnma(along, of.y, g.y)),
                finite(fnma(along, of.z, g.z))};
    }

    void write(float* map, int g, const Vector3<V>& v) const {
        if (!map) return;
        const V parts[3] = {v.x, v.y, v.z};
        const int i = g * V::lanes;
        for (int c = 0; c < 3; ++c) {
            float* to = map + ((this->image * 3 + c) * scene.rows + this->row) * scene.columns +
                        this->first + i;
            if (i + V::lanes <= count) {
                parts[c].store(to);
            } else if (i < count) {
                alignas(64) float lane[V::lanes];
                parts[c].store(lane);
                for (int k = 0; i + k < count; ++k) to[k] = lane[k];
            }
        }
    }

    // The eight nodes around one pixel: g·table and its slopes along the axes; and back into the
    // table what the pixel's change `into` gives to each of them.
    void visit(int k, const float g[3], const float into[3], const float at[3], float out[4]) const {
        const Table& table = scene.model.table;
        const long corners[4] = {0, table.row, table.slab, table.slab + table.row};
        const long first = 3L * cells.first[k];
        const float x = at[0], y = at[1], z = at[2];
        const float across[4] = {(1 - x) * (1 - y), (1 - x) * y, x * (1 - y), x * y};
        float near[4], far[4];
        for (int j = 0; j < 4; ++j) {
            const float* p = table.values + first + corners[j];
            near[j] = g[0] * p[0] + g[1] * p[1] + g[2] * p[2];
            far[j] = g[0] * p[3] + g[1] * p[4] + g[2] * p[5];
        }
        float line[4];
        for (int j = 0; j < 4; ++j) line[j] = near[j] + z * (far[j] - near[j]);
        const float low = line[0] + y * (line[1] - line[0]), high = line[2] + y * (line[3] - line[2]);
        out[0] = low + x * (high - low);
        out[1] = high - low;
        out[2] = (1 - x) * (line[1] - line[0]) + x * (line[3] - line[2]);
        out[3] = 0;
        for (int j = 0; j < 4; ++j) out[3] += across[j] * (far[j] - near[j]);
        if (!slice.table) return;
        const float six[6] = {(1 - z) * into[0], (1 - z) * into[1], (1 - z) * into[2],
                              z * into[0],       z * into[1],       z * into[2]};
        for (int j = 0; j < 4; ++j) {
            float* q = slice.table + first + corners[j];
            for (int c = 0; c < 6; ++c) q[c] += across[j] * six[c];
        }
    }

    void differentiate_group(int g) {
        const Model& m = scene.model;
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

        const HalfAngles<V> half = half_angles(n, l, v, cos_i, cos_r, lanes);
        V angle[3] = {arctan(half.a), arctan(half.r), arctan(half.t)};
        for (V& x : angle) x = select(above, x + x, 0.0f);

        V by_angle[3] = {0.0f, 0.0f, 0.0f}, total = 0.0f, weight = 0.0f;
        if (m.table.values) {
            const Placement<V> place(m.table, angle);
            weight = place.weight() * m.specular_gain;
            read_table(g, lanes, place, change, weight, total, by_angle);
            fade_out(place, change, total, by_angle, half, cos_r);
        }
        V along_view = 0.0f;  // what the diffuse part gives to a change of N·V
        if (m.has_diffuse) {
            const V share = select(above, V(m.diffuse_gain) - weight, 0.0f);
            along_view = differentiate_body(half, cos_r, share, change, by_angle[0]);
        }
        vectors(g, raw_n, raw_l, raw_v, n, l, v, cos_i, cos_r, above, lanes, by_angle, along_view);
    }

    // Σ g T of the pixels and its slopes along the angles, both for a table that counts fully.
    void read_table(int g, unsigned lanes, const Placement<V>& place, const V change[3],
                    const V& weight, V& total, V by_angle[3]) {
        const Table& table = scene.model.table;
        const int i = g * V::lanes;
        fma(fma(place.low[0], V(table.nodes[1]), place.low[1]), V(table.nodes[2]), place.low[2])
            .store_int(cells.first + i);
        alignas(64) float g_of[3][V::lanes], into[3][V::lanes], at[3][V::lanes], out[4][V::lanes];
        for (int c = 0; c < 3; ++c) {
            change[c].store(g_of[c]);
            (change[c] * weight).store(into[c]);
            place.fraction[c].store(at[c]);
        }
        for (int k = 0; k < V::lanes; ++k) {
            float found[4] = {0, 0, 0, 0};
            if (lanes >> k & 1) {
                const float gk[3] = {g_of[0][k], g_of[1][k], g_of[2][k]};
                const float to[3] = {into[0][k], into[1][k], into[2][k]};
                const float where[3] = {at[0][k], at[1][k], at[2][k]};
                visit(i + k, gk, to, where, found);
            }
            for (int c = 0; c < 4; ++c) out[c][k] = found[c];
        }
        total = V::load(out[0]);
        const V by_node[3] = {V::load(out[1]) * weight, V::load(out[2]) * weight,
                              V::load(out[3]) * weight};
        place.along_angles(table, by_node, by_angle);
    }

    // Outside the box the weight falls along the axis that is left: there f goes from T to D.
    void fade_out(const Placement<V>& place, const V change[3], const V& total, V by_angle[3],
                  const HalfAngles<V>& half, const V& cos_r) const {
        const Model& m = scene.model;
        typename V::Mask falling[3];
        unsigned any = 0;
        for (int k = 0; k < 3; ++k) {
            falling[k] = both(V(0.0f) < magnitude(place.beyond[k]), V(0.0f) < place.fade[k]);
            any |= bits(falling[k]);
        }
        if (any == 0) return;
        V rest = total;
        if (m.has_diffuse) {
            const IncidenceTerm<V> incidence(half.a);
            for (int c = 0; c < 3; ++c)
                rest = rest - change[c] * incidence.power(m.exponent[c]) * (cos_r * m.scale[c]);
        }
        rest = rest * m.specular_gain;
        for (int k = 0; k < 3; ++k) {
            const V others = place.fade[(k + 1) % 3] * place.fade[(k + 2) % 3];
            const V slope = negated_where(V(0.0f) < place.beyond[k], V(m.table.per_radian[k]));
            by_angle[k] = by_angle[k] + select(falling[k], rest * others * slope, 0.0f);
        }
    }

    // Eqs (3)–(6) as S (N·V) x^n with x = 1 − cos a; returns what a change of N·V is worth.
    V differentiate_body(const HalfAngles<V>& half, const V& cos_r, const V& share,
                         const V change[3], V& by_incidence) {
        const Model& m = scene.model;
        const IncidenceTerm<V> incidence(half.a);
        const V log = (incidence.exponent + incidence.fraction) * 0.69314718f;
        const V slope = select(incidence.positive, V(1.0f) / greatest(half.a, tiny), 0.0f);
        V along_view = 0.0f;
        for (int c = 0; c < 3; ++c) {
            const V power = incidence.power(m.exponent[c]), g = change[c] * share;
            const V worth = g * power * m.scale[c], value = worth * cos_r;
            keep_sum(g * power * cos_r, body[c]);
            keep_sum(select(incidence.positive, value * log, 0.0f), body[3 + c]);
            along_view = along_view + worth;
            by_incidence = fma(value * m.exponent[c], slope, by_incidence);
        }
        return along_view;
    }

    void vectors(int g, const Vector3<V>& raw_n, const Vector3<V>& raw_l, const Vector3<V>& raw_v,
                 const Vector3<V>& n, const Vector3<V>& l, const Vector3<V>& v, const V& n_l,
                 const V& n_v, const typename V::Mask& above, unsigned lanes, const V by_angle[3],
                 const V& along_view) {
        if (!wanted.normal && !wanted.light && !wanted.view) return;
        const auto opposed = dot(l, v) < 0.0f;
        const Vector3<V> d{v.x - negated_where(opposed, l.x), v.y - negated_where(opposed, l.y),
                           v.z - negated_where(opposed, l.z)};
        const Vector3<V> p_s = cross(l, d);
        const V s = root(dot(p_s, p_s));
        const auto apart = V(4 * eps) < s;
        const V over_s = V(1.0f) / select(apart, s, 1.0f);
        const V d_l = dot(d, l), d_v = dot(d, v), n_d = dot(n, d);
        const auto axis = [&](const V& x, const V& along, const V& unit) {
            return fnma(along, unit, x) * over_s;
        };
        const Vector3<V> p{p_s.x * over_s, p_s.y * over_s, p_s.z * over_s};
        const Vector3<V> l_t{axis(d.x, d_l, l.x), axis(d.y, d_l, l.y), axis(d.z, d_l, l.z)};
        const Vector3<V> v_t{negated_where(opposed, axis(d.x, d_v, v.x)),
                             negated_where(opposed, axis(d.y, d_v, v.y)),
                             negated_where(opposed, axis(d.z, d_v, v.z))};
        const V n_lt = fnma(d_l, n_l, n_d) * over_s;
        const V n_vt = negated_where(opposed, fnma(d_v, n_v, n_d) * over_s);
        const V h = greatest(root(fma(n_lt, n_lt, n_l * n_l)), eps), over_h = V(1.0f) / h;
        const V sin_a = n_lt * over_h, cos_a = n_l * over_h;
        const V sin_r = V(0.0f) - n_vt * over_h, cos_r = n_v * over_h;
        const V tan_t = dot(n, p) * over_h;

        const auto flip = n_lt < 0.0f;
        const V by_a = negated_where(flip, by_angle[0]), by_r = negated_where(flip, by_angle[1]),
                by_t = negated_where(flip, by_angle[2]);
        const V turned = (by_a - by_r) * over_h, leant = by_t * over_h;
        const V twist = (by_a - by_r) * tan_t;
        const V l_p = (V(0.0f) - fma(twist, cos_r, by_t * sin_r)) * over_s;
        const V v_p = fms(twist, cos_a, by_t * sin_a) * over_s;
        const auto of_normal = [&](const V& lt, const V& l_, const V& p_, const V& v_) {
            return fma(turned, fms(cos_a, lt, sin_a * l_), fma(leant, p_, along_view * v_));
        };
        const auto of_light = [&](const V& lt, const V& p_) { return fms(l_p, p_, by_a * lt); };
        const auto of_view = [&](const V& vt, const V& p_, const V& n_) {
            return fma(v_p, p_, fma(by_r, vt, along_view * n_));
        };
        Vector3<V> to_n{of_normal(l_t.x, l.x, p.x, v.x), of_normal(l_t.y, l.y, p.y, v.y),
                        of_normal(l_t.z, l.z, p.z, v.z)};
        Vector3<V> to_l{of_light(l_t.x, p.x), of_light(l_t.y, p.y), of_light(l_t.z, p.z)};
        Vector3<V> to_v{of_view(v_t.x, p.x, n.x), of_view(v_t.y, p.y, n.y), of_view(v_t.z, p.z, n.z)};
        if ((bits(apart) & lanes) != lanes) {
            // L ∥ V: a = −r = θ, the angle between N and L
            const Vector3<V> m = cross(n, l);
            const V square = dot(m, m);
            const auto askew = V(0.0f) < square;
            const V by_theta = by_angle[0] - by_angle[1];
            const V turn = select(askew, by_theta / root(select(askew, square, 1.0f)), 0.0f);
            const V both_ways = along_view - turn;  // N·V is N·L here
            to_n = {select(apart, to_n.x, both_ways * l.x), select(apart, to_n.y, both_ways * l.y),
                    select(apart, to_n.z, both_ways * l.z)};
            to_l = {select(apart, to_l.x, both_ways * n.x), select(apart, to_l.y, both_ways * n.y),
                    select(apart, to_l.z, both_ways * n.z)};
            to_v = {select(apart, to_v.x, 0.0f), select(apart, to_v.y, 0.0f),
                    select(apart, to_v.z, 0.0f)};
        }
        write(wanted.normal, g, before_normalising(to_n, n, raw_n, above));
        write(wanted.light, g, before_normalising(to_l, l, raw_l, above));
        write(wanted.view, g, before_normalising(to_v, v, raw_v, above));
    }

    void differentiate() {
        this->planes_of(scene.normal, 0, normals);
        this->planes_of(scene.light, 1, lights);
        this->planes_of(scene.view, 2, views);
        this->planes_of(wanted.image, 3, changes);
        for (int g = 0; g < groups; ++g) differentiate_group(g);
        for (int c = 0; c < 6; ++c) slice.body[c] += body[c];
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
}

}  // namespace raden
