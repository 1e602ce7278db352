// 16 lanes of float in an AVX-512 register. The same operations as the other vector_*.h.
#pragma once
#include <immintrin.h>

#include "fetch_avx2.h"

namespace raden {

struct Avx512 {
    static constexpr int lanes = 16;
    using Mask = __mmask16;
    __m512 x;

    Avx512() = default;
    Avx512(__m512 v) : x(v) {}
    Avx512(float v) : x(_mm512_set1_ps(v)) {}
    static Avx512 load(const float* p) { return _mm512_loadu_ps(p); }
    void store(float* p) const { _mm512_storeu_ps(p, x); }
    void stream(float* p) const { _mm512_stream_ps(p, x); }
    static void fence() { _mm_sfence(); }
    void store_int(int* p) const { _mm512_storeu_si512(p, _mm512_cvttps_epi32(x)); }
};

inline Avx512 operator+(Avx512 a, Avx512 b) { return _mm512_add_ps(a.x, b.x); }
inline Avx512 operator-(Avx512 a, Avx512 b) { return _mm512_sub_ps(a.x, b.x); }
inline Avx512 operator*(Avx512 a, Avx512 b) { return _mm512_mul_ps(a.x, b.x); }
inline Avx512 operator/(Avx512 a, Avx512 b) { return _mm512_div_ps(a.x, b.x); }
inline __mmask16 operator<(Avx512 a, Avx512 b) { return _mm512_cmp_ps_mask(a.x, b.x, _CMP_LT_OQ); }
inline __mmask16 operator<=(Avx512 a, Avx512 b) { return _mm512_cmp_ps_mask(a.x, b.x, _CMP_LE_OQ); }
inline __mmask16 both(__mmask16 a, __mmask16 b) { return _mm512_kand(a, b); }
inline unsigned bits(__mmask16 m) { return m; }
inline __mmask16 lanes_in(unsigned bits, const Avx512&) { return static_cast<__mmask16>(bits); }

inline Avx512 fma(Avx512 a, Avx512 b, Avx512 c) { return _mm512_fmadd_ps(a.x, b.x, c.x); }
inline Avx512 fnma(Avx512 a, Avx512 b, Avx512 c) { return _mm512_fnmadd_ps(a.x, b.x, c.x); }
inline Avx512 fms(Avx512 a, Avx512 b, Avx512 c) { return _mm512_fmsub_ps(a.x, b.x, c.x); }
inline Avx512 root(Avx512 a) { return _mm512_sqrt_ps(a.x); }
inline Avx512 magnitude(Avx512 a) { return _mm512_abs_ps(a.x); }
inline Avx512 least(Avx512 a, Avx512 b) { return _mm512_min_ps(a.x, b.x); }     // b where a is NaN
inline Avx512 greatest(Avx512 a, Avx512 b) { return _mm512_max_ps(a.x, b.x); }  // b where a is NaN
inline Avx512 floor_of(Avx512 a) { return _mm512_roundscale_ps(a.x, _MM_FROUND_TO_NEG_INF); }
inline Avx512 select(__mmask16 m, Avx512 a, Avx512 b) { return _mm512_mask_blend_ps(m, b.x, a.x); }

// Four pixels of (r, g, b, ·) in each register → three planes.
inline void planes(__m512 p0, __m512 p1, __m512 p2, __m512 p3, Avx512& r, Avx512& g, Avx512& b) {
    const __m512i red_green =
        _mm512_setr_epi32(0, 4, 8, 12, 16, 20, 24, 28, 1, 5, 9, 13, 17, 21, 25, 29);
    const __m512i blue = _mm512_setr_epi32(2, 6, 10, 14, 18, 22, 26, 30, 0, 0, 0, 0, 0, 0, 0, 0);
    const __m512 low = _mm512_permutex2var_ps(p0, red_green, p1);
    const __m512 high = _mm512_permutex2var_ps(p2, red_green, p3);
    r = _mm512_shuffle_f32x4(low, high, 0x44);
    g = _mm512_shuffle_f32x4(low, high, 0xee);
    b = _mm512_shuffle_f32x4(_mm512_permutex2var_ps(p0, blue, p1),
                             _mm512_permutex2var_ps(p2, blue, p3), 0x44);
}

// 16 pixels of (r, g, b, ·), one after another.
inline void planes(const float* rgb, Avx512& r, Avx512& g, Avx512& b) {
    planes(_mm512_loadu_ps(rgb), _mm512_loadu_ps(rgb + 16), _mm512_loadu_ps(rgb + 32),
           _mm512_loadu_ps(rgb + 48), r, g, b);
}

// The same, each `step` numbers after the one before.
inline void planes(const float* rgb, long step, Avx512& r, Avx512& g, Avx512& b) {
    const auto four = [&](long i) {
        const float* p = rgb + i * step;
        __m512 x = _mm512_castps128_ps512(_mm_loadu_ps(p));
        x = _mm512_insertf32x4(x, _mm_loadu_ps(p + step), 1);
        x = _mm512_insertf32x4(x, _mm_loadu_ps(p + 2 * step), 2);
        return _mm512_insertf32x4(x, _mm_loadu_ps(p + 3 * step), 3);
    };
    planes(four(0), four(4), four(8), four(12), r, g, b);
}

inline void fetch(const Avx512&, const Cells& cells, int i, const Table& table, float* rgb) {
    fetch_avx2(cells, i, table, rgb);
}

inline void slopes_at(const Avx512&, const Table& table, long node, const Visit& visit, int i,
                      float* const slopes[3]) {
    slopes_avx2(table, node, visit, i, slopes);
}

inline void add_to_nodes(const Avx512&, const Table& table, long node, const Visit& visit, int i,
                         float* sums) {
    add_avx2(table, node, visit, i, sums);
}

}  // namespace raden
