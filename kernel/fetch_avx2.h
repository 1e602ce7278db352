// One pixel's eight table nodes with 32-byte loads: two neighbours in tilt are six floats in a row.
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

}  // namespace
}  // namespace raden
