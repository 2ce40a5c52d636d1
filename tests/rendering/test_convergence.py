"""Progressive photon mapping comes as near to known irradiance as theory says."""

from dataclasses import replace

import numpy as np
import pytest
from bench.studies import progressive

from photonrelax import gallery

N_PASSES, N_PHOTONS = 32, 5000
# Meshes so fine that their facets are no error beside the noise.
SIZES = {"sphere": {"subdivisions": 5}, "ring": {}}


@pytest.mark.parametrize("scene", progressive.CASES)
def test_errors_fall_over_passes_against_known_irradiance(scene):
    """Noise goes as i^(-α/2), bias as i^(α - 1); with α = 0.7 by powers of -0.35 and -0.3.

    ``python -m bench progressive`` separates them, over longer runs.
    """
    case = replace(progressive.CASES[scene](), scene=gallery.scene(scene, **SIZES[scene]))
    assert len(case.points) > 100
    errors = progressive.converge(case, N_PASSES, N_PHOTONS, sampler="random")
    slope = np.polyfit(np.log(errors.passes), np.log(errors.total), 1)[0]
    assert slope == pytest.approx(-0.325, abs=0.075)
