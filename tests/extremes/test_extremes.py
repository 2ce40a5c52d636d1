"""Every row of the table of extremes holds: for every method, and on every SIMD path."""

from functools import partial

import pytest

import photonrelax as pr
from photonrelax.estimation.methods import METHODS
from tests.extremes import photon_cases, scene_cases
from tests.helpers import simd_paths

# Spectra are of traced photons.
OF_PHOTONS = [
    each.name for each in METHODS.values() if each.needs_photons and not each.needs_spectra
]


def each(cases):
    return pytest.mark.parametrize("case", [pytest.param(case, id=case.name) for case in cases])


@each(photon_cases.CASES)
@pytest.mark.parametrize("method", OF_PHOTONS)
@simd_paths.each("path")
def test_photons(case, method, path):
    with simd_paths.forced(path):
        assert case.error(partial(pr.irradiance_field, method=method)) <= case.bound


@pytest.mark.parametrize("method", OF_PHOTONS)
def test_photons_at_one_point_have_no_radius(method):
    """An error names the number asked for in place of an estimate."""
    photons = photon_cases.spread(photon_cases.UNIFORM[:1])
    with pytest.raises(ValueError, match="at one point, from which no"):
        pr.irradiance_field(photons, method=method)


@pytest.mark.kernels_run_elsewhere
@each(scene_cases.FIELD_CASES)
@pytest.mark.parametrize("method", METHODS)
def test_light_below_a_plate(case, method):
    assert case.error(method) <= case.bound


@each(scene_cases.FIELD_CASES)
@simd_paths.each("path")
def test_light_below_a_plate_from_spectra(case, path):
    with simd_paths.forced(path):
        assert case.error("frequency") <= case.bound


@each([*scene_cases.TRACING_CASES, *scene_cases.OPTICS_CASES, *scene_cases.CAMERA_CASES])
def test_scenes(case):
    assert case.error() <= case.bound
