"""Files of Blender, number by number: `tests/data/README.md`."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import photonrelax as pr

DATA = Path(__file__).parents[2] / "data"
pytestmark = pytest.mark.filterwarnings("ignore:.*can be read in two ways")
MODES = {"standard": "spec", "compat": "compat", "raw": "raw"}


def turned_x(degrees, vector):
    angle = np.radians(degrees)
    x, y, z = vector
    cos, sin = np.cos(angle), np.sin(angle)
    return np.array([x, cos * y - sin * z, sin * y + cos * z])


def turned_z(degrees, vector):
    angle = np.radians(degrees)
    x, y, z = vector
    cos, sin = np.cos(angle), np.sin(angle)
    return np.array([cos * x - sin * y, sin * x + cos * y, z])


def close(value, expected, atol=1e-6):
    np.testing.assert_allclose(value, expected, rtol=1e-6, atol=atol)


def spot_power(watts, outer=20.0, blend=0.2):
    """Power of a spot into its cone, by an integral of the falloff over 4π of `watts`."""
    inner = np.radians(outer * (1.0 - blend))
    angle = (np.arange(200_000) + 0.5) / 200_000 * np.radians(outer)
    edge = np.cos(np.radians(outer))
    falloff = np.clip((np.cos(angle) - edge) / (np.cos(inner) - edge), 0.0, 1.0) ** 2
    share = (falloff * np.sin(angle)).sum() * np.radians(outer) / 200_000 / 2.0
    return watts * share


@pytest.fixture(scope="module")
def sphere_and_ring():
    return pr.load_scene(DATA / "sphere_and_ring.glb")


def test_objects_of_sphere_and_ring(sphere_and_ring):
    floor, sphere, ring = sphere_and_ring.objects
    assert [item.name for item in sphere_and_ring.objects] == ["Floor", "Sphere", "Ring"]
    close(floor.mesh.bounds, [[-4, -4, 0], [4, 4, 0]])
    close(floor.material.albedo, [0.7, 0.65, 0.6])
    assert floor.smooth is False
    close(np.linalg.norm(sphere.mesh.vertices - [-0.9, 0, 0.7], axis=1), 0.5)
    assert sphere.material.ior == pytest.approx(1.45)
    close(sphere.material.tint, np.sqrt([0.8, 0.95, 1.0]))
    assert sphere.edge_defects == (0, 0)
    assert sphere.smooth is True
    axis = ring.mesh.vertices - [1.0, 0.0, 0.2]
    close(np.hypot(axis[:, 0], axis[:, 1]), 0.6)
    close(np.abs(axis[:, 2]), 0.2)
    close(ring.material.reflectance, [0.95, 0.8, 0.45])
    assert ring.material.schlick


def test_lights_of_sphere_and_ring(sphere_and_ring):
    sun, bulb, spot = sphere_and_ring.emitters
    close(sun.direction, turned_z(30.0, turned_x(40.0, (0.0, 0.0, -1.0))))
    close(sun.irradiance, [3.0, 3.0, 3.0])
    close(bulb.position, [-2.0, -1.5, 2.5])
    close(bulb.power, 150.0 * np.array([1.0, 0.85, 0.7]))
    close(spot.position, [2.5, -1.0, 3.0])
    assert (spot.inner_angle, spot.outer_angle) == pytest.approx((16.0, 20.0))
    close(spot.power, spot_power(300.0) * np.array([0.7, 0.85, 1.0]))


def test_camera_of_sphere_and_ring(sphere_and_ring):
    camera = sphere_and_ring.camera
    close(camera.origin, [0.0, -5.0, 3.2])
    sight = np.array([0.0, 5.0, -2.9])
    close(np.subtract(camera.target, camera.origin), sight / np.linalg.norm(sight))
    assert np.radians(camera.vertical_fov) == pytest.approx(0.563198, rel=1e-5)
    assert camera.width / camera.height == pytest.approx(16 / 9, abs=1e-3)


def test_smooth_normals_are_those_of_the_sphere(sphere_and_ring):
    item = sphere_and_ring.objects[1]
    normals = item.shading_normals
    radial = (item.mesh.vertices[normals.vertex] - [-0.9, 0.0, 0.7]) / 0.5
    assert (normals.normal * radial).sum(axis=1).min() > np.cos(np.radians(0.5))


def test_amber_holder():
    with pytest.warns(UserWarning, match="holds what a scene cannot") as warned:
        scene = pr.load_scene(DATA / "amber_holder.glb")
    table = str(warned[0].message)
    assert "Frosted  glass of roughness 0.4" in table
    assert "Ground   gloss of roughness 0.6" in table
    drop = next(item for item in scene.objects if item.name == "Amber drop")
    assert drop.material.ior == pytest.approx(1.55)
    assert drop.edge_defects == (0, 0)
    middle = (drop.mesh.vertices.min(axis=0) + drop.mesh.vertices.max(axis=0)) / 2
    close(middle, [0.0, 0.0, 0.8], atol=1e-5)
    # Half axes of the ellipsoid.
    spread = np.linalg.svd(drop.mesh.vertices - middle, full_matrices=False)[1]
    assert spread[0] / spread[2] == pytest.approx(1.5, rel=0.01)
    assert spread[1] / spread[2] == pytest.approx(1.0, rel=0.01)
    distance = np.linalg.norm(drop.mesh.vertices - middle, axis=1)
    assert (distance.min(), distance.max()) == pytest.approx((0.4, 0.6), rel=0.01)
    (sun,) = scene.emitters
    close(sun.irradiance, 2.0)
    close(sun.direction, turned_x(25.0, (0.0, 0.0, -1.0)))
    # 50 mm with Blender's sensor, 36 mm wide.
    width = np.tan(np.radians(scene.camera.vertical_fov / 2)) * 16 / 9
    assert width == pytest.approx(18.0 / 50.0, rel=1e-4)
    with pytest.raises(ValueError, match=r"Frosted: glass of roughness 0\.4"):
        pr.load_scene(DATA / "amber_holder.glb", strict=True)


@pytest.fixture(scope="module", params=MODES)
def in_mode(request):
    return pr.load_scene(DATA / f"scene_{MODES[request.param]}.glb", light_units=request.param)


def test_lights_are_the_same_in_every_mode(in_mode):
    sun, point, spot = in_mode.emitters
    close(sun.irradiance, 2.0)
    close(sun.direction, np.array([-3.0, 2.0, -4.0]) / np.sqrt(29.0))
    close(point.position, [-2.0, 1.5, 2.0])
    close(point.power, 60.0 * np.array([1.0, 0.9, 0.8]))
    close(spot.position, [0.9, 2.5, 2.0])
    aim = np.array([0.0, -2.5, -1.8])
    close(spot.direction, aim / np.linalg.norm(aim))
    close(spot.power, spot_power(80.0))


def test_objects_are_the_same_in_every_mode(in_mode):
    floor, ball, ring = in_mode.objects
    close(floor.material.albedo, 0.8)
    close(np.linalg.norm(ball.mesh.vertices - [-0.7, 0.0, 0.55], axis=1), 0.5)
    assert ball.material.ior == pytest.approx(1.45)
    assert np.ptp(ring.mesh.vertices[:, 2]) == pytest.approx(0.5)
    close(ring.mesh.bounds.mean(axis=0), [0.9, 0.0, 0.251])


def test_the_three_modes_give_equal_images():
    images = [
        rendered(pr.load_scene(DATA / f"scene_{name}.glb", light_units=units))
        for units, name in MODES.items()
    ]
    for image in images[1:]:
        np.testing.assert_allclose(image, images[0], rtol=1e-5, atol=1e-9)


def rendered(scene):
    camera = replace(scene.camera, width=24, height=24)
    image = pr.render(replace(scene, camera=camera), n_emitted=5000, n_global=0)
    return image.layers["radiance"]


def test_the_open_floor_has_the_radiance_of_cycles():
    scene = pr.load_scene(DATA / "scene_spec.glb")
    camera = pr.Camera((-3, -3, 2), (-3, -3, 0), (0, 1, 0), 5.0, 4, 4)
    open_floor = pr.Scene(scene.objects, scene.emitters[:1], camera)
    radiance = pr.render(open_floor, components=("direct",)).layers["radiance"]
    np.testing.assert_allclose(radiance, 0.37861, rtol=5e-3)
