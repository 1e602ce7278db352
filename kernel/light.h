// Lights from a tile: where they are, and whether all that they add may be left out.
#pragma once
#include <cmath>

#include "formula.h"

namespace raden {

// Where the light is and how much of it arrives, without its colour (lights.py).
template <class V>
inline Vector3<V> towards(const Light& light, const Vector3<V>& position, V& strength) {
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

// What a tile leaves out of its lights. Of V only because each instruction set has its own.
template <class V>
struct Omissions {
    float low[3], high[3];  // of the positions
    float lost = 0.0f;      // of what may be left out, in lights

    // The box around the tile's positions; only where a light may turn out too far away.
    void bound(const float* const positions[3], int count) {
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
    bool left_out(const Light& light, bool bounded) {
        float share = light.reach;
        if (light.kind != directional && bounded) {
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
};

}  // namespace raden
