"""Relaxation towards a rest density: what it keeps, evens out and leaves as it is."""

import numpy as np
import pytest
import trimesh

import photonrelax as pr
from photonrelax import gallery
from tests.helpers.neighbours import nearest
from tests.helpers.photon_maps import MAPS, flat_map, mapped, plane, uniform_map, unit_square
from tests.helpers.tracing_scenes import DOWN, ball, glass_ball, scene_of


def relaxed(photons, rest, *, n_threads=1, scene=None, **settings):
    found = pr.detect_structure(photons, n_threads=n_threads)
    chosen = pr.RelaxSettings(**{"n_iterations": (5, 5), "step": 2.0} | settings)
    return pr.relax(photons, found, chosen, rest=rest, scene=scene, n_threads=n_threads)


@pytest.mark.kernels_run_elsewhere
@pytest.mark.parametrize("kind", ["halton", "random"])
@pytest.mark.parametrize("name", MAPS)
def test_slopes_do_not_flow_away(name, kind):
    """The mean displacement along a slope is under 8 % of that of plain relaxation."""
    photons = mapped(name, 20_000, kind)
    inner = (np.abs(photons.emitter_coords - 0.5) < 0.42).all(axis=1)
    rests = pr.rest_density(photons, n_threads=1), None
    kept, plain = (
        (relaxed(photons, rest, n_iterations=(14, 14)).position - photons.position)[inner, 0].mean()
        for rest in rests
    )
    assert abs(kept) < 0.08 * abs(plain)


@pytest.mark.parametrize("kind", ["halton", "random"])
def test_even_light_becomes_more_even(kind):
    """After (7, 7) iterations, seen through pixels of 2.5 photons, against steps of one without."""
    photons = uniform_map(20_000, kind, seed=5)
    points, normals = plane(0.1 + 0.8 * unit_square(4000, "random", 1))
    rest = pr.rest_density(photons, n_threads=1)
    noise = []
    for moved in (
        relaxed(photons, rest, n_iterations=(7, 7)),
        relaxed(photons, None, n_iterations=(7, 7), step=1.0),
    ):
        field = pr.irradiance_field(moved, method="standard", gather=pr.GatherSettings(k=8))
        side = np.full(len(points), (2.5 / len(photons)) ** 0.5)
        noise.append(field(points, normals, footprint=side)[:, 0].std())
    assert noise[0] <= 0.85 * noise[1]


def test_one_iteration_adds_the_force_at_rest():
    photons = mapped("exponential", 3000, "random")
    found = pr.detect_structure(photons, pr.StructureSettings(reach_scale=np.inf))
    free = pr.Structure(**{**vars(found), "constraint": np.zeros(len(photons))})
    rest = pr.rest_density(photons)
    # Steps to rest are 1.2 times as long.
    plain, moved = (
        pr.relax(
            photons, free, pr.RelaxSettings((0, 1), k=12, step=step, largest_step=np.inf), rest=each
        ).position
        for step, each in ((0.36, None), (0.3, rest))
    )
    radius = nearest(photons.position, photons.position, 12)[1][:, -1]
    radius_of_k = found.radius * np.sqrt(12 / found.n_found)
    length = 1 / np.maximum(np.linalg.norm(rest.slope, axis=1), 1e-300)
    expected = plain + (0.36 * 11.5 / (12 * 12) * radius**2)[:, np.newaxis] * rest.slope
    gone = np.linalg.norm(expected - photons.position, axis=1)
    limit = np.minimum(0.6 * rest.limit * radius, rest.limit * radius_of_k)
    within = gone < np.minimum(limit, 0.4 * length)
    assert within.mean() > 0.9
    np.testing.assert_allclose(moved[within], expected[within], rtol=0, atol=1e-12)


def test_steps_on_slopes_shorten_after_the_fifth():
    """The sixth is (5/6)² as long where density changes by a fifth within the radius of 16."""
    photons = mapped("exponential", 3000, "random")
    found = pr.detect_structure(photons, pr.StructureSettings(reach_scale=np.inf))
    free = pr.Structure(**{**vars(found), "constraint": np.zeros(len(photons))})
    slope = pr.rest_density(photons).slope
    rest = pr.RestDensity(slope, np.zeros(len(photons)), np.full(len(photons), 1e3))

    def after(n, start):
        settings = pr.RelaxSettings((0, n), step=0.3, largest_step=np.inf)
        return pr.relax(photons.replace(position=start), free, settings, rest=rest).position

    fifth, sixth = (after(n, photons.position) for n in (5, 6))
    step = after(1, fifth) - fifth
    steepness = np.linalg.norm(slope, axis=1)
    steep = steepness * nearest(fifth, fifth, 16)[1][:, -1] > 0.2
    held = np.linalg.norm(fifth + step - photons.position, axis=1) * steepness >= 0.4
    assert 0.1 < steep.mean() < 0.9
    assert held.mean() < 0.1
    expected = fifth + np.where(steep, 25 / 36, 1.0)[:, np.newaxis] * step
    np.testing.assert_allclose(sixth[~held], expected[~held], rtol=0, atol=1e-12)


def test_no_photon_goes_beyond_its_limit():
    photons = mapped("folded", 3000, "random")
    found, rest = pr.detect_structure(photons), pr.rest_density(photons)
    moved = pr.relax(photons, found, pr.RelaxSettings((14, 14), step=2.0), rest=rest).position
    gone = np.linalg.norm(moved - photons.position, axis=1)
    assert rest.has_map.all()
    radius = found.radius * np.sqrt(16 / found.n_found)
    assert (gone <= rest.limit * radius * (1 + 1e-9)).all()
    assert (gone * np.linalg.norm(rest.slope, axis=1) <= 0.4 * (1 + 1e-9)).all()


def crossed_sheets():
    """An even sheet across a folded one, of two signatures."""
    folded, even = mapped("folded", 2000, "random", 1), uniform_map(2000, "random", 2)
    fields = ("position", "normal", "flux", "emitter_coords", "emitter_density")
    return pr.PhotonMap(
        **{f: np.concatenate([getattr(folded, f), getattr(even, f)]) for f in fields},
        path_signature=np.repeat([1, 2], 2000),
    )


def test_moves_in_space_are_limited_by_the_spacing_of_all_sheets():
    """To 0.6 of the limit, in units of the radius of k photons of all sheets, in one move."""
    photons = crossed_sheets()
    found, rest = pr.detect_structure(photons), pr.rest_density(photons)
    settings = pr.RelaxSettings((0, 1), step=100.0, largest_step=np.inf)
    moved = pr.relax(photons, found, settings, rest=rest).position
    radius = nearest(photons.position, photons.position, 16)[1][:, -1]
    gone = np.linalg.norm(moved - photons.position, axis=1)
    assert (gone <= 0.6 * rest.limit * radius * (1 + 1e-9)).all()
    assert gone.max() > 0.0


@pytest.mark.kernels_run_elsewhere
@pytest.mark.parametrize("kind", ["halton", "random"])
@pytest.mark.parametrize("n_iterations", [(5, 5), (14, 14)])
def test_facets_are_never_worse_than_unrelaxed(kind, n_iterations):
    """Across a kink of the map, as of flat facets, where density jumps by four."""
    coords = unit_square(20_000, kind, 3)
    x = np.where(coords[:, 0] < 0.5, 0.4 * coords[:, 0], 1.6 * coords[:, 0] - 0.6)
    photons = flat_map(np.column_stack([x, coords[:, 1]]), 20_000, coords=coords)
    rest = pr.rest_density(photons, n_threads=1)
    points, normals = plane(0.05 + 0.9 * unit_square(4000, "random", 1))
    side = np.full(len(points), (2.5 / len(photons)) ** 0.5)
    exact = np.where(points[:, 0] < 0.2, 2.5, 0.625)
    errors = []
    for each in (relaxed(photons, rest, n_iterations=n_iterations), photons):
        field = pr.irradiance_field(each, method="standard", gather=pr.GatherSettings(k=8))
        errors.append(np.abs(field(points, normals, footprint=side)[:, 0] - exact).mean())
    assert errors[0] < errors[1]


@pytest.mark.parametrize("n_iterations", [(5, 5), (14, 14)])
def test_many_small_facets_leave_photons_where_they_are(n_iterations):
    """Facets of some forty photons, each of which throws a patch of light of its own."""
    coords = unit_square(20_000, "halton", 3)
    facet = np.floor(22 * coords)
    photons = flat_map((facet + 0.6 * (22 * coords - facet)) / 22, 20_000, coords=coords)
    rest = pr.rest_density(photons, n_threads=1)
    assert rest.limit.max() < 0.1
    after = relaxed(photons, rest, n_iterations=n_iterations)
    gone = np.linalg.norm(after.position - photons.position, axis=1)
    assert np.median(gone) < 0.1 * 20_000**-0.5


def test_neither_flux_nor_input_changes():
    photons = mapped("exponential", 5000, "random")
    before = photons.position.tobytes()
    after = relaxed(photons, pr.rest_density(photons))
    assert photons.position.tobytes() == before
    assert after.position.tobytes() != before
    assert after.flux.tobytes() == photons.flux.tobytes()
    assert after.well_spaced


def test_the_ledger_of_a_traced_map_is_kept():
    scene = gallery.scene("ring")
    photons = pr.trace_photons(scene, 10_000, seed=1, n_threads=1)
    rest = pr.rest_density(photons)
    after = relaxed(photons, rest, scene=scene)
    assert (after.position != photons.position).any()
    assert (rest.slope != 0.0).any()
    assert photons.ledger is not None
    assert after.ledger is photons.ledger


def test_photons_stay_on_their_floor():
    square = trimesh.Trimesh([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], [[0, 1, 2], [0, 2, 3]])
    photons = mapped("exponential", 3000, "random").replace(object_id=np.zeros(3000, dtype=int))
    after = relaxed(photons, pr.rest_density(photons), scene=scene_of(square)).position
    assert (after[:, 2] == 0.0).all()
    assert after[:, :2].min() >= 0.0
    assert after[:, :2].max() <= 1.0


def hardly_moves(photons):
    """True if none has a map, and all stay within 0.1 √(n/1000), at most 0.3, radii of 16.

    n is rounded down to a power of two.
    """
    rest, found = pr.rest_density(photons), pr.detect_structure(photons)
    n = 2 ** (max(len(photons), 1).bit_length() - 1)
    limit = min(0.1 * np.sqrt(n / 1000), 0.3)
    moved = pr.relax(photons, found, pr.RelaxSettings((5, 5), step=2.0), rest=rest).position
    gone = np.linalg.norm(moved - photons.position, axis=1)
    within = gone <= limit * found.radius * np.sqrt(16 / found.n_found) * (1 + 1e-9)
    return not rest.has_map.any() and (rest.limit == limit).all() and within.all()


@pytest.mark.parametrize("n", [0, 1, 2, 5, 15, 16, 23])
def test_too_few_photons_for_a_map_hardly_move(n):
    assert hardly_moves(uniform_map(24, "random").subset(slice(n)))
    assert pr.rest_density(uniform_map(24, "random")).has_map.all()


def test_photons_without_emitter_coordinates_relax_as_without_a_density():
    photons = uniform_map(2000, "random").replace(emitter_coords=None, emitter_density=None)
    rest = pr.rest_density(photons)
    assert not rest.has_map.any()
    np.testing.assert_array_equal(relaxed(photons, rest).position, relaxed(photons, None).position)


@pytest.mark.parametrize("shape", ["point", "line", "landed together", "no direction"])
def test_photons_whose_map_is_not_unique_hardly_move(shape):
    coords = unit_square(500, "random", 1)
    position = coords.copy()
    if shape == "point":
        coords[:] = 0.5
    elif shape == "line":
        coords[:, 1] = 0.5
    elif shape == "landed together":
        position[:] = 0.5
    else:
        coords = np.zeros((500, 3))
    assert hardly_moves(flat_map(position, 500, coords=coords))


@pytest.mark.parametrize("n", [2000, 20_000])
def test_photons_of_a_pool_of_emitters_hardly_move(n):
    assert hardly_moves(uniform_map(n, "random").replace(emitter_id=np.arange(n) // 20))


@pytest.mark.parametrize("name", ["exponential", "folded"])
@pytest.mark.parametrize(("n_lamps", "each"), [(10, 20), (50, 20), (10, 100), (400, 20)])
def test_small_lamps_are_never_worse_than_unrelaxed(n_lamps, each, name):
    """Lamps whose photons are too few for a map of their own."""
    n, texels = n_lamps * each, 20
    edges = np.linspace(0.0, 1.0, texels + 1)
    below = np.expm1(3.0 * edges) / np.expm1(3.0) if name == "exponential" else np.sqrt(edges)
    exact = np.repeat(np.diff(below) * texels, texels)
    x, y = np.meshgrid(edges[1:] - 0.5 / texels, edges[1:] - 0.5 / texels, indexing="ij")
    points, normals = plane(np.column_stack([x.ravel(), y.ravel()]))
    errors = np.zeros(2)
    for seed in range(4):
        photons = mapped(name, n, "halton", seed).replace(emitter_id=np.arange(n) // each)
        rest = pr.rest_density(photons, n_threads=1)
        assert not rest.has_map.any()
        for i, each_map in enumerate((relaxed(photons, rest), photons)):
            field = pr.irradiance_field(each_map, method="standard", gather=pr.GatherSettings(k=8))
            means = field(points, normals, footprint=np.full(len(points), 1.0 / texels))[:, 0]
            errors[i] += np.abs(means - exact).mean()
    assert errors[0] < errors[1]


def test_moved_photons_stay_on_curved_receivers():
    """Light of a glass ball on the facets of a sphere."""
    receiver = pr.SceneObject(ball(2.0, [0, 0, -2], 5), pr.Diffuse(), smooth=True)
    scene = pr.Scene([receiver, glass_ball()], [DOWN])
    photons = pr.trace_photons(scene, 40_000, seed=1, n_threads=1)
    rest = pr.rest_density(photons, n_threads=1)
    after = relaxed(photons, rest, scene=scene)
    assert (rest.slope != 0.0).any(axis=1).mean() > 0.9
    assert (after.position != photons.position).any(axis=1).mean() > 0.9
    _, distance, _ = trimesh.proximity.closest_point(receiver.mesh, after.position[::50])
    np.testing.assert_allclose(distance, 0.0, atol=1e-9)


@pytest.mark.parametrize("n_threads", [2, 7])
def test_same_bytes_for_every_number_of_threads(n_threads):
    photons = mapped("folded", 20_000, "random")
    rest = pr.rest_density(photons)
    one, many = (relaxed(photons, rest, n_threads=n).position for n in (1, n_threads))
    assert one.tobytes() == many.tobytes()


def test_a_rest_density_of_other_photons_is_refused():
    photons = uniform_map(100, "random")
    fewer = photons.subset(slice(50))
    with pytest.raises(ValueError, match="rest should be of these 50 photons, but is of 100"):
        pr.relax(fewer, pr.detect_structure(fewer), rest=pr.rest_density(photons))
