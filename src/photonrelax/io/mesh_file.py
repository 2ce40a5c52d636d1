"""Meshes of STL and PLY files, and of all others that trimesh reads."""

from __future__ import annotations

import io
import re
import struct
from pathlib import Path
from typing import Any

import numpy as np

from .parts import Part
from .sources import read_whole
from .substitutions import Substitutions

# Of a binary STL file: its heading, the number of triangles, and the bytes of one.
_STL_HEADING, _STL_TRIANGLE = 80, 50
_STL_TYPE = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("other", "<u2")])
# What a file may be of: containers of other files are not read.
_REFUSED = {"zip", "7z", "tar.gz", "tar.bz2", "json", "dict", "dict64", "xyz", "svg", "dxf", "path"}
# Of a count that Python converts, which is more than any file holds.
_MAX_DIGITS = 20
# What to do about errors of trimesh, which reads lists of one length in binary files.
_HINTS = {
    "PLY is unexpected length!": " It is cut off, or its faces are of unlike numbers of corners, "
    "which text files alone may have: export triangles"
}
_PLY_COUNT = re.compile(rb"^element\s+(\S+)\s+(\S+)", re.MULTILINE)


def is_mesh_format(suffix: str) -> bool:
    """True for the ending of the name of a file that trimesh reads as a mesh."""
    import trimesh

    kind = suffix.removeprefix(".").lower()
    return kind not in _REFUSED and kind in trimesh.exchange.load.mesh_formats()


def read_stl(path: Path, substitutions: Substitutions) -> list[Part]:
    """The triangles of an STL file, binary or text.

    Raises
    ------
    OSError, ValueError
        If it cannot be read, or is damaged.
    """
    content = read_whole(path)
    triangles = _binary_stl(content)
    if triangles is None:
        if not content.lstrip()[:5].lower() == b"solid":
            raise ValueError(_cut_off_stl(path, content))
        triangles = _text_stl(path, content)
    return [_part(path, triangles.reshape(-1, 3), np.arange(3 * len(triangles)).reshape(-1, 3))]


def read_ply(path: Path, substitutions: Substitutions) -> list[Part]:
    """The mesh of a PLY file, with its normals.

    Raises
    ------
    OSError, ValueError
        If it cannot be read, or is damaged.
    """
    content = read_whole(path)
    head, end, body = content.partition(b"end_header")
    if not (head.startswith(b"ply") and end):
        raise ValueError(f"{path} should be a PLY file, but has no whole header")
    for name, count in _PLY_COUNT.findall(head):
        # An element takes a byte at least.
        if not (count.isdigit() and len(count) < _MAX_DIGITS and int(count) <= len(body)):
            raise ValueError(
                f"{path} should have as many elements {name.decode(errors='replace')} as its "
                f"{len(body)} bytes can hold, but says {count.decode(errors='replace')[:25]}"
            )
    return _read_with_trimesh(path, content)


def read_other(path: Path, substitutions: Substitutions) -> list[Part]:
    """Meshes of a file in any other format that trimesh reads.

    Raises
    ------
    OSError, ValueError
        If it cannot be read, or is damaged.
    """
    return _read_with_trimesh(path, read_whole(path))


def _read_with_trimesh(path: Path, content: bytes) -> list[Part]:
    import trimesh

    kind = path.suffix.removeprefix(".").lower()
    try:
        with np.errstate(all="ignore"):
            # Files that it names are none of these: no other is opened.
            loaded = trimesh.load_scene(
                io.BytesIO(content), file_type=kind, process=False, resolver={}
            )
            meshes = loaded.dump()
    except Exception as error:
        # Libraries raise anything at damaged files.
        reason = str(error).splitlines()[0][:200] if str(error) else type(error).__name__
        reason += _HINTS.get(reason, "")
        raise ValueError(f"{path} cannot be read as {kind.upper()}: {reason}") from None
    return [
        _part(path, mesh.vertices, mesh.faces, _given_normals(mesh), _given_uv(mesh))
        for mesh in meshes
        if isinstance(mesh, trimesh.Trimesh)
    ]


def _given_normals(mesh: Any) -> np.ndarray | None:
    """Vertex normals that came with the mesh; trimesh keeps no others until they are asked for."""
    if "_ply_raw" in mesh.metadata:
        from trimesh.exchange import ply

        raw = mesh.metadata["_ply_raw"]
        normals = ply._elements_to_kwargs(raw, fix_texture=False, image=None).get("vertex_normals")
        return normals if normals is not None and np.shape(normals) == mesh.vertices.shape else None
    return mesh._cache.cache.get("vertex_normals")


def _given_uv(mesh: Any) -> np.ndarray | None:
    """Texture coordinates (v, 2) of a PLY file's vertices, of any of their usual names."""
    data = mesh.metadata.get("_ply_raw", {}).get("vertex", {}).get("data")
    for pair in (("u", "v"), ("s", "t"), ("texture_u", "texture_v")):
        if isinstance(data, dict) and data.keys() >= set(pair):
            uv = np.column_stack([np.asarray(data[name], dtype=np.float64) for name in pair])
            return uv if len(uv) == len(mesh.vertices) and np.isfinite(uv).all() else None
    return None


def _binary_stl(content: bytes) -> np.ndarray | None:
    """Triangles (n, 3, 3) of a binary file, None if its length is not that of one."""
    if len(content) < _STL_HEADING + 4:
        return None
    (n,) = struct.unpack_from("<I", content, _STL_HEADING)
    if len(content) != _STL_HEADING + 4 + _STL_TRIANGLE * n:
        return None
    rows = np.frombuffer(content, _STL_TYPE, offset=_STL_HEADING + 4)
    # Of NaN that signal casts warn; vertices are checked later.
    with np.errstate(invalid="ignore"):
        return rows["corners"].astype(np.float64)


def _text_stl(path: Path, content: bytes) -> np.ndarray:
    """Triangles (n, 3, 3) of a text file."""
    numbers = re.findall(rb"vertex\s+(\S+)\s+(\S+)\s+(\S+)", content)
    n_facets = len(re.findall(rb"^\s*facet\b", content, re.MULTILINE))
    if len(numbers) != 3 * n_facets or b"endsolid" not in content:
        raise ValueError(
            f"{path} should have three vertices in each of its {n_facets} facets and an endsolid, "
            f"but has {len(numbers)} vertices" + ("" if b"endsolid" in content else " and none")
        )
    try:
        return np.array(numbers).astype(np.float64).reshape(-1, 3, 3)
    except ValueError as error:
        raise ValueError(f"{path} should have numbers at its vertices, but: {error}") from None


def _cut_off_stl(path: Path, content: bytes) -> str:
    if len(content) < _STL_HEADING + 4:
        return f"{path} should be an STL file, but has no more than {len(content)} bytes"
    (n,) = struct.unpack_from("<I", content, _STL_HEADING)
    return (
        f"{path} should be an STL file of {n} triangles in {_STL_HEADING + 4 + _STL_TRIANGLE * n} "
        f"bytes, but has {len(content)}"
    )


def _part(
    path: Path,
    vertices: np.ndarray,
    faces: np.ndarray,
    normals: np.ndarray | None = None,
    uv: np.ndarray | None = None,
) -> Part:
    corners = np.asarray(vertices, dtype=np.float64)
    wrong = np.flatnonzero(~np.isfinite(corners).all(axis=1))
    if len(wrong):
        raise ValueError(
            f"{path} should have finite vertices, but {len(wrong)} of {len(corners)} are not, the "
            f"first of them {wrong[0]}"
        )
    if not len(faces):
        raise ValueError(f"{path} should have triangles, but has none")
    return Part(path.stem, corners, np.asarray(faces), normals, None, np.zeros(3), uv)
