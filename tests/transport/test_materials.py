"""Materials as kernels read them: kinds, interfaces, media."""

from dataclasses import replace

import numpy as np
import pytest
from photonrelax._ext.transport.materials import Materials

from photonrelax.scene.materials import Dielectric, Diffuse, MaterialTable, Mirror
from photonrelax.transport.optics import fresnel
from photonrelax.transport.raycast import empty_intersections

MATERIALS = [Diffuse(0.5), Mirror(0.9), Dielectric(1.5, 1.2, (1, 2, 3))]
FLOOR, MIRROR, GLASS = range(3)
DOWN, UP = [0.0, 0.0, -1.0], [0.0, 0.0, 1.0]


@pytest.fixture
def materials():
    return Materials(MaterialTable.of(MATERIALS))


def hits_on(*objects, shading=UP):
    hits = empty_intersections(len(objects))
    hits.object_id[:] = objects
    hits.geometric_normal[:] = UP
    hits.shading_normal[:] = shading
    return hits


def test_only_diffuse_objects_receive_light(materials):
    np.testing.assert_array_equal(materials.diffuse, [True, False, False])


def test_an_unknown_kind_is_refused():
    table = replace(MaterialTable.of([Diffuse()]), kind=("velvet",))
    with pytest.raises(KeyError, match="velvet"):
        Materials(table)


def interfaces(materials, direction, hits, media=0):
    return materials.interfaces(direction, hits, np.full(len(direction), media, np.uint64))


def test_indices_depend_on_the_side_of_the_ray_and_mirrors_have_none(materials):
    direction = np.array([DOWN, UP, DOWN, UP])
    at = interfaces(materials, direction, hits_on(GLASS, GLASS, MIRROR, 1))
    np.testing.assert_array_equal(at.normal, -direction)
    assert at.is_shading.all()
    np.testing.assert_array_equal(at.n1, [1.2, 1.5, 1, 1])
    np.testing.assert_array_equal(at.n2, [1.5, 1.2, 1, 1])


def test_shading_normals_serve_unless_they_lead_through_the_face(materials):
    lean = np.array([np.sin(0.5), 0.0, np.cos(0.5)])
    direction = np.array([DOWN, [np.cos(0.3), 0.0, -np.sin(0.3)]])
    # The second ray comes from behind the leaning normal.
    at = interfaces(materials, direction, hits_on(MIRROR, 1, shading=lean))
    np.testing.assert_array_equal(at.is_shading, [True, False])
    np.testing.assert_array_equal(at.normal, [lean, UP])


def test_dielectrics_reflect_by_fresnel_and_mirrors_reflect_all(materials):
    direction = np.array([[np.sin(0.3), 0.0, -np.cos(0.3)], UP, DOWN])
    at = interfaces(materials, direction, hits_on(GLASS, GLASS, MIRROR))
    cosine = np.array([np.cos(0.3), 1.0])
    np.testing.assert_array_equal(at.reflected[:2], fresnel(cosine, [1.2, 1.5], [1.5, 1.2]))
    assert at.reflected[2] == 1.0


def test_the_reflectance_of_a_schlick_mirror_rises_to_1():
    metals = Materials(MaterialTable.of([Mirror((0.9, 0.4, 0.0), schlick=True), Mirror(0.9)]))
    angle = np.radians([0.0, 60.0, 90.0])
    direction = np.column_stack([np.sin(angle), 0 * angle, -np.cos(angle)])
    metal = interfaces(metals, direction, hits_on(0, 0, 0)).rising
    expected = [[r + (1.0 - r) * x**5 for r in (0.9, 0.4, 0.0)] for x in (0.0, 0.5, 1.0)]
    np.testing.assert_allclose(metal, expected, atol=1e-15)
    # Of others nothing changes along a path, and nothing needs to be known.
    np.testing.assert_array_equal(interfaces(metals, direction, hits_on(1, 1, 1)).rising, 1.0)


# Bodies of indices 1.1, 1.2, 1.3 and 1.4, and one with an index outside of its own.
BODIES = [Dielectric(1.0 + 0.1 * i, absorption=i) for i in (1, 2, 3, 4)]
BODIES.append(Dielectric(1.5, exterior_ior=1.05, absorption=5))
IORS = np.array([1.0, 1.1, 1.2, 1.3, 1.4, 1.5])


def stack(*bodies):
    """Media of a ray that entered bodies 1, 2, ... in this order."""
    return sum(body << 8 * i for i, body in enumerate(reversed(bodies)))


# Media before, body met, whether from inside: media beyond, and which rule on both sides.
CROSSINGS = {
    "enter from nowhere": ([], 1, DOWN, [1], 0, 1),
    "enter another": ([1], 2, DOWN, [1, 2], 1, 2),
    "leave the last": ([1, 2], 2, UP, [1], 2, 1),
    "leave the only one": ([1], 1, UP, [], 1, 0),
    "leave one further down: nothing changes": ([1, 2, 3], 1, UP, [2, 3], 3, 3),
    "leave one in the middle": ([1, 2, 3], 2, UP, [1, 3], 3, 3),
    "enter again what was not seen to end": ([1, 2], 1, DOWN, [2, 1], 2, 1),
    "enter one beyond eight": ([1, 2, 3, 4] * 2, 5, DOWN, [2, 3, 4, 1, 2, 3, 4, 5], None, None),
}


@pytest.mark.parametrize("name", CROSSINGS)
def test_a_surface_separates_the_media_that_rule_on_its_sides(name):
    before, body, direction, beyond, here, there = CROSSINGS[name]
    materials = Materials(MaterialTable.of(BODIES))
    at = interfaces(materials, np.array([direction]), hits_on(body - 1), stack(*before))
    assert int(at.beyond[0]) == stack(*beyond)
    if here is not None:
        assert (at.n1[0], at.n2[0]) == (IORS[here], IORS[there])
        assert (at.reflected[0] == 0.0) == (here == there)


# Media before, body met, whether from inside: media beyond, and which rule on both sides; bodies 1
# and 2 have priority 0, 3 has 1, and 4 has -1.
RANKED = {
    "enter one that rules": ([1, 2], 3, DOWN, [1, 2, 3], 2, 3),
    "enter one that is ruled": ([1, 3], 2, DOWN, [1, 2, 3], 3, 3),
    "enter one below all others": ([1, 2, 3], 4, DOWN, [4, 1, 2, 3], 3, 3),
    "enter one of equal rank": ([4, 1, 3], 2, DOWN, [4, 1, 2, 3], 3, 3),
    "leave the one that rules": ([4, 1, 3], 3, UP, [4, 1], 3, 1),
    "leave one that is ruled": ([4, 1, 3], 4, UP, [1, 3], 3, 3),
    "one too many: the least is lost": ([4] + [1] * 6 + [3], 2, DOWN, [1] * 6 + [2, 3], 3, 3),
    "one too many: itself the least": ([1, 2] * 3 + [1, 3], 4, DOWN, [1, 2] * 3 + [1, 3], 3, 3),
}


@pytest.mark.parametrize("name", RANKED)
def test_the_largest_priority_rules_and_ties_go_to_the_last_entered(name):
    before, body, direction, beyond, here, there = RANKED[name]
    bodies = [
        replace(each, priority=priority)
        for each, priority in zip(BODIES[:4], (0, 0, 1, -1), strict=True)
    ]
    materials = Materials(MaterialTable.of(bodies))
    at = interfaces(materials, np.array([direction]), hits_on(body - 1), stack(*before))
    assert int(at.beyond[0]) == stack(*beyond)
    assert (at.n1[0], at.n2[0]) == (IORS[here], IORS[there])
    # Where nothing that rules changes the surface is not there, and the ray is taken on.
    media = np.array([stack(*before)], dtype=np.uint64)
    passed = materials.pass_hidden(np.array([direction]), hits_on(body - 1), media)
    assert len(passed) == (here == there)
    assert int(media[0]) == stack(*(beyond if here == there else before))


def test_an_index_outside_of_its_own_holds_whatever_is_around():
    materials = Materials(MaterialTable.of(BODIES))
    at = interfaces(
        materials, np.array([DOWN, UP, UP]), hits_on(4, 4, 4), np.array(stack(1), np.uint64)
    )
    np.testing.assert_array_equal(at.n1, [1.05, 1.5, 1.5])
    np.testing.assert_array_equal(at.n2, [1.5, 1.05, 1.05])


def arrive(materials, direction, hits, *media):
    hits.distance[:] = 2.0
    return materials.arrive(np.array(direction), hits, np.array(media, dtype=np.uint64))


def test_rays_that_meet_a_body_from_behind_were_inside_it():
    materials = Materials(MaterialTable.of([*BODIES[:4], Mirror()]))
    hits = hits_on(0, 0, 0, 4, 1)
    media, transmitted = arrive(
        materials,
        [UP, UP, DOWN, UP, DOWN],
        hits,
        *(stack(), stack(2), stack(2), stack(2), stack(1)),
    )
    np.testing.assert_array_equal(media, [stack(1), stack(2, 1), stack(2), stack(2), stack(1)])
    np.testing.assert_allclose(transmitted[:, 0], np.exp([-2.0, -2.0, -4.0, -4.0, -2.0]))


def test_the_body_that_was_entered_last_absorbs():
    materials = Materials(MaterialTable.of(BODIES))
    _, transmitted = arrive(
        materials, [DOWN] * 3, hits_on(0, 0, 0), stack(2, 3), stack(3, 2), stack()
    )
    np.testing.assert_allclose(transmitted[:, 1], np.exp([-6.0, -4.0, 0.0]))


def test_arrays_have_a_row_for_each_ray():
    materials = Materials(MaterialTable.of(BODIES))
    for call in (materials.arrive, materials.interfaces):
        with pytest.raises(ValueError, match="do not fit one another"):
            call(np.array([DOWN]), hits_on(0, 0), np.zeros(2, np.uint64))
