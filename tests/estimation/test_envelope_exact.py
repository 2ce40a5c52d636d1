"""Envelopes of scenes whose map is known: how near they are, and how that changes with rays."""

import pytest

from tests.analytic.known_maps import nephroid, paraboloid, plate, refractor


def test_light_towards_a_focus_is_exact_to_a_ten_thousandth():
    error, _ = paraboloid().error(n_rays=70_000)
    assert error < 1e-4


@pytest.mark.kernels_run_elsewhere
def test_the_nephroid_is_exact_to_a_ten_thousandth():
    """Away from its fold and its borders."""
    error, envelope = nephroid().error(n_rays=150_000)
    assert error < 1e-4
    assert error < envelope.error


@pytest.mark.parametrize("limits", [{"error": 1e-3}, {"n_rays": 100_000}])
def test_orders_of_reflection_in_a_plate_are_laid_down(limits):
    """Where an error or many rays are asked for; of the rest there is less than 1e-5."""
    error, envelope = plate().error(**limits)
    assert error < 1e-5
    assert envelope.rest is None


def test_error_of_a_smooth_sheet_falls_fast_with_rays():
    """Below a thousandth at 100,000 rays, and falling at least as rays to the -1.2."""
    sheet = refractor()
    (coarse, first), (fine, second) = (sheet.error(n_rays=n) for n in (12_000, 100_000))
    assert fine < 2e-4
    assert fine / coarse < (second.n_rays / first.n_rays) ** -1.2
    assert fine < second.error
