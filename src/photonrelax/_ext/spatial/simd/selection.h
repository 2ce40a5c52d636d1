/* Selection of the k nearest candidates by their rank keys, in one instruction set.
 *
 * Rank keys, scaled distances rounded down, are searched for the key of the k-th nearest. As scaled
 * distances are rounded, candidates whose rank against the k-th is ambiguous, the ties, are compared
 * by exact squared distance, then by id. See docs/methods/neighbour-selection.md.
 */
#ifndef PHOTONRELAX_SIMD_SELECTION_H
#define PHOTONRELAX_SIMD_SELECTION_H

#include "vector.h"

/* Rank of a key among the candidates: `fewer` of them are known to have a smaller one. */
typedef struct {
    const uint8_t *rank_keys;
    int64_t k, fewer;
    int key;
} KeyRank;

INLINE int count_long(uint64_t bits) { return __builtin_popcountll(bits); }
INLINE int lowest_long(uint64_t bits) { return __builtin_ctzll(bits); }

INLINE int64_t n_chunks(const Candidates *found)
{
    return (BLOCK * found->n_blocks + KEY_CHUNK - 1) / KEY_CHUNK;
}

/* Squared distance of a point over a range of axes, in the order of the vector kernels. */
INLINE double squared_distance_at(const double *coords, int64_t first, int64_t end,
                                  const SearchBounds *bounds, int64_t place)
{
    const double *point = coords + BLOCK * bounds->n_axes * (place / BLOCK) + place % BLOCK;
    double gap = point[BLOCK * first] - bounds->low[first], squared = gap * gap;
    for (int64_t axis = first + 1; axis < end; ++axis) {
        gap = point[BLOCK * axis] - bounds->low[axis];
        squared += gap * gap;
    }
    return squared;
}

/* The number of a rank, counted from one, by quickselect; reorders them. */
static double number_of_rank(double *x, int64_t n, int64_t rank)
{
    int64_t low = 0, high = n - 1;
    while (low < high) {
        double pivot = x[low + (high - low) / 2];
        int64_t i = low, j = high;
        while (i <= j) {
            while (x[i] < pivot) ++i;
            while (x[j] > pivot) --j;
            if (i <= j) {
                double swapped = x[i];
                x[i++] = x[j];
                x[j--] = swapped;
            }
        }
        if (rank - 1 <= j)
            high = j;
        else if (rank - 1 >= i)
            low = i;
        else
            break;
    }
    return x[rank - 1];
}

/* Largest key of candidates that may be within the limit. */
INLINE int largest_key(const Candidates *found)
{
    uint8_t largest = 0;
    for (int64_t j = 0; j < BLOCK * found->n_blocks; ++j) {
        uint8_t key = found->rank_keys[j] <= LIMIT_KEY + 1 ? found->rank_keys[j] : 0;
        largest = key > largest ? key : largest;
    }
    return largest;
}

/* Find the key of the k-th nearest candidate, OUTSIDE_KEY if there are fewer, and the number of
 * smaller keys: bit by bit, the largest key with fewer than k smaller ones. The searches of several
 * queries run interleaved, as each step depends on the one before. */
INLINE void find_keys(KeyRank *ranks, int n, int64_t chunks)
{
    for (int bit = 128; bit > 0; bit >>= 1)
        for (int i = 0; i < n; ++i) {
            int64_t count = 0;
            for (int64_t j = 0; j < chunks; ++j)
                count += count_long(keys_at_most(ranks[i].rank_keys + KEY_CHUNK * j,
                                                 ranks[i].key + bit - 1));
            ranks[i].fewer = count < ranks[i].k ? count : ranks[i].fewer;
            ranks[i].key += count < ranks[i].k ? bit : 0;
        }
}

INLINE KeyRank start_rank(Candidates *found, int64_t k)
{
    KeyRank out = {found->rank_keys, k, 0, 0};
    memset(found->rank_keys + BLOCK * found->n_blocks, OUTSIDE_KEY,
           MAX_UNROLLED_CHUNKS * KEY_CHUNK);
    return out;
}

INLINE KeyRank find_rank(Candidates *found, int64_t k)
{
    KeyRank rank = start_rank(found, k);
    find_keys(&rank, 1, n_chunks(found));
    return rank;
}

INLINE int64_t count_keys(const Candidates *found, int most)
{
    int64_t count = 0;
    for (int64_t j = 0; j < n_chunks(found); ++j)
        count += count_long(keys_at_most(found->rank_keys + KEY_CHUNK * j, most));
    return count;
}

/* The rank to resolve where fewer than k candidates are within the limit: the largest key, whose
 * candidates are all selected; or LIMIT_KEY with k = 0, if some are so close to the limit that they
 * may be beyond it. */
INLINE KeyRank rank_of_limit(const Candidates *found)
{
    KeyRank out = {found->rank_keys, 0, 0, largest_key(found)};
    if (out.key < LIMIT_KEY - 1)
        out.k = count_keys(found, out.key);
    else
        out.key = LIMIT_KEY;
    out.fewer = out.key > 0 ? count_keys(found, out.key - 1) : 0;
    return out;
}

/* Exact squared distances of the ties. Those beyond the limit are excluded. */
INLINE void recompute_exact(const double *coords, const SearchBounds *bounds, Candidates *found)
{
    int64_t n = 0;
    for (int64_t j = 0; j < found->n_ties; ++j) {
        int32_t candidate = found->ties[j];
        double squared = squared_distance_at(coords, 0, bounds->n_metric, bounds,
                                             candidate_place(found, candidate));
        found->ties[n] = candidate;
        found->tie_squared[n] = squared;
        if (squared <= bounds->squared_limit)
            ++n;
        else
            found->rank_keys[candidate] = OUTSIDE_KEY;
    }
    found->n_ties = n;
}

/* Collect the ties: candidates within `slack` of a key, and their exact distances. Returns the
 * number of candidates below them; `fewer` have smaller keys. */
INLINE int64_t collect_ties(const double *coords, const SearchBounds *bounds, Candidates *found,
                            int key, int64_t fewer, float slack)
{
    const float low = (float)key - slack, high = (float)(key + 1) + slack;
    const int64_t end = BLOCK * found->n_blocks;
    int64_t n = 0;
    for (int64_t j = 0; j < end; j += KEY_CHUNK) {
        uint64_t near = keys_next_to(found->rank_keys + j, key);
        /* Keys behind the last block may match modulo 256. */
        if (end - j < KEY_CHUNK) near &= ((uint64_t)1 << (end - j)) - 1;
        for (; near; near &= near - 1) {
            int64_t candidate = j + lowest_long(near);
            float distance = found->scaled_distances[candidate];
            int own = found->rank_keys[candidate];
            /* So may keys of candidates. */
            int is_tie = (distance >= low) & (distance <= high) & (own <= key + 1);
            found->ties[n] = (int32_t)candidate;
            n += is_tie;
            fewer -= is_tie & (own < key);
        }
    }
    found->n_ties = n;
    recompute_exact(coords, bounds, found);
    return fewer;
}

/* Exclude as many of the farthest as exceed k, those of highest ids. */
static void drop_highest_ids(Candidates *found, int64_t excess, const int64_t *ids)
{
    double *equal = found->scratch, highest;
    int64_t n = 0;
    for (int64_t j = 0; j < found->n_ties; ++j)
        if (found->tie_squared[j] == found->squared_radius)
            equal[n++] = (double)ids[candidate_place(found, found->ties[j])];
    highest = number_of_rank(equal, n, n - excess);
    for (int64_t j = 0; j < found->n_ties; ++j)
        if (found->tie_squared[j] == found->squared_radius &&
            (double)ids[candidate_place(found, found->ties[j])] > highest)
            found->rank_keys[found->ties[j]] = OUTSIDE_KEY;
}

/* Squared distance of a rank, counted from one, among the ties. */
static double tie_of_rank(const Candidates *found, int64_t rank)
{
    const double *x = found->tie_squared;
    if (found->n_ties == 2) return (x[0] < x[1]) == (rank == 1) ? x[0] : x[1];
    memcpy(found->scratch, x, found->n_ties * sizeof(double));
    return number_of_rank(found->scratch, found->n_ties, rank);
}

/* Select among the ties; `fewer` candidates are below them. */
static void select_ties(Candidates *found, int64_t fewer, const int64_t *ids)
{
    int64_t excess = fewer - found->count;
    found->squared_radius = tie_of_rank(found, found->count - fewer);
    for (int64_t j = 0; j < found->n_ties; ++j) {
        int selected = found->tie_squared[j] <= found->squared_radius;
        found->rank_keys[found->ties[j]] = selected ? (uint8_t)found->max_rank_key : OUTSIDE_KEY;
        excess += selected;
    }
    if (excess > 0) drop_highest_ids(found, excess, ids);
}

/* Select the only tie; most often there is no other. */
INLINE void select_single_tie(Candidates *found)
{
    found->squared_radius = found->tie_squared[0];
    found->rank_keys[found->ties[0]] = (uint8_t)found->max_rank_key;
}

static void select_nothing(Candidates *found)
{
    found->count = found->n_ties = found->n_blocks = 0;
    found->max_rank_key = 0;
    found->squared_radius = 0.0;
}

/* Turn the key of the k-th nearest into the selection. */
INLINE void resolve_rank(const double *coords, const SearchBounds *bounds, float slack,
                         Candidates *found, KeyRank rank, const int64_t *ids)
{
    for (;;) {
        int64_t fewer;
        if (rank.key > LIMIT_KEY) rank = rank_of_limit(found);
        fewer = collect_ties(coords, bounds, found, rank.key, rank.fewer, slack);
        found->count = rank.k;
        found->max_rank_key = rank.key;
        if (rank.k > 0 && fewer + found->n_ties >= rank.k) {
            if (found->n_ties == 1)
                select_single_tie(found);
            else
                select_ties(found, fewer, ids);
            return;
        }
        if (fewer + found->n_ties == 0) {
            select_nothing(found);
            return;
        }
        rank = find_rank(found, fewer + found->n_ties);
    }
}

static void select_nearest(const double *coords, const SearchBounds *const *bounds,
                           const float *rank_slack, Candidates *const *found, int n, int64_t k,
                           const int64_t *ids)
{
    KeyRank ranks[INTERLEAVED];
    int64_t most_chunks = 0;
    if (n == 1) {
        resolve_rank(coords, bounds[0], rank_slack[0], found[0], find_rank(found[0], k), ids);
        return;
    }
    for (int i = 0; i < INTERLEAVED; ++i) {
        ranks[i] = start_rank(found[i < n ? i : 0], k);
        if (i < n && n_chunks(found[i]) > most_chunks) most_chunks = n_chunks(found[i]);
    }
    /* Constant numbers let the compiler unroll the loops. */
    if (most_chunks <= 2)
        find_keys(ranks, INTERLEAVED, 2);
    else if (most_chunks == 3)
        find_keys(ranks, INTERLEAVED, 3);
    else if (most_chunks == MAX_UNROLLED_CHUNKS)
        find_keys(ranks, INTERLEAVED, MAX_UNROLLED_CHUNKS);
    else
        for (int i = 0; i < n; ++i) find_keys(&ranks[i], 1, n_chunks(found[i]));
    for (int i = 0; i < n; ++i)
        resolve_rank(coords, bounds[i], rank_slack[i], found[i], ranks[i], ids);
}

#endif
