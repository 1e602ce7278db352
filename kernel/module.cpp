// The Python side: addresses, shapes and numbers in, an image written in place.
#include <nanobind/nanobind.h>
#include <nanobind/stl/array.h>
#include <nanobind/stl/optional.h>
#include <nanobind/stl/string.h>
#include <nanobind/stl/tuple.h>
#include <nanobind/stl/vector.h>

#include <algorithm>
#include <array>
#include <cfloat>
#include <cmath>
#include <optional>
#include <string>
#include <tuple>
#include <vector>

#include "pool.h"
#include "scene.h"

namespace nb = nanobind;
using raden::Map;
using raden::Scene;

namespace {

// (address, strides of batch, channel, row, column), counted in floats
using MapOf = std::array<std::int64_t, 5>;

constexpr long piece = 32;            // tiles that a thread takes at once: 2048 pixels
constexpr long caches = 512 * 1024;   // pixels; a larger image would push everything else out

constexpr long near_caches = 128 * 1024;  // floats of a table

Map as_map(const std::optional<MapOf>& m) {
    if (!m) return {};
    const auto& [address, batch, channel, row, column] = *m;
    return {{batch, channel, row, column}, reinterpret_cast<const float*>(address)};
}

// (address, 1 or 8 bytes, strides of batch, row, column)
using IndexOf = std::array<std::int64_t, 5>;

raden::Index as_index(const std::optional<IndexOf>& m) {
    if (!m) return {};
    const auto& [address, bytes, batch, row, column] = *m;
    return {{batch, 0, row, column}, reinterpret_cast<const void*>(address), bytes == 8};
}

raden::DifferentiateTiles gradient_of([[maybe_unused]] const std::string& level) {
#ifdef RADEN_X86
    if (level == "avx512") return raden::differentiate_tiles_avx512;
    if (level == "avx2") return raden::differentiate_tiles_avx2;
#endif
    return raden::differentiate_tiles_portable;
}

raden::ShadeTiles tiles_of([[maybe_unused]] const std::string& level) {
#ifdef RADEN_X86
    if (level == "avx512") return raden::shade_tiles_avx512;
    if (level == "avx2") return raden::shade_tiles_avx2;
#endif
    return raden::shade_tiles_portable;
}

std::vector<std::string> levels() {
    std::vector<std::string> found{"portable"};
#ifdef RADEN_X86
    __builtin_cpu_init();
    const bool avx2 = __builtin_cpu_supports("avx2") && __builtin_cpu_supports("fma");
    if (avx2) found.push_back("avx2");
    if (avx2 && __builtin_cpu_supports("avx512f") && __builtin_cpu_supports("avx512dq") &&
        __builtin_cpu_supports("avx512bw") && __builtin_cpu_supports("avx512vl"))
        found.push_back("avx512");
#endif
    return found;
}

// Rows that follow each other without a gap in every map are one long row, and so is one column.
void join_rows(Scene& s, Map& further) {
    std::vector<raden::Strides*> maps;
    for (Map* m : {&s.normal, &s.layers, &s.light, &s.view, &s.position, &s.mask, &s.weights,
                   &s.turned.tangent, &further})
        if (m->data) maps.push_back(m);
    if (s.index.data) maps.push_back(&s.index);
    if (s.columns == 1)
        for (raden::Strides* m : maps) m->column = m->row;
    for (const raden::Strides* m : maps)
        if (m->row != m->column * s.columns) return;
    s.columns *= s.rows;
    s.rows = 1;
}

// The runtime form, as Python gives it: (address of [U, V, W, 3], U, V, W), and c and k.
using TableOf = std::array<std::int64_t, 4>;
using WarpOf = std::array<float, 2>;

raden::Table as_table(const TableOf& from, const WarpOf& warp) {
    raden::Table t;
    t.values = reinterpret_cast<const float*>(from[0]);
    for (int k = 0; k < 3; ++k) t.last[k] = static_cast<float>(from[k + 1] - 1);
    t.count[0] = static_cast<float>(from[2]), t.count[1] = static_cast<float>(from[3]);
    t.warp[0] = warp[0], t.warp[1] = warp[1] / 2;
    t.row = 3 * from[3];
    t.slab = t.row * from[2];
    t.large = t.slab * from[1] > near_caches;
    return t;
}

// Several; one at address 0 is none. Together they are large sooner.
std::vector<raden::Table> as_tables(const std::vector<TableOf>& from, const std::vector<WarpOf>& warps) {
    std::vector<raden::Table> tables;
    long floats = 0;
    for (std::size_t k = 0; k < from.size(); ++k) {
        tables.push_back(as_table(from[k], warps[k]));
        floats += tables[k].slab * from[k][1];
    }
    for (raden::Table& t : tables) t.large = floats > near_caches;
    return tables;
}

// The table with errors, the images of own and systematic standard deviations, the scale's; and of
// each light whether the next one's own errors are others.
using ErrorsOf = std::tuple<std::int64_t, std::int64_t, std::int64_t, float, std::vector<std::uint8_t>>;

void set_errors(Scene& scene, const ErrorsOf& from) {
    scene.errors.values = reinterpret_cast<const float*>(std::get<0>(from));
    scene.errors.own = reinterpret_cast<float*>(std::get<1>(from));
    scene.errors.systematic = reinterpret_cast<float*>(std::get<2>(from));
    scene.errors.scale = std::get<3>(from);
    scene.errors.ends = std::get<4>(from).data();
    scene.table = *scene.tables;
}

void run(Scene& scene, const std::string& level, int threads) {
    if (!scene.tables) scene.tables = &scene.table, scene.table_count = 1;
    Map none;
    join_rows(scene, none);
    scene.stream = scene.batch * scene.rows * scene.columns > caches;
    const auto tiles = tiles_of(level);
    const long count = raden::tile_count(scene);
    // waking a thread takes longer than a few pieces
    raden::share_out(count, piece, static_cast<int>(std::min<long>(threads, count / (4 * piece))),
                     [&](long first, long last) { tiles(scene, first, last); });
}

// 1 over the angle from each azimuth to the next.
std::vector<float> inverse_gaps(const std::vector<float>& azimuths, float period) {
    std::vector<float> found;
    for (std::size_t k = 0; k < azimuths.size(); ++k) {
        const bool last = k + 1 == azimuths.size();
        found.push_back(1 / ((last ? azimuths[0] + period : azimuths[k + 1]) - azimuths[k]));
    }
    return found;
}

// Slice k of the tiles adds to sums[k]: the same bits whichever thread takes it.
void differentiate(Scene& scene, raden::Gradient& wanted, float* sums, int slices,
                   const std::string& level) {
    join_rows(scene, wanted.image);
    const auto tiles = gradient_of(level);
    const long count = raden::tile_count(scene);
    scene.stream = scene.batch * scene.rows * scene.columns > caches;
    const long floats =
        raden::sum_floats * (scene.table.slab / 3) * (static_cast<long>(scene.table.last[0]) + 1);
    raden::share_out(slices, 1, slices, [&](long first, long last) {
        for (long k = first; k < last; ++k)
            tiles(scene, wanted,
                  {count * k / slices, count * (k + 1) / slices, sums ? sums + k * floats : nullptr});
    });
}

}  // namespace

NB_MODULE(_kernel, m) {
    // OpenImageIO, another module made by nanobind, leaves objects at exit; it would tell every user
    nb::set_leak_warnings(false);
    m.doc() = "The fused evaluation of a raden model; see raden_torch/brdf/model/kernel.py.";
    m.def("levels", &levels, "Instruction sets that this machine has, the fastest last.");
    m.def(
        "reflect",
        [](TableOf table, WarpOf warp, MapOf normal, MapOf light, MapOf view,
           std::array<std::int64_t, 3> size, std::int64_t image, const std::string& level,
           int threads) {
            Scene s;
            s.table = as_table(table, warp);
            s.batch = size[0], s.rows = size[1], s.columns = size[2];
            s.normal = as_map(normal), s.light = as_map(light), s.view = as_map(view);
            s.image = reinterpret_cast<float*>(image);
            nb::gil_scoped_release released;
            run(s, level, threads);
        },
        "f_r of three maps into an image [B, 3, H, W].");
    m.def(
        "look_up",
        [](MapOf normal, std::optional<MapOf> mask, std::int64_t values, int side,
           std::array<float, 9> frame, std::array<std::int64_t, 3> size, std::int64_t image,
           const std::string& level, int threads) {
            Scene s;
            s.batch = size[0], s.rows = size[1], s.columns = size[2];
            s.normal = as_map(normal), s.mask = as_map(mask);
            s.sphere.values = reinterpret_cast<const float*>(values);
            s.sphere.side = side;
            std::copy(frame.begin(), frame.end(), s.sphere.frame);
            s.table.values = s.sphere.values;
            s.table.row = 3L * side;  // and no slabs: `fetch` reads its two rows twice
            s.image = reinterpret_cast<float*>(image);
            nb::gil_scoped_release released;
            run(s, level, threads);
        },
        nb::arg("normal"), nb::arg("mask").none(), nb::arg("values"), nb::arg("side"),
        nb::arg("frame"), nb::arg("size"), nb::arg("image"), nb::arg("level"), nb::arg("threads"),
        "Radiance of a lit sphere [side, side, 3] at each normal into an image [B, 3, H, W].");
    m.def(
        "look_up_mirror",
        [](MapOf normal, std::optional<MapOf> view, std::optional<MapOf> position,
           std::optional<MapOf> camera, std::optional<MapOf> mask, std::int64_t values,
           std::array<int, 2> nodes, std::array<float, 14> grid, std::array<std::int64_t, 3> size,
           std::int64_t image, const std::string& level, int threads) {
            Scene s;
            s.batch = size[0], s.rows = size[1], s.columns = size[2];
            s.normal = as_map(normal), s.view = as_map(view), s.position = as_map(position);
            s.camera = as_map(camera), s.mask = as_map(mask);
            s.mirror.values = reinterpret_cast<const float*>(values);
            s.mirror.count = nodes[0], s.mirror.side = nodes[1];
            std::copy(grid.begin(), grid.begin() + 9, s.mirror.axes);
            for (int k = 0; k < 2; ++k) s.mirror.low[k] = grid[9 + k], s.mirror.step[k] = grid[11 + k];
            s.mirror.rim = grid[13];
            s.table.values = s.mirror.values;
            s.table.row = 3L * nodes[1];  // and no slabs, as for `look_up`
            s.image = reinterpret_cast<float*>(image);
            nb::gil_scoped_release released;
            run(s, level, threads);
        },
        nb::arg("normal"), nb::arg("view").none(), nb::arg("position").none(),
        nb::arg("camera").none(), nb::arg("mask").none(), nb::arg("values"), nb::arg("nodes"),
        nb::arg("grid"), nb::arg("size"), nb::arg("image"), nb::arg("level"), nb::arg("threads"),
        "Radiance of a table [count, count, side, side, 3] over views and mirror directions into an "
        "image [B, 3, H, W]; NaN where a node that is NaN is read.");
    m.def(
        "differentiate",
        [](TableOf table, WarpOf warp, MapOf normal, MapOf light, MapOf view, MapOf gradient,
           std::array<std::int64_t, 3> size, std::array<std::int64_t, 3> maps, std::int64_t sums,
           int slices, const std::string& level) {
            Scene s;
            s.table = as_table(table, warp);
            s.batch = size[0], s.rows = size[1], s.columns = size[2];
            s.normal = as_map(normal), s.light = as_map(light), s.view = as_map(view);
            raden::Gradient wanted;
            wanted.image = as_map(gradient);
            wanted.normal = reinterpret_cast<float*>(maps[0]);
            wanted.light = reinterpret_cast<float*>(maps[1]);
            wanted.view = reinterpret_cast<float*>(maps[2]);
            nb::gil_scoped_release released;
            differentiate(s, wanted, reinterpret_cast<float*>(sums), slices, level);
        },
        "The gradient of `reflect`: into maps [B, 3, H, W] (0 for none), and added to one table "
        "[U, V, W, 4] (0 for none; the last channel stays 0) for each slice of the pixels.");
    m.def(
        "shade",
        [](const std::vector<TableOf>& tables, const std::vector<WarpOf>& warps, MapOf normal,
           std::optional<MapOf> layers, std::optional<MapOf> view, std::optional<MapOf> position,
           std::optional<MapOf> camera, std::optional<MapOf> mask, std::optional<IndexOf> index,
           std::optional<MapOf> weights, int weight_count, std::int64_t lights, int light_count,
           std::array<std::int64_t, 3> size, std::int64_t image, std::optional<ErrorsOf> errors,
           const std::string& level, int threads) {
            Scene s;
            const std::vector<raden::Table> several = as_tables(tables, warps);
            s.tables = several.data(), s.table_count = static_cast<int>(several.size());
            for (const raden::Table& t : several) s.all_tables &= t.values != nullptr;
            s.index = as_index(index), s.weights = as_map(weights), s.weight_count = weight_count;
            s.batch = size[0], s.rows = size[1], s.columns = size[2];
            s.normal = as_map(normal), s.layers = as_map(layers), s.view = as_map(view);
            s.position = as_map(position);
            s.camera = as_map(camera), s.mask = as_map(mask);
            s.lights = reinterpret_cast<const raden::Light*>(lights);
            s.lit = true;
            s.light_count = light_count;
            for (long k = 0; k < light_count * s.batch; ++k) {
                const raden::Light& light = s.lights[k];
                s.bounded |= light.kind == raden::spot ||
                             (light.kind == raden::point && light.reach < FLT_MAX);
            }
            s.image = reinterpret_cast<float*>(image);
            if (errors) set_errors(s, *errors);
            nb::gil_scoped_release released;
            run(s, level, threads);
        },
        nb::arg("tables"), nb::arg("warps"), nb::arg("normal"), nb::arg("layers").none(),
        nb::arg("view").none(), nb::arg("position").none(), nb::arg("camera").none(),
        nb::arg("mask").none(), nb::arg("index").none(), nb::arg("weights").none(),
        nb::arg("weight_count"), nb::arg("lights"), nb::arg("light_count"), nb::arg("size"),
        nb::arg("image"), nb::arg("errors").none(), nb::arg("level"), nb::arg("threads"),
        "Radiance of a G-buffer under lights into an image [B, 3, H, W]: of one table; of several by "
        "an index or by weights; or of one with those of its errors (errors.h).");
    m.def(
        "shade_turned",
        [](TableOf table, WarpOf warp, const std::vector<float>& azimuths, float period, MapOf tangent,
           MapOf normal, std::optional<MapOf> layers, std::optional<MapOf> view,
           std::optional<MapOf> position, std::optional<MapOf> camera, std::optional<MapOf> mask,
           std::int64_t lights, int light_count, std::array<std::int64_t, 3> size,
           std::int64_t image, const std::string& level, int threads) {
            Scene s;
            s.table = as_table(table, warp);
            s.table.large = true;  // all of them together
            s.batch = size[0], s.rows = size[1], s.columns = size[2];
            s.normal = as_map(normal), s.layers = as_map(layers), s.view = as_map(view);
            s.position = as_map(position), s.camera = as_map(camera), s.mask = as_map(mask);
            s.lights = reinterpret_cast<const raden::Light*>(lights);
            s.lit = true;
            s.light_count = light_count;
            s.image = reinterpret_cast<float*>(image);
            raden::Turned& turned = s.turned;
            turned.tangent = as_map(tangent);
            turned.azimuths = azimuths.data();
            turned.count = static_cast<int>(azimuths.size());
            turned.period = period;
            const std::vector<float> inverse = inverse_gaps(azimuths, period);
            turned.inverse = inverse.data();
            const auto [most, least] = std::minmax_element(inverse.begin(), inverse.end());
            turned.even = *least - *most < 1e-5f * *most ? *most : 0.0f;
            turned.nodes = static_cast<float>(table[1] * table[2] * table[3]);
            nb::gil_scoped_release released;
            run(s, level, threads);
        },
        nb::arg("table"), nb::arg("warp"), nb::arg("azimuths"), nb::arg("period"),
        nb::arg("tangent"), nb::arg("normal"), nb::arg("layers").none(), nb::arg("view").none(),
        nb::arg("position").none(), nb::arg("camera").none(), nb::arg("mask").none(),
        nb::arg("lights"), nb::arg("light_count"), nb::arg("size"), nb::arg("image"),
        nb::arg("level"), nb::arg("threads"),
        "Radiance of a G-buffer with tangents under lights into an image [B, 3, H, W]: of tables "
        "[K, U, V, W, 3] in one piece, one for each azimuth.");
}
