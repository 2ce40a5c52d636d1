"""Diffusion: estimates by definition, fields that are known, and what must not matter."""

from dataclasses import replace

import numpy as np
import pytest

import photonrelax as pr
from photonrelax._util.validation import in_units
from photonrelax.estimation.diffusion import DiffusionField
from tests.helpers.diffusion_maps import FIXED, LOCAL, METHODS, rotation, steep_map, turned
from tests.helpers.photon_maps import flat_map, plane, uniform_map, unit_square

# --- the definition ---------------------------------------------------------------------------


def landed(photons, point, normal):
    """Photons projected on the tangent plane (SSO08 Eq. A1–A2), and flags of those that land."""
    apart = photons.position - point
    above = (photons.wi * photons.normal).sum(axis=1) > 0.0
    towards = np.where(above[:, None], photons.wi, photons.normal)
    cosine = towards @ normal
    moved = apart - (apart @ normal / np.maximum(cosine, 0.1))[:, None] * towards
    moved -= np.outer(moved @ normal, normal)
    return moved, (cosine > 0.0) & (photons.normal @ normal >= 0.5)


def reach(photons, point, normal, bandwidth, k):
    """The photons within the bandwidth, which at most reaches the k-th but leaves it out."""
    distance = np.linalg.norm(photons.position - point, axis=1)
    facing = photons.normal @ normal >= 0.5
    if k is not None:
        bandwidth = min(bandwidth, (1 - 1e-9) * np.sort(distance[facing])[k - 1])
    return facing & (distance <= bandwidth), bandwidth


def gradient(photons, scale, k):
    """SSO08 Eq. 13 at every photon."""
    out = np.empty((len(photons), 3))
    for i, (point, normal) in enumerate(zip(photons.position, photons.normal, strict=True)):
        near, h = reach(photons, point, normal, scale, k)
        offset, lands = landed(photons, point, normal)
        inside = near & lands & ((offset**2).sum(axis=1) < h**2)
        out[i] = 4 / (np.pi * h**4) * photons.flux.mean(axis=1)[inside] @ offset[inside]
    return out


def found_gradient(photons, settings):
    """The field's, whose units keep squares of gradients within the range of floats, in W/m³."""
    field = DiffusionField(photons, settings)
    _, watts = in_units(photons.flux.mean(axis=1, keepdims=True))
    return field._columns[:, 1:] * watts / field._unit**3


def kernels(photons, slopes, points, normals, settings):
    """Of each point: offsets of photons in reach, bandwidth, mean structure tensor, irradiance."""
    for point, normal in zip(points, normals, strict=True):
        near, h = reach(photons, point, normal, settings.bandwidth, settings.k)
        offset, lands = landed(photons, point, normal)
        weight = np.maximum(1 - (offset**2).sum(axis=1) / h**2, 0) * (near & lands)
        flat = slopes - np.outer(slopes @ normal, normal)
        tensor = np.einsum("i,ij,ik->jk", weight, flat, flat) / weight.sum()
        irradiance = 2 / (np.pi * h**2) * weight @ photons.flux.mean(axis=1)
        yield near & lands, offset, h, tensor, irradiance


def gradients(photons, settings):
    """Slopes at photons, and the largest squared mean of them, if that is what others are of."""
    scale = settings.noise_scale or settings.bandwidth / 2
    k = settings.k if settings.noise_scale is None else None
    slopes, largest = gradient(photons, scale, k and round(k / 4)), None
    if settings.normalisation == "maximum":
        every = kernels(photons, slopes, photons.position, photons.normal, settings)
        largest = max(np.linalg.eigvalsh(tensor)[-1] for _, _, _, tensor, _ in every)
    return slopes, largest


def by_definition(photons, points, normals, settings):
    """Estimates by kernels that are long along edges, and by round ones."""
    slopes, largest = gradients(photons, settings)
    out = []
    found = kernels(photons, slopes, points, normals, settings)
    for normal, (near, offset, h, tensor, irradiance) in zip(normals, found, strict=True):
        plane_axes = np.linalg.svd(normal[None])[2][1:]
        eigenvalues, vectors = np.linalg.eigh(plane_axes @ tensor @ plane_axes.T)
        edge = eigenvalues[-1] / (largest or (irradiance / h) ** 2)
        ratio = edge / settings.edge_threshold
        across = max(1 / (1 + ratio ** (1 + settings.edge_steepness)), settings.least_eigenvalue)
        for along in (1.0, across):
            inverse = vectors @ np.diag([1 / along, 1 / across]) @ vectors.T
            flat = offset @ plane_axes.T
            distance = np.einsum("ij,jk,ik->i", flat, inverse, flat)
            weight = np.maximum(1 - distance / h**2, 0) * near
            out.append(2 / (np.pi * h**2 * np.sqrt(along * across)) * weight @ photons.flux)
    return np.array(out[::2]), np.array(out[1::2])


CASES = [
    replace(FIXED, edge_threshold=0.3, least_eigenvalue=0.05),
    replace(FIXED, edge_threshold=0.1, edge_steepness=0.5, noise_scale=0.08),
    replace(LOCAL, edge_threshold=1.0),
    pr.DiffusionSettings(k=40, bandwidth=0.2, edge_threshold=0.2),
    pr.DiffusionSettings(k=40, bandwidth=0.2, normalisation="local", edge_threshold=1.0),
]


@pytest.mark.parametrize("settings", CASES)
def test_estimates_equal_their_definition(settings):
    """On a plane and, faces being too many for trees of their own, on a bent surface."""
    flat = steep_map(500)
    height = 0.3 * flat.position[:, 0] ** 2
    slope = 0.6 * flat.position[:, 0]
    bent = flat.replace(
        position=flat.position + np.column_stack([0 * height, 0 * height, height]),
        normal=np.column_stack([-slope, 0 * slope, np.ones_like(slope)]),
    )
    q = rotation()
    for photons in (turned(flat, q), turned(bent, q)):
        rows = np.arange(0, 500, 25)
        points = photons.position[rows] + 0.01 * photons.wi[rows]
        normals = photons.normal[rows]
        expected = by_definition(photons, points, normals, settings)
        for isotropic in (False, True):
            field = DiffusionField(photons, settings, isotropic=isotropic)
            np.testing.assert_allclose(field(points, normals), expected[isotropic], rtol=1e-9)


def test_gradients_equal_their_definition():
    photons = turned(steep_map(800), rotation(1))
    for settings, scale, k in (
        (FIXED, 0.05, None),
        (replace(FIXED, noise_scale=0.07), 0.07, None),
        (pr.DiffusionSettings(k=60, bandwidth=0.3), 0.15, 15),
    ):
        found = found_gradient(photons, settings)
        np.testing.assert_allclose(found, gradient(photons, scale, k), rtol=1e-9, atol=1e-12)


def test_the_gradient_of_a_linear_field_is_its_slope():
    """E = 2x over the unit square, by inversion: x = √u."""
    uv = unit_square(20_000, "halton")
    photons = flat_map(np.column_stack([np.sqrt(uv[:, 0]), uv[:, 1]]), 20_000)
    slopes = found_gradient(photons, replace(LOCAL, noise_scale=0.1))
    inside = (np.abs(photons.position[:, :2] - 0.5) < 0.35).all(axis=1)
    np.testing.assert_allclose(slopes[inside].mean(axis=0), [2.0, 0.0, 0.0], atol=0.02)
    assert (slopes[:, 2] == 0.0).all()


@pytest.mark.parametrize("method", METHODS)
def test_without_edges_it_is_the_standard_estimate_of_fixed_bandwidth(method):
    photons, (points, normals) = steep_map(3000), plane(unit_square(300, "random", 5))
    never = replace(FIXED, edge_threshold=np.inf)
    found = pr.irradiance_field(photons, method=method, diffusion=never)(points, normals)
    standard = pr.GatherSettings(k=10_000, gather_radius=0.1)
    expected = pr.estimate_irradiance(photons, points, normals, standard)
    np.testing.assert_allclose(found, expected, rtol=1e-12)


# --- fields that are known ---------------------------------------------------------------------


@pytest.mark.kernels_run_elsewhere
@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("kind", ["random", "halton"])
def test_a_uniform_field_returns_its_own_value(method, kind, interior):
    photons = uniform_map(30_000, kind)
    points, normals = (array[:6000] for array in interior)
    inside = (np.abs(photons.position[:, :2] - 0.5) < 0.35).all(axis=1).mean() / 0.7**2
    for settings in (None, replace(LOCAL, bandwidth=0.06)):
        field = pr.irradiance_field(photons, method=method, diffusion=settings)
        assert field(points, normals).mean() == pytest.approx(inside, rel=5e-3)


@pytest.mark.kernels_run_elsewhere
@pytest.mark.parametrize("method", METHODS)
def test_a_linear_field_is_kept(method):
    """E = 2x over the unit square; means of strips."""
    uv = unit_square(60_000, "halton")
    photons = flat_map(np.column_stack([np.sqrt(uv[:, 0]), uv[:, 1]]), 60_000)
    points, normals = plane(np.random.default_rng(1).uniform(0.1, 0.9, (8000, 2)))
    strip = np.digitize(points[:, 0], np.linspace(0.1, 0.9, 9)) - 1
    expected = np.bincount(strip, 2 * points[:, 0])
    for settings in (None, replace(LOCAL, bandwidth=0.05)):
        field = pr.irradiance_field(photons, method=method, diffusion=settings)
        sums = np.bincount(strip, field(points, normals)[:, 0])
        np.testing.assert_allclose(sums, expected, rtol=0.01)


@pytest.mark.parametrize("method", METHODS)
def test_energy_is_kept(method):
    """A disc of light, its edge and all, within 1 %."""
    xy = unit_square(60_000, "random")
    xy = xy[np.linalg.norm(xy - 0.5, axis=1) < 0.35]
    photons = flat_map(xy, 60_000)
    points, normals = plane(unit_square(20_000, "halton", 3))
    found = pr.irradiance_field(photons, method=method)(points, normals)[:, 0].mean()
    assert found == pytest.approx(photons.flux[:, 0].sum(), rel=0.01)


def test_light_is_projected_along_its_direction_over_a_crease():
    """A roof in light from above: E₀ cos θ up to its ridge, to which other distances add light."""
    slope = np.tan(np.radians(25.0))
    xy = unit_square(40_000, "halton") - 0.5
    side = np.sign(xy[:, 0])
    position = np.column_stack([xy, -slope * np.abs(xy[:, 0])])
    normal = np.column_stack([slope * side, 0 * side, 1 + 0 * side])
    wi = np.tile([0.0, 0.0, 1.0], (len(xy), 1))
    photons = pr.PhotonMap(position, normal, np.full(len(xy), 1 / 40_000), wi=wi)
    x, y = np.random.default_rng(0).uniform([0.0, -0.3], [0.04, 0.3], (1000, 2)).T
    points = np.column_stack([x, y, -slope * x])
    normals = np.tile([slope, 0.0, 1.0], (1000, 1))
    expected = np.cos(np.radians(25.0))
    never = replace(LOCAL, edge_threshold=np.inf)
    along = DiffusionField(photons, never)(points, normals)[:, 0] / expected
    np.testing.assert_allclose(along, 1.0, atol=0.02)
    upright = DiffusionField(photons.replace(wi=None), never)(points, normals)[:, 0] / expected
    assert upright.mean() > 1.05


# --- what must not matter ----------------------------------------------------------------------


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("settings", [FIXED, LOCAL, pr.DiffusionSettings(k=60, bandwidth=0.2)])
def test_rotation_place_unit_and_order_do_not_matter(method, settings):
    photons = steep_map(4000)
    points, normals = plane(unit_square(200, "random", 7))
    one = pr.irradiance_field(photons, method=method, diffusion=settings)(points, normals)
    q, scale, shift = rotation(2), 250.0, np.array([30.0, -4.0, 9.0])
    order = np.random.default_rng(0).permutation(4000)
    moved = turned(photons, q, scale, shift).subset(order)
    scaled = replace(settings, bandwidth=scale * settings.bandwidth)
    field = pr.irradiance_field(moved, method=method, diffusion=scaled)
    other = field(scale * points @ q.T + shift, normals @ q.T)
    # Rounding may order two photons at the same distance.
    np.testing.assert_allclose(scale**2 * other, one, rtol=1e-6)


def test_brightness_does_not_matter():
    photons = steep_map(4000)
    sites = plane(unit_square(200, "random", 7))
    for settings in (FIXED, LOCAL):
        dim, bright = (
            DiffusionField(photons.replace(flux=s * photons.flux), settings)(*sites)
            for s in (1.0, 1000.0)
        )
        np.testing.assert_allclose(1000.0 * dim, bright, rtol=1e-9)


@pytest.mark.parametrize("method", METHODS)
def test_same_bytes_for_every_number_of_threads(method, interior):
    photons = uniform_map(10_000, "random")
    points, normals = (array[:3000] for array in interior)
    one, *others = [
        pr.irradiance_field(photons, method=method, n_threads=t)(points, normals).tobytes()
        for t in (1, 2, 7)
    ]
    assert all(other == one for other in others)


def test_other_faces_do_not_matter():
    """Both sides of a thin plate and a wall beside it: each sees its own light alone."""
    top = uniform_map(4000, "random")
    below = top.replace(normal=-top.normal, flux=top.flux * 5, position=top.position - [0, 0, 1e-4])
    wall = top.replace(
        position=top.position[:, [2, 0, 1]], normal=top.normal[:, [2, 0, 1]], flux=top.flux * 9
    )
    fields = ("position", "normal", "flux")
    every = pr.PhotonMap(
        **{f: np.concatenate([getattr(m, f) for m in (top, below, wall)]) for f in fields}
    )
    points, normals = plane(np.random.default_rng(0).uniform(0.1, 0.9, (100, 2)))
    for side, light in ((normals, top), (-normals, below)):
        found, alone = (DiffusionField(m, LOCAL)(points, side) for m in (every, light))
        np.testing.assert_allclose(found, alone, rtol=1e-9)
    assert (DiffusionField(top, LOCAL)(points, -normals) == 0.0).all()


# --- reports and refusals -----------------------------------------------------------------------


def test_fields_report_their_stages_and_settings():
    said = []

    def progress(*report):
        said.append(report)

    photons = uniform_map(3000, "random")
    for normalisation, stages in (("local", ["gradient"]), ("maximum", ["gradient", "normalise"])):
        settings = pr.DiffusionSettings(k=100, normalisation=normalisation)
        field = pr.irradiance_field(
            photons,
            method="diffusion",
            diffusion=settings,
            progress=progress,
        )
        assert list(field.seconds) == stages
        assert field.used["diffusion"]["k"] == 100
        assert field.used["diffusion"]["bandwidth"] > 0.1
        assert said[-1] == (stages[-1], 3000, 3000)
        field(*plane(np.full((5, 2), 0.5)), progress=progress)
        assert said[-1] == ("estimate", 5, 5)
    values = np.hstack([photons.flux, 2 * photons.flux[:, :1]])
    found = field.densities(values)(*plane(np.full((1, 2), 0.5)))
    np.testing.assert_allclose(found[:, 3], 2 * found[:, 0])


@pytest.mark.parametrize("method", METHODS)
def test_with_fewer_photons_than_k_the_bandwidth_is_the_largest(method):
    photons = flat_map(np.array([[0.5, 0.5]]), 1)
    points, normals = plane(np.array([[0.55, 0.5]]))
    settings = pr.DiffusionSettings(k=500, bandwidth=0.1)
    found = pr.irradiance_field(photons, method=method, diffusion=settings)(points, normals)
    gather = pr.GatherSettings(k=500, gather_radius=0.1)
    expected = pr.estimate_irradiance(photons, points, normals, gather)
    assert expected.min() > 0.0
    np.testing.assert_allclose(found, expected, rtol=1e-12)


@pytest.mark.parametrize("method", METHODS)
def test_maps_with_next_to_nothing(method):
    points, normals = plane(np.array([[0.5, 0.5], [9.0, 9.0]]))
    empty = flat_map(np.empty((0, 2)), 1)
    for settings in (None, FIXED):
        field = pr.irradiance_field(empty, method=method, diffusion=settings)
        assert (field(points, normals) == 0.0).all()
    for n in (1, 5):
        found = pr.irradiance_field(
            flat_map(unit_square(n, "random"), n), method=method, diffusion=FIXED
        )(points, normals)
        assert np.isfinite(found).all()
        assert (found[1] == 0.0).all()
    two = flat_map(np.full((2, 2), 0.5), 2)
    with pytest.raises(ValueError, match=r"2 photons are all at one point.*bandwidth"):
        pr.irradiance_field(two, method=method)
    found = pr.irradiance_field(two, method=method, diffusion=FIXED)(points, normals)
    np.testing.assert_allclose(found[0], 2 / (np.pi * 0.1**2))


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"k": 1}, "k should be at least 2"),
        ({"k": None}, "should have k or bandwidth, but both are None"),
        ({"bandwidth": 0.0}, "bandwidth should be a positive number"),
        ({"bandwidth": np.inf}, "bandwidth should be a positive number"),
        ({"bandwidth": 1e160}, r"bandwidth should lie in \[1e-150, 1e\+150\], but is 1e\+160"),
        ({"noise_scale": 1e-160}, r"noise_scale should lie in \[1e-150, 1e\+150\], but is 1e-160"),
        ({"noise_scale": -1.0}, "noise_scale should be a positive number"),
        ({"edge_threshold": 0.0}, "edge_threshold should be a positive number"),
        ({"edge_steepness": 0.0}, "edge_steepness should be a positive number"),
        ({"least_eigenvalue": 0.0}, "least_eigenvalue should be a positive number"),
        ({"least_eigenvalue": 1.5}, "least_eigenvalue should be at most 1"),
        ({"normalisation": "global"}, "normalisation should be one of maximum, local"),
    ],
)
def test_bad_settings_are_refused(fields, message):
    with pytest.raises(ValueError, match=message):
        pr.DiffusionSettings(**fields)


def test_bad_points_are_refused():
    field = DiffusionField(uniform_map(100, "random"), FIXED)
    points, normals = plane(np.zeros((4, 2)))
    with pytest.raises(ValueError, match=r"normals should have shape \(4, 3\)"):
        field(points, normals[:2])
    with pytest.raises(ValueError, match="normals should hold directions, but vector 0 is zero"):
        field(points, 0 * normals)
    with pytest.raises(ValueError, match="points should be finite"):
        field(points + np.nan, normals)
    with pytest.raises(ValueError, match=r"values should have shape \(100, n\)"):
        field.densities(np.zeros((3, 1)))
