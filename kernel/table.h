// Reading the tables: where each pixel lies in its own one, and what is there.
#pragma once
#include "tile.h"

namespace raden {

// Unit vectors of one vector of pixels, and the cosines of the normal with the other two.
template <class V>
struct Geometry {
    Vector3<V> normal, light, view;
    V cos_i, cos_r;
};

template <class V>
struct TableReader {
    static constexpr int groups = tile_pixels / V::lanes;

    const Tile<V>& tile;
    const Table* tables;
    Cells& cells;
    const Table* one[groups];  // the table of a vector of pixels; null where they differ
    unsigned lit[groups];      // lanes that read
    alignas(64) float layouts[7][tile_pixels];  // where they differ
    alignas(64) float rgb[4 * tile_pixels];

    TableReader(Tile<V>& of, const Table* from) : tile(of), tables(from), cells(of.cells) {}

    void all_read(int table) {
        for (int g = 0; g < groups; ++g) one[g] = tables + table;
    }

    // The tables that the tile's pixels were selected for.
    void choose() {
        if (tile.table >= 0) return all_read(tile.table);
        for (int g = 0; g < groups; ++g) {
            const int i = g * V::lanes;
            int differ = 0;
            for (int k = i; k < i + V::lanes; ++k) differ |= tile.table_of[k] ^ tile.table_of[i];
            one[g] = differ == 0 ? tables + tile.table_of[i] : nullptr;
            if (differ == 0) continue;
            for (int k = i; k < i + V::lanes; ++k) keep_layout(k, tables[tile.table_of[k]]);
        }
    }

    void keep_layout(int k, const Table& of) {
        for (int j = 0; j < 3; ++j) layouts[j][k] = of.last[j];
        for (int j = 0; j < 2; ++j) layouts[3 + j][k] = of.count[j], layouts[5 + j][k] = of.warp[j];
    }

    // One light on one vector of pixels, `strength` times f_r: fills cells and lit. The strength of
    // other lanes is 0.
    void place(int g, unsigned lanes, const Geometry<V>& at, const V& strength) {
        lit[g] = lanes;
        if (one[g]) {
            place_by(*one[g], g, lanes, at, strength);
            if (one[g]->large) prefetch(g);
            return;
        }
        Layouts<V> own;
        const auto load = [&](int j) { return V::load(layouts[j] + g * V::lanes); };
        for (int j = 0; j < 3; ++j) own.last[j] = load(j);
        for (int j = 0; j < 2; ++j) own.count[j] = load(3 + j), own.warp[j] = load(5 + j);
        place_by(own, g, lanes, at, strength);
        if (!tables->large) return;
        for (int k = g * V::lanes; k < (g + 1) * V::lanes; ++k) ask_around(tables[tile.table_of[k]], cells.first[k]);
    }

    // The first node of each pixel, too.
    template <class Layout>
    V place_by(const Layout& table, int g, unsigned lanes, const Geometry<V>& at, const V& strength) {
        const int i = g * V::lanes;
        const Place<V> place(table, {table, at.normal, at.light, at.view, at.cos_i, at.cos_r, lanes});
        const V first = place.first(table);
        first.store_int(cells.first + i);
        const V high = strength * place.fraction[0], low = strength - high;
        const V right = place.fraction[1], left = V(1.0f) - right;
        (low * left).store(cells.weight[0] + i);
        (low * right).store(cells.weight[1] + i);
        (high * left).store(cells.weight[2] + i);
        (high * right).store(cells.weight[3] + i);
        (V(1.0f) - place.fraction[2]).store(cells.near + i);
        place.fraction[2].store(cells.far + i);
        return first;
    }

    // A large table lies in far caches: ask for its lines before they are needed.
    void prefetch(int g) const {
        const Table table = *one[g];
        for (int k = g * V::lanes; k < (g + 1) * V::lanes; ++k) ask_around(table, cells.first[k]);
    }

    static void ask_around(const Table& table, int first) {
        const float* p = table.values + 3L * first;
        ask_for(p);
        ask_for(p + table.row);
        ask_for(p + table.slab);
        ask_for(p + table.slab + table.row);
    }

    // The tables at every pixel that reads them.
    void read() {
        for (int g = 0; g < groups; ++g) read(g, lit[g]);
    }

    void read(int g, unsigned lanes) {
        if (lanes == 0) return;
        const V any = 0.0f;
        if (one[g]) {
            const Table table = *one[g];
            each_lane(g, lanes, [&](int k) { fetch(any, cells, k, table, rgb + 4 * k); });
        } else {
            each_lane(g, lanes, [&](int k) {
                fetch(any, cells, k, tables[tile.table_of[k]], rgb + 4 * k);
            });
        }
    }

    // Where most lanes read, reading all is cheaper than asking.
    template <class Read>
    static void each_lane(int g, unsigned lanes, const Read& read_one) {
        const int i = g * V::lanes;
        if (count_of(lanes) > V::lanes / 2)
            for (int k = i; k < i + V::lanes; ++k) read_one(k);
        else
            for (unsigned left = lanes; left != 0; left &= left - 1) read_one(i + lowest(left));
    }

    // The three channels of one vector of pixels; 0 in other lanes.
    void collect(int g, unsigned lanes, V out[3]) const {
        planes(rgb + 4 * g * V::lanes, out[0], out[1], out[2]);
        if (lanes != all_lanes(out[0])) {
            const auto kept = lanes_in(lanes, out[0]);
            for (int c = 0; c < 3; ++c) out[c] = select(kept, out[c], 0.0f);
        }
    }
};

}  // namespace raden
