"""Workers that commands hand their work to: processes here, or those of a Dask scheduler."""

from __future__ import annotations

import argparse
import signal
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

from .streams import write_lines

# Import lazily: most commands run without workers.
if TYPE_CHECKING:
    from concurrent.futures import Executor

# Seconds in which a scheduler should answer.
_ANSWER = "10s"


@contextmanager
def executor_of(options: argparse.Namespace) -> Iterator[Executor | None]:
    """Yield the executor that options ask for, None without; it ends with the context."""
    if options.scheduler is not None:
        with _dask(options.scheduler) as executor:
            yield executor
    elif options.workers is not None:
        with _processes(options.workers) as executor:
            yield executor
    else:
        yield None


@contextmanager
def _processes(n: int) -> Iterator[Executor]:
    """Yield an executor of processes; after an error they end the tasks that they are at."""
    from concurrent.futures import ProcessPoolExecutor
    from multiprocessing import active_children, get_context

    from .._util.workers import ENDING, hear_endings

    others = set(active_children())
    # OpenMP does not survive a fork.
    pool = ProcessPoolExecutor(n, mp_context=get_context("spawn"), initializer=hear_endings)
    try:
        # The first task starts all processes. Signals wait until they are heard there.
        signal.pthread_sigmask(signal.SIG_BLOCK, ENDING)
        try:
            pool.submit(int)
        finally:
            signal.pthread_sigmask(signal.SIG_UNBLOCK, ENDING)
        yield pool
    except BaseException:
        pool.shutdown(wait=False, cancel_futures=True)
        for process in set(active_children()) - others:
            process.terminate()
        raise
    pool.shutdown()


@contextmanager
def _dask(address: str) -> Iterator[Executor]:
    try:
        from distributed import Client
    except ImportError:
        raise ImportError(
            "--scheduler needs Dask, which is not installed: pip install photonrelax[distributed]"
        ) from None
    try:
        client = Client(address, timeout=_ANSWER)
    except (OSError, ValueError) as error:
        raise OSError(
            f"no Dask scheduler answers at {address}: {error}; start one with `dask scheduler`"
        ) from error
    with client:
        executor: Executor = client.get_executor()
        yield executor


def print_traceback(error: BaseException) -> None:
    """Print the traceback of a worker, or of this process, on standard error."""
    import traceback

    from .._util.workers import WorkerTraceback

    cause = error.__cause__
    if isinstance(cause, WorkerTraceback):
        write_lines(str(cause), to_stderr=True)
    else:
        write_lines("".join(traceback.format_exception(error)), to_stderr=True)
