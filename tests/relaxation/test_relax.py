"""Relaxation: the force by definition, what it keeps, and what it makes even."""

import numpy as np
import pytest
import trimesh

import photonrelax as pr
from tests.helpers.photon_maps import flat_map, uniform_map, unit_square
from tests.helpers.tracing_scenes import scene_of


def relaxed(photons, scene=None, n_threads=None, **settings):
    found = pr.detect_structure(photons, n_threads=n_threads)
    return pr.relax(photons, found, pr.RelaxSettings(**settings), scene=scene, n_threads=n_threads)


def force(photons, i, ids):
    """SJ13 Eq. 8 over the given neighbours, the photon itself and the farthest among them."""
    offsets = photons.position[i] - photons.position[ids]
    distance = np.linalg.norm(offsets, axis=1)
    others = distance > 0
    weight = distance.max() / distance[others] - 1
    return (offsets[others] * weight[:, np.newaxis]).sum(axis=0) / len(ids)


@pytest.mark.parametrize("stage", ["constrained", "collapsed"])
def test_one_iteration_equals_its_definition(stage):
    uv = unit_square(1500, "random", seed=4)
    photons = flat_map(np.column_stack([(2 * uv[:, 0] - 1) ** 2, uv[:, 1]]), 1500, coords=uv)
    found = pr.detect_structure(photons, pr.StructureSettings(reach_scale=np.inf))
    iterations = (1, 0) if stage == "constrained" else (0, 1)
    settings = pr.RelaxSettings(n_iterations=iterations, k=12, step=0.7, largest_step=np.inf)
    moved = pr.relax(photons, found, settings).position
    for i in range(0, 1500, 29):
        gap = np.linalg.norm(photons.emitter_coords - photons.emitter_coords[i], axis=1)
        allowed = (
            np.flatnonzero(gap <= found.emitter_range[i]) if iterations[0] else np.arange(1500)
        )
        distance = np.linalg.norm(photons.position[allowed] - photons.position[i], axis=1)
        f = force(photons, i, allowed[np.argsort(distance)[:12]])
        u, v = found.basis[i]
        constrained = u * (u @ f) + (1 - found.constraint[i]) * v * (v @ f)  # Eq. 9
        np.testing.assert_allclose(
            moved[i], photons.position[i] + 0.7 * constrained, rtol=0, atol=1e-14
        )


def test_neither_flux_nor_input_changes():
    photons = uniform_map(5000, "random")
    before = photons.position.tobytes()
    after = relaxed(photons)
    assert photons.position.tobytes() == before
    assert after.position.tobytes() != before
    assert after.flux.tobytes() == photons.flux.tobytes()
    assert after.well_spaced


@pytest.mark.kernels_run_elsewhere
@pytest.mark.parametrize(
    ("kind", "before", "after"), [("random", 0.32, 0.12), ("halton", 0.08, 0.03)]
)
def test_uniform_light_becomes_even(kind, before, after, interior):
    """Noise at k = 15 falls from 32 % to 12 %, or from 8 % to 3 %; the mean stays true."""
    photons = uniform_map(100_000, kind)
    points, normals = interior
    estimates = [
        pr.estimate_irradiance(m, points, normals)[:, 0] for m in (photons, relaxed(photons))
    ]
    noise = [e.std() / e.mean() for e in estimates]
    assert noise[0] == pytest.approx(before, abs=0.02)
    assert noise[1] <= after
    assert estimates[1].mean() == pytest.approx(1.0, rel=3e-3)


def test_the_constraint_keeps_an_edge():
    """Unconstrained, light flows out of a disc; constrained, by a fraction of photon spacing."""
    xy = unit_square(60_000, "random")
    xy = xy[np.linalg.norm(xy - 0.5, axis=1) < 0.3]
    photons = flat_map(xy, 60_000)
    found = pr.detect_structure(photons)
    free = pr.Structure(**{**vars(found), "constraint": np.zeros(len(photons))})
    spacing = 60_000**-0.5
    outer = [
        np.quantile(np.linalg.norm(m.position[:, :2] - 0.5, axis=1), 0.99)
        for m in (photons, pr.relax(photons, found), pr.relax(photons, free))
    ]
    assert outer[1] - outer[0] < 0.25 * spacing
    assert outer[2] - outer[0] > spacing


def test_strays_cannot_fly_off():
    """A lone pair far from a dense patch: repelled by all of it, but never by leaps."""
    xy = np.concatenate([0.01 * unit_square(500, "random"), [[0.5, 0.5], [0.5, 0.51]]])
    photons = flat_map(xy, 500).replace(emitter_coords=None, emitter_density=None)
    found = pr.detect_structure(photons)
    moved = pr.relax(photons, found, pr.RelaxSettings((0, 50))).position
    travelled = np.linalg.norm(moved - photons.position, axis=1)
    assert travelled.max() <= 50 * 0.1 * found.radius.max()
    assert travelled[:500].max() < 0.05


def test_too_few_in_range_and_coincident_photons_stay():
    three = flat_map(unit_square(3, "random"), 3)
    np.testing.assert_array_equal(relaxed(three).position, three.position)
    coincident = flat_map(np.full((40, 2), 0.25), 40)
    np.testing.assert_array_equal(relaxed(coincident).position, coincident.position)


def test_no_iterations_change_nothing():
    photons = uniform_map(100, "random")
    assert relaxed(photons, n_iterations=(0, 0)) is photons


@pytest.mark.parametrize("n_threads", [2, 7])
def test_same_bytes_for_every_number_of_threads(n_threads):
    photons = uniform_map(20_000, "random")
    one, many = relaxed(photons, n_threads=1), relaxed(photons, n_threads=n_threads)
    assert one.position.tobytes() == many.position.tobytes()


@pytest.mark.parametrize(("scale", "shift"), [(1e-4, 0), (1e4, 0), (1, 1e4)])
def test_neither_unit_nor_origin_matter(scale, shift):
    photons = uniform_map(3000, "random")
    other = photons.replace(position=photons.position * scale + [shift, -shift, shift])
    a, b = relaxed(photons).position, (relaxed(other).position - [shift, -shift, shift]) / scale
    np.testing.assert_allclose(a, b, atol=1e-7)


def test_rotation_turns_the_result_with_it():
    photons = uniform_map(3000, "random")
    rotation = trimesh.transformations.rotation_matrix(0.7, [1, 2, 3])[:3, :3]
    turned = photons.replace(
        position=photons.position @ rotation.T, normal=photons.normal @ rotation.T
    )
    np.testing.assert_allclose(
        relaxed(turned).position, relaxed(photons).position @ rotation.T, atol=1e-6
    )


def on_faces(mesh, n, faces=slice(None), seed=8):
    """Photons scattered evenly over some faces of a mesh, all of object 0."""
    part = mesh.submesh([np.arange(len(mesh.faces))[faces]], append=True)
    position, face = trimesh.sample.sample_surface(part, n, seed=seed)
    normal = part.face_normals[face]
    return pr.PhotonMap(position, normal, np.ones(n) / n, object_id=np.zeros(n, dtype=int))


def square(z=0.0):
    return trimesh.Trimesh([[0, 0, z], [1, 0, z], [1, 1, z], [0, 1, z]], [[0, 1, 2], [0, 2, 3]])


@pytest.mark.parametrize("side", [1, -1])
def test_photons_stay_on_a_curved_surface(side):
    """Outside a sphere, and inside it: every photon on a face, with that face's normal."""
    mesh = trimesh.creation.icosphere(subdivisions=3, radius=2.0)
    scene = scene_of(mesh)
    photons = on_faces(mesh, 4000)
    photons = photons.replace(normal=side * photons.normal)
    after = relaxed(photons, scene)
    moved = np.linalg.norm(after.position - photons.position, axis=1)
    assert (moved > 0.0).mean() > 0.99
    _, distance, _ = trimesh.proximity.closest_point(mesh, after.position)
    assert distance.max() < 1e-6 * scene.scale
    # Facets of a sphere lean from its radius by no more than half their own angle.
    outward = after.position / np.linalg.norm(after.position, axis=1, keepdims=True)
    assert (side * np.einsum("ij,ij->i", after.normal, outward)).min() > np.cos(np.radians(6))
    spacing = [pr.KDTree(m.position).query_self(2).distance[:, 1] for m in (photons, after)]
    assert spacing[1].std() / spacing[1].mean() < 0.5 * spacing[0].std() / spacing[0].mean()


@pytest.mark.parametrize("n", [1, 2, 3, 4, 5, 15, 16, 17, 32, 33])
def test_however_few_photons_are_put_back_on_a_floor_as_if_it_were_not_there(n):
    photons = uniform_map(n, "random").replace(object_id=np.zeros(n, dtype=int))
    floor = square()
    floor.apply_scale(100.0)
    floor.apply_translation([-50.0, -50.0, 0.0])
    found, expected = relaxed(photons, scene_of(floor)), relaxed(photons)
    assert (found.position != photons.position).any() == (n > 3)
    np.testing.assert_allclose(found.position, expected.position, atol=1e-5)
    np.testing.assert_array_equal(found.normal, expected.normal)


@pytest.mark.parametrize("gap", [1e-3, 1e-4])
@pytest.mark.parametrize("same_object", [True, False])
def test_a_sheet_close_above_neither_takes_nor_blocks_photons(gap, same_object):
    floor, above = square(), square(gap)
    both = trimesh.util.concatenate([floor, above])
    scene = scene_of(both) if same_object else scene_of(floor, above)
    photons = uniform_map(4000, "random").replace(object_id=np.zeros(4000, dtype=int))
    after = relaxed(photons, scene).position
    assert (after[:, 2] == 0.0).all()
    assert (after[:, :2] != photons.position[:, :2]).any(axis=1).mean() > 0.95


@pytest.mark.parametrize("opening", [20.0, 60.0, 100.0])
def test_photons_do_not_cross_the_bottom_of_a_groove(opening):
    lean = np.radians(opening / 2)
    up = np.array([0, np.sin(lean), np.cos(lean)])
    vertices = [
        [0, 0, 0],
        [1, 0, 0],
        [1, *up[1:]],
        [0, *up[1:]],
        [1, -up[1], up[2]],
        [0, -up[1], up[2]],
    ]
    groove = trimesh.Trimesh(vertices, [[0, 1, 2], [0, 2, 3], [0, 4, 1], [0, 5, 4]], process=False)
    photons = on_faces(groove, 4000)
    right = photons.position[:, 1] > 0
    photons = photons.replace(
        normal=np.where((photons.normal[:, 2] < 0)[:, None], -photons.normal, photons.normal)
    )
    after = relaxed(photons, scene_of(groove)).position
    beyond = np.where(right, after[:, 1], -after[:, 1])
    assert beyond.min() > -1e-9


def test_both_sides_of_a_plate_are_relaxed_apart(interior):
    """Light on the underside neither moves nor blurs that on top."""
    top, below = uniform_map(20_000, "random", 1), uniform_map(20_000, "random", 2)
    below = below.replace(normal=-below.normal, position=below.position - [0, 0, 1e-4])
    fields = ("position", "normal", "flux")
    bare = [pr.PhotonMap(**{f: getattr(m, f) for f in fields}) for m in (top, below)]
    plate = pr.PhotonMap(**{f: np.concatenate([getattr(m, f) for m in bare]) for f in fields})
    np.testing.assert_array_equal(relaxed(plate).position[:20_000], relaxed(bare[0]).position)


def test_moves_that_leave_the_surface_are_not_made():
    scene = scene_of(square())
    photons = uniform_map(5000, "random").replace(object_id=np.zeros(5000, dtype=int))
    kept, free = relaxed(photons, scene).position, relaxed(photons).position
    assert kept[:, :2].min() >= 0.0
    assert kept[:, :2].max() <= 1.0
    assert (kept[:, 2] == 0.0).all()
    assert free[:, :2].min() < 0.0


def test_emitters_are_relaxed_apart():
    first, second = uniform_map(3000, "random", 1), uniform_map(2000, "random", 2)
    fields = ("position", "normal", "flux", "emitter_coords", "emitter_density")
    both = pr.PhotonMap(
        **{f: np.concatenate([getattr(first, f), getattr(second, f)]) for f in fields},
        emitter_id=np.repeat([0, 1], [3000, 2000]),
    )
    apart = np.concatenate([relaxed(m).position for m in (first, second)])
    np.testing.assert_array_equal(relaxed(both).position, apart)


def test_bad_input_is_refused():
    photons = uniform_map(100, "random")
    found = pr.detect_structure(photons)
    scene = scene_of(trimesh.creation.box())
    with pytest.raises(ValueError, match="structure should be of these 50 photons, but is of 100"):
        pr.relax(photons.subset(slice(50)), found)
    with pytest.raises(ValueError, match="should have an object_id"):
        pr.relax(photons, found, scene=scene)
    with pytest.raises(ValueError, match="object_id should be of the scene's 1 objects"):
        pr.relax(photons.replace(object_id=np.full(100, 7)), found, scene=scene)
    with pytest.raises(ValueError, match="only one of them has emitter coordinates"):
        pr.relax(photons.replace(emitter_coords=None, emitter_density=None), found)


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"n_iterations": (1, 2, 3)}, "n_iterations should be two numbers"),
        ({"n_iterations": 7}, "n_iterations should be two numbers"),
        ({"n_iterations": (-1, 2)}, "n_iterations should be at least 0"),
        ({"k": 2}, "k should be at least 4"),
        ({"step": np.nan}, "step should be"),
        ({"largest_step": 0}, "largest_step should be a positive"),
    ],
)
def test_bad_settings_are_refused(fields, message):
    with pytest.raises(ValueError, match=message):
        pr.RelaxSettings(**fields)
