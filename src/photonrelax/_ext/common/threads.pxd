"""Parallel loops that behave: the number of their threads, and interrupts while they run."""

from posix.time cimport CLOCK_MONOTONIC, clock_gettime, timespec


cdef enum:
    # Elements of a thread, at least, where a loop computes little of each.
    ELEMENTS = 1 << 12


cdef int team_size(int n_threads, Py_ssize_t n_items, Py_ssize_t grain) noexcept nogil


cdef struct Watch:
    # Watches for signals while a loop runs. `raised`: a signal handler raised an exception, which
    # is set in the calling thread; iterations that have not started are left out.
    bint raised
    double next_check


cdef Watch open_watch() noexcept nogil

cdef bint check_signals(Watch* watch) noexcept nogil

cdef int close_watch(const Watch* watch) except -1


cdef inline double seconds_now() noexcept nogil:
    cdef timespec now
    clock_gettime(CLOCK_MONOTONIC, &now)
    return <double> now.tv_sec + 1e-9 * <double> now.tv_nsec


cdef inline bint goes_on(Watch* watch, bint looks) noexcept nogil:
    """False once a signal handler has raised, for which only thread 0, the calling one, looks."""
    if looks and seconds_now() >= watch.next_check:
        check_signals(watch)
    return not watch.raised
