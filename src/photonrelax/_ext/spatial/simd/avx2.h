/* Vectors of AVX2, each in two registers; see vector.h. */
#ifndef PHOTONRELAX_SIMD_AVX2_H
#define PHOTONRELAX_SIMD_AVX2_H

#include <immintrin.h>

#define SIMD_NAME "avx2"
#define SIMD_KERNELS simd_kernels_avx2

typedef struct {
    __m256d low, high;
} f64x8;

typedef struct {
    __m256 low, high;
} f32x16;

/* All bits of a chosen lane are set. */
typedef struct {
    __m256d low, high;
} mask8;

typedef struct {
    __m256 low, high;
} mask16;

INLINE f64x8 f64x8_set1(double x) { return (f64x8){_mm256_set1_pd(x), _mm256_set1_pd(x)}; }

INLINE f64x8 f64x8_load(const double *x)
{
    return (f64x8){_mm256_loadu_pd(x), _mm256_loadu_pd(x + 4)};
}

INLINE void f64x8_store(double *x, f64x8 a)
{
    _mm256_storeu_pd(x, a.low);
    _mm256_storeu_pd(x + 4, a.high);
}

INLINE f64x8 f64x8_add(f64x8 a, f64x8 b)
{
    return (f64x8){_mm256_add_pd(a.low, b.low), _mm256_add_pd(a.high, b.high)};
}

INLINE f64x8 f64x8_sub(f64x8 a, f64x8 b)
{
    return (f64x8){_mm256_sub_pd(a.low, b.low), _mm256_sub_pd(a.high, b.high)};
}

INLINE f64x8 f64x8_mul(f64x8 a, f64x8 b)
{
    return (f64x8){_mm256_mul_pd(a.low, b.low), _mm256_mul_pd(a.high, b.high)};
}

INLINE f64x8 f64x8_div(f64x8 a, f64x8 b)
{
    return (f64x8){_mm256_div_pd(a.low, b.low), _mm256_div_pd(a.high, b.high)};
}

INLINE f64x8 f64x8_max(f64x8 a, f64x8 b)
{
    return (f64x8){_mm256_max_pd(a.low, b.low), _mm256_max_pd(a.high, b.high)};
}

INLINE f64x8 f64x8_min(f64x8 a, f64x8 b)
{
    return (f64x8){_mm256_min_pd(a.low, b.low), _mm256_min_pd(a.high, b.high)};
}

INLINE f64x8 f64x8_sqrt(f64x8 a)
{
    return (f64x8){_mm256_sqrt_pd(a.low), _mm256_sqrt_pd(a.high)};
}

INLINE mask8 f64x8_le(f64x8 a, f64x8 b)
{
    return (mask8){_mm256_cmp_pd(a.low, b.low, _CMP_LE_OQ),
                   _mm256_cmp_pd(a.high, b.high, _CMP_LE_OQ)};
}

INLINE mask8 mask8_and(mask8 a, mask8 b)
{
    return (mask8){_mm256_and_pd(a.low, b.low), _mm256_and_pd(a.high, b.high)};
}

INLINE unsigned mask8_bits(mask8 a)
{
    return (unsigned)_mm256_movemask_pd(a.low) | (unsigned)_mm256_movemask_pd(a.high) << 4;
}

INLINE mask8 mask8_of_bits(unsigned bits)
{
    const __m256i low = _mm256_setr_epi64x(1, 2, 4, 8), high = _mm256_slli_epi64(low, 4);
    const __m256i all = _mm256_set1_epi64x(bits);
    return (mask8){_mm256_castsi256_pd(_mm256_cmpeq_epi64(_mm256_and_si256(all, low), low)),
                   _mm256_castsi256_pd(_mm256_cmpeq_epi64(_mm256_and_si256(all, high), high))};
}

/* a where the mask is set, else b. */
INLINE f64x8 f64x8_select(mask8 mask, f64x8 a, f64x8 b)
{
    return (f64x8){_mm256_blendv_pd(b.low, a.low, mask.low),
                   _mm256_blendv_pd(b.high, a.high, mask.high)};
}

/* Non-temporal store to an aligned address. */
INLINE void f64x8_stream(double *x, f64x8 a)
{
    _mm256_stream_pd(x, a.low);
    _mm256_stream_pd(x + 4, a.high);
}

/* Eight ids, as the bits of doubles. */
INLINE f64x8 f64x8_load_ids(const int64_t *x)
{
    return (f64x8){_mm256_castsi256_pd(_mm256_loadu_si256((const __m256i *)x)),
                   _mm256_castsi256_pd(_mm256_loadu_si256((const __m256i *)(x + 4)))};
}

INLINE double f64x8_sum(f64x8 a)
{
    __m256d four = _mm256_add_pd(a.low, a.high);
    __m128d two = _mm_add_pd(_mm256_castpd256_pd128(four), _mm256_extractf128_pd(four, 1));
    return _mm_cvtsd_f64(_mm_add_sd(two, _mm_unpackhi_pd(two, two)));
}

#define LANE(i) 2 * (i), 2 * (i) + 1
#define ROW(a, b, c, d) {LANE(a), LANE(b), LANE(c), LANE(d)}
/* Permutation that moves the lanes of a bitmask to the front. */
static const int32_t COMPRESSED[16][8] = {
    ROW(0, 0, 0, 0), ROW(0, 0, 0, 0), ROW(1, 0, 0, 0), ROW(0, 1, 0, 0),
    ROW(2, 0, 0, 0), ROW(0, 2, 0, 0), ROW(1, 2, 0, 0), ROW(0, 1, 2, 0),
    ROW(3, 0, 0, 0), ROW(0, 3, 0, 0), ROW(1, 3, 0, 0), ROW(0, 1, 3, 0),
    ROW(2, 3, 0, 0), ROW(0, 2, 3, 0), ROW(1, 2, 3, 0), ROW(0, 1, 2, 3),
};

INLINE __m256d f64x4_compress(unsigned bits, __m256d a)
{
    __m256i lanes = _mm256_loadu_si256((const __m256i *)COMPRESSED[bits]);
    return _mm256_castsi256_pd(_mm256_permutevar8x32_epi32(_mm256_castpd_si256(a), lanes));
}

/* Store the lanes of a bitmask consecutively; at most a whole vector is written. */
INLINE void f64x8_compress_store(void *x, unsigned bits, f64x8 a)
{
    double *target = (double *)x;
    _mm256_storeu_pd(target, f64x4_compress(bits & 15, a.low));
    _mm256_storeu_pd(target + count_bits(bits & 15), f64x4_compress(bits >> 4, a.high));
}

INLINE void f64x8_store_f32(float *x, f64x8 a)
{
    _mm_storeu_ps(x, _mm256_cvtpd_ps(a.low));
    _mm_storeu_ps(x + 4, _mm256_cvtpd_ps(a.high));
}

/* Store numbers from 0 to 255, rounded down, as bytes. */
INLINE void f64x8_store_u8(uint8_t *x, f64x8 a)
{
    __m128i words = _mm_packs_epi32(_mm256_cvttpd_epi32(a.low), _mm256_cvttpd_epi32(a.high));
    _mm_storel_epi64((__m128i *)x, _mm_packus_epi16(words, words));
}

INLINE f32x16 f32x16_set1(float x) { return (f32x16){_mm256_set1_ps(x), _mm256_set1_ps(x)}; }

INLINE f32x16 f32x16_load(const float *x)
{
    return (f32x16){_mm256_loadu_ps(x), _mm256_loadu_ps(x + 8)};
}

INLINE void f32x16_store(float *x, f32x16 a)
{
    _mm256_storeu_ps(x, a.low);
    _mm256_storeu_ps(x + 8, a.high);
}

INLINE f32x16 f32x16_add(f32x16 a, f32x16 b)
{
    return (f32x16){_mm256_add_ps(a.low, b.low), _mm256_add_ps(a.high, b.high)};
}

INLINE f32x16 f32x16_sub(f32x16 a, f32x16 b)
{
    return (f32x16){_mm256_sub_ps(a.low, b.low), _mm256_sub_ps(a.high, b.high)};
}

INLINE f32x16 f32x16_mul(f32x16 a, f32x16 b)
{
    return (f32x16){_mm256_mul_ps(a.low, b.low), _mm256_mul_ps(a.high, b.high)};
}

INLINE f32x16 f32x16_max(f32x16 a, f32x16 b)
{
    return (f32x16){_mm256_max_ps(a.low, b.low), _mm256_max_ps(a.high, b.high)};
}

INLINE f32x16 f32x16_min(f32x16 a, f32x16 b)
{
    return (f32x16){_mm256_min_ps(a.low, b.low), _mm256_min_ps(a.high, b.high)};
}

INLINE mask16 f32x16_le(f32x16 a, f32x16 b)
{
    return (mask16){_mm256_cmp_ps(a.low, b.low, _CMP_LE_OQ),
                    _mm256_cmp_ps(a.high, b.high, _CMP_LE_OQ)};
}

INLINE mask16 mask16_and(mask16 a, mask16 b)
{
    return (mask16){_mm256_and_ps(a.low, b.low), _mm256_and_ps(a.high, b.high)};
}

INLINE unsigned mask16_bits(mask16 a)
{
    return (unsigned)_mm256_movemask_ps(a.low) | (unsigned)_mm256_movemask_ps(a.high) << 8;
}

/* a where the mask is set, else b. */
INLINE f32x16 f32x16_select(mask16 mask, f32x16 a, f32x16 b)
{
    return (f32x16){_mm256_blendv_ps(b.low, a.low, mask.low),
                    _mm256_blendv_ps(b.high, a.high, mask.high)};
}

/* a + b where the mask is set, else a; a is not -0. */
INLINE f32x16 f32x16_add_where(mask16 mask, f32x16 a, f32x16 b)
{
    return (f32x16){_mm256_add_ps(a.low, _mm256_and_ps(mask.low, b.low)),
                    _mm256_add_ps(a.high, _mm256_and_ps(mask.high, b.high))};
}

INLINE void f32x16_store_i32(int32_t *x, f32x16 a)
{
    _mm256_storeu_si256((__m256i *)x, _mm256_cvttps_epi32(a.low));
    _mm256_storeu_si256((__m256i *)(x + 8), _mm256_cvttps_epi32(a.high));
}

INLINE void f32x16_store_u8(uint8_t *x, f32x16 a)
{
    __m256i words = _mm256_packs_epi32(_mm256_cvttps_epi32(a.low), _mm256_cvttps_epi32(a.high));
    __m256i ordered = _mm256_permute4x64_epi64(words, 0xD8);
    _mm_storeu_si128((__m128i *)x, _mm_packus_epi16(_mm256_castsi256_si128(ordered),
                                                    _mm256_extracti128_si256(ordered, 1)));
}

INLINE uint64_t join_masks(__m256i low, __m256i high)
{
    return (uint64_t)(uint32_t)_mm256_movemask_epi8(high) << 32 |
           (uint32_t)_mm256_movemask_epi8(low);
}

/* Bitmask of the 64 keys that are at most `most`. */
INLINE uint64_t keys_at_most(const uint8_t *keys, int most)
{
    const __m256i limit = _mm256_set1_epi8((char)most);
    __m256i low = _mm256_loadu_si256((const __m256i *)keys);
    __m256i high = _mm256_loadu_si256((const __m256i *)(keys + 32));
    return join_masks(_mm256_cmpeq_epi8(_mm256_min_epu8(low, limit), low),
                      _mm256_cmpeq_epi8(_mm256_min_epu8(high, limit), high));
}

/* Bitmask of the 64 keys that differ from `key` by at most one, modulo 256. */
INLINE uint64_t keys_next_to(const uint8_t *keys, int key)
{
    const __m256i first = _mm256_set1_epi8((char)(key - 1)), two = _mm256_set1_epi8(2);
    __m256i low = _mm256_sub_epi8(_mm256_loadu_si256((const __m256i *)keys), first);
    __m256i high = _mm256_sub_epi8(_mm256_loadu_si256((const __m256i *)(keys + 32)), first);
    return join_masks(_mm256_cmpeq_epi8(_mm256_min_epu8(low, two), low),
                      _mm256_cmpeq_epi8(_mm256_min_epu8(high, two), high));
}

#endif
