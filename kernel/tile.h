// Tiles of 64 pixels: which of them are shaded, their maps in planes, and their place in the image.
#pragma once
#include <cmath>
#include <cstdint>

#include "formula.h"

namespace raden {

#if defined(__GNUC__)
#define RADEN_INLINE __attribute__((always_inline)) inline
#define RADEN_ONCE __attribute__((noinline))  // however often it is called
static inline int count_of(unsigned bits) { return __builtin_popcount(bits); }
static inline int lowest(unsigned bits) { return __builtin_ctz(bits); }
static inline void ask_for(const float* p) { __builtin_prefetch(p); }
#else
#define RADEN_INLINE inline
#define RADEN_ONCE
static inline int count_of(unsigned bits) {
    int n = 0;
    for (; bits != 0; bits &= bits - 1) ++n;
    return n;
}

static inline int lowest(unsigned bits) { return count_of((bits & (0u - bits)) - 1); }
static inline void ask_for(const float*) {}
#endif

// What a mask, or an index of no table, leaves of the tiles of a row, until it fills a tile.
struct Gathered {
    long first = 0;              // the column that `at` counts from
    int count = 0, table = 0;    // the one that all of them read
    int at[2 * tile_pixels];
    float masked[2 * tile_pixels];
};

// The pixels of one tile that are worth a look; all of its buffers together stay in the L1 cache.
template <class V>
struct Tile {
    static constexpr int groups = tile_pixels / V::lanes;

    const Scene& scene;
    const long image, row, first;
    const int width;           // pixels of the tile
    float* target;             // the image that is written
    int count = 0;             // of these, the ones that are shaded
    bool whole = false;        // all 64, in a row
    bool gathered = false;     // of several tiles, which were cleared
    bool stream;               // write past the caches
    int at[tile_pixels];       // which ones
    int table = 0;             // the one that all of them read; −1 where they differ
    int table_of[tile_pixels];
    Cells cells;
    alignas(64) float sum[3][tile_pixels], masked[tile_pixels];
    alignas(64) float copies[4][3][tile_pixels];

    Tile(const Scene& s, long b, long y, long x)
        : scene(s), image(b), row(y), first(x),
          width(static_cast<int>(s.columns - x < tile_pixels ? s.columns - x : tile_pixels)),
          target(s.image), stream(s.stream) {}

    // What is left of this tile goes to others; it has to be cleared all the same.
    void leave(Gathered& to) {
        if (to.count == 0) to.first = first, to.table = table;
        for (int i = 0; i < count; ++i) {
            to.at[to.count + i] = static_cast<int>(first - to.first) + at[i];
            if (scene.mask.data) to.masked[to.count + i] = masked[i];
        }
        to.count += count;
        count = 0;
        stream = false;  // its pixels come soon
    }

    // A tile's worth of them, in a tile that starts at their first column.
    void take(Gathered& from) {
        gathered = true;
        table = from.table;
        count = from.count < tile_pixels ? from.count : tile_pixels;
        from.count -= count;
        for (int i = 0; i < count; ++i) at[i] = from.at[i];
        for (int i = 0; i < from.count; ++i) from.at[i] = from.at[count + i];
        if (!scene.mask.data) return;
        for (int i = 0; i < tile_pixels; ++i) masked[i] = i < count ? from.masked[i] : 0.0f;
        for (int i = 0; i < from.count; ++i) from.masked[i] = from.masked[count + i];
    }

    // Some of its pixels alone are shaded, and they read one table.
    bool is_cut() const { return count > 0 && count < width && table >= 0; }

    long start_of(const Strides& m) const { return image * m.batch + row * m.row + first * m.column; }

    void select_pixels() {
        select_by_mask();
        if (scene.index.data && count > 0) {
            if (scene.index.wide)
                select_by_table(static_cast<const std::int64_t*>(scene.index.data));
            else
                select_by_table(static_cast<const std::uint8_t*>(scene.index.data));
        }
        whole = count == tile_pixels;
    }

    // Which table each pixel reads. An index of no table, or beyond them, is not shaded.
    template <class Integer>
    void select_by_table(const Integer* p) {
        p += start_of(scene.index);
        const long step = scene.index.column;
        const auto tables = static_cast<std::uint64_t>(scene.table_count);
        Integer others = 0;
        bool known = true;
        const auto read = [&](int i, Integer k) {
            others |= k ^ p[at[0] * step];
            const bool within = static_cast<std::uint64_t>(k) < tables;
            known &= within;
            table_of[i] = within ? static_cast<int>(k) : 0;
        };
        if (count == tile_pixels && step == 1)
            for (int i = 0; i < tile_pixels; ++i) read(i, p[i]);
        else
            for (int i = 0; i < count; ++i) read(i, p[at[i] * step]);
        if (known && scene.all_tables) {
            table = others == 0 ? table_of[0] : -1;
            return pad_tables();
        }
        int kept = 0;
        for (int i = 0; i < count; ++i) {
            const auto k = static_cast<std::uint64_t>(p[at[i] * step]);
            at[kept] = at[i];
            if (scene.mask.data) masked[kept] = masked[i];
            table_of[kept] = table_of[i];
            kept += k < tables && scene.tables[k].values;
        }
        count = kept;
        table = table_of[0];
        for (int i = 0; i < count; ++i)
            if (table_of[i] != table_of[0]) table = -1;
        pad_tables();
    }

    // Lanes beyond the last pixel read as it does.
    void pad_tables() {
        for (int i = count; i < tile_pixels; ++i) table_of[i] = count > 0 ? table_of[count - 1] : 0;
    }

    void select_by_mask() {
        const Map& m = scene.mask;
        if (!m.data) {
            count = width;
            for (int i = 0; i < width; ++i) at[i] = i;
            return;
        }
        const float* p = m.data + start_of(m);
        if (m.column == 1 && width == tile_pixels)
            select_from(p);
        else
            for (int i = 0; i < width; ++i) keep_one(i, p[i * m.column]);
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
        const float* p = m.data + start_of(m);
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

    float* pixel(int channel) const {
        return target + ((image * 3 + channel) * scene.rows + row) * scene.columns + first;
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
        if (stream && reinterpret_cast<std::uintptr_t>(to) % (4 * V::lanes) == 0)
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
            if (count < width && !gathered)
                for (int i = 0; i < width; ++i) to[i] = 0.0f;
            for (int i = 0; i < count; ++i) to[at[i]] = sum[c][i];
        }
    }

    static void keep(float planes[3][tile_pixels], int i, const Vector3<V>& from) {
        from.x.store(planes[0] + i), from.y.store(planes[1] + i), from.z.store(planes[2] + i);
    }
};

}  // namespace raden
