"""Groups of photons that may be neighbours, and the k-d tree of a group."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from .._ext.photons.normals import all_nearly_equal, group_normals
from .._ext.spatial.blocks import copy_scaled_rows
from .._util.validation import Floats, Rows
from ..spatial.kdtree import KDTree
from .photon_map import PhotonMap

# Faces whose normals are more than 60° apart belong to different surfaces. The same limit as the
# chord between unit normals, and as the cosine of the angle.
MAX_NORMAL_CHORD = 1.0
MIN_NORMAL_COSINE = 1.0 - 0.5 * MAX_NORMAL_CHORD**2
# A surface with more distinct normals than this counts as curved.
MAX_FACES = 64


def neighbour_groups(photons: PhotonMap) -> list[Rows]:
    """Return the rows of each group: photons of one emitter, on faces of similar normals.

    Only surfaces of few planes are separated by their normals here; range axes of `photon_tree`
    separate the others.
    """
    label, present = _face_labels(photons.normal)
    emitter = photons.emitter_id
    if emitter is not None and (emitter != emitter[:1]).any():
        label = label + MAX_FACES * emitter.astype(np.intp)
        present = np.unique(label)
    if len(present) < 2:
        return [slice(None)]
    return [np.flatnonzero(label == one) for one in present]


def _face_labels(normal: Floats) -> tuple[NDArray, NDArray]:
    """Return a label for each of the normals (n, 3), and all labels.

    Normals connected by steps of up to MAX_NORMAL_CHORD have one label; all have the same where
    they are too many to compare.
    """
    faces, face = group_normals(normal, MAX_FACES)
    if faces is None or len(faces) < 2:
        return np.zeros(len(normal), dtype=np.int8), np.zeros(1, dtype=np.int8)
    connected = within_chord(faces)
    # Squaring the matrix doubles the number of steps.
    for _ in range(len(faces).bit_length()):
        connected = connected @ connected
    label = connected.argmax(axis=1).astype(np.int8)
    return label[face], np.unique(label)


def within_chord(faces: Floats) -> NDArray[np.bool_]:
    """Matrix (f, f), true for normals (f, 3) within MAX_NORMAL_CHORD of each other."""
    chord = faces[:, np.newaxis] - faces
    # Squared, as the searches of trees compare them.
    return np.square(chord).sum(axis=2) <= MAX_NORMAL_CHORD**2


def photon_tree(
    position: Floats,
    normal: Floats,
    coords: Floats | None = None,
    ranges: Floats | None = None,
    *,
    rows: Rows = slice(None),
    n_threads: int,
) -> tuple[KDTree, Floats | None]:
    """Return the tree of some photons, and the radius of every photon's range.

    Range axes are the emitter coordinates, if given with their ranges, and the normals, unless
    all are equal but for rounding: photons on the other side of a plate or round a corner are
    not neighbours. Normals are scaled so that MAX_NORMAL_CHORD becomes the largest range.
    """
    columns, scales = [position], [1.0]
    if coords is not None and ranges is not None:
        columns.append(coords)
        scales.append(1.0)
    if not all_nearly_equal(normal, None if isinstance(rows, slice) else rows):
        if ranges is None:
            ranges = np.broadcast_to(MAX_NORMAL_CHORD, len(position))
        columns.append(normal)
        scales.append(ranges[rows].max() / MAX_NORMAL_CHORD)
    points = hstack_rows(columns, scales, rows, n_threads)
    return KDTree(points, n_metric=3, n_threads=n_threads), ranges


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
