"""glTF files: transforms, materials, lights, cameras and what has no counterpart."""

import json

import numpy as np
import pytest
import trimesh

import photonrelax as pr
from photonrelax import cli
from tests.helpers.gltf import SUN, GltfParts, of_mesh

BOX = trimesh.creation.box((1.0, 1.0, 1.0))
BALL = trimesh.creation.icosphere(2, 0.5)
PANE = trimesh.Trimesh([[0, 0, 0], [1, 0, 0], [1, 0, -1], [0, 0, -1]], [[0, 1, 2], [0, 2, 3]])
GLASS = {"KHR_materials_transmission": {"transmissionFactor": 1.0}}
MATT = {"pbrMetallicRoughness": {"metallicFactor": 0.0}}


def pbr(colour=(1, 1, 1), metallic=0.0, roughness=1.0, **extensions):
    factors = {"baseColorFactor": [*colour, 1], "metallicFactor": metallic}
    material = {"name": "stuff", "pbrMetallicRoughness": factors | {"roughnessFactor": roughness}}
    return material | {"extensions": extensions}


def glass(colour=(1, 1, 1), roughness=0.0, **extensions):
    return pbr(colour, roughness=roughness, **GLASS, **extensions)


def loaded(parts, tmp_path, **options):
    return pr.load_scene(parts.write(tmp_path / "scene.gltf"), **options)


def material_of(parts, tmp_path, **options):
    return loaded(parts, tmp_path, **options).objects[0].material


def table_of(parts, tmp_path):
    with pytest.warns(UserWarning, match="holds what a scene cannot") as warned:
        loaded(parts, tmp_path)
    return [" ".join(line.split()) for line in str(warned[0].message).splitlines()]


# --- transforms -----------------------------------------------------------------------------------


def test_y_up_becomes_z_up(tmp_path):
    (item,) = loaded(of_mesh(BOX.copy().apply_translation((1, 2, 3)), MATT), tmp_path).objects
    np.testing.assert_allclose(item.mesh.bounds.mean(axis=0), [1, -3, 2])
    assert item.name == "thing"


def test_nodes_are_placed_by_their_parents(tmp_path):
    parts = GltfParts()
    child = parts.node(mesh=parts.mesh(BOX, MATT), translation=[1.0, 0.0, 0.0])
    matrix = np.diag([2.0, 3.0, 4.0, 1.0])
    matrix[:3, 3] = [0.0, 10.0, 0.0]
    parts.node(children=[child], matrix=matrix.T.ravel().tolist())
    parts.lights(SUN)
    (item,) = loaded(parts, tmp_path).objects
    np.testing.assert_allclose(item.mesh.bounds, [[1, -2, 8.5], [3, 2, 11.5]])


def test_meshes_of_mirrored_nodes_keep_their_outside(tmp_path):
    parts = GltfParts()
    lens = trimesh.creation.cone(0.5, 1.0)
    mesh = parts.mesh(lens, glass(), normals=lens.vertex_normals)
    parts.node(mesh=mesh, scale=[1.0, 1.0, -1.0])
    parts.lights(SUN)
    with pytest.warns(UserWarning, match="solid glass"):
        (item,) = loaded(parts, tmp_path).objects
    assert item.mesh.volume == pytest.approx(lens.volume, rel=1e-6)
    normals = item.shading_normals
    outwards = item.mesh.vertex_normals[normals.vertex]
    assert np.einsum("ij,ij->i", normals.normal, outwards).min() > 0.5


def test_a_mesh_under_many_nodes_is_read_once(tmp_path, monkeypatch):
    from photonrelax.io.gltf import objects

    parts = GltfParts()
    mesh = parts.mesh(BOX, MATT)
    for i in range(5):
        parts.node(mesh=mesh, translation=[2.0 * i, 0.0, 0.0])
    parts.lights(SUN)
    calls = []
    read = objects.triangles_of
    monkeypatch.setattr(objects, "triangles_of", lambda *given: calls.append(given) or read(*given))
    assert len(loaded(parts, tmp_path).objects) == 5
    assert len(calls) == 1


def instanced(**attributes):
    """A turned and mirrored node whose mesh has instances, by arrays of their attributes."""
    parts = GltfParts()
    cube = parts.mesh(trimesh.creation.box((2, 2, 2)), material={})
    numbers = {name: parts.accessor(np.array(rows, float)) for name, rows in attributes.items()}
    extensions = {"EXT_mesh_gpu_instancing": {"attributes": numbers}}
    parts.node(mesh=cube, name="cube", scale=[-1, 1, 1], extensions=extensions)
    parts.json["extensionsRequired"] = ["EXT_mesh_gpu_instancing"]
    parts.lights(SUN)
    return parts


@pytest.mark.filterwarnings("ignore:.*what a scene cannot")
def test_instances_of_a_node_are_objects(tmp_path):
    quarter = [0, np.sqrt(0.5), 0, np.sqrt(0.5)]
    parts = instanced(
        TRANSLATION=[[5, 0, 0], [0, 7, 0]],
        ROTATION=[[0, 0, 0, 1], quarter],
        SCALE=[[1] * 3, [3, 1, 1]],
    )
    first, second = loaded(parts, tmp_path).objects
    np.testing.assert_allclose(first.mesh.bounds, [[-6, -1, -1], [-4, 1, 1]], atol=1e-6)
    # Thrice as long along x, then turned about y, which is up: along -y of the scene.
    np.testing.assert_allclose(second.mesh.bounds, [[-1, -3, 6], [1, 3, 8]], atol=1e-6)
    assert min(first.mesh.volume, second.mesh.volume) > 0.0


def test_attributes_of_instances_are_equally_many(tmp_path):
    parts = instanced(TRANSLATION=[[5, 0, 0], [0, 7, 0]], SCALE=[[1, 1, 1]])
    with pytest.raises(ValueError, match=r"EXT_mesh_gpu_instancing.*equally many, .* \[1, 2\]"):
        loaded(parts, tmp_path)


@pytest.mark.parametrize("cycle", [[0], [1]])
def test_a_node_below_itself_is_an_error(tmp_path, cycle):
    parts = GltfParts()
    parts.node(children=[1])
    parts.node(children=cycle)
    parts.json["scenes"] = []
    finished = parts.finished() | {"scenes": [{"nodes": [0]}]}
    path = tmp_path / "scene.gltf"
    path.write_text(json.dumps(finished))
    with pytest.raises(ValueError, match="should have one parent, but is met twice"):
        pr.load_scene(path)


# --- meshes ---------------------------------------------------------------------------------------


def test_vertices_split_at_seams_are_welded(tmp_path):
    corners = BALL.vertices[BALL.faces].reshape(-1, 3)
    split = trimesh.Trimesh(corners, np.arange(len(corners)).reshape(-1, 3), process=False)
    parts = of_mesh(split, glass(), normals=corners / 0.5)
    with pytest.warns(UserWarning, match="solid glass"):
        (item,) = loaded(parts, tmp_path).objects
    assert len(item.mesh.vertices) == len(BALL.vertices)
    assert item.edge_defects == (0, 0)
    assert item.smooth is not False


def test_normals_of_the_faces_are_flat_facets(tmp_path):
    corners = BOX.vertices[BOX.faces].reshape(-1, 3)
    split = trimesh.Trimesh(corners, np.arange(len(corners)).reshape(-1, 3), process=False)
    normals = np.repeat(BOX.face_normals, 3, axis=0)
    (item,) = loaded(of_mesh(split, MATT, normals=normals), tmp_path).objects
    assert item.smooth is False
    (item,) = loaded(of_mesh(BOX, MATT), tmp_path).objects
    assert item.smooth is False


def test_strips_and_fans_are_triangles(tmp_path):
    for mode, faces in ((5, [[0, 1, 2], [2, 1, 3]]), (6, [[0, 1, 2], [0, 2, 3]])):
        parts = of_mesh(PANE, MATT)
        primitive = parts.json["meshes"][0]["primitives"][0]
        primitive["mode"] = mode
        primitive["indices"] = parts.accessor(np.arange(4))
        (item,) = loaded(parts, tmp_path).objects
        np.testing.assert_array_equal(item.mesh.faces, faces)


# --- materials ------------------------------------------------------------------------------------


def test_matt_is_diffuse(tmp_path):
    np.testing.assert_allclose(
        material_of(of_mesh(BOX, pbr((0.1, 0.2, 0.3))), tmp_path).albedo, [0.1, 0.2, 0.3]
    )


def test_smooth_metal_is_a_mirror_by_schlick(tmp_path):
    mirror = material_of(of_mesh(BOX, pbr((0.9, 0.8, 0.7), 1.0, 0.0)), tmp_path)
    np.testing.assert_allclose(mirror.reflectance, [0.9, 0.8, 0.7])
    assert mirror.schlick


def test_absent_factors_are_those_of_the_standard(tmp_path):
    """A metal of roughness 1, white: diffuse, which is said."""
    assert "stuff metal of roughness 1 a diffuse surface" in table_of(
        of_mesh(BOX, {"name": "stuff"}), tmp_path
    )
    with pytest.warns(UserWarning, match="default material"):
        loaded(of_mesh(BOX), tmp_path)


@pytest.mark.filterwarnings("ignore:.*can be read in two ways")
def test_glass_has_index_absorption_and_tint(tmp_path):
    volume = {"attenuationColor": [0.5, 0.25, 1.0], "attenuationDistance": 0.1}
    extensions = {"KHR_materials_ior": {"ior": 1.7}, "KHR_materials_volume": volume}
    parts = of_mesh(BOX, glass((0.25, 0.5, 1.0), **extensions))
    solid = material_of(parts, tmp_path)
    assert solid.ior == 1.7
    np.testing.assert_allclose(solid.absorption, [10 * np.log(2), 10 * np.log(4), 0], atol=1e-12)
    np.testing.assert_allclose(solid.tint, [0.25, 0.5, 1.0])
    # Blender's glass has its colour once for a way through.
    parts.json["asset"]["generator"] = "Khronos glTF Blender I/O v4.5.51"
    np.testing.assert_allclose(material_of(parts, tmp_path).tint, np.sqrt([0.25, 0.5, 1.0]))
    assert material_of(of_mesh(BOX, glass()), tmp_path).ior == 1.5


@pytest.mark.filterwarnings("ignore:.*can be read in two ways")
def test_glass_has_the_abbe_number_of_its_dispersion(tmp_path):
    """The extension holds 20 over it."""
    extensions = {
        "KHR_materials_ior": {"ior": 1.7},
        "KHR_materials_dispersion": {"dispersion": 0.625},
    }
    index = material_of(of_mesh(BOX, glass(**extensions)), tmp_path).ior
    assert (index.index_d, index.abbe_number) == pytest.approx((1.7, 32.0))
    extensions["KHR_materials_dispersion"]["dispersion"] = 0
    assert material_of(of_mesh(BOX, glass(**extensions)), tmp_path).ior == 1.7


def test_glass_of_an_open_mesh_is_a_plate(tmp_path):
    parts = of_mesh(PANE, glass((0.9, 0.9, 0.9)))
    assert "stuff thin wall, as thing is open a plate 0.00141 m thick" in table_of(parts, tmp_path)
    with pytest.warns(UserWarning, match="thin wall"):
        (item,) = loaded(parts, tmp_path).objects
    assert item.edge_defects == (0, 0)
    assert item.mesh.volume == pytest.approx(np.sqrt(2.0) * 1e-3)
    # The outer face stays.
    np.testing.assert_allclose(item.mesh.bounds, [[0, 0, -np.sqrt(2) * 1e-3], [1, 1, 0]], atol=1e-9)


def test_light_goes_straight_on_through_a_plate(tmp_path):
    """The two interfaces of a plate let (1 - R) / (1 + R) of the light through."""
    parts = of_mesh(PANE, glass())
    floor = trimesh.creation.box(
        (6.0, 0.1, 6.0), trimesh.transformations.translation_matrix([0, -2, 0])
    )
    parts.node(mesh=parts.mesh(floor, MATT), name="floor")
    with pytest.warns(UserWarning, match="thin wall"):
        photons = pr.trace_photons(loaded(parts, tmp_path), 20_000)
    below = photons.subset(photons.object_id == 1)
    assert below.flux[:, 0].sum() == pytest.approx(0.96 / 1.04, rel=0.01)
    assert np.abs(below.position[:, 0] - 0.5).max() < 0.52


def test_emissive_surfaces_are_lamps(tmp_path):
    lamp = MATT | {"name": "lamp", "emissiveFactor": [1.0, 0.5, 0.25], "doubleSided": True}
    lamp["extensions"] = {"KHR_materials_emissive_strength": {"emissiveStrength": 683.0}}
    parts = of_mesh(BOX, MATT, lights=())
    parts.node(mesh=parts.mesh(PANE, lamp), translation=[0.0, 3.0, 0.0])
    (emitter,) = loaded(parts, tmp_path).emitters
    np.testing.assert_allclose(emitter.radiance, [1.0, 0.5, 0.25])
    assert emitter.two_sided
    # Blender's own strength is W/(m² sr).
    parts.json["asset"]["generator"] = "Khronos glTF Blender I/O v5.0.21"
    np.testing.assert_allclose(loaded(parts, tmp_path).emitters[0].radiance[0], 683.0)
    closed = of_mesh(PANE, MATT, lights=())
    closed.node(mesh=closed.mesh(BALL, lamp))
    assert not loaded(closed, tmp_path).emitters[0].two_sided


@pytest.mark.parametrize(
    ("material", "row"),
    [
        (pbr(metallic=1.0, roughness=0.2), "metal of roughness 0.2 a smooth metal"),
        (pbr(metallic=1.0, roughness=0.5), "metal of roughness 0.5 a diffuse surface"),
        (pbr(metallic=0.7, roughness=0.0), "0.7 metal metal"),
        (pbr(roughness=0.5), "gloss of roughness 0.5 no gloss"),
        (glass(roughness=0.4), "glass of roughness 0.4 smooth glass"),
        (
            MATT | {"name": "stuff", "normalTexture": {"index": 0}},
            "normalTexture the normals of the mesh",
        ),
        (pbr(KHR_materials_clearcoat={}), "KHR_materials_clearcoat no coat"),
        (pbr(EXT_of_nobody={}), "EXT_of_nobody nothing of it"),
        (MATT | {"name": "stuff", "alphaMode": "BLEND"}, "alphaMode BLEND opaque"),
    ],
)
def test_what_has_no_counterpart_is_told_with_what_is_used(tmp_path, material, row):
    parts = of_mesh(BOX, material)
    assert f"stuff {row}" in table_of(parts, tmp_path)
    with pytest.raises(ValueError, match="should hold no more than a scene can, but holds stuff: "):
        loaded(parts, tmp_path, strict=True)


def test_the_table_is_printed_once_and_strict_is_an_error(tmp_path, capsys):
    path = with_cameras(tmp_path, pbr(roughness=0.5))
    assert cli.main(["plan", str(path)]) == 0
    printed = capsys.readouterr().err
    assert printed.count("gloss of roughness 0.5") == 1
    assert printed.startswith("photonrelax: warning: ")
    assert cli.main(["plan", str(path), "--strict"]) == 1
    assert "gloss of roughness 0.5" in capsys.readouterr().err


# --- lights and cameras ---------------------------------------------------------------------------


@pytest.mark.parametrize(("units", "watts"), [("standard", 683.0), ("compat", 1.0), ("raw", 1.0)])
def test_suns_have_their_irradiance(tmp_path, units, watts):
    sun = {"type": "directional", "intensity": 10.0, "color": [1.0, 0.5, 0.0]}
    (emitter,) = loaded(of_mesh(BOX, MATT, [sun]), tmp_path, light_units=units).emitters
    np.testing.assert_allclose(emitter.irradiance, np.array([10.0, 5.0, 0.0]) / watts)
    np.testing.assert_allclose(emitter.direction, [0.0, 0.0, -1.0], atol=1e-12)


@pytest.mark.parametrize(
    ("units", "unit"), [("standard", 683.0), ("compat", 1.0), ("raw", 4 * np.pi)]
)
def test_points_and_spots_have_their_intensity(tmp_path, units, unit):
    cone = {"innerConeAngle": 0.3, "outerConeAngle": 0.5}
    lights = [
        {"type": "point", "intensity": 10.0},
        {"type": "spot", "intensity": 10.0, "spot": cone},
    ]
    point, spot = loaded(of_mesh(BOX, MATT, lights), tmp_path, light_units=units).emitters
    below = np.array([[0.0, 0.0, -2.0]])
    for emitter in (point, spot):
        irradiance = emitter.direct(below, 0.0).irradiance
        np.testing.assert_allclose(irradiance, 10.0 / unit / 4.0, rtol=1e-12)
    assert np.radians([spot.inner_angle, spot.outer_angle]) == pytest.approx([0.3, 0.5])


def with_cameras(tmp_path, material=MATT):
    parts = of_mesh(BOX, material)
    lens = {"yfov": 0.5, "aspectRatio": 2.0, "znear": 0.1}
    parts.json["cameras"] = [
        {"type": "perspective", "perspective": lens},
        {"type": "orthographic", "orthographic": {"xmag": 3.0, "ymag": 2.0}},
    ]
    parts.node(camera=0, name="Front", translation=[0.0, 1.0, 5.0])
    parts.node(
        camera=1, name="Top", translation=[0.0, 9.0, 0.0], rotation=[-(0.5**0.5), 0, 0, 0.5**0.5]
    )
    return parts.write(tmp_path / "scene.gltf")


def test_cameras_are_chosen_by_name(tmp_path):
    path = with_cameras(tmp_path)
    front = pr.load_scene(path).camera
    assert (front.width, front.height) == (1200, 600)
    assert np.radians(front.vertical_fov) == pytest.approx(0.5)
    np.testing.assert_allclose(front.origin, [0, -5, 1])
    np.testing.assert_allclose(front.axes(), [[1, 0, 0], [0, 0, 1], [0, 1, 0]], atol=1e-12)
    top = pr.load_scene(path, camera="Top").camera
    assert (top.width, top.height, top.orthographic_height) == (900, 600, 4.0)
    np.testing.assert_allclose(top.axes(), [[1, 0, 0], [0, 1, 0], [0, 0, -1]], atol=1e-12)
    with pytest.raises(ValueError, match=r"one of those of .*, Front, Top, but is 'Back'"):
        pr.load_scene(path, camera="Back")


# --- errors ---------------------------------------------------------------------------------------


def test_extensions_that_are_required_but_not_known_are_named(tmp_path):
    parts = of_mesh(BOX, MATT)
    parts.json["extensionsRequired"] = ["KHR_draco_mesh_compression", "KHR_materials_ior"]
    with pytest.raises(ValueError, match="not known: KHR_draco_mesh_compression"):
        loaded(parts, tmp_path)


def test_a_file_without_light_or_mesh_says_so(tmp_path):
    with pytest.raises(ValueError, match="should have a light, but has none"):
        loaded(of_mesh(BOX, MATT, lights=()), tmp_path)
    parts = GltfParts()
    parts.lights(SUN)
    with pytest.raises(ValueError, match="should have a mesh of triangles"):
        loaded(parts, tmp_path)


def test_glass_that_is_inside_out_is_named(tmp_path):
    inverted = BOX.copy()
    inverted.invert()
    with pytest.raises(ValueError, match=r"scene.gltf: object 'thing': mesh of a Dielectric"):
        loaded(of_mesh(inverted, glass()), tmp_path)


def test_arguments_are_of_scripts(tmp_path):
    with pytest.raises(ValueError, match="takes no arguments, but is given size"):
        loaded(of_mesh(BOX, MATT), tmp_path, arguments={"size": 3})
