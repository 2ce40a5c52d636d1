"""What lanes.h declares; see there."""

from libc.stdint cimport int32_t, int64_t, uint8_t


cdef extern from "lanes.h" nogil:
    enum:
        BLOCK
        LANES
        OUTSIDE
        KEYS
        FEW_CHUNKS
        TOGETHER

    ctypedef struct Reach:
        const double* low
        const double* high
        double squared_limit
        double squared_range
        double key_scale
        const double* half_range
        int64_t n_metric
        int64_t n_axes

    ctypedef struct Found:
        int32_t* blocks
        double* squared
        uint8_t* keys
        int64_t n_blocks
        int64_t count
        double squared_radius

    ctypedef struct Lanes:
        const char* name
        unsigned int (*boxes_near)(const double*, const Reach*) noexcept nogil
        void (*scan)(const double*, const int32_t*, int64_t, const Reach*, Found*) noexcept nogil
        void (*nearest)(Found**, int, int64_t, const int64_t*) noexcept nogil
        void (*compact)(Found*, double) noexcept nogil
        void (*list)(const Found*, double*, int64_t*) noexcept nogil
        void (*list_points)(const double*, int64_t, const Found*, double*, double*) noexcept nogil
        void (*sorted)(
            double*, const int64_t*, int64_t, double, const int64_t*, double*, int64_t*
        ) noexcept nogil
        void (*moments)(
            const double*, int64_t, const Found*, const double*, const double*, double, double*
        ) noexcept nogil
        void (*repulsion)(
            double*, double*, int64_t, double, const double*, double*
        ) noexcept nogil

    double key_scale(double squared_limit)
    int lowest_bit(unsigned int bits)
    int highest_bit(unsigned int bits)
    void prefetch_row(const void* row, int64_t n_bytes)
    const Lanes* lanes_named(const char* name)
