"""Unit normals by definition: their length, their groups, the faces near them."""

import numpy as np
import pytest

from photonrelax._ext.photons import normals as normals_kernel
from photonrelax._ext.spatial import blocks
from photonrelax._util import validation


def random_directions(n, seed=0):
    rng = np.random.default_rng(seed)
    return validation.unit_vectors(rng.normal(size=(n, 3)), "directions", (n, 3))


@pytest.mark.parametrize("n_threads", [1, 2, 7])
def test_unit_vectors_are_vectors_by_their_length(n_threads):
    rng = np.random.default_rng(0)
    vectors = rng.normal(size=(30_000, 3)) * 10.0 ** rng.integers(-300, 300, (30_000, 1))
    found = validation.unit_vectors(vectors, "vectors", (None, 3), n_threads)
    largest = vectors / np.abs(vectors).max(axis=1, keepdims=True)
    expected = largest / np.linalg.norm(largest, axis=1, keepdims=True)
    np.testing.assert_array_equal(found, expected)


def test_what_has_no_direction_is_refused():
    vectors = random_directions(20_000)
    vectors[9000] = 0.0
    with pytest.raises(ValueError, match="vectors should hold directions, but vector 9000 is zero"):
        validation.unit_vectors(vectors, "vectors", (None, 3))
    vectors[9000, 1] = np.nan
    with pytest.raises(ValueError, match="vectors should be finite"):
        validation.unit_vectors(vectors, "vectors", (None, 3))


@pytest.mark.parametrize("n_faces", [0, 1, 2, 64])
def test_few_normals_are_numbered_as_they_appear(n_faces):
    normals = random_directions(n_faces)
    faces, face = normals_kernel.group_normals(np.vstack([normals, normals[::-1]]), 64)
    np.testing.assert_array_equal(faces, normals)
    np.testing.assert_array_equal(face, [*range(n_faces), *reversed(range(n_faces))])


def test_roundings_do_not_make_faces():
    normals = random_directions(3).repeat(200, axis=0)
    normals += np.random.default_rng(1).uniform(-4e-16, 4e-16, normals.shape)
    faces, face = normals_kernel.group_normals(normals, 64)
    np.testing.assert_array_equal(faces, normals[::200])
    np.testing.assert_array_equal(face, np.arange(3).repeat(200))


def test_many_normals_are_not_separated():
    assert normals_kernel.group_normals(random_directions(65), 64)[0] is None


def test_normals_are_alike_only_if_all_are_the_same():
    normals = np.repeat(random_directions(2), [50, 1], axis=0)
    assert not normals_kernel.all_nearly_equal(normals, None)
    assert normals_kernel.all_nearly_equal(normals[:50], None)
    assert normals_kernel.all_nearly_equal(normals, np.arange(3, 50))
    assert not normals_kernel.all_nearly_equal(normals, np.arange(3, 51))
    assert normals_kernel.all_nearly_equal(normals[:0], None)
    assert normals_kernel.all_nearly_equal(normals, np.arange(0))


def test_roundings_do_not_make_normals_differ():
    normals = random_directions(1).repeat(3, axis=0)
    normals[1] = np.nextafter(normals[1], 0.0)
    assert normals_kernel.all_nearly_equal(normals, None)
    normals[2, 0] += 1e-14
    assert not normals_kernel.all_nearly_equal(normals, None)


@pytest.mark.parametrize("n_threads", [1, 2, 7])
def test_faces_near_a_normal_are_those_within_the_chord(n_threads):
    """Sets that are known have their number, no faces at all −1, any others come last."""
    faces, normals = random_directions(9, 1), random_directions(20_000)
    near = np.linalg.norm(normals[:, np.newaxis] - faces, axis=2) <= 1.0
    mask = (near << np.arange(9)).sum(axis=1).astype(np.uint64)
    known = np.unique(mask[mask > 0])[::2].copy()
    expected = np.full(len(normals), len(known))
    for number, one in enumerate(known):
        expected[mask == one] = number
    expected[mask == 0] = -1
    found = normals_kernel.find_face_sets(3.0 * normals, faces, known, 1.0, n_threads)
    np.testing.assert_array_equal(found, expected)
    assert {-1, 0, len(known)} <= set(found)


def test_normals_without_a_direction_face_nothing():
    normals = np.array([[0.0, 0, 1], [0, 0, 0], [0, np.nan, 1], [np.inf, 0, 1], [0, 0, -1]])
    found = normals_kernel.find_face_sets(normals, normals[:1], np.ones(1, np.uint64), 1.0, 1)
    np.testing.assert_array_equal(found, [0, -2, -2, -2, -1])


@pytest.mark.parametrize("rows", [None, np.array([4, 0, 4])])
def test_columns_are_copied_side_by_side(rows):
    source = np.arange(10.0).reshape(5, 2)
    expected = source if rows is None else source[rows]
    target = np.zeros((len(expected), 4))
    blocks.copy_scaled_rows(target, 1, source, rows, scale=0.5, n_threads=2)
    np.testing.assert_array_equal(target[:, 1:3], 0.5 * expected)
    assert not target[:, [0, 3]].any()
    with pytest.raises(ValueError, match="columns do not fit the target"):
        blocks.copy_scaled_rows(target, 3, source, rows, scale=0.5, n_threads=2)
    with pytest.raises(ValueError, match="rows do not fit the target"):
        blocks.copy_scaled_rows(target[1:], 0, source, rows, scale=0.5, n_threads=2)


@pytest.mark.parametrize("n", [1, 1024, 5000])
@pytest.mark.parametrize("n_threads", [1, 2, 7])
def test_bounds_are_the_least_and_the_greatest_of_each_axis(n, n_threads):
    points = np.random.default_rng(n).normal(size=(n, 4))
    low, high = blocks.bounds(points, 3, n_threads)
    np.testing.assert_array_equal(low, points[:, :3].min(axis=0))
    np.testing.assert_array_equal(high, points[:, :3].max(axis=0))


def test_no_points_have_no_bounds():
    low, high = blocks.bounds(np.empty((0, 2)), 2, 2)
    assert (low == np.inf).all()
    assert (high == -np.inf).all()
    with pytest.raises(ValueError, match="from 0 to 2"):
        blocks.bounds(np.empty((0, 2)), 3, 1)
