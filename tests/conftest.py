"""Fixtures of all tests."""

import os

# Processes of `pytest -n` share the cores: a thread that spins while it waits keeps the others
# from theirs. OpenMP reads this when the first kernel is imported.
if "PYTEST_XDIST_WORKER" in os.environ:
    os.environ.setdefault("OMP_WAIT_POLICY", "passive")

import numpy as np
import pytest

from photonrelax import gallery
from tests.helpers.photon_maps import plane


@pytest.fixture
def interior():
    """20,000 points of the unit square away from its border."""
    return plane(np.random.default_rng(99).uniform(0.15, 0.85, (20_000, 2)))


@pytest.fixture(scope="session")
def ring():
    return gallery.scene("ring", pixels=16, sections=64)
