"""Rest density: slopes by definition, and of known densities."""

import numpy as np
import pytest
import trimesh
from scipy.optimize import brentq

import photonrelax as pr
from photonrelax._ext.relaxation import relax as relax_kernel
from photonrelax._ext.relaxation import rest_density as kernel
from photonrelax.relaxation.rest_density import LATTICE_FORCE
from tests.helpers.neighbours import nearest
from tests.helpers.photon_maps import flat_map, mapped, uniform_map, unit_square


def tangents(direction):
    """Two unit vectors (3, 2) perpendicular to a unit vector."""
    return np.linalg.svd(direction[np.newaxis])[2][1:].T


def terms(delta):
    a, b = delta.T
    return np.column_stack([np.ones_like(a), a, b, a * a / 2, a * b, b * b / 2])


def hexagonal():
    """The 91 points of a lattice around one of them, with one to a unit of area."""
    spacing = np.sqrt(2 / np.sqrt(3))
    rows = [
        (i + j / 2, j * np.sqrt(3) / 2)
        for j in range(-5, 6)
        for i in range(-5, 6)
        if abs(i + j) <= 5
    ]
    return spacing * np.array(rows)


def edge(delta, radius):
    """Direction away from an edge of the sheet, its distance over the radius, and the area left."""
    mean = delta[1:].mean(axis=0)
    shift = np.linalg.norm(mean) / radius
    along = mean / np.linalg.norm(mean)

    def area(t):
        return np.pi / 2 + np.arcsin(t) + t * np.sqrt(1 - t * t)

    def excess(t):
        return 2 / 3 * (1 - t * t) ** 1.5 - shift * area(t)

    if shift > 0.3:
        t = brentq(excess, 0, 1, xtol=1e-15) if excess(0) > 0 else 0.0
        if (-delta @ along).max() <= (t + 0.2) * radius:
            return along, t, area(t)
    return along, np.inf, np.pi


def slope_by_definition(delta, offset, max_residual=0.1):
    """Slope g from the offsets of 24 photons, nearest first, and the residual of their map."""
    radius = np.linalg.norm(delta[15])
    weight = np.exp(-(np.linalg.norm(delta[:16], axis=1) ** 2) / (2 * radius**2))
    matrix = weight[:, np.newaxis] * terms(delta[:16])
    fit = np.linalg.lstsq(matrix, weight[:, np.newaxis] * offset[:16], rcond=None)[0]
    left = (weight[:, np.newaxis] * (offset[:16] - terms(delta[:16]) @ fit)) ** 2
    largest = np.linalg.norm(delta[-1])
    along, t, share = edge(delta, largest)
    area = share * largest**2 / 23
    first, second = fit[1:3], np.array([[fit[3], fit[4]], [fit[4], fit[5]]])
    metric = first @ first.T + area * np.einsum("ijc,jkc->ik", second, second)
    values, vectors = np.linalg.eigh(metric)
    aspect = min(np.sqrt(values[1] / values[0]), 6.0)
    stretch = vectors[:, ::-1] * np.sqrt(area / 2 * np.array([1 / aspect, aspect]))
    lattice = hexagonal() @ stretch.T
    lattice = lattice[lattice @ along >= -t * largest]
    points = terms(lattice) @ fit - fit[0]
    points = points[np.argsort(np.linalg.norm(points, axis=1))[:32]]
    distance = np.linalg.norm(points, axis=1)
    others = distance > 0
    force = (distance.max() / distance[others] - 1) @ -points[others] / 32
    squared_radius = 2 * (distance**2).mean()
    residual = np.sqrt(left.sum() / (weight**2).sum() / squared_radius)
    g = -force / (LATTICE_FORCE * squared_radius)
    return g * (residual <= max_residual), residual


def curved_sheets(coords):
    """Photons of two sheets, mapped with folds to a plane that is turned in space."""
    n = len(coords)
    signature = np.random.default_rng(2).integers(2, size=n)
    a, b = coords[:, :2].T
    x = np.where(signature, (2 * a - 1) ** 2 + 0.3 * b, 0.8 * a - 0.2 * np.sin(3 * b))
    y = np.where(signature, b - 0.4 * a * b, np.exp(b) + a * a)
    normal = np.array([2.0, -1.0, 2.0]) / 3.0
    position = np.column_stack([x, y]) @ tangents(normal).T
    return pr.PhotonMap(
        position,
        np.tile(normal, (n, 1)),
        np.full((n, 3), 1.0 / n),
        emitter_coords=coords,
        emitter_density=np.full(n, float(n)),
        path_signature=signature * 7 - 3,
    )


def directions(n):
    """Unit vectors of a cap."""
    uv = 0.6 * unit_square(n, "random", 5) - 0.3
    return np.column_stack([uv, np.sqrt(1 - (uv**2).sum(axis=1))])


@pytest.mark.parametrize(
    "coords", [unit_square(900, "random", 5), directions(900)], ids=["plane", "sphere"]
)
def test_slopes_equal_their_definition(coords):
    photons = curved_sheets(coords)
    found = pr.rest_density(photons)
    frame = tangents(photons.normal[0])
    for i in range(0, len(photons), 7):
        own = np.flatnonzero(photons.path_signature == photons.path_signature[i])
        ids = own[nearest(coords[own], coords[[i]], 24, n_metric=coords.shape[1])[0][0]]
        delta = coords[ids] - coords[i]
        if coords.shape[1] == 3:
            delta = delta @ tangents(coords[i])
        slope, residual = slope_by_definition(
            delta, (photons.position[ids] - photons.position[i]) @ frame
        )
        np.testing.assert_allclose(found.residual[i], residual, rtol=1e-7, atol=1e-12)
        scale = 1.0 + np.linalg.norm(slope)
        np.testing.assert_allclose(found.slope[i], frame @ slope, rtol=0, atol=1e-9 * scale)


@pytest.mark.parametrize("kind", ["halton", "random"])
def test_slope_of_an_exponential_density(kind):
    """The slope of exp(3 x) is 3 wherever photons have neighbours all round."""
    photons = mapped("exponential", 20_000, kind)
    inner = (np.abs(photons.emitter_coords - 0.5) < 0.4).all(axis=1)
    slope = pr.rest_density(photons).slope[inner]
    np.testing.assert_allclose(np.median(slope, axis=0), [3.0, 0.0, 0.0], rtol=0, atol=0.05)


def test_even_light_has_no_slope_but_at_its_edges():
    photons = uniform_map(20_000, "halton")
    slope = np.linalg.norm(pr.rest_density(photons).slope, axis=1)
    depth = 0.5 - np.abs(photons.position[:, :2] - 0.5).max(axis=1)
    spacing = 20_000**-0.5
    assert np.quantile(slope[depth > 3 * spacing], 0.99) * spacing < 1e-2
    assert np.quantile(slope[depth < 0.2 * spacing], 0.01) * spacing > 0.2


def test_photons_of_other_signatures_are_no_neighbours():
    first, second = mapped("exponential", 3000, "random", 1), mapped("folded", 2000, "random", 2)
    fields = ("position", "normal", "flux", "emitter_coords", "emitter_density")
    both = pr.PhotonMap(
        **{f: np.concatenate([getattr(first, f), getattr(second, f)]) for f in fields},
        path_signature=np.repeat([5, -5], [3000, 2000]),
    )
    apart = np.concatenate([pr.rest_density(m).slope for m in (first, second)])
    np.testing.assert_array_equal(pr.rest_density(both).slope, apart)


def test_without_signatures_the_residual_tells_sheets_apart():
    """Where two sheets overlap over the emitter coordinates, no map fits, and no slope is made."""
    coords = unit_square(4000, "random", 4)
    photons = curved_sheets(coords).replace(path_signature=None)
    rest = pr.rest_density(photons)
    assert (rest.residual > 0.1).mean() > 0.98
    assert (rest.slope[rest.residual > 0.1] == 0.0).all()


def force_over_coords(coords, k=16):
    """Force of the nearest k photons over the emitter coordinates, in units of their radius."""
    ids, distance = nearest(coords, coords, k)
    radius, apart = distance[:, -1:], distance[:, 1:, np.newaxis]
    away = coords[:, np.newaxis] - coords[ids[:, 1:]]
    force = (away * (radius[..., np.newaxis] / apart - 1.0)).sum(axis=1) / k
    return np.linalg.norm(force, axis=1) / radius[:, 0]


@pytest.mark.kernels_run_elsewhere
@pytest.mark.parametrize("kind", ["halton", "random"])
def test_limits_follow_the_noise(kind):
    """Seven times the median force over the emitter coordinates, at most half the radius."""
    photons = uniform_map(5000, kind)
    inner = (np.abs(photons.emitter_coords - 0.5) < 0.4).all(axis=1)
    noise = np.median(force_over_coords(photons.emitter_coords)[inner])
    limit = pr.rest_density(photons).limit
    np.testing.assert_allclose(limit, min(7.0 * noise, 0.5), rtol=0.05)


def test_limits_are_of_each_sheet():
    """A sheet of a tenth of Halton's photons is as noisy as independent ones."""
    coords = unit_square(20_000, "halton")
    faint = np.random.default_rng(1).random(20_000) < 0.1
    photons = flat_map(coords, 20_000, path_signature=faint.astype(int))
    limit = pr.rest_density(photons).limit
    assert np.ptp(limit[faint]) == np.ptp(limit[~faint]) == 0.0
    assert limit[faint][0] > 1.4 * limit[~faint][0]


@pytest.mark.parametrize("share", [0.2, 0.5, 0.8])
def test_photons_whose_map_is_refused_hardly_move(share):
    """Twice the noise for seven times; less of both where fewer than two thirds of maps fit."""
    photons = mapped("exponential", 5000, "halton")
    residual = pr.rest_density(photons).residual
    largest = float(np.quantile(residual, share))
    limit = pr.rest_density(photons, pr.RestDensitySettings(max_residual=largest)).limit
    smooth = min(1.5 * (residual <= largest).mean(), 1.0) ** 2
    noise = limit[residual > largest] / (2.0 * smooth)
    np.testing.assert_allclose(noise, noise[0])
    assert 0.03 < noise[0] < 0.05
    np.testing.assert_allclose(limit[residual <= largest], 7.0 * noise[0] * smooth)


@pytest.mark.parametrize("n_threads", [2, 7])
def test_same_bytes_for_every_number_of_threads(n_threads):
    photons = mapped("folded", 20_000, "random")
    one, many = pr.rest_density(photons, n_threads=1), pr.rest_density(photons, n_threads=n_threads)
    assert one.slope.tobytes() == many.slope.tobytes()
    assert one.residual.tobytes() == many.residual.tobytes()


@pytest.mark.parametrize(("scale", "shift"), [(1e-4, 0), (1e4, 0), (1, 1e4)])
def test_neither_unit_nor_origin_matter(scale, shift):
    photons = mapped("exponential", 3000, "random")
    other = photons.replace(position=photons.position * scale + [shift, -shift, shift])
    slope, of_other = pr.rest_density(photons).slope, pr.rest_density(other).slope
    np.testing.assert_allclose(of_other * scale, slope, rtol=1e-6, atol=1e-4)


def test_the_unit_of_the_emitter_coordinates_does_not_matter():
    photons = mapped("exponential", 3000, "random")
    other = photons.replace(emitter_coords=1e-3 * photons.emitter_coords + 5.0)
    np.testing.assert_allclose(
        pr.rest_density(other).slope, pr.rest_density(photons).slope, rtol=1e-6, atol=1e-4
    )


def test_rotation_turns_the_slope_with_it():
    photons = mapped("exponential", 3000, "random")
    rotation = trimesh.transformations.rotation_matrix(0.7, [1, 2, 3])[:3, :3]
    turned = photons.replace(
        position=photons.position @ rotation.T, normal=photons.normal @ rotation.T
    )
    np.testing.assert_allclose(
        pr.rest_density(turned).slope, pr.rest_density(photons).slope @ rotation.T, atol=1e-6
    )


def test_order_does_not_matter():
    photons = mapped("folded", 3000, "random")
    order = np.random.default_rng(1).permutation(3000)
    slope = pr.rest_density(photons).slope
    np.testing.assert_array_equal(pr.rest_density(photons.subset(order)).slope, slope[order])


def test_bad_columns_are_refused():
    with pytest.raises(ValueError, match="residual"):
        pr.RestDensity(np.zeros((2, 3)), np.array([1.0, -1.0]), np.ones(2))
    with pytest.raises(ValueError, match="limit"):
        pr.RestDensity(np.zeros((2, 3)), np.ones(2), np.array([1.0, -1.0]))
    with pytest.raises(ValueError, match="slope"):
        pr.RestDensity(np.full((2, 3), np.nan), np.ones(2), np.ones(2))


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"k": 5}, "k should be at least 6"),
        ({"k": 65}, "k should be at most 64"),
        ({"n_fitted": 5}, "n_fitted should be at least 6"),
        ({"n_fitted": 25}, "n_fitted should be at most 24"),
        ({"max_residual": 0.0}, "max_residual should be a positive"),
    ],
)
def test_bad_settings_are_refused(fields, message):
    with pytest.raises(ValueError, match=message):
        pr.RestDensitySettings(**fields)


def test_kernels_refuse_arrays_that_do_not_fit():
    three, one = np.zeros((20, 3)), np.zeros(20)
    tree = pr.KDTree(np.random.default_rng(0).random((20, 3))).kernel
    arrays = {"records": np.zeros((20, 9)), "places": np.arange(20), "slope": three}
    arrays |= {"residual": one, "noise": one}
    settings = {"k": 8, "n_fitted": 8, "max_residual": 0.1, "lattice_force": LATTICE_FORCE}
    for name, array in arrays.items():
        wrong = arrays | {name: array[1:].copy()}
        with pytest.raises(ValueError, match="do not fit the tree"):
            kernel.prescribe(tree, 0, 20, **wrong, **settings, n_threads=1)
    rest = {"slope": three, "limit": one, "origin": three, "start": three}
    rest |= {"rows": np.arange(20), "radius": one}
    settings = {"limit_of_slope": 0.4, "share": 1.0, "longer": 1.2, "steep": 0.2, "n_threads": 1}
    for name, array in rest.items():
        with pytest.raises(ValueError, match="do not fit one another"):
            relax_kernel.Rest(**rest | {name: array[1:].copy()}, **settings)
