// The tiles of a scene: f_r itself, the sum over lights, or a lit sphere.
#pragma once
#include "light.h"
#include "table.h"

namespace raden {

template <class V>
struct ShadedTile : Tile<V> {
    using Tile<V>::groups;
    using Tile<V>::scene;
    using Tile<V>::image;
    using Tile<V>::count;
    using Tile<V>::sum;
    using Tile<V>::load;
    using Tile<V>::planes_of;
    using Tile<V>::put;
    using Tile<V>::spread;

    TableReader<V> reader;
    Omissions<V> omissions;
    alignas(64) float n[3][tile_pixels], v[3][tile_pixels], n_v[tile_pixels];
    alignas(64) float layer[3][tile_pixels];  // the layers' normals, where they lean; n_v is theirs
    alignas(64) float shares[most_weights][tile_pixels];  // of the tables that are mixed
    int shown[most_weights], shown_count = 0;             // which these are
    unsigned seen[groups];

    ShadedTile(const Scene& s, long b, long y, long x)
        : Tile<V>(s, b, y, x), reader(*this, s.tables) {}

    // f_r of N, L and V, all three as maps.
    void reflect() {
        const float *normals[3], *lights[3], *views[3];
        planes_of(scene.normal, 0, normals);
        planes_of(scene.light, 1, lights);
        planes_of(scene.view, 2, views);
        reader.all_read(0);
        for (int g = 0; g < groups; ++g) {
            reader.lit[g] = 0;
            const int i = g * V::lanes;
            Geometry<V> at;
            at.normal = unit(load(normals, i)), at.light = unit(load(lights, i));
            at.cos_i = dot(at.normal, at.light);
            const auto lit = V(0.0f) < at.cos_i;
            if (bits(lit) == 0) continue;
            at.view = unit(load(views, i));
            at.cos_r = dot(at.normal, at.view);
            const auto above = both(lit, V(0.0f) < at.cos_r);
            const unsigned lanes = bits(above);
            if (lanes != 0) reader.place(g, lanes, at, select(above, V(1.0f), 0.0f));
        }
        reader.read();
        for (int g = 0; g < groups; ++g) {
            V out[3];
            reader.collect(g, reader.lit[g], out);
            put(g, out);
        }
        spread();
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
                this->keep(layer, i, leaning);
            }
            if (i + V::lanes > count) seen[g] &= count > i ? (1u << (count - i)) - 1 : 0u;
            this->keep(n, i, normal);
            this->keep(v, i, view);
            cosine.store(n_v + i);
        }
    }

    // Where the pixels that a light reaches lie in their tables.
    void place_light(const Light& light) {
        place_light(light, [&](int g, unsigned lanes, const Geometry<V>& at, const V& strength) {
            reader.place(g, lanes, at, strength);
        });
    }

    // The same by `put`, which places one vector of pixels.
    template <class Put>
    void place_light(const Light& light, const Put& put) {
        const float *positions[3], *normals[3] = {n[0], n[1], n[2]}, *views[3] = {v[0], v[1], v[2]};
        const float* layers[3] = {layer[0], layer[1], layer[2]};
        if (light.kind != directional) planes_of(scene.position, 3, positions);
        for (int g = 0; g < groups; ++g) {
            reader.lit[g] = 0;
            if (seen[g] == 0) continue;
            const int i = g * V::lanes;
            Geometry<V> at;
            at.normal = load(normals, i);
            V strength = 1.0f;
            at.light = light.kind == directional
                           ? Vector3<V>{light.at[0], light.at[1], light.at[2]}
                           : towards(light, load(positions, i), strength);
            at.cos_i = dot(at.normal, at.light);
            at.cos_r = V::load(n_v + i);
            strength = strength * at.cos_i;
            if (scene.layers.data) {  // the surface's cosine, but the layers' place in the table
                at.normal = load(layers, i);
                at.cos_i = dot(at.normal, at.light);
            }
            const auto above = both(V(0.0f) < strength, both(V(0.0f) < at.cos_i, V(0.0f) < at.cos_r));
            const unsigned lanes = bits(above) & seen[g];
            if (lanes == 0) continue;
            at.view = load(views, i);
            put(g, lanes, at, select(above, strength, 0.0f));
        }
    }

    void add_light(const Light& light) {
        if (omissions.left_out(light, scene.bounded)) return;
        if (scene.weights.data) return add_mixture(light);
        place_light(light);
        reader.read();
        add_read(light);
    }

    // What was read of the pixels that a light reaches.
    void add_read(const Light& light) {
        for (int g = 0; g < groups; ++g) {
            if (reader.lit[g] == 0) continue;
            V out[3];
            reader.collect(g, reader.lit[g], out);
            add(g, out, light);
        }
    }

    void add(int g, const V out[3], const Light& light) {
        for (int c = 0; c < 3; ++c) {
            float* here = sum[c] + g * V::lanes;
            fma(out[c], V(light.radiated[c]), V::load(here)).store(here);
        }
    }

    // Several tables, each times its weight; those of one layout are read at one place.
    void add_mixture(const Light& light) {
        const Table* placed = nullptr;
        for (int j = 0; j < shown_count; ++j) {
            const Table& table = scene.tables[shown[j]];
            reader.all_read(shown[j]);
            if (!placed || !same_layout(*placed, table)) {
                place_light(light);
                placed = &table;
            }
            for (int g = 0; g < groups; ++g) {
                const V weight = V::load(shares[j] + g * V::lanes);
                const unsigned lanes = reader.lit[g] & bits(V(0.0f) < weight);
                if (lanes == 0) continue;
                reader.read(g, lanes);
                V out[3];
                reader.collect(g, lanes, out);
                for (int c = 0; c < 3; ++c) out[c] = out[c] * weight;
                add(g, out, light);
            }
        }
    }

    // The tables that the tile's pixels mix, and their weights.
    void find_shares() {
        for (int k = 0; k < scene.table_count; ++k) {
            float* to = shares[shown_count];
            if (k < scene.weight_count)
                copy_weights(k, to);
            else
                rest_of_weights(to);
            for (int i = count; i < tile_pixels; ++i) to[i] = 0.0f;
            unsigned any = 0;
            for (int g = 0; g < groups; ++g) any |= bits(V(0.0f) < V::load(to + g * V::lanes));
            if (any != 0) shown[shown_count++] = k;
        }
    }

    void copy_weights(int k, float* to) const {
        const Map& m = scene.weights;
        const float* p = m.data + this->start_of(m) + k * m.channel;
        if (this->whole && m.column == 1)
            for (int i = 0; i < tile_pixels; ++i) to[i] = p[i];
        else
            for (int i = 0; i < count; ++i) to[i] = p[this->at[i] * m.column];
    }

    void rest_of_weights(float* to) const {
        float own[tile_pixels];
        for (int i = 0; i < count; ++i) to[i] = 1.0f;
        for (int k = 0; k < scene.weight_count; ++k) {
            copy_weights(k, own);
            for (int i = 0; i < count; ++i) to[i] -= own[i];
        }
    }

    // Σ f_r E cos θi, times the mask; what is not finite is 0.
    void shade() {
        if (count == 0) return this->clear();
        see();
        if (scene.weights.data)
            find_shares();
        else
            reader.choose();
        if (scene.bounded) {
            const float* positions[3];
            planes_of(scene.position, 3, positions);
            omissions.bound(positions, count);
        }
        for (int k = 0; k < scene.light_count; ++k) add_light(scene.lights[k * scene.batch + image]);
        put_sum();
    }

    void put_sum() {
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
            if (scene.mask.data) out[c] = out[c] * V::load(this->masked + g * V::lanes);
        }
        put(g, out);
    }

    // The same from a lit sphere: bilinear in the octahedral map of the hemisphere.
    void look_up() {
        if (count == 0) return this->clear();
        Cells& cells = this->cells;
        const float* normals[3];
        planes_of(scene.normal, 0, normals);
        reader.all_read(0);
        const float* f = scene.sphere.frame;
        const float last = static_cast<float>(scene.sphere.side - 1);
        for (int g = 0; g < groups; ++g) {
            reader.lit[g] = 0;
            const int i = g * V::lanes;
            const Vector3<V> normal = unit(load(normals, i));
            const V z = dot(normal, Vector3<V>{f[6], f[7], f[8]});
            reader.lit[g] = bits(V(0.0f) < z);
            if (reader.lit[g] == 0) continue;
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
        reader.read();
        for (int g = 0; g < groups; ++g) {
            V out[3];
            reader.collect(g, reader.lit[g], out);
            put_masked(g, out);
        }
        spread();
    }
};

}  // namespace raden
