"""Threads."""

from __future__ import annotations

import os

from .validation import count

# More threads than this the OpenMP runtime may refuse, and with it end the process.
_MOST_THREADS = 1024


def thread_count(n_threads: int | None) -> int:
    """Return the number of threads to use; None means every core this process may use.

    Raises
    ------
    TypeError, ValueError
        If it is neither None nor an integer from 1 to 1024.
    """
    if n_threads is None:
        if hasattr(os, "sched_getaffinity"):
            return len(os.sched_getaffinity(0))
        return os.cpu_count() or 1
    return count(n_threads, "n_threads", high=_MOST_THREADS)
