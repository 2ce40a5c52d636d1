import threading
import time
from concurrent.futures import Future, ProcessPoolExecutor, ThreadPoolExecutor
from multiprocessing import get_context
from typing import ClassVar

import pytest
from photonrelax._ext.common.threads import team_limit

from photonrelax._util import parallel
from photonrelax._util.parallel import for_each_slice, ordered_map, thread_count, thread_executor


def double_late(job):
    """Later jobs are finished sooner."""
    time.sleep(0.002 * (20 - job))
    return 2 * job


@pytest.mark.parametrize("n_threads", [1, 2, 7])
def test_results_come_in_the_order_of_the_jobs(n_threads):
    with thread_executor(n_threads) as executor:
        assert list(ordered_map(double_late, range(20), executor)) == list(range(0, 40, 2))


def test_processes_do_as_well():
    with ProcessPoolExecutor(2, mp_context=get_context("spawn")) as executor:
        assert list(ordered_map(double_late, range(20), executor)) == list(range(0, 40, 2))


def test_one_thread_needs_no_executor():
    with thread_executor(1) as executor:
        assert executor is None
        names = set(ordered_map(lambda _: threading.current_thread().name, range(3), executor))
    assert names == {threading.current_thread().name}


def test_threads_may_have_loops_of_few_threads():
    before = team_limit()
    with thread_executor(2, n_each=3) as executor:
        assert executor.submit(team_limit).result() == 3
        # Executors within theirs are not larger.
        assert executor.submit(lambda: thread_executor(8).__enter__()._max_workers).result() == 3
    assert team_limit() == before > 3


def test_few_jobs_are_taken_ahead_of_the_results():
    taken = []

    def jobs():
        for job in range(100):
            taken.append(job)
            yield job

    with thread_executor(2) as executor:
        results = ordered_map(lambda job: job, jobs(), executor, max_pending=4)
        for number, result in enumerate(results):
            assert result == number
            assert len(taken) <= number + 5


class Recorder(ThreadPoolExecutor):
    """Remembers its futures."""

    futures: ClassVar[list[Future]] = []

    def submit(self, *args, **kwargs):
        self.futures.append(super().submit(*args, **kwargs))
        return self.futures[-1]


@pytest.fixture
def futures(monkeypatch):
    monkeypatch.setattr(parallel, "ThreadPoolExecutor", Recorder)
    monkeypatch.setattr(Recorder, "futures", [])
    return Recorder.futures


def wait_for_cancelled(futures):
    end = time.monotonic() + 60.0
    while not any(future.cancelled() for future in futures):
        assert time.monotonic() < end
        time.sleep(0.001)


@pytest.mark.parametrize("error", [ValueError, KeyboardInterrupt])
def test_after_an_error_waiting_jobs_are_cancelled(error, futures):
    def work(job):
        if job == 0:
            raise error("job 0")
        wait_for_cancelled(futures)

    with thread_executor(2) as executor, pytest.raises(error, match="job 0"):
        list(ordered_map(work, range(100), executor, max_pending=10))
    assert len(futures) == 11
    assert sum(future.cancelled() for future in futures) >= 8


def test_after_an_interrupt_of_the_consumer_waiting_jobs_are_cancelled(futures):
    def consume():
        with thread_executor(2) as executor:
            for _ in ordered_map(work, range(100), executor, max_pending=10):
                raise KeyboardInterrupt

    def work(job):
        if job:
            wait_for_cancelled(futures)

    with pytest.raises(KeyboardInterrupt):
        consume()
    assert len(futures) == 11
    assert sum(future.cancelled() for future in futures) >= 8


@pytest.mark.parametrize("n_threads", [1, 3])
@pytest.mark.parametrize("n", [0, 1, 10, 95])
def test_slices_cover_all_rows_once(n, n_threads):
    rows = [0] * n

    def work(chunk):
        assert len(rows[chunk]) <= 10
        rows[chunk] = [1 + row for row in rows[chunk]]

    for_each_slice(work, n, 10, n_threads)
    assert rows == [1] * n


def test_an_error_in_a_slice_is_raised():
    def fail(chunk):
        raise ValueError(f"rows from {chunk.start}")

    with pytest.raises(ValueError, match="rows from 0"):
        for_each_slice(fail, 100, 10, 2)


@pytest.mark.parametrize(
    ("n_threads", "error", "message"),
    [
        (0, ValueError, "n_threads should be at least 1"),
        (1025, ValueError, "n_threads should be at most 1024"),
        (1.5, TypeError, "n_threads should be an integer"),
    ],
)
def test_thread_counts_are_checked(n_threads, error, message):
    assert thread_count(3) == 3
    assert thread_count(None) >= 1
    with pytest.raises(error, match=message):
        thread_count(n_threads)
