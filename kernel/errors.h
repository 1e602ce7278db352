// Tiles with standard deviations: an image, and what the errors of the table's nodes do to it. The
// reference is shading/radiance_std.py.
#pragma once
#include <cstring>

#include "shade.h"

namespace raden {

template <class V>
struct ErrorTile : ShadedTile<V> {
    using Base = ShadedTile<V>;
    using Base::groups;
    using Base::reader;
    using Base::scene;
    using Base::sum;

    static constexpr int own_at = 3, shared_at = 6;  // of a node's numbers
    using Pixels = float[tile_pixels][node_floats];
    const Errors& errors;
    alignas(64) Pixels sums = {};     // over lights; of own errors over those where they are one
    alignas(64) Pixels squares;       // of own errors, over what else
    bool is_one = true;               // all lights' own errors are one, and need no squares
    alignas(64) float is_own[node_floats] = {};

    ErrorTile(const Scene& s, long b, long y, long x) : Base(s, b, y, x), errors(s.errors) {
        for (int c = own_at; c < shared_at; ++c) is_own[c] = 1.0f;
    }

    void shade() {
        float* const targets[3] = {scene.image, errors.own, errors.systematic};
        if (this->count == 0) {
            for (float* to : targets) this->target = to, this->clear();
            return;
        }
        this->see();
        reader.all_read(0);
        for (int k = 0; k + 1 < scene.light_count; ++k) is_one &= !errors.ends[k];
        if (!is_one) std::memset(squares, 0, sizeof squares);
        for (int k = 0; k < scene.light_count; ++k) {
            const Light& light = scene.lights[k * scene.batch + this->image];
            this->place_light(light, [&](int g, unsigned lanes, const Geometry<V>& at, const V& strength) {
                reader.place_by(scene.table, g, lanes, at, strength);
                reader.lit[g] = lanes;
            });
            read(light);
            if (errors.ends[k] && k + 1 < scene.light_count) end_together();
        }
        put_all();
    }

    void read(const Light& light) {
        alignas(64) float radiated[node_floats];
        for (int c = 0; c < node_floats; ++c) radiated[c] = light.radiated[c % 3];
        const Cells& cells = this->cells;
        const long right = scene.table.row / 3 * node_floats, up = scene.table.slab / 3 * node_floats;
        for (int g = 0; g < groups; ++g)
            reader.each_lane(g, reader.lit[g], [&](int i) {
                const float* p = errors.values + static_cast<long>(node_floats) * cells.first[i];
                const float* const at[4] = {p, p + right, p + up, p + up + right};
                for (int c = 0; c < node_floats; c += V::lanes) {
                    V near = 0.0f, far = 0.0f;
                    for (int k = 0; k < 4; ++k) {
                        const V weight = cells.weight[k][i];
                        near = fma(weight, V::load(at[k] + c), near);
                        far = fma(weight, V::load(at[k] + node_floats + c), far);
                    }
                    const V value = fma(far, cells.far[i], near * V(cells.near[i]));
                    fma(value, V::load(radiated + c), V::load(sums[i] + c)).store(sums[i] + c);
                }
            });
    }

    void end_together() {
        for (int i = 0; i < tile_pixels; ++i)
            for (int c = 0; c < node_floats; c += V::lanes) {
                const V all = V::load(sums[i] + c), own = all * V::load(is_own + c);
                fma(own, own, V::load(squares[i] + c)).store(squares[i] + c);
                (all - own).store(sums[i] + c);
            }
    }

    // Four numbers of each pixel, of which `planes` takes three.
    template <class Take>
    void gather(int g, const Take& take, V out[3]) {
        alignas(64) float rgb[4 * V::lanes];
        for (int i = 0; i < V::lanes; ++i)
            for (int c = 0; c < 4; ++c) rgb[4 * i + c] = take(g * V::lanes + i, c);
        planes(rgb, out[0], out[1], out[2]);
    }

    void put_all() {
        V out[3];
        alignas(64) float images[3][3][tile_pixels];
        for (int g = 0; g < groups; ++g) {
            const auto keep = [&](int k) {
                for (int c = 0; c < 3; ++c) out[c].store(images[k][c] + g * V::lanes);
            };
            gather(g, [&](int i, int c) { return sums[i][own_at + c]; }, out);
            if (is_one) {
                for (V& each : out) each = magnitude(each);
            } else {
                V others[3];
                gather(g, [&](int i, int c) { return squares[i][own_at + c]; }, others);
                for (int c = 0; c < 3; ++c) out[c] = root(fma(out[c], out[c], others[c]));
            }
            keep(1);
            gather(g, [&](int i, int c) {
                const float* s = sums[i] + shared_at + c;
                return s[0] * s[0] + s[3] * s[3] + s[6] * s[6];
            }, out);
            V value[3];
            gather(g, [&](int i, int c) { return sums[i][c]; }, value);
            for (int c = 0; c < 3; ++c) {
                const V scaled = value[c] * errors.scale;
                out[c] = root(fma(scaled, scaled, out[c]));
            }
            keep(2);
            for (int c = 0; c < 3; ++c) out[c] = value[c];
            keep(0);
        }
        float* const targets[3] = {scene.image, errors.own, errors.systematic};
        for (int k = 0; k < 3; ++k) {
            this->target = targets[k];
            for (int g = 0; g < groups; ++g) {
                for (int c = 0; c < 3; ++c) out[c] = V::load(images[k][c] + g * V::lanes);
                this->put_masked(g, out);
            }
            this->spread();
        }
    }
};

}  // namespace raden
