"""Nodes of a glTF scene, and their transforms in a world whose z points up."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..._util.validation import Floats
from ..json_entry import JsonEntry
from .file import GltfFile

# From glTF's axes, y up, to z up: (x, y, z) becomes (x, -z, y).
_Z_UP = np.array([[1.0, 0, 0, 0], [0, 0, -1, 0], [0, 1, 0, 0], [0, 0, 0, 1]])
_IDENTITY = tuple(np.eye(4).ravel())
INSTANCES = "EXT_mesh_gpu_instancing"
# Attributes of instances: the member of a node that each stands for, and its width.
_PLACES = {"TRANSLATION": ("translation", 3), "ROTATION": ("rotation", 4), "SCALE": ("scale", 3)}


@dataclass(frozen=True, eq=False)
class PlacedNode:
    """A node of the scene.

    Attributes
    ----------
    entry : JsonEntry
    name : str
    to_world : (4, 4)
        From the node's own axes to the world.
    """

    entry: JsonEntry
    name: str
    to_world: Floats

    @property
    def position(self) -> Floats:
        """Origin (3,) of the node, m."""
        position: Floats = self.to_world[:3, 3]
        return position

    def axis(self, i: int) -> Floats:
        """Unit vector (3,) along one of the node's axes.

        Raises
        ------
        ValueError
            If the node is scaled to nothing along it.
        """
        vector = self.to_world[:3, i]
        length = np.linalg.norm(vector)
        if not length > 0.0:
            raise ValueError(f"{self.entry.where} should have a scale above 0, but has none")
        unit: Floats = vector / length
        return unit


def placed_nodes(file: GltfFile) -> list[PlacedNode]:
    """The nodes of the file's scene, parents before their children.

    Raises
    ------
    ValueError
        If a node is its own ancestor, or has a transform that is not one.
    """
    nodes = file.entries("nodes")
    scenes = file.entries("scenes")
    index = file.root.index("scene", len(scenes))
    if not scenes:
        raise ValueError(f"{file.path} should have a scene, but has none")
    roots = scenes[index or 0].indices("nodes", len(nodes))
    waiting = [(node, _Z_UP) for node in reversed(roots)]
    found: list[PlacedNode] = []
    seen: set[int] = set()
    while waiting:
        i, to_parent = waiting.pop()
        if i in seen:
            raise ValueError(f"{nodes[i].where} should have one parent, but is met twice")
        seen.add(i)
        to_world = to_parent @ _local(nodes[i])
        if not np.isfinite(to_world).all():
            raise ValueError(f"{nodes[i].where} should have a finite transform, but has not")
        name = nodes[i].text("name", f"node {i}")
        found += [
            PlacedNode(nodes[i], name, to_world @ each) for each in _instances(file, nodes[i])
        ]
        children = nodes[i].indices("children", len(nodes))
        waiting += [(child, to_world) for child in reversed(children)]
    return found


def _instances(file: GltfFile, node: JsonEntry) -> list[Floats]:
    """Transforms (4, 4) of the instances of a node's mesh to the node; of others that of itself."""
    extension = node.entry("extensions").entry(INSTANCES)
    given = extension.entry("attributes")
    n_accessors = len(file.entries("accessors"))
    places = {}
    for attribute, (member, width) in _PLACES.items():
        index = given.index(attribute, n_accessors)
        if index is not None:
            places[member] = file.floats(index, width)
    counts = {len(each) for each in places.values()}
    if len(counts) > 1:
        raise ValueError(f"{given.where} should be equally many, but are {sorted(counts)}")
    if "mesh" not in node or not counts:
        return [np.eye(4)]
    return [
        _local(JsonEntry({key: rows[i].tolist() for key, rows in places.items()}, given.where))
        for i in range(counts.pop())
    ]


def _local(node: JsonEntry) -> Floats:
    """Transform (4, 4) of a node to its parent."""
    if "matrix" in node:
        matrix = node.numbers("matrix", _IDENTITY).reshape(4, 4).T
        if not np.array_equal(matrix[3], [0.0, 0.0, 0.0, 1.0]):
            raise node.error("matrix", "affine, by columns")
        return matrix
    x, y, z, w = _unit(node.numbers("rotation", (0.0, 0.0, 0.0, 1.0)), node)
    turn = np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )
    local = np.eye(4)
    local[:3, :3] = turn * node.numbers("scale", (1.0, 1.0, 1.0))
    local[:3, 3] = node.numbers("translation", (0.0, 0.0, 0.0))
    return local


def _unit(rotation: Floats, node: JsonEntry) -> Floats:
    length = np.linalg.norm(rotation)
    if not (length > 0.0 and np.isfinite(length)):
        raise node.error("rotation", "a quaternion with a length")
    unit: Floats = rotation / length
    return unit
