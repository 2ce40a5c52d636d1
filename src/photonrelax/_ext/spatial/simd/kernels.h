/* SIMD kernels of the k-d tree: box tests, candidate scans, selection of the k nearest, and sums
 * over the neighbours. There is one table of kernels per instruction set; all give the same bits.
 *
 * Points are stored in blocks of 16, structure of arrays within a block: coordinate `axis` of the
 * point at place p is coords[(p / 16) * 16 * n_axes + 16 * axis + p % 16]. Lanes without a point
 * hold infinity. Boxes are stored likewise, in groups of 16: the lower bounds, then the upper
 * bounds, axis by axis; lanes without a box hold infinity and minus infinity.
 */
#ifndef PHOTONRELAX_SIMD_KERNELS_H
#define PHOTONRELAX_SIMD_KERNELS_H

#include <stdint.h>

enum {
    BLOCK = 16,
    /* Doubles of a vector. */
    LANES = 8,
    /* Rank keys are bytes. Candidates within the limit have keys up to LIMIT_KEY, or one more, as
     * float32 distances are rounded; candidates out of range or well beyond the limit have
     * OUTSIDE_KEY. */
    LIMIT_KEY = 250,
    OUTSIDE_KEY = 255,
    /* Rank keys compared at once, and the largest number of such chunks of a query that is
     * selected together with others. */
    KEY_CHUNK = 64,
    MAX_UNROLLED_CHUNKS = 4,
    /* Queries whose selections run interleaved. */
    INTERLEAVED = 4,
    /* Points of more axes are not searched in float32. */
    MAX_FLOAT_AXES = 12
};

/* Region around a point (low == high) or a box that neighbours have to lie in: squared distance at
 * most `squared_limit` (finite) over the first n_metric axes; over the others, the range axes,
 * squared distance at most `squared_range`, unless that is negative, and an offset of at most
 * `half_range` on each, unless that is NULL. */
typedef struct {
    const double *low, *high;
    double squared_limit, squared_range;
    const double *half_range;
    int64_t n_metric, n_axes;
} SearchBounds;

/* Map to float32 coordinates, (x - origin) * scale, chosen so that the search bounds lie within
 * [-1, 1]; range axes have a scale of their own. */
typedef struct {
    const double *origin;
    double scale, range_scale;
    int64_t n_metric, n_axes;
} Quantisation;

/* A query in float32 coordinates, and bounds on the errors of squared distances there. */
typedef struct {
    const float *at;
    float squared_limit, squared_range;
    float limit_slack, range_slack;
    /* Bound on the error of the difference of two scaled distances. */
    float rank_slack;
} FloatQuery;

/* The points of some blocks, and the k nearest of them.
 *
 * Scaled distances are squared distances in units of squared_limit / LIMIT_KEY; rank keys are
 * scaled distances rounded down, or OUTSIDE_KEY. Both are stored block by block, with room for
 * MAX_UNROLLED_CHUNKS * KEY_CHUNK more keys. The `count` neighbours selected are the candidates of
 * keys up to `max_rank_key`; the farthest is at `squared_radius`, and among the `n_ties` candidates
 * whose float32 rank was ambiguous. Of these the exact squared distances are kept. `ties`,
 * `tie_squared` and `scratch` have room for all candidates. */
typedef struct {
    int32_t *blocks;
    uint8_t *rank_keys;
    float *scaled_distances;
    int64_t n_blocks, count;
    double squared_radius;
    int64_t max_rank_key, n_ties;
    int32_t *ties;
    double *tie_squared, *scratch;
} Candidates;

/* Smoothing kernel: CONSTANT, CONE, EPANECHNIKOV or GAUSSIAN, and its squared bandwidth. */
typedef struct {
    int64_t shape;
    double squared_bandwidth;
} Weights;

enum {
    CONSTANT_WEIGHTS = 0,
    CONE_WEIGHTS = 1,
    EPANECHNIKOV_WEIGHTS = 2,
    GAUSSIAN_WEIGHTS = 3
};

/* Standard deviation of the Gaussian, in bandwidths. */
#define GAUSSIAN_DEVIATION 0.41
/* Half its inverse square; the Gaussian is exp(-GAUSSIAN_EXPONENT * ratio) of the ratio of squared
 * distance to squared bandwidth, GAUSSIAN_PEAK times which integrates to pi over the unit disc. */
#define GAUSSIAN_EXPONENT (0.5 / (GAUSSIAN_DEVIATION * GAUSSIAN_DEVIATION))
#define GAUSSIAN_PEAK 3.134522134101892

/* A rectangle around a point of three metric coordinates and the range coordinates behind them.
 * Rows of `axes` are the directions of its two sides and its normal. Points within `half` of the
 * point along each are on it: half its sides, and half the thickness of a slab. With a
 * `squared_range` that is not negative the range axes are limited as those of SearchBounds. */
typedef struct {
    const double *at;
    double axes[9], half[3];
    double squared_range;
    int64_t n_axes;
} Rectangle;

/* Weights of a rectangle convolved with a Gaussian, cut off at a squared radius, but for a factor.
 * Along a side that is not much shorter than the Gaussian's deviation it is a difference of two
 * normal distributions; along one that is, where `is_narrow`, the Gaussian times a polynomial in
 * the squared offset, `series`. */
typedef struct {
    double squared_radius, inverse_deviation;
    int64_t is_narrow[2];
    double series[2][4];
} RectangleWeights;

/* Mean over a rectangle of a Gaussian of any covariance, but for a factor: over the first side by
 * nodes, in [-1, 1], and weights; over the second, `half` a side in deviations, by the normal
 * distribution given the offset along the first. Its middle is at `slope` times that offset. Scales
 * are inverse deviations. Where `is_narrow` it is the density times a polynomial in the squared
 * offset, `series`. */
typedef struct {
    int64_t n_nodes;
    const double *nodes, *weights;
    double first_half, first_scale, slope, second_scale, half, series[4];
    int64_t is_narrow;
} SlantedWeights;

enum {
    /* Terms of a quadratic map of a plane: 1, a, b, a^2 / 2, ab, b^2 / 2. */
    QUADRATIC_TERMS = 6,
    /* Points of half a lattice, in whole vectors, and keys of all, in whole chunks. */
    LATTICE_HALF = 48,
    LATTICE_KEYS = 128
};

/* Vectors that cross cache lines are slow. */
#define CACHE_ALIGNED __attribute__((aligned(64)))

/* Offsets from the points of eight queries, up to KEY_CHUNK each, nearest first, those at zero among
 * them: (a, b), and those that they are mapped to. */
typedef struct {
    double a[KEY_CHUNK][LANES], b[KEY_CHUNK][LANES], u[KEY_CHUNK][LANES], v[KEY_CHUNK][LANES];
} CACHE_ALIGNED MapSamples;

/* Quadratic maps of eight queries.
 *
 * Offsets (a, b) are in units of the radius of those fitted, (u, v) in units of `scale`. Where the
 * fit is not unique coefficients are no numbers. `residual` is the root mean square of what maps
 * leave, `unevenness` the length of the repulsion of SJ13 Eq. 8 by the offsets (a, b) that are
 * fitted, and (sum_a, sum_b) the sum of all. */
typedef struct {
    double u[QUADRATIC_TERMS][LANES], v[QUADRATIC_TERMS][LANES];
    double scale[LANES], residual[LANES], unevenness[LANES], sum_a[LANES], sum_b[LANES];
} CACHE_ALIGNED QuadraticMaps;

/* Quadratic map of a lattice, without constant term. Points are left in whose product with
 * `inward` is at least `edge`. */
typedef struct {
    double u[QUADRATIC_TERMS - 1], v[QUADRATIC_TERMS - 1], inward[2], edge;
} LatticeMap;

/* Kernels of one instruction set. `blocks` with `bits` are those of 16 blocks whose bits are set. */
typedef struct {
    const char *name;
    /* Bitmask of the 16 boxes that overlap the search bounds. Box rows are `stride` doubles
     * apart. */
    unsigned (*overlapping_boxes)(const double *boxes, int64_t stride, const SearchBounds *bounds);
    /* The same in float32; the mask may include boxes just outside. */
    unsigned (*overlapping_float_boxes)(const float *boxes, int64_t stride,
                                        const SearchBounds *bounds, const FloatQuery *query);
    /* Compress the boxes of a bitmask into consecutive columns of `target`; columns behind them
     * are overwritten. */
    void (*pack_boxes)(const double *boxes, int64_t n_axes, unsigned bits, double *target,
                       int64_t stride);
    /* Convert rows of n coordinates, one row per axis, to float32. */
    void (*quantise_rows)(const double *rows, int64_t stride, int64_t n,
                          const Quantisation *quantisation, float *target);
    /* Convert n blocks to float32. */
    void (*quantise_blocks)(const double *coords, const int32_t *blocks, int64_t n,
                            const Quantisation *quantisation, float *target);
    /* Append the points of blocks to the candidates; the bounds are around a point. */
    void (*scan_blocks)(const double *coords, const int32_t *blocks, unsigned bits,
                        const SearchBounds *bounds, Candidates *found);
    /* The same from float32 blocks. */
    void (*scan_float_blocks)(const double *coords, const float *float_blocks,
                              const int32_t *blocks, unsigned bits, const SearchBounds *bounds,
                              const FloatQuery *query, Candidates *found);
    /* Recompute the rank keys of all candidates after the bounds have changed. */
    void (*rescan)(const double *coords, const SearchBounds *bounds, Candidates *found);
    /* Select the k nearest candidates, ties by id, or all within the bounds if they are fewer; for
     * up to INTERLEAVED queries at once. */
    void (*select_nearest)(const double *coords, const SearchBounds *const *bounds,
                           const float *rank_slack, Candidates *const *found, int n, int64_t k,
                           const int64_t *ids);
    /* Drop the blocks that have no neighbour selected; the others have to be rescanned. */
    void (*compact)(Candidates *found);
    /* Write squared distances and ids of the neighbours, unordered; up to LANES more are
     * overwritten. Avoid reading the output immediately: store-to-load forwarding stalls. */
    void (*gather_neighbours)(const double *coords, const SearchBounds *bounds,
                              const Candidates *found, const int64_t *ids, double *squared,
                              int64_t *id);
    /* Write three coordinates of the neighbours, rows of count + LANES per axis. */
    void (*gather_points)(const double *coords, int64_t n_axes, const Candidates *found,
                          double *points);
    /* Sort up to KEY_CHUNK neighbours by distance, but for those whose squared distances differ by
     * less than a 50,000-th of the largest. */
    void (*sort_neighbours)(const double *squared, const int64_t *id, int64_t count,
                            double squared_radius, double *sorted, int64_t *sorted_id);
    /* Finish the sort, by distance and then by id, and write distances and ids. With `streaming`,
     * non-temporal stores: count is a multiple of LANES and rows are aligned to cache lines. */
    void (*write_neighbours)(double *squared, int64_t *id, int64_t count, int streaming,
                             double *distance, int64_t *to_id);
    /* Covariance uu, uv, vv, and mean u, v, of the offsets of the neighbours from a point along
     * the two vectors of `frame`. */
    void (*moments)(const double *coords, int64_t n_axes, const Candidates *found,
                    const double *at, const double *frame, double *out);
    /* Repulsion of SJ13 Eq. 8 on a point by gathered neighbours: the mean of the offsets from them
     * times (radius / distance - 1). */
    void (*repulsion)(double *points, int64_t count, double squared_radius, const double *at,
                      double *out);
    /* Weighted sums over the neighbours of `values`, which are stored like coordinates; the weights
     * are those of a kernel that integrates to pi times the squared bandwidth. */
    void (*weighted_sum)(const double *coords, const SearchBounds *bounds, const Candidates *found,
                         const Weights *weights, const double *values, int64_t n_channels,
                         double *out);
    /* Bitmask of the 16 boxes that may hold a point within a squared distance of a rectangle, and
     * of those that lie on it, `margin` inside its sides; of none, if that is negative. */
    unsigned (*boxes_near_rectangle)(const double *boxes, const Rectangle *rectangle,
                                     double squared_limit, double margin, unsigned *deep);
    /* Append the squared distances from a rectangle, above `squared_low` and up to `squared_high`,
     * of points of n blocks to `band`, which has room for `capacity` and LANES more. Returns their
     * number, which may exceed the room, and adds the number of points up to `squared_low`. */
    int64_t (*rectangle_band)(const double *coords, const int32_t *blocks, int64_t n,
                              const Rectangle *rectangle, double squared_low, double squared_high,
                              double *band, int64_t capacity, int64_t *n_low);
    /* Weighted sums over the points of n blocks of `values`, which are stored like coordinates. */
    void (*rectangle_sum)(const double *coords, const int32_t *blocks, int64_t n,
                          const Rectangle *rectangle, const RectangleWeights *weights,
                          const double *values, int64_t n_channels, double *out);
    /* Weights at 16 offsets along both sides. */
    void (*slanted_weights)(const double *first, const double *second,
                            const SlantedWeights *weights, double *out);
    /* Fit quadratic maps to the first n_fitted of n samples, with weights exp(-squared offset), and
     * scale the samples as they are. */
    void (*fit_maps)(MapSamples *samples, int64_t n, int64_t n_fitted, QuadraticMaps *maps);
    /* Repulsion of SJ13 Eq. 8 on a point by the `nearest` points of a lattice around it that is
     * mapped. Returns the radius of an even disc of their mean squared distance, about the square
     * root of `expected`; zero if they are not as many or it is not finite. Rows of the lattice
     * are the terms, without the first, at one of each two points opposite, and first at its
     * centre. */
    double (*lattice_repulsion)(const double *lattice, const LatticeMap *map, double expected,
                                int64_t nearest, double *force);
} SimdKernels;

static inline int lowest_bit(unsigned bits) { return __builtin_ctz(bits); }
static inline int count_bits(unsigned bits) { return __builtin_popcount(bits); }
static inline int highest_bit(unsigned bits) { return 31 - __builtin_clz(bits); }

static inline int64_t candidate_place(const Candidates *found, int64_t candidate)
{
    return BLOCK * (int64_t)found->blocks[candidate / BLOCK] + candidate % BLOCK;
}

/* The farthest neighbour selected, of equally far ones that of the highest id; -1 if none is. */
static inline int64_t farthest_candidate(const Candidates *found, const int64_t *ids)
{
    int64_t farthest = -1;
    for (int64_t j = 0; j < found->n_ties; ++j) {
        int64_t candidate = found->ties[j];
        if (found->tie_squared[j] != found->squared_radius ||
            found->rank_keys[candidate] > found->max_rank_key)
            continue;
        if (farthest < 0 ||
            ids[candidate_place(found, candidate)] > ids[candidate_place(found, farthest)])
            farthest = candidate;
    }
    return farthest;
}

/* Order non-temporal stores before the stores that follow. */
static inline void store_fence(void)
{
#if defined(__SSE__)
    __builtin_ia32_sfence();
#endif
}

/* Kernels by name: avx512, avx2 or portable; for the empty name, the widest the processor has. NULL
 * if the processor does not have them. */
#ifdef __cplusplus
extern "C"
#endif
const SimdKernels *simd_kernels_named(const char *name);

#endif
