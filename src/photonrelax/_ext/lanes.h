/* Loops over eight points at a time, in the instruction set that suits the processor.
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
    /* Points are sorted roughly by keys from 0 to FARTHEST, and OUTSIDE for those out of reach. */
    FARTHEST = 254,
    OUTSIDE = 255,
    /* Keys are looked at so many at a time, in no fewer chunks than these. */
    KEYS = 64,
    FEW_CHUNKS = 4,
    /* So many searches among candidates run side by side. */
    TOGETHER = 4
};

/* What may be found from a point, or from any point of a box: squared distances up to
 * `squared_limit` (finite) over the first n_metric axes; over the others a ball, unless
 * `squared_range` is negative, and an interval of `half_range` each, unless it is NULL. */
typedef struct {
    const double *low, *high;
    double squared_limit, squared_range;
    /* What makes keys of squared distances up to the limit. */
    double key_scale;
    const double *half_range;
    int64_t n_metric, n_axes;
} Reach;

/* Candidates: all points of some blocks. Squared distances, infinite where out of reach, and keys
 * lie block by block; keys have room for FEW_CHUNKS * KEYS more than there are points, distances for
 * twice the number of points. Found are the `count`
 * candidates whose squared distance is at most `squared_radius`, that of the farthest of them. */
typedef struct {
    int32_t *blocks;
    double *squared;
    uint8_t *keys;
    int64_t n_blocks, count;
    double squared_radius;
} Found;

typedef struct {
    const char *name;
    /* Which of 16 boxes reach into the reach, as bits. */
    unsigned (*boxes_near)(const double *boxes, const Reach *reach);
    /* Make the points of more blocks candidates; reach is from a point. */
    void (*scan)(const double *coords, const int32_t *blocks, int64_t n_blocks, const Reach *reach,
                 Found *found);
    /* Find the k nearest candidates, ties by id, all in reach if they are fewer; of several
     * searches, at most TOGETHER. */
    void (*nearest)(Found *const *found, int n, int64_t k, const int64_t *ids);
    /* Keep only the blocks of what was found, put all else in them out of reach, and make keys anew. */
    void (*compact)(Found *found, double key_scale);
    /* Write squared distances and places of what was found, in the order of the places. Lists have
     * room for LANES more. What is listed is best not read at once: wide loads wait for stores. */
    void (*list)(const Found *found, double *squared, int64_t *place);
    /* The same with three coordinates instead of places, axis by axis, count + LANES apart. */
    void (*list_points)(const double *coords, int64_t n_axes, const Found *found, double *squared,
                        double *points);
    /* Write distances and ids of what was listed, at most KEYS, nearest first, ties by id. */
    void (*sorted)(double *squared, const int64_t *place, int64_t count, double squared_radius,
                   const int64_t *ids, double *distance, int64_t *id);
    /* Second moments uu, uv, vv about the mean, divided by their number, of the offsets of what was
     * found from a point, along the two directions of `frame`, multiplied by `scale` first. */
    void (*moments)(const double *coords, int64_t n_axes, const Found *found, const double *at,
                    const double *frame, double scale, double *out);
    /* The repulsion of SJ13 Eq. 8 on a point by what was listed with its coordinates: the mean of
     * the offsets from it times (radius / distance - 1). */
    void (*repulsion)(double *squared, double *points, int64_t count, double squared_radius,
                      const double *at, double *out);
} Lanes;

/* What turns squared distances up to a limit into keys up to FARTHEST. */
static inline double key_scale(double squared_limit)
{
    return squared_limit > 1e-300 ? FARTHEST / squared_limit : 0.0;
}

static inline int lowest_bit(unsigned bits) { return __builtin_ctz(bits); }
static inline int highest_bit(unsigned bits) { return 31 - __builtin_clz(bits); }

/* Have a row that will soon be read or written brought into the cache. */
static inline void prefetch_row(const void *row, int64_t n_bytes)
{
    for (int64_t i = 0; i < n_bytes; i += 64) __builtin_prefetch((const char *)row + i, 1);
}

/* The set of that name: avx512, avx2 or portable, or for the empty name the widest this processor
 * has; NULL if it has no such set. */
#ifdef __cplusplus
extern "C"
#endif
const Lanes *lanes_named(const char *name);

#endif
