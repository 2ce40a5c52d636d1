"""Estimates: kernels by definition, uniform fields, edges, and what is refused."""

from dataclasses import replace

import numpy as np
import pytest

import photonrelax as pr
from tests.helpers.photon_maps import flat_map, plane, uniform_map, unit_square

# A Gaussian's height where it is cut off, over that in its middle.
RIM = np.exp(-0.5 / 0.41**2)
KERNELS = {
    "constant": lambda t: np.ones_like(t),
    "cone": lambda t: 3 * (1 - t),
    "epanechnikov": lambda t: 2 * (1 - t**2),
    "gaussian": lambda t: np.exp(-0.5 * (t / 0.41) ** 2) / (2 * 0.41**2 * (1 - RIM)),
}


@pytest.mark.parametrize("kernel", KERNELS)
def test_kernels_integrate_to_one(kernel):
    """Over the unit disc, divided by its area π."""
    t = (np.arange(100_000) + 0.5) / 100_000
    assert (KERNELS[kernel](t) * 2 * t).mean() == pytest.approx(1.0, abs=1e-9)


@pytest.mark.parametrize("kernel", KERNELS)
@pytest.mark.parametrize("gather_radius", [np.inf, 0.03])
def test_estimates_equal_their_definition(kernel, gather_radius):
    rng = np.random.default_rng(0)
    photons = flat_map(rng.random((3000, 2)) ** 2, 3000).replace(flux=rng.random((3000, 3)))
    points, normals = plane(rng.random((200, 2)))
    settings = pr.GatherSettings(k=9, kernel=kernel, gather_radius=gather_radius)
    estimates = pr.estimate_irradiance(photons, points, normals, settings)
    limited = 0
    for point, estimate in zip(points, estimates, strict=True):
        distance = np.linalg.norm(photons.position - point, axis=1)
        order = np.argsort(distance)[:9]
        order = order[distance[order] <= gather_radius]
        bandwidth = gather_radius
        if len(order) == 9:
            bandwidth = distance[order[-1]]
            order = order[:-1]
        limited += bandwidth == gather_radius
        weight = KERNELS[kernel](distance[order] / bandwidth) / (np.pi * bandwidth**2)
        np.testing.assert_allclose(estimate, weight @ photons.flux[order], rtol=1e-10)
    assert (0 < limited < 200) == np.isfinite(gather_radius)


@pytest.fixture(scope="module")
def uniform_maps():
    """Maps of 1 W/m²: several where chance or the shift of the sequence matters."""
    halton = [uniform_map(100_000, "halton", seed) for seed in range(6)]
    start = uniform_map(200_000, "halton")
    settings = pr.RelaxSettings((3, 3))
    return {
        "random": [uniform_map(100_000, "random", seed) for seed in range(8)],
        "halton": halton,
        "relaxed": [pr.relax(start, pr.detect_structure(start), settings)],
    }


@pytest.mark.kernels_run_elsewhere
@pytest.mark.parametrize("kernel", KERNELS)
@pytest.mark.parametrize("kind", ["random", "halton", "relaxed"])
@pytest.mark.parametrize("k", [15, 50])
def test_a_uniform_field_returns_its_own_value(kernel, kind, k, uniform_maps, interior):
    points, normals = interior
    settings = pr.GatherSettings(k=k, kernel=kernel)
    means = []
    for photons in uniform_maps[kind]:
        inside = (np.abs(photons.position[:, :2] - 0.5) < 0.35).all(axis=1).mean() / 0.7**2
        means.append(pr.estimate_irradiance(photons, points, normals, settings).mean() / inside)
    assert np.mean(means) == pytest.approx(1.0, abs=3e-3)


def test_a_linear_field_is_kept():
    """E = 2x over the unit square, by inversion: x = √u; means of strips."""
    uv = unit_square(120_000, "halton")
    photons = flat_map(np.column_stack([np.sqrt(uv[:, 0]), uv[:, 1]]), 120_000, coords=uv)
    points, normals = plane(np.random.default_rng(1).uniform(0.1, 0.9, (40_000, 2)))
    strip = np.digitize(points[:, 0], np.linspace(0.1, 0.9, 9)) - 1
    expected = np.bincount(strip, 2 * points[:, 0])
    for method in ("standard", "parameterised"):
        field = pr.irradiance_field(photons.replace(well_spaced=True), method=method)
        sums = np.bincount(strip, field(points, normals)[:, 0])
        np.testing.assert_allclose(sums, expected, rtol=0.01)


def test_black_stays_black():
    """Light in a disc: beyond the gather radius nothing, and total flux kept."""
    xy = unit_square(40_000, "random")
    xy = xy[np.linalg.norm(xy - 0.5, axis=1) < 0.3]
    photons = flat_map(xy, 40_000)
    field = pr.IrradianceField(photons)
    radius = field.settings.gather_radius
    assert 0 < radius < 0.02
    grid = (np.arange(500) + 0.5) / 500
    points, normals = plane(np.stack(np.meshgrid(grid, grid), -1).reshape(-1, 2))
    estimates = field(points, normals)[:, 0]
    outside = np.linalg.norm(points[:, :2] - 0.5, axis=1) > 0.3 + radius
    assert (estimates[outside] == 0.0).all()
    assert estimates.mean() == pytest.approx(photons.flux[:, 0].sum(), rel=0.01)


def test_the_automatic_radius_reaches_the_fifteenth_photon_of_most():
    photons = uniform_map(9000, "random")
    radius = pr.IrradianceField(photons).settings.gather_radius
    fifteenth = pr.KDTree(photons.position).query_self(15).distance[:, -1]
    assert (fifteenth <= radius).mean() == pytest.approx(0.95, abs=1e-3)


@pytest.mark.parametrize("share", [0.9, 0.95, 0.99])
def test_a_bright_spot_does_not_black_out_dim_light(share):
    """Most photons in a spot of a centimetre, the others over a square metre."""
    n_spot = int(100_000 * share)
    spot, wide = 0.01 * unit_square(n_spot, "random"), unit_square(100_000 - n_spot, "random", 1)
    photons = flat_map(np.concatenate([spot, wide]), 100_000)
    points, normals = plane(np.random.default_rng(0).uniform(0.2, 0.8, (4000, 2)))
    estimates = pr.estimate_irradiance(photons, points, normals)[:, 0]
    assert estimates.mean() == pytest.approx(1 - share, rel=0.1)
    assert (estimates > 0.0).mean() > 0.9


def test_coincident_photons_are_seen():
    """However many: with all k at the point, the bandwidth is the gather radius."""
    settings = pr.GatherSettings(k=15, gather_radius=0.1)
    points, normals = plane(np.array([[0.5, 0.5]]))
    for n in (14, 15):
        photons = flat_map(np.full((n, 2), 0.5), 1)
        found = pr.estimate_irradiance(photons, points, normals, settings)
        np.testing.assert_allclose(found, n * 2 / (np.pi * 0.1**2))


def test_more_neighbours_than_photons_take_no_more_memory():
    photons = uniform_map(100, "random")
    points, normals = plane(np.full((1, 2), 0.5))
    settings = pr.GatherSettings(k=2**62, gather_radius=0.3)
    found = pr.estimate_irradiance(photons, points, normals, settings)
    few = pr.estimate_irradiance(photons, points, normals, replace(settings, k=101))
    np.testing.assert_array_equal(found, few)


def test_photons_that_each_face_another_way_still_make_a_field():
    photons = pr.PhotonMap(np.eye(3), np.eye(3), np.ones(3))
    assert pr.estimate_irradiance(photons, np.eye(3), np.eye(3)).min() > 0.0


def test_photons_on_faces_turned_away_are_not_counted():
    """Both sides of a thin plate and a wall beside it: each sees its own light alone."""
    top = uniform_map(20_000, "halton")
    below = top.replace(normal=-top.normal, flux=top.flux * 5, position=top.position - [0, 0, 1e-4])
    wall = top.replace(
        position=top.position[:, [2, 0, 1]], normal=top.normal[:, [2, 0, 1]], flux=top.flux * 9
    )
    fields = ("position", "normal", "flux")
    both = pr.PhotonMap(
        **{f: np.concatenate([getattr(m, f) for m in (top, below, wall)]) for f in fields},
        well_spaced=True,
    )
    points, normals = plane(np.random.default_rng(0).uniform(0.1, 0.9, (500, 2)))
    radius = pr.GatherSettings(gather_radius=0.05)
    for side, light in ((normals, top), (-normals, below)):
        np.testing.assert_allclose(
            pr.estimate_irradiance(both, points, side, radius),
            pr.estimate_irradiance(light, points, side, radius),
            rtol=1e-9,
        )
    assert (pr.estimate_irradiance(top, points, -normals) == 0.0).all()


def test_densities_of_what_photons_carry(interior):
    """Flux doubled is density doubled; any number of channels."""
    photons = uniform_map(10_000, "random")
    field = pr.IrradianceField(photons)
    values = np.hstack([photons.flux, 2 * photons.flux[:, :1], np.zeros((10_000, 1))])
    found = field.densities(values)(*interior)
    np.testing.assert_array_equal(found[:, :3], field(*interior))
    np.testing.assert_allclose(found[:, 3], 2 * found[:, 0])
    assert (found[:, 4] == 0.0).all()


@pytest.mark.parametrize("scale", [1e-4, 1e4])
@pytest.mark.parametrize("shift", [0.0, 1e4])
def test_irradiance_scales_with_area(scale, shift):
    photons = uniform_map(5000, "random")
    moved = photons.replace(position=(photons.position + shift) * scale)
    points, normals = plane(np.random.default_rng(1).random((300, 2)))
    a = pr.estimate_irradiance(photons, points, normals)
    b = pr.estimate_irradiance(moved, (points + shift) * scale, normals) * scale**2
    np.testing.assert_allclose(a, b, rtol=1e-6)


def test_same_bytes_for_every_number_of_threads(interior):
    photons = uniform_map(20_000, "random")
    one, *others = [
        pr.irradiance_field(photons, n_threads=t)(*interior).tobytes() for t in (1, 2, 7)
    ]
    assert all(other == one for other in others)


def test_arrays_from_elsewhere_will_do(interior):
    """Position, normal and flux alone: every method works."""
    full = uniform_map(50_000, "random")
    bare = pr.PhotonMap(full.position, full.normal, full.flux[:, 0])
    noise = {}
    for method in ("standard", "parameterised"):
        estimates = pr.irradiance_field(bare, method=method)(*interior)
        noise[method] = estimates.std() / estimates.mean()
    assert noise["parameterised"] < 0.5 * noise["standard"]


def test_maps_with_next_to_nothing():
    points, normals = plane(np.array([[0.5, 0.5]]))
    empty = flat_map(np.empty((0, 2)), 1)
    assert (pr.estimate_irradiance(empty, points, normals) == 0.0).all()
    assert (pr.irradiance_field(empty)(points, normals) == 0.0).all()
    few = flat_map(unit_square(5, "random"), 5)  # k > n: the radius that holds them all
    assert np.isfinite(pr.estimate_irradiance(few, points, normals)).all()
    with pytest.raises(ValueError, match="photons are all at one point"):
        pr.estimate_irradiance(flat_map(np.full((2, 2), 0.5), 2), points, normals)
    fixed = pr.GatherSettings(gather_radius=0.1)
    two = pr.estimate_irradiance(flat_map(np.full((2, 2), 0.5), 2), points, normals, fixed)
    np.testing.assert_allclose(two, 2 / (np.pi * 0.1**2))


def test_bad_input_is_refused():
    photons = uniform_map(100, "random")
    points, normals = plane(np.zeros((4, 2)))
    with pytest.raises(ValueError, match="method should be one of standard, "):
        pr.irradiance_field(photons, method="magic")
    with pytest.raises(ValueError, match=r"normals should have shape \(4, 3\)"):
        pr.estimate_irradiance(photons, points, normals[:2])
    with pytest.raises(ValueError, match="points should be finite"):
        pr.estimate_irradiance(photons, points + np.nan, normals)
    with pytest.raises(ValueError, match=r"values should have shape \(100, n\)"):
        pr.IrradianceField(photons).densities(np.zeros((3, 1)))


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"k": 1}, "k should be at least 2"),
        ({"kernel": "box"}, "kernel should be one of constant, cone, epanechnikov"),
        ({"gather_radius": -1.0}, "gather_radius should be a positive number"),
        ({"gather_radius": 1e-160}, r"gather_radius should lie in \[1e-150, 1e\+150\]"),
        ({"gather_radius": 1e160}, r"gather_radius should lie in \[1e-150, 1e\+150\]"),
    ],
)
def test_bad_settings_are_refused(fields, message):
    with pytest.raises(ValueError, match=message):
        pr.GatherSettings(**fields)
