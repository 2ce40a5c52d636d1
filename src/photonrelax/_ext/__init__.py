"""Compiled kernels."""

import os
from importlib import import_module

# What users set to choose how threads wait, in any OpenMP runtime.
_WAIT_SETTINGS = ("OMP_WAIT_POLICY", "GOMP_SPINCOUNT", "KMP_BLOCKTIME")

# Threads sleep; those of GNU's runtime after some tens of microseconds, as to wake a thread takes
# longer than that: a tree, with a dozen short loops, is built a tenth faster.
_WAITS = {"OMP_WAIT_POLICY": "passive", "GOMP_SPINCOUNT": "10000"}


def _load_openmp() -> None:
    """Load the OpenMP runtime so that threads that wait for one another soon sleep.

    By default they spin for milliseconds: beside other processes a loop then takes many times as
    long, as cores are lost to threads that wait. Runtimes read the choice once, when they are
    loaded.
    """
    if any(name in os.environ for name in _WAIT_SETTINGS):
        return
    os.environ |= _WAITS
    try:
        import_module(".common.threads", __name__)
    finally:
        for name in _WAITS:
            del os.environ[name]


_load_openmp()
