// 8 lanes of float in an AVX2 register. The same operations as the other vector_*.h.
#pragma once
#include <immintrin.h>

#include "fetch_avx2.h"

namespace raden {

struct Avx2 {
    static constexpr int lanes = 8;
    struct Mask {
        __m256 x;
    };
    __m256 x;

    Avx2() = default;
    Avx2(__m256 v) : x(v) {}
    Avx2(float v) : x(_mm256_set1_ps(v)) {}
    static Avx2 load(const float* p) { return _mm256_loadu_ps(p); }
    void store(float* p) const { _mm256_storeu_ps(p, x); }
    void stream(float* p) const { _mm256_stream_ps(p, x); }
    static void fence() { _mm_sfence(); }
    void store_int(int* p) const {
        _mm256_storeu_si256(reinterpret_cast<__m256i*>(p), _mm256_cvttps_epi32(x));
    }
};

inline Avx2 operator+(Avx2 a, Avx2 b) { return _mm256_add_ps(a.x, b.x); }
inline Avx2 operator-(Avx2 a, Avx2 b) { return _mm256_sub_ps(a.x, b.x); }
inline Avx2 operator*(Avx2 a, Avx2 b) { return _mm256_mul_ps(a.x, b.x); }
inline Avx2 operator/(Avx2 a, Avx2 b) { return _mm256_div_ps(a.x, b.x); }
inline Avx2::Mask operator<(Avx2 a, Avx2 b) { return {_mm256_cmp_ps(a.x, b.x, _CMP_LT_OQ)}; }
inline Avx2::Mask operator<=(Avx2 a, Avx2 b) { return {_mm256_cmp_ps(a.x, b.x, _CMP_LE_OQ)}; }
inline Avx2::Mask both(Avx2::Mask a, Avx2::Mask b) { return {_mm256_and_ps(a.x, b.x)}; }
inline unsigned bits(Avx2::Mask m) { return static_cast<unsigned>(_mm256_movemask_ps(m.x)); }
inline Avx2::Mask lanes_in(unsigned bits, const Avx2&) {
    const __m256i bit = _mm256_setr_epi32(1, 2, 4, 8, 16, 32, 64, 128);
    const __m256i on = _mm256_and_si256(_mm256_set1_epi32(static_cast<int>(bits)), bit);
    return {_mm256_castsi256_ps(_mm256_cmpeq_epi32(on, bit))};
}

inline Avx2 fma(Avx2 a, Avx2 b, Avx2 c) { return _mm256_fmadd_ps(a.x, b.x, c.x); }
inline Avx2 fnma(Avx2 a, Avx2 b, Avx2 c) { return _mm256_fnmadd_ps(a.x, b.x, c.x); }
inline Avx2 fms(Avx2 a, Avx2 b, Avx2 c) { return _mm256_fmsub_ps(a.x, b.x, c.x); }
inline Avx2 root(Avx2 a) { return _mm256_sqrt_ps(a.x); }
inline Avx2 magnitude(Avx2 a) { return _mm256_andnot_ps(_mm256_set1_ps(-0.0f), a.x); }
inline Avx2 least(Avx2 a, Avx2 b) { return _mm256_min_ps(a.x, b.x); }     // b where a is NaN
inline Avx2 greatest(Avx2 a, Avx2 b) { return _mm256_max_ps(a.x, b.x); }  // b where a is NaN
inline Avx2 floor_of(Avx2 a) { return _mm256_floor_ps(a.x); }
inline Avx2 select(Avx2::Mask m, Avx2 a, Avx2 b) { return _mm256_blendv_ps(b.x, a.x, m.x); }

// 8 pixels of (r, g, b, ·), each `step` numbers after the one before → three planes.
inline void planes(const float* rgb, long step, Avx2& r, Avx2& g, Avx2& b) {
    const auto pair = [=](long i) {  // pixels i and i + 4
        return _mm256_insertf128_ps(_mm256_castps128_ps256(_mm_loadu_ps(rgb + step * i)),
                                    _mm_loadu_ps(rgb + step * (i + 4)), 1);
    };
    const __m256 p0 = pair(0), p1 = pair(1), p2 = pair(2), p3 = pair(3);
    const __m256 low01 = _mm256_unpacklo_ps(p0, p1), low23 = _mm256_unpacklo_ps(p2, p3);
    const __m256 high01 = _mm256_unpackhi_ps(p0, p1), high23 = _mm256_unpackhi_ps(p2, p3);
    r = _mm256_shuffle_ps(low01, low23, 0x44);
    g = _mm256_shuffle_ps(low01, low23, 0xee);
    b = _mm256_shuffle_ps(high01, high23, 0x44);
}

inline void planes(const float* rgb, Avx2& r, Avx2& g, Avx2& b) { planes(rgb, 4, r, g, b); }

inline void fetch(const Avx2&, const Cells& cells, int i, const Table& table, float* rgb) {
    fetch_avx2(cells, i, table, rgb);
}

inline void slopes_at(const Avx2&, const Table& table, long node, const Visit& visit, int i,
                      float* const slopes[3]) {
    slopes_avx2(table, node, visit, i, slopes);
}

inline void add_to_nodes(const Avx2&, const Table& table, long node, const Visit& visit, int i,
                         float* sums) {
    add_avx2(table, node, visit, i, sums);
}

}  // namespace raden
