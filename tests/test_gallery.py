"""Built-in scenes: well-formed glass and metal, clear of the floor, seen by their cameras."""

import inspect

import numpy as np
import pytest
import trimesh

import photonrelax as pr
from photonrelax import gallery
from photonrelax.gallery import _shapes

COARSE = {
    "prism": {"subdivisions": 4},
    "ring": {"sections": 64},
    "ripples": {"resolution": 40},
    "sphere": {"subdivisions": 3},
}


@pytest.fixture(params=gallery.names())
def scene(request):
    return gallery.scene(request.param, **COARSE[request.param])


def specular(scene):
    (index,) = scene.specular_objects
    return scene.objects[index]


def test_there_are_four_scenes_each_with_a_line_about_it():
    assert gallery.names() == ("prism", "ring", "ripples", "sphere")
    assert all(gallery.about(name) for name in gallery.names())


def test_an_unknown_scene_is_refused_with_the_known_ones():
    with pytest.raises(ValueError, match="one of prism, ring, ripples, sphere, but is 'teapot'"):
        gallery.scene("teapot")


def test_scene_knows_its_name_and_has_a_camera(scene):
    assert scene.name in gallery.names()
    assert isinstance(scene.camera, pr.Camera)
    assert len(scene.emitters) == 1


def test_every_size_is_an_argument_with_a_default(scene):
    function = getattr(getattr(gallery, scene.name), scene.name)
    parameters = inspect.signature(function).parameters.values()
    assert all(p.kind is p.KEYWORD_ONLY and p.default is not p.empty for p in parameters)


def test_pixels_set_the_size_of_the_picture():
    for name in gallery.names():
        camera = gallery.scene(name, pixels=37, **COARSE[name]).camera
        assert (camera.width, camera.height) == (37, 37)


def test_glass_and_metal_stand_clear_of_the_floor(scene):
    assert specular(scene).mesh.vertices[:, 2].min() >= 0.999e-3


def test_surfaces_are_closed(scene):
    mesh = specular(scene).mesh
    welded = trimesh.Trimesh(mesh.vertices, mesh.faces)
    welded.merge_vertices(merge_norm=True, digits_vertex=9)
    assert welded.is_watertight


def test_faces_wind_outwards_as_the_normals_point(scene):
    mesh = specular(scene).mesh
    assert mesh.volume > 0
    corners = mesh.vertex_normals[mesh.faces]
    assert (np.einsum("fij,fj->fi", corners, mesh.face_normals) > 0).all()
    np.testing.assert_allclose(np.linalg.norm(corners, axis=2), 1.0, rtol=1e-12)


def test_camera_looks_at_the_lit_floor(scene):
    target = scene.camera.target
    assert np.abs(target[:2]).max() < 2.0
    assert scene.camera.origin[2] > target[2]


def test_ring_has_the_volume_of_a_tube():
    mesh = specular(gallery.scene("ring", radius=2.0, thickness=0.5, height=1.5)).mesh
    assert mesh.volume == pytest.approx(np.pi * (2.5**2 - 2.0**2) * 1.5, rel=1e-4)


def test_ring_normals_are_those_of_the_cylinder():
    mesh = specular(gallery.scene("ring", **COARSE["ring"])).mesh
    upright = np.abs(mesh.vertex_normals[:, 2]) < 0.5
    radial = mesh.vertices[upright, :2]
    radial = radial / np.linalg.norm(radial, axis=1, keepdims=True)
    along = (radial * mesh.vertex_normals[upright, :2]).sum(axis=1)
    np.testing.assert_allclose(np.abs(along), 1.0, rtol=1e-12)


def test_sphere_is_a_sphere_at_its_gap():
    mesh = specular(gallery.scene("sphere", radius=0.5, gap=0.3, subdivisions=3)).mesh
    from_centre = mesh.vertices - [0.0, 0.0, 0.8]
    np.testing.assert_allclose(np.linalg.norm(from_centre, axis=1), 0.5, rtol=1e-12)
    np.testing.assert_allclose(mesh.vertex_normals, from_centre / 0.5, atol=1e-12)


def test_ripples_normals_are_those_of_the_waves():
    mesh = specular(gallery.scene("ripples", resolution=200)).mesh
    top = slice(0, 201 * 201)
    by_faces = _shapes.make_mesh(mesh.vertices[top], mesh.faces[: 2 * 200 * 200]).vertex_normals
    inner = np.arange(201 * 201).reshape(201, 201)[1:-1, 1:-1].ravel()
    np.testing.assert_allclose(mesh.vertex_normals[inner], by_faces[inner], atol=2e-3)


def test_ripples_refuses_waves_deeper_than_the_slab():
    with pytest.raises(ValueError, match="amplitude should be less than thickness"):
        gallery.scene("ripples", amplitude=0.5)


def test_prism_has_about_the_volume_of_a_triangular_prism():
    mesh = specular(gallery.scene("prism", inradius=0.4, height=1.4, bevel=0.004)).mesh
    assert mesh.volume == pytest.approx(3 * np.sqrt(3) * 0.4**2 * 1.4, rel=0.02)


def test_level_set_finds_the_surface_and_its_normals():
    half_axes = np.array([1.0, 2.0, 0.5])

    def ellipsoid(points):
        scaled = points / half_axes
        return (scaled**2).sum(axis=1) - 1.0, 2 * scaled / half_axes

    mesh = _shapes.level_set(ellipsoid, 3 * np.ones(3), 3)
    np.testing.assert_allclose(ellipsoid(mesh.vertices)[0], 0.0, atol=1e-12)
    expected = mesh.vertices / half_axes**2
    expected = expected / np.linalg.norm(expected, axis=1, keepdims=True)
    np.testing.assert_allclose(mesh.vertex_normals, expected, atol=1e-12)
