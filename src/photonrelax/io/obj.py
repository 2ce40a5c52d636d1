"""Wavefront OBJ files, and the materials of their MTL files."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from .._util.validation import Floats
from ..scene.materials import Dielectric, Diffuse, Material, Mirror
from .parts import Part
from .sources import read_beside, read_whole
from .substitutions import Substitutions

# By illum: rays are refracted, or reflected alone; the latter by Fresnel in one.
_GLASS, _MIRRORS, _FRESNEL_MIRROR = (4, 6, 7, 9), (3, 5, 8), 5
_ABSENT = -1


def read_obj(
    path: Path,
    substitutions: Substitutions,
    *,
    with_materials: bool = True,
    with_uv: bool = False,
) -> list[Part]:
    """Parts of an OBJ file, one for each material of each object; MTL files may be left out.

    With texture coordinates vertices are split where these differ.

    Raises
    ------
    OSError
        If it, or its MTL file, cannot be read.
    ValueError
        If it is damaged; the message has the line.
    """
    obj = _Obj(path, substitutions, with_uv)
    for number, words in _lines(read_whole(path)):
        if words[0] == b"mtllib" and not with_materials:
            continue
        try:
            obj.read(words)
        except (ValueError, IndexError, OverflowError) as error:
            raise ValueError(f"{path}, line {number} is damaged: {error}") from None
    return obj.parts()


@dataclass
class _Group:
    """Corners of the faces of one object and material, three after another."""

    object_name: str
    material_name: str
    position: list[int] = field(default_factory=list)
    uv: list[int] = field(default_factory=list)
    normal: list[int] = field(default_factory=list)


class _Obj:
    """Vertices, faces and materials of the lines of an OBJ file read so far."""

    def __init__(self, path: Path, substitutions: Substitutions, with_uv: bool) -> None:
        self._path, self._substitutions, self._with_uv = path, substitutions, with_uv
        self._positions: list[tuple[float, float, float]] = []
        self._uvs: list[tuple[float, float]] = []
        self._normals: list[tuple[float, float, float]] = []
        self._materials: dict[str, tuple[Material, Floats]] = {}
        self._groups: dict[tuple[str, str], _Group] = {}
        self._object_name = self._material_name = ""

    def read(self, words: list[bytes]) -> None:
        """Take a line."""
        key = words[0]
        if key == b"v":
            self._positions.append(_triple(words))
        elif key == b"vt":
            self._uvs.append((float(words[1]), float(words[2]) if len(words) > 2 else 0.0))
        elif key == b"vn":
            self._normals.append(_triple(words))
        elif key == b"f":
            self._add_face(words[1:])
        elif key == b"o":
            self._object_name = _text(words)
        elif key == b"usemtl":
            self._material_name = _text(words)
        elif key == b"mtllib":
            content = read_beside(self._path, _text(words), f"{self._path}: mtllib")
            self._materials |= read_mtl(content, _text(words), self._substitutions)

    def parts(self) -> list[Part]:
        """The groups that have faces."""
        return [self._part(group) for group in self._groups.values()]

    def _add_face(self, corners: list[bytes]) -> None:
        if len(corners) < 3:
            raise ValueError(f"a face should have three corners or more, but has {len(corners)}")
        key = self._object_name, self._material_name
        group = self._groups.setdefault(key, _Group(*key))
        found = [corner.split(b"/") for corner in corners]
        position = [_index(each, 0, len(self._positions)) for each in found]
        uv = [_index(each, 1, len(self._uvs)) for each in found]
        normal = [_index(each, 2, len(self._normals)) for each in found]
        for i in range(1, len(corners) - 1):
            group.position += (position[0], position[i], position[i + 1])
            group.uv += (uv[0], uv[i], uv[i + 1])
            group.normal += (normal[0], normal[i], normal[i + 1])

    def _part(self, group: _Group) -> Part:
        material, radiance = self._materials.get(group.material_name, (None, np.zeros(3)))
        position, normal, uv = map(np.array, (group.position, group.normal, group.uv))
        has_normals = len(self._normals) > 0 and (normal != _ABSENT).all()
        has_uv = self._with_uv and len(self._uvs) > 0 and (uv != _ABSENT).all()
        columns = [position, *([normal] if has_normals else []), *([uv] if has_uv else [])]
        first, corner = _distinct(columns)
        vertices = np.array(self._positions, dtype=np.float64)[position[first]]
        normals = np.array(self._normals, dtype=np.float64)[normal[first]] if has_normals else None
        coordinates = np.array(self._uvs, dtype=np.float64)[uv[first]] if has_uv else None
        names = (group.object_name, group.material_name)
        name = "/".join(each for each in names if each) or self._path.stem
        faces = corner.reshape(-1, 3)
        return Part(name, vertices, faces, normals, material, radiance, coordinates)


def _distinct(columns: list[NDArray]) -> tuple[NDArray, NDArray]:
    """Corners that differ in a column, in their order, and the number of that of each corner."""
    number = columns[0]
    for column in columns[1:]:
        number = np.unique(number * np.int64(column.max() + 1) + column, return_inverse=True)[1]
    _, first, corner = np.unique(number, return_index=True, return_inverse=True)
    return first, corner


def read_mtl(
    content: bytes, name: str, substitutions: Substitutions
) -> dict[str, tuple[Material, Floats]]:
    """Materials of an MTL file and the radiance that each emits, by their names.

    Raises
    ------
    ValueError
        If it is damaged; the message has the line.
    """
    found: dict[str, dict[str, list[bytes]]] = {}
    current: dict[str, list[bytes]] = {}
    materials = {}
    for _, words in _lines(content):
        if words[0] == b"newmtl":
            current = found.setdefault(_text(words), {})
        else:
            current[words[0].decode(errors="replace")] = words[1:]
    for material, values in found.items():
        try:
            materials[material] = _material(values, material, substitutions)
        except (ValueError, IndexError, OverflowError) as error:
            raise ValueError(f"material {material!r} of {name} is damaged: {error}") from None
    return materials


def _material(
    values: dict[str, list[bytes]], name: str, substitutions: Substitutions
) -> tuple[Material, Floats]:
    for key in values:
        if key.startswith(("map_", "bump", "norm", "disp", "decal")):
            substitutions.add(name, key, "the colour alone")
    illum = int(_number(values, "illum", 2.0))
    radiance = np.maximum(_colour(values, "Ke", 0.0), 0.0)
    if illum in _GLASS and not radiance.any():
        # The filter is of a way through, that is of two surfaces.
        tint = np.sqrt(_unit(_colour(values, "Tf", 1.0)))
        return Dielectric(_number(values, "Ni", 1.5), tint=tint), radiance
    if illum in _MIRRORS and not radiance.any():
        return Mirror(_unit(_colour(values, "Ks", 1.0)), schlick=illum == _FRESNEL_MIRROR), radiance
    if _colour(values, "Ks", 0.0).any() and illum == 2 and "Ks" in values:
        substitutions.add(name, "gloss (Ks)", "no gloss")
    if _number(values, "d", 1.0) < 1.0:
        substitutions.add(name, "transparency (d)", "opaque")
    return Diffuse(_unit(_colour(values, "Kd", 0.8))), radiance


def _unit(colour: Floats) -> Floats:
    return np.clip(colour, 0.0, 1.0)


def _number(values: dict[str, list[bytes]], key: str, default: float) -> float:
    return float(values[key][-1]) if key in values else default


def _colour(values: dict[str, list[bytes]], key: str, default: float) -> Floats:
    words = values.get(key)
    if words is None:
        return np.full(3, default)
    if words[0] in (b"spectral", b"xyz"):
        raise ValueError(f"{key} should be red, green and blue, but is of {words[0].decode()}")
    # One number is grey.
    return np.array([float(word) for word in (words[:3] if len(words) >= 3 else words[:1] * 3)])


def _lines(content: bytes) -> Iterator[tuple[int, list[bytes]]]:
    """Numbers of lines, and their words; lines that end in a backslash go on."""
    pending: list[bytes] = []
    for number, line in enumerate(content.split(b"\n"), 1):
        words = line.split(b"#", 1)[0].split()
        if words and words[-1].endswith(b"\\"):
            pending += [*words[:-1], *filter(None, [words[-1][:-1]])]
            continue
        words, pending = [*pending, *words], []
        if words:
            yield number, words


def _text(words: list[bytes]) -> str:
    return b" ".join(words[1:]).decode(errors="replace")


def _triple(words: list[bytes]) -> tuple[float, float, float]:
    return float(words[1]), float(words[2]), float(words[3])


def _index(corner: list[bytes], place: int, n: int) -> int:
    """Index from 0 of a corner's position, texture or normal; negative ones count from the end."""
    if len(corner) <= place or not corner[place]:
        if place == 0:
            raise ValueError("a corner has no position")
        return _ABSENT
    index = int(corner[place])
    index = index - 1 if index > 0 else n + index
    if not 0 <= index < n:
        raise ValueError(f"index {int(corner[place])} is of none of the {n} before")
    return index
