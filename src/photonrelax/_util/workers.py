"""Ordered maps over executors of processes, whose workers keep what they were sent.

An executor has `submit` alone, and workers come and go. A task names the value that it needs by its
digest, and a file of it in a temporary folder (`TMPDIR`); a worker that neither has kept it nor
sees the file says so, and the task is sent again with the value itself, or the name under which
Dask has scattered it to its workers.
"""

from __future__ import annotations

import pickle
import signal
import tempfile
import traceback
import warnings
from collections import deque
from collections.abc import Callable, Generator, Iterable, Iterator
from concurrent.futures import BrokenExecutor, CancelledError, Executor, Future, ThreadPoolExecutor
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from types import FrameType
from typing import Any, NamedTuple, TypeVar
from uuid import uuid4

from .._ext.common.threads import limit_teams
from .._version import SEED_LAYOUT, __version__
from .parallel import ordered_map, thread_count, thread_executor
from .parcels import Parcel, is_kept, kept, unpack, unpack_file
from .platforms import Platform, platform_of_process, warn_of_mixture

Value = TypeVar("Value")
Job = TypeVar("Job")
Result = TypeVar("Result")

# What client and workers have to share for the same bytes.
_RELEASE = (__version__, SEED_LAYOUT)
# Some executors work in threads of this very process.
_PROCESS = uuid4().hex
# Tasks submitted and not yet yielded, for each worker: so many wait while results are taken.
_PENDING = 3
_TASKS_PER_WORKER = 4
# By name, as the packages they are in may not be imported.
_DEATHS = ("KilledWorker", "FutureCancelledError")


class WorkerLostError(OSError):
    """A worker of an executor ended before its task did."""


class WorkerTraceback(Exception):  # noqa: N818
    """Traceback of an error in a worker, as its cause."""

    def __str__(self) -> str:
        return f"in a worker:\n{self.args[0]}"


def worker_map(
    work: Callable[[Value, Job], Result],
    value: Value,
    jobs: Iterable[Job],
    executor: Executor | None,
    *,
    n_threads: int = 1,
) -> Generator[Result]:
    """Yield ``work(value, job)`` in the order of the jobs.

    Parameters
    ----------
    work : callable
        A function of a module, or a partial of one.
    value : picklable
        What all jobs need; a worker unpacks it once.
    jobs : iterable
        Taken one at a time, as earlier ones are finished; small.
    executor : concurrent.futures.Executor or None
        Of threads, or of processes on any machines; None for the calling thread.
    n_threads : int
        Threads of a task in another process.

    Raises
    ------
    WorkerLostError
        If a worker ends early. Jobs that were yielded are done.
    ValueError
        If a worker has another version of the package. Errors of `work` have the worker's
        traceback as their cause.
    """
    if executor is None or isinstance(executor, ThreadPoolExecutor):
        limit = None if executor is None else 2 * n_workers(executor)
        yield from ordered_map(partial(work, value), jobs, executor, max_pending=limit)
        return
    with tempfile.TemporaryDirectory(prefix="photonrelax-", ignore_cleanup_errors=True) as folder:
        tasks = _Tasks(executor, Parcel(value), Path(folder), n_threads)
        yield from tasks.results(work, jobs)


class Workers(NamedTuple):
    """An executor, None for the calling thread, and the threads of each of its tasks."""

    executor: Executor | None
    n_threads: int

    @property
    def n_tasks(self) -> int:
        """Tasks that work is best divided into, at least, so that all workers end together."""
        return 1 if self.executor is None else _TASKS_PER_WORKER * n_workers(self.executor)

    @contextmanager
    def or_threads(self, n: int) -> Iterator[Workers]:
        """Yield these workers; without an executor so many threads, whose loops have one."""
        if self.executor is not None:
            yield self
            return
        with thread_executor(n, n_each=1) as executor:
            yield self._replace(executor=executor)

    def map(
        self, work: Callable[[Value, Job], Result], value: Value, jobs: Iterable[Job]
    ) -> Generator[Result]:
        """`worker_map` over the jobs."""
        return worker_map(work, value, jobs, self.executor, n_threads=self.n_threads)


def checked_executor(executor: Executor | None) -> Executor | None:
    """An executor, or None; raises TypeError if it is something else."""
    if executor is not None and not isinstance(executor, Executor):
        raise TypeError(
            "executor should be a concurrent.futures.Executor or None, but is "
            f"{type(executor).__name__}: that of a Dask client is client.get_executor()"
        )
    return executor


def n_workers(executor: Executor | None) -> int:
    """Workers of an executor, as far as it tells: else as many as there are cores here."""
    client: Any = getattr(executor, "_client", None)
    if hasattr(client, "nthreads"):
        return max(sum(client.nthreads().values()), 1)
    for name in ("num_workers", "_max_workers"):
        n = getattr(executor, name, None)
        if isinstance(n, int) and n > 0:
            return n
    return thread_count(None) if executor is not None else 1


class _Sent(NamedTuple):
    payload: bytes
    future: Future[_Reply]


class _Reply(NamedTuple):
    """Outcome of a task; `value` is its result, its error with a traceback, or a release."""

    outcome: str
    value: Any
    platform: Platform | None = None
    warnings: tuple[tuple[str, type[Warning]], ...] = ()


class _Tasks:
    """Tasks of a map on an executor, and the value that they share."""

    def __init__(self, executor: Executor, parcel: Parcel, folder: Path, n_threads: int) -> None:
        self._executor, self._parcel = executor, parcel
        self._path = folder / parcel.digest
        parcel.write(self._path)
        self._n_threads = n_threads
        # For workers that do not see the folder, once there are any.
        self._content: Any = None
        self._pending: deque[_Sent] = deque()
        self._platforms: set[Platform] = set()

    def results(self, work: Callable[[Value, Job], Result], jobs: Iterable[Job]) -> Iterator[Any]:
        """Results in the order of the jobs."""
        limit = _PENDING * n_workers(self._executor)
        lost = None
        try:
            for job in jobs:
                try:
                    self._pending.append(self._submit(pickle.dumps((work, job), protocol=5)))
                except WorkerLostError as error:
                    # What was done before is not lost.
                    lost = error
                    break
                if len(self._pending) > limit:
                    yield self._next()
            while self._pending:
                yield self._next()
            if lost is not None:
                raise lost
        finally:
            for sent in self._pending:
                sent.future.cancel()

    def _submit(self, payload: bytes, content: Any = None) -> _Sent:
        where = self._parcel.digest, str(self._path), content
        with _named_death():
            future = self._executor.submit(
                _run, _RELEASE, where, self._n_threads, payload, _PROCESS
            )
        return _Sent(payload, future)

    def _next(self) -> Any:
        """Result of the task that was submitted first."""
        reply = self._reply(self._pending[0])
        while reply.outcome == "missing":
            self._send_again()
            reply = self._reply(self._pending[0])
        self._pending.popleft()
        self._check(reply)
        for text, category in reply.warnings:
            warnings.warn(text, category, stacklevel=2)
        return reply.value

    @staticmethod
    def _reply(sent: _Sent) -> _Reply:
        with _named_death():
            return sent.future.result()

    def _send_again(self) -> None:
        """Send all tasks that came back for want of their value again, with it."""
        if self._content is None:
            self._content = _scattered(self._executor, self._parcel.to_bytes())
        for i, sent in enumerate(self._pending):
            if sent.future.done() and self._reply(sent).outcome == "missing":
                self._pending[i] = self._submit(sent.payload, self._content)

    def _check(self, reply: _Reply) -> None:
        if reply.outcome == "refused":
            raise ValueError(
                f"workers should have photonrelax {_described(_RELEASE)} as this process, but one "
                f"has {_described(reply.value)}: install the same everywhere"
            )
        if reply.platform is not None and reply.platform not in self._platforms:
            self._platforms.add(reply.platform)
            warn_of_mixture(self._platforms)
        if reply.outcome == "failed":
            error, trace = reply.value
            raise error from WorkerTraceback(trace)


def _scattered(executor: Executor, content: bytes) -> Any:
    """Content of tasks: bytes, or the name by which Dask's workers have them already."""
    client: Any = getattr(executor, "_client", None)
    if not hasattr(client, "scatter"):
        return content
    # To all, so that those of a worker that ends are not lost.
    with _named_death():
        return client.scatter(content, broadcast=True, hash=False)


def _described(release: tuple[str, int]) -> str:
    return f"{release[0]} (seeds of layout {release[1]})"


@contextmanager
def _named_death() -> Iterator[None]:
    """Raise WorkerLostError in place of the errors of executors whose workers have ended."""
    try:
        yield
    except Exception as error:
        is_death = isinstance(error, BrokenExecutor | CancelledError)
        if not is_death and type(error).__name__ not in _DEATHS:
            raise
        raise WorkerLostError(
            "a worker ended before its task was done: it was killed, perhaps for its memory, or "
            "its machine was lost; start again with a new executor, fewer workers or more memory"
        ) from error


# --- in a worker ----------------------------------------------------------------------------------

ENDING = (signal.SIGINT, signal.SIGTERM)
"""Signals that are blocked where a worker starts that is to hear of endings."""
# Seconds.
_UNTIL_RAISED_AGAIN = 0.2
_is_running, _has_ended = False, False


def hear_endings() -> None:
    """Let SIGTERM end the task that this process is at, and all that follow.

    A process that ended while it sends a result would leave its executor waiting for the rest.
    Ctrl-C, which goes to all processes of a terminal, is left to the one that has the executor.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    for number in (signal.SIGTERM, signal.SIGALRM):
        signal.signal(number, _end)
    signal.pthread_sigmask(signal.SIG_UNBLOCK, ENDING)


def _end(number: int, frame: FrameType | None) -> None:
    global _has_ended
    _has_ended = True
    if _is_running:
        # Python drops what is raised while it calls a destructor or a callback.
        signal.setitimer(signal.ITIMER_REAL, _UNTIL_RAISED_AGAIN)
        raise KeyboardInterrupt


@contextmanager
def _until_ended() -> Iterator[None]:
    """A task, in which SIGTERM raises KeyboardInterrupt if this process hears of endings."""
    global _is_running
    _is_running = True
    try:
        if _has_ended:
            raise KeyboardInterrupt
        yield
    finally:
        _is_running = False


def _run(
    release: tuple[str, int],
    where: tuple[str, str, bytes | None],
    n_threads: int,
    payload: bytes,
    sender: str,
) -> _Reply:
    """Reply of this process to a task."""
    if release != _RELEASE:
        return _Reply("refused", _RELEASE)
    platform = platform_of_process()
    if sender != _PROCESS:
        limit_teams(n_threads)
    digest, path, content = where
    if content is None and not is_kept(digest) and not Path(path).exists():
        return _Reply("missing", None, platform)
    try:
        build = partial(unpack_file, path) if content is None else partial(unpack, content)
        value = kept(digest, build)
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            work, job = pickle.loads(payload)
            with _until_ended():
                result = work(value, job)
    except Exception as error:
        return _Reply("failed", (_picklable(error), traceback.format_exc()), platform)
    given = tuple((str(each.message), each.category) for each in caught)
    return _Reply("done", result, platform, given)


def _picklable(error: Exception) -> Exception:
    try:
        copy = pickle.loads(pickle.dumps(error))
    except Exception:
        copy = None
    if type(copy) is type(error):
        return error
    return RuntimeError(f"{type(error).__name__}: {error}")
