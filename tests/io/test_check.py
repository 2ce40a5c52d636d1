"""Findings about scenes, and their repair."""

from pathlib import Path

import numpy as np
import pytest
import trimesh

import photonrelax as pr
from photonrelax import cli
from photonrelax.io.check import scene_findings
from tests.helpers.gltf import SUN, GltfParts, of_mesh
from tests.helpers.stl import stl_bytes

DATA = Path(__file__).parents[1] / "data"
BALL = trimesh.creation.icosphere(2, 0.5)
MATT = {"pbrMetallicRoughness": {"metallicFactor": 0.0}}
GLASS = {
    "name": "glass",
    "pbrMetallicRoughness": {"metallicFactor": 0.0, "roughnessFactor": 0.0},
    "extensions": {"KHR_materials_transmission": {"transmissionFactor": 1.0}},
}
FLOOR = pr.SceneObject(trimesh.creation.box((9, 9, 1)), pr.Diffuse(), "floor")


def check(path, capsys, *arguments):
    code = cli.main(["check", str(path), *arguments])
    return code, capsys.readouterr().out


def inverted():
    mesh = BALL.copy()
    mesh.invert()
    return mesh


def holed(n_faces=1):
    return trimesh.Trimesh(BALL.vertices, BALL.faces[n_faces:], process=False)


def crossed():
    faces = BALL.faces.copy()
    faces[::7] = faces[::7, ::-1]
    return trimesh.Trimesh(BALL.vertices, faces, process=False)


def on_floor(parts):
    floor = trimesh.creation.box((6.0, 0.1, 6.0))
    parts.node(mesh=parts.mesh(floor, MATT), name="floor", translation=[0.0, -2.0, 0.0])
    parts.json["cameras"] = [{"type": "perspective", "perspective": {"yfov": 0.5}}]
    parts.node(camera=0, translation=[0.0, 0.0, 9.0])
    return parts


@pytest.fixture
def file_of(tmp_path):
    def file_of(mesh, material=GLASS):
        return on_floor(of_mesh(mesh, material)).write(tmp_path / "scene.gltf")

    return file_of


def test_a_sound_scene_has_no_findings(file_of, capsys):
    assert check(file_of(BALL, MATT), capsys) == (0, "no findings\n")
    assert check("ring", capsys) == (0, "no findings\n")


@pytest.mark.parametrize(
    ("mesh", "text"),
    [
        (inverted(), "'thing' is of glass, and its faces wind inwards"),
        (holed(), "'thing' is of glass, and has 3 open edges and 0 whose"),
        (crossed(), "'thing' is of glass, and has 0 open edges and 130 whose"),
    ],
)
def test_glass_that_is_not_sound_is_an_error_that_can_be_repaired(
    file_of, tmp_path, capsys, mesh, text
):
    path = file_of(mesh)
    code, printed = check(path, capsys)
    assert code == 1
    assert f"error: {text}" in printed
    repaired = tmp_path / "repaired.glb"
    code, printed = check(path, capsys, "--repair", str(repaired))
    assert code == 0
    assert printed.endswith(f"\nwrote {repaired}, in which there are\nno findings\n")
    assert check(repaired, capsys) == (0, "no findings\n")
    ball = pr.load_scene(repaired).objects[0]
    assert ball.edge_defects == (0, 0)
    assert ball.mesh.volume == pytest.approx(BALL.volume, rel=0.02)


def test_an_open_pane_is_a_thin_wall_which_is_noted(file_of, capsys):
    pane = trimesh.Trimesh(
        [[0, 0, 0], [1, 0, 0], [1, 0, -1], [0, 0, -1]], [[0, 1, 2], [0, 2, 3]], process=False
    )
    code, printed = check(file_of(pane), capsys)
    assert code == 0
    assert "thin wall, as thing is open" in printed


def test_glass_of_other_files_is_repaired_too(tmp_path, capsys):
    path = tmp_path / "ball.stl"
    path.write_bytes(stl_bytes(holed()))
    code, printed = check(path, capsys)
    assert code == 1
    assert "'ball' is of glass, and has 3 open edges" in printed
    assert check(path, capsys, "--repair", str(tmp_path / "b.glb"))[0] == 0


def test_triangles_without_an_area_are_counted(file_of, capsys):
    faces = np.vstack([BALL.faces, [[0, 0, 1], [2, 2, 2]]])
    flat = trimesh.Trimesh(BALL.vertices, faces, process=False)
    code, printed = check(file_of(flat, MATT), capsys)
    assert code == 0
    assert "note: 'thing' has 2 triangles without an area" in printed


def test_a_file_that_cannot_be_read_is_an_error(tmp_path, capsys):
    parts = of_mesh(BALL, MATT, lights=())
    code, printed = check(parts.write(tmp_path / "dark.gltf"), capsys)
    assert code == 1
    assert printed.startswith("error: ")
    assert "should have a light, but has none" in printed
    empty = tmp_path / "empty.glb"
    empty.write_bytes(b"")
    assert check(empty, capsys, "--repair", str(tmp_path / "out.glb"))[0] == 1
    assert not (tmp_path / "out.glb").exists()


DOWN = pr.CollimatedEmitter((0, 0, -1))


def texts(objects, emitters=(DOWN,), camera=None):
    camera = camera or pr.Camera((0, -9, 3), (0, 0, 0))
    scene = pr.Scene(objects, emitters, camera)
    return [(each.spoils, each.text) for each in scene_findings(scene)]


def glass(centre, **properties):
    mesh = BALL.copy()
    mesh.apply_translation(centre)
    return pr.SceneObject(mesh, pr.Dielectric(1.5, **properties), "ball")


def test_interpenetrating_glass_of_one_priority_is_an_error():
    ((spoils, text),) = texts([FLOOR, glass((0, 0, 2)), glass((0.6, 0, 2))])
    assert spoils
    assert "objects[1] ('ball') and objects[2] ('ball'), both transparent, interpenetrate" in text
    assert texts([FLOOR, glass((0, 0, 2)), glass((0.6, 0, 2), priority=1)]) == []
    assert texts([FLOOR, glass((0, 0, 2)), glass((1.5, 0, 2))]) == []


def test_glass_in_glass_is_no_finding():
    bubble = trimesh.creation.icosphere(2, 0.2)
    bubble.apply_translation((0, 0, 2))
    assert texts([FLOOR, glass((0, 0, 2)), pr.SceneObject(bubble, pr.Dielectric(1.0))]) == []


def test_a_hole_that_is_too_large_is_an_error_which_repair_leaves(file_of, tmp_path, capsys):
    path = file_of(holed(4))
    code, printed = check(path, capsys)
    assert code == 1
    text = "error: 'thing' is of glass, and has 6 open edges, too many to fill"
    assert text in printed
    code, printed = check(path, capsys, "--repair", str(tmp_path / "b.glb"))
    assert code == 1
    assert text in printed.split("b.glb, in which there are\n")[1]


def test_what_repair_leaves_is_found_in_the_file_that_it_wrote(tmp_path, capsys):
    script = tmp_path / "balls.py"
    script.write_text(
        "import trimesh\nimport photonrelax as pr\n"
        "def scene():\n"
        "    ball = trimesh.creation.icosphere(2, 0.5)\n"
        "    floor = trimesh.creation.box((9, 9, 1))\n"
        "    objects = [pr.SceneObject(floor, pr.Diffuse(), 'floor')]\n"
        "    for z in (2.0, 2.6):\n"
        "        mesh = ball.copy()\n"
        "        mesh.apply_translation((0.0, 0.0, z))\n"
        "        objects.append(pr.SceneObject(mesh, pr.Dielectric(1.5), f'ball {z}'))\n"
        "    return pr.Scene(objects, [pr.CollimatedEmitter((0, 0, -1))])\n"
    )
    code, printed = check(script, capsys, "--repair", str(tmp_path / "b.glb"))
    before, left = printed.split("b.glb, in which there are\n")
    assert code == 1
    for part in (before, left):
        assert "both transparent, interpenetrate" in part


def test_glass_in_the_same_place_is_an_error():
    ((spoils, text),) = texts([FLOOR, glass((0, 0, 2)), glass((0, 0, 2), priority=3)])
    assert spoils
    assert "are in the same place: remove one" in text


def test_emitters_and_cameras_inside_of_things_are_found():
    lamps = [pr.PointEmitter((0, 0, 2)), pr.SpotEmitter((0, 0, 0.2), (0, 0, 1))]
    found = texts([FLOOR, glass((0, 0, 2))], lamps, pr.Camera((1, 1, 0), (0, 0, 9)))
    opaque = "is inside of objects[0] ('floor'), which is opaque: move it out"
    assert found == [
        (True, f"emitters[1], a SpotEmitter {opaque}"),
        (True, f"the camera {opaque}"),
        (False, "emitters[0], a PointEmitter is inside of objects[1] ('ball'), and in its medium"),
    ]


def test_images_of_absurd_sizes_and_missing_cameras_are_found():
    huge = pr.Camera((0, -9, 3), (0, 0, 0), width=10**6, height=10**6)
    ((spoils, text),) = texts([FLOOR], camera=huge)
    assert spoils
    assert "an image of 1000000 x 1000000 pixels take at least 100 TB" in text
    found = list(scene_findings(pr.Scene([FLOOR], [pr.CollimatedEmitter((0, 0, -1))])))
    assert [each.spoils for each in found] == [False]
    assert "there is no camera" in found[0].text


def test_photons_need_somewhere_to_land():
    ((spoils, text),) = texts([glass((0, 0, 2))])
    assert spoils
    assert "there is no diffuse object and no sensor" in text


def test_files_of_blender_have_no_error(capsys):
    for name in ("sphere_and_ring", "amber_holder", "scene_spec"):
        code, printed = check(DATA / f"{name}.glb", capsys)
        assert (code, "error" in printed) == (0, False)


def test_lights_of_a_file_are_checked(tmp_path, capsys):
    parts = GltfParts()
    parts.node(mesh=parts.mesh(BALL, MATT), name="wall")
    parts.lights(SUN, {"type": "point", "intensity": 3.0})
    code, printed = check(parts.write(tmp_path / "a.gltf"), capsys)
    assert code == 1
    assert (
        "emitters[1], a PointEmitter is inside of objects[0] ('wall'), which is opaque" in printed
    )
