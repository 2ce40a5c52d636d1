"""Declarations of kernels.h; see there."""

from libc.stdint cimport int32_t, int64_t, uint8_t


cdef extern from "kernels.h" nogil:
    enum:
        BLOCK
        LANES
        LIMIT_KEY
        OUTSIDE_KEY
        KEY_CHUNK
        MAX_UNROLLED_CHUNKS
        INTERLEAVED
        MAX_FLOAT_AXES
        CONSTANT_WEIGHTS
        CONE_WEIGHTS
        EPANECHNIKOV_WEIGHTS
        GAUSSIAN_WEIGHTS
        QUADRATIC_TERMS
        LATTICE_HALF

    const double GAUSSIAN_DEVIATION
    const double GAUSSIAN_EXPONENT
    const double GAUSSIAN_PEAK

    ctypedef struct SearchBounds:
        const double* low
        const double* high
        double squared_limit
        double squared_range
        const double* half_range
        int64_t n_metric
        int64_t n_axes

    ctypedef struct Quantisation:
        const double* origin
        double scale
        double range_scale
        int64_t n_metric
        int64_t n_axes

    ctypedef struct FloatQuery:
        const float* at
        float squared_limit
        float squared_range
        float limit_slack
        float range_slack
        float rank_slack

    ctypedef struct Candidates:
        int32_t* blocks
        uint8_t* rank_keys
        float* scaled_distances
        int64_t n_blocks
        int64_t count
        double squared_radius
        int64_t max_rank_key
        int64_t n_ties
        int32_t* ties
        double* tie_squared
        double* scratch

    ctypedef struct Weights:
        int64_t shape
        double squared_bandwidth

    ctypedef struct Rectangle:
        const double* at
        double[9] axes
        double[3] half
        double squared_range
        int64_t n_axes

    ctypedef struct RectangleWeights:
        double squared_radius
        double inverse_deviation
        int64_t[2] is_narrow
        double[2][4] series

    ctypedef struct SlantedWeights:
        int64_t n_nodes
        const double* nodes
        const double* weights
        double first_half
        double first_scale
        double slope
        double second_scale
        double half
        double[4] series
        int64_t is_narrow

    # Of KEY_CHUNK rows of LANES, and of QUADRATIC_TERMS rows.
    ctypedef struct MapSamples:
        double[64][8] a
        double[64][8] b
        double[64][8] u
        double[64][8] v

    ctypedef struct QuadraticMaps:
        double[6][8] u
        double[6][8] v
        double[8] scale
        double[8] residual
        double[8] unevenness
        double[8] sum_a
        double[8] sum_b

    ctypedef struct LatticeMap:
        double[5] u
        double[5] v
        double[2] inward
        double edge

    ctypedef struct SimdKernels:
        const char* name
        unsigned int (*overlapping_boxes)(
            const double*, int64_t, const SearchBounds*
        ) noexcept nogil
        unsigned int (*overlapping_float_boxes)(
            const float*, int64_t, const SearchBounds*, const FloatQuery*
        ) noexcept nogil
        void (*pack_boxes)(
            const double*, int64_t, unsigned int, double*, int64_t
        ) noexcept nogil
        void (*quantise_rows)(
            const double*, int64_t, int64_t, const Quantisation*, float*
        ) noexcept nogil
        void (*quantise_blocks)(
            const double*, const int32_t*, int64_t, const Quantisation*, float*
        ) noexcept nogil
        void (*scan_blocks)(
            const double*, const int32_t*, unsigned int, const SearchBounds*, Candidates*
        ) noexcept nogil
        void (*scan_float_blocks)(
            const double*, const float*, const int32_t*, unsigned int, const SearchBounds*,
            const FloatQuery*, Candidates*
        ) noexcept nogil
        void (*rescan)(const double*, const SearchBounds*, Candidates*) noexcept nogil
        void (*select_nearest)(
            const double*, const SearchBounds**, const float*, Candidates**, int, int64_t,
            const int64_t*
        ) noexcept nogil
        void (*compact)(Candidates*) noexcept nogil
        void (*gather_neighbours)(
            const double*, const SearchBounds*, const Candidates*, const int64_t*, double*,
            int64_t*
        ) noexcept nogil
        void (*gather_points)(
            const double*, int64_t, const Candidates*, double*
        ) noexcept nogil
        void (*sort_neighbours)(
            const double*, const int64_t*, int64_t, double, double*, int64_t*
        ) noexcept nogil
        void (*write_neighbours)(
            double*, int64_t*, int64_t, int, double*, int64_t*
        ) noexcept nogil
        void (*moments)(
            const double*, int64_t, const Candidates*, const double*, const double*, double*
        ) noexcept nogil
        void (*repulsion)(double*, int64_t, double, const double*, double*) noexcept nogil
        void (*weighted_sum)(
            const double*, const SearchBounds*, const Candidates*, const Weights*, const double*,
            int64_t, double*
        ) noexcept nogil
        unsigned int (*boxes_near_rectangle)(
            const double*, const Rectangle*, double, double, unsigned int*
        ) noexcept nogil
        int64_t (*rectangle_band)(
            const double*, const int32_t*, int64_t, const Rectangle*, double, double, double*,
            int64_t, int64_t*
        ) noexcept nogil
        void (*rectangle_sum)(
            const double*, const int32_t*, int64_t, const Rectangle*, const RectangleWeights*,
            const double*, int64_t, double*
        ) noexcept nogil
        void (*slanted_weights)(
            const double*, const double*, const SlantedWeights*, double*
        ) noexcept nogil
        void (*fit_maps)(MapSamples*, int64_t, int64_t, QuadraticMaps*) noexcept nogil
        double (*lattice_repulsion)(
            const double*, const LatticeMap*, double, int64_t, double*
        ) noexcept nogil

    int64_t farthest_candidate(const Candidates* found, const int64_t* ids)
    int lowest_bit(unsigned int bits)
    int count_bits(unsigned int bits)
    int highest_bit(unsigned int bits)
    void store_fence()
    const SimdKernels* simd_kernels_named(const char* name)
