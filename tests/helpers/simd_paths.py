"""Searches forced onto one set of vector instructions."""

import os
from contextlib import contextmanager
from unittest import mock

import pytest

from photonrelax._ext.spatial import tree as kdtree

VARIABLE = "PHOTONRELAX_SIMD"


@contextmanager
def forced(path):
    """Build trees that search on this path, whatever the caller's environment says."""
    with mock.patch.dict(os.environ, {VARIABLE: path}):
        yield


def has(path):
    try:
        with forced(path):
            return kdtree.instruction_set() == path
    except ValueError:
        return False


def each(name):
    """Run a test on each path; those the processor lacks are skipped."""
    return pytest.mark.parametrize(
        name,
        [
            pytest.param(
                path, marks=pytest.mark.skipif(not has(path), reason=f"no {path} on this processor")
            )
            for path in ("avx512", "avx2", "portable")
        ],
    )
