"""Damaged files: one line that names them; no memory on their word, no other folder read."""

import base64
import json
import os
import struct
import tracemalloc
from pathlib import Path

import numpy as np
import pytest
import trimesh

import photonrelax as pr
from photonrelax import cli
from tests.helpers.damage import cut_off, flipped
from tests.helpers.gltf import of_mesh
from tests.helpers.stl import stl_bytes
from tests.io.test_mesh_files import MTL, OBJ

BALL = trimesh.creation.icosphere(1)
MATT = {"pbrMetallicRoughness": {"metallicFactor": 0.0}}
GLB = Path(__file__).parents[1] / "data" / "amber_holder.glb"


def gltf():
    return of_mesh(BALL, MATT).finished()


def as_bytes(content):
    return content if isinstance(content, bytes) else content.encode()


WHOLE = {
    "a.glb": GLB.read_bytes(),
    "a.gltf": json.dumps(gltf()).encode(),
    "a.stl": stl_bytes(BALL),
    "text.stl": as_bytes(BALL.export(file_type="stl_ascii")),
    "a.ply": as_bytes(BALL.export(file_type="ply")),
    "text.ply": as_bytes(BALL.export(file_type="ply", encoding="ascii")),
    "a.obj": OBJ.encode(),
    "a.off": as_bytes(BALL.export(file_type="off")),
}


def read(path):
    """Load a file; an error is one line that names it."""
    try:
        return pr.load_scene(path)
    except (ValueError, OSError) as raised:
        error = str(raised)
    assert "\n" not in error
    assert path.name in error
    return None


@pytest.mark.filterwarnings("ignore:.*(holds what a scene cannot|in two ways|is a Dielectric)")
@pytest.mark.parametrize("name", WHOLE)
def test_damaged_files_are_one_error_or_another_scene(tmp_path, name):
    (tmp_path / "stuff.mtl").write_text(MTL)
    path = tmp_path / name
    path.write_bytes(WHOLE[name])
    assert read(path) is not None
    for content in (*cut_off(WHOLE[name], 12), *flipped(WHOLE[name], 25)):
        path.write_bytes(content)
        read(path)


@pytest.mark.parametrize("name", WHOLE)
def test_files_that_are_cut_off_are_errors(tmp_path, name, capsys):
    (tmp_path / "stuff.mtl").write_text(MTL)
    path = tmp_path / name
    path.write_bytes(WHOLE[name][: len(WHOLE[name]) // 2])
    assert cli.main(["plan", str(path)]) == 1
    error = capsys.readouterr().err
    assert error.startswith("photonrelax: error: ")
    assert error.count("\n") == 1
    assert name in error


HUGE = 2**31 - 1


def set_in(*keys, value):
    def change(root):
        for key in keys[:-1]:
            root = root[key]
        root[keys[-1]] = value

    return change


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (set_in("accessors", 0, "count", value=HUGE), "should have 2147483647 elements"),
        (set_in("accessors", 0, "count", value=2**60), "a whole number from 0 to"),
        (set_in("accessors", 0, "count", value=-1), "a whole number"),
        (set_in("accessors", 0, "count", value="12"), "a whole number"),
        (set_in("accessors", 0, "byteOffset", value=HUGE), "from byte 2147483647"),
        (set_in("accessors", 0, "bufferView", value=99), "a whole number from 0 to 1"),
        (set_in("accessors", 0, "type", value="MAT4"), "numbers or vectors"),
        (set_in("accessors", 0, "type", value="VEC2"), "should hold vectors of 3"),
        (set_in("accessors", 1, "componentType", value=5126), "unsigned integers"),
        (set_in("bufferViews", 0, "byteLength", value=HUGE), "should lie in its buffer"),
        (set_in("bufferViews", 0, "byteStride", value=4), "4 apart"),
        (set_in("buffers", 0, "byteLength", value=HUGE), "should have 2147483647 bytes"),
        (set_in("buffers", 0, "uri", value="none.bin"), "there is no file"),
        (set_in("buffers", 0, "uri", value="../secret.bin"), "should name a file in"),
        (set_in("buffers", 0, "uri", value="%2e%2e/secret.bin"), "should name a file in"),
        (set_in("buffers", 0, "uri", value="/etc/passwd"), "should name a file in"),
        (set_in("buffers", 0, "uri", value="file:///etc/passwd"), "should name a file in"),
        (set_in("buffers", 0, "uri", value="link.bin"), "should name a file in"),
        (set_in("buffers", 0, "uri", value="a\0b"), "should name a file"),
        (set_in("buffers", 0, "uri", value="."), "a folder"),
        (set_in("buffers", 0, "uri", value="data:;base64,!!"), "base64 data"),
        (set_in("buffers", 0, "uri", value=3), "should be text"),
        (set_in("buffers", value={}), "should be a list"),
        (set_in("meshes", 0, "primitives", 0, "attributes", value={}), "should have a POSITION"),
        (set_in("meshes", 0, "primitives", 0, "material", value=7), "a whole number from 0 to 0"),
        (set_in("meshes", 0, "primitives", 0, "mode", value=7), "a whole number from 0 to 6"),
        (set_in("nodes", 0, "mesh", value=-3), "a whole number"),
        (set_in("nodes", 0, "scale", value=[1, 1]), "3 numbers"),
        (set_in("nodes", 0, "scale", value=[1, 1, 1e999]), "3 numbers"),
        (set_in("nodes", 0, "scale", value=[0, 0, 0]), "should have a face with an area"),
        (set_in("nodes", 0, "rotation", value=[0, 0, 0, 0]), "quaternion"),
        (set_in("nodes", 0, "matrix", value=[0] * 16), "affine"),
        (set_in("nodes", 0, "children", value=[77]), "whole numbers below"),
        (set_in("asset", "version", value="1.0"), "glTF of version 2"),
        (set_in("scenes", value=[]), "should have a scene"),
        (set_in("materials", 0, value=[1]), "should be a JSON object"),
        (set_in("extensions", "KHR_lights_punctual", "lights", 0, "type", value="lamp"), "spot"),
        (set_in("extensions", "KHR_lights_punctual", "lights", 0, "intensity", value=-1), "number"),
    ],
)
def test_what_is_wrong_in_a_gltf_file_is_named(tmp_path, change, message):
    root = gltf()
    change(root)
    (tmp_path / "secret.bin").write_bytes(bytes(10_000))
    folder = tmp_path / "scene"
    folder.mkdir()
    os.symlink(tmp_path / "secret.bin", folder / "link.bin")
    path = folder / "a.gltf"
    path.write_text(json.dumps(root))
    tracemalloc.start()
    with pytest.raises((ValueError, OSError), match=message) as raised:
        pr.load_scene(path)
    assert tracemalloc.get_traced_memory()[1] < 8e6
    tracemalloc.stop()
    assert "a.gltf" in str(raised.value)


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_vertices_that_are_not_finite_are_counted(tmp_path, value):
    root = gltf()
    head, data = root["buffers"][0]["uri"].split(",")
    content = bytearray(base64.b64decode(data))
    content[4:8] = struct.pack("<f", value)
    root["buffers"][0]["uri"] = f"{head},{base64.b64encode(content).decode()}"
    path = tmp_path / "a.gltf"
    path.write_text(json.dumps(root))
    with pytest.raises(ValueError, match=r"1 of its 42 vectors are not, the first .* 0") as raised:
        pr.load_scene(path)
    assert "object 'thing'" in str(raised.value)


def test_indices_beyond_the_positions_are_an_error(tmp_path):
    parts = of_mesh(BALL, MATT)
    parts.json["meshes"][0]["primitives"][0]["indices"] = parts.accessor(np.arange(3) + 41)
    with pytest.raises(ValueError, match="below its 42 positions, but one is 43"):
        pr.load_scene(parts.write(tmp_path / "a.gltf"))


def ply(counts):
    head = f"ply\nformat binary_little_endian 1.0\nelement vertex {counts}\nproperty float x\n"
    return (head + "property float y\nproperty float z\nend_header\n").encode() + bytes(36)


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("a.stl", bytes(80) + struct.pack("<I", HUGE) + bytes(50), "2147483647 triangles"),
        ("a.stl", b"", "no more than 0 bytes"),
        ("a.stl", b"solid x\nfacet\nvertex 0 0 0\nendsolid", "three vertices in each"),
        ("a.ply", ply(HUGE), "says 2147483647"),
        ("a.ply", ply("-4"), "says -4"),
        ("a.ply", ply("9" * 5000), "says 9"),
        ("a.ply", ply(3), "should have faces"),
        ("a.obj", b"f 1 2 3", "line 1 is damaged: index 1 is of none of the 0"),
        ("a.obj", b"v 0 0 0\n", "should have faces"),
        ("a.off", b"OFF\n999999999 1 0\n0 0 0\n", "cannot be read as OFF"),
        (
            "a.glb",
            b"glTF" + struct.pack("<II", 2, HUGE) + bytes(30),
            "says that it is of version 2",
        ),
        (
            "a.glb",
            b"glTF" + struct.pack("<II", 2, 24) + struct.pack("<I4s", HUGE, b"JSON") + b"{}  ",
            "cut off",
        ),
        ("a.gltf", b"[" * 100_000, "should hold JSON"),
        ("a.gltf", b'{"asset": 3}', "should be a JSON object"),
        (
            "a.gltf",
            b'{"asset": {"version": "2.0"}, "n": ' + b"9" * 10_000 + b"}",
            "should hold JSON",
        ),
    ],
)
def test_files_are_not_believed(tmp_path, name, content, message):
    path = tmp_path / name
    path.write_bytes(content)
    tracemalloc.start()
    with pytest.raises(ValueError, match=message) as raised:
        pr.load_scene(path)
    assert tracemalloc.get_traced_memory()[1] < 2e7
    tracemalloc.stop()
    assert name in str(raised.value)
    assert "\n" not in str(raised.value)
