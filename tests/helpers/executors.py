"""Executors of processes, each started once a session."""

from concurrent.futures import ProcessPoolExecutor
from functools import cache
from multiprocessing import get_context

import pytest

N_WORKERS = 2


def spawned(n_workers=N_WORKERS):
    return ProcessPoolExecutor(n_workers, mp_context=get_context("spawn"))


@cache
def shared_pool():
    """Two processes that tests share."""
    return spawned()


def loky_pool(n_workers=N_WORKERS):
    loky = pytest.importorskip("loky")
    return loky.ProcessPoolExecutor(n_workers)


def dask_cluster():
    """A cluster of two processes on the loopback interface."""
    distributed = pytest.importorskip("distributed")
    # Processes start slowly beside other tests.
    pytest.importorskip("dask").config.set({"distributed.comm.timeouts.connect": "120s"})
    return distributed.LocalCluster(
        n_workers=N_WORKERS,
        threads_per_worker=1,
        processes=True,
        # Any free port: without a dashboard the scheduler still listens on one.
        dashboard_address=":0",
        silence_logs=50,
    )
