"""Irradiance of images of the emitter, against closed forms, photons and brute force."""

import itertools
from dataclasses import replace

import numpy as np
import pytest
import trimesh

import photonrelax as pr
from photonrelax import gallery
from photonrelax._ext.estimation import envelope as kernel
from photonrelax._ext.estimation import envelope_grid, envelope_pieces
from photonrelax.estimation.envelope import elements, tracing
from photonrelax.estimation.envelope import field as envelope_field
from photonrelax.estimation.envelope.grids import Footprints
from photonrelax.estimation.irradiance_map import texel_grid
from photonrelax.transport import splitting
from tests.helpers.tracing_scenes import DOWN, box, floor, slab

LIMITS = {"thickness": 1.0, "least_cosine": 0.5}
NORMAL, LIGHT = np.array([0.0, -0.96, -0.28]), np.array([0.0, 0.6, -0.8])


def mirrored(reflectance=0.7):
    """A small flat mirror, with light from above that it throws onto the floor."""
    plate = box([0.5, 0.5, 0.02])
    plate.apply_transform(trimesh.geometry.align_vectors([0, 0, 1], NORMAL))
    plate.apply_translation([0, 0, 1.5])
    light = pr.CollimatedEmitter(LIGHT, (1.0, 2.0, 3.0))
    return pr.Scene([floor(20.0), pr.SceneObject(plate, pr.Mirror(reflectance))], [light])


def floor_map(field, half=1.0, n=50, centre=(0.0, 0.0)):
    corner = (centre[0] - half, centre[1] - half, 0.0)
    return pr.irradiance_map(field, corner, (2 * half, 0, 0), (0, 2 * half, 0), (n, n))


def field_of(scene, **limits):
    envelope = pr.trace_envelope(scene, n_threads=1, **limits)
    return pr.irradiance_field(envelope, method="envelope", n_threads=1)


def test_light_behind_a_flat_mirror_is_even():
    """E = reflectance · E₀ cos θ to rounding, wherever a texel is wholly lit."""
    field = field_of(mirrored(), error=0.05)
    image = LIGHT - 2 * (LIGHT @ NORMAL) * NORMAL
    centre = 1.5 * image[:2] / -image[2]
    found = floor_map(field, 0.05, 10, centre)
    expected = 0.7 * -image[2] * np.array([1.0, 2.0, 3.0])
    np.testing.assert_allclose(found, np.broadcast_to(expected, found.shape), rtol=1e-9)


def test_light_through_a_plate_is_even_but_for_faint_orders():
    """(1 - R)² of the light directly; by two reflections, R² of that by photons."""
    field = field_of(pr.Scene([floor(), slab()], [DOWN]), error=0.005)
    found = floor_map(field, 1.5)
    assert found.min() >= 0.96**2 * (1 - 1e-9)
    assert found.mean() == pytest.approx(0.96 / 1.04, abs=3e-4)


@pytest.fixture(scope="module")
def bent():
    """Field of the images of a bent mirror, all of whose light is of one sheet."""
    field = field_of(gallery.scene("reflector", resolution=128), error=0.05)
    assert field.rest is None
    return field


def test_a_map_holds_all_light_that_falls_on_it(bent):
    half, n = 12.0, 40
    held = floor_map(bent, half, n).sum(axis=(0, 1)) * (2 * half / n) ** 2
    np.testing.assert_allclose(held, bent.envelope.flux.sum(axis=0), rtol=1e-9)


def test_texels_part_the_light_between_them(bent):
    fine, coarse = (floor_map(bent, 1.5, n) for n in (60, 20))
    means = fine.reshape(20, 3, 20, 3, 3).mean(axis=(1, 3))
    np.testing.assert_allclose(means, coarse, rtol=1e-9, atol=1e-12 * coarse.max())


@pytest.mark.parametrize("per_texel", [0, 1000])
def test_maps_are_means_over_footprints_that_are_texels(bent, monkeypatch, per_texel):
    """Of some rows, by going through the triangles and by searching their tree."""
    monkeypatch.setattr(envelope_field, "_PER_TEXEL", per_texel)
    grid, rows = texel_grid((-1, -1, 0), (2, 0, 0), (0, 2, 0), (30, 20)), range(7, 12)
    centres = grid.centres(rows)
    normals, footprint = np.tile(grid.normal, (150, 1)), np.tile(grid.edges, (150, 1, 1))
    expected = bent(centres, normals, footprint=footprint)
    found = bent.over_texels(grid, rows)
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-12 * expected.max())


def test_error_falls_with_rays_and_is_told():
    scene = gallery.scene("reflector", resolution=1024)
    exact = floor_map(field_of(scene, n_rays=150_000, footprint=0.03), 1.5, 100)
    errors, told = [], []
    for n_rays in (8000, 24_000):
        field = field_of(scene, n_rays=n_rays, footprint=0.03)
        found = floor_map(field, 1.5, 100)
        errors.append(np.abs(found - exact).sum() / exact.sum())
        told.append(field.envelope.error)
        assert field.envelope.n_rays <= n_rays
    assert errors[1] < 0.6 * errors[0]
    assert errors[1] < 0.01
    assert all(error < 2.0 * estimate for error, estimate in zip(errors, told, strict=True))


@pytest.mark.kernels_run_elsewhere
@pytest.mark.parametrize(("n_threads", "batch"), [(2, 8192), (7, 1000)])
def test_threads_and_batches_do_not_matter(monkeypatch, n_threads, batch):
    scene = gallery.scene("sphere", subdivisions=3)
    one = pr.trace_envelope(scene, error=0.1, n_threads=1)
    monkeypatch.setattr(splitting, "_BATCH", batch)
    many = pr.trace_envelope(scene, error=0.1, n_threads=n_threads)
    for name in ("position", "normal", "flux", "misplaced"):
        assert getattr(one, name).tobytes() == getattr(many, name).tobytes()


def test_points_are_means_over_squares_of_the_footprint():
    field = field_of(mirrored(), error=0.05, footprint=0.02)
    points = field.envelope.position.mean(axis=1)[::40]
    normals = np.tile([0.0, 0.0, 2.0], (len(points), 1))
    sides = np.full(len(points), 0.02)
    np.testing.assert_array_equal(field(points, normals), field(points, normals, footprint=sides))
    assert (field(points, -normals) == 0.0).all()


def test_overlap_is_that_of_polygons():
    """Against sums over a fine grid of points, on a plane that is aslant."""
    rng = np.random.default_rng(3)
    turned = trimesh.transformations.rotation_matrix(0.7, [1, 2, 3])[:3, :3]
    flat = np.concatenate([rng.uniform(-1, 1, (12, 3, 2)), np.zeros((12, 3, 1))], axis=2)
    edges = np.array([[0.9, 0.1, 0.0], [-0.2, 0.7, 0.0]])
    normal = np.tile(turned @ [0, 0, 1], (12, 1))
    out = np.empty((1, 12))
    tree = pr_tree(flat @ turned.T)
    normals, sums = kernel.node_normals(tree, normal), kernel.node_sums(tree, np.eye(12))
    kernel.means(
        *(tree, flat @ turned.T, normals, sums, np.zeros((1, 3)), normal[:1].copy()),
        *((edges @ turned.T)[np.newaxis], np.arange(1)),
        **LIMITS,
        out=out,
        n_threads=1,
    )
    n = 400
    side = (np.arange(n) + 0.5) / n - 0.5
    grid = np.array(list(itertools.product(side, side))) @ edges[:, :2]
    for triangle, share in zip(flat[..., :2], out[0], strict=True):
        inside = np.ones(len(grid), dtype=bool)
        a, b, c = triangle
        area = cross(b - a, c - a)
        for p, q in ((a, b), (b, c), (c, a)):
            inside &= np.sign(area) * cross(q - p, grid - p) >= 0.0
        assert share == pytest.approx(inside.mean() / (abs(area) / 2), abs=0.02)


def test_a_large_footprint_holds_the_light_within():
    """Of nodes of the tree as a whole, as well as of triangles alone; not of surfaces aslant."""
    rng = np.random.default_rng(5)
    triangles = rng.uniform(-1, 1, (500, 1, 3)) * [1, 1, 0.01] + rng.normal(0, 0.01, (500, 3, 3))
    normals = np.where(rng.random((500, 1)) < 0.1, [[1.0, 0, 0]], [[0, 0, 1.0]])
    values, out = rng.random((500, 2)), np.empty((1, 2))
    tree = pr_tree(triangles)
    kernel.means(
        *(tree, triangles, kernel.node_normals(tree, normals), kernel.node_sums(tree, values)),
        *(np.zeros((1, 3)), np.array([[0, 0, 1.0]]), np.array([[[4.0, 0, 0], [0, 4.0, 0]]])),
        np.arange(1),
        **LIMITS,
        out=out,
        n_threads=1,
    )
    np.testing.assert_allclose(out[0], values[normals[:, 2] == 1.0].sum(axis=0) / 16, rtol=1e-12)


def scattered_triangles(rng):
    """Of all sizes, some of them lines and points, some aslant or off the plane z = 0."""
    size = 10.0 ** rng.uniform(-3, 1, (1500, 1, 1))
    triangles = rng.uniform(-6, 6, (1500, 1, 3)) * [1, 1, 0] + size * rng.normal(0, 1, (1500, 3, 3))
    triangles[..., 2] *= 0.1
    triangles[:100, 2] = triangles[:100, :2].mean(axis=1)
    triangles[100:150] = np.round(triangles[100:150, :1])
    normals = np.where(rng.random((1500, 1)) < 0.1, [[1.0, 0, 0]], [[0, 0, 1.0]])
    return triangles, normals


def test_texels_of_a_grid_are_as_footprints_one_by_one():
    """Of a slanted grid, by going through the triangles and by searching their tree."""
    rng = np.random.default_rng(7)
    triangles, normals = scattered_triangles(rng)
    values = rng.random((1500, 3))
    edges = np.array([[0.21, 0.02, 0.0], [-0.07, 0.17, 0.0]])
    column, row = (each.ravel() for each in np.meshgrid(np.arange(31), np.arange(23)))
    centres = np.column_stack([column - 15, row - 11, np.zeros(len(row))])
    centres[:, :2] = centres[:, :2] @ edges[:, :2]
    facing, sides = np.tile([0.0, 0.0, 1.0], (len(row), 1)), np.tile(edges, (len(row), 1, 1))
    footprints = Footprints(centres, facing, sides, rng.permutation(len(row)))
    tree, one_by_one = pr_tree(triangles), np.empty((len(row), 3))
    kernel.means(
        *(tree, triangles, kernel.node_normals(tree, normals), kernel.node_sums(tree, values)),
        *footprints,
        **LIMITS,
        out=one_by_one,
        n_threads=1,
    )
    grid = footprints.grid
    assert grid.shape == (31, 23)
    at_once = [np.empty((23, 31, 3)) for _ in range(3)]
    for n_threads, out in zip((1, 2, 7), at_once, strict=True):
        envelope_grid.sums(
            *(triangles, normals, values),
            **{"origin": grid.origin, "edges": grid.edges, "towards": grid.normal, **LIMITS},
            out=out,
            n_threads=n_threads,
        )
    means = at_once[0][grid.row, grid.column] / grid.area
    np.testing.assert_allclose(means, one_by_one, rtol=0, atol=1e-12 * one_by_one.max())
    assert len({out.tobytes() for out in at_once}) == 1


@pytest.mark.parametrize(
    "change",
    [
        lambda centres, normals, edges: centres.__setitem__((3, 2), 1e-3),
        lambda centres, normals, edges: centres.__setitem__((3, 0), centres[3, 0] + 1e-3),
        lambda centres, normals, edges: normals.__setitem__((3, 2), -1.0),
        lambda centres, normals, edges: edges.__setitem__((3, 0, 0), 0.5),
    ],
)
def test_footprints_that_are_not_of_one_grid_are_known(change):
    centres = np.column_stack([*(each.ravel() for each in np.mgrid[:4, :4]), np.zeros(16)])
    normals, edges = np.tile([0.0, 0.0, 1.0], (16, 1)), np.tile(np.eye(3)[:2], (16, 1, 1))
    footprints = Footprints(centres, normals, edges, np.arange(16))
    assert footprints.grid is not None
    change(centres, normals, edges)
    assert footprints.grid is None


@pytest.mark.parametrize("parts", [1, 2, 5, envelope_pieces.MOST])
def test_pieces_of_a_quadratic_image_lie_on_it(parts):
    """Corners of n² pieces, and fluxes that sum to the mean over the middles of the sides."""
    rng = np.random.default_rng(parts)
    six = np.array([[0, 0], [1, 0], [0, 1], [0.5, 0.5], [0, 0.5], [0.5, 0]])

    def image(at):
        return np.column_stack([at[:, 0] + 0.2 * at[:, 1] ** 2, at[:, 1], at[:, 0] * at[:, 1]])

    light = 1.0 + rng.random((1, 6, 3))
    found = np.empty((parts**2, 3, 3)), np.empty((parts**2, 3)), np.empty((parts**2, 3, 2), "f4")
    envelope_pieces.pieces(
        *(image(six)[np.newaxis], light, six[np.newaxis], np.array([parts]), np.array([0])),
        **dict(zip(("corners", "flux", "places"), found, strict=True)),
        n_threads=1,
    )
    corners, flux, places = found
    np.testing.assert_allclose(corners.reshape(-1, 3), image(places.reshape(-1, 2)), atol=1e-6)
    area = 0.5 * np.abs(cross(places[:, 1] - places[:, 0], places[:, 2] - places[:, 0]))
    np.testing.assert_allclose(area, 0.5 / parts**2, rtol=1e-5)
    assert len(np.unique(places.mean(axis=1).round(6), axis=0)) == parts**2
    np.testing.assert_allclose(flux.sum(axis=0), light[0, 3:].mean(axis=0), rtol=1e-12)


def cross(a, b):
    return a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]


def pr_tree(triangles):
    from photonrelax.spatial.box_tree import BoxTree

    return BoxTree(triangles.min(axis=1), triangles.max(axis=1)).kernel


@pytest.mark.kernels_run_elsewhere
def test_pictures_have_the_error_as_a_layer():
    scene = gallery.scene("ring")
    scene = replace(scene, camera=replace(scene.camera, width=24, height=24))
    image = pr.render(scene, method="envelope", envelope=pr.EnvelopeSettings(error=0.05))
    assert (image.layers["caustic"] > 0.0).any()
    assert not image.layers["envelope.photons"].all()
    ledger = {name: np.array(flux) for name, flux in image.stats["ledger"].items()}
    emitted = ledger.pop("emitted")
    np.testing.assert_allclose(sum(ledger.values()), emitted, rtol=1e-9)
    error = image.layers["envelope.error"]
    assert ((error >= 0.0) & (error <= 1.0)).all()
    assert error.max() > 0.0
    again = pr.render(scene, method="parameterised", n_emitted=200_000)
    means = [each.layers["caustic"].mean() for each in (image, again)]
    assert means[0] == pytest.approx(means[1], rel=0.02)


def test_sheets_that_stay_rough_are_left_to_photons(monkeypatch):
    """As much light, where borders would take more rays than they may."""
    monkeypatch.setattr(tracing, "_MOST_OF_BORDERS", 2000)
    scene = gallery.scene("prism", subdivisions=3)
    ledger = pr.trace_envelope(scene, error=0.01, footprint=0.05, n_photons=50_000).ledger
    photons = pr.trace_photons(scene, 50_000).flux.sum(axis=0)
    np.testing.assert_allclose(ledger.images + ledger.points + ledger.photons, photons, rtol=0.05)
    assert (ledger.photons > ledger.images).all()


def test_sheets_that_take_most_rays_of_borders_are_given_up_for_the_others(monkeypatch):
    """Without that, all light of facets is of photons where rays of borders are used up."""
    monkeypatch.setattr(tracing, "_MOST_OF_BORDERS", 40_000)
    scene = gallery.scene("prism", subdivisions=4)
    given = {"error": 0.1, "footprint": 0.05, "n_photons": 50_000}
    ledger = pr.trace_envelope(scene, **given).ledger
    monkeypatch.setattr(tracing, "_OTHERS", 0.0)
    others = pr.trace_envelope(scene, **given).ledger
    assert (ledger.photons < 0.5 * ledger.images).all()
    assert (others.photons > others.images).all()
    stored = [each.images + each.points + each.photons for each in (ledger, others)]
    np.testing.assert_allclose(*stored, rtol=0.02)


def test_the_final_gather_reads_photons_of_the_envelope():
    """Light that a wall takes from a caustic, as of traced photons but for noise."""
    scene = mirrored()
    wall = pr.SceneObject(box([2.0, 0.1, 2.0], (0.0, 1.2, 1.0)), pr.Diffuse(0.7))
    camera = pr.Camera((1.5, -2.5, 1.5), (0.0, 0.3, 0.3), vertical_fov=50.0, width=16, height=16)
    scene = pr.Scene([*scene.objects, wall], scene.emitters, camera)
    limits = {"n_emitted": 20_000, "final_gather": 32}
    settings = pr.EnvelopeSettings(error=0.1)
    images = (
        pr.render(scene, method="envelope", envelope=settings, **limits),
        pr.render(scene, **limits),
    )
    found, expected = (image.layers["indirect"].mean() for image in images)
    assert found == pytest.approx(expected, rel=0.3)


def test_light_of_emitters_with_a_size_is_of_photons():
    """A sun beside parallel light of the same direction: no images, and as much light."""
    scene = mirrored()
    sun = pr.CollimatedEmitter(LIGHT, (1.0, 2.0, 3.0), angular_radius=3.0)
    both = pr.Scene(scene.objects, [*scene.emitters, sun])
    limits = {"error": 0.05, "footprint": 0.005, "n_photons": 60_000}
    one, two = (field_of(each, **limits) for each in (scene, both))
    ledger = two.envelope.ledger
    np.testing.assert_allclose(ledger.images, one.envelope.ledger.images, rtol=1e-9)
    np.testing.assert_allclose(ledger.photons, ledger.images, rtol=0.05)
    light = [floor_map(each, 1.5).sum() for each in (one, two)]
    assert light[1] == pytest.approx(2.0 * light[0], rel=0.03)
    np.testing.assert_array_equal(two.layers["envelope.photons"].sum(), len(two.envelope.rest))


def test_a_small_sun_is_several_parallel_lights():
    """The flux of one, and its edges as blurred as those of photons."""
    scene = mirrored()
    sun = pr.CollimatedEmitter(LIGHT, (1.0, 2.0, 3.0), angular_radius=1.0)
    sunny = pr.Scene(scene.objects, [sun])
    field = field_of(sunny, error=0.01, footprint=0.06)
    assert 4 <= len(field.envelope.charts) <= 64
    assert field.rest is None
    parallel = field_of(scene, error=0.05)
    np.testing.assert_allclose(field.flux.sum(axis=0), parallel.flux.sum(axis=0), rtol=5e-3)
    photons = pr.irradiance_field(pr.trace_photons(sunny, 200_000), scene=sunny)
    fields = photons, field, parallel
    exact, found, hard = (floor_map(each, 0.45, 30, (0.0, -0.1)) for each in fields)
    error, difference = (np.abs(each - exact).sum() / exact.sum() for each in (found, hard))
    assert error < 0.05
    assert error < 0.6 * difference


@pytest.mark.kernels_run_elsewhere
@pytest.mark.parametrize(
    ("name", "parameters"),
    [("ring", {}), ("sphere", {"subdivisions": 4}), ("ripples", {"resolution": 128})],
)
def test_flux_is_that_of_photons(name, parameters):
    """Of images, points and photons together; with what is lost, all that is emitted."""
    scene = gallery.scene(name, **parameters)
    ledger = pr.trace_envelope(scene, n_rays=25_000, footprint=0.02).ledger
    stored = ledger.images + ledger.points + ledger.photons
    np.testing.assert_allclose(stored + ledger.lost, ledger.emitted, rtol=1e-9)
    photons = pr.trace_photons(scene, 200_000)
    np.testing.assert_allclose(stored, photons.flux.sum(axis=0), rtol=3e-3)


def test_tips_of_sheets_between_nodes_are_found_by_first_rays():
    """The horns of the light inside of a ring; and faint sheets, which no photon is emitted for."""
    scene = gallery.scene("ring")
    photons = pr.trace_photons(scene, 100_000).flux.sum(axis=0)
    envelope = pr.trace_envelope(scene, error=0.05, footprint=0.05)
    ledger = envelope.ledger
    assert envelope.rest is None
    assert (ledger.points > 2e-3 * photons).all()
    np.testing.assert_allclose(ledger.images + ledger.points, photons, rtol=2e-3)


def test_places_in_elements_are_in_one_of_four_parts():
    """Of an element that is no right triangle; the part's own weights are not negative."""
    corners = np.array([[0, 0], [64, 16], [16, 48]])
    weights = np.random.default_rng(2).dirichlet(np.ones(3), 200)
    found = elements.parts_at(np.tile(corners, (200, 1, 1)), weights @ corners)
    six = elements.six_places(corners[np.newaxis])[0]
    parts = six[elements.PARTS[found]]
    for (a, b, c), at in zip(parts, weights @ corners, strict=True):
        sides = np.array([cross(q - p, at - p) for p, q in ((a, b), (b, c), (c, a))])
        assert (sides * np.sign(cross(b - a, c - a)) >= -1e-9).all()


@pytest.mark.parametrize("n", [1, 10, 20_000])
def test_photons_of_an_envelope_have_all_its_light(bent, n):
    photons = bent.envelope.photons(n)
    assert len(photons) == n
    np.testing.assert_allclose(photons.flux.sum(axis=0), bent.flux.sum(axis=0), rtol=1e-12)
    np.testing.assert_allclose(photons.flux, np.broadcast_to(photons.flux[0], (n, 3)), rtol=1e-9)


def test_photons_of_an_envelope_are_where_their_coordinates_lead(bent):
    """Traced photons of the same coordinates lie at the same places."""
    photons = bent.envelope.photons(20_000)
    traced = pr.trace_photons(gallery.scene("reflector", resolution=128), 20_000)
    assert set(photons.path_signature) <= set(traced.path_signature)
    for axis in range(2):
        # Both coordinates are along the same axes, from other origins.
        spread = [np.ptp(each.emitter_coords[:, axis]) for each in (photons, traced)]
        assert spread[0] == pytest.approx(spread[1], rel=0.02)
    density = np.median(photons.emitter_density * photons.flux[:, 0])
    assert density == pytest.approx(np.median(traced.emitter_density * traced.flux[:, 0]), rel=0.06)


def test_photons_of_an_envelope_are_well_spaced_and_relax(bent):
    """A map of relaxed photons is near the envelope's own, as one of traced photons is."""
    photons = bent.envelope.photons(40_000)
    traced = pr.trace_photons(gallery.scene("reflector", resolution=128), 40_000)
    exact = floor_map(bent, 2.0, 40)
    errors = [
        np.abs(floor_map(pr.irradiance_field(each), 2.0, 40) - exact).sum() / exact.sum()
        for each in (photons, traced.subset(slice(0, len(photons))))
    ]
    assert errors[0] < 0.06
    assert errors[0] < 1.2 * errors[1]


def test_a_scene_without_caustics_is_refused():
    scene = mirrored()
    away = pr.CollimatedEmitter([0, 0, 1])
    with pytest.raises(ValueError, match="should arrive on a Diffuse surface"):
        pr.trace_envelope(pr.Scene(scene.objects, [away]))


@pytest.mark.parametrize(
    "limits", [{"n_rays": 0}, {"error": -1.0}, {"seconds": 0.0}, {"footprint": np.nan}]
)
def test_limits_out_of_range_are_refused(limits):
    with pytest.raises(ValueError, match=f"EnvelopeSettings.{next(iter(limits))}"):
        pr.trace_envelope(mirrored(), **limits)


def test_photons_and_envelopes_are_told_apart():
    scene = mirrored()
    envelope = pr.trace_envelope(scene, error=0.1)
    with pytest.raises(TypeError, match="should be a PhotonMap, but is Envelope"):
        pr.irradiance_field(envelope)
    photons = pr.trace_photons(scene, 1000)
    with pytest.raises(TypeError, match="should be an Envelope"):
        pr.irradiance_field(photons, method="envelope")
