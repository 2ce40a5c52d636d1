"""Thread counts, and ordered maps over an executor."""

from __future__ import annotations

import math
import os
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Executor, Future, ThreadPoolExecutor
from contextlib import contextmanager
from typing import TypeVar

from .._ext.common.threads import limit_teams_here, team_limit
from .cgroups import cpu_quota
from .validation import count

Job = TypeVar("Job")
Result = TypeVar("Result")

# More threads than this the OpenMP runtime may refuse, and with it end the process.
_MAX_THREADS = 1024


def thread_count(n_threads: int | None) -> int:
    """Return the number of threads to use; None means every core this process may use.

    Those of its affinity, and no more than the CPU quotas of its control groups, rounded up.

    Raises
    ------
    TypeError, ValueError
        If it is neither None nor an integer from 1 to 1024.
    """
    if n_threads is None:
        return min(_n_cores(), _MAX_THREADS)
    return count(n_threads, "n_threads", high=_MAX_THREADS)


def _n_cores() -> int:
    # macOS has no affinity.
    if hasattr(os, "sched_getaffinity"):
        n_cores = len(os.sched_getaffinity(0))
    else:
        n_cores = os.cpu_count() or 1
    quota = cpu_quota()
    return n_cores if quota >= n_cores else max(1, math.ceil(quota))


@contextmanager
def thread_executor(n_threads: int, *, n_each: int | None = None) -> Iterator[Executor | None]:
    """Yield an executor of so many threads, None for one; it ends with the running calls.

    Loops in kernels that a thread starts have `n_each` threads at most, if that is given.
    """
    n_threads = min(n_threads, team_limit())
    if n_threads <= 1:
        yield None
        return
    start = (limit_teams_here, (n_each,)) if n_each else (None, ())
    executor = ThreadPoolExecutor(n_threads, "", *start)
    try:
        yield executor
    finally:
        executor.shutdown(cancel_futures=True)


def ordered_map(
    work: Callable[[Job], Result],
    jobs: Iterable[Job],
    executor: Executor | None,
    *,
    max_pending: int | None = None,
) -> Iterator[Result]:
    """Yield ``work(job)`` in the order of the jobs.

    An error, an interrupt or the end of the iteration cancels the jobs that have not started.

    Parameters
    ----------
    work : callable
        Must be picklable, like jobs and results, for an executor of processes.
    jobs : iterable
        Taken one at a time, as earlier ones are finished.
    executor : concurrent.futures.Executor or None
        None calls `work` in the calling thread.
    max_pending : int, optional
        Jobs submitted but not yet yielded; twice the number of cores by default.
    """
    if executor is None:
        yield from map(work, jobs)
        return
    limit = max_pending or 2 * thread_count(None)
    pending: deque[Future[Result]] = deque()
    try:
        for job in jobs:
            pending.append(executor.submit(work, job))
            if len(pending) > limit:
                yield pending.popleft().result()
        while pending:
            yield pending.popleft().result()
    finally:
        for future in pending:
            future.cancel()


def for_each_slice(work: Callable[[slice], None], n: int, size: int, n_threads: int) -> None:
    """Call `work` on slices of `size` rows that cover range(n), from several threads."""
    slices = [slice(first, min(first + size, n)) for first in range(0, n, size)]
    with thread_executor(min(n_threads, len(slices))) as executor:
        for _ in ordered_map(work, slices, executor, max_pending=2 * n_threads):
            pass
