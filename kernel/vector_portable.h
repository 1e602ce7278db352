// 8 lanes of float in an array: loops that any compiler can turn into what its machine has.
#pragma once
#include <cmath>
#include <cstdint>
#include <cstring>

#include "scene.h"

namespace raden {

struct Portable {
    static constexpr int lanes = 8;
    struct Mask {
        std::int32_t x[lanes];  // −1 or 0
    };
    float x[lanes];

    Portable() = default;
    Portable(float v) {
        for (float& lane : x) lane = v;
    }
    static Portable load(const float* p) {
        Portable v;
        std::memcpy(v.x, p, sizeof v.x);
        return v;
    }
    void store(float* p) const { std::memcpy(p, x, sizeof x); }
    void stream(float* p) const { store(p); }
    static void fence() {}
    void store_int(int* p) const {
        // NaN and what is out of range may only come from lanes that are not read
        for (int i = 0; i < lanes; ++i) p[i] = x[i] > -1.0f && x[i] < 1e9f ? static_cast<int>(x[i]) : 0;
    }
};

template <class F>
inline Portable lanewise(F f) {
    Portable v;
    for (int i = 0; i < Portable::lanes; ++i) v.x[i] = f(i);
    return v;
}
template <class F>
inline Portable::Mask maskwise(F f) {
    Portable::Mask m;
    for (int i = 0; i < Portable::lanes; ++i) m.x[i] = -static_cast<std::int32_t>(f(i));
    return m;
}

using P = const Portable&;
using PM = const Portable::Mask&;
inline Portable operator+(P a, P b) { return lanewise([&](int i) { return a.x[i] + b.x[i]; }); }
inline Portable operator-(P a, P b) { return lanewise([&](int i) { return a.x[i] - b.x[i]; }); }
inline Portable operator*(P a, P b) { return lanewise([&](int i) { return a.x[i] * b.x[i]; }); }
inline Portable operator/(P a, P b) { return lanewise([&](int i) { return a.x[i] / b.x[i]; }); }
inline Portable::Mask operator<(P a, P b) { return maskwise([&](int i) { return a.x[i] < b.x[i]; }); }
inline Portable::Mask operator<=(P a, P b) { return maskwise([&](int i) { return a.x[i] <= b.x[i]; }); }
inline Portable::Mask both(PM a, PM b) { return maskwise([&](int i) { return (a.x[i] & b.x[i]) != 0; }); }
inline unsigned bits(PM m) {
    unsigned all = 0;
    for (int i = 0; i < Portable::lanes; ++i) all |= static_cast<unsigned>(m.x[i] & 1) << i;
    return all;
}

inline Portable::Mask lanes_in(unsigned bits, P) { return maskwise([&](int i) { return (bits >> i & 1) != 0; }); }

inline Portable fma(P a, P b, P c) { return a * b + c; }
inline Portable fnma(P a, P b, P c) { return c - a * b; }
inline Portable fms(P a, P b, P c) { return a * b - c; }
inline Portable root(P a) { return lanewise([&](int i) { return std::sqrt(a.x[i]); }); }
inline Portable magnitude(P a) { return lanewise([&](int i) { return std::fabs(a.x[i]); }); }
inline Portable least(P a, P b) { return lanewise([&](int i) { return a.x[i] < b.x[i] ? a.x[i] : b.x[i]; }); }
inline Portable greatest(P a, P b) { return lanewise([&](int i) { return a.x[i] > b.x[i] ? a.x[i] : b.x[i]; }); }
inline Portable floor_of(P a) { return lanewise([&](int i) { return std::floor(a.x[i]); }); }
inline Portable select(PM m, P a, P b) { return lanewise([&](int i) { return m.x[i] ? a.x[i] : b.x[i]; }); }

// 8 pixels of (r, g, b, ·), each `step` numbers after the one before → three planes.
inline void planes(const float* rgb, long step, Portable& r, Portable& g, Portable& b) {
    r = lanewise([&](int i) { return rgb[step * i]; });
    g = lanewise([&](int i) { return rgb[step * i + 1]; });
    b = lanewise([&](int i) { return rgb[step * i + 2]; });
}

inline void planes(const float* rgb, Portable& r, Portable& g, Portable& b) { planes(rgb, 4, r, g, b); }

inline void fetch(P, const Cells& cells, int i, const Table& table, float* rgb) {
    const float* p = table.values + 3L * cells.first[i];
    for (int c = 0; c < 3; ++c) {
        const auto across = [&](long at) {
            return cells.weight[0][i] * p[at] + cells.weight[1][i] * p[table.row + at] +
                   cells.weight[2][i] * p[table.slab + at] +
                   cells.weight[3][i] * p[table.slab + table.row + at];
        };
        rgb[c] = cells.near[i] * across(c) + cells.far[i] * across(c + 3);
    }
}

// The slopes of the table along the three axes, in nodes, at pixel i of a vector: three channels each.
inline void slopes_at(P, const Table& table, long node, const Visit& visit, int i, float* const slopes[3]) {
    const float* p = table.values + 3 * node;
    const float x = visit.at[0][i], y = visit.at[1][i], z = visit.at[2][i];
    for (int c = 0; c < 3; ++c, ++p) {
        const auto step = [&](const float* q) { return q[3] - q[0]; };
        const auto line = [&](const float* q) { return q[0] + z * step(q); };
        const float *right = p + table.row, *up = p + table.slab, *across = up + table.row;
        const float low = line(right) - line(p), high = line(across) - line(up);
        slopes[0][c] = line(up) + y * high - (line(p) + y * low);
        slopes[1][c] = (1 - x) * low + x * high;
        slopes[2][c] = (1 - x) * ((1 - y) * step(p) + y * step(right)) +
                       x * ((1 - y) * step(up) + y * step(across));
    }
}

// What a change g of pixel i gives to each of the eight nodes around it.
inline void add_to_nodes(P, const Table& table, long node, const Visit& visit, int i, float* sums) {
    const long row = sum_floats * (table.row / 3), slab = sum_floats * (table.slab / 3);
    const float x = visit.at[0][i], y = visit.at[1][i], z = visit.at[2][i];
    const float across[4] = {(1 - x) * (1 - y), (1 - x) * y, x * (1 - y), x * y};
    const long corners[4] = {0, row, slab, slab + row};
    for (int j = 0; j < 4; ++j) {
        float* q = sums + sum_floats * node + corners[j];
        for (int c = 0; c < 3; ++c) {
            const float g = across[j] * visit.change[c][i];
            q[c] += (1 - z) * g;
            q[sum_floats + c] += z * g;
        }
    }
}

}  // namespace raden
