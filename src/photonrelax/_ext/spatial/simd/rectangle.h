/* Points around a rectangle, and integrals of kernels over it, for eight points at a time; see
 * estimation/footprint.pyx. */
#ifndef PHOTONRELAX_SIMD_RECTANGLE_H
#define PHOTONRELAX_SIMD_RECTANGLE_H

/* Offset of eight points from the middle of a rectangle along one of its axes. */
INLINE f64x8 along_axis(const f64x8 *offset, const double *axis)
{
    f64x8 sum = f64x8_mul(offset[0], f64x8_set1(axis[0]));
    sum = f64x8_add(sum, f64x8_mul(offset[1], f64x8_set1(axis[1])));
    return f64x8_add(sum, f64x8_mul(offset[2], f64x8_set1(axis[2])));
}

/* Excess over half a side, of offsets without their sign; NaN where those are. */
INLINE f64x8 excess(f64x8 offset, double half)
{
    return f64x8_max(f64x8_set1(0.0), f64x8_sub(offset, f64x8_set1(half)));
}

/* Offsets along the axes, without their signs, of eight points, and which are in range; points and
 * the range of lanes without one are NaN or infinite. */
INLINE mask8 rectangle_offsets(const double *points, const Rectangle *rectangle, f64x8 *along)
{
    f64x8 offset[3], squared;
    for (int axis = 0; axis < 3; ++axis)
        offset[axis] = f64x8_sub(f64x8_load(points + BLOCK * axis),
                                 f64x8_set1(rectangle->at[axis]));
    for (int axis = 0; axis < 3; ++axis)
        along[axis] = f64x8_abs(along_axis(offset, rectangle->axes + 3 * axis));
    if (rectangle->squared_range < 0.0) return mask8_of_bits(0xFF);
    squared = squared_distance(points, 3, rectangle->n_axes, rectangle->at);
    return f64x8_le(squared, f64x8_set1(rectangle->squared_range));
}

INLINE f64x8 squared_excess(const f64x8 *along, const Rectangle *rectangle)
{
    f64x8 squared = f64x8_set1(0.0);
    for (int axis = 0; axis < 3; ++axis) {
        f64x8 gap = excess(along[axis], rectangle->half[axis]);
        squared = f64x8_add(squared, f64x8_mul(gap, gap));
    }
    return squared;
}

/* Offsets along the axes of the middles of eight boxes, without their signs, and half the boxes'
 * extents. */
INLINE void box_offsets(const double *boxes, const Rectangle *rectangle, f64x8 *along,
                        f64x8 *extent)
{
    const f64x8 half = f64x8_set1(0.5);
    f64x8 offset[3], size[3];
    for (int axis = 0; axis < 3; ++axis) {
        const double *low = boxes + BLOCK * axis, *high = low + BLOCK * rectangle->n_axes;
        f64x8 at = f64x8_set1(rectangle->at[axis]);
        f64x8 below = f64x8_sub(f64x8_load(low), at), above = f64x8_sub(f64x8_load(high), at);
        offset[axis] = f64x8_mul(f64x8_add(below, above), half);
        size[axis] = f64x8_mul(f64x8_sub(above, below), half);
    }
    for (int axis = 0; axis < 3; ++axis) {
        double sizes[3];
        for (int i = 0; i < 3; ++i) sizes[i] = fabs(rectangle->axes[3 * axis + i]);
        along[axis] = f64x8_abs(along_axis(offset, rectangle->axes + 3 * axis));
        extent[axis] = along_axis(size, sizes);
    }
}

/* Squared distances over the range axes of the farthest corners of eight boxes. */
INLINE f64x8 farthest_range(const double *boxes, const Rectangle *rectangle)
{
    f64x8 squared = f64x8_set1(0.0);
    for (int64_t axis = 3; axis < rectangle->n_axes; ++axis) {
        const double *low = boxes + BLOCK * axis, *high = low + BLOCK * rectangle->n_axes;
        f64x8 at = f64x8_set1(rectangle->at[axis]);
        f64x8 gap = f64x8_max(f64x8_sub(at, f64x8_load(low)), f64x8_sub(f64x8_load(high), at));
        squared = axis == 3 ? f64x8_mul(gap, gap) : f64x8_add(squared, f64x8_mul(gap, gap));
    }
    return squared;
}

INLINE unsigned eight_near(const double *boxes, const Rectangle *rectangle, double squared_limit,
                           double margin, unsigned *deep)
{
    const SearchBounds bounds = {rectangle->at, rectangle->at, 0.0, rectangle->squared_range, NULL,
                                 3, rectangle->n_axes};
    const f64x8 range = f64x8_set1(rectangle->squared_range);
    f64x8 along[3], extent[3], nearest[3];
    mask8 near, inside;
    box_offsets(boxes, rectangle, along, extent);
    for (int axis = 0; axis < 3; ++axis) nearest[axis] = f64x8_sub(along[axis], extent[axis]);
    near = f64x8_le(squared_excess(nearest, rectangle), f64x8_set1(squared_limit));
    if (rectangle->squared_range >= 0.0)
        near = mask8_and(near, f64x8_le(squared_box_distance(boxes, BLOCK, 3, rectangle->n_axes,
                                                             &bounds), range));
    *deep = 0;
    if (margin < 0.0) return mask8_bits(near);
    inside = near;
    for (int axis = 0; axis < 3; ++axis) {
        double half = rectangle->half[axis] - (axis < 2 ? margin : 0.0);
        inside = mask8_and(inside, f64x8_le(f64x8_add(along[axis], extent[axis]),
                                            f64x8_set1(half)));
    }
    if (rectangle->squared_range >= 0.0)
        inside = mask8_and(inside, f64x8_le(farthest_range(boxes, rectangle), range));
    *deep = mask8_bits(inside);
    return mask8_bits(near);
}

static unsigned boxes_near_rectangle(const double *boxes, const Rectangle *rectangle,
                                     double squared_limit, double margin, unsigned *deep)
{
    unsigned low_deep, high_deep;
    unsigned low = eight_near(boxes, rectangle, squared_limit, margin, &low_deep);
    unsigned high = eight_near(boxes + LANES, rectangle, squared_limit, margin, &high_deep);
    *deep = low_deep | high_deep << LANES;
    return low | high << LANES;
}

static int64_t rectangle_band(const double *coords, const int32_t *blocks, int64_t n,
                              const Rectangle *rectangle, double squared_low, double squared_high,
                              double *band, int64_t capacity, int64_t *n_low)
{
    int64_t count = 0, low_count = 0;
    for (int64_t i = 0; i < n; ++i)
        for (int half = 0; half < BLOCK; half += LANES) {
            const double *points = coords + BLOCK * rectangle->n_axes * (int64_t)blocks[i] + half;
            f64x8 along[3], squared;
            mask8 in_range = rectangle_offsets(points, rectangle, along);
            unsigned low, high;
            squared = squared_excess(along, rectangle);
            low = mask8_bits(mask8_and(in_range, f64x8_le(squared, f64x8_set1(squared_low))));
            high = mask8_bits(mask8_and(in_range, f64x8_le(squared, f64x8_set1(squared_high))));
            high &= ~low;
            if (high && count <= capacity) f64x8_compress_store(band + count, high, squared);
            low_count += count_bits(low);
            count += count_bits(high);
        }
    *n_low += low_count;
    return count;
}

/* Numerator and denominator of the normal distribution less a half, to 1e-13: a rational function
 * fitted from -7 to 7. */
INLINE f64x8 normal_distribution(f64x8 x, f64x8 *denominator)
{
    static const double above[] = {
        2.34442608411314425e-15, 2.91394797956429116e-12, 3.78716473817039056e-10,
        1.96158770810968535e-08, 7.53418755527748023e-07, 2.08161459306404890e-05,
        3.91402563264153547e-04, 6.36225887925478390e-03, 4.68780863616194484e-02,
        3.98942280400874239e-01,
    };
    static const double below[] = {
        2.48967836251480095e-13, 8.03310395527741608e-11, 5.68532901363187326e-09,
        2.55889795173927364e-07, 8.15386704985593592e-06, 1.90490843482637556e-04,
        3.23796244242115469e-03, 3.83099186294742105e-02, 2.84172603383166092e-01, 1.0,
    };
    f64x8 squared;
    x = f64x8_max(f64x8_min(x, f64x8_set1(7.0)), f64x8_set1(-7.0));
    squared = f64x8_mul(x, x);
    *denominator = polynomial(below, 10, squared);
    return f64x8_mul(x, polynomial(above, 10, squared));
}

/* Profile along a side, a quotient, at offsets without their signs, in deviations. */
INLINE f64x8 side_profile(f64x8 offset, double half, f64x8 *denominator)
{
    f64x8 below, above, over, under;
    over = normal_distribution(f64x8_add(offset, f64x8_set1(half)), &above);
    under = normal_distribution(f64x8_sub(offset, f64x8_set1(half)), &below);
    *denominator = f64x8_mul(above, below);
    return f64x8_sub(f64x8_mul(over, below), f64x8_mul(under, above));
}

INLINE f64x8 rectangle_weight(const f64x8 *along, const Rectangle *rectangle,
                              const RectangleWeights *weights)
{
    const f64x8 scale = f64x8_set1(weights->inverse_deviation);
    f64x8 weight = f64x8_set1(1.0), below = weight, denominator;
    f64x8 offset = f64x8_mul(excess(along[2], rectangle->half[2]), scale);
    f64x8 squared = f64x8_mul(offset, offset);
    for (int side = 0; side < 2; ++side) {
        offset = f64x8_mul(along[side], scale);
        if (weights->is_narrow[side]) {
            f64x8 own = f64x8_mul(offset, offset);
            weight = f64x8_mul(weight, polynomial(weights->series[side], 4, own));
            squared = f64x8_add(squared, own);
        } else {
            double half = rectangle->half[side] * weights->inverse_deviation;
            weight = f64x8_mul(weight, side_profile(offset, half, &denominator));
            below = f64x8_mul(below, denominator);
        }
    }
    weight = f64x8_mul(weight, exponential(f64x8_mul(squared, f64x8_set1(-0.5))));
    return f64x8_div(weight, below);
}

/* Channels whose sums are formed together: flux, its mean and the attributes of photons have 9. */
enum { CHANNELS = 12 };

/* With a constant number of channels sums stay in registers. */
INLINE void rectangle_channels(const double *coords, const int32_t *blocks, int64_t n_blocks,
                               const Rectangle *rectangle, const RectangleWeights *weights,
                               const double *values, int64_t n_channels, int n, double *out)
{
    const f64x8 zero = f64x8_set1(0.0), radius = f64x8_set1(weights->squared_radius);
    f64x8 sum[CHANNELS];
    for (int channel = 0; channel < n; ++channel) sum[channel] = zero;
    for (int64_t i = 0; i < n_blocks; ++i)
        for (int half = 0; half < BLOCK; half += LANES) {
            const int64_t block = blocks[i];
            const double *points = coords + BLOCK * rectangle->n_axes * block + half;
            const double *value = values + BLOCK * n_channels * block + half;
            f64x8 along[3], squared, weight;
            mask8 inside = rectangle_offsets(points, rectangle, along);
            squared = squared_excess(along, rectangle);
            inside = mask8_and(inside, f64x8_le(squared, radius));
            if (!mask8_bits(inside)) continue;
            weight = rectangle_weight(along, rectangle, weights);
            weight = f64x8_select(inside, weight, zero);
            for (int channel = 0; channel < n; ++channel)
                sum[channel] = f64x8_add(sum[channel],
                                         f64x8_mul(weight, f64x8_load(value + BLOCK * channel)));
        }
    for (int channel = 0; channel < n; ++channel) out[channel] = f64x8_sum(sum[channel]);
}

static void rectangle_sum(const double *coords, const int32_t *blocks, int64_t n,
                          const Rectangle *rectangle, const RectangleWeights *weights,
                          const double *values, int64_t n_channels, double *out)
{
    /* Weights take much longer than sums: all channels share them. */
    for (int64_t channel = 0; channel < n_channels; channel += CHANNELS) {
        const int64_t left = n_channels - channel;
        const double *value = values + BLOCK * channel;
        if (left == 3)
            rectangle_channels(coords, blocks, n, rectangle, weights, value, n_channels, 3,
                               out + channel);
        else
            rectangle_channels(coords, blocks, n, rectangle, weights, value, n_channels,
                               left < CHANNELS ? (int)left : CHANNELS, out + channel);
    }
}

/* Exponential function from -56 to 0, and its value at -56 below. */
INLINE f64x8 far_exponential(f64x8 x)
{
    f64x8 y = exponential(f64x8_mul(f64x8_max(x, f64x8_set1(-56.0)), f64x8_set1(0.0625)));
    for (int i = 0; i < 4; ++i) y = f64x8_mul(y, y);
    return y;
}

static void slanted_weights(const double *first, const double *second,
                            const SlantedWeights *weights, double *out)
{
    for (int lane = 0; lane < BLOCK; lane += LANES) {
        f64x8 sum = f64x8_set1(0.0);
        for (int64_t i = 0; i < weights->n_nodes; ++i) {
            const f64x8 node = f64x8_set1(weights->first_half * weights->nodes[i]);
            f64x8 along = f64x8_sub(f64x8_load(first + lane), node), squared, own;
            f64x8 beside = f64x8_sub(f64x8_load(second + lane),
                                     f64x8_mul(along, f64x8_set1(weights->slope)));
            beside = f64x8_mul(beside, f64x8_set1(weights->second_scale));
            along = f64x8_mul(along, f64x8_set1(weights->first_scale));
            squared = f64x8_mul(along, along);
            if (weights->is_narrow) {
                own = f64x8_mul(beside, beside);
                squared = f64x8_add(squared, own);
                own = polynomial(weights->series, 4, own);
            } else {
                f64x8 denominator;
                own = side_profile(beside, weights->half, &denominator);
                own = f64x8_div(own, denominator);
            }
            own = f64x8_mul(own, f64x8_set1(weights->weights[i]));
            squared = f64x8_mul(squared, f64x8_set1(-0.5));
            sum = f64x8_add(sum, f64x8_mul(own, far_exponential(squared)));
        }
        f64x8_store(out + lane, sum);
    }
}

#endif
