// Tiles of a material whose reflection turns with the sample: a table for each azimuth, of which a
// pixel reads two for each light. The reference is materials/anisotropic.py.
#pragma once
#include "light.h"
#include "table.h"

namespace raden {

// The tables lie one after the other; all have the layout of `Scene::table`, which is the first.
struct Turned {
    Map tangent;
    const float* azimuths = nullptr;  // rising, 0 … period, in radians
    const float* inverse = nullptr;   // 1 over the angle from each to the next
    float even = 0.0f;                // it, where all are the same, else 0
    int count = 0;
    float period = 0.0f;
    float nodes = 0.0f;  // of one table
};

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
struct TurnedTile : Tile<V> {
    using Base = Tile<V>;
    using Base::groups;
    using Base::scene;

    const Turned& turned;
    alignas(64) float n[3][tile_pixels], v[3][tile_pixels];
    alignas(64) float read[3][tile_pixels], read_v[tile_pixels];  // the normal that the table is read by
    alignas(64) float along[3][tile_pixels], side[3][tile_pixels];  // the tangent, and N × it
    alignas(64) float part[tile_pixels], rgb[4 * tile_pixels];
    alignas(64) int first[2][tile_pixels];
    unsigned visible[groups], reached[groups];

    TurnedTile(const Scene& s, const Turned& t, long b, long y, long x) : Base(s, b, y, x), turned(t) {}

    // N, V and the tangent of the pixels that the viewer sees.
    void look() {
        const float *normals[3], *views[3], *others[3];
        const Map& camera = scene.camera;
        this->planes_of(scene.normal, 0, normals);
        this->planes_of(camera.data ? scene.position : scene.view, 1, views);
        for (int g = 0; g < groups; ++g) {
            const int i = g * V::lanes;
            for (int c = 0; c < 3; ++c) V(0.0f).store(this->sum[c] + i);
            const Vector3<V> normal = unit(this->load(normals, i));
            Vector3<V> view = this->load(views, i);
            if (camera.data) {
                const float* from = camera.data + this->image * camera.batch;
                view = {V(from[0]) - view.x, V(from[camera.channel]) - view.y,
                        V(from[2 * camera.channel]) - view.z};
            }
            view = unit(view);
            visible[g] = bits(V(0.0f) < dot(normal, view));
            if (i + V::lanes > this->count)
                visible[g] &= this->count > i ? (1u << (this->count - i)) - 1 : 0u;
            this->keep(n, i, normal);
            this->keep(v, i, view);
            if (!scene.layers.data) this->keep(read, i, normal);
        }
        if (scene.layers.data) {
            this->planes_of(scene.layers, 2, others);
            for (int i = 0; i < tile_pixels; i += V::lanes) this->keep(read, i, unit(this->load(others, i)));
        }
        this->planes_of(turned.tangent, 3, others);
        for (int g = 0; g < groups; ++g) turn(g, others);
    }

    void turn(int g, const float* const tangents[3]) {
        const int i = g * V::lanes;
        const float *normals[3] = {read[0], read[1], read[2]}, *views[3] = {v[0], v[1], v[2]};
        const Vector3<V> normal = this->load(normals, i), view = this->load(views, i);
        Vector3<V> t = unit(this->load(tangents, i));
        const V up = dot(normal, t);
        t = {fnma(up, normal.x, t.x), fnma(up, normal.y, t.y), fnma(up, normal.z, t.z)};
        const V cosine = dot(normal, view);
        visible[g] &= bits(both(V(0.0f) < cosine, V(least_across * least_across) < dot(t, t)));
        this->keep(along, i, t);
        this->keep(side, i, cross(normal, t));
        cosine.store(read_v + i);
    }

    // The sample's azimuth, 0 … period.
    V azimuth(int i, const Vector3<V>& normal, const Vector3<V>& view, const Vector3<V>& light,
              const V& cos_i, const V& cos_r) const {
        const float *tangents[3] = {along[0], along[1], along[2]}, *sides[3] = {side[0], side[1], side[2]};
        const Vector3<V> t = this->load(tangents, i), s = this->load(sides, i);
        const Vector3<V> p = cross(light, {view.x - light.x, view.y - light.y, view.z - light.z});
        const auto apart = V(16 * eps * eps) < dot(p, p);
        const auto behind = cos_r < cos_i * dot(light, view);
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

    void place(const Light& light, const float* const positions[3]) {
        const float *normals[3] = {n[0], n[1], n[2]}, *views[3] = {v[0], v[1], v[2]};
        const float* read_by[3] = {read[0], read[1], read[2]};
        for (int g = 0; g < groups; ++g) {
            reached[g] = 0;
            if (visible[g] == 0) continue;
            const int i = g * V::lanes;
            V strength = 1.0f;
            const Vector3<V> to = light.kind == directional
                                      ? Vector3<V>{light.at[0], light.at[1], light.at[2]}
                                      : towards(light, this->load(positions, i), strength);
            const Vector3<V> normal = this->load(read_by, i), view = this->load(views, i);
            strength = strength * dot(this->load(normals, i), to);
            const V cos_i = dot(normal, to), cos_r = V::load(read_v + i);
            const auto above = both(V(0.0f) < strength, both(V(0.0f) < cos_i, V(0.0f) < cos_r));
            const unsigned lanes = bits(above) & visible[g];
            if (lanes == 0) continue;
            reached[g] = lanes;
            const Place<V> at(scene.table, {scene.table, normal, to, view, cos_i, cos_r, lanes});
            V below, beyond, share;
            between(azimuth(i, normal, view, to, cos_i, cos_r), below, beyond, share);
            share.store(part + i);
            const V node = at.first(scene.table);
            (node + below).store_int(first[0] + i);
            (node + beyond).store_int(first[1] + i);
            weigh(i, at, select(above, strength, 0.0f));
            ask(i);
        }
    }

    void weigh(int i, const Place<V>& at, const V& gain) {
        Cells& cells = this->cells;
        const V high = gain * at.fraction[0], low = gain - high;
        const V right = at.fraction[1], left = V(1.0f) - right;
        (low * left).store(cells.weight[0] + i);
        (low * right).store(cells.weight[1] + i);
        (high * left).store(cells.weight[2] + i);
        (high * right).store(cells.weight[3] + i);
        (V(1.0f) - at.fraction[2]).store(cells.near + i);
        at.fraction[2].store(cells.far + i);
    }

    // Where most lanes are lit, reading all is cheaper than asking.
    void read_tables() {
        for (int g = 0; g < groups; ++g) {
            const int i = g * V::lanes;
            if (count_of(reached[g]) > V::lanes / 2)
                for (int k = i; k < i + V::lanes; ++k) read_one(k);
            else
                for (unsigned left = reached[g]; left != 0; left &= left - 1) read_one(i + lowest(left));
        }
    }

    void read_one(int k) {
        fetch_both(V(0.0f), this->cells, k, scene.table, first[0][k], first[1][k], part[k], rgb + 4 * k);
    }

    // The tables lie in far caches: ask for their lines before they are needed.
    void ask(int i) const {
        const Table& table = scene.table;
        for (int s = 0; s < 2; ++s)
            for (int k = i; k < i + V::lanes; ++k) {
                const float* p = table.values + 3L * first[s][k];
                ask_for(p);
                ask_for(p + table.row);
                ask_for(p + table.slab);
                ask_for(p + table.slab + table.row);
            }
    }

    void add(const Light& light) {
        const float* positions[3];
        if (light.kind != directional) this->planes_of(scene.position, 2, positions);
        place(light, positions);
        read_tables();
        for (int g = 0; g < groups; ++g) {
            if (reached[g] == 0) continue;
            const int i = g * V::lanes;
            V f[3];
            planes(rgb + 4 * i, f[0], f[1], f[2]);
            const auto kept = lanes_in(reached[g], f[0]);
            for (int c = 0; c < 3; ++c) {
                float* here = this->sum[c] + i;
                fma(select(kept, f[c], 0.0f), V(light.radiated[c]), V::load(here)).store(here);
            }
        }
    }

    // Σ f_r E cos θi, times the mask; what is not finite is 0.
    void shade() {
        if (this->count == 0) return this->clear();
        look();
        for (int k = 0; k < scene.light_count; ++k) add(scene.lights[k * scene.batch + this->image]);
        for (int g = 0; g < groups; ++g) {
            V out[3];
            for (int c = 0; c < 3; ++c) {
                const V sum = V::load(this->sum[c] + g * V::lanes);
                out[c] = select(magnitude(sum) <= FLT_MAX, sum, 0.0f);
                if (scene.mask.data) out[c] = out[c] * V::load(this->masked + g * V::lanes);
            }
            this->put(g, out);
        }
        this->spread();
    }
};

template <class V>
void shade_turned_tiles(const Scene& scene, const Turned& turned, long first_tile, long last_tile) {
    const long across = tiles_per_row(scene);
    for (long i = first_tile; i < last_tile; ++i) {
        const long line = i / across;
        TurnedTile<V> tile(scene, turned, line / scene.rows, line % scene.rows, i % across * tile_pixels);
        tile.select_pixels();
        tile.shade();
    }
    V::fence();
}

using ShadeTurnedTiles = void (*)(const Scene&, const Turned&, long first_tile, long last_tile);
void shade_turned_tiles_portable(const Scene&, const Turned&, long first_tile, long last_tile);
void shade_turned_tiles_avx2(const Scene&, const Turned&, long first_tile, long last_tile);
void shade_turned_tiles_avx512(const Scene&, const Turned&, long first_tile, long last_tile);

}  // namespace raden
