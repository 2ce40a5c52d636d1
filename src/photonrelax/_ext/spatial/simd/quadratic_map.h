/* Sums that quadratic maps of a plane are fitted from, and the force of a lattice that one maps;
 * see relaxation/rest_density.pyx. */
#ifndef PHOTONRELAX_SIMD_QUADRATIC_MAP_H
#define PHOTONRELAX_SIMD_QUADRATIC_MAP_H

/* Keys of a lattice are squared distances in units of a hundredth of the one that is expected. */
#define LATTICE_KEY 100.0

/* Terms of a quadratic map at eight places, and the weight exp(-squared offset), zero for lanes
 * from n. */
INLINE f64x8 quadratic_terms(const MapSamples *samples, int64_t j, int64_t n, f64x8 *terms)
{
    const f64x8 half = f64x8_set1(0.5), zero = f64x8_set1(0.0);
    const f64x8 a = f64x8_load(samples->a + j), b = f64x8_load(samples->b + j);
    const f64x8 aa = f64x8_mul(a, a), bb = f64x8_mul(b, b);
    const mask8 own = mask8_of_bits(n - j < LANES ? (1u << (n - j)) - 1 : (1u << LANES) - 1);
    terms[0] = f64x8_set1(1.0);
    terms[1] = a;
    terms[2] = b;
    terms[3] = f64x8_mul(half, aa);
    terms[4] = f64x8_mul(a, b);
    terms[5] = f64x8_mul(half, bb);
    return f64x8_select(own, exponential(f64x8_sub(zero, f64x8_add(aa, bb))), zero);
}

static void quadratic_sums(const MapSamples *samples, int64_t n, double *matrix, double *u,
                           double *v)
{
    enum { TERMS = QUADRATIC_TERMS };
    f64x8 products[TERMS][TERMS], sum_u[TERMS], sum_v[TERMS];
    for (int i = 0; i < TERMS; ++i) {
        sum_u[i] = sum_v[i] = f64x8_set1(0.0);
        for (int k = 0; k <= i; ++k) products[i][k] = f64x8_set1(0.0);
    }
    for (int64_t j = 0; j < n; j += LANES) {
        f64x8 terms[TERMS];
        const f64x8 weight = quadratic_terms(samples, j, n, terms);
        const f64x8 to_u = f64x8_load(samples->u + j), to_v = f64x8_load(samples->v + j);
        for (int i = 0; i < TERMS; ++i) {
            const f64x8 own = f64x8_mul(weight, terms[i]);
            sum_u[i] = f64x8_add(sum_u[i], f64x8_mul(own, to_u));
            sum_v[i] = f64x8_add(sum_v[i], f64x8_mul(own, to_v));
            for (int k = 0; k <= i; ++k)
                products[i][k] = f64x8_add(products[i][k], f64x8_mul(own, terms[k]));
        }
    }
    for (int i = 0; i < TERMS; ++i) {
        u[i] = f64x8_sum(sum_u[i]);
        v[i] = f64x8_sum(sum_v[i]);
        for (int k = 0; k <= i; ++k) matrix[TERMS * i + k] = f64x8_sum(products[i][k]);
    }
}

static double quadratic_residual(const MapSamples *samples, int64_t n, const double *u,
                                 const double *v)
{
    f64x8 weights = f64x8_set1(0.0), squares = weights;
    for (int64_t j = 0; j < n; j += LANES) {
        f64x8 terms[QUADRATIC_TERMS];
        const f64x8 weight = quadratic_terms(samples, j, n, terms);
        f64x8 left_u = f64x8_load(samples->u + j), left_v = f64x8_load(samples->v + j);
        for (int i = 0; i < QUADRATIC_TERMS; ++i) {
            left_u = f64x8_sub(left_u, f64x8_mul(f64x8_set1(u[i]), terms[i]));
            left_v = f64x8_sub(left_v, f64x8_mul(f64x8_set1(v[i]), terms[i]));
        }
        left_u = f64x8_add(f64x8_mul(left_u, left_u), f64x8_mul(left_v, left_v));
        weights = f64x8_add(weights, weight);
        squares = f64x8_add(squares, f64x8_mul(weight, left_u));
    }
    return sqrt(f64x8_sum(squares) / f64x8_sum(weights));
}

/* Where points of a lattice are mapped to. */
typedef struct {
    double u[LATTICE_ROW], v[LATTICE_ROW], squared[LATTICE_ROW];
    /* Points left in. */
    int64_t count;
} MappedLattice;

static void map_lattice(const double *lattice, const LatticeMap *map, MappedLattice *mapped)
{
    enum { TERMS = QUADRATIC_TERMS - 1 };
    const f64x8 outside = f64x8_set1(INFINITY);
    mapped->count = 0;
    for (int j = 0; j < LATTICE_ROW; j += LANES) {
        f64x8 u = f64x8_set1(0.0), v = u, along, squared;
        mask8 inside;
        for (int i = 0; i < TERMS; ++i) {
            const f64x8 term = f64x8_load(lattice + LATTICE_ROW * i + j);
            u = f64x8_add(u, f64x8_mul(f64x8_set1(map->u[i]), term));
            v = f64x8_add(v, f64x8_mul(f64x8_set1(map->v[i]), term));
        }
        along = f64x8_add(f64x8_mul(f64x8_set1(map->inward[0]), f64x8_load(lattice + j)),
                          f64x8_mul(f64x8_set1(map->inward[1]),
                                    f64x8_load(lattice + LATTICE_ROW + j)));
        inside = f64x8_le(f64x8_set1(map->edge), along);
        squared = f64x8_add(f64x8_mul(u, u), f64x8_mul(v, v));
        f64x8_store(mapped->u + j, u);
        f64x8_store(mapped->v + j, v);
        f64x8_store(mapped->squared + j, f64x8_select(inside, squared, outside));
        mapped->count += count_bits(mask8_bits(inside));
    }
}

static double smallest_of_rank(double *values, int64_t n, int64_t rank)
{
    for (int64_t first = 0; first <= rank; ++first)
        for (int64_t j = first + 1; j < n; ++j)
            if (values[j] < values[first]) {
                const double other = values[first];
                values[first] = values[j];
                values[j] = other;
            }
    return values[rank];
}

INLINE int64_t count_at_most(const uint8_t *keys, int most)
{
    int64_t count = 0;
    for (int j = 0; j < LATTICE_KEYS; j += KEY_CHUNK)
        count += __builtin_popcountll(keys_at_most(keys + j, most));
    return count;
}

/* Squared distance of the nearest `nearest` points; infinite if no finite one holds them. Points
 * that far, and nearer, have a bit set. */
static double lattice_limit(const MappedLattice *mapped, double expected, int64_t nearest,
                            uint64_t *bits)
{
    uint8_t keys[LATTICE_KEYS];
    double bucket[LATTICE_ROW], scale = LATTICE_KEY / expected;
    int64_t n = 0;
    int least, most = OUTSIDE_KEY;
    memset(keys, OUTSIDE_KEY, sizeof keys);
    /* Where the points are farther than expected, once more in larger units. */
    for (; scale > 0.0 && scale < INFINITY && most == OUTSIDE_KEY; scale *= 0.0625) {
        for (int j = 0; j < LATTICE_ROW; j += LANES)
            f64x8_store_u8(keys + j, f64x8_min(f64x8_mul(f64x8_load(mapped->squared + j),
                                                         f64x8_set1(scale)),
                                               f64x8_set1(OUTSIDE_KEY)));
        for (least = 0, most = OUTSIDE_KEY; least < most;) {
            const int middle = (least + most) / 2;
            if (count_at_most(keys, middle) < nearest)
                least = middle + 1;
            else
                most = middle;
        }
    }
    if (most == OUTSIDE_KEY) return INFINITY;
    for (int j = 0; j < LATTICE_KEYS; j += KEY_CHUNK) {
        const uint64_t below = most > 0 ? keys_at_most(keys + j, most - 1) : 0;
        bits[j / KEY_CHUNK] = keys_at_most(keys + j, most);
        nearest -= __builtin_popcountll(below);
        for (uint64_t at = bits[j / KEY_CHUNK] & ~below; at; at &= at - 1)
            bucket[n++] = mapped->squared[j + __builtin_ctzll(at)];
    }
    return smallest_of_rank(bucket, n, nearest - 1);
}

static double lattice_repulsion(const double *lattice, const LatticeMap *map, double expected,
                                int64_t nearest, double *force)
{
    const f64x8 zero = f64x8_set1(0.0), one = f64x8_set1(1.0);
    f64x8 sum_u = zero, sum_v = zero, total = zero;
    uint64_t bits[LATTICE_KEYS / KEY_CHUNK];
    MappedLattice mapped;
    double limit;
    int64_t count = 0;
    map_lattice(lattice, map, &mapped);
    if (mapped.count < nearest) return 0.0;
    limit = lattice_limit(&mapped, expected, nearest, bits);
    if (!(limit > 0.0 && limit < INFINITY)) return 0.0;
    for (int j = 0; j < LATTICE_ROW; j += LANES) {
        const f64x8 radius = f64x8_set1(sqrt(limit)), squared = f64x8_load(mapped.squared + j);
        f64x8 weight, u, v;
        mask8 within;
        if (!(bits[j / KEY_CHUNK] >> j % KEY_CHUNK & 0xff)) continue;
        within = f64x8_le(squared, f64x8_set1(limit));
        count += count_bits(mask8_bits(within));
        total = f64x8_add(total, f64x8_select(within, squared, zero));
        weight = f64x8_max(f64x8_sqrt(squared), f64x8_mul(radius, f64x8_set1(0x1p-500)));
        weight = f64x8_sub(one, f64x8_div(radius, weight));
        /* Products, as places behind the last point are no numbers. */
        u = f64x8_mul(weight, f64x8_load(mapped.u + j));
        v = f64x8_mul(weight, f64x8_load(mapped.v + j));
        sum_u = f64x8_add(sum_u, f64x8_select(within, u, zero));
        sum_v = f64x8_add(sum_v, f64x8_select(within, v, zero));
    }
    force[0] = f64x8_sum(sum_u) / nearest;
    force[1] = f64x8_sum(sum_v) / nearest;
    /* Of points at the limit, all of which have been counted, only some are among the nearest. */
    return sqrt(2.0 / nearest * (f64x8_sum(total) + (nearest - count) * limit));
}

#endif
