/* What is made of what was found, for one instruction set; see body.h.
 *
 * It is read eight lanes at a time, those eights of which any were found.
 */

static TARGET void NAME(compact)(Candidates *found)
{
    int64_t kept = 0;
    for (int64_t i = 0; i < found->n_blocks; ++i) {
        uint64_t here = NAME(keys_at_most)(found->rank_keys + BLOCK * i, (int)found->max_rank_key);
        found->blocks[kept] = found->blocks[i];
        kept += (here & 0xFFFF) != 0;
    }
    found->n_blocks = kept;
}

/* Eight lanes of a block, from a lane on, and which of them were found, as bits; and which of the
 * next LANES chunks of keys, from `first` on, have which of their eights found, as bits. */
typedef struct {
    const Candidates *found;
    int64_t first, block, lane;
    uint64_t chunk[LANES], left;
    unsigned bits;
} NAME(Eights);
#define Eights NAME(Eights)

static INLINE Eights NAME(eights)(const Candidates *found)
{
    Eights out;
    out.found = found;
    out.first = -LANES;
    out.left = 0;
    return out;
}

/* Look at the next LANES chunks. */
static INLINE void NAME(look_at_chunks)(Eights *at)
{
    const Candidates *found = at->found;
    const int64_t n = n_chunks(found) - at->first;
    for (int64_t i = 0; i < n && i < LANES; ++i) {
        at->chunk[i] = NAME(keys_at_most)(found->rank_keys + KEY_CHUNK * (at->first + i), (int)found->max_rank_key);
        at->left |= bytes_not_zero(at->chunk[i]) << (LANES * i);
    }
}

/* Go to the next eight; tell whether there is one. How many there are is hard to foresee, so all
 * but very long lists are gone through in one go. */
static INLINE int NAME(next)(Eights *at)
{
    int64_t eight;
    while (!at->left) {
        at->first += LANES;
        if (at->first >= n_chunks(at->found)) return 0;
        NAME(look_at_chunks)(at);
    }
    eight = LOWEST_BIT(at->left);
    at->left &= at->left - 1;
    at->bits = at->chunk[eight / LANES] >> (LANES * (eight % LANES)) & 0xFF;
    at->block = at->found->blocks[KEY_CHUNK / BLOCK * at->first + eight / 2];
    at->lane = LANES * (eight % 2);
    return 1;
}

static INLINE const double *NAME(lanes_at)(const double *coords, int64_t n_axes, const Eights *at)
{
    return coords + BLOCK * n_axes * at->block + at->lane;
}

/* With constant numbers of axes the compiler unrolls their loops. */
static INLINE void NAME(list_all)(const double *coords, const SearchBounds *reach, const Candidates *found,
                                  const int64_t *ids, double *squared, int64_t *id,
                                  int64_t n_metric, int64_t n_axes)
{
    for (Eights at = NAME(eights)(found); NAME(next)(&at);) {
        const double *points = NAME(lanes_at)(coords, n_axes, &at);
        NAME(pack)(squared, at.bits, NAME(squared_gap)(points, 0, n_metric, reach->low));
        NAME(pack)(id, at.bits, NAME(load_ids)(ids + BLOCK * at.block + at.lane));
        squared += COUNT_BITS(at.bits);
        id += COUNT_BITS(at.bits);
    }
}

static TARGET void NAME(list)(const double *coords, const SearchBounds *reach, const Candidates *found,
                              const int64_t *ids, double *squared, int64_t *id)
{
    if (reach->n_metric == 3 && reach->n_axes == 3)
        NAME(list_all)(coords, reach, found, ids, squared, id, 3, 3);
    else
        NAME(list_all)(coords, reach, found, ids, squared, id, reach->n_metric, reach->n_axes);
}

static TARGET void NAME(list_points)(const double *coords, int64_t n_axes, const Candidates *found,
                                     double *points)
{
    const int64_t stride = found->count + LANES;
    for (Eights at = NAME(eights)(found); NAME(next)(&at);) {
        const double *from = NAME(lanes_at)(coords, n_axes, &at);
        for (int axis = 0; axis < 3; ++axis)
            NAME(pack)(points + axis * stride, at.bits, NAME(load)(from + BLOCK * axis));
        points += COUNT_BITS(at.bits);
    }
}

/* Count for each of n vectors of keys those that are no greater. With a constant number of vectors
 * counts stay in registers. */
static INLINE void NAME(count_lesser)(const float *keys, int64_t count, int n, int32_t *lesser)
{
    F16 key[KEY_CHUNK / BLOCK], sum[KEY_CHUNK / BLOCK];
    for (int i = 0; i < n; ++i) {
        key[i] = NAME(f_load)(keys + BLOCK * i);
        sum[i] = NAME(f_all)(0.0f);
    }
    for (int64_t j = 0; j < count; ++j) {
        const F16 own = NAME(f_all)(keys[j]);
        for (int i = 0; i < n; ++i)
            sum[i] = NAME(f_add_where)(NAME(f_at_most)(own, key[i]), sum[i], NAME(f_all)(1.0f));
    }
    for (int i = 0; i < n; ++i) NAME(f_store_integers)(lesser + BLOCK * i, sum[i]);
}

static TARGET void NAME(sort)(const double *squared, const int64_t *id, int64_t count,
                              double squared_radius, double *to, int64_t *to_id)
{
    const V8 scale = NAME(all)(squared_radius > 1e-300 ? 1.0 / squared_radius : 0.0);
    const int n = (int)((count + BLOCK - 1) / BLOCK);
    float keys[KEY_CHUNK] = {0.0f};
    int32_t rank[KEY_CHUNK];
    for (int64_t j = 0; j < count; j += LANES)
        NAME(store_rounded)(keys + j, NAME(add)(NAME(mul)(NAME(load)(squared + j), scale),
                                                NAME(all)(1.0)));
    number_keys(keys, count);
    for (int64_t j = count; j < BLOCK * n; ++j) keys[j] = INFINITY;
    if (n <= 1)
        NAME(count_lesser)(keys, count, 1, rank);
    else if (n == 2)
        NAME(count_lesser)(keys, count, 2, rank);
    else if (n == 3)
        NAME(count_lesser)(keys, count, 3, rank);
    else
        NAME(count_lesser)(keys, count, KEY_CHUNK / BLOCK, rank);
    for (int64_t j = 0; j < count; ++j) {
        to[rank[j] - 1] = squared[j];
        to_id[rank[j] - 1] = id[j];
    }
}

/* Tell whether numbers grow from one to the next. */
static INLINE int NAME(growing)(const double *x, int64_t count)
{
    unsigned not_growing = 0;
    for (int64_t j = 0; j + 1 < count; j += LANES) {
        const int64_t pairs = count - 1 - j;
        unsigned bits = NAME(bits)(NAME(at_most)(NAME(load)(x + j + 1), NAME(load)(x + j)));
        not_growing |= bits & ((pairs < LANES ? 1u << pairs : 1u << LANES) - 1);
    }
    return not_growing == 0;
}

static TARGET void NAME(write)(double *squared, int64_t *id, int64_t count, int streaming,
                               double *distance, int64_t *to_id)
{
    int64_t j = 0;
    if (!NAME(growing)(squared, count)) sort_exactly(squared, id, count);
    if (streaming) {
        for (; j < count; j += LANES) {
            NAME(stream)(distance + j, NAME(root)(NAME(load)(squared + j)));
            NAME(stream)((double *)(to_id + j), NAME(load_ids)(id + j));
        }
        return;
    }
    for (; j + LANES <= count; j += LANES) {
        NAME(store)(distance + j, NAME(root)(NAME(load)(squared + j)));
        NAME(store)((double *)(to_id + j), NAME(load_ids)(id + j));
    }
    for (; j < count; ++j) {
        distance[j] = sqrt(squared[j]);
        to_id[j] = id[j];
    }
}

static TARGET void NAME(moments)(const double *coords, int64_t n_axes, const Candidates *found,
                                 const double *at, const double *frame, double *out)
{
    const V8 zero = NAME(all)(0.0);
    V8 sum_u = zero, sum_v = zero, uu = zero, uv = zero, vv = zero;
    const double each = 1.0 / (double)found->count;
    double mean_u, mean_v;
    for (Eights at_eight = NAME(eights)(found); NAME(next)(&at_eight);) {
        const double *points = NAME(lanes_at)(coords, n_axes, &at_eight);
        const M8 chosen = NAME(chosen)(at_eight.bits);
        V8 u = zero, v = zero;
        for (int axis = 0; axis < 3; ++axis) {
            V8 x = NAME(sub)(NAME(load)(points + BLOCK * axis), NAME(all)(at[axis]));
            u = NAME(add)(u, NAME(mul)(x, NAME(all)(frame[axis])));
            v = NAME(add)(v, NAME(mul)(x, NAME(all)(frame[3 + axis])));
        }
        u = NAME(pick)(chosen, u, zero);
        v = NAME(pick)(chosen, v, zero);
        sum_u = NAME(add)(sum_u, u);
        sum_v = NAME(add)(sum_v, v);
        uu = NAME(add)(uu, NAME(mul)(u, u));
        uv = NAME(add)(uv, NAME(mul)(u, v));
        vv = NAME(add)(vv, NAME(mul)(v, v));
    }
    mean_u = NAME(total)(sum_u) * each;
    mean_v = NAME(total)(sum_v) * each;
    out[0] = NAME(total)(uu) * each - mean_u * mean_u;
    out[1] = NAME(total)(uv) * each - mean_u * mean_v;
    out[2] = NAME(total)(vv) * each - mean_v * mean_v;
    out[3] = mean_u;
    out[4] = mean_v;
}

static TARGET void NAME(repulsion)(double *points, int64_t count, double squared_radius,
                                   const double *at, double *out)
{
    const int64_t stride = count + LANES;
    const V8 radius = NAME(all)(sqrt(squared_radius));
    V8 sum[3] = {NAME(all)(0.0), NAME(all)(0.0), NAME(all)(0.0)};
    for (int axis = 0; axis < 3; ++axis)
        for (int64_t j = count; j < stride; ++j) points[axis * stride + j] = at[axis];
    for (int64_t j = 0; j < count; j += LANES) {
        V8 offset[3], squared = NAME(all)(0.0), distance, weight;
        for (int axis = 0; axis < 3; ++axis) {
            offset[axis] = NAME(sub)(NAME(all)(at[axis]), NAME(load)(points + axis * stride + j));
            squared = NAME(add)(squared, NAME(mul)(offset[axis], offset[axis]));
        }
        /* The offset of a photon at the very same point is zero; this keeps its weight finite. */
        distance = NAME(greater)(NAME(root)(squared), NAME(mul)(radius, NAME(all)(0x1p-500)));
        weight = NAME(sub)(NAME(quotient)(radius, distance), NAME(all)(1.0));
        for (int axis = 0; axis < 3; ++axis)
            sum[axis] = NAME(add)(sum[axis], NAME(mul)(weight, offset[axis]));
    }
    for (int axis = 0; axis < 3; ++axis) out[axis] = NAME(total)(sum[axis]) / count;
}

static INLINE V8 NAME(weight)(V8 squared, const Weights *weights)
{
    V8 ratio = NAME(quotient)(squared, NAME(all)(weights->squared_bandwidth));
    if (weights->shape == EPANECHNIKOV_WEIGHTS)
        return NAME(mul)(NAME(all)(2.0), NAME(sub)(NAME(all)(1.0), ratio));
    if (weights->shape == CONE_WEIGHTS)
        return NAME(mul)(NAME(all)(3.0), NAME(sub)(NAME(all)(1.0), NAME(root)(ratio)));
    return NAME(all)(1.0);
}

/* With a constant number of channels sums stay in registers. */
static INLINE void NAME(weigh_some)(const double *coords, const SearchBounds *reach, const Candidates *found,
                                    const Weights *weights, const double *values,
                                    int64_t n_channels, int n, double *out)
{
    V8 sum[3] = {NAME(all)(0.0), NAME(all)(0.0), NAME(all)(0.0)};
    for (Eights at = NAME(eights)(found); NAME(next)(&at);) {
        const double *points = NAME(lanes_at)(coords, reach->n_axes, &at);
        const double *value = NAME(lanes_at)(values, n_channels, &at);
        V8 squared = NAME(squared_gap)(points, 0, reach->n_metric, reach->low);
        V8 weight = NAME(weight)(squared, weights);
        weight = NAME(pick)(NAME(chosen)(at.bits), weight, NAME(all)(0.0));
        for (int channel = 0; channel < n; ++channel)
            sum[channel] = NAME(add)(sum[channel],
                                     NAME(mul)(weight, NAME(load)(value + BLOCK * channel)));
    }
    for (int channel = 0; channel < n; ++channel) out[channel] = NAME(total)(sum[channel]);
}

static TARGET void NAME(weigh)(const double *coords, const SearchBounds *reach, const Candidates *found,
                               const Weights *weights, const double *values, int64_t n_channels,
                               double *out)
{
    int64_t channel = 0;
    for (; channel + 3 <= n_channels; channel += 3)
        NAME(weigh_some)(coords, reach, found, weights, values + BLOCK * channel, n_channels, 3,
                         out + channel);
    for (; channel < n_channels; ++channel)
        NAME(weigh_some)(coords, reach, found, weights, values + BLOCK * channel, n_channels, 1,
                         out + channel);
}

#undef Eights
