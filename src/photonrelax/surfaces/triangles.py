"""Triangles with their bounds."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

from .._util.validation import Floats
from ..scene.meshes import bounding_box, triangle_bounds
from ..spatial.box_tree import BoxTree


@dataclass(frozen=True, eq=False)
class Triangles:
    """Triangles in space.

    Attributes
    ----------
    corners, normals : (f, 3, 3), (f, 3)
        m, wound anticlockwise as seen from the tips of their unit normals.
    """

    corners: Floats
    normals: Floats

    @cached_property
    def bounds(self) -> tuple[Floats, Floats]:
        """Least and greatest coordinates, (3,) both."""
        return bounding_box(self.corners)

    @cached_property
    def tree(self) -> BoxTree:
        """The bounding boxes of the faces."""
        return BoxTree(*triangle_bounds(self.corners))
