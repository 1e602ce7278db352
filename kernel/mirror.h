// A frame read from a table over the mirror direction and the view (mirror_table.py).
#pragma once
#include "shade.h"

namespace raden {

// Where one vector of pixels lies in the grid of views: the node below, and the fractions above it.
template <class V>
struct ViewPlace {
    V node[2], fraction[2];

    ViewPlace(const MirrorTable& m, const Vector3<V>& view) {
        for (int k = 0; k < 2; ++k) {
            const float* a = m.axes + 3 * k;
            const V flat = dot(view, Vector3<V>{a[0], a[1], a[2]});
            const V last = static_cast<float>(m.count - 1);
            const V at = m.count == 1 ? V(0.0f)
                                      : least(greatest((flat - m.low[k]) / m.step[k], 0.0f), last);
            node[k] = m.count == 1 ? V(0.0f) : least(floor_of(at), last - 1.0f);
            fraction[k] = at - node[k];
        }
    }
};

// A node's view.
template <class V>
Vector3<V> view_of(const MirrorTable& m, const V& x, const V& y) {
    const V a = fma(x, V(m.step[0]), V(m.low[0])), b = fma(y, V(m.step[1]), V(m.low[1]));
    const V c = root(greatest(V(1.0f) - fma(a, a, b * b), 0.0f));
    const float* e = m.axes;
    return unit(Vector3<V>{fma(c, V(e[6]), fma(b, V(e[3]), a * e[0])),
                           fma(c, V(e[7]), fma(b, V(e[4]), a * e[1])),
                           fma(c, V(e[8]), fma(b, V(e[5]), a * e[2]))});
}

// A vector by the shortest turn from one unit vector to another, not its opposite.
template <class V>
Vector3<V> turned(const Vector3<V>& vector, const Vector3<V>& start, const Vector3<V>& end) {
    const Vector3<V> axis = cross(start, end), beside = cross(axis, vector);
    const V cosine = dot(start, end), along = dot(axis, vector) / (V(1.0f) + cosine);
    return {fma(axis.x, along, fma(vector.x, cosine, beside.x)),
            fma(axis.y, along, fma(vector.y, cosine, beside.y)),
            fma(axis.z, along, fma(vector.z, cosine, beside.z))};
}

// Where a direction lies in an octahedral map of the sphere: cells, and weights times `strength`.
template <class V>
void place_in_map(Cells& cells, int i, const MirrorTable& m, const Vector3<V>& d, const V& node,
                  const V& strength) {
    const V last = static_cast<float>(m.side - 1);
    const V scale = V(1.0f) / greatest(magnitude(d.x) + magnitude(d.y) + magnitude(d.z), tiny);
    const V fold = greatest(V(0.0f) - d.z * scale, 0.0f);
    const auto axis = [&](const V& along) {
        const V at = along * scale;
        const V folded = at + select(at < 0.0f, V(0.0f) - fold, fold);
        return least(greatest(fma(folded, V(0.5f) * last, V(0.5f) * last), 0.0f), last);
    };
    const V across = axis(d.x), down = axis(d.y);
    const V column = least(floor_of(across), last - 1.0f), line = least(floor_of(down), last - 1.0f);
    const V row = fma(node, last + 1.0f, line);
    fma(row, last + 1.0f, column).store_int(cells.first + i);
    const V below = (down - line) * strength;
    (strength - below).store(cells.weight[0] + i);
    below.store(cells.weight[1] + i);
    V(0.0f).store(cells.weight[2] + i);
    V(0.0f).store(cells.weight[3] + i);
    (V(1.0f) - (across - column)).store(cells.near + i);
    (across - column).store(cells.far + i);
}

// One corner of the grid's cell that each pixel's view lies in.
template <class V>
void add_corner(ShadedTile<V>& tile, int right, int up) {
    const MirrorTable& m = tile.scene.mirror;
    for (int g = 0; g < ShadedTile<V>::groups; ++g) {
        tile.reader.lit[g] = 0;
        if (tile.seen[g] == 0) continue;
        const int i = g * V::lanes;
        const float *normals[3] = {tile.n[0], tile.n[1], tile.n[2]};
        const float *views[3] = {tile.v[0], tile.v[1], tile.v[2]};
        const Vector3<V> normal = tile.load(normals, i), view = tile.load(views, i);
        const ViewPlace<V> place(m, view);
        const V x = place.node[0] + static_cast<float>(right), y = place.node[1] + static_cast<float>(up);
        const V across = right ? place.fraction[0] : V(1.0f) - place.fraction[0];
        const V strength = across * (up ? place.fraction[1] : V(1.0f) - place.fraction[1]);
        const unsigned lanes = bits(V(0.0f) < strength) & tile.seen[g];
        if (lanes == 0) continue;
        const V cosine = V::load(tile.n_v + i), twice = cosine + cosine;
        Vector3<V> mirror = {fms(twice, normal.x, view.x), fms(twice, normal.y, view.y),
                             fms(twice, normal.z, view.z)};
        const auto rim = cosine < m.rim;
        if (m.count > 1 && (bits(rim) & lanes) != 0) {
            const Vector3<V> other = turned(mirror, view, view_of(m, x, y));
            mirror = {select(rim, other.x, mirror.x), select(rim, other.y, mirror.y),
                      select(rim, other.z, mirror.z)};
        }
        const V node = fma(y, V(static_cast<float>(m.count)), x);
        place_in_map(tile.cells, i, m, mirror, node, strength);
        tile.reader.lit[g] = lanes;
    }
    tile.reader.read();
    for (int g = 0; g < ShadedTile<V>::groups; ++g) {
        if (tile.reader.lit[g] == 0) continue;
        V out[3];
        tile.reader.collect(g, tile.reader.lit[g], out);
        for (int c = 0; c < 3; ++c) {
            float* here = tile.sum[c] + g * V::lanes;
            (V::load(here) + out[c]).store(here);
        }
    }
}

// NaN where a node that is missing in the table is read; 0 where the surface is not seen.
template <class V>
void look_up_mirror(ShadedTile<V>& tile) {
    if (tile.count == 0) return tile.clear();
    tile.see();
    tile.reader.all_read(0);
    const int corners = tile.scene.mirror.count == 1 ? 1 : 2;
    for (int up = 0; up < corners; ++up)
        for (int right = 0; right < corners; ++right) add_corner(tile, right, up);
    for (int g = 0; g < ShadedTile<V>::groups; ++g) {
        V out[3];
        for (int c = 0; c < 3; ++c) {
            out[c] = V::load(tile.sum[c] + g * V::lanes);
            if (tile.scene.mask.data) out[c] = out[c] * V::load(tile.masked + g * V::lanes);
        }
        tile.put(g, out);
    }
    tile.spread();
}

}  // namespace raden
