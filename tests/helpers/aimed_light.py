"""Light aimed at casters compared with the same paths among all light."""

import numpy as np
import pytest

import photonrelax as pr


def assert_aimed_light_is_that_of_all_paths(scene):
    """Check the flux of caustics within their noise, and return the photons of both."""
    aimed = pr.trace_photons(scene, 50_000)
    whole = pr.trace_photons(scene, 400_000, paths="all", sampler="random", seed=1)
    caustic = whole.subset(np.isin(whole.path_signature, aimed.path_signature))
    noise = np.hypot(*(1 / np.sqrt(len(each)) for each in (aimed, caustic)))
    ratio = aimed.flux[:, 0].sum() / caustic.flux[:, 0].sum()
    assert ratio == pytest.approx(1.0, abs=5 * noise)
    return aimed, caustic
