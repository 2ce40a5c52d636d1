"""Indirect light against radiosity, against closed forms of furnaces, and at its extremes."""

import pickle
from types import SimpleNamespace

import numpy as np
import pytest

import photonrelax as pr
from photonrelax.estimation.indirect import IndirectField, default_settings
from tests.analytic.radiosity import Cube
from tests.helpers.tracing_scenes import ball, box, coloured_walls, cube_wall

ALBEDOS = np.array([[0.8, 0.2, 0.2], [0.2, 0.8, 0.2], *4 * [[0.7, 0.7, 0.7]]])
LAMP, POWER = (0.2, -0.1, 0.5), (10.0, 10.0, 10.0)
FLOOR = 4


@pytest.fixture(scope="module")
def coloured():
    """Estimates on the floor of a cube of coloured walls, and what radiosity says."""
    scene = pr.Scene(coloured_walls(ALBEDOS), [pr.PointEmitter(LAMP, POWER)])
    photons = pr.trace_photons(scene, 600_000, paths="global")
    field = IndirectField(photons, scene=scene)
    cube = Cube(2.0, ALBEDOS, POWER, LAMP)
    points = cube.middles[FLOOR]
    exact = cube.indirect(FLOOR, points)
    found = field(points, np.tile([0.0, 0.0, 1.0], (len(points), 1)))
    k = field.settings.k
    return SimpleNamespace(scene=scene, field=field, found=found, exact=exact, points=points, k=k)


@pytest.mark.kernels_run_elsewhere
def test_noise_is_that_of_k_photons(coloured):
    inside = np.abs(coloured.points[:, :2]).max(axis=1) < 0.8
    found, exact = coloured.found[inside], coloured.exact[inside]
    assert coloured.k == 800
    assert np.abs(found - exact).sum() / exact.sum() <= 1.1 / np.sqrt(coloured.k)


@pytest.mark.kernels_run_elsewhere
def test_bias_is_small_beside_walls_and_in_corners(coloured):
    far = np.sort(np.abs(coloured.points[:, :2]), axis=1)
    for part, most in ((far[:, 1] > 0.85, 0.03), (far[:, 0] > 0.85, 0.06)):
        found, exact = coloured.found[part], coloured.exact[part]
        assert abs(found.sum() / exact.sum() - 1.0) <= most


def outermost(along):
    """Points of the floor in the outer fortieth of its width, at coordinates along the walls."""
    across = 1.0 - 0.05 * (np.arange(3) + 0.5) / 3
    pairs = [(sign * x, y) for sign in (-1.0, 1.0) for x in across for y in along]
    points = np.array([(*pair, -1.0) for pair in pairs])
    return np.concatenate([points, points[:, [1, 0, 2]]])


@pytest.mark.kernels_run_elsewhere
def test_bias_is_small_in_the_outer_fortieth(coloured):
    """Means over three maps, beside walls and in corners; radiosity extrapolated."""
    fields = [coloured.field]
    for seed in (1, 2):
        photons = pr.trace_photons(coloured.scene, 600_000, paths="global", seed=seed)
        # Of the floor alone: the first map has the light of all walls.
        on_floor = photons.subset(np.flatnonzero(photons.normal[:, 2] > 0.5))
        fields.append(IndirectField(on_floor, scene=coloured.scene))
        assert fields[-1].settings.k == coloured.k
    coarse, fine = (Cube(2.0, ALBEDOS, POWER, LAMP, n) for n in (6, 12))
    near = 1.0 - 0.05 * (np.arange(3) + 0.5) / 3
    for along, most in ((np.arange(-0.95, 1.0, 0.1), 0.03), ([*-near, *near], 0.06)):
        points = outermost(along)
        exact, rough = (each.indirect(FLOOR, points).sum() for each in (fine, coarse))
        up = np.tile([0.0, 0.0, 1.0], (len(points), 1))
        found = np.mean([field(points, up).sum() for field in fields])
        assert abs(found / (exact + (exact - rough) / 3.0) - 1.0) <= most


@pytest.mark.kernels_run_elsewhere
@pytest.mark.parametrize("albedo", [0.5, 0.9, 0.95])
def test_furnace(albedo):
    """In a closed ball of albedo a, E = Φ / (4πR²(1 - a)), of which a share of a is indirect."""
    shell = ball(1.0, [0, 0, 0], 5)
    shell.invert()
    scene = pr.Scene([pr.SceneObject(shell, pr.Diffuse(albedo))], [pr.PointEmitter([0, 0, 0])])
    photons = pr.trace_photons(scene, int(40_000 / albedo), paths="global")
    expected = albedo / (1.0 - albedo) / shell.area
    np.testing.assert_allclose(photons.flux.sum(axis=0) / shell.area, expected, rtol=0.01)
    field = IndirectField(photons, scene=scene)
    at = shell.triangles_center[::8]
    found = field(at, -at)
    np.testing.assert_allclose(found.mean(axis=0), expected, rtol=0.01)
    assert photons.ledger.cut.sum() == 0.0


def test_means_over_footprints_of_uniform_light():
    rng = np.random.default_rng(3)
    position = np.column_stack([rng.uniform(-1, 1, (40_000, 2)), np.zeros(40_000)])
    up = np.tile([0.0, 0.0, 1.0], (40_000, 1))
    photons = pr.PhotonMap(position, up, np.full((40_000, 3), 1e-4))
    field = IndirectField(photons)
    points = np.column_stack([rng.uniform(-0.5, 0.5, (500, 2)), np.zeros(500)])
    for side in (None, np.full(500, 1e-3), np.full(500, 0.2)):
        found = field(points, up[:500], footprint=side)
        np.testing.assert_allclose(found.mean(axis=0), 1.0, rtol=0.02)


def test_without_photons_it_is_dark():
    empty = pr.PhotonMap(*3 * [np.empty((0, 3))])
    assert not IndirectField(empty)([[0, 0, 0]], [[0, 0, 1]]).any()


def test_photons_at_one_point_are_left_out():
    photons = pr.PhotonMap(np.zeros((3, 3)), np.tile([0.0, 0.0, 1.0], (3, 1)), np.ones((3, 3)))
    assert not IndirectField(photons)([[0, 0, 0]], [[0, 0, 1]]).any()


def test_where_no_photon_is_near_it_is_dark():
    rng = np.random.default_rng(1)
    position = np.column_stack([rng.random((5000, 2)), np.zeros(5000)])
    photons = pr.PhotonMap(position, np.tile([0.0, 0.0, 1.0], (5000, 1)), np.ones((5000, 3)))
    assert not IndirectField(photons)([[9, 9, 0]], [[0, 0, 1]]).any()


def test_it_does_not_depend_on_threads():
    meshes = [box([2, 2, 2])]
    scene = pr.Scene([pr.SceneObject(meshes[0], pr.Diffuse(0.8))], [pr.PointEmitter([0, 0, 0])])
    photons = pr.trace_photons(scene, 20_000, paths="global")
    at = photons.position[:200], photons.normal[:200]
    one, *others = (IndirectField(photons, scene=scene, n_threads=n)(*at) for n in (1, 2, 7))
    for other in others:
        np.testing.assert_array_equal(other, one)


@pytest.mark.parametrize(
    ("n", "k"), [(0, 50), (100, 50), (20_000, 400), (10**6, 800), (10**7, 1600)]
)
def test_k_follows_from_the_number_of_photons(n, k):
    assert default_settings(n).k == k


def half_submerged(rng, n=200):
    """A wall half in water, bright there and dim above, with n² photons, one in each cell."""
    water = pr.SceneObject(box([6, 6, 3], [0, 0, -1.5]), pr.Dielectric(1.33))
    wall = pr.SceneObject(cube_wall(0, -1), pr.Diffuse(0.5))
    scene = pr.Scene([wall, water], [pr.PointEmitter([0, 0, 0.5])])
    cells = np.stack(np.meshgrid(np.arange(n), np.arange(n)), axis=-1).reshape(-1, 2)
    yz = 2.0 * (cells + rng.random((n * n, 2))) / n - 1.0
    position, normal = np.insert(yz, 0, -1.0, axis=1), np.tile([1.0, 0.0, 0.0], (n * n, 1))
    flux = np.where(yz[:, 1:] < 0.0, [[20.0, 10.0, 5.0]], 1.0) * 4.0 / n**2
    return scene, pr.PhotonMap(position, normal, flux)


def test_light_below_a_waterline_stays_below():
    rng = np.random.default_rng(5)
    scene, photons = half_submerged(rng)
    field = IndirectField(photons, scene=scene)
    y, height = rng.uniform(-0.9, 0.9, 500), rng.uniform(0.001, 0.05, 500)
    normals = np.tile([1.0, 0.0, 0.0], (500, 1))
    for side, expected in ((1.0, [1.0, 1.0, 1.0]), (-1.0, [20.0, 10.0, 5.0])):
        points = np.column_stack([-np.ones(500), y, side * height])
        for footprint in (None, np.full(500, 0.002)):
            found = field(points, normals, footprint=footprint)
            np.testing.assert_allclose(found.mean(axis=0), expected, rtol=0.01)


def test_fields_of_parts_are_pickled():
    scene, photons = half_submerged(np.random.default_rng(5), 60)
    field = IndirectField(photons, scene=scene)
    copy = pickle.loads(pickle.dumps(field))
    at = photons.position[:100], photons.normal[:100]
    np.testing.assert_array_equal(copy(*at), field(*at))
