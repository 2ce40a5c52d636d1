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
    """Yield an executor of processes; after an error they are ended with what they are doing."""
    from concurrent.futures import ProcessPoolExecutor
    from multiprocessing import active_children, get_context

    others = set(active_children())
    # OpenMP does not survive a fork.
    pool = ProcessPoolExecutor(n, mp_context=get_context("spawn"), initializer=_leave_interrupts)
    try:
        yield pool
    except BaseException:
        pool.shutdown(wait=False, cancel_futures=True)
        for process in set(active_children()) - others:
            process.terminate()
        raise
    pool.shutdown()


def _leave_interrupts() -> None:
    """Leave Ctrl-C, which goes to all processes of a terminal, to the one that has the work."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)


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
