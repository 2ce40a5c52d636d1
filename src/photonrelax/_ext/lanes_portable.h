/* What lanes_body.h needs to know of any processor. */
#define SET_SUFFIX portable
#define SET_NAME "portable"
#define TARGET
#define WIDTH 1
#define VECTOR double
#define MASK unsigned
#define SET(x) (x)
#define LOAD(x) (*(x))
#define STORE(x, v) (*(x) = (v))
#define STREAM(x, v) (*(x) = (v))
#define ADD(a, b) ((a) + (b))
#define SUB(a, b) ((a) - (b))
#define MUL(a, b) ((a) * (b))
#define DIV(a, b) ((a) / (b))
#define MAX(a, b) ((a) > (b) ? (a) : (b))
#define MIN(a, b) ((a) < (b) ? (a) : (b))
#define SQRT(a) sqrt(a)
#define AT_MOST(a, b) ((unsigned)((a) <= (b)))
#define BOTH(a, b) ((a) & (b))
#define BITS(m) (m)
#define PICK(m, a, b) ((m) ? (a) : (b))
#define PACK(to, m, v) memcpy(to, &(v), sizeof(double))
#define CHOOSE(bits) (bits)
#define F_WIDTH 1
#define F_VECTOR float
#define F_MASK unsigned
#define F_SET(x) (x)
#define F_LOAD(x) (*(x))
#define F_STORE(x, v) (*(x) = (v))
#define F_STORE_INTEGERS(x, v) (*(x) = (int32_t)(v))
#define F_ADD(a, b) ((a) + (b))
#define F_SUB(a, b) ((a) - (b))
#define F_MUL(a, b) ((a) * (b))
#define F_MAX(a, b) ((a) > (b) ? (a) : (b))
#define F_MIN(a, b) ((a) < (b) ? (a) : (b))
#define F_AT_MOST(a, b) ((unsigned)((a) <= (b)))
#define F_BOTH(a, b) ((a) & (b))
#define F_BITS(m) (m)
#define F_PICK(m, a, b) ((m) ? (a) : (b))
#define F_ADD_WHERE(m, a, b) ((m) ? (a) + (b) : (a))

#if defined(__SSE2__)
#include <emmintrin.h>
static ALWAYS_INLINE uint64_t keys_equal_portable(const uint8_t *keys, int key)
{
    uint64_t bits = 0;
    for (int i = 0; i < KEYS; i += 16) {
        __m128i x = _mm_loadu_si128((const __m128i *)(keys + i));
        __m128i equal = _mm_cmpeq_epi8(x, _mm_set1_epi8((char)key));
        bits |= (uint64_t)_mm_movemask_epi8(equal) << i;
    }
    return bits;
}

static ALWAYS_INLINE uint64_t keys_at_most_portable(const uint8_t *keys, int most)
{
    uint64_t bits = 0;
    for (int i = 0; i < KEYS; i += 16) {
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
    for (int i = 0; i < KEYS; ++i) bits |= (uint64_t)(keys[i] == key) << i;
    return bits;
}

static uint64_t keys_at_most_portable(const uint8_t *keys, int most)
{
    uint64_t bits = 0;
    for (int i = 0; i < KEYS; ++i) bits |= (uint64_t)(keys[i] <= most) << i;
    return bits;
}
#endif

/* Keys one less than this, this, and one more. */
static ALWAYS_INLINE uint64_t keys_next_to_portable(const uint8_t *keys, int key)
{
    return keys_equal_portable(keys, key) | keys_equal_portable(keys, key + 1) |
           (key > 0 ? keys_equal_portable(keys, key - 1) : 0);
}

#define store_keys_portable(to, v)                                   \
    do {                                                             \
        V8 key = (v);                                                \
        for (int i = 0; i < LANES; ++i) (to)[i] = (uint8_t)key.part[i]; \
    } while (0)

#define store_f_keys_portable(to, v)                                    \
    do {                                                                \
        F16 f_key = (v);                                                \
        for (int i = 0; i < BLOCK; ++i) (to)[i] = (uint8_t)f_key.part[i]; \
    } while (0)

#define STORE_ROUNDED(to, v) (*(to) = (float)(v))
