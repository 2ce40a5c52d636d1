/* Vectors of any processor, in 16-byte vector types of GCC and Clang: SSE2, NEON; see vector.h. */
#ifndef PHOTONRELAX_SIMD_PORTABLE_H
#define PHOTONRELAX_SIMD_PORTABLE_H

#if defined(__SSE2__)
#include <emmintrin.h>
#endif

#define SIMD_NAME "portable"
#define SIMD_KERNELS simd_kernels_portable

enum { PARTS = 4 };

typedef double f64x2 __attribute__((vector_size(16)));
typedef int64_t i64x2 __attribute__((vector_size(16)));
typedef float f32x4 __attribute__((vector_size(16)));
typedef int32_t i32x4 __attribute__((vector_size(16)));

typedef struct {
    f64x2 part[PARTS];
} f64x8;

typedef struct {
    f32x4 part[PARTS];
} f32x16;

/* All bits of a chosen lane are set. */
typedef struct {
    i64x2 part[PARTS];
} mask8;

typedef struct {
    i32x4 part[PARTS];
} mask16;

INLINE f64x2 f64x2_select(i64x2 mask, f64x2 a, f64x2 b)
{
    return (f64x2)(((i64x2)a & mask) | ((i64x2)b & ~mask));
}

INLINE f32x4 f32x4_select(i32x4 mask, f32x4 a, f32x4 b)
{
    return (f32x4)(((i32x4)a & mask) | ((i32x4)b & ~mask));
}

INLINE f64x8 f64x8_set1(double x)
{
    f64x8 out;
    for (int i = 0; i < PARTS; ++i) out.part[i] = (f64x2){x, x};
    return out;
}

INLINE f64x8 f64x8_load(const double *x)
{
    f64x8 out;
    for (int i = 0; i < PARTS; ++i) memcpy(&out.part[i], x + 2 * i, sizeof out.part[i]);
    return out;
}

INLINE void f64x8_store(double *x, f64x8 a)
{
    for (int i = 0; i < PARTS; ++i) memcpy(x + 2 * i, &a.part[i], sizeof a.part[i]);
}

INLINE f64x8 f64x8_add(f64x8 a, f64x8 b)
{
    for (int i = 0; i < PARTS; ++i) a.part[i] += b.part[i];
    return a;
}

INLINE f64x8 f64x8_sub(f64x8 a, f64x8 b)
{
    for (int i = 0; i < PARTS; ++i) a.part[i] -= b.part[i];
    return a;
}

INLINE f64x8 f64x8_mul(f64x8 a, f64x8 b)
{
    for (int i = 0; i < PARTS; ++i) a.part[i] *= b.part[i];
    return a;
}

INLINE f64x8 f64x8_div(f64x8 a, f64x8 b)
{
    for (int i = 0; i < PARTS; ++i) a.part[i] /= b.part[i];
    return a;
}

INLINE f64x8 f64x8_max(f64x8 a, f64x8 b)
{
    for (int i = 0; i < PARTS; ++i)
        a.part[i] = f64x2_select((i64x2)(a.part[i] > b.part[i]), a.part[i], b.part[i]);
    return a;
}

INLINE f64x8 f64x8_min(f64x8 a, f64x8 b)
{
    for (int i = 0; i < PARTS; ++i)
        a.part[i] = f64x2_select((i64x2)(a.part[i] < b.part[i]), a.part[i], b.part[i]);
    return a;
}

INLINE f64x8 f64x8_sqrt(f64x8 a)
{
    for (int i = 0; i < PARTS; ++i)
        a.part[i] = (f64x2){sqrt(a.part[i][0]), sqrt(a.part[i][1])};
    return a;
}

INLINE mask8 f64x8_le(f64x8 a, f64x8 b)
{
    mask8 out;
    for (int i = 0; i < PARTS; ++i) out.part[i] = (i64x2)(a.part[i] <= b.part[i]);
    return out;
}

INLINE mask8 mask8_and(mask8 a, mask8 b)
{
    for (int i = 0; i < PARTS; ++i) a.part[i] &= b.part[i];
    return a;
}

INLINE unsigned mask8_bits(mask8 a)
{
    unsigned bits = 0;
    for (int i = 0; i < PARTS; ++i)
        bits |= (unsigned)((a.part[i][0] & 1) | (a.part[i][1] & 2)) << (2 * i);
    return bits;
}

INLINE mask8 mask8_of_bits(unsigned bits)
{
    mask8 out;
    for (int i = 0; i < PARTS; ++i)
        out.part[i] = (i64x2){-(int64_t)(bits >> (2 * i) & 1), -(int64_t)(bits >> (2 * i + 1) & 1)};
    return out;
}

/* a where the mask is set, else b. */
INLINE f64x8 f64x8_select(mask8 mask, f64x8 a, f64x8 b)
{
    for (int i = 0; i < PARTS; ++i)
        a.part[i] = f64x2_select(mask.part[i], a.part[i], b.part[i]);
    return a;
}

/* Non-temporal store where there is one; here a store. */
INLINE void f64x8_stream(double *x, f64x8 a) { f64x8_store(x, a); }

/* Eight ids, as the bits of doubles. */
INLINE f64x8 f64x8_load_ids(const int64_t *x)
{
    f64x8 out;
    for (int i = 0; i < PARTS; ++i) memcpy(&out.part[i], x + 2 * i, sizeof out.part[i]);
    return out;
}

INLINE double f64x8_sum(f64x8 a)
{
    f64x2 two = (a.part[0] + a.part[2]) + (a.part[1] + a.part[3]);
    return two[0] + two[1];
}

/* Store the lanes of a bitmask consecutively; at most a whole vector is written. */
INLINE void f64x8_compress_store(void *x, unsigned bits, f64x8 a)
{
    double *target = (double *)x;
    for (int i = 0; i < PARTS; ++i) {
        const unsigned first = bits >> (2 * i) & 1, second = bits >> (2 * i + 1) & 1;
        f64x2 packed = {first ? a.part[i][0] : a.part[i][1], a.part[i][1]};
        memcpy(target, &packed, sizeof packed);
        target += first + second;
    }
}

INLINE void f64x8_store_f32(float *x, f64x8 a)
{
    for (int i = 0; i < LANES; ++i) x[i] = (float)a.part[i / 2][i % 2];
}

/* Store numbers from 0 to 255, rounded down, as bytes. */
INLINE void f64x8_store_u8(uint8_t *x, f64x8 a)
{
    for (int i = 0; i < LANES; ++i) x[i] = (uint8_t)a.part[i / 2][i % 2];
}

INLINE f32x16 f32x16_set1(float x)
{
    f32x16 out;
    for (int i = 0; i < PARTS; ++i) out.part[i] = (f32x4){x, x, x, x};
    return out;
}

INLINE f32x16 f32x16_load(const float *x)
{
    f32x16 out;
    for (int i = 0; i < PARTS; ++i) memcpy(&out.part[i], x + 4 * i, sizeof out.part[i]);
    return out;
}

INLINE void f32x16_store(float *x, f32x16 a)
{
    for (int i = 0; i < PARTS; ++i) memcpy(x + 4 * i, &a.part[i], sizeof a.part[i]);
}

INLINE f32x16 f32x16_add(f32x16 a, f32x16 b)
{
    for (int i = 0; i < PARTS; ++i) a.part[i] += b.part[i];
    return a;
}

INLINE f32x16 f32x16_sub(f32x16 a, f32x16 b)
{
    for (int i = 0; i < PARTS; ++i) a.part[i] -= b.part[i];
    return a;
}

INLINE f32x16 f32x16_mul(f32x16 a, f32x16 b)
{
    for (int i = 0; i < PARTS; ++i) a.part[i] *= b.part[i];
    return a;
}

INLINE f32x16 f32x16_max(f32x16 a, f32x16 b)
{
    for (int i = 0; i < PARTS; ++i)
        a.part[i] = f32x4_select((i32x4)(a.part[i] > b.part[i]), a.part[i], b.part[i]);
    return a;
}

INLINE f32x16 f32x16_min(f32x16 a, f32x16 b)
{
    for (int i = 0; i < PARTS; ++i)
        a.part[i] = f32x4_select((i32x4)(a.part[i] < b.part[i]), a.part[i], b.part[i]);
    return a;
}

INLINE mask16 f32x16_le(f32x16 a, f32x16 b)
{
    mask16 out;
    for (int i = 0; i < PARTS; ++i) out.part[i] = (i32x4)(a.part[i] <= b.part[i]);
    return out;
}

INLINE mask16 mask16_and(mask16 a, mask16 b)
{
    for (int i = 0; i < PARTS; ++i) a.part[i] &= b.part[i];
    return a;
}

INLINE unsigned mask16_bits(mask16 a)
{
    unsigned bits = 0;
    for (int i = 0; i < PARTS; ++i)
        bits |= (unsigned)((a.part[i][0] & 1) | (a.part[i][1] & 2) | (a.part[i][2] & 4) |
                           (a.part[i][3] & 8)) << (4 * i);
    return bits;
}

/* a where the mask is set, else b. */
INLINE f32x16 f32x16_select(mask16 mask, f32x16 a, f32x16 b)
{
    for (int i = 0; i < PARTS; ++i)
        a.part[i] = f32x4_select(mask.part[i], a.part[i], b.part[i]);
    return a;
}

/* a + b where the mask is set, else a; a is not -0. */
INLINE f32x16 f32x16_add_where(mask16 mask, f32x16 a, f32x16 b)
{
    for (int i = 0; i < PARTS; ++i) a.part[i] += (f32x4)((i32x4)b.part[i] & mask.part[i]);
    return a;
}

INLINE void f32x16_store_i32(int32_t *x, f32x16 a)
{
    for (int i = 0; i < BLOCK; ++i) x[i] = (int32_t)a.part[i / 4][i % 4];
}

#if defined(__SSE2__)
INLINE void f32x16_store_u8(uint8_t *x, f32x16 a)
{
    __m128i low = _mm_packs_epi32(_mm_cvttps_epi32((__m128)a.part[0]),
                                  _mm_cvttps_epi32((__m128)a.part[1]));
    __m128i high = _mm_packs_epi32(_mm_cvttps_epi32((__m128)a.part[2]),
                                   _mm_cvttps_epi32((__m128)a.part[3]));
    _mm_storeu_si128((__m128i *)x, _mm_packus_epi16(low, high));
}

INLINE uint64_t keys_at_most(const uint8_t *keys, int most)
{
    uint64_t bits = 0;
    for (int i = 0; i < KEY_CHUNK; i += 16) {
        __m128i x = _mm_loadu_si128((const __m128i *)(keys + i));
        __m128i less = _mm_cmpeq_epi8(_mm_min_epu8(x, _mm_set1_epi8((char)most)), x);
        bits |= (uint64_t)_mm_movemask_epi8(less) << i;
    }
    return bits;
}

INLINE uint64_t keys_next_to(const uint8_t *keys, int key)
{
    const __m128i first = _mm_set1_epi8((char)(key - 1)), two = _mm_set1_epi8(2);
    uint64_t bits = 0;
    for (int i = 0; i < KEY_CHUNK; i += 16) {
        __m128i x = _mm_sub_epi8(_mm_loadu_si128((const __m128i *)(keys + i)), first);
        bits |= (uint64_t)_mm_movemask_epi8(_mm_cmpeq_epi8(_mm_min_epu8(x, two), x)) << i;
    }
    return bits;
}
#else
INLINE void f32x16_store_u8(uint8_t *x, f32x16 a)
{
    for (int i = 0; i < BLOCK; ++i) x[i] = (uint8_t)a.part[i / 4][i % 4];
}

/* Bitmask of the 64 keys that are at most `most`. */
INLINE uint64_t keys_at_most(const uint8_t *keys, int most)
{
    uint64_t bits = 0;
    for (int i = 0; i < KEY_CHUNK; ++i) bits |= (uint64_t)(keys[i] <= most) << i;
    return bits;
}

/* Bitmask of the 64 keys that differ from `key` by at most one, modulo 256. */
INLINE uint64_t keys_next_to(const uint8_t *keys, int key)
{
    uint64_t bits = 0;
    for (int i = 0; i < KEY_CHUNK; ++i)
        bits |= (uint64_t)((uint8_t)(keys[i] - (key - 1)) <= 2) << i;
    return bits;
}
#endif

#endif
