/* Candidates and the nearest of them, for one instruction set; see body.h. */

static INLINE V8 NAME(gap)(const double *boxes, int64_t stride, int64_t axis, const SearchBounds *reach)
{
    const double *low = boxes + stride * axis, *high = low + stride * reach->n_axes;
    V8 below = NAME(sub)(NAME(load)(low), NAME(all)(reach->high[axis]));
    V8 above = NAME(sub)(NAME(all)(reach->low[axis]), NAME(load)(high));
    return NAME(greater)(NAME(greater)(below, above), NAME(all)(0.0));
}

static INLINE V8 NAME(squared_box_gap)(const double *boxes, int64_t stride, int64_t first,
                                       int64_t end, const SearchBounds *reach)
{
    V8 gap = NAME(gap)(boxes, stride, first, reach);
    V8 squared = NAME(mul)(gap, gap);
    for (int64_t axis = first + 1; axis < end; ++axis) {
        gap = NAME(gap)(boxes, stride, axis, reach);
        squared = NAME(add)(squared, NAME(mul)(gap, gap));
    }
    return squared;
}

static INLINE unsigned NAME(eight_near)(const double *boxes, int64_t stride, const SearchBounds *reach,
                                        int64_t n_metric)
{
    const int64_t n_axes = reach->n_axes;
    M8 near = NAME(at_most)(NAME(squared_box_gap)(boxes, stride, 0, n_metric, reach),
                            NAME(all)(reach->squared_limit));
    if (reach->squared_range >= 0.0)
        near = NAME(both)(near, NAME(at_most)(NAME(squared_box_gap)(boxes, stride, n_metric, n_axes,
                                                                    reach),
                                              NAME(all)(reach->squared_range)));
    if (reach->half_range)
        for (int64_t axis = n_metric; axis < n_axes; ++axis)
            near = NAME(both)(near, NAME(at_most)(NAME(gap)(boxes, stride, axis, reach),
                                                  NAME(all)(reach->half_range[axis - n_metric])));
    return NAME(bits)(near);
}

static TARGET unsigned NAME(boxes_near)(const double *boxes, int64_t stride, const SearchBounds *reach)
{
    if (reach->n_metric == 3)
        return NAME(eight_near)(boxes, stride, reach, 3) |
               NAME(eight_near)(boxes + LANES, stride, reach, 3) << LANES;
    return NAME(eight_near)(boxes, stride, reach, reach->n_metric) |
           NAME(eight_near)(boxes + LANES, stride, reach, reach->n_metric) << LANES;
}

static INLINE V8 NAME(squared_gap)(const double *points, int64_t first, int64_t end,
                                   const double *at)
{
    V8 gap = NAME(sub)(NAME(load)(points + BLOCK * first), NAME(all)(at[first]));
    V8 squared = NAME(mul)(gap, gap);
    for (int64_t axis = first + 1; axis < end; ++axis) {
        gap = NAME(sub)(NAME(load)(points + BLOCK * axis), NAME(all)(at[axis]));
        squared = NAME(add)(squared, NAME(mul)(gap, gap));
    }
    return squared;
}

static INLINE M8 NAME(within_half)(const double *points, const SearchBounds *reach, M8 near)
{
    for (int64_t axis = reach->n_metric; axis < reach->n_axes; ++axis) {
        V8 x = NAME(load)(points + BLOCK * axis), at = NAME(all)(reach->low[axis]);
        V8 gap = NAME(greater)(NAME(sub)(x, at), NAME(sub)(at, x));
        V8 half_range = NAME(all)(reach->half_range[axis - reach->n_metric]);
        near = NAME(both)(near, NAME(at_most)(gap, half_range));
    }
    return near;
}

static INLINE void NAME(scan_block)(const double *restrict points, const SearchBounds *reach, double scale,
                                    uint8_t *restrict keys, float *restrict scaled_distance)
{
    for (int half = 0; half < BLOCK; half += LANES) {
        V8 squared = NAME(squared_gap)(points + half, 0, reach->n_metric, reach->low);
        M8 near = NAME(at_most)(squared, NAME(all)(reach->squared_limit));
        if (reach->squared_range >= 0.0)
            near = NAME(both)(near, NAME(at_most)(NAME(squared_gap)(points + half, reach->n_metric,
                                                                   reach->n_axes, reach->low),
                                                  NAME(all)(reach->squared_range)));
        if (reach->half_range) near = NAME(within_half)(points + half, reach, near);
        squared = NAME(lesser)(NAME(mul)(squared, NAME(all)(scale)), NAME(all)(OUTSIDE_KEY));
        squared = NAME(pick)(near, squared, NAME(all)(OUTSIDE_KEY));
        NAME(store_keys)(keys + half, squared);
        NAME(store_rounded)(scaled_distance + half, squared);
    }
}

static TARGET void NAME(rescan)(const double *coords, const SearchBounds *reach, Candidates *found)
{
    const double scale = key_scale(reach->squared_limit);
    for (int64_t i = 0; i < found->n_blocks; ++i)
        NAME(scan_block)(coords + BLOCK * reach->n_axes * (int64_t)found->blocks[i], reach, scale,
                         found->rank_keys + BLOCK * i, found->scaled_distances + BLOCK * i);
}

static TARGET void NAME(scan)(const double *coords, const int32_t *blocks, unsigned bits,
                              const SearchBounds *reach, Candidates *found)
{
    const double scale = key_scale(reach->squared_limit);
    for (; bits; bits &= bits - 1) {
        int32_t block = blocks[lowest_bit(bits)];
        NAME(scan_block)(coords + BLOCK * reach->n_axes * (int64_t)block, reach, scale,
                         found->rank_keys + BLOCK * found->n_blocks,
                         found->scaled_distances + BLOCK * found->n_blocks);
        found->blocks[found->n_blocks++] = block;
    }
}

/* Write the lanes chosen one behind the other, and more behind them. */
static INLINE void NAME(pack)(void *to, unsigned bits, V8 a)
{
    int count = 0;
    for (int i = 0; i < PARTS; ++i) {
        unsigned part = bits >> (WIDTH * i) & ((1u << WIDTH) - 1);
        PACK((char *)to + sizeof(double) * count, part, a.part[i]);
        count += COUNT_BITS(part);
    }
}

static TARGET void NAME(list_boxes)(const double *boxes, int64_t n_axes, unsigned bits, double *to,
                                    int64_t stride)
{
    const int n_first = COUNT_BITS(bits & 0xFF);
    for (int64_t row = 0; row < 2 * n_axes; ++row) {
        const double *from = boxes + BLOCK * row;
        NAME(pack)(to + stride * row, bits & 0xFF, NAME(load)(from));
        NAME(pack)(to + stride * row + n_first, bits >> LANES, NAME(load)(from + LANES));
    }
}

static INLINE void NAME(copy_row)(const double *restrict row, int64_t n, double origin,
                                  double scale, float *restrict to)
{
    const V8 from = NAME(all)(origin), factor = NAME(all)(scale);
    for (int64_t i = 0; i < n; i += LANES)
        NAME(store_rounded)(to + i, NAME(mul)(NAME(sub)(NAME(load)(row + i), from), factor));
}

static TARGET void NAME(copy_rows)(const double *rows, int64_t stride, int64_t n,
                                   const Quantisation *frame, float *to)
{
    for (int64_t axis = 0; axis < frame->n_axes; ++axis)
        NAME(copy_row)(rows + stride * axis, n, frame->origin[axis],
                       axis < frame->n_metric ? frame->scale : frame->range_scale,
                       to + stride * axis);
}

/* With constant numbers of axes origins stay in registers. */
static INLINE void NAME(copy_all)(const double *restrict coords, const int32_t *restrict blocks,
                                  int64_t n, const Quantisation *frame, int64_t n_metric, int64_t n_axes,
                                  float *restrict to)
{
    const Quantisation by = *frame;
    for (int64_t i = 0; i < n; ++i) {
        const double *block = coords + BLOCK * n_axes * (int64_t)blocks[i];
        for (int64_t axis = 0; axis < n_axes; ++axis, to += BLOCK)
            NAME(copy_row)(block + BLOCK * axis, BLOCK, by.origin[axis],
                           axis < n_metric ? by.scale : by.range_scale, to);
    }
}

static TARGET void NAME(copy_blocks)(const double *coords, const int32_t *blocks, int64_t n,
                                     const Quantisation *frame, float *to)
{
    if (frame->n_metric == 3 && frame->n_axes == 3)
        NAME(copy_all)(coords, blocks, n, frame, 3, 3, to);
    else if (frame->n_metric == 3 && frame->n_axes == 6)
        NAME(copy_all)(coords, blocks, n, frame, 3, 6, to);
    else
        NAME(copy_all)(coords, blocks, n, frame, frame->n_metric, frame->n_axes, to);
}

static INLINE F16 NAME(copied_box_gap)(const float *boxes, int64_t stride, int64_t first,
                                      int64_t end, int64_t n_axes, const float *at)
{
    F16 squared = NAME(f_all)(0.0f);
    for (int64_t axis = first; axis < end; ++axis) {
        const float *low = boxes + stride * axis, *high = low + stride * n_axes;
        F16 here = NAME(f_all)(at[axis]);
        F16 below = NAME(f_sub)(NAME(f_load)(low), here);
        F16 above = NAME(f_sub)(here, NAME(f_load)(high));
        F16 gap = NAME(f_greater)(NAME(f_greater)(below, above), NAME(f_all)(0.0f));
        squared = NAME(f_add)(squared, NAME(f_mul)(gap, gap));
    }
    return squared;
}

static TARGET unsigned NAME(copies_near)(const float *boxes, int64_t stride, const SearchBounds *reach,
                                         const FloatQuery *query)
{
    const int64_t n_metric = reach->n_metric, n_axes = reach->n_axes;
    F16 squared = NAME(copied_box_gap)(boxes, stride, 0, n_metric, n_axes, query->at);
    F16 most = NAME(f_all)(query->squared_limit + query->limit_slack);
    FM16 near = NAME(f_at_most)(squared, most);
    if (query->squared_range >= 0.0f) {
        squared = NAME(copied_box_gap)(boxes, stride, n_metric, n_axes, n_axes, query->at);
        most = NAME(f_all)(query->squared_range + query->range_slack);
        near = NAME(f_both)(near, NAME(f_at_most)(squared, most));
    }
    return NAME(f_bits)(near);
}

static INLINE F16 NAME(copied_gap)(const float *points, int64_t first, int64_t end, const float *at)
{
    F16 gap = NAME(f_sub)(NAME(f_load)(points + BLOCK * first), NAME(f_all)(at[first]));
    F16 squared = NAME(f_mul)(gap, gap);
    for (int64_t axis = first + 1; axis < end; ++axis) {
        gap = NAME(f_sub)(NAME(f_load)(points + BLOCK * axis), NAME(f_all)(at[axis]));
        squared = NAME(f_add)(squared, NAME(f_mul)(gap, gap));
    }
    return squared;
}

/* With constant numbers of axes the compiler unrolls their loops. */
static INLINE void NAME(scan_copied)(const double *coords, const float *restrict copies,
                                     const int32_t *restrict blocks, unsigned bits,
                                     const SearchBounds *reach, const FloatQuery *query, Candidates *found, int ball,
                                     int64_t n_metric, int64_t n_axes)
{
    const FloatQuery from = *query;
    const F16 outside = NAME(f_all)(OUTSIDE_KEY);
    const F16 scale = NAME(f_all)(LIMIT_KEY / from.squared_limit);
    uint8_t *restrict keys = found->rank_keys + BLOCK * found->n_blocks;
    float *restrict scaled_distance = found->scaled_distances + BLOCK * found->n_blocks;
    int32_t *restrict to = found->blocks + found->n_blocks;
    int64_t n = COUNT_BITS(bits);
    for (int64_t i = 0; i < n; ++i, bits &= bits - 1, keys += BLOCK, scaled_distance += BLOCK) {
        const float *points = copies + BLOCK * n_axes * lowest_bit(bits);
        F16 squared = NAME(copied_gap)(points, 0, n_metric, from.at);
        F16 height = NAME(f_lesser)(NAME(f_mul)(squared, scale), outside);
        NAME(f_store)(scaled_distance, height);
        to[i] = blocks[lowest_bit(bits)];
        if (ball) {
            F16 range = NAME(copied_gap)(points, n_metric, n_axes, from.at);
            F16 within = NAME(f_all)(from.squared_range + from.range_slack);
            FM16 near = NAME(f_at_most)(range, within);
            F16 well_within = NAME(f_all)(from.squared_range - from.range_slack);
            unsigned doubt = NAME(f_bits)(near) ^ NAME(f_bits)(NAME(f_at_most)(range, well_within));
            NAME(store_f_keys)(keys, NAME(f_pick)(near, height, outside));
            if (doubt) settle_range(coords, to[i], doubt, reach, keys);
        } else {
            NAME(store_f_keys)(keys, height);
        }
    }
    found->n_blocks += n;
}

static TARGET void NAME(scan_copies)(const double *coords, const float *copies,
                                     const int32_t *blocks, unsigned bits, const SearchBounds *reach,
                                     const FloatQuery *query, Candidates *found)
{
    const int ball = query->squared_range >= 0.0f;
    if (reach->n_metric == 3 && reach->n_axes == 3)
        NAME(scan_copied)(coords, copies, blocks, bits, reach, query, found, 0, 3, 3);
    else if (reach->n_metric == 3 && reach->n_axes == 5)
        NAME(scan_copied)(coords, copies, blocks, bits, reach, query, found, ball, 3, 5);
    else if (reach->n_metric == 3 && reach->n_axes == 6)
        NAME(scan_copied)(coords, copies, blocks, bits, reach, query, found, ball, 3, 6);
    else
        NAME(scan_copied)(coords, copies, blocks, bits, reach, query, found, ball, reach->n_metric,
                          reach->n_axes);
}

/* Find the key of the k-th nearest candidate, OUTSIDE_KEY if there are fewer, and how many have a
 * lesser one: bit by bit, as the greatest key that fewer than k are less than. Several searches run
 * side by side, as each step of one waits for the last. */
static INLINE void NAME(keys_of)(Ranked *ranked, int n, int64_t n_chunks)
{
    for (int bit = 128; bit > 0; bit >>= 1)
        for (int i = 0; i < n; ++i) {
            int64_t count = 0;
            for (int64_t j = 0; j < n_chunks; ++j)
                count += COUNT_LONG(NAME(keys_at_most)(ranked[i].rank_keys + KEY_CHUNK * j,
                                                       ranked[i].key + bit - 1));
            ranked[i].fewer = count < ranked[i].k ? count : ranked[i].fewer;
            ranked[i].key += count < ranked[i].k ? bit : 0;
        }
}

static INLINE Ranked NAME(ranked)(Candidates *found, int64_t k)
{
    Ranked out = {found->rank_keys, k, 0, 0};
    memset(found->rank_keys + BLOCK * found->n_blocks, OUTSIDE_KEY, MAX_UNROLLED_CHUNKS * KEY_CHUNK);
    return out;
}

static INLINE Ranked NAME(rank)(Candidates *found, int64_t k)
{
    Ranked ranked = NAME(ranked)(found, k);
    NAME(keys_of)(&ranked, 1, n_chunks(found));
    return ranked;
}

/* Note the candidates next to a key, from `doubt` below to `doubt` above it, that are within the
 * limit, and their exact distances; return how many are lower, of whom `fewer` have lesser keys. */
static INLINE int64_t NAME(note_few)(const double *coords, const SearchBounds *reach, Candidates *found,
                                     int key, int64_t fewer, float doubt)
{
    const float low = (float)key - doubt, high = (float)(key + 1) + doubt;
    const int64_t end = BLOCK * found->n_blocks;
    int64_t n = 0;
    for (int64_t j = 0; j < end; j += KEY_CHUNK) {
        uint64_t here = NAME(keys_next_to)(found->rank_keys + j, key);
        /* What lies behind may be next to it modulo 256. */
        if (end - j < KEY_CHUNK) here &= ((uint64_t)1 << (end - j)) - 1;
        for (; here; here &= here - 1) {
            int64_t candidate = j + LOWEST_BIT(here);
            float height = found->scaled_distances[candidate];
            int own = found->rank_keys[candidate];
            /* Keys next to this are found modulo 256. */
            int noted = (height >= low) & (height <= high) & (own <= key + 1);
            found->ties[n] = (int32_t)candidate;
            n += noted;
            fewer -= noted & (own < key);
        }
    }
    found->n_ties = n;
    look_at_few(coords, reach, found);
    return fewer;
}

static INLINE int64_t NAME(count_keys)(const Candidates *found, int most)
{
    int64_t count = 0;
    for (int64_t j = 0; j < n_chunks(found); ++j)
        count += COUNT_LONG(NAME(keys_at_most)(found->rank_keys + KEY_CHUNK * j, most));
    return count;
}

/* The search for the k-th nearest where fewer than k are in reach: for the farthest of all or, if
 * some are so close to the limit that they may be beyond it, for these, with k zero. */
static INLINE Ranked NAME(up_to_limit)(const Candidates *found)
{
    Ranked out = {found->rank_keys, 0, 0, greatest_key(found)};
    if (out.key < LIMIT_KEY - 1)
        out.k = NAME(count_keys)(found, out.key);
    else
        out.key = LIMIT_KEY;
    out.fewer = out.key > 0 ? NAME(count_keys)(found, out.key - 1) : 0;
    return out;
}

/* As scaled_distance are a little off, those next to the key of the k-th are looked at exactly. */
static INLINE void NAME(settle)(const double *coords, const SearchBounds *reach, float doubt, Candidates *found,
                                Ranked ranked, const int64_t *ids)
{
    for (;;) {
        int64_t fewer;
        if (ranked.key > LIMIT_KEY) ranked = NAME(up_to_limit)(found);
        fewer = NAME(note_few)(coords, reach, found, ranked.key, ranked.fewer, doubt);
        found->count = ranked.k;
        found->max_rank_key = ranked.key;
        if (ranked.k > 0 && fewer + found->n_ties >= ranked.k) {
            if (found->n_ties == 1)
                choose_only(found);
            else
                choose_few(found, fewer, ids);
            return;
        }
        if (fewer + found->n_ties == 0) {
            find_nothing(found);
            return;
        }
        ranked = NAME(rank)(found, fewer + found->n_ties);
    }
}

static TARGET void NAME(nearest)(const double *coords, const SearchBounds *const *reach,
                                 const float *doubt, Candidates *const *found, int n, int64_t k,
                                 const int64_t *ids)
{
    Ranked ranked[INTERLEAVED];
    int64_t most_chunks = 0;
    if (n == 1) {
        NAME(settle)(coords, reach[0], doubt[0], found[0], NAME(rank)(found[0], k), ids);
        return;
    }
    for (int i = 0; i < INTERLEAVED; ++i) {
        ranked[i] = NAME(ranked)(found[i < n ? i : 0], k);
        if (i < n && n_chunks(found[i]) > most_chunks) most_chunks = n_chunks(found[i]);
    }
    /* Constant numbers let the compiler unroll the loops. */
    if (most_chunks <= 2)
        NAME(keys_of)(ranked, INTERLEAVED, 2);
    else if (most_chunks == 3)
        NAME(keys_of)(ranked, INTERLEAVED, 3);
    else if (most_chunks == MAX_UNROLLED_CHUNKS)
        NAME(keys_of)(ranked, INTERLEAVED, MAX_UNROLLED_CHUNKS);
    else
        for (int i = 0; i < n; ++i) NAME(keys_of)(&ranked[i], 1, n_chunks(found[i]));
    for (int i = 0; i < n; ++i) NAME(settle)(coords, reach[i], doubt[i], found[i], ranked[i], ids);
}
