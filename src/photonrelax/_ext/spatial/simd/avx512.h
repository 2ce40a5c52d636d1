/* What body.h needs to know of AVX-512. */
#define SET_SUFFIX avx512
#define SET_NAME "avx512"
#define TARGET __attribute__((target("avx512f,avx512bw,avx512dq,avx512vl,popcnt,bmi")))
#define WIDTH 8
#define VECTOR __m512d
#define MASK __mmask8
#define SET(x) _mm512_set1_pd(x)
#define LOAD(x) _mm512_loadu_pd(x)
#define STORE(x, v) _mm512_storeu_pd(x, v)
#define STREAM(x, v) _mm512_stream_pd(x, v)
#define ADD(a, b) _mm512_add_pd(a, b)
#define SUB(a, b) _mm512_sub_pd(a, b)
#define MUL(a, b) _mm512_mul_pd(a, b)
#define DIV(a, b) _mm512_div_pd(a, b)
#define MAX(a, b) _mm512_max_pd(a, b)
#define MIN(a, b) _mm512_min_pd(a, b)
#define SQRT(a) _mm512_sqrt_pd(a)
#define TOTAL(a) \
    total_of_four(_mm256_add_pd(_mm512_castpd512_pd256(a), _mm512_extractf64x4_pd(a, 1)))
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
#define F_ADD_WHERE(m, a, b) _mm512_mask_add_ps(a, m, a, b)
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

#define store_keys_avx512(to, v) \
    _mm_storel_epi64((__m128i *)(to), _mm256_cvtepi32_epi8(_mm512_cvttpd_epi32((v).part[0])))

#define store_f_keys_avx512(to, v)   \
    _mm_storeu_si128((__m128i *)(to), _mm512_cvtepi32_epi8(_mm512_cvttps_epi32((v).part[0])))
