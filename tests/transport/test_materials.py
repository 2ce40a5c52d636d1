"""Materials as kernels read them: kinds, interfaces, media."""

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
    table = MaterialTable(("velvet",), *(np.ones(shape) for shape in ((1, 3), 1, 1, (1, 3))))
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
