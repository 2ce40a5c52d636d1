"""Scene data: what is stored, what is computed from it, what is refused."""

import numpy as np
import pytest
import trimesh

import photonrelax as pr
from photonrelax.scene.meshes import nondegenerate_faces


def box(centre=(0.0, 0.0, 0.0), size=1.0, material=None):
    mesh = trimesh.creation.box(extents=[size] * 3)
    mesh.apply_translation(centre)
    return pr.SceneObject(mesh, material or pr.Diffuse())


def scene(*objects):
    return pr.Scene(objects, [pr.PointEmitter((0, 0, 5))])


def test_colours_are_three_read_only_floats():
    albedo = np.array([0.1, 0.2, 0.3])
    diffuse = pr.Diffuse(albedo)
    albedo[:] = 1.0
    np.testing.assert_array_equal(diffuse.albedo, [0.1, 0.2, 0.3])
    np.testing.assert_array_equal(pr.Mirror(0.5).reflectance, [0.5, 0.5, 0.5])
    with pytest.raises(ValueError, match="read-only"):
        diffuse.albedo[0] = 1.0


def test_directions_are_stored_as_unit_vectors():
    np.testing.assert_allclose(pr.CollimatedEmitter((0, 0, -5)).direction, [0, 0, -1])
    np.testing.assert_allclose(pr.LambertianEmitter((0, 0, 0), (3, 0, 4)).direction, [0.6, 0, 0.8])


@pytest.mark.parametrize(
    ("make", "error", "message"),
    [
        (lambda: pr.Diffuse(1.5), ValueError, "albedo"),
        (lambda: pr.Diffuse((1, 1)), ValueError, "albedo"),
        (lambda: pr.Mirror(-0.1), ValueError, "reflectance"),
        (lambda: pr.Dielectric(ior=0.0), ValueError, "ior"),
        (lambda: pr.Dielectric(exterior_ior=np.nan), ValueError, "exterior_ior"),
        (lambda: pr.Dielectric(absorption=(0, 0, -1)), ValueError, "absorption"),
        (lambda: pr.CollimatedEmitter((0, 0, 0)), ValueError, "direction"),
        (lambda: pr.PointEmitter((0, np.inf, 0)), ValueError, "position"),
        (lambda: pr.PointEmitter((0, 0, 0), power=-1), ValueError, "power"),
        (lambda: pr.LambertianEmitter((0, 0), (0, 0, 1)), ValueError, "position"),
        (lambda: pr.SceneObject(trimesh.creation.box(), "glass"), TypeError, "material"),
        (lambda: pr.SceneObject("box", pr.Diffuse()), TypeError, "mesh"),
        (lambda: pr.Scene([], [pr.PointEmitter((0, 0, 0))]), ValueError, "objects"),
        (lambda: pr.Scene([box()], []), ValueError, "emitters"),
        (lambda: pr.Scene([box(), 3], [pr.PointEmitter((0, 0, 0))]), TypeError, r"objects\[1\]"),
        (lambda: pr.Scene([box()], [box()]), TypeError, r"emitters\[0\]"),
        (lambda: pr.Scene(box(), [pr.PointEmitter((0, 0, 0))]), TypeError, "objects"),
        (lambda: pr.Scene([box()], [pr.PointEmitter((0, 0, 0))], "top"), TypeError, "camera"),
        (lambda: scene(box()).bounding_sphere([]), ValueError, "object_ids"),
        (lambda: pr.Camera((0, 0, 0), (0, 0, 0)), ValueError, "target"),
        (lambda: pr.Camera((0, 0, 0), (0, 0, 3)), ValueError, "up"),
        (lambda: pr.Camera((0, 0, 0), (1, 0, 0), vertical_fov=180), ValueError, "vertical_fov"),
        (lambda: pr.Camera((0, 0, 0), (1, 0, 0), width=0), ValueError, "width"),
        (lambda: pr.Camera((0, 0, 0), (1, 0, 0), height=2.5), TypeError, "height"),
        (
            lambda: pr.Camera((0, 0, 0), (1, 0, 0), orthographic_height=0),
            ValueError,
            "orthographic_height",
        ),
    ],
)
def test_what_makes_no_sense_is_refused_by_name(make, error, message):
    with pytest.raises(error, match=message):
        make()


def bad_mesh(vertices, faces):
    return trimesh.Trimesh(vertices, faces, process=False, validate=False)


@pytest.mark.parametrize(
    ("mesh", "message"),
    [
        (lambda: bad_mesh([[0, 0, 0]], np.empty((0, 3), int)), "should have faces"),
        (lambda: bad_mesh([[0, 0, 0], [1, 0, 0], [2, 0, 0]], [[0, 1, 2]]), "with an area"),
        (lambda: bad_mesh([[0, 0, 0], [1, 0, 0], [0, np.nan, 0]], [[0, 1, 2]]), "finite"),
        (lambda: bad_mesh([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 3]]), "indices"),
    ],
)
def test_unusable_meshes_are_refused(mesh, message):
    with pytest.raises(ValueError, match=message):
        pr.SceneObject(mesh(), pr.Diffuse())


@pytest.mark.parametrize("split", [False, True])
@pytest.mark.parametrize("offset", [0.0, 1e5])
def test_a_glass_body_inside_out_is_refused(split, offset):
    mesh = trimesh.creation.icosphere(2)
    mesh.apply_translation([offset] * 3)
    if split:
        mesh.unmerge_vertices()
    pr.SceneObject(mesh, pr.Dielectric())
    mesh.invert()
    with pytest.raises(ValueError, match=r"wind inwards \(volume -4.05\).* mesh.invert"):
        pr.SceneObject(mesh, pr.Dielectric())
    pr.SceneObject(mesh, pr.Mirror())
    # An open surface has no inside, whichever way it bends.
    mesh.update_faces(np.arange(len(mesh.faces)) > 0)
    pr.SceneObject(mesh, pr.Dielectric())


@pytest.mark.parametrize("size", [1e-12, 1.0, 1e12])
def test_faces_without_area_are_left_out_at_any_scale(size):
    vertices = size * np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [2, 0, 0]])
    mesh = bad_mesh(vertices, [[0, 1, 3], [0, 1, 2], [1, 1, 2]])
    ids, faces = nondegenerate_faces(mesh)
    np.testing.assert_array_equal(ids, [1])
    np.testing.assert_array_equal(faces, [[0, 1, 2]])


def test_camera_axes_are_right_up_and_forward():
    right, up, forward = pr.Camera((0, -5, 0), (0, 0, 0)).axes()
    np.testing.assert_allclose(right, [1, 0, 0])
    np.testing.assert_allclose(up, [0, 0, 1])
    np.testing.assert_allclose(forward, [0, 1, 0])


def test_bounding_sphere_and_scale_of_boxes():
    two = scene(box(size=2.0), box(centre=(10, 0, 0), size=2.0))
    centre, radius = two.bounding_sphere([1])
    np.testing.assert_allclose(centre, [10, 0, 0])
    np.testing.assert_allclose(radius, np.sqrt(3))
    centre, radius = two.bounding_sphere()
    np.testing.assert_allclose(centre, [5, 0, 0])
    np.testing.assert_allclose(radius, np.linalg.norm([6, 1, 1]))
    np.testing.assert_allclose(two.scale, np.linalg.norm([12, 2, 2]))


def test_vertices_of_no_face_do_not_count():
    mesh = bad_mesh([[0, 0, 0], [1, 0, 0], [0, 1, 0], [900, 0, 0]], [[0, 1, 2]])
    assert scene(pr.SceneObject(mesh, pr.Diffuse())).scale == pytest.approx(np.sqrt(2))


def test_material_table_and_specular_objects():
    mixed = scene(
        box(material=pr.Diffuse(0.25)),
        box(material=pr.Mirror((0.5, 0.6, 0.7))),
        box(material=pr.Dielectric(1.7, 1.3, (1, 2, 3))),
    )
    table = mixed.material_table()
    assert mixed.specular_objects == (1, 2)
    assert table.kind == ("diffuse", "mirror", "dielectric")
    np.testing.assert_array_equal(
        table.reflectance, [[0.25, 0.25, 0.25], [0.5, 0.6, 0.7], [1, 1, 1]]
    )
    np.testing.assert_array_equal(table.ior, [1, 1, 1.7])
    np.testing.assert_array_equal(table.exterior_ior, [1, 1, 1.3])
    np.testing.assert_array_equal(table.absorption, [[0, 0, 0], [0, 0, 0], [1, 2, 3]])
