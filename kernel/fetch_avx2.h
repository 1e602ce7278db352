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

inline float sum_of(__m256 v) {
    __m128 four = _mm_add_ps(_mm256_castps256_ps128(v), _mm256_extractf128_ps(v, 1));
    four = _mm_add_ps(four, _mm_movehl_ps(four, four));
    return _mm_cvtss_f32(_mm_add_ss(four, _mm_movehdup_ps(four)));
}

// `visit_nodes` of vector_portable.h, six floats at once.
inline void visit_avx2(const Table& table, long first, float* sums, const float g[3],
                       const float at[3], float slopes[3]) {
    const __m256i six = _mm256_setr_epi32(-1, -1, -1, -1, -1, -1, 0, 0);
    const __m256 change = _mm256_setr_ps(g[0], g[1], g[2], g[0], g[1], g[2], 0, 0);
    const __m256 sign = _mm256_setr_ps(-1, -1, -1, 1, 1, 1, 0, 0);
    const __m256 low = _mm256_setr_ps(1, 1, 1, 0, 0, 0, 0, 0);
    const __m256 into = _mm256_mul_ps(change, _mm256_fmadd_ps(_mm256_set1_ps(at[2]), sign, low));
    const long corners[4] = {0, table.row, table.slab, table.slab + table.row};
    const float x = at[0], y = at[1];
    const float across[4] = {(1 - x) * (1 - y), (1 - x) * y, x * (1 - y), x * y};
    const float along_u[4] = {y - 1, -y, 1 - y, y}, along_v[4] = {x - 1, 1 - x, -x, x};
    __m256 by_u = _mm256_setzero_ps(), by_v = by_u, by_w = by_u;
    for (int j = 0; j < 4; ++j) {
        const __m256 node = _mm256_maskload_ps(table.values + first + corners[j], six);
        by_u = _mm256_fmadd_ps(_mm256_set1_ps(along_u[j]), node, by_u);
        by_v = _mm256_fmadd_ps(_mm256_set1_ps(along_v[j]), node, by_v);
        by_w = _mm256_fmadd_ps(_mm256_set1_ps(across[j]), node, by_w);
        if (sums) {
            float* to = sums + first + corners[j];
            _mm256_maskstore_ps(
                to, six,
                _mm256_fmadd_ps(_mm256_set1_ps(across[j]), into, _mm256_maskload_ps(to, six)));
        }
    }
    slopes[0] = sum_of(_mm256_mul_ps(by_u, into));
    slopes[1] = sum_of(_mm256_mul_ps(by_v, into));
    slopes[2] = sum_of(_mm256_mul_ps(by_w, _mm256_mul_ps(change, sign)));
}

}  // namespace
}  // namespace raden
