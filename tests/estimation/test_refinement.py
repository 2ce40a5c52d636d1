"""Numbers of photons that adapt: the rules by definition, uniform light, edges."""

import numpy as np
import pytest

import photonrelax as pr
from tests.helpers.footprint_rule import around, radius_of, square
from tests.helpers.photon_maps import (
    endless_map,
    even_points,
    flat_map,
    plane,
    uniform_map,
    unit_square,
)

REFINEMENTS = ("differential-checking", "bias-compensation")
K_MIN, K = 15, 200
# Mean of the Gaussian over the disc it is cut off at.
MEAN = 2 * 0.41**2 * (1 - np.exp(-0.5 / 0.41**2))
KERNELS = {
    "constant": lambda ratio: np.ones_like(ratio),
    "cone": lambda ratio: 3 * (1 - np.sqrt(ratio)),
    "epanechnikov": lambda ratio: 2 * (1 - ratio),
    "gaussian": lambda ratio: np.exp(-0.5 * ratio / 0.41**2) / MEAN,
}


def refined(refinement, **others):
    return pr.GatherSettings(k=K, k_min=K_MIN, refinement=refinement, **others)


def checked(density, k_min, k):
    """Differential checking: density[K] is the estimate of K photons."""
    number, signs = k_min, []
    while number < k and not (len(signs) >= 6 and abs(sum(signs[-6:])) == 6):
        grown = min(max(int(1.2 * number), number + 1), k)
        signs.append(np.sign(density[grown] - density[number]))
        number = grown
    return number


def compensated(density, flux, k_min, k):
    """Bias compensation: flux[i] is that of the i-th nearest."""
    low, high = k_min, k
    accepted = [k_min]
    while low < high:
        middle = (low + high + 1) // 2
        mean = np.average(density[accepted], weights=accepted)
        nearer = flux[: middle - 1]
        unevenness = (nearer**2).mean() / nearer.mean() ** 2
        variance = mean**2 * unevenness * (1 / (low - 1) - 1 / (middle - 1))
        if abs(density[middle] - mean) > 2.576 * np.sqrt(variance):
            high = middle - 1
        else:
            low = middle
            accepted.append(middle)
    return low


def chosen(refinement, squared, flux, k_min=K_MIN):
    """The number of photons for one list, nearest first, of squared distances and fluxes."""
    density = np.full(len(squared) + 1, np.nan)
    within = np.concatenate([[0.0], np.cumsum(flux)[:-1]])
    density[1:] = within / (np.pi * squared)
    if refinement == "differential-checking":
        return checked(density, k_min, len(squared))
    return compensated(density, flux, k_min, len(squared))


@pytest.fixture(scope="module")
def step():
    """A step from 1 to 0.2 W/m² at x = 1/2, of photons of unequal flux, and points about it."""
    rng = np.random.default_rng(0)
    xy = rng.random((20_000, 2))
    xy = xy[rng.random(20_000) < np.where(xy[:, 0] < 0.5, 1.0, 0.2)]
    flux = rng.uniform(0.5, 1.5, (len(xy), 3)) / 20_000
    points = np.column_stack([rng.uniform(0.3, 0.85, 300), rng.uniform(0.2, 0.8, 300)])
    return flat_map(xy, 20_000).replace(flux=flux), *plane(points)


RADIUS = 0.034
REACH = RADIUS * np.sqrt(K / K_MIN)


def nearest(photons, point):
    """Rows of the K nearest photons within reach, nearest first, and squared distances."""
    squared = ((photons.position - point) ** 2).sum(axis=1)
    near = np.flatnonzero(squared <= REACH**2)
    order = near[np.argsort(squared[near])][:K]
    return order, squared[order]


@pytest.fixture(scope="module")
def lists(step):
    """Of each point the K nearest within reach, and the number chosen, None of too few."""
    photons, points, _ = step
    found = [nearest(photons, point) for point in points]

    def number(refinement, order, squared):
        if squared[K_MIN - 1] > RADIUS**2:
            return None
        return chosen(refinement, squared, photons.flux[order].mean(axis=1))

    return {name: [(*one, number(name, *one)) for one in found] for name in REFINEMENTS}


@pytest.mark.parametrize("kernel", KERNELS)
@pytest.mark.parametrize("refinement", REFINEMENTS)
def test_estimates_equal_their_definition(refinement, kernel, step, lists):
    """Also of lists cut short by the gather radius, and where that is the bandwidth itself."""
    photons, points, normals = step
    settings = refined(refinement, kernel=kernel, gather_radius=RADIUS)
    estimates = pr.estimate_irradiance(photons, points, normals, settings)
    cases = {"all": 0, "fewer": 0, "too few": 0}
    for (order, near, number), estimate in zip(lists[refinement], estimates, strict=True):
        if number is None:
            bandwidth, used = RADIUS**2, (near <= RADIUS**2).sum()
            cases["too few"] += 1
        else:
            bandwidth, used = near[number - 1], number - 1
            cases["all" if len(near) == K else "fewer"] += 1
        weight = KERNELS[kernel](near[:used] / bandwidth) / (np.pi * bandwidth)
        np.testing.assert_allclose(estimate, weight @ photons.flux[order[:used]], rtol=1e-9)
    assert min(cases.values()) >= 20, cases


def numbers(refinement, photons, points):
    """Numbers of photons that estimates use, by the definition."""
    distance = pr.KDTree(photons.position).query(points, K).distance
    flux = np.full(K, photons.flux[0, 0])
    return np.array([chosen(refinement, row**2, flux) for row in distance])


@pytest.mark.kernels_run_elsewhere
@pytest.mark.parametrize("refinement", REFINEMENTS)
def test_uniform_light_uses_nearly_all_photons(refinement):
    """And keeps its mean: what is chosen is chosen by chance, 0.9 % low at most (measured)."""
    used, means, noise = [], [], {K_MIN: [], K: [], refinement: []}
    for seed in range(4):
        photons, (points, normals) = (
            endless_map(10_000, "random", seed),
            even_points(2584, 1000 + seed),
        )
        used.append(numbers(refinement, photons, points[:2500:10]).mean())
        for name, settings in (
            (K_MIN, pr.GatherSettings(k=K_MIN)),
            (K, pr.GatherSettings(k=K)),
            (refinement, refined(refinement)),
        ):
            estimates = pr.estimate_irradiance(photons, points, normals, settings)[:, 0]
            noise[name].append(estimates.std())
        means.append(estimates.mean())
    assert np.mean(used) > 0.85 * K
    assert np.mean(means) == pytest.approx(1.0, abs=0.012)
    assert np.mean(noise[refinement]) < 1.4 * np.mean(noise[K])
    assert np.mean(noise[refinement]) < 0.4 * np.mean(noise[K_MIN])


@pytest.mark.parametrize("side", [0.0, 0.003, 0.02, 0.2])
@pytest.mark.parametrize("refinement", REFINEMENTS)
def test_means_over_footprints_are_of_the_numbers_chosen_at_their_points(
    refinement, side, step, lists
):
    """Of the least number, within the gather radius, where that holds fewer photons."""
    photons, points, normals = step[0], step[1][:100], step[2][:100]
    settings, footprint = refined(refinement, gather_radius=RADIUS), np.full(100, side)
    random, spaced = (
        pr.IrradianceField(photons.replace(well_spaced=well_spaced), settings)(
            points, normals, footprint=footprint
        )
        for well_spaced in (False, True)
    )
    for i, (_, _, number) in enumerate(lists[refinement][:100]):
        k, largest = (K_MIN, RADIUS) if number is None else (number, REACH)
        seen = around(photons, points[i], normals[i], square(side))
        bandwidth, at_photon = radius_of(seen.squared, seen.sides, k, largest)
        expected = seen.weights(bandwidth, with_rim=not at_photon) @ photons.flux[seen.rows]
        np.testing.assert_allclose(random[i], expected, rtol=1e-9)
        if bandwidth < largest:
            expected /= 1.0 - 0.32 * k**-1.35 * np.exp(-3.6 * side / bandwidth)
        np.testing.assert_allclose(spaced[i], expected, rtol=1e-9)


@pytest.mark.kernels_run_elsewhere
@pytest.mark.parametrize("kind", ["random", "halton"])
@pytest.mark.parametrize("refinement", REFINEMENTS)
def test_uniform_light_has_its_own_value_over_footprints(refinement, kind):
    """But for what is chosen by chance, as at points."""
    means = np.empty((4, 4))
    for seed, row in enumerate(means):
        field = pr.IrradianceField(endless_map(10_000, kind, seed), refined(refinement))
        points, normals = even_points(610, 1000 + seed)
        for i, size in enumerate((0.1, 1.0, 10.0, 100.0)):
            footprint = np.full(len(points), np.sqrt(size / 10_000))
            row[i] = field(points, normals, footprint=footprint)[:, 0].mean()
    np.testing.assert_allclose(means.mean(axis=0), 1.0, atol=0.012)


@pytest.mark.parametrize("refinement", REFINEMENTS)
def test_a_map_has_the_flux_that_points_have(refinement):
    """Of a disc of light, 2.6 % of which is lost at points: fewer photons where light is dim."""
    xy = unit_square(60_000, "random")
    photons = flat_map(xy[np.linalg.norm(xy - 0.5, axis=1) < 0.35], 60_000)
    middle = (np.arange(100) + 0.5) / 100
    points, normals = plane(np.stack(np.meshgrid(middle, middle), -1).reshape(-1, 2))
    field = pr.IrradianceField(photons, refined(refinement))
    over, at = (
        field(points, normals, footprint=footprint)[:, 0].mean()
        for footprint in (np.full(10_000, 0.01), None)
    )
    assert over == pytest.approx(at, rel=5e-3)
    assert over == pytest.approx(photons.flux[:, 0].sum(), rel=0.03)


@pytest.mark.parametrize("refinement", REFINEMENTS)
def test_an_edge_is_sharper_than_with_the_most_photons(refinement):
    """1 W/m² left of x = 1/2: fewer photons right of it, and less light beyond the edge."""
    n = 100_000
    photons = flat_map(unit_square(n // 2, "random", 3) * [0.5, 1.0], n)
    reach = np.sqrt(K / (np.pi * n))
    rng = np.random.default_rng(0)
    error = {}
    for side, low in (("lit", -reach), ("dark", 0.0)):
        x = 0.5 + rng.uniform(low, low + reach, 4000)
        points, normals = plane(np.column_stack([x, rng.uniform(0.1, 0.9, 4000)]))
        used = numbers(refinement, photons, points[:500]).mean()
        assert used < (0.97 if side == "lit" else 0.5) * K, side
        for settings in (pr.GatherSettings(k=K), refined(refinement)):
            found = pr.estimate_irradiance(photons, points, normals, settings)[:, 0]
            error[side, settings.refinement] = np.sqrt(np.mean((found - (x < 0.5)) ** 2))
    assert error["dark", refinement] < 0.85 * error["dark", "none"]
    assert error["lit", refinement] < error["lit", "none"]


@pytest.mark.parametrize("refinement", REFINEMENTS)
def test_all_that_photons_carry_comes_from_the_same_photons(refinement, step):
    photons, points, normals = step
    field = pr.IrradianceField(photons, refined(refinement))
    values = np.random.default_rng(1).random((len(photons), 2))
    values = np.hstack([photons.flux[:, :1], 3 * photons.flux[:, :1], values, np.ones_like(values)])
    found = field.densities(values)(points, normals)
    np.testing.assert_array_equal(found[:, 0], field(points, normals)[:, 0])
    np.testing.assert_allclose(found[:, 1], 3 * found[:, 0])
    means = found[:, 2] / found[:, 4]
    assert (means > 0.0).all()
    assert (means < 1.0).all()


@pytest.mark.parametrize("refinement", REFINEMENTS)
def test_same_bytes_for_every_number_of_threads_and_order_of_photons(refinement, step):
    photons, points, normals = step
    shuffled = photons.subset(np.random.default_rng(2).permutation(len(photons)))
    one, *others = [
        pr.IrradianceField(some, refined(refinement), n_threads=t)(points, normals).tobytes()
        for some, t in ((photons, 1), (photons, 2), (photons, 7), (shuffled, 2))
    ]
    assert all(other == one for other in others)
    footprint = np.linspace(0.0, 0.1, len(points))
    one, *others = [
        pr.IrradianceField(photons, refined(refinement), n_threads=t)(
            points, normals, footprint=footprint
        )
        for t in (1, 2, 7)
    ]
    for other in others:
        np.testing.assert_array_equal(one, other)


@pytest.mark.parametrize("refinement", REFINEMENTS)
def test_faces_turned_away_and_maps_with_next_to_nothing(refinement):
    top = uniform_map(5000, "random")
    below = top.replace(normal=-top.normal, flux=5 * top.flux)
    fields = ("position", "normal", "flux")
    both = pr.PhotonMap(
        **{f: np.concatenate([getattr(side, f) for side in (top, below)]) for f in fields}
    )
    points, normals = plane(np.random.default_rng(0).uniform(0.2, 0.8, (200, 2)))
    settings = refined(refinement, gather_radius=0.05)
    found = pr.estimate_irradiance(both, points, -normals, settings)
    alone = pr.estimate_irradiance(below, points, -normals, settings)
    np.testing.assert_allclose(found, alone, rtol=1e-12)
    empty = flat_map(np.empty((0, 2)), 1)
    assert (pr.estimate_irradiance(empty, points, normals, refined(refinement)) == 0.0).all()
    black = top.replace(flux=np.zeros_like(top.flux))
    assert (pr.estimate_irradiance(black, points, normals, refined(refinement)) == 0.0).all()
    coincident = flat_map(np.full((20, 2), 0.5), 1)
    here = plane(np.array([[0.5, 0.5]]))
    found = pr.estimate_irradiance(coincident, *here, refined(refinement, gather_radius=0.1))
    np.testing.assert_allclose(found, 20 * 2 / (np.pi * 0.1**2))
    for photons in (empty, black):
        field = pr.IrradianceField(photons, refined(refinement))
        assert (field(points, normals, footprint=np.full(200, 0.01)) == 0.0).all()


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"refinement": "sharp"}, "refinement should be one of none, differential-checking, bias"),
        ({"refinement": "bias-compensation", "k": 10}, "k should be more than k_min, 15"),
        ({"refinement": "differential-checking"}, "k_min, 15, .* but is 15: try k=200"),
        ({"k_min": 1}, "k_min should be at least 2"),
    ],
)
def test_bad_settings_are_refused(fields, message):
    with pytest.raises(ValueError, match=message):
        pr.GatherSettings(**fields)
