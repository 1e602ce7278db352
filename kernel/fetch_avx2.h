// One pixel's eight table nodes with 32-byte loads: two neighbours along w are six floats in a row.
#pragma once
#include <immintrin.h>

#include "scene.h"

namespace raden {
namespace {

inline void fetch_avx2(const Cells& cells, int i, const Table& table, float* rgb) {
    const float* p = table.values + 3L * cells.first[i];
    const float* q = p + table.slab;
    // the last load is masked: it would reach two floats beyond the end of the table
    const __m256i six = _mm256_setr_epi32(-1, -1, -1, -1, -1, -1, 0, 0);
    const __m256 last = _mm256_maskload_ps(q + table.row, six);
    __m256 sum = _mm256_mul_ps(_mm256_broadcast_ss(&cells.weight[3][i]), last);
    sum = _mm256_fmadd_ps(_mm256_broadcast_ss(&cells.weight[2][i]), _mm256_loadu_ps(q), sum);
    __m256 more = _mm256_mul_ps(_mm256_broadcast_ss(&cells.weight[0][i]), _mm256_loadu_ps(p));
    more = _mm256_fmadd_ps(_mm256_broadcast_ss(&cells.weight[1][i]),
                           _mm256_loadu_ps(p + table.row), more);
    sum = _mm256_add_ps(sum, more);
    const __m256i second = _mm256_setr_epi32(3, 4, 5, 6, 7, 7, 7, 7);
    const __m128 far = _mm256_castps256_ps128(_mm256_permutevar8x32_ps(sum, second));
    const __m128 near = _mm_mul_ps(_mm_broadcast_ss(&cells.near[i]), _mm256_castps256_ps128(sum));
    _mm_store_ps(rgb, _mm_fmadd_ps(_mm_broadcast_ss(&cells.far[i]), far, near));
}

// `slopes_at` of vector_portable.h, six floats at once.
inline void slopes_avx2(const Table& table, long node, const Visit& visit, int i, float* const slopes[3]) {
    const __m256i six = _mm256_setr_epi32(-1, -1, -1, -1, -1, -1, 0, 0);
    const float* p = table.values + 3 * node;
    const float* q = p + table.slab;
    const __m256 a = _mm256_loadu_ps(p), b = _mm256_loadu_ps(p + table.row);
    const __m256 c = _mm256_loadu_ps(q), d = _mm256_maskload_ps(q + table.row, six);
    const __m256 x = _mm256_broadcast_ss(&visit.at[0][i]), y = _mm256_broadcast_ss(&visit.at[1][i]);
    const __m128 z = _mm_broadcast_ss(&visit.at[2][i]);
    const __m256 low = _mm256_sub_ps(b, a), high = _mm256_sub_ps(d, c);
    const __m256 from = _mm256_fmadd_ps(y, low, a);
    const __m256 by_u = _mm256_sub_ps(_mm256_fmadd_ps(y, high, c), from);
    const __m256 by_v = _mm256_fmadd_ps(x, _mm256_sub_ps(high, low), low);
    const __m256 here = _mm256_fmadd_ps(x, by_u, from);
    const __m256i second = _mm256_setr_epi32(3, 4, 5, 6, 7, 7, 7, 7);
    const auto step = [second](__m256 v) {  // from one neighbour along w to the other
        const __m128 far = _mm256_castps256_ps128(_mm256_permutevar8x32_ps(v, second));
        return _mm_sub_ps(far, _mm256_castps256_ps128(v));
    };
    _mm_store_ps(slopes[0], _mm_fmadd_ps(z, step(by_u), _mm256_castps256_ps128(by_u)));
    _mm_store_ps(slopes[1], _mm_fmadd_ps(z, step(by_v), _mm256_castps256_ps128(by_v)));
    _mm_store_ps(slopes[2], step(here));
}

// `add_to_nodes` of vector_portable.h, two neighbours along w at once.
inline void add_avx2(const Table& table, long node, const Visit& visit, int i, float* sums) {
    const long row = sum_floats * (table.row / 3), slab = sum_floats * (table.slab / 3);
    const __m128 change =
        _mm_setr_ps(visit.change[0][i], visit.change[1][i], visit.change[2][i], 0.0f);
    const __m256 x = _mm256_broadcast_ss(&visit.at[0][i]), y = _mm256_broadcast_ss(&visit.at[1][i]);
    const __m128 far = _mm_mul_ps(change, _mm_broadcast_ss(&visit.at[2][i]));
    const __m256 both = _mm256_set_m128(far, _mm_sub_ps(change, far));
    const __m256 high = _mm256_mul_ps(both, x), low = _mm256_sub_ps(both, high);
    const __m256 high_right = _mm256_mul_ps(high, y), low_right = _mm256_mul_ps(low, y);
    const auto add = [](float* to, __m256 more) { _mm256_storeu_ps(to, _mm256_add_ps(more, _mm256_loadu_ps(to))); };
    float* to = sums + sum_floats * node;
    add(to, _mm256_sub_ps(low, low_right));
    add(to + row, low_right);
    add(to + slab, _mm256_sub_ps(high, high_right));
    add(to + slab + row, high_right);
}

}  // namespace
}  // namespace raden
