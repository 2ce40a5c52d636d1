"""Built-in scenes: well-formed glass and metal, clear of the floor, seen by their cameras."""

import inspect
from dataclasses import replace

import numpy as np
import pytest
import trimesh

import photonrelax as pr
from photonrelax import gallery
from photonrelax.gallery import meshes
from tests.analytic.glass_sphere import GlassSphere
from tests.analytic.metal_ring import MetalRing

COARSE = {
    "box": {"subdivisions": 3},
    "cognac": {"sections": 64, "rings": 48},
    "cylinder": {"sections": 64},
    "ellipsoid": {"subdivisions": 4},
    "lamp": {},
    "lights": {"subdivisions": 3},
    "pool": {"resolution": 48},
    "prism": {"subdivisions": 4},
    "reflector": {"resolution": 128},
    "ring": {"sections": 64},
    "rings": {"sections": 64},
    "ripples": {"resolution": 40},
    "spectrum": {},
    "sphere": {"subdivisions": 3},
    "toruses": {"sections": 64},
}
# Scenes whose light goes on beyond the picture, or is not of caustics in the main.
WIDE = ("box", "pool")


@pytest.fixture(params=gallery.names())
def scene(request):
    return gallery.scene(request.param, **COARSE[request.param])


def casters(scene):
    return [scene.objects[index] for index in scene.specular_objects]


def specular(scene):
    (caster,) = casters(scene)
    return caster


def test_every_scene_has_a_line_about_it():
    assert set(gallery.names()) == set(COARSE)
    assert all(gallery.about(name) for name in gallery.names())


def test_an_unknown_scene_is_refused_with_the_known_ones():
    with pytest.raises(ValueError, match=r"one of .*, ring, ripples, .*, but is 'teapot'"):
        gallery.scene("teapot")


def test_scene_knows_its_name_and_has_a_camera(scene):
    assert scene.name in gallery.names()
    assert isinstance(scene.camera, pr.Camera)


def test_every_size_is_an_argument_with_a_default(scene):
    function = getattr(getattr(gallery, scene.name), scene.name)
    parameters = inspect.signature(function).parameters.values()
    assert all(p.kind is p.KEYWORD_ONLY and p.default is not p.empty for p in parameters)


@pytest.mark.parametrize("name", ["ring", "sphere", "ripples"])
def test_measured_scenes_have_surroundings_if_asked_for(name):
    assert len(gallery.scene(name, **COARSE[name]).emitters) == 1
    _, around = gallery.scene(name, **COARSE[name], surroundings=(0.1, 0.2, 0.3)).emitters
    np.testing.assert_array_equal(around.radiance, [0.1, 0.2, 0.3])


def test_pixels_set_the_size_of_the_image():
    for name in gallery.names():
        camera = gallery.scene(name, pixels=37, **COARSE[name]).camera
        assert (camera.width, camera.height) == (37, 37)


def test_glass_and_metal_stand_clear_of_the_floor(scene):
    # But water, which its basin overlaps.
    for item in casters(scene):
        assert item.mesh.vertices[:, 2].min() >= 0.999e-3 or item.name == "water"


def test_surfaces_are_closed(scene):
    # But the reflector of a lamp, which light comes out of.
    for item in casters(scene):
        mesh = trimesh.Trimesh(item.mesh.vertices, item.mesh.faces)
        mesh.merge_vertices(merge_norm=True, digits_vertex=9)
        assert mesh.is_watertight or (scene.name, item.name) == ("lamp", "reflector")


def test_faces_wind_outwards_as_the_normals_point(scene):
    for item in casters(scene):
        mesh = item.mesh
        assert mesh.volume > 0 or (scene.name, item.name) == ("lamp", "reflector")
        shading = item.shading_normals
        if item.smooth is True:
            corners = shading.normal[shading.faces]
            assert (np.einsum("fij,fj->fi", corners, mesh.face_normals) > 0).all()
            np.testing.assert_allclose(np.linalg.norm(corners, axis=2), 1.0, rtol=1e-12)


def caustic_seen(scene, photons, turned=0.0):
    """Return the caustic a camera sees whose target is moved by as many distances to its right."""
    away = scene.camera.target - scene.camera.origin
    target = scene.camera.target + turned * np.cross(away, scene.camera.up)
    camera = replace(scene.camera, target=target, width=24, height=24)
    image = pr.render(
        replace(scene, camera=camera),
        photons=photons,
        method="standard",
        supersampling=1,
        n_global=0,
    )
    return image.layers["caustic"].mean(axis=2)


def test_camera_looks_at_the_caustic(scene):
    photons = pr.trace_photons(scene, 20_000)
    seen = caustic_seen(scene, photons)
    assert (seen > 0).mean() > 0.4
    if scene.name in WIDE:
        return
    assert seen[6:18, 6:18].sum() > 0.25 * seen.sum()
    for turned in (-1.0, 1.0):
        assert caustic_seen(scene, photons, turned).sum() < 0.5 * seen.sum()


def test_thumbnails_have_all_light(scene):
    small = replace(scene, camera=replace(scene.camera, width=16, height=16))
    image = pr.render(small, n_emitted=3000, n_global=3000, method="standard", supersampling=1)
    means = {name: layer.mean() for name, layer in image.layers.items() if name != "Z"}
    assert np.isfinite(image.layers["radiance"]).all()
    assert 0.01 < means["radiance"] < 1.5
    assert means["caustic"] > 0.0
    # The shield of the lamp and the screen of the prism let no direct light by.
    assert (means["direct"] > 0.0) != (scene.name in ("lamp", "prism"))


def test_a_pool_is_moved_by_time():
    still, later = (
        gallery.scene("pool", time=time, **COARSE["pool"]).objects[-1].mesh for time in (0.0, 0.1)
    )
    moved = np.abs(later.vertices - still.vertices)
    assert moved[:, :2].max() == 0.0
    assert 0.0 < moved[:, 2].max() < 0.1
    assert (still.faces == later.faces).all()


def test_waves_of_a_pool_obey_the_dispersion_of_water():
    # h(t + dt) - 2 h(t) + h(t - dt) is -ω² dt² h for a single wave, whose number k the slope gives.
    dt, depth = 1e-3, 0.6
    one = {"waves": 1, "depth": depth, **COARSE["pool"]}
    surfaces = [gallery.scene("pool", time=t, **one).objects[-1].mesh for t in (-dt, 0.0, dt)]
    n = (COARSE["pool"]["resolution"] + 1) ** 2
    before, now, after = (mesh.vertices[:n, 2] for mesh in surfaces)
    squared = -np.dot(before - 2 * now + after, now) / np.dot(now, now) / dt**2
    normal = surfaces[1].vertex_normals[:n]
    steepness = np.square(normal[:, :2] / normal[:, 2:]).sum(axis=1).mean()
    k = np.sqrt(steepness / np.square(now).mean())
    expected = (9.81 * k + 7.28e-5 * k**3) * np.tanh(k * depth)
    assert squared == pytest.approx(expected, rel=0.1)


def test_toruses_are_linked_and_apart():
    glass, metal = casters(gallery.scene("toruses", **COARSE["toruses"]))
    metal_ring = trimesh.Trimesh(metal.mesh.vertices, metal.mesh.faces)
    distance = trimesh.proximity.ProximityQuery(metal_ring).vertex(glass.mesh.vertices)[0]
    assert distance.min() > 0.01


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
    by_faces = meshes.make_mesh(mesh.vertices[top], mesh.faces[: 2 * 200 * 200]).vertex_normals
    inner = np.arange(201 * 201).reshape(201, 201)[1:-1, 1:-1].ravel()
    np.testing.assert_allclose(mesh.vertex_normals[inner], by_faces[inner], atol=2e-3)


def test_ripples_refuses_waves_deeper_than_the_slab():
    with pytest.raises(ValueError, match="amplitude should be less than thickness"):
        gallery.scene("ripples", amplitude=0.5)


def test_prism_has_about_the_volume_of_a_triangular_prism():
    sizes = {"inradius": 0.4, "height": 1.4, "bevel": 0.004, "subdivisions": 5}
    mesh = specular(gallery.scene("prism", **sizes)).mesh
    assert mesh.volume == pytest.approx(3 * np.sqrt(3) * 0.4**2 * 1.4, rel=0.02)


def test_level_set_finds_the_surface_and_its_normals():
    half_axes = np.array([1.0, 2.0, 0.5])

    def ellipsoid(points):
        scaled = points / half_axes
        return (scaled**2).sum(axis=1) - 1.0, 2 * scaled / half_axes

    mesh = meshes.level_set(ellipsoid, 3 * np.ones(3), 3)
    np.testing.assert_allclose(ellipsoid(mesh.vertices)[0], 0.0, atol=1e-12)
    expected = mesh.vertices / half_axes**2
    expected = expected / np.linalg.norm(expected, axis=1, keepdims=True)
    np.testing.assert_allclose(mesh.vertex_normals, expected, atol=1e-12)


ORDERS = range(-1, 12)


@pytest.fixture(scope="module")
def sphere_photons():
    return pr.trace_photons(gallery.scene("sphere", irradiance=3.0, subdivisions=6), 500_000)


def test_sphere_flux_agrees_with_quadrature(sphere_photons):
    near = np.linalg.norm(sphere_photons.position[:, :2], axis=1) < 10.0
    expected = GlassSphere(gap=0.2, irradiance=3.0).total_flux(within=10.0, orders=ORDERS)
    assert sphere_photons.flux[near, 0].sum() == pytest.approx(expected, rel=3e-3)


def test_sphere_profile_agrees_with_quadrature(sphere_photons):
    edges = np.linspace(0.15, 0.75, 5)
    distance = np.linalg.norm(sphere_photons.position[:, :2], axis=1)
    flux = np.histogram(distance, edges, weights=sphere_photons.flux[:, 0])[0]
    reference = GlassSphere(gap=0.2, irradiance=3.0)
    expected = reference.annulus_irradiance(edges, orders=ORDERS)
    np.testing.assert_allclose(flux / (np.pi * np.diff(edges**2)), expected, rtol=0.03)


def test_estimated_sphere_profile_agrees_with_quadrature(sphere_photons):
    distance, turn = np.linspace(0.15, 0.45, 5), np.linspace(0, 2 * np.pi, 400, endpoint=False)
    points = np.multiply.outer(distance, np.column_stack([np.cos(turn), np.sin(turn), 0 * turn]))
    # Farther out a circle crosses too few photons for its mean to be known to 3 %.
    irradiance = pr.estimate_irradiance(
        sphere_photons, points.reshape(-1, 3), np.tile([0.0, 0.0, 1.0], (5 * 400, 1))
    )
    reference = GlassSphere(gap=0.2, irradiance=3.0)
    expected = reference.irradiance_at(distance, orders=ORDERS)
    means = irradiance[:, 0].reshape(5, 400).mean(axis=1)
    np.testing.assert_allclose(means, expected, rtol=0.03)


def test_ring_agrees_with_the_analytic_reflection_map():
    scene = gallery.scene(
        "ring", height=0.4, gap=1e-3, elevation=30.0, irradiance=2.0, reflectance=0.9
    )
    photons = pr.trace_photons(scene, 500_000)
    edges = np.linspace(-1, 1, 41)
    counted = np.histogram2d(*photons.position[:, :2].T, (edges, edges), weights=photons.flux[:, 0])
    irradiance = counted[0] / (edges[1] - edges[0]) ** 2
    expected = MetalRing(
        height=0.4, gap=1e-3, elevation=np.radians(30), irradiance=2.0, reflectance=0.9
    ).pixel_irradiance(edges, 1_000_000)
    farther = np.maximum(np.abs(edges[:-1]), np.abs(edges[1:]))
    inside = np.hypot(*np.meshgrid(farther, farther)) < 1.0
    difference = np.abs(irradiance - expected)[inside].sum()
    assert difference < 0.02 * expected[inside].sum()
    assert irradiance[inside].sum() == pytest.approx(expected[inside].sum(), rel=3e-3)
