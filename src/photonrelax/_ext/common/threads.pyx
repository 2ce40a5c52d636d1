"""Parallel loops that behave; see threads.pxd."""

from cython.parallel cimport threadid
from libc.limits cimport INT_MAX
from posix.unistd cimport getpid

cdef extern from *:
    """
    static __thread int limit_here = INT_MAX;
    """
    # The most threads of any loop that the calling thread starts.
    int limit_here

cdef extern from "Python.h":
    # Its exception stays set, for `close_watch` to raise: not declared as raising.
    int PyErr_CheckSignals() noexcept

# Seconds between looks for signals. A look takes the GIL.
cdef double CHECK_INTERVAL = 0.05

# The process that loaded the OpenMP runtime.
cdef int home = getpid()
# The most threads of any loop of this process.
cdef int limit = INT_MAX
# Linkers may leave out a library of which nothing is used; this is the module that loads it.
threadid()


cdef int team_size(int n_threads, Py_ssize_t n_items, Py_ssize_t grain) noexcept nogil:
    """The number of threads of a parallel loop over `n_items`, at least `grain` each.

    Less work than the grain takes no longer than to wake a thread, which may have to wait for a
    core of a shared machine. In a forked child it is one: the threads of libgomp's pool do not
    survive a fork, and a loop that counts on them would wait for ever.
    """
    if getpid() != home:
        return 1
    return <int> max(1, min(<Py_ssize_t> min(n_threads, limit, limit_here), n_items // grain))


def limit_teams(int n_threads):
    """Hold all loops of this process to a number of threads, however many they are given."""
    global limit
    limit = n_threads


def limit_teams_here(int n_threads):
    """Hold all loops that the calling thread starts to a number of threads."""
    global limit_here
    limit_here = n_threads


def team_limit():
    """The most threads of any loop that the calling thread starts."""
    return min(limit, limit_here)


cdef Watch open_watch() noexcept nogil:
    cdef Watch watch
    watch.raised = False
    watch.next_check = seconds_now() + CHECK_INTERVAL
    return watch


cdef bint check_signals(Watch* watch) noexcept nogil:
    """Run the handlers of signals that have arrived; false if one has raised."""
    if not watch.raised:
        watch.raised = raised_by_handler()
        watch.next_check = seconds_now() + CHECK_INTERVAL
    return not watch.raised


cdef bint raised_by_handler() noexcept with gil:
    return PyErr_CheckSignals() != 0


cdef int close_watch(const Watch* watch) except -1:
    """Raise the exception of a signal handler, if there was one."""
    return -1 if watch.raised else 0
