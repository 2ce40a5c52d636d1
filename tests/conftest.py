"""Fixtures of all tests."""

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
