"""Samples of pixels that share one estimate."""

from dataclasses import replace

import numpy as np
import pytest
from photonrelax._ext.transport.samples import add_by_pixel, merge_samples

import photonrelax as pr
from photonrelax.transport.hit_points import trace_hit_points
from photonrelax.transport.raycast import RayCaster
from tests.transport.test_hit_points import DOWN, box, plane, sphere

CAMERA = pr.Camera((0, 0, 9), (0, 0, 0), (0, 1, 0), width=8, height=6, orthographic_height=3)


def seen(objects, camera=CAMERA, supersampling=3, **options):
    scene = pr.Scene(objects, [DOWN])
    caster = RayCaster(scene.objects)
    return trace_hit_points(
        *(scene, caster, camera, range(camera.height)), supersampling=supersampling, **options
    )[0]


def merged(hits, side=3):
    return merge_samples(hits, side, tolerance=0.25, least_cosine=0.95)


def test_a_pixel_of_one_surface_is_one_piece_of_its_size():
    hits = seen([plane()])
    position, normal, footprint, of_hit = merged(hits)
    np.testing.assert_array_equal(of_hit, hits.pixel)
    pixels = seen([plane()], supersampling=1)
    np.testing.assert_allclose(position, pixels.position, atol=1e-12)
    np.testing.assert_allclose(normal, pixels.normal, atol=1e-12)
    np.testing.assert_allclose(footprint, pixels.footprint, atol=1e-12)


def test_samples_of_pixels_that_see_several_surfaces_stay_alone():
    """On both sides of an edge, of a crease, and where only some samples see anything."""
    step = box((-0.1, -9, 0), (9, 9, 0.2), pr.Diffuse())
    half = plane(half=0.9)
    for objects in ([plane(), step], [half]):
        hits = seen(objects)
        position, _, footprint, of_hit = merged(hits)
        n = np.bincount(of_hit)
        assert set(n) == {1, 9}
        one = np.flatnonzero(n == 1)
        alone = np.flatnonzero(np.isin(of_hit, one))
        np.testing.assert_array_equal(position[of_hit[alone]], hits.position[alone])
        np.testing.assert_array_equal(footprint[of_hit[alone]], hits.footprint[alone])
        for piece in np.flatnonzero(n == 9):
            own = hits.position[of_hit == piece]
            assert np.ptp(own[:, 2]) == 0.0


def test_samples_of_other_levels_are_of_other_pieces():
    """As where a pixel is the last that sees a mirror, and the first of what is behind."""
    hits = seen([plane()])
    of_one = replace(hits, n_specular=np.arange(len(hits), dtype=np.int32) // 3)
    np.testing.assert_array_equal(merged(of_one)[3], np.arange(len(hits)))


def test_pieces_cover_what_their_samples_cover():
    hits = seen([plane(), sphere(pr.Dielectric(), subdivisions=3)])
    _, _, footprint, of_hit = merged(hits)
    area = np.linalg.norm(np.cross(hits.footprint[:, 0], hits.footprint[:, 1]), axis=1)
    whole = np.linalg.norm(np.cross(footprint[:, 0], footprint[:, 1]), axis=1)
    pieces = np.bincount(of_hit, area)
    np.testing.assert_allclose(whole, pieces, rtol=0.1, atol=1e-12)
    assert (np.bincount(of_hit) == 9).mean() > 0.1


def test_single_samples_are_left_as_they_are():
    hits = seen([plane()], supersampling=1)
    position, normal, footprint, of_hit = merged(hits, side=1)
    np.testing.assert_array_equal(of_hit, np.arange(len(hits)))
    for one, name in ((position, "position"), (normal, "normal"), (footprint, "footprint")):
        np.testing.assert_array_equal(one, getattr(hits, name))


def test_no_hit_points_have_no_pieces():
    hits = seen([plane()], replace(CAMERA, target=(0, 0, 20)))
    assert len(hits) == 0
    assert [len(column) for column in merged(hits)] == [0, 0, 0, 0]


@pytest.mark.parametrize("name", ["object_id", "position", "normal", "footprint"])
def test_columns_have_to_fit(name):
    hits = seen([plane()])
    with pytest.raises(ValueError, match="do not fit one another"):
        merged(replace(hits, **{name: getattr(hits, name)[1:]}))


@pytest.mark.parametrize("shared", [False, True])
@pytest.mark.parametrize("n_factors", [0, 1, 4])
def test_sums_over_pixels_have_the_bits_of_those_of_numpy(shared, n_factors):
    rng = np.random.default_rng(0)
    pixel = rng.integers(0, 6, 100)
    values = rng.random((30 if shared else 100, 4))
    of_hit = rng.integers(0, 30, 100) if shared else None
    weight = rng.random((100, n_factors)) if n_factors else None
    sums = np.zeros((6, 4))
    add_by_pixel(sums, pixel, values, of_hit, weight)
    each = values[of_hit] if shared else values
    each = each if weight is None else weight * each
    expected = [np.bincount(pixel, column, minlength=6) for column in each.T]
    np.testing.assert_array_equal(sums, np.transpose(expected))


def test_one_value_is_shared_by_the_channels_of_its_weight():
    sums = np.zeros((1, 3))
    add_by_pixel(sums, np.zeros(1, np.int64), [[2.0]], None, np.array([[1.0, 2.0, 3.0]]))
    np.testing.assert_array_equal(sums, [[2.0, 4.0, 6.0]])


@pytest.mark.parametrize(("pixel", "of_hit"), [(4, 0), (-1, 0), (0, 2), (0, -1)])
def test_sums_refuse_pixels_and_values_that_are_not_there(pixel, of_hit):
    with pytest.raises(ValueError, match="4 pixels and 2 values"):
        add_by_pixel(
            *(np.zeros((4, 3)), np.array([pixel]), np.ones((2, 3)), np.array([of_hit]), None),
        )
