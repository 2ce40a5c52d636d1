"""Scenes that are saved and read again."""

import json
import struct
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh

import photonrelax as pr
from photonrelax.scene.digest import scene_digest
from photonrelax.scene.materials import Material, MaterialRow

DATA = Path(__file__).parents[2] / "data"
FLOOR = trimesh.creation.box((6.0, 6.0, 0.1))
BALL = trimesh.creation.icosphere(2, 0.5)
TILTED = BALL.vertices + np.array([0.0, 0.0, 0.1 / 3])
TILTED /= np.linalg.norm(TILTED, axis=1, keepdims=True)
LEANING = trimesh.Trimesh(BALL.vertices / 3, BALL.faces, vertex_normals=TILTED, process=False)
FLAT = trimesh.creation.box((1, 1, 0.0))
GLASS = pr.Dielectric(1.5, absorption=(0.1, 0.2, 3.0), priority=2, tint=(0.9, 0.8, 0.7))
FLINT = pr.Sellmeier((1.0, 0.25), (0.006, 0.02))
OBJECTS = [
    pr.SceneObject(FLOOR, pr.Diffuse((0.1, 0.2, 0.3)), "floor"),
    pr.SceneObject(BALL, GLASS, "ball", smooth=30.0),
    pr.SceneObject(LEANING, pr.Mirror((0.9, 0.5, 0.3), schlick=True), "leaning", smooth=True),
    pr.SceneObject(FLAT, pr.Sensor()),
    pr.SceneObject(BALL, pr.Dielectric(FLINT)),
]
EMITTERS = [
    pr.CollimatedEmitter((0.3, 0.1, -1.0), (3.0, 2.0, 1.0), 0.266),
    pr.PointEmitter((1 / 3, 2.0, 3.0), (3.0, 2.0, 1.0)),
    pr.SpotEmitter((1.0, 2.0, 3.0), (0.0, 0.3, -1.0), 7.0, 10.0, 33.0),
    pr.LambertianEmitter((1.0, 2.0, 3.0), (0.0, 0.3, -1.0)),
    pr.AreaEmitter(pr.Disk((0, 0, 4), (0, 0, -1), 0.5), power=(3.0, 2.0, 1.0)),
    pr.AreaEmitter(BALL, radiance=2.0, two_sided=True, material=pr.Diffuse(0.5)),
    pr.EnvironmentEmitter((0.1, 0.2, 0.3)),
]
CAMERA = pr.Camera((0.1, -4.0, 3.0), (0.3, 0.0, 0.2), (0.1, 0.0, 1.0), 40.0, 64, 48)
SCENE = pr.Scene(OBJECTS, EMITTERS, CAMERA, "everything")


@pytest.fixture(scope="module")
def saved(tmp_path_factory):
    path = tmp_path_factory.mktemp("saved") / "everything.glb"
    pr.save_scene(SCENE, path)
    return path


def test_it_is_the_same_scene(saved):
    loaded = pr.load_scene(saved)
    assert scene_digest(loaded) == scene_digest(SCENE)
    assert [item.name for item in loaded.objects] == [item.name for item in SCENE.objects]


@pytest.mark.parametrize(
    ("name", "sizes"),
    [
        ("ring", {}),
        ("prism", {"subdivisions": 3}),
        ("ripples", {"resolution": 32}),
        ("reflector", {}),
    ],
)
def test_built_in_scenes_keep_their_digest(tmp_path, name, sizes):
    scene = pr.gallery.scene(name, **sizes)
    pr.save_scene(scene, tmp_path / "a.glb")
    assert scene_digest(pr.load_scene(tmp_path / "a.glb")) == scene_digest(scene)


@pytest.mark.filterwarnings("ignore:.*in two ways")
def test_files_of_blender_keep_their_digest(tmp_path):
    scene = pr.load_scene(DATA / "sphere_and_ring.glb")
    pr.save_scene(scene, tmp_path / "a.glb")
    assert scene_digest(pr.load_scene(tmp_path / "a.glb")) == scene_digest(scene)


def test_a_scene_without_a_camera_has_none(tmp_path):
    pr.save_scene(replace(SCENE, camera=None), tmp_path / "a.glb")
    assert pr.load_scene(tmp_path / "a.glb").camera is None


def of_other_program(path):
    """The file as if another program had written it: its own terms are all there is."""
    content = path.read_bytes()
    (n,) = struct.unpack_from("<I", content, 12)
    root = json.loads(content[20 : 20 + n])
    root["asset"]["generator"] = "another"
    text = json.dumps(root).encode()
    text += b" " * (-len(text) % 4)
    chunks = struct.pack("<I4s", len(text), b"JSON") + text + content[20 + n :]
    other = path.with_name("other.glb")
    other.write_bytes(struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks)
    return other


@pytest.mark.filterwarnings("ignore:.*holds what a scene cannot")
def test_other_programs_find_what_gltf_can_hold(saved):
    loaded = pr.load_scene(of_other_program(saved))
    floor, ball, leaning, _, flint = loaded.objects
    np.testing.assert_allclose(floor.mesh.bounds, FLOOR.bounds, rtol=1e-6)
    np.testing.assert_allclose(floor.material.albedo, [0.1, 0.2, 0.3])
    for name in ("ior", "absorption", "tint"):
        np.testing.assert_allclose(getattr(ball.material, name), getattr(GLASS, name))
    assert ball.edge_defects == (0, 0)
    assert flint.material.ior.index_d == pytest.approx(FLINT.index_d)
    assert flint.material.ior.abbe_number == pytest.approx(FLINT.abbe_number)
    np.testing.assert_allclose(leaning.material.reflectance, [0.9, 0.5, 0.3])
    normals = leaning.shading_normals
    distance = np.linalg.norm(
        leaning.mesh.vertices[normals.vertex][:, None] - LEANING.vertices, axis=2
    )
    np.testing.assert_allclose(normals.normal, TILTED[distance.argmin(axis=1)], atol=1e-6)
    lamps = loaded.emitters[:2]
    np.testing.assert_allclose(lamps[0].radiance, EMITTERS[4].emitted_radiance)
    np.testing.assert_allclose(lamps[1].radiance, 2.0)
    sun, point, spot = loaded.emitters[2:]
    np.testing.assert_allclose(sun.direction, EMITTERS[0].direction)
    np.testing.assert_allclose(sun.irradiance, EMITTERS[0].irradiance)
    np.testing.assert_allclose(point.power, EMITTERS[1].power)
    np.testing.assert_allclose(spot.power, EMITTERS[2].power)
    np.testing.assert_allclose(spot.direction, EMITTERS[2].direction)
    assert (spot.inner_angle, spot.outer_angle) == pytest.approx((10.0, 33.0))
    np.testing.assert_allclose(loaded.camera.axes(), CAMERA.axes(), atol=1e-12)
    assert loaded.camera.vertical_fov == pytest.approx(40.0)


def test_trimesh_reads_it(saved):
    assert len(trimesh.load_scene(saved).geometry) == 7


class Velvet(Material):
    def row(self):
        return MaterialRow("diffuse")


def test_what_cannot_be_saved_is_refused(tmp_path):
    velvet = pr.Scene([pr.SceneObject(FLOOR, Velvet())], EMITTERS)
    with pytest.raises(TypeError, match="classes of photonrelax, but has a Velvet"):
        pr.save_scene(velvet, tmp_path / "a.glb")
    with pytest.raises(ValueError, match=r"should be named \*\.glb"):
        pr.save_scene(SCENE, tmp_path / "a.stl")
    with pytest.raises(OSError, match="there is no folder"):
        pr.save_scene(SCENE, tmp_path / "nowhere" / "a.glb")
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("old", "new"),
    [
        (b'"class": "Diffuse"', b'"class": "Diffuzz"'),
        (b'"version": 1', b'"version": 9'),
        (b'"shape": [162, 3]', b'"shape": [262, 3]'),
        (b'"ior": 1.5', b'"ior":-1.5'),
        (b'"dtype": "<f8"', b'"dtype": "|O8"'),
    ],
)
def test_damaged_extras_are_errors(saved, tmp_path, old, new):
    content = saved.read_bytes()
    path = tmp_path / "a.glb"
    path.write_bytes(content.replace(old, new))
    assert path.read_bytes() != content
    with pytest.raises(ValueError, match=r"a\.glb"):
        pr.load_scene(path)
