// Tiles of a material whose reflection turns with the sample: a table for each azimuth, of which a
// pixel reads two for each light. The reference is materials/anisotropic.py.
#pragma once
#include "shade.h"

namespace raden {

constexpr float pi = 3.14159265f;
constexpr float least_across = 1e-5f;  // sine of tangent and normal below which the angle is rounding

// The angle of (c, s) against (1, 0), to 2e-7; 0 of (0, 0).
template <class V>
inline V angle_of(const V& s, const V& c) {
    const V sine = magnitude(s), cosine = magnitude(c);
    const V ratio = least(sine, cosine) / greatest(greatest(sine, cosine), smallest);
    // atan(r)/r of 0…1 in powers of r², through Chebyshev's nodes; in pairs, which do not wait for
    // each other
    const V x = ratio * ratio, x2 = x * x;
    const V low = fma(fma(x, -0.14016585f, 0.19969235f), x2, fma(x, -0.33331960f, 0.99999988f));
    const V high = fma(fma(x, -0.00466877f, 0.02416619f), x2, fma(x, -0.05936710f, 0.09906097f));
    const V sum = fma(high, x2 * x2, low);
    V angle = sum * ratio;
    angle = select(cosine < sine, V(pi / 2) - angle, angle);
    angle = select(c < V(0.0f), V(pi) - angle, angle);
    return select(s < V(0.0f), V(0.0f) - angle, angle);
}

// `fetch` of two tables at one place, `share` of the way from the first to the second.
template <class V>
inline void fetch_both(const V& any, Cells& cells, int i, const Table& table, int low, int high,
                       float share, float* rgb) {
#ifdef __AVX2__
    const float *p = table.values + 3L * low, *q = table.values + 3L * high;
    const __m256 part = _mm256_set1_ps(share);
    const auto mixed = [part](__m256 a, __m256 b) { return _mm256_fmadd_ps(part, _mm256_sub_ps(b, a), a); };
    const auto node = [&](long at) { return mixed(_mm256_loadu_ps(p + at), _mm256_loadu_ps(q + at)); };
    // the last load is masked: it would reach two floats beyond the end of the tables
    const __m256i six = _mm256_setr_epi32(-1, -1, -1, -1, -1, -1, 0, 0);
    const long far_end = table.slab + table.row;
    const __m256 last = mixed(_mm256_maskload_ps(p + far_end, six), _mm256_maskload_ps(q + far_end, six));
    __m256 sum = _mm256_mul_ps(_mm256_broadcast_ss(&cells.weight[3][i]), last);
    sum = _mm256_fmadd_ps(_mm256_broadcast_ss(&cells.weight[2][i]), node(table.slab), sum);
    __m256 more = _mm256_mul_ps(_mm256_broadcast_ss(&cells.weight[0][i]), node(0));
    more = _mm256_fmadd_ps(_mm256_broadcast_ss(&cells.weight[1][i]), node(table.row), more);
    sum = _mm256_add_ps(sum, more);
    const __m128 far = _mm256_castps256_ps128(
        _mm256_permutevar8x32_ps(sum, _mm256_setr_epi32(3, 4, 5, 6, 7, 7, 7, 7)));
    const __m128 near = _mm_mul_ps(_mm_broadcast_ss(&cells.near[i]), _mm256_castps256_ps128(sum));
    _mm_store_ps(rgb, _mm_fmadd_ps(_mm_broadcast_ss(&cells.far[i]), far, near));
#else
    float upper[4];
    cells.first[i] = high;
    fetch(any, cells, i, table, upper);
    cells.first[i] = low;
    fetch(any, cells, i, table, rgb);
    for (int c = 0; c < 3; ++c) rgb[c] += share * (upper[c] - rgb[c]);
#endif
}

template <class V>
struct TurnedTile : ShadedTile<V> {
    using Base = ShadedTile<V>;
    using Base::groups;
    using Base::layer;
    using Base::n;
    using Base::reader;
    using Base::scene;
    using Base::seen;
    using Base::v;

    const Turned& turned;
    alignas(64) float along[3][tile_pixels], side[3][tile_pixels];  // the tangent, and N × it
    alignas(64) float part[tile_pixels];
    alignas(64) int first[2][tile_pixels];

    TurnedTile(const Scene& s, long b, long y, long x) : Base(s, b, y, x), turned(s.turned) {}

    // The tangent of the pixels that the viewer sees, about the normal that the table is read by.
    void turn() {
        const float* tangents[3];
        this->planes_of(turned.tangent, 3, tangents);
        const auto& by = scene.layers.data ? layer : n;
        const float* normals[3] = {by[0], by[1], by[2]};
        for (int g = 0; g < groups; ++g) {
            const int i = g * V::lanes;
            const Vector3<V> normal = this->load(normals, i);
            Vector3<V> t = unit(this->load(tangents, i));
            const V up = dot(normal, t);
            t = {fnma(up, normal.x, t.x), fnma(up, normal.y, t.y), fnma(up, normal.z, t.z)};
            seen[g] &= bits(V(least_across * least_across) < dot(t, t));
            this->keep(along, i, t);
            this->keep(side, i, cross(normal, t));
        }
    }

    // The sample's azimuth, 0 … period. It and `place` are inlined by order: a fifth of the frame.
    RADEN_INLINE V azimuth(int i, const Geometry<V>& at) const {
        const Vector3<V>&light = at.light, &view = at.view;
        const float *tangents[3] = {along[0], along[1], along[2]}, *sides[3] = {side[0], side[1], side[2]};
        const Vector3<V> t = this->load(tangents, i), s = this->load(sides, i);
        const Vector3<V> p = cross(light, {view.x - light.x, view.y - light.y, view.z - light.z});
        const auto apart = V(16 * eps * eps) < dot(p, p);
        const auto behind = at.cos_r < at.cos_i * dot(light, view);
        V sine = dot(t, p), cosine = dot(s, p);
        sine = select(behind, V(0.0f) - sine, sine), cosine = select(behind, V(0.0f) - cosine, cosine);
        sine = select(apart, sine, dot(light, s)), cosine = select(apart, cosine, V(0.0f) - dot(light, t));
        const V angle = angle_of(sine, cosine);
        return angle - floor_of(angle * (1.0f / turned.period)) * turned.period;
    }

    // The first nodes of the tables below and above an azimuth, and how far it is to the upper one.
    void between(const V& angle, V& low, V& high, V& share) const {
        const float last = static_cast<float>(turned.count - 1);
        if (turned.even > 0.0f) {
            const V place = (angle - turned.azimuths[0]) * turned.even, below = floor_of(place);
            share = least(greatest(place - below, 0.0f), 1.0f);
            const auto around = below < V(0.0f);
            low = select(around, last, least(below, last)) * turned.nodes;
            high = select(both(V(0.0f) <= below, below < V(last)), low + turned.nodes, 0.0f);
            return;
        }
        V start = turned.azimuths[turned.count - 1] - turned.period;
        V inverse = turned.inverse[turned.count - 1], place = last;
        for (int k = 0; k < turned.count; ++k) {
            const auto above = V(turned.azimuths[k]) <= angle;
            start = select(above, turned.azimuths[k], start);
            inverse = select(above, turned.inverse[k], inverse);
            place = select(above, static_cast<float>(k), place);
        }
        low = place * turned.nodes;
        high = select(place < V(last), low + turned.nodes, 0.0f);
        share = least(greatest((angle - start) * inverse, 0.0f), 1.0f);
    }

    // The tables lie in far caches: their lines are asked for before they are needed.
    RADEN_INLINE void place(int g, unsigned lanes, const Geometry<V>& at, const V& strength) {
        const int i = g * V::lanes;
        const V node = reader.place_by(scene.table, g, lanes, at, strength);
        reader.lit[g] = lanes;
        V below, beyond, share;
        between(azimuth(i, at), below, beyond, share);
        share.store(part + i);
        (node + below).store_int(first[0] + i);
        (node + beyond).store_int(first[1] + i);
        for (const auto& each : first)
            for (int k = i; k < i + V::lanes; ++k) reader.ask_around(scene.table, each[k]);
    }

    void add_turned(const Light& light) {
        this->place_light(light, [&](int g, unsigned lanes, const Geometry<V>& at, const V& strength) {
            place(g, lanes, at, strength);
        });
        const V any = 0.0f;
        for (int g = 0; g < groups; ++g)
            reader.each_lane(g, reader.lit[g], [&](int k) {
                fetch_both(any, this->cells, k, scene.table, first[0][k], first[1][k], part[k],
                           reader.rgb + 4 * k);
            });
        this->add_read(light);
    }

    void shade() {
        if (this->count == 0) return this->clear();
        this->see();
        turn();
        for (int k = 0; k < scene.light_count; ++k)
            add_turned(scene.lights[k * scene.batch + this->image]);
        this->put_sum();
    }
};

}  // namespace raden
