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
    alignas(64) Pixels sums;          // over lights; of own errors over those where they are one
    alignas(64) Pixels squares;       // of own errors, over what else
    bool is_one = true;               // all lights' own errors are one, and need no squares
    alignas(64) float is_own[node_floats] = {};

    ErrorTile(const Scene& s, long b, long y, long x) : Base(s, b, y, x), errors(s.errors) {
        for (int c = own_at; c < shared_at; ++c) is_own[c] = 1.0f;
    }

    void shade() {
        float* const targets[3] = {scene.image, errors.own, errors.systematic};
        if (this->count == 0 || scene.light_count == 0) {
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
            k == 0 ? read<true>(light) : read<false>(light);
            if (errors.ends[k] && k + 1 < scene.light_count) end_together();
        }
        put_all();
    }

    template <bool is_first>
    void read(const Light& light) {
        alignas(64) float radiated[node_floats];
        for (int c = 0; c < node_floats; ++c) radiated[c] = light.radiated[c % 3];
        const Cells& cells = this->cells;
        const long right = scene.table.row / 3 * node_floats, up = scene.table.slab / 3 * node_floats;
        for (int g = 0; g < groups; ++g) {
            if (is_first && count_of(reader.lit[g]) < V::lanes)
                std::memset(sums[g * V::lanes], 0, sizeof(float) * V::lanes * node_floats);
            reader.each_lane(g, reader.lit[g], [&](int i) {
                const float* p = errors.values + static_cast<long>(node_floats) * cells.first[i];
                const V weight[4] = {cells.weight[0][i], cells.weight[1][i], cells.weight[2][i], cells.weight[3][i]};
                const V nearer = cells.near[i], further = cells.far[i];
                for (int c = 0; c < node_floats; c += V::lanes, p += V::lanes) {
                    const auto across = [&](const float* at) {
                        const V low = fma(weight[1], V::load(at + right), weight[0] * V::load(at));
                        return fma(weight[3], V::load(at + up + right), fma(weight[2], V::load(at + up), low));
                    };
                    const V value = fma(further, across(p + node_floats), nearer * across(p));
                    const V shown = value * V::load(radiated + c);
                    (is_first ? shown : shown + V::load(sums[i] + c)).store(sums[i] + c);
                }
            });
        }
    }

    void end_together() {
        for (int i = 0; i < tile_pixels; ++i)
            for (int c = 0; c < node_floats; c += V::lanes) {
                const V all = V::load(sums[i] + c), own = all * V::load(is_own + c);
                fma(own, own, V::load(squares[i] + c)).store(squares[i] + c);
                (all - own).store(sums[i] + c);
            }
    }

    // Three numbers of each pixel, from the one at `c`, in planes.
    static void gather(const Pixels& from, int g, int c, V out[3]) {
        planes(from[g * V::lanes] + c, node_floats, out[0], out[1], out[2]);
    }

    void put_all() {
        put_each(scene.image, [&](int g, V out[3]) { gather(sums, g, 0, out); });
        put_each(errors.own, [&](int g, V out[3]) {
            gather(sums, g, own_at, out);
            V others[3] = {0.0f, 0.0f, 0.0f};
            if (!is_one) gather(squares, g, own_at, others);
            for (int c = 0; c < 3; ++c)
                out[c] = is_one ? magnitude(out[c]) : root(fma(out[c], out[c], others[c]));
        });
        put_each(errors.systematic, [&](int g, V out[3]) {
            gather(sums, g, 0, out);
            for (int c = 0; c < 3; ++c) {
                const V scaled = out[c] * errors.scale;
                out[c] = scaled * scaled;
            }
            for (int k = 0; k < 3; ++k) {
                V shared[3];
                gather(sums, g, shared_at + 3 * k, shared);
                for (int c = 0; c < 3; ++c) out[c] = fma(shared[c], shared[c], out[c]);
            }
            for (int c = 0; c < 3; ++c) out[c] = root(out[c]);
        });
    }

    template <class Of>
    void put_each(float* target, const Of& of) {
        this->target = target;
        for (int g = 0; g < groups; ++g) {
            V out[3];
            of(g, out);
            this->put_masked(g, out);
        }
        this->spread();
    }
};

}  // namespace raden
