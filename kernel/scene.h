// What one call works on: plain pointers and numbers, no Python and no torch.
#pragma once

namespace raden {

// A map [B, C, H, W] of floats; strides count floats, 0 where the map is broadcast.
struct Map {
    const float* data = nullptr;
    long batch = 0, channel = 0, row = 0, column = 0;
};

// f_r on a grid, [A, R, T, 3] in one piece; cell = radians · per_radian + offset.
struct Table {
    const float* values = nullptr;
    float nodes[3] = {0, 0, 0};
    // a baked table: axis 1 is r − a, and cell i of an axis begins at node start[i] and has
    // pieces[i] of them, both in whole blocks; `box` counts the measured cells along a, r, t
    const float *start[3] = {nullptr, nullptr, nullptr}, *pieces[3] = {nullptr, nullptr, nullptr};
    int blocks[3] = {0, 0, 0};
    float box[3] = {0, 0, 0}, last_cell[3] = {0, 0, 0};
    bool large = false;      // does not stay in the near caches
    long row = 0, slab = 0;  // floats from one receiving, or incidence, to the next
    float per_radian[3] = {0, 0, 0}, offset[3] = {0, 0, 0};
};

// Eq. (2): I_d · diffuse + I_s · specular, with eqs (3)–(6) as `scale` and `exponent`.
struct Model {
    Table table;
    bool has_diffuse = false;
    float scale[3] = {0, 0, 0}, exponent[3] = {1, 1, 1};
    float diffuse_gain = 1, specular_gain = 1;
};

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

struct Scene {
    long batch = 0, rows = 0, columns = 0;
    Map normal, light, view, position, mask;  // without data where the scene has none
    Map camera;                               // [B, 3]; the view is camera − position where given
    bool lit = false;                         // by lights; else f_r itself, with `light` as a map
    LitSphere sphere;                         // instead of lights, where it has values
    const Light* lights = nullptr;            // [lights, batch]
    int light_count = 0;
    bool bounded = false;  // by the tiles' positions: some light has an end
    Model model;
    float* image = nullptr;  // [B, 3, H, W] in one piece
    bool stream = false;     // write past the caches
};

constexpr int block_cells = 32;  // of a baked table's axis, looked up at once
constexpr int tile_pixels = 64;

// Where a tile's pixels lie in the table: first node and the weights of the nodes around it.
struct Cells {
    alignas(64) int first[tile_pixels];
    alignas(64) float weight[4][tile_pixels];  // (a, r), (a, r + 1), (a + 1, r), (a + 1, r + 1)
    alignas(64) float near[tile_pixels], far[tile_pixels];  // t, t + 1
};

static inline long tiles_per_row(const Scene& s) { return (s.columns + tile_pixels - 1) / tile_pixels; }
static inline long tile_count(const Scene& s) { return s.batch * s.rows * tiles_per_row(s); }

// What the backward pass wants of a scene that is not lit: maps [B, 3, H, W] in one piece, or null.
struct Gradient {
    Map image;  // of the loss by f_r
    float *normal = nullptr, *light = nullptr, *view = nullptr;
};

// A run of tiles with sums of its own, so that no two threads add to the same number.
struct Slice {
    long first_tile = 0, last_tile = 0;
    float* table = nullptr;   // like the table, or null
    double* body = nullptr;   // scale and exponent of the three channels
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
