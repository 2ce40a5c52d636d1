/* The loops of lanes.h for one instruction set: VECTOR of WIDTH doubles and what is done to it.
 *
 * Every loop works on eight doubles, V8, however many vectors that takes, and adds up in one
 * order, so that all instruction sets give the same bits.
 */
#include "lanes_vector.h"

static INLINE V8 NAME(gap)(const double *boxes, int64_t axis, const Reach *reach)
{
    const double *low = boxes + BLOCK * axis, *high = low + BLOCK * reach->n_axes;
    V8 below = NAME(sub)(NAME(load)(low), NAME(all)(reach->high[axis]));
    V8 above = NAME(sub)(NAME(all)(reach->low[axis]), NAME(load)(high));
    return NAME(greater)(NAME(greater)(below, above), NAME(all)(0.0));
}

static INLINE V8 NAME(squared_box_gap)(const double *boxes, int64_t first, int64_t end,
                                       const Reach *reach)
{
    V8 gap = NAME(gap)(boxes, first, reach);
    V8 squared = NAME(mul)(gap, gap);
    for (int64_t axis = first + 1; axis < end; ++axis) {
        gap = NAME(gap)(boxes, axis, reach);
        squared = NAME(add)(squared, NAME(mul)(gap, gap));
    }
    return squared;
}

static INLINE unsigned NAME(eight_near)(const double *boxes, const Reach *reach)
{
    M8 near = NAME(at_most)(NAME(squared_box_gap)(boxes, 0, reach->n_metric, reach),
                            NAME(all)(reach->squared_limit));
    if (reach->squared_range >= 0.0)
        near = NAME(both)(near, NAME(at_most)(NAME(squared_box_gap)(boxes, reach->n_metric,
                                                                    reach->n_axes, reach),
                                              NAME(all)(reach->squared_range)));
    if (reach->half_range)
        for (int64_t axis = reach->n_metric; axis < reach->n_axes; ++axis)
            near = NAME(both)(near, NAME(at_most)(NAME(gap)(boxes, axis, reach),
                                                  NAME(all)(reach->half_range[axis - reach->n_metric])));
    return NAME(bits)(near);
}

static TARGET unsigned NAME(boxes_near)(const double *boxes, const Reach *reach)
{
    return NAME(eight_near)(boxes, reach) | NAME(eight_near)(boxes + LANES, reach) << LANES;
}

static INLINE V8 NAME(squared_gap)(const double *points, int64_t first, int64_t end, const double *at)
{
    V8 gap = NAME(sub)(NAME(load)(points + BLOCK * first), NAME(all)(at[first]));
    V8 squared = NAME(mul)(gap, gap);
    for (int64_t axis = first + 1; axis < end; ++axis) {
        gap = NAME(sub)(NAME(load)(points + BLOCK * axis), NAME(all)(at[axis]));
        squared = NAME(add)(squared, NAME(mul)(gap, gap));
    }
    return squared;
}

static INLINE M8 NAME(within_half)(const double *points, const Reach *reach, M8 near)
{
    for (int64_t axis = reach->n_metric; axis < reach->n_axes; ++axis) {
        V8 x = NAME(load)(points + BLOCK * axis), at = NAME(all)(reach->low[axis]);
        V8 gap = NAME(greater)(NAME(sub)(x, at), NAME(sub)(at, x));
        near = NAME(both)(near, NAME(at_most)(gap, NAME(all)(reach->half_range[axis - reach->n_metric])));
    }
    return near;
}

/* With constant numbers of axes the compiler unrolls their loops. */
static INLINE void NAME(scan_block)(const double *restrict points, const Reach *reach, int ball,
                                    int64_t n_metric, int64_t n_axes, double *restrict to,
                                    uint8_t *restrict keys)
{
    const V8 limit = NAME(all)(reach->squared_limit), scale = NAME(all)(reach->key_scale);
    for (int half = 0; half < BLOCK; half += LANES) {
        V8 squared = NAME(squared_gap)(points + half, 0, n_metric, reach->low);
        M8 near = NAME(at_most)(squared, limit);
        if (ball)
            near = NAME(both)(near, NAME(at_most)(NAME(squared_gap)(points + half,
                                                                   n_metric, n_axes,
                                                                   reach->low),
                                                  NAME(all)(reach->squared_range)));
        if (reach->half_range) near = NAME(within_half)(points + half, reach, near);
        squared = NAME(pick)(near, squared, NAME(all)(INFINITY));
        NAME(store)(to + half, squared);
        NAME(store_keys)(keys + half, NAME(lesser)(NAME(mul)(squared, scale), NAME(all)(OUTSIDE)));
    }
}

static INLINE void NAME(scan_blocks)(const double *restrict coords, const int32_t *restrict blocks,
                                     int64_t n_blocks, const Reach *reach, const Found *found,
                                     int ball, int64_t n_metric, int64_t n_axes)
{
    double *restrict to = found->squared + BLOCK * found->n_blocks;
    uint8_t *restrict keys = found->keys + BLOCK * found->n_blocks;
    const Reach from = *reach;
    for (int64_t i = 0; i < n_blocks; ++i)
        NAME(scan_block)(coords + BLOCK * n_axes * (int64_t)blocks[i], &from, ball, n_metric, n_axes,
                         to + BLOCK * i, keys + BLOCK * i);
}

static TARGET void NAME(scan)(const double *coords, const int32_t *blocks, int64_t n_blocks,
                              const Reach *reach, Found *found)
{
    const int ball = reach->squared_range >= 0.0;
    if (reach->n_metric == 3 && reach->n_axes == 3)
        NAME(scan_blocks)(coords, blocks, n_blocks, reach, found, 0, 3, 3);
    else if (reach->n_metric == 3 && reach->n_axes == 5)
        NAME(scan_blocks)(coords, blocks, n_blocks, reach, found, ball, 3, 5);
    else if (reach->n_metric == 3 && reach->n_axes == 6)
        NAME(scan_blocks)(coords, blocks, n_blocks, reach, found, ball, 3, 6);
    else
        NAME(scan_blocks)(coords, blocks, n_blocks, reach, found, ball, reach->n_metric,
                          reach->n_axes);
    memcpy(found->blocks + found->n_blocks, blocks, n_blocks * sizeof(int32_t));
    found->n_blocks += n_blocks;
}

/* Find the key of the k-th nearest candidate, OUTSIDE if there are fewer, and how many have a lesser
 * one: bit by bit, as the greatest key that fewer than k are less than. Several searches run side
 * by side, as each step of one waits for the last. */
static INLINE void NAME(keys_of)(Ranked *ranked, int n, int64_t n_chunks)
{
    for (int bit = 128; bit > 0; bit >>= 1)
        for (int i = 0; i < n; ++i) {
            int64_t count = 0;
            for (int64_t j = 0; j < n_chunks; ++j)
                count += COUNT_LONG(NAME(keys_at_most)(ranked[i].keys + KEYS * j,
                                                       ranked[i].key + bit - 1));
            ranked[i].fewer = count < ranked[i].k ? count : ranked[i].fewer;
            ranked[i].key += count < ranked[i].k ? bit : 0;
        }
}

static INLINE Ranked NAME(ranked)(Found *found, int64_t k)
{
    Ranked out = {found->keys, k, 0, 0};
    memset(found->keys + BLOCK * found->n_blocks, OUTSIDE, FEW_CHUNKS * KEYS);
    return out;
}

/* Copy the squared distances of candidates with this key behind all others; return how many. */
static INLINE int64_t NAME(copy_equal)(const Found *found, int key, double *few)
{
    int64_t n = 0;
    for (int64_t j = 0; j < BLOCK * found->n_blocks; j += KEYS)
        for (uint64_t here = NAME(keys_equal)(found->keys + j, key); here; here &= here - 1)
            few[n++] = found->squared[j + LOWEST_BIT(here)];
    return n;
}

static INLINE void NAME(settle)(Found *found, Ranked ranked, const int64_t *ids)
{
    double *few = found->squared + BLOCK * found->n_blocks;
    int64_t n;
    found->count = ranked.k;
    if (ranked.key == OUTSIDE) {
        found->count = ranked.fewer;
        found->squared_radius = 0.0;
        if (found->count == 0) return;
        ranked = NAME(ranked)(found, found->count);
        NAME(keys_of)(&ranked, 1, n_chunks(found));
    }
    n = NAME(copy_equal)(found, ranked.key, few);
    found->squared_radius = n == 1 ? few[0] : of_rank(few, n, found->count - ranked.fewer);
    if (ranked.fewer + n > found->count) drop_ties(found, few, n, ranked.fewer, ids);
}

static TARGET void NAME(nearest)(Found *const *found, int n, int64_t k, const int64_t *ids)
{
    Ranked ranked[TOGETHER];
    int64_t most_chunks = 0;
    for (int i = 0; i < TOGETHER; ++i) {
        ranked[i] = NAME(ranked)(found[i < n ? i : 0], k);
        if (i < n && n_chunks(found[i]) > most_chunks) most_chunks = n_chunks(found[i]);
    }
    /* Constant numbers let the compiler unroll the loops. */
    if (most_chunks <= FEW_CHUNKS / 2)
        NAME(keys_of)(ranked, TOGETHER, FEW_CHUNKS / 2);
    else if (most_chunks <= FEW_CHUNKS)
        NAME(keys_of)(ranked, TOGETHER, FEW_CHUNKS);
    else
        for (int i = 0; i < n; ++i) NAME(keys_of)(&ranked[i], 1, n_chunks(found[i]));
    for (int i = 0; i < n; ++i) NAME(settle)(found[i], ranked[i], ids);
}

/* Keep only the blocks of what was found, and make all else in them unreachable. */
static TARGET void NAME(compact)(Found *found, double key_scale)
{
    const V8 most = NAME(all)(found->squared_radius), away = NAME(all)(INFINITY);
    const V8 scale = NAME(all)(key_scale), outside = NAME(all)(OUTSIDE);
    int64_t kept = 0;
    for (int64_t i = 0; i < found->n_blocks; ++i) {
        unsigned any = 0;
        for (int half = 0; half < BLOCK; half += LANES) {
            V8 x = NAME(load)(found->squared + BLOCK * i + half);
            M8 chosen = NAME(at_most)(x, most);
            x = NAME(pick)(chosen, x, away);
            any |= NAME(bits)(chosen);
            NAME(store)(found->squared + BLOCK * kept + half, x);
            NAME(store_keys)(found->keys + BLOCK * kept + half,
                             NAME(lesser)(NAME(mul)(x, scale), outside));
        }
        found->blocks[kept] = found->blocks[i];
        kept += any != 0;
    }
    found->n_blocks = kept;
}

/* Write the lanes chosen one behind the other, and more behind them; return how many. */
static INLINE int NAME(pack)(void *to, M8 chosen, V8 a)
{
    int count = 0;
    for (int i = 0; i < PARTS; ++i) {
        PACK((char *)to + sizeof(double) * count, chosen.part[i], a.part[i]);
        count += COUNT_BITS(BITS(chosen.part[i]));
    }
    return count;
}

/* Eight places that follow each other, as the bits of doubles. */
static INLINE V8 NAME(places)(int64_t first)
{
    V8 out;
    for (int i = 0; i < PARTS; ++i) out.part[i] = PLACES(first + WIDTH * i);
    return out;
}

static TARGET void NAME(list)(const Found *found, double *squared, int64_t *place)
{
    const V8 most = NAME(all)(found->squared_radius);
    int64_t count = 0;
    for (int64_t i = 0; i < 2 * found->n_blocks; ++i) {
        V8 x = NAME(load)(found->squared + LANES * i);
        M8 chosen = NAME(at_most)(x, most);
        int64_t first = BLOCK * (int64_t)found->blocks[i / 2] + i % 2 * LANES;
        NAME(pack)(place + count, chosen, NAME(places)(first));
        count += NAME(pack)(squared + count, chosen, x);
    }
}

static TARGET void NAME(list_points)(const double *coords, int64_t n_axes, const Found *found,
                                     double *squared, double *points)
{
    const V8 most = NAME(all)(found->squared_radius);
    const int64_t stride = found->count + LANES;
    int64_t count = 0;
    for (int64_t i = 0; i < 2 * found->n_blocks; ++i) {
        const double *from = coords + BLOCK * n_axes * (int64_t)found->blocks[i / 2] + i % 2 * LANES;
        V8 x = NAME(load)(found->squared + LANES * i);
        M8 chosen = NAME(at_most)(x, most);
        for (int axis = 0; axis < 3; ++axis)
            NAME(pack)(points + axis * stride + count, chosen, NAME(load)(from + BLOCK * axis));
        count += NAME(pack)(squared + count, chosen, x);
    }
}

/* Write up to KEYS neighbours to their rough rank, that of their key and then of their place. */
static INLINE void NAME(sort_roughly)(const double *restrict squared, const int64_t *restrict place,
                                      int64_t count, double squared_radius,
                                      const int64_t *restrict ids, double *restrict to,
                                      int64_t *restrict id)
{
    const V8 scale = NAME(all)(key_scale(squared_radius));
    uint8_t keys[2 * KEYS];
    for (int64_t j = 0; j < count; j += LANES)
        NAME(store_keys)(keys + j, NAME(mul)(NAME(load)(squared + j), scale));
    memset(keys + count, OUTSIDE, KEYS);
    for (int64_t j = 0; j < count; ++j) {
        uint64_t less_or_equal = NAME(keys_at_most)(keys, keys[j]);
        uint64_t equal = NAME(keys_equal)(keys, keys[j]);
        int rank = COUNT_LONG(less_or_equal & ~(equal & (UINT64_MAX << j)));
        to[rank] = squared[j];
        id[rank] = ids[place[j]];
    }
}

static TARGET void NAME(sorted)(double *squared, const int64_t *place, int64_t count,
                                double squared_radius, const int64_t *ids, double *distance,
                                int64_t *id)
{
    double sorted[KEYS];
    int64_t sorted_id[KEYS], j;
    for (j = 0; j < LANES; ++j) squared[count + j] = 0.0;
    NAME(sort_roughly)(squared, place, count, squared_radius, ids, sorted, sorted_id);
    sort_exactly(sorted, sorted_id, count);
    for (j = 0; j + LANES <= count; j += LANES)
        NAME(store)(distance + j, NAME(root)(NAME(load)(sorted + j)));
    for (; j < count; ++j) distance[j] = sqrt(sorted[j]);
    memcpy(id, sorted_id, count * sizeof(int64_t));
}

static TARGET void NAME(moments)(const double *coords, int64_t n_axes, const Found *found,
                                 const double *at, const double *frame, double scale, double *out)
{
    const V8 most = NAME(all)(found->squared_radius), zero = NAME(all)(0.0);
    V8 sum_u = zero, sum_v = zero, uu = zero, uv = zero, vv = zero;
    double mean_u, mean_v, n = (double)found->count;
    for (int64_t i = 0; i < 2 * found->n_blocks; ++i) {
        const double *points = coords + BLOCK * n_axes * (int64_t)found->blocks[i / 2] + i % 2 * LANES;
        M8 chosen = NAME(at_most)(NAME(load)(found->squared + LANES * i), most);
        V8 u = zero, v = zero;
        for (int axis = 0; axis < 3; ++axis) {
            V8 x = NAME(sub)(NAME(load)(points + BLOCK * axis), NAME(all)(at[axis]));
            u = NAME(add)(u, NAME(mul)(x, NAME(all)(frame[axis])));
            v = NAME(add)(v, NAME(mul)(x, NAME(all)(frame[3 + axis])));
        }
        u = NAME(pick)(chosen, NAME(mul)(u, NAME(all)(scale)), zero);
        v = NAME(pick)(chosen, NAME(mul)(v, NAME(all)(scale)), zero);
        sum_u = NAME(add)(sum_u, u);
        sum_v = NAME(add)(sum_v, v);
        uu = NAME(add)(uu, NAME(mul)(u, u));
        uv = NAME(add)(uv, NAME(mul)(u, v));
        vv = NAME(add)(vv, NAME(mul)(v, v));
    }
    mean_u = NAME(total)(sum_u) / n;
    mean_v = NAME(total)(sum_v) / n;
    out[0] = NAME(total)(uu) / n - mean_u * mean_u;
    out[1] = NAME(total)(uv) / n - mean_u * mean_v;
    out[2] = NAME(total)(vv) / n - mean_v * mean_v;
}

static TARGET void NAME(repulsion)(double *squared, double *points, int64_t count,
                                   double squared_radius, const double *at, double *out)
{
    const int64_t stride = count + LANES;
    const V8 radius = NAME(all)(sqrt(squared_radius));
    V8 sum[3] = {NAME(all)(0.0), NAME(all)(0.0), NAME(all)(0.0)};
    for (int64_t j = count; j < stride; ++j) {
        squared[j] = 0.0;
        for (int axis = 0; axis < 3; ++axis) points[axis * stride + j] = at[axis];
    }
    for (int64_t j = 0; j < count; j += LANES) {
        /* The offset of a photon at the very same point is zero; this keeps its weight finite. */
        V8 distance = NAME(greater)(NAME(root)(NAME(load)(squared + j)),
                                    NAME(mul)(radius, NAME(all)(0x1p-500)));
        V8 weight = NAME(sub)(NAME(quotient)(radius, distance), NAME(all)(1.0));
        for (int axis = 0; axis < 3; ++axis) {
            V8 offset = NAME(sub)(NAME(all)(at[axis]), NAME(load)(points + axis * stride + j));
            sum[axis] = NAME(add)(sum[axis], NAME(mul)(weight, offset));
        }
    }
    for (int axis = 0; axis < 3; ++axis) out[axis] = NAME(total)(sum[axis]) / count;
}

static const Lanes NAME(lanes) = {SET_NAME, NAME(boxes_near), NAME(scan), NAME(nearest),
                                  NAME(compact), NAME(list), NAME(list_points), NAME(sorted), NAME(moments), NAME(repulsion)};

#undef V8
#undef M8
#undef PARTS
#undef SET_SUFFIX
#undef SET_NAME
#undef TARGET
#undef WIDTH
#undef VECTOR
#undef MASK
#undef SET
#undef LOAD
#undef STORE
#undef ADD
#undef SUB
#undef MUL
#undef DIV
#undef MAX
#undef MIN
#undef SQRT
#undef AT_MOST
#undef BOTH
#undef BITS
#undef PICK
#undef PACK
#undef PLACES
