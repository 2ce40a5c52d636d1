/* One set of loops for each instruction set, and the choice among them. */
#include "kernels.h"

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

/* The search for the key of the k-th nearest candidate: `fewer` are known to have a lesser one. */
typedef struct {
    const uint8_t *rank_keys;
    int64_t k, fewer;
    int key;
} Ranked;

/* What makes keys of squared distances up to a limit. */
static inline double key_scale(double squared_limit)
{
    return squared_limit > 1e-300 ? LIMIT_KEY / squared_limit : 0.0;
}

static inline int64_t n_chunks(const Candidates *found)
{
    return (BLOCK * found->n_blocks + KEY_CHUNK - 1) / KEY_CHUNK;
}

/* Which bytes are not zero, as bits. */
static ALWAYS_INLINE uint64_t bytes_not_zero(uint64_t x)
{
    x |= x >> 4;
    x |= x >> 2;
    x |= x >> 1;
    return (x & 0x0101010101010101u) * 0x0102040810204080u >> 56;
}

/* The greatest key of what may be within the limit or is just beyond it. */
static ALWAYS_INLINE int greatest_key(const Candidates *found)
{
    uint8_t greatest = 0;
    for (int64_t j = 0; j < BLOCK * found->n_blocks; ++j) {
        uint8_t key = found->rank_keys[j] <= LIMIT_KEY + 1 ? found->rank_keys[j] : 0;
        greatest = key > greatest ? key : greatest;
    }
    return greatest;
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
        bits = (bits & ~(uint32_t)(KEY_CHUNK - 1)) | (uint32_t)j;
        memcpy(keys + j, &bits, sizeof bits);
    }
}

/* Sort by insertion what is nearly sorted: by squared distance, then id. */
static void sort_exactly(double *squared, int64_t *id, int64_t count)
{
    for (int64_t j = 1; j < count; ++j) {
        double x = squared[j];
        int64_t own = id[j], hole = j;
        while (hole > 0 &&
               (squared[hole - 1] > x || (squared[hole - 1] == x && id[hole - 1] > own))) {
            squared[hole] = squared[hole - 1];
            id[hole] = id[hole - 1];
            --hole;
        }
        squared[hole] = x;
        id[hole] = own;
    }
}

static ALWAYS_INLINE double squared_gap_at(const double *coords, int64_t first, int64_t end,
                                           const SearchBounds *reach, int64_t place)
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
static void settle_range(const double *coords, int64_t block, unsigned bits, const SearchBounds *reach,
                         uint8_t *keys)
{
    for (; bits; bits &= bits - 1) {
        int lane = lowest_bit(bits);
        double squared = squared_gap_at(coords, reach->n_metric, reach->n_axes, reach,
                                        BLOCK * block + lane);
        if (!(squared <= reach->squared_range)) keys[lane] = OUTSIDE_KEY;
    }
}

/* Put out of reach candidates beyond the count that are as far away as the farthest, those of
 * highest ids. */
static void drop_ties(Candidates *found, int64_t excess, const int64_t *ids)
{
    double *equal = found->scratch, highest;
    int64_t n = 0;
    for (int64_t j = 0; j < found->n_ties; ++j)
        if (found->tie_squared[j] == found->squared_radius)
            equal[n++] = (double)ids[candidate_place(found, found->ties[j])];
    highest = of_rank(equal, n, n - excess);
    for (int64_t j = 0; j < found->n_ties; ++j)
        if (found->tie_squared[j] == found->squared_radius &&
            (double)ids[candidate_place(found, found->ties[j])] > highest)
            found->rank_keys[found->ties[j]] = OUTSIDE_KEY;
}

/* Note how far away the few are; those beyond the limit are out of reach, and none of them. */
static ALWAYS_INLINE void look_at_few(const double *coords, const SearchBounds *reach, Candidates *found)
{
    int64_t n = 0;
    for (int64_t j = 0; j < found->n_ties; ++j) {
        int32_t candidate = found->ties[j];
        double squared = squared_gap_at(coords, 0, reach->n_metric, reach,
                                        candidate_place(found, candidate));
        found->ties[n] = candidate;
        found->tie_squared[n] = squared;
        if (squared <= reach->squared_limit)
            ++n;
        else
            found->rank_keys[candidate] = OUTSIDE_KEY;
    }
    found->n_ties = n;
}

/* Choose the only one of the few; most often there is no other. */
static ALWAYS_INLINE void choose_only(Candidates *found)
{
    found->squared_radius = found->tie_squared[0];
    found->rank_keys[found->ties[0]] = (uint8_t)found->max_rank_key;
}

/* The squared distance of a rank, counted from one, among the few. */
static double few_of_rank(const Candidates *found, int64_t rank)
{
    const double *x = found->tie_squared;
    if (found->n_ties == 2) return (x[0] < x[1]) == (rank == 1) ? x[0] : x[1];
    memcpy(found->scratch, x, found->n_ties * sizeof(double));
    return of_rank(found->scratch, found->n_ties, rank);
}

/* Choose among the few what is found; `fewer` of all are nearer than these. */
static void choose_few(Candidates *found, int64_t fewer, const int64_t *ids)
{
    int64_t excess = fewer - found->count;
    found->squared_radius = few_of_rank(found, found->count - fewer);
    for (int64_t j = 0; j < found->n_ties; ++j) {
        int chosen = found->tie_squared[j] <= found->squared_radius;
        found->rank_keys[found->ties[j]] = chosen ? (uint8_t)found->max_rank_key : OUTSIDE_KEY;
        excess += chosen;
    }
    if (excess > 0) drop_ties(found, excess, ids);
}

static void find_nothing(Candidates *found)
{
    found->count = found->n_ties = found->n_blocks = 0;
    found->max_rank_key = 0;
    found->squared_radius = 0.0;
}

#include "portable.h"

#include "body.h"

#if defined(__x86_64__)
#include <immintrin.h>

#include "avx2.h"

#include "body.h"

#include "avx512.h"

#include "body.h"
#endif

static const SimdKernels *widest(void)
{
#if defined(__x86_64__)
    __builtin_cpu_init();
    if (!__builtin_cpu_supports("popcnt") || !__builtin_cpu_supports("bmi")) return &lanes_portable;
    if (__builtin_cpu_supports("avx512f") && __builtin_cpu_supports("avx512bw") &&
        __builtin_cpu_supports("avx512dq") && __builtin_cpu_supports("avx512vl"))
        return &lanes_avx512;
    if (__builtin_cpu_supports("avx2")) return &lanes_avx2;
#endif
    return &lanes_portable;
}

const SimdKernels *simd_kernels_named(const char *name)
{
    const SimdKernels *best = widest();
    if (name[0] == '\0' || strcmp(name, best->name) == 0) return best;
    if (strcmp(name, "portable") == 0) return &lanes_portable;
#if defined(__x86_64__)
    if (strcmp(name, "avx2") == 0 && best == &lanes_avx512) return &lanes_avx2;
#endif
    return NULL;
}
