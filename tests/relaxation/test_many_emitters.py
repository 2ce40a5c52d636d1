"""Lights made of many emitters: relaxed as those of one, and never worse than unrelaxed."""

import numpy as np
import pytest

import photonrelax as pr
from tests.helpers.photon_maps import flat_map, plane, unit_square

N = 20_000
GRID = (np.arange(40) + 0.5) / 40
POINTS = np.stack(np.meshgrid(GRID, GRID), -1).reshape(-1, 2)
RELAXING = ("parameterised", "relaxation")


def lamps(n_lamps, xy, flux=1.0):
    """Photons of lamps, 1 W in all for a flux of one each."""
    photons = flat_map(xy, len(xy), emitter_id=np.arange(len(xy)) % n_lamps)
    photons = photons.replace(emitter_coords=None, emitter_density=None)
    return photons.replace(flux=photons.flux * np.reshape(flux, (-1, 1)))


def joined(*maps):
    """One map of all, each with emitters of its own."""
    ids = np.cumsum([0] + [photons.emitter_id.max() + 1 for photons in maps])
    columns = {
        name: np.concatenate([getattr(photons, name) for photons in maps])
        for name in ("position", "normal", "flux")
    }
    emitter = [m.emitter_id + first for m, first in zip(maps, ids, strict=False)]
    return pr.PhotonMap(**columns, emitter_id=np.concatenate(emitter))


def uniform(n_lamps, n=N, **options):
    return lamps(n_lamps, unit_square(n, "random", seed=n_lamps), **options)


def gradient(n_lamps):
    """2x W/m²."""
    u, v = unit_square(N, "random", seed=n_lamps).T
    return lamps(n_lamps, np.column_stack([np.sqrt(u), v]))


def half(n_lamps):
    """2 W/m² on one half of the square."""
    return lamps(n_lamps, unit_square(N, "random", seed=n_lamps) * [0.5, 1.0])


def discs(n_lamps, radius, n=N, seed=0):
    """A disc of uniform light from each lamp, and the irradiance at the points."""
    rng = np.random.default_rng(seed)
    centre = rng.uniform(0.1, 0.9, (n_lamps, 2))
    r, angle = radius * np.sqrt(rng.random(n)), 2 * np.pi * rng.random(n)
    offset = r * [np.cos(angle), np.sin(angle)]
    within = np.square(POINTS[:, np.newaxis] - centre).sum(axis=2) < radius**2
    return (
        lamps(n_lamps, centre[np.arange(n) % n_lamps] + offset.T),
        within.mean(axis=1) / (np.pi * radius**2),
    )


def of_many_powers(n_lamps):
    """Uniform light of lamps whose powers span two decades, with as many photons each."""
    power = 10 ** np.random.default_rng(n_lamps).uniform(-2, 0, n_lamps)
    return uniform(n_lamps, flux=power[np.arange(N) % n_lamps] / power.mean())


def a_large_lamp_and(photons, irradiance):
    return joined(uniform(1), photons), 1.0 + irradiance


CASES = {
    **{f"uniform, {n}": (uniform(n), 1.0) for n in (3, 12, 200, 3000, N)},
    **{f"gradient, {n}": (gradient(n), 2.0 * POINTS[:, 0]) for n in (3, 12, 1000)},
    **{f"half, {n}": (half(n), 2.0 * (POINTS[:, 0] < 0.5)) for n in (3, 12, 1000)},
    **{f"discs, {n}": discs(n, 0.2) for n in (3, 12, 300)},
    "small discs": discs(300, 0.04),
    "powers, 12": (of_many_powers(12), 1.0),
    "powers, 1000": (of_many_powers(1000), 1.0),
    "large and small": a_large_lamp_and(uniform(700), 1.0),
    "large and discs": a_large_lamp_and(*discs(500, 0.1)),
    "large and few": a_large_lamp_and(uniform(20, n=200, flux=0.01), 0.01),
}


@pytest.mark.kernels_run_elsewhere
@pytest.mark.parametrize("case", CASES)
def test_relaxed_maps_are_no_worse(case):
    photons, irradiance = CASES[case]
    error, mean = {}, {}
    for method in ("standard", *RELAXING):
        estimates = pr.irradiance_field(photons, method=method)(*plane(POINTS))[:, 0]
        error[method] = np.abs(estimates - irradiance).mean()
        mean[method] = estimates.mean() / np.broadcast_to(irradiance, len(POINTS)).mean()
    for method in RELAXING:
        assert error[method] < 0.9 * error["standard"]
        assert mean[method] == pytest.approx(1.0, abs=0.05)


@pytest.mark.kernels_run_elsewhere
@pytest.mark.parametrize("n_lamps", [12, 1000, N])
@pytest.mark.parametrize("method", RELAXING)
def test_a_light_of_many_lamps_is_relaxed_as_that_of_one(n_lamps, method):
    photons = uniform(n_lamps)
    one, many = (
        pr.irradiance_field(some, method=method).photons.position
        for some in (photons.replace(emitter_id=None), photons)
    )
    np.testing.assert_array_equal(many, one)


def test_lamps_in_one_tree_are_relaxed_by_themselves():
    """Forty folded caustics in a row, each with emitter coordinates of its own."""
    n_lamps, each = 40, 400
    emitter = np.repeat(np.arange(n_lamps), each)
    uv = unit_square(n_lamps * each, "random")
    xy = np.column_stack([(2 * uv[:, 0] - 1) ** 2 + 0.7 * emitter, uv[:, 1]])
    photons = flat_map(xy, each, coords=uv, emitter_id=emitter)
    structure = pr.detect_structure(photons)
    relaxed = pr.relax(photons, structure)
    for one in range(0, n_lamps, 7):
        rows = np.flatnonzero(emitter == one)
        alone = pr.detect_structure(photons.subset(rows))
        for name in ("eigenvalues", "constraint", "radius", "n_found", "reach"):
            np.testing.assert_allclose(
                getattr(structure, name)[rows], getattr(alone, name), atol=1e-12
            )
        moved = pr.relax(photons.subset(rows), alone)
        np.testing.assert_allclose(relaxed.position[rows], moved.position, atol=1e-9)


def test_pools_at_rest_stay():
    """Ten photons of each of twenty lamps among those of a large one."""
    photons = joined(uniform(1), uniform(20, n=200))
    structure = pr.detect_structure(photons)
    weak = photons.emitter_id > 0
    np.testing.assert_array_equal(structure.n_found[weak], 1)
    np.testing.assert_array_equal(structure.constraint[weak], 0.0)
    np.testing.assert_allclose(np.linalg.norm(structure.basis, axis=2), 1.0)
    relaxed = pr.relax(photons, structure).position
    np.testing.assert_array_equal(relaxed[weak], photons.position[weak])
    assert (relaxed[~weak] != photons.position[~weak]).any(axis=1).all()


@pytest.mark.parametrize("method", RELAXING)
def test_many_lamps_with_photons_at_few_points(method):
    """Both at once: a light of many lamps, rounded to a grid."""
    photons = uniform(1000)
    centre = np.array([0.5, 0.5, 0.0])
    rounded = photons.replace(position=(np.floor(photons.position * 40) + centre) / 40)
    inside = plane(np.random.default_rng(0).uniform(0.15, 0.85, (1000, 2)))
    estimates = pr.irradiance_field(rounded, method=method)(*inside)
    assert estimates.mean() == pytest.approx(1.0, abs=0.03)
    assert np.abs(estimates - 1.0).mean() < 0.1
