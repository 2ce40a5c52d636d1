"""Mitsuba 3 scenes, in XML and as dictionaries."""

import numpy as np
import pytest
import trimesh
from PIL import Image

import photonrelax as pr
from photonrelax import cli
from photonrelax.scene.textures import face_texture

XML = """<?xml version="1.0"?>
<!-- A ball of glass above a floor. -->
<scene version="3.0.0">
  <default name="height" value="2"/>
  <integrator type="path"/>
  <sensor type="perspective" id="front">
    <float name="fov" value="40"/>
    <transform name="to_world">
      <lookat origin="0, -6, 3" target="0, 0, 1" up="0, 0, 1"/>
    </transform>
    <film type="hdrfilm">
      <integer name="width" value="200"/><integer name="height" value="100"/>
    </film>
  </sensor>
  <sensor type="orthographic" id="top">
    <transform name="to_world">
      <scale value="3"/>
      <lookat origin="0, 0, 9" target="0, 0, 0" up="0, 1, 0"/>
    </transform>
  </sensor>
  <bsdf type="dielectric" id="glass"><string name="int_ior" value="water"/></bsdf>
  <shape type="sphere" id="ball">
    <point name="center" x="0" y="0" z="$height"/>
    <float name="radius" value="0.5"/>
    <ref id="glass"/>
  </shape>
  <shape type="rectangle" id="floor">
    <transform name="to_world"><scale value="4"/><translate z="-1"/></transform>
    <bsdf type="twosided">
      <bsdf type="diffuse"><rgb name="reflectance" value="0.1, 0.2, 0.3"/></bsdf>
    </bsdf>
  </shape>
  <shape type="disk">
    <transform name="to_world">
      <rotate x="1" angle="180"/><translate z="6"/>
    </transform>
    <emitter type="area"><rgb name="radiance" value="3 2 1"/></emitter>
  </shape>
  <emitter type="point">
    <point name="position" value="1 2 3"/><rgb name="intensity" value="2"/>
  </emitter>
  <emitter type="directional">
    <vector name="direction" z="-1"/><spectrum name="irradiance" value="5"/>
  </emitter>
  <emitter type="constant"/>
</scene>
"""


@pytest.fixture
def xml(tmp_path):
    path = tmp_path / "a.xml"
    path.write_text(XML)
    return path


def test_shapes_and_materials(xml):
    ball, floor = pr.load_scene(xml).objects
    np.testing.assert_allclose(np.linalg.norm(ball.mesh.vertices - [0, 0, 2], axis=1), 0.5)
    assert (ball.material.ior, ball.material.exterior_ior) == (1.333, 1.000277)
    assert (ball.name, floor.name) == ("ball", "floor")
    np.testing.assert_allclose(floor.mesh.bounds, [[-4, -4, -1], [4, 4, -1]])
    np.testing.assert_allclose(floor.mesh.face_normals, [[0, 0, 1]] * 2)
    np.testing.assert_allclose(floor.material.albedo, [0.1, 0.2, 0.3])


def test_emitters(xml):
    lamp, point, sun, sky = pr.load_scene(xml).emitters
    np.testing.assert_allclose(lamp.radiance, [3, 2, 1])
    assert lamp.shape.face_normals[:, 2].max() == pytest.approx(-1.0)
    assert lamp.shape.bounds[0, 2] == pytest.approx(6.0)
    np.testing.assert_allclose(point.position, [1, 2, 3])
    np.testing.assert_allclose(point.power, 8 * np.pi)
    np.testing.assert_allclose(sun.direction, [0, 0, -1])
    np.testing.assert_allclose(sun.irradiance, 5.0)
    np.testing.assert_allclose(sky.radiance, 1.0)


def test_cameras(xml):
    front = pr.load_scene(xml).camera
    assert (front.width, front.height) == (200, 100)
    half = np.tan(np.radians(20.0)) / 2.0
    assert front.vertical_fov == pytest.approx(2 * np.degrees(np.arctan(half)))
    np.testing.assert_allclose(front.origin, [0, -6, 3])
    right, _, forward = front.axes()
    np.testing.assert_allclose(right, [1, 0, 0], atol=1e-12)
    np.testing.assert_allclose(forward, np.array([0, 6, -2]) / np.sqrt(40), atol=1e-12)
    top = pr.load_scene(xml, camera="top").camera
    # Scaled, then moved: 3 to the left and right of the middle.
    assert (top.width, top.height, top.orthographic_height) == (768, 576, 4.5)


def test_arguments_are_defaults(xml, capsys):
    ball, _ = pr.load_scene(xml, arguments={"height": 3}).objects
    assert ball.mesh.bounds.mean(axis=0)[2] == pytest.approx(3.0)
    assert cli.main(["plan", str(xml), "--arg", "height=3"]) == 0
    assert cli.main(["plan", str(xml), "--arg", "width=3"]) == 1
    assert "defaults of the scene, height, but are width" in capsys.readouterr().err


def scene_of(**members):
    basis = {"type": "scene", "light": {"type": "point"}, "floor": {"type": "rectangle"}}
    return pr.load_scene(basis | members)


def material_of(bsdf):
    return scene_of(thing={"type": "cube", "bsdf": bsdf}).objects[1].material


def test_defaults_are_those_of_mitsuba():
    scene = scene_of(camera={"type": "perspective"})
    np.testing.assert_allclose(scene.objects[0].material.albedo, 0.5)
    np.testing.assert_allclose(scene.emitters[0].power, 4 * np.pi)
    camera = scene.camera
    assert (camera.width, camera.height) == (768, 576)
    # 50 mm before 35 mm film, whose diagonal is that of the image.
    half = 43.2666 / 2 / 50 * 576 / np.hypot(768, 576)
    assert camera.vertical_fov == pytest.approx(2 * np.degrees(np.arctan(half)), rel=1e-5)
    glass = material_of({"type": "dielectric"})
    assert (glass.ior, glass.exterior_ior) == (1.5046, 1.000277)


def test_dictionaries_take_colours_numbers_and_transforms():
    colour = {"type": "rgb", "value": [0.1, 0.2, 0.3]}
    np.testing.assert_allclose(
        material_of({"type": "diffuse", "reflectance": colour}).albedo, [0.1, 0.2, 0.3]
    )
    moved = np.eye(4)
    moved[:3, 3] = [0, 0, 5]
    cube = scene_of(cube={"type": "cube", "to_world": moved}).objects[1]
    np.testing.assert_allclose(cube.mesh.bounds, [[-1, -1, 4], [1, 1, 6]])


@pytest.mark.filterwarnings("ignore:.*in two ways")
def test_conductors_are_mirrors():
    perfect = material_of({"type": "conductor", "material": "none"})
    np.testing.assert_array_equal(perfect.reflectance, 1.0)
    assert not perfect.schlick
    by_index = material_of({"type": "conductor", "eta": 0.2, "k": 3.0})
    np.testing.assert_allclose(by_index.reflectance, (0.64 + 9) / (1.44 + 9))
    assert by_index.schlick
    copper = material_of({"type": "conductor", "material": "Cu"})
    assert copper.reflectance[0] > copper.reflectance[2]


@pytest.mark.parametrize("kind", ["conductor", "roughconductor"])
@pytest.mark.filterwarnings("ignore:.*what a scene cannot")
def test_a_conductor_without_a_material_reflects_all_light(kind):
    mirror = material_of({"type": kind})
    np.testing.assert_array_equal(mirror.reflectance, 1.0)
    assert not mirror.schlick


def test_dictionaries_refer_to_what_is_before():
    white = {"type": "diffuse", "reflectance": {"type": "rgb", "value": [0.8, 0.7, 0.6]}}
    wall = {"type": "rectangle", "material": {"type": "ref", "id": "white"}}
    scene = scene_of(integrator={"type": "path"}, white=white, wall=wall)
    np.testing.assert_allclose(scene.objects[-1].material.albedo, [0.8, 0.7, 0.6])
    with pytest.raises(ValueError, match="an id before it, but is of 'white'"):
        scene_of(wall=wall, white=white)


@pytest.mark.parametrize(
    ("spectrum", "expected"),
    [
        ({"type": "uniform", "value": 0.3}, [0.3, 0.3, 0.3]),
        ({"type": "srgb", "color": [0.1, 0.2, 0.3]}, [0.1, 0.2, 0.3]),
        ({"type": "d65"}, [1.0, 1.0, 1.0]),
    ],
)
def test_spectra_of_one_colour(spectrum, expected):
    light = scene_of(light={"type": "constant", "radiance": spectrum}).emitters[0]
    np.testing.assert_allclose(light.radiance, expected)


@pytest.mark.parametrize("kind", ["blackbody", "checkerboard"])
def test_what_is_no_colour_is_an_error(kind):
    with pytest.raises(ValueError, match=f"'light': radiance should be a colour.*{kind}"):
        scene_of(light={"type": "constant", "radiance": {"type": kind}})


@pytest.mark.parametrize(
    ("radiance", "message"),
    [
        ('<spectrum type="blackbody" name="radiance"/>', "should be a colour.*'blackbody'"),
        ('<spectrum name="radiance" filename="lamp.spd"/>', "or three, but is 'lamp.spd'"),
        ('<spectrum name="radiance" value="400:1, 700:2"/>', "or three, but is '400:1, 700:2'"),
    ],
)
def test_spectra_over_wavelengths_are_errors(xml, radiance, message):
    xml.write_text(XML.replace('<rgb name="radiance" value="3 2 1"/>', radiance))
    with pytest.raises(ValueError, match=message):
        pr.load_scene(xml)


@pytest.mark.parametrize(
    ("bsdf", "held"),
    [
        ({"type": "roughdielectric"}, "roughdielectric +a smooth dielectric"),
        ({"type": "plastic"}, "plastic +a diffuse surface"),
        ({"type": "bumpmap", "inner": {"type": "diffuse"}}, "bumpmap +the BSDF inside"),
        ({"type": "thindielectric"}, "thindielectric +a surface that light passes"),
    ],
)
def test_what_has_no_counterpart_is_told(bsdf, held):
    with pytest.warns(UserWarning, match=held):
        scene_of(thing={"type": "cube", "bsdf": bsdf})


def test_a_spot_keeps_its_intensity_and_cones():
    spot = {"type": "spot", "intensity": 3.0, "cutoff_angle": 30.0}
    with pytest.warns(UserWarning, match="falloff linear in the angle"):
        emitter = scene_of(spot=spot).emitters[1]
    assert (emitter.inner_angle, emitter.outer_angle) == (22.5, 30.0)
    irradiance = emitter.direct(np.array([[0.0, 0.0, 2.0]]), 0.0).irradiance
    np.testing.assert_allclose(irradiance, 0.75)


@pytest.mark.parametrize("kind", ["obj", "ply", "stl"])
def test_meshes_are_read_from_files_beside(tmp_path, kind):
    ball = trimesh.creation.icosphere(2)
    ball.export(tmp_path / f"ball.{kind}")
    shape = f'<shape type="{kind}"><string name="filename" value="ball.{kind}"/></shape>'
    path = tmp_path / "a.xml"
    path.write_text(XML.replace("</scene>", f"{shape}</scene>"))
    mesh = pr.load_scene(path).objects[2]
    np.testing.assert_allclose(np.linalg.norm(mesh.mesh.vertices, axis=1), 1.0, rtol=1e-6)
    assert mesh.smooth is not False


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("</scene>", "", "no element found"),
        ("<scene version", "<!DOCTYPE a><scene version", "document types and entities"),
        ('<ref id="glass"/>', '<ref id="wood"/>', "ref should be of an id before it"),
        ('type="disk"', 'type="hair"', "type 'hair' is not read"),
        ('value="3 2 1"', 'value="3 x 1"', "could not convert"),
        ('type="disk"', 'type="obj"', "should name a file|there is no file|folder"),
        ('<float name="radius" value="0.5"/>', '<float name="radius" value="x"/>', "a number"),
        ('value="water"', 'value="honey"', "int_ior should be a number"),
        ('<emitter type="constant"/>', '<include filename="b.xml"/>', "include is not read"),
        ('value="40"', 'value="400"', "fov should be between 0 and 180"),
        ("<scene version", "<nothing/><scene version", "junk after"),
        ('<rotate x="1"', "<rotate", "rotate should have an axis"),
    ],
)
def test_what_is_wrong_is_one_line(xml, capsys, old, new, message):
    xml.write_text(XML.replace(old, new, 1))
    with pytest.raises((ValueError, OSError), match=message):
        pr.load_scene(xml)
    assert cli.main(["plan", str(xml)]) == 1
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    assert "a.xml" in error


def test_files_elsewhere_are_not_read(xml):
    shape = '<shape type="ply"><string name="filename" value="../b.ply"/></shape>'
    xml.write_text(XML.replace("</scene>", f"{shape}</scene>"))
    with pytest.raises(ValueError, match="should name a file in"):
        pr.load_scene(xml)


# Bitmaps. Which way round they are was compared with renders of Mitsuba 3.9.

TEXELS = np.array([[[250, 10, 10], [10, 250, 10]], [[10, 10, 250], [250, 250, 10]]], np.uint8)
LIGHT = {"type": "point", "position": [0, 0, 3]}


@pytest.fixture
def bitmap(tmp_path, monkeypatch):
    Image.fromarray(TEXELS).save(tmp_path / "texels.png")
    monkeypatch.chdir(tmp_path)
    return {"type": "bitmap", "filename": "texels.png", "filter_type": "nearest"}


def textured(shape, texture):
    """The first object of a scene of a diffuse shape, and its colours at points."""
    bsdf = {"type": "diffuse", "reflectance": texture}
    scene = pr.load_scene({"type": "scene", "shape": shape | {"bsdf": bsdf}, "light": LIGHT})
    item = scene.objects[0]

    def colours(points):
        face = [0 if y < x else 1 for x, y, _ in points]
        return face_texture(item).at(item, np.array(face), np.array(points, float), None)

    return item, colours


QUARTERS = [(-0.4, -0.5, 0.0), (0.5, -0.4, 0.0), (-0.5, 0.4, 0.0), (0.4, 0.5, 0.0)]


def test_row_0_of_a_bitmap_is_at_v_0(bitmap):
    _, colours = textured({"type": "rectangle"}, bitmap | {"raw": True})
    np.testing.assert_allclose(colours(QUARTERS), TEXELS.reshape(4, 3) / 255.0, rtol=1e-6)


def test_bytes_are_srgb_and_transforms_move_coordinates(bitmap):
    half_right = np.eye(4)
    half_right[0, 3] = 0.5
    _, colours = textured({"type": "rectangle"}, bitmap | {"to_uv": half_right})
    meaning = pr.Texture(TEXELS, encoding="srgb").meaning
    np.testing.assert_allclose(colours(QUARTERS), meaning[TEXELS[:, ::-1]].reshape(4, 3), rtol=1e-6)


@pytest.mark.parametrize("kind", ["obj", "ply"])
def test_coordinates_of_files_are_v_up_in_obj_and_v_down_in_ply(bitmap, tmp_path, kind):
    corners = ["-1 -1 0 0 0", "1 -1 0 1 0", "1 1 0 1 1", "-1 1 0 0 1"]
    faces = [(0, 1, 2), (0, 2, 3)]
    if kind == "ply":
        head = ["ply", "format ascii 1.0", "element vertex 4"]
        head += [f"property float {name}" for name in "xyzuv"]
        head += ["element face 2", "property list uchar int vertex_indices", "end_header"]
        lines = head + corners + ["3 {} {} {}".format(*face) for face in faces]
    else:
        lines = [f"v {each[:-4]}" for each in corners] + [f"vt {each[-3:]}" for each in corners]
        lines += ["f " + " ".join(f"{i + 1}/{i + 1}" for i in face) for face in faces]
    (tmp_path / f"quad.{kind}").write_text("\n".join(lines) + "\n")
    shape = {"type": kind, "filename": f"quad.{kind}"}
    _, colours = textured(shape, bitmap | {"raw": True})
    rows = TEXELS[::-1] if kind == "obj" else TEXELS
    np.testing.assert_allclose(colours(QUARTERS), rows.reshape(4, 3) / 255.0, rtol=1e-6)


def test_a_bitmap_on_what_has_no_coordinates_is_its_mean(bitmap):
    with pytest.warns(UserWarning, match="texture without coordinates"):
        item, _ = textured({"type": "sphere"}, bitmap | {"raw": True})
    np.testing.assert_allclose(item.material.albedo, TEXELS.mean(axis=(0, 1)) / 255.0, rtol=1e-5)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"filename": "../texels.png"}, "should name a file in"),
        ({"filename": "none.png"}, "none.png"),
        ({"filename": ""}, "should have a filename"),
        ({"wrap_mode": "twice"}, "wrap_mode should be one of repeat, mirror, clamp"),
    ],
)
def test_what_is_wrong_with_a_bitmap_is_told(bitmap, change, message):
    with pytest.raises((ValueError, OSError), match=message):
        textured({"type": "rectangle"}, bitmap | change)


# Rotations about axes by 90 degrees, from x, y and z.
X_TO_Y_TO_Z = np.array([[0, 0, 1, 0], [1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 0, 1.0]])


def surroundings(tmp_path, radiance, **values):
    pr.Image({"radiance": radiance.astype(np.float32)}).write_exr(tmp_path / "map.exr")
    sky = {"type": "envmap", "filename": "map.exr", **values}
    return pr.load_scene({"type": "scene", "ball": {"type": "sphere"}, "sky": sky}).emitters[0]


def test_an_envmap_has_row_0_up_and_its_left_edge_at_minus_z(bitmap, tmp_path):
    blocks = np.random.default_rng(2).random((4, 8, 3))
    found = surroundings(tmp_path, blocks.repeat(8, 0).repeat(8, 1), scale=2.0)
    # By Mitsuba: atan2(x, -z) / 2π along a row, acos(y) / π down.
    polar, around = np.pi * (np.arange(4) + 0.5) / 4, 2 * np.pi * (np.arange(8) + 0.5) / 8
    polar, around = np.meshgrid(polar, around, indexing="ij")
    directions = np.stack(
        [np.sin(polar) * np.sin(around), np.cos(polar), -np.sin(polar) * np.cos(around)], axis=-1
    )
    seen = found.background(directions.reshape(-1, 3)).reshape(4, 8, 3)
    np.testing.assert_allclose(seen, 2.0 * blocks, rtol=1e-6)


def test_an_envmap_turned_to_z_is_taken_as_it_is(bitmap, tmp_path):
    radiance = np.random.default_rng(2).random((8, 16, 3)).astype(np.float32)
    found = surroundings(tmp_path, radiance, to_world=X_TO_Y_TO_Z)
    np.testing.assert_array_equal(found.radiance, radiance)
    with pytest.raises(ValueError, match="to_world should turn alone"):
        surroundings(tmp_path, radiance, to_world=np.eye(4) + np.eye(4, k=1))
