"""Maps over processes, whose workers keep what they were sent."""

import os
import signal
import time
import warnings
from concurrent.futures import Executor, Future, ThreadPoolExecutor

import numpy as np
import pytest

from photonrelax._util import workers
from photonrelax._util.platforms import Platform, platform_of_process, warn_of_mixture
from photonrelax._util.workers import WorkerLostError, WorkerTraceback, n_workers, worker_map
from tests.helpers.executors import shared_pool, spawned


class Loud:
    """Counts how often a process unpickles it."""

    n_unpickled = 0

    def __init__(self, array):
        self.array = array

    def __setstate__(self, state):
        self.__dict__.update(state)
        Loud.n_unpickled += 1


def scaled(value, job):
    return os.getpid(), Loud.n_unpickled, job * float(value.array.sum())


def test_results_are_in_order_and_a_value_is_unpickled_once_a_worker():
    jobs = range(20)
    found = list(worker_map(scaled, Loud(np.ones((100, 100))), jobs, shared_pool()))
    assert [result for _, _, result in found] == [1e4 * job for job in jobs]
    assert {count for _, count, _ in found} == {1}
    assert os.getpid() not in {pid for pid, _, _ in found}


@pytest.mark.parametrize("threads", [None, 3])
def test_threads_and_no_executor_get_the_value_itself(threads):
    value = Loud(np.ones(2))
    executor = None if threads is None else ThreadPoolExecutor(threads)
    assert [r for _, _, r in worker_map(scaled, value, range(9), executor)] == list(range(0, 18, 2))


class Elsewhere(Executor):
    """Runs tasks here, as a worker would that sees no file of the client."""

    def __init__(self, **changes):
        self.changes = changes
        self.contents = []

    def submit(self, run, release, where, n_threads, *others):
        digest, _, content = where
        self.contents.append(content)
        release = self.changes.get("release", release)
        future = Future()
        future.set_result(run(release, (digest, "/nowhere", content), n_threads, *others))
        return future


def first_column(value, job):
    return value[job]


def test_a_worker_that_sees_no_file_gets_the_value_with_a_task():
    executor, value = Elsewhere(), list(np.random.default_rng().random(4))
    assert list(worker_map(first_column, value, range(4), executor)) == value
    assert len([content for content in executor.contents if content]) < 4 + 1
    again = Elsewhere()
    assert list(worker_map(first_column, value, range(4), again)) == value
    assert again.contents == [None] * 4


def test_a_worker_of_another_version_is_refused_in_words():
    executor = Elsewhere(release=("0.0.9", 7))
    text = r"photonrelax .* as this process, but one has .*: install the same everywhere"
    with pytest.raises(ValueError, match=text):
        list(worker_map(first_column, [1.0], [0], executor))


def failing(value, job):
    raise KeyError(f"job {job}")


def test_an_error_has_the_traceback_of_the_worker():
    with pytest.raises(KeyError, match="job 0") as caught:
        list(worker_map(failing, None, range(3), shared_pool()))
    assert isinstance(caught.value.__cause__, WorkerTraceback)
    assert "in failing" in str(caught.value.__cause__)


class UnpicklableError(Exception):
    def __init__(self, one, two):
        super().__init__(one)


def failing_oddly(value, job):
    raise UnpicklableError("one", "two")


def test_an_error_that_cannot_be_pickled_is_described():
    with pytest.raises(RuntimeError, match="UnpicklableError: one"):
        list(worker_map(failing_oddly, None, [0], shared_pool()))


def warning(value, job):
    warnings.warn(f"job {job}", RuntimeWarning, stacklevel=1)


def test_warnings_of_workers_are_given_here():
    with pytest.warns(RuntimeWarning, match="job 5"):
        list(worker_map(warning, None, [5], shared_pool()))


def dying(value, job):
    if job == 1:
        os.kill(os.getpid(), signal.SIGKILL)
    return job


def test_a_worker_that_is_killed_is_one_line():
    with spawned(1) as executor:
        results = worker_map(dying, None, range(3), executor)
        with pytest.raises(WorkerLostError, match="a worker ended before its task was done") as one:
            list(results)
        assert "\n" not in str(one.value)
        with pytest.raises(WorkerLostError, match="start again with a new executor"):
            list(worker_map(dying, None, range(3), executor))


class Recorder(Elsewhere):
    """Starts nothing, and remembers its futures."""

    def __init__(self):
        self.futures = []

    def submit(self, *args):
        self.futures.append(Future())
        return self.futures[-1]


def test_an_interrupt_cancels_what_is_out():
    def jobs():
        yield from range(4)
        raise KeyboardInterrupt

    executor = Recorder()
    with pytest.raises(KeyboardInterrupt):
        list(worker_map(first_column, [1.0], jobs(), executor))
    assert len(executor.futures) == 4
    assert all(future.cancelled() for future in executor.futures)


def team(value, job):
    from photonrelax._ext.common.threads import team_limit

    time.sleep(0.01)
    return team_limit()


def test_tasks_have_their_number_of_threads_and_this_process_all():
    before = team(None, 0)
    assert set(worker_map(team, None, range(4), shared_pool(), n_threads=3)) == {3}
    assert set(worker_map(team, None, range(4), Elsewhere(), n_threads=3)) == {before}


def test_numbers_of_workers():
    assert n_workers(None) == 1
    assert n_workers(shared_pool()) == 2
    assert n_workers(ThreadPoolExecutor(5)) == 5
    assert n_workers(Elsewhere()) >= 1


def test_other_things_are_no_executors():
    with pytest.raises(TypeError, match="is list: that of a Dask client"):
        workers.checked_executor([])


def test_different_platforms_warn_and_equal_ones_do_not():
    one = platform_of_process()
    warn_of_mixture({one})
    other = Platform(one.machine, one.features[:-1], "0", "glibc 1")
    with pytest.warns(UserWarning, match="different platforms: .*embreex 0, glibc 1"):
        warn_of_mixture({one, other})
