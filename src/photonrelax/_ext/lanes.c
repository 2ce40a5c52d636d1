/* One set of loops for each instruction set, and the choice among them. */
#include "lanes.h"

#include <float.h>
#include <math.h>
#include <string.h>

#define ALWAYS_INLINE inline __attribute__((always_inline))
#define COUNT_BITS(x) __builtin_popcount(x)
#define COUNT_LONG(x) __builtin_popcountll(x)
#define LOWEST_BIT(x) __builtin_ctzll(x)
#define JOIN_NAMES(a, b) a##_##b
#define JOIN(a, b) JOIN_NAMES(a, b)
#define NAME(x) JOIN(x, SET_SUFFIX)
#define INLINE ALWAYS_INLINE TARGET

/* The search for the key of the k-th nearest candidate: `fewer` are known to have less than `key`. */
typedef struct {
    const uint8_t *keys;
    int64_t k, fewer;
    int key;
} Ranked;

/* What makes keys of squared distances up to a limit. */
static inline double key_scale(double squared_limit)
{
    return squared_limit > 1e-300 ? FARTHEST / squared_limit : 0.0;
}

static inline int64_t n_chunks(const Found *found)
{
    return (BLOCK * found->n_blocks + KEYS - 1) / KEYS;
}

/* Return the number of a rank, counted from one, among n; reorders them. */
static double of_rank(double *x, int64_t n, int64_t rank)
{
    int64_t low = 0, high = n - 1;
    while (low < high) {
        double pivot = x[low + (high - low) / 2];
        int64_t i = low, j = high;
        while (i <= j) {
            while (x[i] < pivot) ++i;
            while (x[j] > pivot) --j;
            if (i <= j) {
                double kept = x[i];
                x[i++] = x[j];
                x[j--] = kept;
            }
        }
        if (rank - 1 <= j)
            high = j;
        else if (rank - 1 >= i)
            low = i;
        else
            break;
    }
    return x[rank - 1];
}

/* Make keys from 1 to 2 all different: their last bits are replaced by their number. */
static ALWAYS_INLINE void number_keys(float *keys, int64_t count)
{
    for (int64_t j = 0; j < count; ++j) {
        uint32_t bits;
        memcpy(&bits, keys + j, sizeof bits);
        bits = (bits & ~(uint32_t)(KEYS - 1)) | (uint32_t)j;
        memcpy(keys + j, &bits, sizeof bits);
    }
}

/* Sort by insertion what is nearly sorted: by squared distance, then id. */
static void sort_exactly(double *squared, int64_t *id, int64_t count)
{
    for (int64_t j = 1; j < count; ++j) {
        double x = squared[j];
        int64_t own = id[j], hole = j;
        for (; hole > 0 && (squared[hole - 1] > x || (squared[hole - 1] == x && id[hole - 1] > own));
             --hole) {
            squared[hole] = squared[hole - 1];
            id[hole] = id[hole - 1];
        }
        squared[hole] = x;
        id[hole] = own;
    }
}

static double squared_gap_at(const double *coords, int64_t first, int64_t end, const Reach *reach,
                             int64_t place)
{
    const double *point = coords + BLOCK * reach->n_axes * (place / BLOCK) + place % BLOCK;
    double gap = point[BLOCK * first] - reach->low[first], squared = gap * gap;
    for (int64_t axis = first + 1; axis < end; ++axis) {
        gap = point[BLOCK * axis] - reach->low[axis];
        squared += gap * gap;
    }
    return squared;
}

/* Put those of some points of a block out of reach that are outside of the range. */
static void settle_range(const double *coords, int64_t block, unsigned bits, const Reach *reach,
                         uint8_t *keys)
{
    for (; bits; bits &= bits - 1) {
        int lane = lowest_bit(bits);
        double squared = squared_gap_at(coords, reach->n_metric, reach->n_axes, reach,
                                        BLOCK * block + lane);
        if (!(squared <= reach->squared_range)) keys[lane] = OUTSIDE;
    }
}

/* Put out of reach candidates beyond the count that are as far away as the farthest, those of
 * highest ids. */
static void drop_ties(Found *found, int64_t excess, const int64_t *ids)
{
    double *equal = found->squared + found->n_few, highest;
    int64_t n = 0;
    for (int64_t j = 0; j < found->n_few; ++j)
        if (found->squared[j] == found->squared_radius)
            equal[n++] = (double)ids[place_of(found, found->few[j])];
    highest = of_rank(equal, n, n - excess);
    for (int64_t j = 0; j < found->n_few; ++j)
        if (found->squared[j] == found->squared_radius &&
            (double)ids[place_of(found, found->few[j])] > highest)
            found->keys[found->few[j]] = OUTSIDE;
}

/* Note how far away the few are; those beyond the limit are out of reach, and none of them. */
static void look_at_few(const double *coords, const Reach *reach, Found *found)
{
    int64_t n = 0;
    for (int64_t j = 0; j < found->n_few; ++j) {
        int32_t candidate = found->few[j];
        double squared = squared_gap_at(coords, 0, reach->n_metric, reach,
                                        place_of(found, candidate));
        found->few[n] = candidate;
        found->squared[n] = squared;
        if (squared <= reach->squared_limit)
            ++n;
        else
            found->keys[candidate] = OUTSIDE;
    }
    found->n_few = n;
}

/* The squared distance of a rank, counted from one, among the few. */
static double few_of_rank(const Found *found, int64_t rank)
{
    const double *x = found->squared;
    double *spare = found->squared + found->n_few;
    if (found->n_few == 1) return x[0];
    if (found->n_few == 2) return (x[0] < x[1]) == (rank == 1) ? x[0] : x[1];
    memcpy(spare, x, found->n_few * sizeof(double));
    return of_rank(spare, found->n_few, rank);
}

/* Choose among the few what is found; `fewer` of all are nearer than these. */
static void choose_few(Found *found, int64_t fewer, const int64_t *ids)
{
    int64_t excess = fewer - found->count;
    found->squared_radius = few_of_rank(found, found->count - fewer);
    for (int64_t j = 0; j < found->n_few; ++j) {
        int chosen = found->squared[j] <= found->squared_radius;
        found->keys[found->few[j]] = chosen ? (uint8_t)found->key : OUTSIDE;
        excess += chosen;
    }
    if (excess > 0) drop_ties(found, excess, ids);
}

static void find_nothing(Found *found)
{
    found->count = found->n_few = found->n_blocks = 0;
    found->key = 0;
    found->squared_radius = 0.0;
}

/* ---- Any processor ---- */
#define SET_SUFFIX portable
#define SET_NAME "portable"
#define TARGET
#define WIDTH 1
#define VECTOR double
#define MASK unsigned
#define SET(x) (x)
#define LOAD(x) (*(x))
#define STORE(x, v) (*(x) = (v))
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

#include "lanes_body.h"

#if defined(__x86_64__)
#include <immintrin.h>

/* ---- AVX2 ---- */
#define SET_SUFFIX avx2
#define SET_NAME "avx2"
#define TARGET __attribute__((target("avx2,popcnt,bmi")))
#define WIDTH 4
#define VECTOR __m256d
#define MASK __m256d
#define SET(x) _mm256_set1_pd(x)
#define LOAD(x) _mm256_loadu_pd(x)
#define STORE(x, v) _mm256_storeu_pd(x, v)
#define ADD(a, b) _mm256_add_pd(a, b)
#define SUB(a, b) _mm256_sub_pd(a, b)
#define MUL(a, b) _mm256_mul_pd(a, b)
#define DIV(a, b) _mm256_div_pd(a, b)
#define MAX(a, b) _mm256_max_pd(a, b)
#define MIN(a, b) _mm256_min_pd(a, b)
#define SQRT(a) _mm256_sqrt_pd(a)
#define AT_MOST(a, b) _mm256_cmp_pd(a, b, _CMP_LE_OQ)
#define BOTH(a, b) _mm256_and_pd(a, b)
#define BITS(m) ((unsigned)_mm256_movemask_pd(m))
#define PICK(m, a, b) _mm256_blendv_pd(b, a, m)
#define PACK(to, bits, v) pack_four(to, bits, v)
#define CHOOSE(bits)                                                                     \
    _mm256_castsi256_pd(_mm256_cmpeq_epi64(                                              \
        _mm256_and_si256(_mm256_set1_epi64x(bits), _mm256_setr_epi64x(1, 2, 4, 8)),      \
        _mm256_setr_epi64x(1, 2, 4, 8)))
#define F_WIDTH 8
#define F_VECTOR __m256
#define F_MASK __m256
#define F_SET(x) _mm256_set1_ps(x)
#define F_LOAD(x) _mm256_loadu_ps(x)
#define F_STORE(x, v) _mm256_storeu_ps(x, v)
#define F_STORE_INTEGERS(x, v) _mm256_storeu_si256((__m256i *)(x), _mm256_cvttps_epi32(v))
#define F_ADD(a, b) _mm256_add_ps(a, b)
#define F_SUB(a, b) _mm256_sub_ps(a, b)
#define F_MUL(a, b) _mm256_mul_ps(a, b)
#define F_MAX(a, b) _mm256_max_ps(a, b)
#define F_MIN(a, b) _mm256_min_ps(a, b)
#define F_AT_MOST(a, b) _mm256_cmp_ps(a, b, _CMP_LE_OQ)
#define F_BOTH(a, b) _mm256_and_ps(a, b)
#define F_BITS(m) ((unsigned)_mm256_movemask_ps(m))
#define F_PICK(m, a, b) _mm256_blendv_ps(b, a, m)
#define STORE_ROUNDED(to, v) _mm_storeu_ps(to, _mm256_cvtpd_ps(v))

#define LANE(i) 2 * (i), 2 * (i) + 1
#define ROW(a, b, c, d) {LANE(a), LANE(b), LANE(c), LANE(d)}
/* Which lanes of a mask lie one behind the other. */
static const int32_t PACKED[16][8] = {
    ROW(0, 0, 0, 0), ROW(0, 0, 0, 0), ROW(1, 0, 0, 0), ROW(0, 1, 0, 0),
    ROW(2, 0, 0, 0), ROW(0, 2, 0, 0), ROW(1, 2, 0, 0), ROW(0, 1, 2, 0),
    ROW(3, 0, 0, 0), ROW(0, 3, 0, 0), ROW(1, 3, 0, 0), ROW(0, 1, 3, 0),
    ROW(2, 3, 0, 0), ROW(0, 2, 3, 0), ROW(1, 2, 3, 0), ROW(0, 1, 2, 3),
};

static INLINE void pack_four(void *to, unsigned mask, __m256d v)
{
    __m256i order = _mm256_loadu_si256((const __m256i *)PACKED[mask]);
    __m256i packed = _mm256_permutevar8x32_epi32(_mm256_castpd_si256(v), order);
    _mm256_storeu_pd(to, _mm256_castsi256_pd(packed));
}

static INLINE uint64_t keys_at_most_avx2(const uint8_t *keys, int most)
{
    __m256i limit = _mm256_set1_epi8((char)most);
    __m256i a = _mm256_loadu_si256((const __m256i *)keys);
    __m256i b = _mm256_loadu_si256((const __m256i *)(keys + 32));
    uint32_t low = (uint32_t)_mm256_movemask_epi8(_mm256_cmpeq_epi8(_mm256_min_epu8(a, limit), a));
    uint32_t high = (uint32_t)_mm256_movemask_epi8(_mm256_cmpeq_epi8(_mm256_min_epu8(b, limit), b));
    return (uint64_t)high << 32 | low;
}

static INLINE uint64_t keys_next_to_avx2(const uint8_t *keys, int key)
{
    __m256i less = _mm256_set1_epi8((char)(key - 1)), two = _mm256_set1_epi8(2);
    __m256i a = _mm256_sub_epi8(_mm256_loadu_si256((const __m256i *)keys), less);
    __m256i b = _mm256_sub_epi8(_mm256_loadu_si256((const __m256i *)(keys + 32)), less);
    uint32_t low = (uint32_t)_mm256_movemask_epi8(_mm256_cmpeq_epi8(_mm256_min_epu8(a, two), a));
    uint32_t high = (uint32_t)_mm256_movemask_epi8(_mm256_cmpeq_epi8(_mm256_min_epu8(b, two), b));
    return (uint64_t)high << 32 | low;
}

static INLINE uint64_t keys_equal_avx2(const uint8_t *keys, int key)
{
    __m256i same = _mm256_set1_epi8((char)key);
    __m256i a = _mm256_loadu_si256((const __m256i *)keys);
    __m256i b = _mm256_loadu_si256((const __m256i *)(keys + 32));
    uint32_t low = (uint32_t)_mm256_movemask_epi8(_mm256_cmpeq_epi8(a, same));
    uint32_t high = (uint32_t)_mm256_movemask_epi8(_mm256_cmpeq_epi8(b, same));
    return (uint64_t)high << 32 | low;
}

#define store_keys_avx2(to, v)                                                            \
    do {                                                                                  \
        V8 key = (v);                                                                     \
        __m128i four = _mm_packs_epi32(_mm256_cvttpd_epi32(key.part[0]),                  \
                                       _mm256_cvttpd_epi32(key.part[1]));                 \
        _mm_storel_epi64((__m128i *)(to), _mm_packus_epi16(four, four));                  \
    } while (0)

#define store_f_keys_avx2(to, v)                                                          \
    do {                                                                                  \
        F16 f_key = (v);                                                                  \
        __m256i words = _mm256_permute4x64_epi64(                                         \
            _mm256_packs_epi32(_mm256_cvttps_epi32(f_key.part[0]),                        \
                               _mm256_cvttps_epi32(f_key.part[1])), 0xD8);                \
        _mm_storeu_si128((__m128i *)(to),                                                 \
                         _mm_packus_epi16(_mm256_castsi256_si128(words),                  \
                                          _mm256_extracti128_si256(words, 1)));           \
    } while (0)

#include "lanes_body.h"

/* ---- AVX-512 ---- */
#define SET_SUFFIX avx512
#define SET_NAME "avx512"
#define TARGET __attribute__((target("avx512f,avx512bw,avx512dq,avx512vl,popcnt,bmi")))
#define WIDTH 8
#define VECTOR __m512d
#define MASK __mmask8
#define SET(x) _mm512_set1_pd(x)
#define LOAD(x) _mm512_loadu_pd(x)
#define STORE(x, v) _mm512_storeu_pd(x, v)
#define ADD(a, b) _mm512_add_pd(a, b)
#define SUB(a, b) _mm512_sub_pd(a, b)
#define MUL(a, b) _mm512_mul_pd(a, b)
#define DIV(a, b) _mm512_div_pd(a, b)
#define MAX(a, b) _mm512_max_pd(a, b)
#define MIN(a, b) _mm512_min_pd(a, b)
#define SQRT(a) _mm512_sqrt_pd(a)
#define AT_MOST(a, b) _mm512_cmp_pd_mask(a, b, _CMP_LE_OQ)
#define BOTH(a, b) ((__mmask8)((a) & (b)))
#define BITS(m) ((unsigned)(m))
#define PICK(m, a, b) _mm512_mask_blend_pd(m, b, a)
#define PACK(to, bits, v) _mm512_storeu_pd(to, _mm512_maskz_compress_pd((__mmask8)(bits), v))
#define CHOOSE(bits) ((__mmask8)(bits))
#define F_WIDTH 16
#define F_VECTOR __m512
#define F_MASK __mmask16
#define F_SET(x) _mm512_set1_ps(x)
#define F_LOAD(x) _mm512_loadu_ps(x)
#define F_STORE(x, v) _mm512_storeu_ps(x, v)
#define F_STORE_INTEGERS(x, v) _mm512_storeu_si512(x, _mm512_cvttps_epi32(v))
#define F_ADD(a, b) _mm512_add_ps(a, b)
#define F_SUB(a, b) _mm512_sub_ps(a, b)
#define F_MUL(a, b) _mm512_mul_ps(a, b)
#define F_MAX(a, b) _mm512_max_ps(a, b)
#define F_MIN(a, b) _mm512_min_ps(a, b)
#define F_AT_MOST(a, b) _mm512_cmp_ps_mask(a, b, _CMP_LE_OQ)
#define F_BOTH(a, b) ((__mmask16)((a) & (b)))
#define F_BITS(m) ((unsigned)(m))
#define F_PICK(m, a, b) _mm512_mask_blend_ps(m, b, a)
#define STORE_ROUNDED(to, v) _mm256_storeu_ps(to, _mm512_cvtpd_ps(v))

static INLINE uint64_t keys_at_most_avx512(const uint8_t *keys, int most)
{
    return _mm512_cmple_epu8_mask(_mm512_loadu_si512(keys), _mm512_set1_epi8((char)most));
}

static INLINE uint64_t keys_next_to_avx512(const uint8_t *keys, int key)
{
    __m512i above = _mm512_sub_epi8(_mm512_loadu_si512(keys), _mm512_set1_epi8((char)(key - 1)));
    return _mm512_cmple_epu8_mask(above, _mm512_set1_epi8(2));
}

static INLINE uint64_t keys_equal_avx512(const uint8_t *keys, int key)
{
    return _mm512_cmpeq_epu8_mask(_mm512_loadu_si512(keys), _mm512_set1_epi8((char)key));
}

#define store_keys_avx512(to, v) \
    _mm_storel_epi64((__m128i *)(to), _mm256_cvtepi32_epi8(_mm512_cvttpd_epi32((v).part[0])))

#define store_f_keys_avx512(to, v)   \
    _mm_storeu_si128((__m128i *)(to), _mm512_cvtepi32_epi8(_mm512_cvttps_epi32((v).part[0])))

#include "lanes_body.h"
#endif

static const Lanes *widest(void)
{
#if defined(__x86_64__)
    __builtin_cpu_init();
    if (__builtin_cpu_supports("avx512f") && __builtin_cpu_supports("avx512bw") &&
        __builtin_cpu_supports("avx512dq") && __builtin_cpu_supports("avx512vl"))
        return &lanes_avx512;
    if (__builtin_cpu_supports("avx2")) return &lanes_avx2;
#endif
    return &lanes_portable;
}

const Lanes *lanes_named(const char *name)
{
    const Lanes *best = widest();
    if (name[0] == '\0' || strcmp(name, best->name) == 0) return best;
    if (strcmp(name, "portable") == 0) return &lanes_portable;
#if defined(__x86_64__)
    if (strcmp(name, "avx2") == 0 && best == &lanes_avx512) return &lanes_avx2;
#endif
    return NULL;
}
