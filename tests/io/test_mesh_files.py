"""STL, PLY and OBJ files, and others that trimesh reads."""

import struct

import numpy as np
import pytest
import trimesh

import photonrelax as pr
from photonrelax import cli
from tests.helpers.stl import stl_bytes

BALL = trimesh.creation.icosphere(2, 0.5)
OBJ = """
mtllib stuff.mtl
o Lens
v 0 0 0
v 1 0 0
v 1 1 0
v 0 1 0
v 0 0 1
usemtl Glass
f 1 4 3 2
f 1 2 5
f 2 3 5
f 3 4 5
f -2 -5 -1
o Plate
vn 0 0 1
usemtl Metal
f 1//1 2//1 \\
  3//1
usemtl Lamp
f 2 3 4
usemtl Paint
f 1 2 4
"""
MTL = """
newmtl Glass
illum 7
Ni 1.6
Tf 0.25 0.81 1
newmtl Metal
illum 3
Ks 0.9 0.8 0.7
newmtl Lamp
Kd 0.1 0.1 0.1
Ke 3 2 1
newmtl Paint
Kd 0.1 0.2 0.3
Ks 0.5 0.5 0.5
map_Kd paint.png
d 0.5
"""


def loaded(path, **arguments):
    return pr.load_scene(path, arguments=arguments)


def same_triangles(mesh, expected, atol=1e-7):
    np.testing.assert_allclose(
        mesh.vertices[mesh.faces], expected.vertices[expected.faces], atol=atol
    )


@pytest.mark.parametrize("kind", ["stl", "stl_ascii", "ply", "obj", "off"])
def test_meshes_of_every_format_are_closed_glass(tmp_path, kind):
    path = tmp_path / f"ball.{kind.removesuffix('_ascii')}"
    content = stl_bytes(BALL) if kind == "stl" else BALL.export(file_type=kind)
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    ball, screen = loaded(path).objects
    same_triangles(ball.mesh, BALL)
    assert ball.edge_defects == (0, 0)
    assert isinstance(ball.material, pr.Dielectric)
    assert screen.name == "screen"
    radial = ball.mesh.vertices[ball.shading_normals.vertex] / 0.5
    assert np.einsum("ij,ij->i", ball.shading_normals.normal, radial).min() > 0.999


def test_normals_of_ply_files_are_kept_and_turned(tmp_path):
    leaning = BALL.vertices + np.array([0.0, 0.0, 0.2])
    leaning /= np.linalg.norm(leaning, axis=1, keepdims=True)
    mesh = trimesh.Trimesh(BALL.vertices, BALL.faces, vertex_normals=leaning, process=False)
    path = tmp_path / "ball.ply"
    path.write_bytes(mesh.export(file_type="ply", vertex_normal=True))
    (ball, _) = loaded(path, rotate=(90, 0, 0)).objects
    turned = leaning[:, [0, 2, 1]] * [1, -1, 1]
    np.testing.assert_allclose(ball.shading_normals.normal, turned, atol=1e-6)


def test_a_binary_ply_file_of_quads_and_triangles_says_what_to_do(tmp_path, capsys):
    head = b"ply\nformat binary_little_endian 1.0\nelement vertex 5\nproperty float x\n"
    head += b"property float y\nproperty float z\nelement face 2\n"
    head += b"property list uchar int vertex_indices\nend_header\n"
    faces = struct.pack("<B4i", 4, 0, 1, 2, 3) + struct.pack("<B3i", 3, 0, 1, 4)
    path = tmp_path / "a.ply"
    path.write_bytes(head + np.eye(5, 3, dtype="<f4").tobytes() + faces)
    assert cli.main(["check", str(path)]) == 1
    assert "unlike numbers of corners" in capsys.readouterr().out


@pytest.fixture
def obj(tmp_path):
    (tmp_path / "stuff.mtl").write_text(MTL)
    path = tmp_path / "stuff.obj"
    path.write_text(OBJ)
    return path


def test_obj_files_have_the_materials_of_their_mtl(obj):
    with pytest.warns(UserWarning, match="holds what a scene cannot") as warned:
        scene = loaded(obj)
    glass, metal, paint, _ = scene.objects
    assert [item.name for item in scene.objects[:3]] == ["Lens/Glass", "Plate/Metal", "Plate/Paint"]
    assert glass.material.ior == 1.6
    np.testing.assert_allclose(glass.material.tint, [0.5, 0.9, 1.0])
    assert glass.edge_defects == (0, 0)
    assert glass.mesh.volume == pytest.approx(1 / 3)
    np.testing.assert_allclose(metal.material.reflectance, [0.9, 0.8, 0.7])
    np.testing.assert_allclose(metal.mesh.vertices, [[0, 0, 0], [1, 0, 0], [1, 1, 0]])
    np.testing.assert_allclose(paint.material.albedo, [0.1, 0.2, 0.3])
    _, lamp = scene.emitters
    np.testing.assert_allclose(lamp.radiance, [3, 2, 1])
    table = str(warned[0].message)
    for held in ("gloss (Ks)", "map_Kd", "transparency (d)"):
        assert f"Paint  {held}" in table


def test_an_object_without_a_name_has_that_of_its_file(tmp_path):
    path = tmp_path / "chip.obj"
    path.write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    assert loaded(path, material="diffuse").objects[0].name == "chip"


@pytest.mark.filterwarnings("ignore:.*holds what a scene cannot")
def test_a_material_that_is_given_is_that_of_all_parts(obj):
    scene = loaded(obj, material="mirror")
    assert all(isinstance(item.material, pr.Mirror) for item in scene.objects[:-1])
    assert len(scene.emitters) == 1


def test_strict_is_an_error_for_obj_files_too(obj):
    with pytest.raises(ValueError, match=r"Paint: map_Kd"):
        pr.load_scene(obj, strict=True)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("f 1 2 5", "f 1 2 9", "line 11 is damaged: index 9 is of none of the 5"),
        ("f 1 2 5", "f 1 2", "three corners or more, but has 2"),
        ("v 1 1 0", "v 1 x 0", "line 6 is damaged"),
        ("v 1 1 0", "v 1 1", "line 6 is damaged"),
        ("stuff.mtl", "../stuff.mtl", "should name a file in"),
        ("stuff.mtl", "/etc/passwd", "should name a file in"),
        ("stuff.mtl", "other.mtl", "there is no file"),
        ("v 1 1 0", "v nan 1 0", "should be finite"),
    ],
)
def test_errors_of_obj_files_name_the_line(obj, old, new, message):
    obj.write_text(obj.read_text().replace(old, new))
    with pytest.raises((ValueError, OSError), match=message) as raised:
        loaded(obj)
    assert "stuff.obj" in str(raised.value)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("Ni 1.6", "Ni one", "material 'Glass' of stuff.mtl is damaged"),
        ("Kd 0.1 0.2 0.3", "Kd spectral file.rfl", "should be red, green and blue"),
        ("Ni 1.6", "Ni -3", "ior should be a positive number"),
    ],
)
def test_errors_of_mtl_files_name_the_material(obj, old, new, message):
    mtl = obj.with_name("stuff.mtl")
    mtl.write_text(mtl.read_text().replace(old, new))
    with pytest.raises(ValueError, match=message):
        loaded(obj)
