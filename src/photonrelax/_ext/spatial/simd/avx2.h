/* What body.h needs to know of AVX2. */
#define SET_SUFFIX avx2
#define SET_NAME "avx2"
#define TARGET __attribute__((target("avx2,popcnt,bmi")))
#define WIDTH 4
#define VECTOR __m256d
#define MASK __m256d
#define SET(x) _mm256_set1_pd(x)
#define LOAD(x) _mm256_loadu_pd(x)
#define STORE(x, v) _mm256_storeu_pd(x, v)
#define STREAM(x, v) _mm256_stream_pd(x, v)
#define ADD(a, b) _mm256_add_pd(a, b)
#define SUB(a, b) _mm256_sub_pd(a, b)
#define MUL(a, b) _mm256_mul_pd(a, b)
#define DIV(a, b) _mm256_div_pd(a, b)
#define MAX(a, b) _mm256_max_pd(a, b)
#define MIN(a, b) _mm256_min_pd(a, b)
#define SQRT(a) _mm256_sqrt_pd(a)
#define TOTAL(a) total_of_four(a)
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
#define F_ADD_WHERE(m, a, b) _mm256_add_ps(a, _mm256_and_ps(m, b))
#define STORE_ROUNDED(to, v) _mm_storeu_ps(to, _mm256_cvtpd_ps(v))

static INLINE double total_of_four(__m256d a)
{
    __m128d two = _mm_add_pd(_mm256_castpd256_pd128(a), _mm256_extractf128_pd(a, 1));
    return _mm_cvtsd_f64(_mm_add_sd(two, _mm_unpackhi_pd(two, two)));
}

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
