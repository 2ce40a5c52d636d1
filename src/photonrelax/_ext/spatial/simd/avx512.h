/* Vectors of AVX-512; see vector.h. */
#ifndef PHOTONRELAX_SIMD_AVX512_H
#define PHOTONRELAX_SIMD_AVX512_H

#include <immintrin.h>

#define SIMD_NAME "avx512"
#define SIMD_KERNELS simd_kernels_avx512

typedef __m512d f64x8;
typedef __m512 f32x16;
typedef __mmask8 mask8;
typedef __mmask16 mask16;

INLINE f64x8 f64x8_set1(double x) { return _mm512_set1_pd(x); }
INLINE f64x8 f64x8_load(const double *x) { return _mm512_loadu_pd(x); }
INLINE void f64x8_store(double *x, f64x8 a) { _mm512_storeu_pd(x, a); }
INLINE f64x8 f64x8_add(f64x8 a, f64x8 b) { return _mm512_add_pd(a, b); }
INLINE f64x8 f64x8_sub(f64x8 a, f64x8 b) { return _mm512_sub_pd(a, b); }
INLINE f64x8 f64x8_mul(f64x8 a, f64x8 b) { return _mm512_mul_pd(a, b); }
INLINE f64x8 f64x8_div(f64x8 a, f64x8 b) { return _mm512_div_pd(a, b); }
INLINE f64x8 f64x8_max(f64x8 a, f64x8 b) { return _mm512_max_pd(a, b); }
INLINE f64x8 f64x8_min(f64x8 a, f64x8 b) { return _mm512_min_pd(a, b); }
INLINE f64x8 f64x8_sqrt(f64x8 a) { return _mm512_sqrt_pd(a); }
INLINE mask8 f64x8_le(f64x8 a, f64x8 b) { return _mm512_cmp_pd_mask(a, b, _CMP_LE_OQ); }
INLINE mask8 mask8_and(mask8 a, mask8 b) { return (mask8)(a & b); }
INLINE unsigned mask8_bits(mask8 a) { return a; }
INLINE mask8 mask8_of_bits(unsigned bits) { return (mask8)bits; }

/* a where the mask is set, else b. */
INLINE f64x8 f64x8_select(mask8 mask, f64x8 a, f64x8 b) { return _mm512_mask_blend_pd(mask, b, a); }

/* Non-temporal store to an aligned address. */
INLINE void f64x8_stream(double *x, f64x8 a) { _mm512_stream_pd(x, a); }

/* Eight ids, as the bits of doubles. */
INLINE f64x8 f64x8_load_ids(const int64_t *x) { return _mm512_castsi512_pd(_mm512_loadu_si512(x)); }

INLINE double f64x8_sum(f64x8 a)
{
    __m256d four = _mm256_add_pd(_mm512_castpd512_pd256(a), _mm512_extractf64x4_pd(a, 1));
    __m128d two = _mm_add_pd(_mm256_castpd256_pd128(four), _mm256_extractf128_pd(four, 1));
    return _mm_cvtsd_f64(_mm_add_sd(two, _mm_unpackhi_pd(two, two)));
}

/* Store the lanes of a bitmask consecutively; a whole vector is written. */
INLINE void f64x8_compress_store(void *x, unsigned bits, f64x8 a)
{
    _mm512_storeu_pd(x, _mm512_maskz_compress_pd((__mmask8)bits, a));
}

INLINE void f64x8_store_f32(float *x, f64x8 a) { _mm256_storeu_ps(x, _mm512_cvtpd_ps(a)); }

/* Store numbers from 0 to 255, rounded down, as bytes. */
INLINE void f64x8_store_u8(uint8_t *x, f64x8 a)
{
    _mm_storel_epi64((__m128i *)x, _mm256_cvtepi32_epi8(_mm512_cvttpd_epi32(a)));
}

INLINE f32x16 f32x16_set1(float x) { return _mm512_set1_ps(x); }
INLINE f32x16 f32x16_load(const float *x) { return _mm512_loadu_ps(x); }
INLINE void f32x16_store(float *x, f32x16 a) { _mm512_storeu_ps(x, a); }
INLINE f32x16 f32x16_add(f32x16 a, f32x16 b) { return _mm512_add_ps(a, b); }
INLINE f32x16 f32x16_sub(f32x16 a, f32x16 b) { return _mm512_sub_ps(a, b); }
INLINE f32x16 f32x16_mul(f32x16 a, f32x16 b) { return _mm512_mul_ps(a, b); }
INLINE f32x16 f32x16_max(f32x16 a, f32x16 b) { return _mm512_max_ps(a, b); }
INLINE f32x16 f32x16_min(f32x16 a, f32x16 b) { return _mm512_min_ps(a, b); }
INLINE mask16 f32x16_le(f32x16 a, f32x16 b) { return _mm512_cmp_ps_mask(a, b, _CMP_LE_OQ); }
INLINE mask16 mask16_and(mask16 a, mask16 b) { return (mask16)(a & b); }
INLINE unsigned mask16_bits(mask16 a) { return a; }

/* a where the mask is set, else b. */
INLINE f32x16 f32x16_select(mask16 mask, f32x16 a, f32x16 b)
{
    return _mm512_mask_blend_ps(mask, b, a);
}

/* a + b where the mask is set, else a. */
INLINE f32x16 f32x16_add_where(mask16 mask, f32x16 a, f32x16 b)
{
    return _mm512_mask_add_ps(a, mask, a, b);
}

INLINE void f32x16_store_i32(int32_t *x, f32x16 a)
{
    _mm512_storeu_si512(x, _mm512_cvttps_epi32(a));
}

INLINE void f32x16_store_u8(uint8_t *x, f32x16 a)
{
    _mm_storeu_si128((__m128i *)x, _mm512_cvtepi32_epi8(_mm512_cvttps_epi32(a)));
}

/* Bitmask of the 64 keys that are at most `most`. */
INLINE uint64_t keys_at_most(const uint8_t *keys, int most)
{
    return _mm512_cmple_epu8_mask(_mm512_loadu_si512(keys), _mm512_set1_epi8((char)most));
}

/* Bitmask of the 64 keys that differ from `key` by at most one, modulo 256. */
INLINE uint64_t keys_next_to(const uint8_t *keys, int key)
{
    __m512i above = _mm512_sub_epi8(_mm512_loadu_si512(keys), _mm512_set1_epi8((char)(key - 1)));
    return _mm512_cmple_epu8_mask(above, _mm512_set1_epi8(2));
}

#endif
