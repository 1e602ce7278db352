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

// Three floats twice: the gradient of pixel i for two neighbours along w.
inline __m256 change_twice(const Visit& visit, int i) {
    const __m256 red = _mm256_broadcast_ss(&visit.change[0][i]);
    const __m256 green = _mm256_broadcast_ss(&visit.change[1][i]);
    const __m256 blue = _mm256_broadcast_ss(&visit.change[2][i]);
    return _mm256_blend_ps(_mm256_blend_ps(red, green, 0x12), blue, 0x24);
}

// `slopes_at` of vector_portable.h, six floats at once.
inline void slopes_avx2(const Table& table, long node, const Visit& visit, int i, float* slopes) {
    const __m256i six = _mm256_setr_epi32(-1, -1, -1, -1, -1, -1, 0, 0);
    const float* p = table.values + 3 * node;
    const __m256 a = _mm256_maskload_ps(p, six), b = _mm256_maskload_ps(p + table.row, six);
    p += table.slab;
    const __m256 c = _mm256_maskload_ps(p, six), d = _mm256_maskload_ps(p + table.row, six);
    const __m256 x = _mm256_broadcast_ss(&visit.at[0][i]), y = _mm256_broadcast_ss(&visit.at[1][i]);
    const __m256 low = _mm256_sub_ps(b, a), high = _mm256_sub_ps(d, c);
    const __m256 from = _mm256_fmadd_ps(y, low, a);
    const __m256 by_u = _mm256_sub_ps(_mm256_fmadd_ps(y, high, c), from);
    const __m256 by_v = _mm256_fmadd_ps(x, _mm256_sub_ps(high, low), low);
    const __m256 by_w = _mm256_fmadd_ps(x, by_u, from);
    const __m256 sign = _mm256_setr_ps(-1, -1, -1, 1, 1, 1, 0, 0);
    const __m256 start = _mm256_setr_ps(1, 1, 1, 0, 0, 0, 0, 0);
    const __m256 change = change_twice(visit, i);
    const __m256 into =
        _mm256_mul_ps(change, _mm256_fmadd_ps(_mm256_broadcast_ss(&visit.at[2][i]), sign, start));
    const __m256 u_v = _mm256_hadd_ps(_mm256_mul_ps(by_u, into), _mm256_mul_ps(by_v, into));
    const __m256 w = _mm256_mul_ps(by_w, _mm256_mul_ps(change, sign));
    const __m256 each = _mm256_hadd_ps(u_v, _mm256_hadd_ps(w, _mm256_setzero_ps()));
    _mm_store_ps(slopes, _mm_add_ps(_mm256_castps256_ps128(each), _mm256_extractf128_ps(each, 1)));
}

// `add_to_nodes` of vector_portable.h, a node at a time: a pixel's stores are as wide as the loads
// of the next, which often is in the same cell or beside it.
inline void add_avx2(const Table& table, long node, const Visit& visit, int i, float* sums) {
    const long row = sum_floats * (table.row / 3), slab = sum_floats * (table.slab / 3);
    const __m128 change =
        _mm_setr_ps(visit.change[0][i], visit.change[1][i], visit.change[2][i], 0.0f);
    const __m128 x = _mm_broadcast_ss(&visit.at[0][i]), y = _mm_broadcast_ss(&visit.at[1][i]);
    const __m128 z = _mm_broadcast_ss(&visit.at[2][i]);
    const __m128 far = _mm_mul_ps(change, z), near = _mm_sub_ps(change, far);
    const __m128 high = x, low = _mm_sub_ps(_mm_set1_ps(1.0f), x);
    const __m128 high_right = _mm_mul_ps(high, y), high_left = _mm_sub_ps(high, high_right);
    const __m128 low_right = _mm_mul_ps(low, y), low_left = _mm_sub_ps(low, low_right);
    const auto add = [near, far](float* to, __m128 weight) {
        _mm_storeu_ps(to, _mm_fmadd_ps(weight, near, _mm_loadu_ps(to)));
        to += sum_floats;
        _mm_storeu_ps(to, _mm_fmadd_ps(weight, far, _mm_loadu_ps(to)));
    };
    float* to = sums + sum_floats * node;
    add(to, low_left);
    add(to + row, low_right);
    add(to + slab, high_left);
    add(to + slab + row, high_right);
}

}  // namespace
}  // namespace raden
