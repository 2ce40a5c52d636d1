/* Quadratic maps of a plane, fitted to samples for eight queries at a time, and the force of a
 * lattice that one of them maps; see relaxation/rest_density.pyx. */
#ifndef PHOTONRELAX_SIMD_QUADRATIC_MAP_H
#define PHOTONRELAX_SIMD_QUADRATIC_MAP_H

/* Keys of a lattice are squared distances in units of a hundredth of the one that is expected. */
#define LATTICE_KEY 100.0
/* Pivots of normal equations below this share of their diagonal are rounding errors. */
#define SINGULAR 1e-10

/* Length of vectors, of any that a double holds. */
INLINE f64x8 planar_length(f64x8 a, f64x8 b)
{
    const f64x8 size = f64x8_max(f64x8_abs(a), f64x8_abs(b));
    a = f64x8_div(a, size);
    b = f64x8_div(b, size);
    return f64x8_mul(size, f64x8_sqrt(f64x8_add(f64x8_mul(a, a), f64x8_mul(b, b))));
}

static void scale_rows(double (*rows)[LANES], int64_t n, f64x8 scale)
{
    for (int64_t j = 0; j < n; ++j) f64x8_store(rows[j], f64x8_mul(scale, f64x8_load(rows[j])));
}

/* Divide offsets by the radius of those fitted, and those mapped to by the largest of them. */
static void normalise(MapSamples *samples, int64_t n, int64_t n_fitted, QuadraticMaps *maps)
{
    const f64x8 one = f64x8_set1(1.0), radius = planar_length(f64x8_load(samples->a[n_fitted - 1]),
                                                              f64x8_load(samples->b[n_fitted - 1]));
    f64x8 farthest = f64x8_set1(0.0);
    for (int64_t j = 0; j < n; ++j) {
        farthest = f64x8_max(farthest, f64x8_abs(f64x8_load(samples->u[j])));
        farthest = f64x8_max(farthest, f64x8_abs(f64x8_load(samples->v[j])));
    }
    scale_rows(samples->a, n, f64x8_div(one, radius));
    scale_rows(samples->b, n, f64x8_div(one, radius));
    scale_rows(samples->u, n, f64x8_div(one, farthest));
    scale_rows(samples->v, n, f64x8_div(one, farthest));
    f64x8_store(maps->scale, farthest);
}

/* Terms of a map at sample j; returns its squared offset. */
INLINE f64x8 quadratic_terms(const MapSamples *samples, int64_t j, f64x8 *terms)
{
    const f64x8 half = f64x8_set1(0.5);
    const f64x8 a = f64x8_load(samples->a[j]), b = f64x8_load(samples->b[j]);
    const f64x8 aa = f64x8_mul(a, a), bb = f64x8_mul(b, b);
    terms[0] = f64x8_set1(1.0);
    terms[1] = a;
    terms[2] = b;
    terms[3] = f64x8_mul(half, aa);
    terms[4] = f64x8_mul(a, b);
    terms[5] = f64x8_mul(half, bb);
    return f64x8_add(aa, bb);
}

/* Normal equations: a symmetric matrix, in its lower triangle, and two right sides; and the weights
 * of samples. */
typedef struct {
    f64x8 matrix[QUADRATIC_TERMS][QUADRATIC_TERMS], u[QUADRATIC_TERMS], v[QUADRATIC_TERMS];
    f64x8 weight[KEY_CHUNK];
} NormalEquations;

static void add_samples(const MapSamples *samples, int64_t n, NormalEquations *sums)
{
    for (int i = 0; i < QUADRATIC_TERMS; ++i) {
        sums->u[i] = sums->v[i] = f64x8_set1(0.0);
        for (int k = 0; k <= i; ++k) sums->matrix[i][k] = f64x8_set1(0.0);
    }
    for (int64_t j = 0; j < n; ++j) {
        f64x8 terms[QUADRATIC_TERMS];
        const f64x8 squared = quadratic_terms(samples, j, terms);
        const f64x8 weight = exponential(f64x8_sub(f64x8_set1(0.0), squared));
        const f64x8 u = f64x8_load(samples->u[j]), v = f64x8_load(samples->v[j]);
        sums->weight[j] = weight;
        for (int i = 0; i < QUADRATIC_TERMS; ++i) {
            const f64x8 own = f64x8_mul(weight, terms[i]);
            sums->u[i] = f64x8_add(sums->u[i], f64x8_mul(own, u));
            sums->v[i] = f64x8_add(sums->v[i], f64x8_mul(own, v));
            for (int k = 0; k <= i; ++k)
                sums->matrix[i][k] = f64x8_add(sums->matrix[i][k], f64x8_mul(own, terms[k]));
        }
    }
}

/* Cholesky factor in the place of the matrix, inverses on its diagonal; those that are singular
 * become no numbers. */
static void factorise(f64x8 (*matrix)[QUADRATIC_TERMS])
{
    const f64x8 one = f64x8_set1(1.0), nan = f64x8_set1(NAN);
    for (int j = 0; j < QUADRATIC_TERMS; ++j) {
        f64x8 pivot = matrix[j][j];
        for (int m = 0; m < j; ++m)
            pivot = f64x8_sub(pivot, f64x8_mul(matrix[j][m], matrix[j][m]));
        pivot = f64x8_select(f64x8_le(pivot, f64x8_mul(f64x8_set1(SINGULAR), matrix[j][j])), nan,
                             pivot);
        matrix[j][j] = f64x8_div(one, f64x8_sqrt(pivot));
        for (int i = j + 1; i < QUADRATIC_TERMS; ++i) {
            for (int m = 0; m < j; ++m)
                matrix[i][j] = f64x8_sub(matrix[i][j], f64x8_mul(matrix[i][m], matrix[j][m]));
            matrix[i][j] = f64x8_mul(matrix[i][j], matrix[j][j]);
        }
    }
}

/* Solve for x, whose right side it holds, by a Cholesky factor. */
static void back_substitute(f64x8 (*factor)[QUADRATIC_TERMS], f64x8 *x)
{
    for (int i = 0; i < QUADRATIC_TERMS; ++i) {
        for (int m = 0; m < i; ++m) x[i] = f64x8_sub(x[i], f64x8_mul(factor[i][m], x[m]));
        x[i] = f64x8_mul(x[i], factor[i][i]);
    }
    for (int i = QUADRATIC_TERMS - 1; i >= 0; --i) {
        for (int m = i + 1; m < QUADRATIC_TERMS; ++m)
            x[i] = f64x8_sub(x[i], f64x8_mul(factor[m][i], x[m]));
        x[i] = f64x8_mul(x[i], factor[i][i]);
    }
}

/* Root mean square, by the weights of the fit, of what maps leave of n samples. */
static f64x8 residual(const MapSamples *samples, int64_t n, const NormalEquations *solved)
{
    const f64x8 *u = solved->u, *v = solved->v;
    f64x8 weights = f64x8_set1(0.0), squares = weights;
    for (int64_t j = 0; j < n; ++j) {
        f64x8 terms[QUADRATIC_TERMS];
        const f64x8 weight = solved->weight[j];
        f64x8 left_u = f64x8_load(samples->u[j]), left_v = f64x8_load(samples->v[j]);
        (void)quadratic_terms(samples, j, terms);
        for (int i = 0; i < QUADRATIC_TERMS; ++i) {
            left_u = f64x8_sub(left_u, f64x8_mul(u[i], terms[i]));
            left_v = f64x8_sub(left_v, f64x8_mul(v[i], terms[i]));
        }
        left_u = f64x8_add(f64x8_mul(left_u, left_u), f64x8_mul(left_v, left_v));
        weights = f64x8_add(weights, weight);
        squares = f64x8_add(squares, f64x8_mul(weight, left_u));
    }
    return f64x8_sqrt(f64x8_div(squares, weights));
}

/* Length of the repulsion of SJ13 Eq. 8 by n samples, in units of their radius. */
static f64x8 unevenness(const MapSamples *samples, int64_t n)
{
    const f64x8 one = f64x8_set1(1.0), least = f64x8_set1(0x1p-500);
    f64x8 a = f64x8_set1(0.0), b = a;
    for (int64_t j = 0; j < n; ++j) {
        const f64x8 to_a = f64x8_load(samples->a[j]), to_b = f64x8_load(samples->b[j]);
        f64x8 weight = f64x8_add(f64x8_mul(to_a, to_a), f64x8_mul(to_b, to_b));
        weight = f64x8_sub(one, f64x8_div(one, f64x8_max(f64x8_sqrt(weight), least)));
        a = f64x8_add(a, f64x8_mul(weight, to_a));
        b = f64x8_add(b, f64x8_mul(weight, to_b));
    }
    a = f64x8_sqrt(f64x8_add(f64x8_mul(a, a), f64x8_mul(b, b)));
    return f64x8_div(a, f64x8_set1((double)n));
}

static void fit_maps(MapSamples *samples, int64_t n, int64_t n_fitted, QuadraticMaps *maps)
{
    NormalEquations sums;
    f64x8 a = f64x8_set1(0.0), b = a;
    normalise(samples, n, n_fitted, maps);
    add_samples(samples, n_fitted, &sums);
    factorise(sums.matrix);
    back_substitute(sums.matrix, sums.u);
    back_substitute(sums.matrix, sums.v);
    for (int i = 0; i < QUADRATIC_TERMS; ++i) {
        f64x8_store(maps->u[i], sums.u[i]);
        f64x8_store(maps->v[i], sums.v[i]);
    }
    f64x8_store(maps->residual, residual(samples, n_fitted, &sums));
    f64x8_store(maps->unevenness, unevenness(samples, n_fitted));
    for (int64_t j = 0; j < n; ++j) {
        a = f64x8_add(a, f64x8_load(samples->a[j]));
        b = f64x8_add(b, f64x8_load(samples->b[j]));
    }
    f64x8_store(maps->sum_a, a);
    f64x8_store(maps->sum_b, b);
}

/* Where points of a lattice are mapped to: those of its table, and those opposite. */
typedef struct {
    double u[2][LATTICE_HALF], v[2][LATTICE_HALF], squared[2][LATTICE_HALF];
    /* Points left in. */
    int64_t count;
} CACHE_ALIGNED MappedLattice;

INLINE void map_points(MappedLattice *mapped, int side, int j, f64x8 u, f64x8 v, mask8 inside)
{
    const f64x8 squared = f64x8_add(f64x8_mul(u, u), f64x8_mul(v, v));
    f64x8_store(mapped->u[side] + j, u);
    f64x8_store(mapped->v[side] + j, v);
    f64x8_store(mapped->squared[side] + j, f64x8_select(inside, squared, f64x8_set1(INFINITY)));
    mapped->count += count_bits(mask8_bits(inside));
}

/* A linear form of two rows of the lattice, and a quadratic one of the three behind them. */
INLINE f64x8 linear_terms(const double *lattice, const double *factor)
{
    return f64x8_add(f64x8_mul(f64x8_set1(factor[0]), f64x8_load(lattice)),
                     f64x8_mul(f64x8_set1(factor[1]), f64x8_load(lattice + LATTICE_HALF)));
}

INLINE f64x8 second_terms(const double *lattice, const double *factor)
{
    f64x8 sum = linear_terms(lattice + 2 * LATTICE_HALF, factor + 2);
    return f64x8_add(sum, f64x8_mul(f64x8_set1(factor[4]), f64x8_load(lattice + 4 * LATTICE_HALF)));
}

static void map_lattice(const double *lattice, const LatticeMap *map, MappedLattice *mapped)
{
    const f64x8 edge = f64x8_set1(map->edge), zero = f64x8_set1(0.0);
    mapped->count = 0;
    for (int j = 0; j < LATTICE_HALF; j += LANES) {
        const f64x8 u = linear_terms(lattice + j, map->u), v = linear_terms(lattice + j, map->v);
        const f64x8 uu = second_terms(lattice + j, map->u), vv = second_terms(lattice + j, map->v);
        const f64x8 along = linear_terms(lattice + j, map->inward);
        map_points(mapped, 0, j, f64x8_add(uu, u), f64x8_add(vv, v), f64x8_le(edge, along));
        map_points(mapped, 1, j, f64x8_sub(uu, u), f64x8_sub(vv, v),
                   f64x8_le(edge, f64x8_sub(zero, along)));
    }
    /* The centre has no opposite. */
    mapped->squared[1][0] = INFINITY;
    mapped->count -= 1;
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
    const double *squared = mapped->squared[0];
    uint8_t keys[LATTICE_KEYS];
    double bucket[2 * LATTICE_HALF], scale = LATTICE_KEY / expected;
    int64_t n = 0;
    int most = OUTSIDE_KEY;
    memset(keys, OUTSIDE_KEY, sizeof keys);
    /* Where the points are farther than expected, once more in larger units. */
    for (; scale > 0.0 && scale < INFINITY && most == OUTSIDE_KEY; scale *= 0.0625) {
        const f64x8 to_key = f64x8_set1(scale), outside = f64x8_set1(OUTSIDE_KEY);
        for (int j = 0; j < 2 * LATTICE_HALF; j += LANES)
            f64x8_store_u8(keys + j, f64x8_min(f64x8_mul(f64x8_load(squared + j), to_key), outside));
        /* The least key up to which there are as many, bit by bit. */
        most = 0;
        for (int bit = 128; bit > 0; bit >>= 1)
            most += count_at_most(keys, most + bit - 1) < nearest ? bit : 0;
    }
    if (most == OUTSIDE_KEY) return INFINITY;
    for (int j = 0; j < LATTICE_KEYS; j += KEY_CHUNK) {
        const uint64_t below = most > 0 ? keys_at_most(keys + j, most - 1) : 0;
        bits[j / KEY_CHUNK] = keys_at_most(keys + j, most);
        nearest -= __builtin_popcountll(below);
        for (uint64_t at = bits[j / KEY_CHUNK] & ~below; at; at &= at - 1)
            bucket[n++] = squared[j + __builtin_ctzll(at)];
    }
    return smallest_of_rank(bucket, n, nearest - 1);
}

static double lattice_repulsion(const double *lattice, const LatticeMap *map, double expected,
                                int64_t nearest, double *force)
{
    const f64x8 zero = f64x8_set1(0.0), one = f64x8_set1(1.0);
    f64x8 sum_u = zero, sum_v = zero, total = zero, radius, least;
    uint64_t bits[LATTICE_KEYS / KEY_CHUNK];
    MappedLattice mapped;
    double limit;
    int64_t count = 0;
    map_lattice(lattice, map, &mapped);
    if (mapped.count < nearest) return 0.0;
    limit = lattice_limit(&mapped, expected, nearest, bits);
    if (!(limit > 0.0 && limit < INFINITY)) return 0.0;
    radius = f64x8_set1(sqrt(limit));
    least = f64x8_mul(radius, f64x8_set1(0x1p-500));
    for (int j = 0; j < 2 * LATTICE_HALF; j += LANES) {
        const f64x8 squared = f64x8_load(mapped.squared[0] + j);
        f64x8 weight, u, v;
        mask8 within;
        if (!(bits[j / KEY_CHUNK] >> j % KEY_CHUNK & 0xff)) continue;
        within = f64x8_le(squared, f64x8_set1(limit));
        count += count_bits(mask8_bits(within));
        total = f64x8_add(total, f64x8_select(within, squared, zero));
        weight = f64x8_sub(one, f64x8_div(radius, f64x8_max(f64x8_sqrt(squared), least)));
        /* Products, as places behind the last point are no numbers. */
        u = f64x8_mul(weight, f64x8_load(mapped.u[0] + j));
        v = f64x8_mul(weight, f64x8_load(mapped.v[0] + j));
        sum_u = f64x8_add(sum_u, f64x8_select(within, u, zero));
        sum_v = f64x8_add(sum_v, f64x8_select(within, v, zero));
    }
    force[0] = f64x8_sum(sum_u) / nearest;
    force[1] = f64x8_sum(sum_v) / nearest;
    /* Of points at the limit, all of which have been counted, only some are among the nearest. */
    return sqrt(2.0 / nearest * (f64x8_sum(total) + (nearest - count) * limit));
}

#endif
