"""Work on processes compared with the same in one process: times, bytes moved, lost workers.

``python -m bench scaling`` traces photons, makes passes and renders frames of `pool` in pools of
one-thread workers, in turns with one thread of this process.
"""

from __future__ import annotations

import argparse
import os
import pickle
import signal
import tempfile
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Executor, Future, ProcessPoolExecutor
from contextlib import contextmanager, suppress
from multiprocessing import get_context
from pathlib import Path
from statistics import median
from time import perf_counter, process_time

import photonrelax as pr
from bench.arguments import numbers
from bench.markdown import markdown_table
from bench.speed import machine
from photonrelax._util.workers import WorkerLostError, worker_map
from photonrelax.rendering.animation import Animation

Work = Callable[[Executor | None], object]

_PIXELS = 300
_TRIVIAL_TASKS = 500


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--photons", type=float, default=1e7, help="of a trace; default 1e7")
    parser.add_argument("--passes", type=int, default=24, help="of 100,000 photons; default 24")
    parser.add_argument("--frames", type=int, default=8, help="of 100,000 photons; default 8")
    parser.add_argument("--workers", type=numbers, default=[1, 2, 4], help="default 1,2,4")
    parser.add_argument("--rounds", type=int, default=3, help="default 3")


def run(options: argparse.Namespace) -> None:
    """Print the tables."""
    scene = pr.gallery.scene("pool", pixels=_PIXELS)
    works = {
        f"{options.photons:,.0f} photons": _trace(scene, int(options.photons)),
        f"{options.passes} passes": _passes(scene, options.passes),
        f"{options.frames} frames": _frames(options.frames),
    }
    rows = [row for name, work in works.items() for row in _rows(name, work, options)]
    titles = ["work", "workers", "wall, s", "over one process", "CPU of workers, s", "CPU here, s"]
    print(markdown_table([*titles, "sent, MB", "received, MB"], rows), end="\n\n")
    print(f"A task that does nothing takes {1e3 * _overhead():.2g} ms.")
    print(f"A worker killed half way: {_lost(scene, options.passes)}.", end="\n\n")
    print(f"Medians of {options.rounds} in turns. {machine.description()}.")


def _trace(scene: pr.Scene, n: int) -> Work:
    return lambda executor: pr.trace_photons(scene, n, n_threads=1, executor=executor)


def _passes(scene: pr.Scene, n: int, checkpoints: pr.Checkpoints | None = None) -> Work:
    return lambda executor: pr.render_progressive(
        scene,
        n_passes=n,
        settings=pr.ProgressiveSettings(radius="global"),
        checkpoints=checkpoints,
        n_threads=1,
        executor=executor,
    )


def _frames(n: int) -> Work:
    animation = Animation(
        lambda time: pr.gallery.scene("pool", pixels=_PIXELS, time=time),
        [0.1 * number for number in range(n)],
        n_emitted=100_000,
        n_threads=1,
    )
    return lambda executor: list(animation.frames(range(n), executor))


def _rows(name: str, work: Work, options: argparse.Namespace) -> Iterator[list[str]]:
    alone: list[tuple[float, float]] = []
    found: dict[int, list[tuple[float, float, float]]] = {n: [] for n in options.workers}
    for _ in range(options.rounds):
        here, started = process_time(), perf_counter()
        work(None)
        alone.append((perf_counter() - started, process_time() - here))
        for n in options.workers:
            found[n].append(_measured(work, n))
    usual, cpu = (median(column) for column in zip(*alone, strict=True))
    yield [name, "none", f"{usual:.2f}", "1", "", f"{cpu:.2f}", "", ""]
    sent, received = _bytes(work)
    for n, times in found.items():
        wall, there, here = (median(column) for column in zip(*times, strict=True))
        cells = [f"{wall:.2f}", f"{wall / usual:.2f}", f"{there:.2f}", f"{here:.2f}"]
        yield [name, str(n), *cells, f"{sent / 1e6:.1f}", f"{received / 1e6:.1f}"]


def _measured(work: Work, n: int) -> tuple[float, float, float]:
    """Wall time, CPU time of warm workers and of this process, s."""
    with _pool(n) as pool:
        before, here, started = _cpu(pool), process_time(), perf_counter()
        work(pool)
        wall, here = perf_counter() - started, process_time() - here
        return wall, _cpu(pool) - before, here


@contextmanager
def _pool(n: int) -> Iterator[ProcessPoolExecutor]:
    """Yield a pool whose workers have imported what they need."""
    with ProcessPoolExecutor(n, mp_context=get_context("spawn")) as pool:
        warm = pr.gallery.scene("ring", pixels=8, sections=16)
        for _ in range(2):
            pr.render(warm, n_emitted=100 * n, executor=pool)
        yield pool


def _cpu(pool: ProcessPoolExecutor) -> float:
    """CPU time of the processes of a pool so far, s; from Linux's proc file system."""
    ticks = 0
    for pid in pool._processes:
        user, system = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[11:13]
        ticks += int(user) + int(system)
    return ticks / os.sysconf("SC_CLK_TCK")


class _Counter(Executor):
    """An executor that counts the bytes of tasks and results, and of the values they share."""

    def __init__(self, executor: Executor) -> None:
        self._executor = executor
        self.sent = self.received = 0
        self._seen: set[str] = set()

    def submit(self, work: Callable, *arguments: object) -> Future:
        self.sent += len(pickle.dumps((work, arguments)))
        path = arguments[1][1]
        if path not in self._seen:
            self._seen.add(path)
            self.sent += Path(path).stat().st_size
        future = self._executor.submit(work, *arguments)
        future.add_done_callback(self._receive)
        return future

    def _receive(self, future: Future) -> None:
        if not future.cancelled() and future.exception() is None:
            self.received += len(pickle.dumps(future.result(), protocol=5))


def _bytes(work: Work) -> tuple[int, int]:
    with _pool(1) as pool:
        counter = _Counter(pool)
        work(counter)
        return counter.sent, counter.received


def _overhead() -> float:
    """Seconds of a task that does nothing."""
    with _pool(1) as pool:
        started = perf_counter()
        _exhaust(worker_map(_nothing, None, range(_TRIVIAL_TASKS), pool))
        return (perf_counter() - started) / _TRIVIAL_TASKS


def _nothing(value: None, job: int) -> None:
    return None


def _exhaust(results: Iterable[object]) -> None:
    for _ in results:
        pass


class _Killer(_Counter):
    """An executor that loses a worker when a number of results is there."""

    def __init__(self, pool: ProcessPoolExecutor, after: int) -> None:
        super().__init__(pool)
        self._pool, self._left = pool, after

    def _receive(self, future: Future) -> None:
        self._left -= 1
        if self._left == 0:
            os.kill(next(iter(self._pool._processes)), signal.SIGKILL)


def _lost(scene: pr.Scene, n_passes: int) -> str:
    """Time of passes with and without a worker that is killed, in words."""
    with tempfile.TemporaryDirectory() as folder:
        state = pr.Checkpoints(Path(folder) / "run.npz")
        work = _passes(scene, n_passes, state)
        started = perf_counter()
        with _pool(2) as pool, suppress(WorkerLostError):
            work(_Killer(pool, n_passes // 2))
        lost_at = perf_counter() - started
        with _pool(2) as pool:
            work(pool)
        with_death = perf_counter() - started
    started = perf_counter()
    with _pool(2) as pool:
        _passes(scene, n_passes)(pool)
    straight = perf_counter() - started
    return (
        f"{n_passes} passes on two workers take {straight:.1f} s, starts included; with one killed "
        f"after {lost_at:.1f} s, and resumed by a new pool, {with_death:.1f} s"
    )
