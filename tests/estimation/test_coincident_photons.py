"""Photons at the same point: one photon of the flux of all, whatever the method."""

import numpy as np
import pytest

import photonrelax as pr
from tests.helpers.photon_maps import flat_map, plane, uniform_map, unit_square
from tests.helpers.tracing_scenes import SCENES

N = 3000
RNG = np.random.default_rng(5)
POINTS = plane(RNG.uniform(0.15, 0.85, (300, 2)))
EVERYWHERE = ("standard", "parameterised", "relaxation", "diffusion", "isotropic-diffusion")
EVERY_METHOD = (*EVERYWHERE, "progressive")
GATHERS = [
    *(
        pr.GatherSettings(kernel=kernel)
        for kernel in ("constant", "cone", "epanechnikov", "gaussian")
    ),
    pr.GatherSettings(k=100, refinement="bias-compensation"),
    pr.GatherSettings(k=100, refinement="differential-checking"),
]


def on_lattice(cells, n=20_000):
    """Uniform light rounded to the centres of cells."""
    return flat_map((np.floor(unit_square(n, "random") * cells) + 0.5) / cells, n)


def at_places(places, n):
    return flat_map(places[np.arange(n) % len(places)], n)


def repeated(photons, times, seed=0):
    """The map with each photon in as many parts, in any order."""
    rows = np.random.default_rng(seed).permutation(np.repeat(np.arange(len(photons)), times))
    parts = photons.subset(rows)
    return parts.replace(flux=parts.flux / times)


def random(n=N):
    return uniform_map(n, "random")


def curved():
    slope = 0.4 * random().position[:, :2]
    return random().replace(normal=np.column_stack([slope, np.ones(N)]))


def on_a_line():
    along = np.random.default_rng(1).random(N)
    return flat_map(np.column_stack([along, np.full(N, 0.5)]), N)


def of_two_emitters():
    return random().replace(emitter_id=np.arange(N) % 2)


def test_trees_know_of_coincident_points():
    for n in (2, 17, 100, 5000):
        points = np.random.default_rng(n).random((n, 3))
        assert not pr.KDTree(points).kernel.may_coincide
        for seed in range(20):
            one, other = np.random.default_rng(seed).choice(n, 2, replace=False)
            pair = points.copy()
            pair[one] = pair[other]
            assert pr.KDTree(pair, n_threads=1 + seed % 2).kernel.may_coincide


def test_trees_know_of_points_at_one_position_that_differ_a_little_on_range_axes():
    position = unit_square(5000, "random")
    for pair in range(20):
        points = np.column_stack([position, position])
        points[pair + 1, :2] = points[pair, :2]
        points[pair + 1, 2:] = points[pair, 2:] + 1e-6
        assert pr.KDTree(points, n_metric=2).kernel.may_coincide


@pytest.mark.kernels_run_elsewhere
@pytest.mark.parametrize("photons", [random, curved, on_a_line, of_two_emitters])
@pytest.mark.parametrize("method", EVERY_METHOD)
def test_parts_of_photons_are_whole_photons(photons, method):
    whole = photons()
    estimates = [
        pr.irradiance_field(some, method=method)(*POINTS) for some in (whole, repeated(whole, 7))
    ]
    np.testing.assert_allclose(estimates[1], estimates[0], rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("gather", GATHERS)
def test_parts_of_photons_are_whole_photons_with_any_kernel(gather):
    one, seven = (
        pr.estimate_irradiance(p, *POINTS, gather) for p in (random(), repeated(random(), 7))
    )
    np.testing.assert_allclose(seven, one, rtol=1e-9)


def test_parts_of_photons_are_whole_photons_with_spectra():
    photons = pr.trace_photons(SCENES["glass ball"], 6000, frequency_share=0.2)
    points = photons.position[::20], photons.normal[::20]
    one, three = (
        pr.irradiance_field(some, method="frequency")(*points)
        for some in (photons, repeated(photons, 3))
    )
    np.testing.assert_allclose(three, one, rtol=1e-9)


def test_some_photons_in_parts_are_whole_photons():
    photons = random()
    some = photons.subset(slice(0, 500))
    mixed = np.concatenate([np.arange(500, N), np.repeat(np.arange(500), 40)])
    flux = np.concatenate([photons.flux[500:], np.repeat(some.flux / 40, 40, axis=0)])
    one = pr.estimate_irradiance(photons, *POINTS)
    np.testing.assert_allclose(
        pr.estimate_irradiance(photons.subset(mixed).replace(flux=flux), *POINTS), one, rtol=1e-9
    )


@pytest.mark.kernels_run_elsewhere
@pytest.mark.parametrize("cells", [2000, 256, 64, 32])
@pytest.mark.parametrize("method", EVERY_METHOD)
def test_rounded_positions_leave_uniform_light_as_it_is(cells, method):
    estimates = pr.irradiance_field(on_lattice(cells), method=method)(*POINTS)
    assert estimates.mean() == pytest.approx(1.0, abs=0.03)
    assert estimates.min() > 0.0


@pytest.mark.parametrize("method", EVERY_METHOD)
def test_beams_stored_at_their_axes_light_all(method):
    photons = at_places(unit_square(200, "random"), 20_000)
    photons = photons.replace(emitter_coords=None, emitter_density=None)
    inside = (np.abs(POINTS[0][:, :2] - 0.5) < 0.35).all(axis=1)
    estimates = pr.irradiance_field(photons, method=method)(*POINTS)[inside]
    assert estimates.mean() == pytest.approx(1.0, abs=0.15)


@pytest.mark.parametrize("method", EVERY_METHOD)
def test_a_beam_among_other_photons_is_a_photon(method):
    """Its flux is spread over the bandwidth around it; elsewhere the light is as without."""
    beam = np.full((5000, 2), 0.5)
    photons = flat_map(np.vstack([unit_square(20_000, "random"), beam]), 20_000)
    far = np.linalg.norm(POINTS[0][:, :2] - 0.5, axis=1) > 0.2
    estimates = pr.irradiance_field(photons, method=method)(*POINTS)
    assert estimates[far].mean() == pytest.approx(1.0, abs=0.03)
    at_beam = pr.irradiance_field(photons, method=method)(*plane(np.full((1, 2), 0.5)))
    assert at_beam.min() > 20.0


def test_photons_at_one_point_need_a_radius():
    photons = flat_map(np.full((50, 2), 0.5), 50)
    at = plane(np.array([[0.5, 0.5], [0.5, 0.55], [0.5, 0.7]]))
    with pytest.raises(ValueError, match="all at one point"):
        pr.irradiance_field(photons, method="parameterised")
    gather = pr.GatherSettings(gather_radius=0.1)
    estimates = pr.irradiance_field(photons, method="parameterised", gather=gather)(*at)[:, 0]
    np.testing.assert_allclose(estimates, 2 / (np.pi * 0.1**2) * np.array([1.0, 0.75, 0.0]))


def test_the_two_sides_of_a_sheet_keep_their_light():
    """Photons at the same points, of two W on one side and one W on the other."""
    above = flat_map(unit_square(N, "random"), N)
    both = pr.PhotonMap(
        np.vstack([above.position, above.position]),
        np.vstack([above.normal, -above.normal]),
        np.vstack([2.0 * above.flux, above.flux]),
    )
    points, normals = POINTS
    one = pr.estimate_irradiance(above, points, normals)
    np.testing.assert_allclose(pr.estimate_irradiance(both, points, normals), 2.0 * one, rtol=1e-9)
    np.testing.assert_allclose(pr.estimate_irradiance(both, points, -normals), one, rtol=1e-9)


def test_densities_are_of_the_values_of_all():
    photons = on_lattice(40)
    values = np.column_stack([photons.flux[:, 0], np.arange(len(photons))])
    field = pr.irradiance_field(photons, method="standard")
    np.testing.assert_allclose(
        field.densities(values)(*POINTS)[:, 0], field(*POINTS)[:, 0], rtol=1e-12
    )


@pytest.mark.parametrize("photons", [lambda: on_lattice(32), lambda: repeated(curved(), 5)])
def test_photons_at_the_same_point_are_relaxed_as_one(photons):
    photons = photons()
    structure = pr.detect_structure(photons)
    relaxed = pr.relax(photons, structure)
    assert np.isfinite(relaxed.position).all()
    assert np.isfinite(structure.eigenvalues).all()
    np.testing.assert_array_equal(relaxed.flux, photons.flux)
    _, before = np.unique(photons.position, axis=0, return_inverse=True)
    _, after = np.unique(relaxed.position, axis=0, return_inverse=True)
    np.testing.assert_array_equal(np.unique(before, return_counts=True)[1].sum(), len(photons))
    assert len(np.unique(np.column_stack([before, after]), axis=0)) == before.max() + 1


@pytest.mark.parametrize("method", EVERY_METHOD)
def test_estimates_at_the_nodes_of_a_grid(method):
    """There fifteen places are nearest whose density is 6 % off that of all."""
    nodes = plane((np.stack(np.meshgrid(*[np.arange(8, 24)] * 2), -1).reshape(-1, 2) + 0.5) / 32)
    estimates = pr.irradiance_field(on_lattice(32), method=method)(*nodes)
    assert estimates.mean() == pytest.approx(1.0, abs=0.08)


@pytest.mark.parametrize("cells", [256, 64, 32])
def test_rounded_light_is_no_noisier_relaxed(cells):
    photons = on_lattice(cells)
    noise = {
        method: pr.irradiance_field(photons, method=method)(*POINTS).std()
        for method in ("standard", "parameterised", "relaxation")
    }
    assert noise["parameterised"] < 1.05 * noise["standard"]
    assert noise["relaxation"] < 1.05 * noise["standard"]
