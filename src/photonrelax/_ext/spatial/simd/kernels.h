/* Loops over eight or sixteen points at a time, in the instruction set that suits the processor.
 *
 * Points lie in blocks of 16, axis by axis: coordinate `axis` of the point at place p is
 * coords[(p / 16) * 16 * n_axes + 16 * axis + p % 16]. Lanes without a point hold infinity. Boxes
 * lie likewise, 16 together: all that is least, then all that is greatest, axis by axis; lanes
 * without a box hold infinity and its negative. Every instruction set computes the same bits.
 */
#ifndef PHOTONRELAX_LANES_H
#define PHOTONRELAX_LANES_H

#include <stdint.h>

enum {
    BLOCK = 16,
    LANES = 8,
    /* Candidates are sorted roughly by keys. Those up to FARTHEST are within the limit or, as keys
     * are off a little, just beyond it; what is out of range, or far beyond, is OUTSIDE. */
    FARTHEST = 250,
    OUTSIDE = 255,
    /* Keys are looked at so many at a time; up to FEW_CHUNKS of such, several searches look at as
     * many as the one that needs the most. */
    KEYS = 64,
    FEW_CHUNKS = 4,
    /* So many searches among candidates run side by side. */
    TOGETHER = 4,
    /* Copies bear no more axes than these. */
    MOST_COPIED_AXES = 12
};

/* What may be found from a point, or from any point of a box: squared distances up to
 * `squared_limit` (finite) over the first n_metric axes; over the others a ball, unless
 * `squared_range` is negative, and an interval of `half_range` each, unless it is NULL. */
typedef struct {
    const double *low, *high;
    double squared_limit, squared_range;
    const double *half_range;
    int64_t n_metric, n_axes;
} Reach;

/* Copies of points are floats, (x - origin) * scale, so that what is in reach lies within 1. */
typedef struct {
    const double *origin;
    double scale, range_scale;
    int64_t n_metric, n_axes;
} Frame;

/* The reach of a point among copies, and by how much squared distances may be off. */
typedef struct {
    const float *at;
    float squared_limit, squared_range;
    float limit_slack, range_slack;
    /* How much higher a candidate may seem than one that is farther away, or as far. */
    float doubt;
} Local;

/* Candidates: all points of some blocks. Their heights, squared distances as multiples of the
 * FARTHEST-th part of the limit, and keys, heights rounded down but OUTSIDE for what is not to be
 * found, lie block by block; keys have room for FEW_CHUNKS * KEYS more. Found are the `count`
 * candidates of keys up to `key`, the farthest of them at `squared_radius`. It is among the `n_few`
 * whose exact squared distances had to be looked at; there is room for as many as candidates, and
 * as many spare numbers. */
typedef struct {
    int32_t *blocks;
    uint8_t *keys;
    float *heights;
    int64_t n_blocks, count;
    double squared_radius;
    int64_t key, n_few;
    int32_t *few;
    double *squared, *spare;
} Found;

/* How much the photons found weigh: CONSTANT, CONE or EPANECHNIKOV, over a squared bandwidth. */
typedef struct {
    int64_t shape;
    double squared_bandwidth;
} Weights;

enum { CONSTANT_WEIGHTS = 0, CONE_WEIGHTS = 1, EPANECHNIKOV_WEIGHTS = 2 };

/* Blocks given with bits are those of the 16 that start there. */
typedef struct {
    const char *name;
    /* Which of 16 boxes, whose rows are `stride` apart, reach into the reach, as bits. */
    unsigned (*boxes_near)(const double *boxes, int64_t stride, const Reach *reach);
    /* The same, but some boxes just out of reach may be among them. */
    unsigned (*copies_near)(const float *boxes, int64_t stride, const Reach *reach,
                            const Local *local);
    /* Write these of 16 boxes one behind the other into rows of that stride, and more behind. */
    void (*list_boxes)(const double *boxes, int64_t n_axes, unsigned bits, double *to,
                       int64_t stride);
    /* Copy rows of n numbers, one an axis. */
    void (*copy_rows)(const double *rows, int64_t stride, int64_t n, const Frame *frame, float *to);
    /* Copy blocks. */
    void (*copy_blocks)(const double *coords, const int32_t *blocks, int64_t n, const Frame *frame,
                        float *to);
    /* Make the points of more blocks candidates; reach is from a point. */
    void (*scan)(const double *coords, const int32_t *blocks, unsigned bits, const Reach *reach,
                 Found *found);
    /* The same by their copies. */
    void (*scan_copies)(const double *coords, const float *copies, const int32_t *blocks,
                        unsigned bits, const Reach *reach, const Local *local, Found *found);
    /* Give candidates new keys, for a reach that has changed. */
    void (*rescan)(const double *coords, const Reach *reach, Found *found);
    /* Find the k nearest candidates, ties by id, all in reach if they are fewer; of several
     * searches, at most TOGETHER. */
    void (*nearest)(const double *coords, const Reach *const *reach, const float *doubt,
                    Found *const *found, int n, int64_t k, const int64_t *ids);
    /* Keep only the blocks of what was found; all in them need new keys. */
    void (*compact)(Found *found);
    /* Write squared distances and ids of what was found. Lists have room for LANES more. What is
     * listed, or sorted, is best not read at once: wide loads wait for stores. */
    void (*list)(const double *coords, const Reach *reach, const Found *found, const int64_t *ids,
                 double *squared, int64_t *id);
    /* Write three coordinates of what was found, axis by axis, count + LANES apart. */
    void (*list_points)(const double *coords, int64_t n_axes, const Found *found, double *points);
    /* Sort what was listed, at most KEYS, nearest first, but for those whose squared distances
     * differ by less than a 50,000-th of the greatest. */
    void (*sort)(const double *squared, const int64_t *id, int64_t count, double squared_radius,
                 double *to, int64_t *to_id);
    /* Write distances and ids of what was sorted so, nearest first, ties by id; past the cache, if
     * asked to: then count is a multiple of LANES and rows start where lines of the cache do. */
    void (*write)(double *squared, int64_t *id, int64_t count, int past_cache, double *distance,
                  int64_t *to_id);
    /* Second moments uu, uv, vv about the mean, divided by their number, and the mean (u, v) of the
     * offsets of what was found from a point, along the two vectors of `frame`. */
    void (*moments)(const double *coords, int64_t n_axes, const Found *found, const double *at,
                    const double *frame, double *out);
    /* The repulsion of SJ13 Eq. 8 on a point by what was listed with its coordinates: the mean of
     * the offsets from it times (radius / distance - 1). */
    void (*repulsion)(double *points, int64_t count, double squared_radius, const double *at,
                      double *out);
    /* Write the weighted sums over what was found of `values`, which lie like coordinates; a kernel
     * that has these weights integrates to pi times the squared bandwidth. */
    void (*weigh)(const double *coords, const Reach *reach, const Found *found,
                  const Weights *weights, const double *values, int64_t n_channels, double *out);
} Lanes;

static inline int lowest_bit(unsigned bits) { return __builtin_ctz(bits); }
static inline int count_bits(unsigned bits) { return __builtin_popcount(bits); }
static inline int highest_bit(unsigned bits) { return 31 - __builtin_clz(bits); }

static inline int64_t place_of(const Found *found, int64_t candidate)
{
    return BLOCK * (int64_t)found->blocks[candidate / BLOCK] + candidate % BLOCK;
}

/* Which candidate is the farthest of those found, by id of several; -1 if none was. */
static inline int64_t last_found(const Found *found, const int64_t *ids)
{
    int64_t last = -1;
    for (int64_t j = 0; j < found->n_few; ++j) {
        int64_t candidate = found->few[j];
        if (found->squared[j] == found->squared_radius && found->keys[candidate] <= found->key &&
            (last < 0 || ids[place_of(found, candidate)] > ids[place_of(found, last)]))
            last = candidate;
    }
    return last;
}

/* Have a row that will soon be read or written brought into the cache. */
static inline void prefetch_row(const void *row, int64_t n_bytes)
{
    for (int64_t i = 0; i < n_bytes - 1; i += 64) __builtin_prefetch((const char *)row + i, 1);
    __builtin_prefetch((const char *)row + n_bytes - 1, 1);
}

/* Have what was written past the cache seen by all threads. */
static inline void finish_writing(void)
{
#if defined(__SSE__)
    __builtin_ia32_sfence();
#endif
}

/* The set of that name: avx512, avx2 or portable, or for the empty name the widest this processor
 * has; NULL if it has no such set. */
#ifdef __cplusplus
extern "C"
#endif
const Lanes *lanes_named(const char *name);

#endif
