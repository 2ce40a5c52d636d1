"""Axes of trees of photons: positions, normals, and what else limits their neighbours."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from .._ext.spatial.blocks import copy_scaled_rows
from .._util.validation import Floats, Rows
from ..spatial.kdtree import KDTree

# Faces whose normals are more than 60° apart belong to different surfaces. The same limit as the
# chord between unit normals, and as the cosine of the angle.
MAX_NORMAL_CHORD = 1.0
MIN_NORMAL_COSINE = 1.0 - 0.5 * MAX_NORMAL_CHORD**2
# A surface with more distinct normals than this counts as curved.
MAX_FACES = 64


def within_chord(faces: Floats) -> NDArray[np.bool_]:
    """Matrix (f, f), true for normals (f, 3) within MAX_NORMAL_CHORD of each other."""
    chord = faces[:, np.newaxis] - faces
    # Squared, as the searches of trees compare them.
    return np.square(chord).sum(axis=2) <= MAX_NORMAL_CHORD**2


def normal_range(tree: KDTree) -> float:
    """Return the largest chord between the normals of neighbours, -1 for a tree without normals."""
    return MAX_NORMAL_CHORD if tree.n_axes > tree.n_metric else -1.0


def hstack_rows(columns: list[Floats], scales: list[float], rows: Rows, n_threads: int) -> Floats:
    """Return rows of arrays, each multiplied by its scale, side by side in one array."""
    selected = None if isinstance(rows, slice) else rows
    if selected is None and len(columns) == 1:
        return columns[0]
    n = len(columns[0]) if selected is None else len(selected)
    points = np.empty((n, sum(column.shape[1] for column in columns)))
    first = 0
    for column, scale in zip(columns, scales, strict=True):
        copy_scaled_rows(points, first, column, selected, scale=scale, n_threads=n_threads)
        first += column.shape[1]
    return points


def leaf_rows(tree: KDTree, rows: Rows) -> NDArray[np.intp]:
    """Return the rows of photons in tree order, of a tree of the photons in `rows`."""
    order = np.asarray(tree.kernel.ids)
    return order if isinstance(rows, slice) else rows[order]
