"""Faces of transparent objects in one plane with other faces, as rays meet them."""

import numpy as np
import pytest
import trimesh

import photonrelax as pr
from photonrelax.transport.raycast import RayCaster


def block(low, high, half, material=None):
    mesh = trimesh.creation.box(bounds=[[-half, -half, low], [half, half, high]])
    return pr.SceneObject(mesh, material or pr.Dielectric())


def surfaces(objects):
    """Heights of surfaces below (0.1, 0.2), and the objects they belong to, from above."""
    caster = RayCaster(objects)
    down = np.array([[0.0, 0.0, -1.0]])
    hits = caster.intersect([[0.1, 0.2, 9.0]], down)
    met = []
    while hits.hit[0]:
        met.append((float(hits.position[0, 2]), int(hits.object_id[0])))
        hits = caster.intersect(hits.position, down, origin_offset=hits.offset)
    return zip(*met, strict=True)


@pytest.mark.parametrize("gap", [-1e-9, 0.0, 1e-15, 1e-9, 1e-6])
@pytest.mark.parametrize("lower", [3.0, 1.0])
def test_the_smaller_of_two_bodies_that_touch_reaches_into_the_other(lower, gap):
    """Rounded coordinates leave a gap between bodies, or make them overlap."""
    heights, objects = surfaces([block(0.0, 1.0, lower), block(1.0 + gap, 2.0, 2.0)])
    assert objects == (1, 0, 1, 0)
    np.testing.assert_allclose(heights, [2, 1, 1, 0], atol=1e-3)


@pytest.mark.parametrize("order", [1, -1])
def test_a_body_up_to_the_surface_of_another_is_moved_inside(order):
    pair = [block(0.0, 2.0, 3.0), block(1.0, 2.0, 2.0)]
    heights, objects = surfaces(pair[::order])
    outer, inner = (0, 1) if order == 1 else (1, 0)
    assert objects == (outer, inner, inner, outer)
    np.testing.assert_allclose(heights, [2, 2, 1, 0], atol=1e-3)
    assert heights[2:] == (1.0, 0.0)


def test_bodies_apart_stay_where_they_are():
    heights, _ = surfaces([block(0.0, 2.0, 3.0), block(0.5, 1.5, 2.0), block(2.5, 3.0, 2.0)])
    assert heights == (3.0, 2.5, 2.0, 1.5, 0.5, 0.0)


def test_glass_is_moved_off_planes_of_opaque_faces_but_not_off_parallel_ones():
    table, post = block(-1.0, 0.0, 3.0, pr.Diffuse()), block(0.0, 4.0, 0.05, pr.Diffuse())
    heights, objects = surfaces([table, post, block(0.0, 1.0, 2.0)])
    assert objects == (2, 2, 0, 0)
    assert heights[0] == 1.0
    assert 0.0 < heights[1] < 1e-3
