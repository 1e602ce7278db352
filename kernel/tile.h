// Tiles of 64 pixels: first where each pixel lies in the table, then the table, then the sum.
#pragma once
#include <cmath>
#include <cstdint>

#include "formula.h"

namespace raden {

#if defined(__GNUC__)
static inline int count_of(unsigned bits) { return __builtin_popcount(bits); }
static inline int lowest(unsigned bits) { return __builtin_ctz(bits); }
static inline void ask_for(const float* p) { __builtin_prefetch(p); }
#else
static inline int count_of(unsigned bits) {
    int n = 0;
    for (; bits != 0; bits &= bits - 1) ++n;
    return n;
}

static inline int lowest(unsigned bits) { return count_of((bits & (0u - bits)) - 1); }
static inline void ask_for(const float*) {}
#endif

// The pixels of one tile that are worth a look; all of its buffers together stay in the L1 cache.
template <class V>
struct Tile {
    static constexpr int groups = tile_pixels / V::lanes;

    const Scene& scene;
    const long image, row, first;
    const int width;           // pixels of the tile
    int count = 0;             // of these, the ones that are not masked out
    bool whole = false;        // all 64
    int at[tile_pixels];       // which ones
    unsigned lit[groups];      // lanes that read the table
    Cells cells;
    alignas(64) float rgb[4 * tile_pixels];
    alignas(64) float sum[3][tile_pixels], masked[tile_pixels];
    alignas(64) float n[3][tile_pixels], v[3][tile_pixels], n_v[tile_pixels];
    alignas(64) float layer[3][tile_pixels];  // the layers' normals, where they lean; n_v is theirs
    unsigned seen[groups];
    alignas(64) float copies[4][3][tile_pixels];
    float low[3], high[3];  // of the positions
    float lost = 0.0f;      // of what may be left out, in lights

    Tile(const Scene& s, long b, long y, long x)
        : scene(s), image(b), row(y), first(x),
          width(static_cast<int>(s.columns - x < tile_pixels ? s.columns - x : tile_pixels)) {}

    void select_pixels() {
        const Map& m = scene.mask;
        if (!m.data) {
            count = width;
            for (int i = 0; i < width; ++i) at[i] = i;
            whole = count == tile_pixels;
            return;
        }
        const float* p = m.data + image * m.batch + row * m.row + first * m.column;
        if (m.column == 1 && width == tile_pixels)
            select_from(p);
        else
            for (int i = 0; i < width; ++i) keep_one(i, p[i * m.column]);
        whole = count == tile_pixels;
        for (int i = count; i < tile_pixels && count > 0; ++i) masked[i] = 0.0f;
    }

    // A mask leaves a tile alone, as a rule, or takes all of it.
    void select_from(const float* mask) {
        unsigned left[groups], none = 0, all = ~0u;
        for (int g = 0; g < groups; ++g) {
            left[g] = bits(V(0.0f) < V::load(mask + g * V::lanes));
            none |= left[g], all &= left[g];
        }
        if (none == 0) return;
        if (all == (1u << V::lanes) - 1) {
            count = tile_pixels;
            for (int i = 0; i < tile_pixels; ++i) at[i] = i;  // a map may lie in other strides
            for (int i = 0; i < width; i += V::lanes)
                least(V::load(mask + i), 1.0f).store(masked + i);
            return;
        }
        for (int g = 0; g < groups; ++g)
            for (; left[g] != 0; left[g] &= left[g] - 1) {
                const int i = g * V::lanes + lowest(left[g]);
                keep_one(i, mask[i]);
            }
    }

    void keep_one(int i, float value) {
        at[count] = i;
        masked[count] = value < 1.0f ? value : 1.0f;
        count += value > 0.0f;  // not NaN either
    }

    // Three planes of a map for the pixels selected: the map itself where it lies in a row.
    void planes_of(const Map& m, int buffer, const float* out[3]) {
        const float* p = m.data + image * m.batch + row * m.row + first * m.column;
        for (int c = 0; c < 3; ++c, p += m.channel) {
            out[c] = p;
            if (whole && m.column == 1) continue;
            float* copy = copies[buffer][c];
            for (int i = 0; i < count; ++i) copy[i] = p[at[i] * m.column];
            for (int i = count; i < tile_pixels; ++i) copy[i] = 0.0f;
            out[c] = copy;
        }
    }

    static Vector3<V> load(const float* const planes[3], int i) {
        return {V::load(planes[0] + i), V::load(planes[1] + i), V::load(planes[2] + i)};
    }

    // One light on one vector of pixels, `strength` times f_r. Fills cells and lit.
    void place_group(int g, unsigned lanes, const Vector3<V>& normal, const Vector3<V>& view,
                     const V& cos_r, const Vector3<V>& light, const V& cos_i, const V& strength,
                     typename V::Mask above) {
        const Table& table = scene.table;
        const int i = g * V::lanes;
        const Place<V> place(table, {table, normal, light, view, cos_i, cos_r, lanes});
        place.first(table).store_int(cells.first + i);
        const V gain = select(above, strength, 0.0f), high = gain * place.fraction[0];
        const V low = gain - high, right = place.fraction[1], left = V(1.0f) - right;
        (low * left).store(cells.weight[0] + i);
        (low * right).store(cells.weight[1] + i);
        (high * left).store(cells.weight[2] + i);
        (high * right).store(cells.weight[3] + i);
        (V(1.0f) - place.fraction[2]).store(cells.near + i);
        place.fraction[2].store(cells.far + i);
        lit[g] = lanes;
        if (table.large) prefetch(g);
    }

    // A large table lies in far caches: ask for its lines before they are needed.
    void prefetch(int g) {
        const Table& table = scene.table;
        for (int i = g * V::lanes; i < (g + 1) * V::lanes; ++i) {
            const float* p = table.values + 3L * cells.first[i];
            ask_for(p);
            ask_for(p + table.row);
            ask_for(p + table.slab);
            ask_for(p + table.slab + table.row);
        }
    }

    // The table at every pixel that reads it. Where most lanes do, reading all is cheaper than asking.
    void read_table() {
        const Table table = scene.table;
        const V any = 0.0f;
        for (int g = 0; g < groups; ++g) {
            const int i = g * V::lanes;
            if (count_of(lit[g]) > V::lanes / 2)
                for (int k = i; k < i + V::lanes; ++k) fetch(any, cells, k, table, rgb + 4 * k);
            else
                for (unsigned left = lit[g]; left != 0; left &= left - 1) {
                    const int k = i + lowest(left);
                    fetch(any, cells, k, table, rgb + 4 * k);
                }
        }
    }

    // The three channels of one vector of pixels.
    void collect(int g, V out[3]) {
        planes(rgb + 4 * g * V::lanes, out[0], out[1], out[2]);
        if (lit[g] != all_lanes(out[0])) {
            const auto kept = lanes_in(lit[g], out[0]);
            for (int c = 0; c < 3; ++c) out[c] = select(kept, out[c], 0.0f);
        }
    }

    float* pixel(int channel) const {
        return scene.image + ((image * 3 + channel) * scene.rows + row) * scene.columns + first;
    }

    void put(int g, const V out[3]) {
        for (int c = 0; c < 3; ++c) {
            if (whole)
                write(out[c], pixel(c) + g * V::lanes);
            else
                out[c].store(sum[c] + g * V::lanes);
        }
    }

    void write(const V& v, float* to) const {
        if (scene.stream && reinterpret_cast<std::uintptr_t>(to) % (4 * V::lanes) == 0)
            v.stream(to);
        else
            v.store(to);
    }

    void clear() const {
        for (int c = 0; c < 3; ++c) {
            float* to = pixel(c);
            int i = 0;
            for (; i + V::lanes <= width; i += V::lanes) write(V(0.0f), to + i);
            for (; i < width; ++i) to[i] = 0.0f;
        }
    }

    // A tile that is not whole was put into `sum`.
    void spread() {
        if (whole) return;
        for (int c = 0; c < 3; ++c) {
            float* to = pixel(c);
            if (count < width)
                for (int i = 0; i < width; ++i) to[i] = 0.0f;
            for (int i = 0; i < count; ++i) to[at[i]] = sum[c][i];
        }
    }

    // f_r of N, L and V, all three as maps.
    void reflect() {
        const float *normals[3], *lights[3], *views[3];
        planes_of(scene.normal, 0, normals);
        planes_of(scene.light, 1, lights);
        planes_of(scene.view, 2, views);
        for (int g = 0; g < groups; ++g) {
            lit[g] = 0;
            const int i = g * V::lanes;
            const Vector3<V> normal = unit(load(normals, i)), light = unit(load(lights, i));
            const V cos_i = dot(normal, light);
            const auto lit_lanes = V(0.0f) < cos_i;
            if (bits(lit_lanes) == 0) continue;
            const Vector3<V> view = unit(load(views, i));
            const V cos_r = dot(normal, view);
            const auto above = both(lit_lanes, V(0.0f) < cos_r);
            const unsigned lanes = bits(above);
            if (lanes == 0) continue;
            place_group(g, lanes, normal, view, cos_r, light, cos_i, V(1.0f), above);
        }
        read_table();
        for (int g = 0; g < groups; ++g) {
            V out[3];
            collect(g, out);
            put(g, out);
        }
        spread();
    }

    static void keep(float planes[3][tile_pixels], int i, const Vector3<V>& from) {
        from.x.store(planes[0] + i), from.y.store(planes[1] + i), from.z.store(planes[2] + i);
    }

    // N and V of the pixels that the viewer sees.
    void see() {
        const float *normals[3], *views[3], *layers[3];
        planes_of(scene.normal, 0, normals);
        if (scene.layers.data) planes_of(scene.layers, 1, layers);
        const Map& camera = scene.camera;
        planes_of(camera.data ? scene.position : scene.view, 2, views);
        for (int g = 0; g < groups; ++g) {
            const int i = g * V::lanes;
            for (int c = 0; c < 3; ++c) V(0.0f).store(sum[c] + i);
            const Vector3<V> normal = unit(load(normals, i));
            Vector3<V> view = load(views, i);
            if (camera.data) {
                const float* from = camera.data + image * camera.batch;
                view = {V(from[0]) - view.x, V(from[camera.channel]) - view.y,
                        V(from[2 * camera.channel]) - view.z};
            }
            view = unit(view);
            V cosine = dot(normal, view);
            seen[g] = bits(V(0.0f) < cosine);
            if (scene.layers.data) {
                const Vector3<V> leaning = unit(load(layers, i));
                cosine = dot(leaning, view);
                seen[g] &= bits(V(0.0f) < cosine);
                keep(layer, i, leaning);
            }
            if (i + V::lanes > count) seen[g] &= count > i ? (1u << (count - i)) - 1 : 0u;
            keep(n, i, normal);
            keep(v, i, view);
            cosine.store(n_v + i);
        }
    }

    // Where the light is and how much of it arrives, without its colour (lights.py).
    static Vector3<V> towards(const Light& light, const Vector3<V>& position, V& strength) {
        const Vector3<V> to{V(light.at[0]) - position.x, V(light.at[1]) - position.y,
                            V(light.at[2]) - position.z};
        const V square = dot(to, to);
        const auto apart = V(FLT_MIN) < square;
        strength = select(apart, V(1.0f) / select(apart, square, 1.0f), 0.0f);
        if (light.kind == spot) {
            const Vector3<V> axis{light.axis[0], light.axis[1], light.axis[2]};
            const V length = root(square * dot(axis, axis));
            const V cosine = (V(0.0f) - dot(to, axis)) / greatest(length, FLT_MIN);
            const V x = least(greatest((cosine - light.outer) / (light.inner - light.outer), 0.0f), 1.0f);
            strength = strength * (x * x * fnma(V(2.0f), x, 3.0f));
        }
        return unit(to);
    }

    // The box around the tile's positions; only where a light may turn out too far away.
    void bound_positions() {
        const float* positions[3];
        planes_of(scene.position, 3, positions);
        for (int c = 0; c < 3; ++c) {
            float least_of = FLT_MAX, greatest_of = -FLT_MAX;
            for (int i = 0; i < count; ++i) {  // NaN is neither
                least_of = positions[c][i] < least_of ? positions[c][i] : least_of;
                greatest_of = positions[c][i] > greatest_of ? positions[c][i] : greatest_of;
            }
            low[c] = least_of, high[c] = greatest_of;
        }
    }

    // Whether a light is left out: it shines past the tile, or all that it can add still fits into
    // what may be lost.
    bool left_out(const Light& light) {
        float share = light.reach;
        if (light.kind != directional && scene.bounded) {
            float square = 0.0f;
            for (int c = 0; c < 3; ++c) {
                const float below = low[c] - light.at[c], above = light.at[c] - high[c];
                const float apart = below > above ? below : above;
                if (apart > 0.0f) square += apart * apart;
            }
            share = light.reach / square;
            if (light.kind == spot && shines_past(light)) return true;
        }
        if (!(lost + share <= 1.0f)) return false;
        lost += share;
        return true;
    }

    // The cone around the tile, as the lamp sees it, against the lamp's own.
    bool shines_past(const Light& light) const {
        float to_centre = 0.0f, radius = 0.0f, axis = 0.0f, along = 0.0f;
        for (int c = 0; c < 3; ++c) {
            const float centre = 0.5f * (low[c] + high[c]) - light.at[c], half = 0.5f * (high[c] - low[c]);
            to_centre += centre * centre, radius += half * half;
            axis += light.axis[c] * light.axis[c], along += centre * light.axis[c];
        }
        if (!(radius < to_centre)) return false;
        const float cosine = along / std::sqrt(to_centre * axis);
        const float tile_sine = std::sqrt(radius / to_centre);
        const float tile_cosine = std::sqrt(1.0f - tile_sine * tile_sine);
        const float sine = std::sqrt(cosine * cosine < 1.0f ? 1.0f - cosine * cosine : 0.0f);
        const bool beside = cosine < tile_cosine;  // the lamp's axis does not meet the tile
        return beside && cosine * tile_cosine + sine * tile_sine < light.outer - 1e-4f;
    }

    void add_light(const Light& light) {
        if (left_out(light)) return;
        const float* positions[3];
        if (light.kind != directional) planes_of(scene.position, 3, positions);
        for (int g = 0; g < groups; ++g) {
            lit[g] = 0;
            if (seen[g] == 0) continue;
            const int i = g * V::lanes;
            const float *normals[3] = {n[0], n[1], n[2]}, *views[3] = {v[0], v[1], v[2]};
            Vector3<V> normal = load(normals, i);
            V strength = 1.0f;
            const Vector3<V> to = light.kind == directional
                                      ? Vector3<V>{light.at[0], light.at[1], light.at[2]}
                                      : towards(light, load(positions, i), strength);
            V cos_i = dot(normal, to);
            const V cos_r = V::load(n_v + i);
            strength = strength * cos_i;
            if (scene.layers.data) {  // the surface's cosine, but the layers' place in the table
                const float* layers[3] = {layer[0], layer[1], layer[2]};
                normal = load(layers, i);
                cos_i = dot(normal, to);
            }
            const auto above = both(V(0.0f) < strength, both(V(0.0f) < cos_i, V(0.0f) < cos_r));
            const unsigned lanes = bits(above) & seen[g];
            if (lanes == 0) continue;
            strength = select(above, strength, 0.0f);
            place_group(g, lanes, normal, load(views, i), cos_r, to, cos_i, strength, above);
        }
        read_table();
        for (int g = 0; g < groups; ++g) {
            if (lit[g] == 0) continue;
            V out[3];
            collect(g, out);
            for (int c = 0; c < 3; ++c) {
                float* here = sum[c] + g * V::lanes;
                fma(out[c], V(light.radiated[c]), V::load(here)).store(here);
            }
        }
    }

    // Σ f_r E cos θi, times the mask; what is not finite is 0.
    void shade() {
        if (count == 0) return clear();
        see();
        if (scene.bounded) bound_positions();
        for (int k = 0; k < scene.light_count; ++k) add_light(scene.lights[k * scene.batch + image]);
        for (int g = 0; g < groups; ++g) {
            V out[3];
            for (int c = 0; c < 3; ++c) out[c] = V::load(sum[c] + g * V::lanes);
            put_masked(g, out);
        }
        spread();
    }

    void put_masked(int g, V out[3]) {
        for (int c = 0; c < 3; ++c) {
            out[c] = select(magnitude(out[c]) <= FLT_MAX, out[c], 0.0f);
            if (scene.mask.data) out[c] = out[c] * V::load(masked + g * V::lanes);
        }
        put(g, out);
    }

    // The same from a lit sphere: bilinear in the octahedral map of the hemisphere.
    void look_up() {
        if (count == 0) return clear();
        const float* normals[3];
        planes_of(scene.normal, 0, normals);
        const float* f = scene.sphere.frame;
        const float last = static_cast<float>(scene.sphere.side - 1);
        for (int g = 0; g < groups; ++g) {
            lit[g] = 0;
            const int i = g * V::lanes;
            const Vector3<V> normal = unit(load(normals, i));
            const V z = dot(normal, Vector3<V>{f[6], f[7], f[8]});
            lit[g] = bits(V(0.0f) < z);
            if (lit[g] == 0) continue;
            const V x = dot(normal, Vector3<V>{f[0], f[1], f[2]}), y = dot(normal, Vector3<V>{f[3], f[4], f[5]});
            const V scale = V(0.5f * last) / (magnitude(x) + magnitude(y) + greatest(z, tiny));
            const V across = least(greatest(fma(x + y, scale, 0.5f * last), 0.0f), last);
            const V down = least(greatest(fma(x - y, scale, 0.5f * last), 0.0f), last);
            const V column = least(floor_of(across), last - 1.0f), line = least(floor_of(down), last - 1.0f);
            fma(line, V(last + 1.0f), column).store_int(cells.first + i);
            (V(1.0f) - (down - line)).store(cells.weight[0] + i);
            (down - line).store(cells.weight[1] + i);
            V(0.0f).store(cells.weight[2] + i);
            V(0.0f).store(cells.weight[3] + i);
            (V(1.0f) - (across - column)).store(cells.near + i);
            (across - column).store(cells.far + i);
        }
        read_table();
        for (int g = 0; g < groups; ++g) {
            V out[3];
            collect(g, out);
            put_masked(g, out);
        }
        spread();
    }
};

template <class V>
void shade_tiles(const Scene& scene, long first_tile, long last_tile) {
    const long across = tiles_per_row(scene);
    for (long i = first_tile; i < last_tile; ++i) {
        const long line = i / across;
        Tile<V> tile(scene, line / scene.rows, line % scene.rows, i % across * tile_pixels);
        tile.select_pixels();
        if (scene.sphere.values)
            tile.look_up();
        else if (scene.lit)
            tile.shade();
        else
            tile.reflect();
    }
    V::fence();
}

}  // namespace raden
