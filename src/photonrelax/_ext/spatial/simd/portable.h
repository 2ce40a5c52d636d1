/* What body.h needs to know of any processor. */
#define SET_SUFFIX portable
#define SET_NAME "portable"
#define TARGET
#define WIDTH 2
#define VECTOR TwoDoubles
#define MASK TwoMasks
#define SET(x) ((TwoDoubles){x, x})
#define LOAD(x) load_two(x)
#define STORE(x, v) memcpy(x, &(v), sizeof(TwoDoubles))
#define STREAM(x, v) STORE(x, v)
#define ADD(a, b) ((a) + (b))
#define SUB(a, b) ((a) - (b))
#define MUL(a, b) ((a) * (b))
#define DIV(a, b) ((a) / (b))
#define MAX(a, b) PICK((TwoMasks)((a) > (b)), a, b)
#define MIN(a, b) PICK((TwoMasks)((a) < (b)), a, b)
#define SQRT(a) ((TwoDoubles){sqrt((a)[0]), sqrt((a)[1])})
#define TOTAL(a) ((a)[0] + (a)[1])
#define AT_MOST(a, b) ((TwoMasks)((a) <= (b)))
#define BOTH(a, b) ((a) & (b))
#define BITS(m) ((unsigned)(((m)[0] & 1) | ((m)[1] & 2)))
#define PICK(m, a, b) ((TwoDoubles)(((TwoMasks)(a) & (m)) | ((TwoMasks)(b) & ~(m))))
#define PACK(to, bits, v) pack_two(to, bits, v)
#define CHOOSE(bits) ((TwoMasks){-(int64_t)((bits) & 1), -(int64_t)((bits) >> 1)})
#define F_WIDTH 4
#define F_VECTOR FourFloats
#define F_MASK FourMasks
#define F_SET(x) ((FourFloats){x, x, x, x})
#define F_LOAD(x) load_four(x)
#define F_STORE(x, v) memcpy(x, &(v), sizeof(FourFloats))
#define F_ADD(a, b) ((a) + (b))
#define F_SUB(a, b) ((a) - (b))
#define F_MUL(a, b) ((a) * (b))
#define F_MAX(a, b) F_PICK((FourMasks)((a) > (b)), a, b)
#define F_MIN(a, b) F_PICK((FourMasks)((a) < (b)), a, b)
#define F_AT_MOST(a, b) ((FourMasks)((a) <= (b)))
#define F_BOTH(a, b) ((a) & (b))
#define F_BITS(m) ((unsigned)(((m)[0] & 1) | ((m)[1] & 2) | ((m)[2] & 4) | ((m)[3] & 8)))
#define F_PICK(m, a, b) ((FourFloats)(((FourMasks)(a) & (m)) | ((FourMasks)(b) & ~(m))))
#define F_ADD_WHERE(m, a, b) ((a) + (FourFloats)((FourMasks)(b) & (m)))
#define F_STORE_INTEGERS(x, v) store_integers(x, v)
#define STORE_ROUNDED(to, v) ((to)[0] = (float)(v)[0], (to)[1] = (float)(v)[1])

/* Vectors of GCC and Clang, which become those of SSE2 and NEON. */
typedef double TwoDoubles __attribute__((vector_size(16)));
typedef int64_t TwoMasks __attribute__((vector_size(16)));
typedef float FourFloats __attribute__((vector_size(16)));
typedef int32_t FourMasks __attribute__((vector_size(16)));

static ALWAYS_INLINE TwoDoubles load_two(const double *x)
{
    TwoDoubles out;
    memcpy(&out, x, sizeof out);
    return out;
}

static ALWAYS_INLINE FourFloats load_four(const float *x)
{
    FourFloats out;
    memcpy(&out, x, sizeof out);
    return out;
}

static ALWAYS_INLINE void pack_two(void *to, unsigned bits, TwoDoubles v)
{
    TwoDoubles packed = {bits & 1 ? v[0] : v[1], v[1]};
    memcpy(to, &packed, sizeof packed);
}

static ALWAYS_INLINE void store_integers(int32_t *to, FourFloats v)
{
    for (int i = 0; i < 4; ++i) to[i] = (int32_t)v[i];
}

#if defined(__SSE2__)
#include <emmintrin.h>
static ALWAYS_INLINE uint64_t keys_equal_portable(const uint8_t *keys, int key)
{
    uint64_t bits = 0;
    for (int i = 0; i < KEY_CHUNK; i += 16) {
        __m128i x = _mm_loadu_si128((const __m128i *)(keys + i));
        __m128i equal = _mm_cmpeq_epi8(x, _mm_set1_epi8((char)key));
        bits |= (uint64_t)_mm_movemask_epi8(equal) << i;
    }
    return bits;
}

static ALWAYS_INLINE uint64_t keys_at_most_portable(const uint8_t *keys, int most)
{
    uint64_t bits = 0;
    for (int i = 0; i < KEY_CHUNK; i += 16) {
        __m128i x = _mm_loadu_si128((const __m128i *)(keys + i));
        __m128i less = _mm_cmpeq_epi8(_mm_min_epu8(x, _mm_set1_epi8((char)most)), x);
        bits |= (uint64_t)_mm_movemask_epi8(less) << i;
    }
    return bits;
}
#else
static uint64_t keys_equal_portable(const uint8_t *keys, int key)
{
    uint64_t bits = 0;
    for (int i = 0; i < KEY_CHUNK; ++i) bits |= (uint64_t)(keys[i] == key) << i;
    return bits;
}

static uint64_t keys_at_most_portable(const uint8_t *keys, int most)
{
    uint64_t bits = 0;
    for (int i = 0; i < KEY_CHUNK; ++i) bits |= (uint64_t)(keys[i] <= most) << i;
    return bits;
}
#endif

/* Keys one less than this, this, and one more. */
static ALWAYS_INLINE uint64_t keys_next_to_portable(const uint8_t *keys, int key)
{
    return keys_equal_portable(keys, key) | keys_equal_portable(keys, key + 1) |
           (key > 0 ? keys_equal_portable(keys, key - 1) : 0);
}

#define store_keys_portable(to, v)                                                        \
    do {                                                                                  \
        V8 key = (v);                                                                     \
        for (int i = 0; i < LANES; ++i) (to)[i] = (uint8_t)key.part[i / 2][i % 2];        \
    } while (0)

#if defined(__SSE2__)
#define store_f_keys_portable(to, v)                                                      \
    do {                                                                                  \
        F16 f_key = (v);                                                                  \
        __m128i low = _mm_packs_epi32(_mm_cvttps_epi32((__m128)f_key.part[0]),            \
                                      _mm_cvttps_epi32((__m128)f_key.part[1]));           \
        __m128i high = _mm_packs_epi32(_mm_cvttps_epi32((__m128)f_key.part[2]),           \
                                       _mm_cvttps_epi32((__m128)f_key.part[3]));          \
        _mm_storeu_si128((__m128i *)(to), _mm_packus_epi16(low, high));                   \
    } while (0)
#else
#define store_f_keys_portable(to, v)                                                      \
    do {                                                                                  \
        F16 f_key = (v);                                                                  \
        for (int i = 0; i < BLOCK; ++i) (to)[i] = (uint8_t)f_key.part[i / 4][i % 4];      \
    } while (0)
#endif
