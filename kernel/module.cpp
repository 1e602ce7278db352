// The Python side: addresses, shapes and numbers in, an image written in place.
#include <nanobind/nanobind.h>
#include <nanobind/stl/array.h>
#include <nanobind/stl/optional.h>
#include <nanobind/stl/string.h>
#include <nanobind/stl/vector.h>

#include <algorithm>
#include <array>
#include <cfloat>
#include <cmath>
#include <optional>
#include <string>
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
    return {reinterpret_cast<const float*>(address), batch, channel, row, column};
}

raden::DifferentiateTiles gradient_of(const std::string& level) {
#ifdef RADEN_X86
    if (level == "avx512") return raden::differentiate_tiles_avx512;
    if (level == "avx2") return raden::differentiate_tiles_avx2;
#endif
    return raden::differentiate_tiles_portable;
}

raden::ShadeTiles tiles_of(const std::string& level) {
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
    Map* const maps[] = {&s.normal, &s.light, &s.view, &s.position, &s.mask, &further};
    if (s.columns == 1)
        for (Map* m : maps) m->column = m->row;
    for (const Map* m : maps)
        if (m->data && m->row != m->column * s.columns) return;
    s.columns *= s.rows;
    s.rows = 1;
}

struct ModelOf {
    std::int64_t table = 0;  // address, 0 for none
    std::array<int, 3> nodes{};
    std::vector<std::int64_t> cuts;  // addresses of (start, pieces) by cell, of a baked table
    std::vector<int> cells;
    std::array<std::vector<float>, 3> start, pieces;  // the same, apart and in whole blocks
    std::array<double, 3> first_deg{}, step_deg{};
    bool has_diffuse = false;
    std::array<float, 3> scale{}, exponent{};
    float diffuse_gain = 1, specular_gain = 1;
};

// The kernel keeps pointers into `from`, which has to live as long as the model.
raden::Model as_model(ModelOf& from) {
    raden::Model m;
    m.table.values = reinterpret_cast<const float*>(from.table);
    for (int k = 0; k < 3; ++k) {
        m.table.nodes[k] = static_cast<float>(from.nodes[k]);
        m.table.per_radian[k] = static_cast<float>(180 / M_PI / from.step_deg[k]);
        m.table.offset[k] = static_cast<float>(-from.first_deg[k] / from.step_deg[k]);
        m.table.box[k] = m.table.nodes[k] - 1;
        if (from.cuts.size() == 3) {
            const auto* cuts = reinterpret_cast<const float*>(from.cuts[k]);
            m.table.blocks[k] = (from.cells[k] + raden::block_cells - 1) / raden::block_cells;
            const std::size_t padded = m.table.blocks[k] * raden::block_cells;
            from.start[k].assign(padded, 0.0f);
            from.pieces[k].assign(padded, 1.0f);
            for (int i = 0; i < from.cells[k]; ++i) {
                from.start[k][i] = cuts[2 * i];
                from.pieces[k][i] = cuts[2 * i + 1];
            }
            m.table.start[k] = from.start[k].data();
            m.table.pieces[k] = from.pieces[k].data();
            m.table.last_cell[k] = static_cast<float>(from.cells[k] - 1);
            const int beside = k == 1 ? from.cells[0] : 0;  // r − a spans the cells of both
            m.table.box[k] = static_cast<float>(from.cells[k] - beside);
        }
        m.scale[k] = from.scale[k];
        m.exponent[k] = from.exponent[k];
    }
    m.table.row = 3L * from.nodes[2];
    m.table.slab = m.table.row * from.nodes[1];
    m.table.large = m.table.slab * from.nodes[0] > near_caches;
    m.has_diffuse = from.has_diffuse;
    m.diffuse_gain = from.diffuse_gain;
    m.specular_gain = from.specular_gain;
    return m;
}

void run(Scene& scene, const std::string& level, int threads) {
    Map none;
    join_rows(scene, none);
    scene.stream = scene.batch * scene.rows * scene.columns > caches;
    const auto tiles = tiles_of(level);
    const long count = raden::tile_count(scene);
    // waking a thread takes longer than a few pieces
    raden::share_out(count, piece, static_cast<int>(std::min<long>(threads, count / (4 * piece))),
                     [&](long first, long last) { tiles(scene, first, last); });
}

// Slice k of the tiles adds to sums[k] and body[k]: the same bits whichever thread takes it.
void differentiate(Scene& scene, raden::Gradient& wanted, float* sums, double* body, int slices,
                   const std::string& level) {
    join_rows(scene, wanted.image);
    const auto tiles = gradient_of(level);
    const long count = raden::tile_count(scene);
    const long floats = scene.model.table.slab * static_cast<long>(scene.model.table.nodes[0]);
    raden::share_out(slices, 1, slices, [&](long first, long last) {
        for (long k = first; k < last; ++k)
            tiles(scene, wanted,
                  {count * k / slices, count * (k + 1) / slices, sums ? sums + k * floats : nullptr,
                   body + 6 * k});
    });
}

}  // namespace

NB_MODULE(_kernel, m) {
    m.doc() = "The fused evaluation of a raden model; see raden_torch/brdf/model/kernel.py.";
    m.def("levels", &levels, "Instruction sets that this machine has, the fastest last.");
    nb::class_<ModelOf>(m, "Model")
        .def(nb::init<>())
        .def_rw("table", &ModelOf::table)
        .def_rw("nodes", &ModelOf::nodes)
        .def_rw("cuts", &ModelOf::cuts)
        .def_rw("cells", &ModelOf::cells)
        .def_rw("first_deg", &ModelOf::first_deg)
        .def_rw("step_deg", &ModelOf::step_deg)
        .def_rw("has_diffuse", &ModelOf::has_diffuse)
        .def_rw("scale", &ModelOf::scale)
        .def_rw("exponent", &ModelOf::exponent)
        .def_rw("diffuse_gain", &ModelOf::diffuse_gain)
        .def_rw("specular_gain", &ModelOf::specular_gain);
    m.def(
        "reflect",
        [](ModelOf& model, MapOf normal, MapOf light, MapOf view,
           std::array<std::int64_t, 3> size, std::int64_t image, const std::string& level,
           int threads) {
            Scene s;
            s.model = as_model(model);
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
            s.model.table.values = s.sphere.values;
            s.model.table.row = 3L * side;  // and no slabs: `fetch` reads its two rows twice
            s.image = reinterpret_cast<float*>(image);
            nb::gil_scoped_release released;
            run(s, level, threads);
        },
        nb::arg("normal"), nb::arg("mask").none(), nb::arg("values"), nb::arg("side"),
        nb::arg("frame"), nb::arg("size"), nb::arg("image"), nb::arg("level"), nb::arg("threads"),
        "Radiance of a lit sphere [side, side, 3] at each normal into an image [B, 3, H, W].");
    m.def(
        "differentiate",
        [](ModelOf& model, MapOf normal, MapOf light, MapOf view, MapOf gradient,
           std::array<std::int64_t, 3> size, std::array<std::int64_t, 3> maps, std::int64_t table,
           std::int64_t body, int slices, const std::string& level) {
            Scene s;
            s.model = as_model(model);
            s.batch = size[0], s.rows = size[1], s.columns = size[2];
            s.normal = as_map(normal), s.light = as_map(light), s.view = as_map(view);
            raden::Gradient wanted;
            wanted.image = as_map(gradient);
            wanted.normal = reinterpret_cast<float*>(maps[0]);
            wanted.light = reinterpret_cast<float*>(maps[1]);
            wanted.view = reinterpret_cast<float*>(maps[2]);
            nb::gil_scoped_release released;
            differentiate(s, wanted, reinterpret_cast<float*>(table),
                          reinterpret_cast<double*>(body), slices, level);
        },
        "The gradient of `reflect`: into maps [B, 3, H, W] (0 for none), and into one table (or 0) "
        "and six sums for each slice of the pixels.");
    m.def(
        "shade",
        [](ModelOf& model, MapOf normal, std::optional<MapOf> view,
           std::optional<MapOf> position, std::optional<MapOf> camera, std::optional<MapOf> mask,
           std::int64_t lights, int light_count, std::array<std::int64_t, 3> size,
           std::int64_t image, const std::string& level, int threads) {
            Scene s;
            s.model = as_model(model);
            s.batch = size[0], s.rows = size[1], s.columns = size[2];
            s.normal = as_map(normal), s.view = as_map(view), s.position = as_map(position);
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
            nb::gil_scoped_release released;
            run(s, level, threads);
        },
        nb::arg("model"), nb::arg("normal"), nb::arg("view").none(), nb::arg("position").none(),
        nb::arg("camera").none(), nb::arg("mask").none(), nb::arg("lights"),
        nb::arg("light_count"), nb::arg("size"), nb::arg("image"), nb::arg("level"),
        nb::arg("threads"), "Radiance of a G-buffer under lights into an image [B, 3, H, W].");
}
