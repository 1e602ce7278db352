// What one call works on: plain pointers and numbers, no Python and no torch.
#pragma once
#include <cstdint>

namespace raden {

// Of a map [B, C, H, W]; they count elements, 0 where the map is broadcast.
struct Strides {
    long batch = 0, channel = 0, row = 0, column = 0;
};

struct Map : Strides {
    const float* data = nullptr;
};

// Which table a pixel reads: bytes, or 64-bit integers.
struct Index : Strides {
    const void* data = nullptr;
    bool wide = false;
};

// f_r at the nodes of the runtime form, [U, V, W, 3] in one piece (runtime_table.py). One of several
// may be without values: its pixels are not shaded.
struct Table {
    const float* values = nullptr;
    float last[3] = {0, 0, 0};  // nodes of each axis less one
    float count[2] = {0, 0};    // nodes of the second and third axis
    float warp[2] = {1, 1};     // c and k/2
    bool large = false;         // does not stay in the near caches
    long row = 0, slab = 0;     // floats from one node of the second, or first, axis to the next
};

static inline bool same_layout(const Table& a, const Table& b) {
    for (int k = 0; k < 3; ++k)
        if (a.last[k] != b.last[k]) return false;
    return a.warp[0] == b.warp[0] && a.warp[1] == b.warp[1];
}

enum LightKind { directional = 0, point = 1, spot = 2 };

// As Python packs it: one row of floats per light and image.
struct Light {
    float kind;
    float at[3];         // unit direction to the light, or its position
    float radiated[3];   // irradiance, or intensity
    float axis[3];       // of a spot
    float outer, inner;  // cosines
    // the largest radiance it can cause, at distance 1 or at any, over what a pixel may lose
    float reach;
};

// Radiance over the normals of a hemisphere around the viewer, [side, side, 3]: for lights and a
// viewer at infinity. `frame` holds two axes across and the direction to the viewer.
struct LitSphere {
    const float* values = nullptr;
    int side = 0;
    float frame[9] = {0, 0, 0, 0, 0, 0, 0, 0, 0};
};

// Radiance over mirror directions, [count, count, side, side, 3]: an octahedral map for each view of
// a grid (mirror_table.py). `axes` holds two across and the middle view.
struct MirrorTable {
    const float* values = nullptr;
    int side = 0, count = 0;
    float axes[9] = {0, 0, 0, 0, 0, 0, 0, 0, 0};
    float low[2] = {0, 0}, step[2] = {0, 0};  // of the views, along the axes across
    float rim = 0;                            // N·V below which R is turned with V
};

// A table for each azimuth of the sample (materials/anisotropic.py), one after the other; all have the
// layout of `Scene::table`, which is the first.
struct Turned {
    Map tangent;
    const float* azimuths = nullptr;  // rising, 0 … period, in radians
    const float* inverse = nullptr;   // 1 over the angle from each to the next
    float even = 0.0f;                // it, where all are the same, else 0
    int count = 0;
    float period = 0.0f;
    float nodes = 0.0f;  // of one table
};

constexpr int node_floats = 16;  // of a table with errors

// Standard deviations of the image, beside it (errors.h), where there are values: [U, V, W, 16], by
// the layout of `Scene::table`, whose own values are not read. A node has f_r, the standard deviation
// of its own error, and its changes by one standard deviation of up to three errors that all nodes
// share, of three channels each.
struct Errors {
    const float* values = nullptr;
    float *own = nullptr, *systematic = nullptr;  // [B, 3, H, W] in one piece
    float scale = 0.0f;                           // relative, of all nodes together
    const std::uint8_t* ends = nullptr;  // of each light: the next one's own errors are others
};

struct Scene {
    long batch = 0, rows = 0, columns = 0;
    Map normal, light, view, position, mask;  // without data where the scene has none
    Map layers;   // normals of film layers that lean against the surface
    Map camera;                               // [B, 3]; the view is camera − position where given
    bool lit = false;                         // by lights; else f_r itself, with `light` as a map
    LitSphere sphere;                         // instead of lights, where it has values
    MirrorTable mirror;                       // the same
    Turned turned;                            // where there is a tangent
    Errors errors;
    const Light* lights = nullptr;            // [lights, batch]
    int light_count = 0;
    bool bounded = false;  // by the tiles' positions: some light has an end
    Table table;
    const Table* tables = nullptr;  // several, of which `index` chooses or `weights` mix
    int table_count = 0;
    bool all_tables = true;  // have values
    Index index;
    // [B, tables, H, W] of at most `most_weights` tables, or one less: the last has the rest to 1
    Map weights;
    int weight_count = 0;  // channels of it
    float* image = nullptr;  // [B, 3, H, W] in one piece
    bool stream = false;     // write past the caches
};

constexpr int tile_pixels = 64;
constexpr int most_weights = 32;

// Where a tile's pixels lie in the table: first node and the weights of the nodes around it.
struct Cells {
    alignas(64) int first[tile_pixels];
    alignas(64) float weight[4][tile_pixels];  // (u, v), (u, v + 1), (u + 1, v), (u + 1, v + 1)
    alignas(64) float near[tile_pixels], far[tile_pixels];  // w, w + 1
};

static inline long tiles_per_row(const Scene& s) { return (s.columns + tile_pixels - 1) / tile_pixels; }
static inline long tile_count(const Scene& s) { return s.batch * s.rows * tiles_per_row(s); }

// What the backward pass wants of a scene that is not lit: maps [B, 3, H, W] in one piece, or null.
struct Gradient {
    Map image;  // of the loss by f_r
    float *normal = nullptr, *light = nullptr, *view = nullptr;
};

constexpr int sum_floats = 4;  // of a node's sums: three channels and one that stays 0

// A run of tiles with sums of its own, so that no two threads add to the same number.
struct Slice {
    long first_tile = 0, last_tile = 0;
    float* table = nullptr;  // [U, V, W, sum_floats], or null
};

// What one vector of pixels asks of the nodes around each: the gradient of its colour, and where
// it lies between the nodes along u, v and w.
struct Visit {
    alignas(64) float change[3][16], at[3][16];
};

// One per instruction set; the same template, compiled with other flags.
using ShadeTiles = void (*)(const Scene&, long first_tile, long last_tile);
void shade_tiles_portable(const Scene&, long first_tile, long last_tile);
void shade_tiles_avx2(const Scene&, long first_tile, long last_tile);
void shade_tiles_avx512(const Scene&, long first_tile, long last_tile);
using DifferentiateTiles = void (*)(const Scene&, const Gradient&, const Slice&);
void differentiate_tiles_portable(const Scene&, const Gradient&, const Slice&);
void differentiate_tiles_avx2(const Scene&, const Gradient&, const Slice&);
void differentiate_tiles_avx512(const Scene&, const Gradient&, const Slice&);

}  // namespace raden
