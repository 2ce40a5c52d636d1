"""Compiled kernels."""

import os
from importlib import import_module

# What users set to choose how threads wait, in any OpenMP runtime.
_WAIT_SETTINGS = ("OMP_WAIT_POLICY", "GOMP_SPINCOUNT", "KMP_BLOCKTIME")


def _load_openmp() -> None:
    """Load the OpenMP runtime so that threads that wait for one another sleep.

    By default they spin: beside other processes a loop then takes many times as long, as cores
    are lost to threads that wait. Runtimes read the choice once, when they are loaded.
    """
    if any(name in os.environ for name in _WAIT_SETTINGS):
        return
    os.environ["OMP_WAIT_POLICY"] = "passive"
    try:
        import_module(".common.threads", __name__)
    finally:
        del os.environ["OMP_WAIT_POLICY"]


_load_openmp()
