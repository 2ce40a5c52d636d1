"""Textures of base colours in glTF files."""

import base64
import io

import numpy as np
import pytest
import trimesh
from PIL import Image

import photonrelax as pr
from photonrelax.scene.digest import scene_digest
from tests.helpers.gltf import of_mesh

# Red, green; blue, white: rows from the top.
IMAGE = np.array([[[255, 0, 0], [0, 255, 0]], [[0, 0, 255], [255, 255, 255]]], dtype=np.uint8)
FLOOR = trimesh.Trimesh(
    [[-1, 0, 1], [1, 0, 1], [1, 0, -1], [-1, 0, -1]], [[0, 1, 2], [0, 2, 3]], process=False
)
# v is down: the far edge of the floor, +y of the scene, is the top of the image.
UV = np.array([[0.0, 1.0], [1.0, 1.0], [1.0, 0.0], [0.0, 0.0]])
NEAREST = {"magFilter": 9728}


def encoded(kind="PNG", image=IMAGE):
    file = io.BytesIO()
    Image.fromarray(image).save(file, kind, **({"lossless": True} if kind == "WEBP" else {}))
    return file.getvalue()


def data_uri(content):
    return f"data:image/png;base64,{base64.b64encode(content).decode()}"


def textured(image=None, *, info=(), sampler=NEAREST, factor=(1, 1, 1), uv=UV, texture=()):
    material = {
        "name": "painted",
        "pbrMetallicRoughness": {
            "metallicFactor": 0.0,
            "baseColorFactor": [*factor, 1],
            "baseColorTexture": {"index": 0, **dict(info)},
        },
    }
    parts = of_mesh(FLOOR, material, uv=uv)
    parts.json["textures"] = [{"source": 0, "sampler": 0, **dict(texture)}]
    parts.json["samplers"] = [dict(sampler)]
    parts.json["images"] = [image or {"uri": data_uri(encoded())}]
    return parts


def albedo(scene, *points):
    """Albedo seen from above at points (x, y)."""
    found = []
    for x, y in points:
        camera = pr.Camera((x, y, 3), (x, y, 0), (0, 1, 0), 0.1, 1, 1)
        image = pr.render(pr.Scene(scene.objects, scene.emitters, camera), components=("direct",))
        found.append(image.layers["albedo"][0, 0])
    return np.array(found)


QUADRANTS = [(-0.5, 0.5), (0.5, 0.5), (-0.5, -0.5), (0.5, -0.5)]
COLOURS = [[1, 0, 0], [0, 1, 0], [0, 0, 1], [1, 1, 1]]


def loaded(parts, tmp_path):
    return pr.load_scene(parts.write(tmp_path / "a.gltf"))


def test_a_texture_lies_on_the_floor_as_in_the_standard(tmp_path):
    scene = loaded(textured(), tmp_path)
    np.testing.assert_allclose(albedo(scene, *QUADRANTS), COLOURS)


def test_images_are_srgb_and_the_factor_is_linear(tmp_path):
    grey = np.full((1, 1, 3), 188, dtype=np.uint8)
    parts = textured({"uri": data_uri(encoded(image=grey))}, factor=(0.5, 0.25, 1.0))
    linear = ((188 / 255 + 0.055) / 1.055) ** 2.4
    np.testing.assert_allclose(
        albedo(loaded(parts, tmp_path), (0.1, 0.1)), [linear * np.array([0.5, 0.25, 1.0])]
    )


@pytest.mark.parametrize("kind", ["PNG", "WEBP"])
def test_images_lie_beside_the_file_or_in_its_buffer(tmp_path, kind):
    name = f"floor {kind}.img"
    (tmp_path / name).write_bytes(encoded(kind))
    beside = loaded(textured({"uri": name.replace(" ", "%20")}), tmp_path)
    parts = textured()
    content = encoded(kind)
    view = {"buffer": 0, "byteOffset": len(parts.bytes), "byteLength": len(content)}
    parts.bytes += content
    parts.json["bufferViews"].append(view)
    parts.json["images"] = [{"bufferView": len(parts.json["bufferViews"]) - 1}]
    for scene in (beside, loaded(parts, tmp_path)):
        np.testing.assert_allclose(albedo(scene, *QUADRANTS), COLOURS)


@pytest.mark.parametrize(
    ("wrap", "expected"),
    [(10497, [0, 1, 0]), (33648, [1, 0, 0]), (33071, [1, 0, 0])],
)
def test_wrap_modes(tmp_path, wrap, expected):
    """Left of the image, half a texel beyond its edge."""
    scene = loaded(textured(sampler=NEAREST | {"wrapS": wrap}, uv=UV - [1.0, 0.0]), tmp_path)
    np.testing.assert_allclose(albedo(scene, (0.75, 0.5)), [expected])


def test_texture_transforms(tmp_path):
    """The standard's own order: scaled, then turned counter-clockwise, then moved."""
    transform = {"offset": [0.5, 0.0], "scale": [0.5, 1.0], "rotation": 0.0}
    info = {"extensions": {"KHR_texture_transform": transform}}
    scene = loaded(textured(info=info.items()), tmp_path)
    np.testing.assert_allclose(albedo(scene, (-0.5, 0.5), (0.5, -0.5)), [[0, 1, 0], [1, 1, 1]])
    turned = {"extensions": {"KHR_texture_transform": {"rotation": np.pi / 2, "offset": [0, 1]}}}
    scene = loaded(textured(info=turned.items()), tmp_path)
    # u becomes v, and v becomes 1 - u.
    expected = [IMAGE[1 - column, row] / 255 for row in range(2) for column in range(2)]
    np.testing.assert_allclose(albedo(scene, *QUADRANTS), expected)


def test_the_set_of_coordinates_is_chosen(tmp_path):
    parts = textured(info={"texCoord": 1}.items())
    attributes = parts.json["meshes"][0]["primitives"][0]["attributes"]
    attributes["TEXCOORD_1"] = parts.accessor(UV[:, ::-1])
    swapped = [COLOURS[0], COLOURS[2], COLOURS[1], COLOURS[3]]
    np.testing.assert_allclose(albedo(loaded(parts, tmp_path), *QUADRANTS), swapped)
    with pytest.raises(ValueError, match="should have TEXCOORD_3 for its texture"):
        loaded(textured(info={"texCoord": 3}.items()), tmp_path)


def test_a_saved_texture_is_the_same(tmp_path):
    scene = loaded(textured(), tmp_path)
    pr.save_scene(scene, tmp_path / "b.glb")
    assert scene_digest(pr.load_scene(tmp_path / "b.glb")) == scene_digest(scene)


def test_texture_coordinates_of_a_mesh_are_saved(tmp_path):
    mesh = FLOOR.copy()
    mesh.visual = trimesh.visual.TextureVisuals(uv=UV)
    item = pr.SceneObject(mesh, pr.Diffuse(pr.Texture(IMAGE)))
    scene = pr.Scene([item], [pr.PointEmitter((0, 0, 3))])
    pr.save_scene(scene, tmp_path / "b.glb")
    assert scene_digest(pr.load_scene(tmp_path / "b.glb")) == scene_digest(scene)


def test_other_programs_find_the_texture_of_a_saved_scene(tmp_path):
    parts = textured(sampler=NEAREST | {"wrapS": 33071}, factor=(0.5, 0.5, 1.0))
    pr.save_scene(loaded(parts, tmp_path), tmp_path / "b.glb")
    content = (tmp_path / "b.glb").read_bytes().replace(b'"photonrelax ', b'"another     ')
    (tmp_path / "c.glb").write_bytes(content)
    scene = pr.load_scene(tmp_path / "c.glb")
    assert scene.objects[0].material.texture.wrap == ("clamp", "repeat")
    expected = np.array(COLOURS) * [0.5, 0.5, 1.0]
    np.testing.assert_allclose(albedo(scene, *QUADRANTS), expected)


def test_linear_filters_are_told(tmp_path):
    with pytest.warns(UserWarning, match="linear filter of texels +means over pixels"):
        loaded(textured(sampler={"magFilter": 9729}), tmp_path)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"image": {"uri": data_uri(b"\xabKTX 20\xbb")}}, "image of KTX2, for which there is no"),
        ({"image": {"uri": data_uri(b"GIF89a")}}, "image of unknown, for which"),
        ({"image": {"uri": data_uri(encoded()[:40])}}, "cannot be read as an image"),
        ({"image": {"uri": "../floor.png"}}, "should name a file in"),
        ({"sampler": {"wrapS": 3}}, "should be one of 10497"),
        ({"info": {"index": 4}.items()}, "a whole number from 0 to 0"),
        ({"texture": {"source": 9}.items()}, "a whole number from 0 to 0"),
    ],
)
def test_what_is_wrong_with_a_texture_is_named(tmp_path, change, message):
    with pytest.raises(ValueError, match=message) as raised:
        loaded(textured(**change), tmp_path)
    assert "a.gltf" in str(raised.value)


def test_images_without_a_decoder_are_named_by_their_extension(tmp_path):
    parts = textured()
    parts.json["textures"] = [{"extensions": {"KHR_texture_basisu": {"source": 0}}}]
    with pytest.raises(ValueError, match="PNG, JPEG or WebP, but has KHR_texture_basisu"):
        loaded(parts, tmp_path)
    parts.json["extensionsRequired"] = ["KHR_texture_basisu"]
    with pytest.raises(ValueError, match="not known: KHR_texture_basisu"):
        loaded(parts, tmp_path)
