/* SIMD kernels of the k-d tree, see kernels.h, for one instruction set.
 *
 * setup.py compiles this file once per set, with that set's flags. All sets work on eight doubles
 * or sixteen floats at a time and add in one order, so that they give the same bits.
 */
#include "kernels.h"

#include "selection.h"
#include "vector.h"

/* Box tests and squared distances */

/* Distances of eight boxes on one axis; zero where they overlap the bounds. */
INLINE f64x8 box_gap(const double *boxes, int64_t stride, int64_t axis, const SearchBounds *bounds)
{
    const double *low = boxes + stride * axis, *high = low + stride * bounds->n_axes;
    f64x8 below = f64x8_sub(f64x8_load(low), f64x8_set1(bounds->high[axis]));
    f64x8 above = f64x8_sub(f64x8_set1(bounds->low[axis]), f64x8_load(high));
    return f64x8_max(f64x8_max(below, above), f64x8_set1(0.0));
}

INLINE f64x8 squared_box_distance(const double *boxes, int64_t stride, int64_t first, int64_t end,
                                  const SearchBounds *bounds)
{
    f64x8 gap = box_gap(boxes, stride, first, bounds);
    f64x8 squared = f64x8_mul(gap, gap);
    for (int64_t axis = first + 1; axis < end; ++axis) {
        gap = box_gap(boxes, stride, axis, bounds);
        squared = f64x8_add(squared, f64x8_mul(gap, gap));
    }
    return squared;
}

INLINE unsigned eight_overlapping(const double *boxes, int64_t stride, const SearchBounds *bounds,
                                  int64_t n_metric)
{
    const int64_t n_axes = bounds->n_axes;
    f64x8 squared = squared_box_distance(boxes, stride, 0, n_metric, bounds);
    mask8 inside = f64x8_le(squared, f64x8_set1(bounds->squared_limit));
    if (bounds->squared_range >= 0.0) {
        squared = squared_box_distance(boxes, stride, n_metric, n_axes, bounds);
        inside = mask8_and(inside, f64x8_le(squared, f64x8_set1(bounds->squared_range)));
    }
    if (bounds->half_range)
        for (int64_t axis = n_metric; axis < n_axes; ++axis) {
            f64x8 half_range = f64x8_set1(bounds->half_range[axis - n_metric]);
            f64x8 gap = box_gap(boxes, stride, axis, bounds);
            inside = mask8_and(inside, f64x8_le(gap, half_range));
        }
    return mask8_bits(inside);
}

static unsigned overlapping_boxes(const double *boxes, int64_t stride, const SearchBounds *bounds)
{
    if (bounds->n_metric == 3)
        return eight_overlapping(boxes, stride, bounds, 3) |
               eight_overlapping(boxes + LANES, stride, bounds, 3) << LANES;
    return eight_overlapping(boxes, stride, bounds, bounds->n_metric) |
           eight_overlapping(boxes + LANES, stride, bounds, bounds->n_metric) << LANES;
}

INLINE f32x16 squared_float_box_distance(const float *boxes, int64_t stride, int64_t first,
                                         int64_t end, int64_t n_axes, const float *at)
{
    f32x16 squared = f32x16_set1(0.0f);
    for (int64_t axis = first; axis < end; ++axis) {
        const float *low = boxes + stride * axis, *high = low + stride * n_axes;
        f32x16 x = f32x16_set1(at[axis]);
        f32x16 below = f32x16_sub(f32x16_load(low), x);
        f32x16 above = f32x16_sub(x, f32x16_load(high));
        f32x16 gap = f32x16_max(f32x16_max(below, above), f32x16_set1(0.0f));
        squared = f32x16_add(squared, f32x16_mul(gap, gap));
    }
    return squared;
}

static unsigned overlapping_float_boxes(const float *boxes, int64_t stride,
                                        const SearchBounds *bounds, const FloatQuery *query)
{
    const int64_t n_metric = bounds->n_metric, n_axes = bounds->n_axes;
    f32x16 squared = squared_float_box_distance(boxes, stride, 0, n_metric, n_axes, query->at);
    f32x16 limit = f32x16_set1(query->squared_limit + query->limit_slack);
    mask16 inside = f32x16_le(squared, limit);
    if (query->squared_range >= 0.0f) {
        squared = squared_float_box_distance(boxes, stride, n_metric, n_axes, n_axes, query->at);
        limit = f32x16_set1(query->squared_range + query->range_slack);
        inside = mask16_and(inside, f32x16_le(squared, limit));
    }
    return mask16_bits(inside);
}

INLINE f64x8 squared_distance(const double *points, int64_t first, int64_t end, const double *at)
{
    f64x8 gap = f64x8_sub(f64x8_load(points + BLOCK * first), f64x8_set1(at[first]));
    f64x8 squared = f64x8_mul(gap, gap);
    for (int64_t axis = first + 1; axis < end; ++axis) {
        gap = f64x8_sub(f64x8_load(points + BLOCK * axis), f64x8_set1(at[axis]));
        squared = f64x8_add(squared, f64x8_mul(gap, gap));
    }
    return squared;
}

INLINE f32x16 squared_float_distance(const float *points, int64_t first, int64_t end,
                                     const float *at)
{
    f32x16 gap = f32x16_sub(f32x16_load(points + BLOCK * first), f32x16_set1(at[first]));
    f32x16 squared = f32x16_mul(gap, gap);
    for (int64_t axis = first + 1; axis < end; ++axis) {
        gap = f32x16_sub(f32x16_load(points + BLOCK * axis), f32x16_set1(at[axis]));
        squared = f32x16_add(squared, f32x16_mul(gap, gap));
    }
    return squared;
}

/* Conversion to float32, and packed boxes */

static void pack_boxes(const double *boxes, int64_t n_axes, unsigned bits, double *target,
                       int64_t stride)
{
    const int n_low = count_bits(bits & 0xFF);
    for (int64_t row = 0; row < 2 * n_axes; ++row) {
        const double *source = boxes + BLOCK * row;
        f64x8_compress_store(target + stride * row, bits & 0xFF, f64x8_load(source));
        f64x8_compress_store(target + stride * row + n_low, bits >> LANES,
                             f64x8_load(source + LANES));
    }
}

INLINE void quantise_row(const double *restrict row, int64_t n, double origin, double scale,
                         float *restrict target)
{
    const f64x8 origins = f64x8_set1(origin), scales = f64x8_set1(scale);
    for (int64_t i = 0; i < n; i += LANES)
        f64x8_store_f32(target + i, f64x8_mul(f64x8_sub(f64x8_load(row + i), origins), scales));
}

static void quantise_rows(const double *rows, int64_t stride, int64_t n,
                          const Quantisation *quantisation, float *target)
{
    for (int64_t axis = 0; axis < quantisation->n_axes; ++axis)
        quantise_row(rows + stride * axis, n, quantisation->origin[axis],
                     axis < quantisation->n_metric ? quantisation->scale
                                                   : quantisation->range_scale,
                     target + stride * axis);
}

/* With constant numbers of axes origins stay in registers. */
INLINE void quantise_axes(const double *restrict coords, const int32_t *restrict blocks, int64_t n,
                          const Quantisation *quantisation, int64_t n_metric, int64_t n_axes,
                          float *restrict target)
{
    const Quantisation by = *quantisation;
    for (int64_t i = 0; i < n; ++i) {
        const double *block = coords + BLOCK * n_axes * (int64_t)blocks[i];
        for (int64_t axis = 0; axis < n_axes; ++axis, target += BLOCK)
            quantise_row(block + BLOCK * axis, BLOCK, by.origin[axis],
                         axis < n_metric ? by.scale : by.range_scale, target);
    }
}

static void quantise_blocks(const double *coords, const int32_t *blocks, int64_t n,
                            const Quantisation *quantisation, float *target)
{
    const int64_t n_metric = quantisation->n_metric, n_axes = quantisation->n_axes;
    if (n_metric == 3 && n_axes == 3)
        quantise_axes(coords, blocks, n, quantisation, 3, 3, target);
    else if (n_metric == 3 && n_axes == 6)
        quantise_axes(coords, blocks, n, quantisation, 3, 6, target);
    else
        quantise_axes(coords, blocks, n, quantisation, n_metric, n_axes, target);
}

/* Candidates */

/* Factor from squared distances to scaled distances. */
INLINE double distance_scale(double squared_limit)
{
    return squared_limit > 1e-300 ? LIMIT_KEY / squared_limit : 0.0;
}

INLINE mask8 within_half_range(const double *points, const SearchBounds *bounds, mask8 inside)
{
    for (int64_t axis = bounds->n_metric; axis < bounds->n_axes; ++axis) {
        f64x8 x = f64x8_load(points + BLOCK * axis), at = f64x8_set1(bounds->low[axis]);
        f64x8 gap = f64x8_max(f64x8_sub(x, at), f64x8_sub(at, x));
        f64x8 half_range = f64x8_set1(bounds->half_range[axis - bounds->n_metric]);
        inside = mask8_and(inside, f64x8_le(gap, half_range));
    }
    return inside;
}

INLINE void scan_block(const double *restrict points, const SearchBounds *bounds, double scale,
                       uint8_t *restrict rank_keys, float *restrict scaled_distances)
{
    const f64x8 outside = f64x8_set1(OUTSIDE_KEY);
    for (int half = 0; half < BLOCK; half += LANES) {
        f64x8 squared = squared_distance(points + half, 0, bounds->n_metric, bounds->low);
        mask8 inside = f64x8_le(squared, f64x8_set1(bounds->squared_limit));
        f64x8 scaled = f64x8_min(f64x8_mul(squared, f64x8_set1(scale)), outside);
        if (bounds->squared_range >= 0.0) {
            squared = squared_distance(points + half, bounds->n_metric, bounds->n_axes,
                                       bounds->low);
            inside = mask8_and(inside, f64x8_le(squared, f64x8_set1(bounds->squared_range)));
        }
        if (bounds->half_range) inside = within_half_range(points + half, bounds, inside);
        scaled = f64x8_select(inside, scaled, outside);
        f64x8_store_u8(rank_keys + half, scaled);
        f64x8_store_f32(scaled_distances + half, scaled);
    }
}

static void rescan(const double *coords, const SearchBounds *bounds, Candidates *found)
{
    const double scale = distance_scale(bounds->squared_limit);
    for (int64_t i = 0; i < found->n_blocks; ++i)
        scan_block(coords + BLOCK * bounds->n_axes * (int64_t)found->blocks[i], bounds, scale,
                   found->rank_keys + BLOCK * i, found->scaled_distances + BLOCK * i);
}

static void scan_blocks(const double *coords, const int32_t *blocks, unsigned bits,
                        const SearchBounds *bounds, Candidates *found)
{
    const double scale = distance_scale(bounds->squared_limit);
    for (; bits; bits &= bits - 1) {
        int32_t block = blocks[lowest_bit(bits)];
        scan_block(coords + BLOCK * bounds->n_axes * (int64_t)block, bounds, scale,
                   found->rank_keys + BLOCK * found->n_blocks,
                   found->scaled_distances + BLOCK * found->n_blocks);
        found->blocks[found->n_blocks++] = block;
    }
}

/* Exclude points of a block that are out of range, by their exact distances. */
static void recheck_range(const double *coords, int64_t block, unsigned bits,
                          const SearchBounds *bounds, uint8_t *rank_keys)
{
    for (; bits; bits &= bits - 1) {
        int lane = lowest_bit(bits);
        double squared = squared_distance_at(coords, bounds->n_metric, bounds->n_axes, bounds,
                                             BLOCK * block + lane);
        if (!(squared <= bounds->squared_range)) rank_keys[lane] = OUTSIDE_KEY;
    }
}

/* Scan float32 blocks; `ball` says whether the range is limited. With constant numbers of axes the
 * compiler unrolls their loops. */
INLINE void scan_float_axes(const double *coords, const float *restrict float_blocks,
                            const int32_t *restrict blocks, unsigned bits,
                            const SearchBounds *bounds, const FloatQuery *query, Candidates *found,
                            int ball, int64_t n_metric, int64_t n_axes)
{
    const FloatQuery from = *query;
    const f32x16 outside = f32x16_set1(OUTSIDE_KEY);
    const f32x16 scale = f32x16_set1(LIMIT_KEY / from.squared_limit);
    uint8_t *restrict rank_keys = found->rank_keys + BLOCK * found->n_blocks;
    float *restrict distances = found->scaled_distances + BLOCK * found->n_blocks;
    int32_t *restrict target = found->blocks + found->n_blocks;
    const int64_t n = count_bits(bits);
    for (int64_t i = 0; i < n; ++i, bits &= bits - 1, rank_keys += BLOCK, distances += BLOCK) {
        const float *points = float_blocks + BLOCK * n_axes * lowest_bit(bits);
        f32x16 squared = squared_float_distance(points, 0, n_metric, from.at);
        f32x16 scaled = f32x16_min(f32x16_mul(squared, scale), outside);
        f32x16_store(distances, scaled);
        target[i] = blocks[lowest_bit(bits)];
        if (ball) {
            f32x16 range = squared_float_distance(points, n_metric, n_axes, from.at);
            mask16 inside = f32x16_le(range, f32x16_set1(from.squared_range + from.range_slack));
            mask16 surely = f32x16_le(range, f32x16_set1(from.squared_range - from.range_slack));
            unsigned ambiguous = mask16_bits(inside) ^ mask16_bits(surely);
            f32x16_store_u8(rank_keys, f32x16_select(inside, scaled, outside));
            if (ambiguous) recheck_range(coords, target[i], ambiguous, bounds, rank_keys);
        } else {
            f32x16_store_u8(rank_keys, scaled);
        }
    }
    found->n_blocks += n;
}

static void scan_float_blocks(const double *coords, const float *float_blocks,
                              const int32_t *blocks, unsigned bits, const SearchBounds *bounds,
                              const FloatQuery *query, Candidates *found)
{
    const int ball = query->squared_range >= 0.0f;
    const int64_t n_metric = bounds->n_metric, n_axes = bounds->n_axes;
    if (n_metric == 3 && n_axes == 3)
        scan_float_axes(coords, float_blocks, blocks, bits, bounds, query, found, 0, 3, 3);
    else if (n_metric == 3 && n_axes == 5)
        scan_float_axes(coords, float_blocks, blocks, bits, bounds, query, found, ball, 3, 5);
    else if (n_metric == 3 && n_axes == 6)
        scan_float_axes(coords, float_blocks, blocks, bits, bounds, query, found, ball, 3, 6);
    else
        scan_float_axes(coords, float_blocks, blocks, bits, bounds, query, found, ball, n_metric,
                        n_axes);
}

static void compact(Candidates *found)
{
    int64_t kept = 0;
    for (int64_t i = 0; i < found->n_blocks; ++i) {
        uint64_t bits = keys_at_most(found->rank_keys + BLOCK * i, (int)found->max_rank_key);
        found->blocks[kept] = found->blocks[i];
        kept += (bits & 0xFFFF) != 0;
    }
    found->n_blocks = kept;
}

/* Neighbours, read eight lanes at a time */

/* Iterator over the octets, groups of eight lanes, that hold a neighbour: the block, the first lane
 * and the bitmask of its neighbours. It has the masks of LANES chunks of keys from `first` on, and
 * the bitmask of their octets that are left. */
typedef struct {
    const Candidates *found;
    int64_t first, block, lane;
    uint64_t chunk[LANES], left;
    unsigned bits;
} Octets;

INLINE Octets octets(const Candidates *found)
{
    Octets out;
    out.found = found;
    out.first = -LANES;
    out.left = 0;
    return out;
}

/* Bitmask of the bytes that are not zero. */
INLINE uint64_t nonzero_bytes(uint64_t x)
{
    x |= x >> 4;
    x |= x >> 2;
    x |= x >> 1;
    return (x & 0x0101010101010101u) * 0x0102040810204080u >> 56;
}

INLINE void load_chunks(Octets *at)
{
    const Candidates *found = at->found;
    const int64_t n = n_chunks(found) - at->first;
    for (int64_t i = 0; i < n && i < LANES; ++i) {
        at->chunk[i] = keys_at_most(found->rank_keys + KEY_CHUNK * (at->first + i),
                                    (int)found->max_rank_key);
        at->left |= nonzero_bytes(at->chunk[i]) << (LANES * i);
    }
}

/* Advance to the next octet; false at the end. Their number is hard to predict: one loop over eight
 * chunks mispredicts once, where a loop per chunk would each time. */
INLINE int next_octet(Octets *at)
{
    int64_t octet;
    while (!at->left) {
        at->first += LANES;
        if (at->first >= n_chunks(at->found)) return 0;
        load_chunks(at);
    }
    octet = lowest_long(at->left);
    at->left &= at->left - 1;
    at->bits = at->chunk[octet / LANES] >> (LANES * (octet % LANES)) & 0xFF;
    at->block = at->found->blocks[KEY_CHUNK / BLOCK * at->first + octet / 2];
    at->lane = LANES * (octet % 2);
    return 1;
}

INLINE const double *octet_of(const double *coords, int64_t n_axes, const Octets *at)
{
    return coords + BLOCK * n_axes * at->block + at->lane;
}

/* With constant numbers of axes the compiler unrolls their loops. */
INLINE void gather_axes(const double *coords, const SearchBounds *bounds, const Candidates *found,
                        const int64_t *ids, double *squared, int64_t *id, int64_t n_metric,
                        int64_t n_axes)
{
    for (Octets at = octets(found); next_octet(&at);) {
        const double *points = octet_of(coords, n_axes, &at);
        f64x8_compress_store(squared, at.bits, squared_distance(points, 0, n_metric, bounds->low));
        f64x8_compress_store(id, at.bits, f64x8_load_ids(ids + BLOCK * at.block + at.lane));
        squared += count_bits(at.bits);
        id += count_bits(at.bits);
    }
}

static void gather_neighbours(const double *coords, const SearchBounds *bounds,
                              const Candidates *found, const int64_t *ids, double *squared,
                              int64_t *id)
{
    if (bounds->n_metric == 3 && bounds->n_axes == 3)
        gather_axes(coords, bounds, found, ids, squared, id, 3, 3);
    else
        gather_axes(coords, bounds, found, ids, squared, id, bounds->n_metric, bounds->n_axes);
}

static void gather_points(const double *coords, int64_t n_axes, const Candidates *found,
                          double *points)
{
    const int64_t stride = found->count + LANES;
    for (Octets at = octets(found); next_octet(&at);) {
        const double *source = octet_of(coords, n_axes, &at);
        for (int axis = 0; axis < 3; ++axis)
            f64x8_compress_store(points + axis * stride, at.bits,
                                 f64x8_load(source + BLOCK * axis));
        points += count_bits(at.bits);
    }
}

/* Sorted neighbours */

/* Make sort keys from 1 to 2 distinct: replace their last bits by their index. */
INLINE void index_sort_keys(float *keys, int64_t count)
{
    for (int64_t j = 0; j < count; ++j) {
        uint32_t bits;
        memcpy(&bits, keys + j, sizeof bits);
        bits = (bits & ~(uint32_t)(KEY_CHUNK - 1)) | (uint32_t)j;
        memcpy(keys + j, &bits, sizeof bits);
    }
}

/* Rank each key of n vectors, from one, by counting the keys that are at most as large. With a
 * constant number of vectors counts stay in registers. */
INLINE void rank_sort_keys(const float *keys, int64_t count, int n, int32_t *rank)
{
    f32x16 key[KEY_CHUNK / BLOCK], sum[KEY_CHUNK / BLOCK];
    for (int i = 0; i < n; ++i) {
        key[i] = f32x16_load(keys + BLOCK * i);
        sum[i] = f32x16_set1(0.0f);
    }
    for (int64_t j = 0; j < count; ++j) {
        const f32x16 own = f32x16_set1(keys[j]);
        for (int i = 0; i < n; ++i)
            sum[i] = f32x16_add_where(f32x16_le(own, key[i]), sum[i], f32x16_set1(1.0f));
    }
    for (int i = 0; i < n; ++i) f32x16_store_i32(rank + BLOCK * i, sum[i]);
}

static void sort_neighbours(const double *squared, const int64_t *id, int64_t count,
                            double squared_radius, double *sorted, int64_t *sorted_id)
{
    const f64x8 one = f64x8_set1(1.0);
    const f64x8 scale = f64x8_set1(squared_radius > 1e-300 ? 1.0 / squared_radius : 0.0);
    const int n = (int)((count + BLOCK - 1) / BLOCK);
    float keys[KEY_CHUNK] = {0.0f};
    int32_t rank[KEY_CHUNK];
    for (int64_t j = 0; j < count; j += LANES)
        f64x8_store_f32(keys + j, f64x8_add(f64x8_mul(f64x8_load(squared + j), scale), one));
    index_sort_keys(keys, count);
    for (int64_t j = count; j < BLOCK * n; ++j) keys[j] = INFINITY;
    if (n <= 1)
        rank_sort_keys(keys, count, 1, rank);
    else if (n == 2)
        rank_sort_keys(keys, count, 2, rank);
    else if (n == 3)
        rank_sort_keys(keys, count, 3, rank);
    else
        rank_sort_keys(keys, count, KEY_CHUNK / BLOCK, rank);
    for (int64_t j = 0; j < count; ++j) {
        sorted[rank[j] - 1] = squared[j];
        sorted_id[rank[j] - 1] = id[j];
    }
}

/* Insertion sort, by squared distance and then by id, of what is nearly sorted. */
static void insertion_sort(double *squared, int64_t *id, int64_t count)
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

INLINE int strictly_increasing(const double *x, int64_t count)
{
    unsigned descents = 0;
    for (int64_t j = 0; j + 1 < count; j += LANES) {
        const int64_t pairs = count - 1 - j;
        unsigned bits = mask8_bits(f64x8_le(f64x8_load(x + j + 1), f64x8_load(x + j)));
        descents |= bits & ((pairs < LANES ? 1u << pairs : 1u << LANES) - 1);
    }
    return descents == 0;
}

static void write_neighbours(double *squared, int64_t *id, int64_t count, int streaming,
                             double *distance, int64_t *to_id)
{
    int64_t j = 0;
    if (!strictly_increasing(squared, count)) insertion_sort(squared, id, count);
    if (streaming) {
        for (; j < count; j += LANES) {
            f64x8_stream(distance + j, f64x8_sqrt(f64x8_load(squared + j)));
            f64x8_stream((double *)(to_id + j), f64x8_load_ids(id + j));
        }
        return;
    }
    for (; j + LANES <= count; j += LANES) {
        f64x8_store(distance + j, f64x8_sqrt(f64x8_load(squared + j)));
        f64x8_store((double *)(to_id + j), f64x8_load_ids(id + j));
    }
    for (; j < count; ++j) {
        distance[j] = sqrt(squared[j]);
        to_id[j] = id[j];
    }
}

/* Sums over neighbours */

static void moments(const double *coords, int64_t n_axes, const Candidates *found,
                    const double *at, const double *frame, double *out)
{
    const f64x8 zero = f64x8_set1(0.0);
    f64x8 sum_u = zero, sum_v = zero, uu = zero, uv = zero, vv = zero;
    const double weight = 1.0 / (double)found->count;
    double mean_u, mean_v;
    for (Octets octet = octets(found); next_octet(&octet);) {
        const double *points = octet_of(coords, n_axes, &octet);
        const mask8 selected = mask8_of_bits(octet.bits);
        f64x8 u = zero, v = zero;
        for (int axis = 0; axis < 3; ++axis) {
            f64x8 x = f64x8_sub(f64x8_load(points + BLOCK * axis), f64x8_set1(at[axis]));
            u = f64x8_add(u, f64x8_mul(x, f64x8_set1(frame[axis])));
            v = f64x8_add(v, f64x8_mul(x, f64x8_set1(frame[3 + axis])));
        }
        u = f64x8_select(selected, u, zero);
        v = f64x8_select(selected, v, zero);
        sum_u = f64x8_add(sum_u, u);
        sum_v = f64x8_add(sum_v, v);
        uu = f64x8_add(uu, f64x8_mul(u, u));
        uv = f64x8_add(uv, f64x8_mul(u, v));
        vv = f64x8_add(vv, f64x8_mul(v, v));
    }
    mean_u = f64x8_sum(sum_u) * weight;
    mean_v = f64x8_sum(sum_v) * weight;
    out[0] = f64x8_sum(uu) * weight - mean_u * mean_u;
    out[1] = f64x8_sum(uv) * weight - mean_u * mean_v;
    out[2] = f64x8_sum(vv) * weight - mean_v * mean_v;
    out[3] = mean_u;
    out[4] = mean_v;
}

static void repulsion(double *points, int64_t count, double squared_radius, const double *at,
                      double *out)
{
    const int64_t stride = count + LANES;
    const f64x8 radius = f64x8_set1(sqrt(squared_radius)), one = f64x8_set1(1.0);
    /* The offset of a point at the same place is zero; this keeps its weight finite. */
    const f64x8 least = f64x8_mul(radius, f64x8_set1(0x1p-500));
    f64x8 sum[3] = {f64x8_set1(0.0), f64x8_set1(0.0), f64x8_set1(0.0)};
    for (int axis = 0; axis < 3; ++axis)
        for (int64_t j = count; j < stride; ++j) points[axis * stride + j] = at[axis];
    for (int64_t j = 0; j < count; j += LANES) {
        f64x8 offset[3], squared = f64x8_set1(0.0), weight;
        for (int axis = 0; axis < 3; ++axis) {
            offset[axis] = f64x8_sub(f64x8_set1(at[axis]), f64x8_load(points + axis * stride + j));
            squared = f64x8_add(squared, f64x8_mul(offset[axis], offset[axis]));
        }
        weight = f64x8_sub(f64x8_div(radius, f64x8_max(f64x8_sqrt(squared), least)), one);
        for (int axis = 0; axis < 3; ++axis)
            sum[axis] = f64x8_add(sum[axis], f64x8_mul(weight, offset[axis]));
    }
    for (int axis = 0; axis < 3; ++axis) out[axis] = f64x8_sum(sum[axis]) / count;
}

/* Value of a polynomial of n coefficients, that of the highest power first. */
INLINE f64x8 polynomial(const double *coefficients, int n, f64x8 x)
{
    f64x8 sum = f64x8_set1(coefficients[0]);
    for (int i = 1; i < n; ++i)
        sum = f64x8_add(f64x8_mul(sum, x), f64x8_set1(coefficients[i]));
    return sum;
}

/* Exponential function from -3.5 to 0, to 1e-13 of its value: the 16th power of that of x / 16, a
 * Taylor series about the middle of the interval. */
INLINE f64x8 exponential(f64x8 x)
{
    static const double taylor[] = {1.0 / 40320, 1.0 / 5040, 1.0 / 720, 1.0 / 120, 1.0 / 24,
                                    1.0 / 6,     0.5,        1.0,       1.0};
    const f64x8 middle = f64x8_set1(0.109375), factor = f64x8_set1(0.8963942066351505);
    f64x8 y = f64x8_add(f64x8_mul(x, f64x8_set1(0.0625)), middle);
    y = f64x8_mul(polynomial(taylor, 9, y), factor);
    for (int i = 0; i < 4; ++i) y = f64x8_mul(y, y);
    return y;
}

INLINE f64x8 kernel_weight(f64x8 squared, const Weights *weights)
{
    const f64x8 one = f64x8_set1(1.0);
    f64x8 ratio = f64x8_div(squared, f64x8_set1(weights->squared_bandwidth));
    if (weights->shape == EPANECHNIKOV_WEIGHTS)
        return f64x8_mul(f64x8_set1(2.0), f64x8_sub(one, ratio));
    if (weights->shape == CONE_WEIGHTS)
        return f64x8_mul(f64x8_set1(3.0), f64x8_sub(one, f64x8_sqrt(ratio)));
    if (weights->shape == GAUSSIAN_WEIGHTS)
        return f64x8_mul(f64x8_set1(GAUSSIAN_PEAK),
                         exponential(f64x8_mul(ratio, f64x8_set1(-GAUSSIAN_EXPONENT))));
    return one;
}

/* With a constant number of channels sums stay in registers. */
INLINE void weighted_channels(const double *coords, const SearchBounds *bounds,
                              const Candidates *found, const Weights *weights,
                              const double *values, int64_t n_channels, int n, double *out)
{
    f64x8 sum[3] = {f64x8_set1(0.0), f64x8_set1(0.0), f64x8_set1(0.0)};
    for (Octets at = octets(found); next_octet(&at);) {
        const double *points = octet_of(coords, bounds->n_axes, &at);
        const double *value = octet_of(values, n_channels, &at);
        f64x8 squared = squared_distance(points, 0, bounds->n_metric, bounds->low);
        f64x8 weight = f64x8_select(mask8_of_bits(at.bits), kernel_weight(squared, weights),
                                    f64x8_set1(0.0));
        for (int channel = 0; channel < n; ++channel)
            sum[channel] = f64x8_add(sum[channel],
                                     f64x8_mul(weight, f64x8_load(value + BLOCK * channel)));
    }
    for (int channel = 0; channel < n; ++channel) out[channel] = f64x8_sum(sum[channel]);
}

static void weighted_sum(const double *coords, const SearchBounds *bounds, const Candidates *found,
                         const Weights *weights, const double *values, int64_t n_channels,
                         double *out)
{
    int64_t channel = 0;
    for (; channel + 3 <= n_channels; channel += 3)
        weighted_channels(coords, bounds, found, weights, values + BLOCK * channel, n_channels, 3,
                          out + channel);
    for (; channel < n_channels; ++channel)
        weighted_channels(coords, bounds, found, weights, values + BLOCK * channel, n_channels, 1,
                          out + channel);
}

#include "quadratic_map.h"
#include "rectangle.h"

const SimdKernels SIMD_KERNELS = {
    .name = SIMD_NAME,
    .overlapping_boxes = overlapping_boxes,
    .overlapping_float_boxes = overlapping_float_boxes,
    .pack_boxes = pack_boxes,
    .quantise_rows = quantise_rows,
    .quantise_blocks = quantise_blocks,
    .scan_blocks = scan_blocks,
    .scan_float_blocks = scan_float_blocks,
    .rescan = rescan,
    .select_nearest = select_nearest,
    .compact = compact,
    .gather_neighbours = gather_neighbours,
    .gather_points = gather_points,
    .sort_neighbours = sort_neighbours,
    .write_neighbours = write_neighbours,
    .moments = moments,
    .repulsion = repulsion,
    .weighted_sum = weighted_sum,
    .boxes_near_rectangle = boxes_near_rectangle,
    .rectangle_band = rectangle_band,
    .rectangle_sum = rectangle_sum,
    .slanted_weights = slanted_weights,
    .fit_maps = fit_maps,
    .lattice_repulsion = lattice_repulsion,
};
