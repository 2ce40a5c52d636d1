"""What kernels.h declares; see there."""

from libc.stdint cimport int32_t, int64_t, uint8_t


cdef extern from "kernels.h" nogil:
    enum:
        BLOCK
        LANES
        FARTHEST
        OUTSIDE
        KEYS
        FEW_CHUNKS
        TOGETHER
        MOST_COPIED_AXES
        CONSTANT_WEIGHTS
        CONE_WEIGHTS
        EPANECHNIKOV_WEIGHTS

    ctypedef struct Reach:
        const double* low
        const double* high
        double squared_limit
        double squared_range
        const double* half_range
        int64_t n_metric
        int64_t n_axes

    ctypedef struct Frame:
        const double* origin
        double scale
        double range_scale
        int64_t n_metric
        int64_t n_axes

    ctypedef struct Local:
        const float* at
        float squared_limit
        float squared_range
        float limit_slack
        float range_slack
        float doubt

    ctypedef struct Found:
        int32_t* blocks
        uint8_t* keys
        float* heights
        int64_t n_blocks
        int64_t count
        double squared_radius
        int64_t key
        int64_t n_few
        int32_t* few
        double* squared
        double* spare

    ctypedef struct Weights:
        int64_t shape
        double squared_bandwidth

    ctypedef struct Lanes:
        const char* name
        unsigned int (*boxes_near)(const double*, int64_t, const Reach*) noexcept nogil
        unsigned int (*copies_near)(
            const float*, int64_t, const Reach*, const Local*
        ) noexcept nogil
        void (*list_boxes)(
            const double*, int64_t, unsigned int, double*, int64_t
        ) noexcept nogil
        void (*copy_rows)(
            const double*, int64_t, int64_t, const Frame*, float*
        ) noexcept nogil
        void (*copy_blocks)(
            const double*, const int32_t*, int64_t, const Frame*, float*
        ) noexcept nogil
        void (*scan)(
            const double*, const int32_t*, unsigned int, const Reach*, Found*
        ) noexcept nogil
        void (*scan_copies)(
            const double*, const float*, const int32_t*, unsigned int, const Reach*, const Local*,
            Found*
        ) noexcept nogil
        void (*rescan)(const double*, const Reach*, Found*) noexcept nogil
        void (*nearest)(
            const double*, const Reach**, const float*, Found**, int, int64_t, const int64_t*
        ) noexcept nogil
        void (*compact)(Found*) noexcept nogil
        void (*list)(
            const double*, const Reach*, const Found*, const int64_t*, double*, int64_t*
        ) noexcept nogil
        void (*list_points)(const double*, int64_t, const Found*, double*) noexcept nogil
        void (*sort)(
            const double*, const int64_t*, int64_t, double, double*, int64_t*
        ) noexcept nogil
        void (*write)(double*, int64_t*, int64_t, int, double*, int64_t*) noexcept nogil
        void (*moments)(
            const double*, int64_t, const Found*, const double*, const double*, double*
        ) noexcept nogil
        void (*repulsion)(double*, int64_t, double, const double*, double*) noexcept nogil
        void (*weigh)(
            const double*, const Reach*, const Found*, const Weights*, const double*, int64_t,
            double*
        ) noexcept nogil

    int64_t last_found(const Found* found, const int64_t* ids)
    int lowest_bit(unsigned int bits)
    int count_bits(unsigned int bits)
    int highest_bit(unsigned int bits)
    void finish_writing()
    void prefetch_row(const void* row, int64_t n_bytes)
    const Lanes* lanes_named(const char* name)
