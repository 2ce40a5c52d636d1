"""Groups of photons that may be neighbours."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from .._ext.photons.normals import group_normals
from .._util.validation import Floats, Rows
from ..scene.dispersion import LONGEST, SHORTEST
from .axes import MAX_FACES, within_chord
from .emitter_pools import EmitterPools, emitter_pools
from .photon_map import PhotonMap

# Groups that have a tree each; all others share one.
_MAX_TREES = 16


class Group(NamedTuple):
    """Photons that are neighbours of one another alone.

    Attributes
    ----------
    rows : slice or (m,) intp array
        Their rows in the map.
    mixed : bool
        They are of several emitters, so that their emitter coordinates do not compare.
    at_rest : bool
        They are too few to have a structure, and stay where they are.
    labels : (n, 1) float array, optional
        Groups that share a tree: photons of the map whose labels differ are not neighbours.
    whole : WholeGroup, optional
        What is known of all photons of a group, of which these are some.
    """

    rows: Rows
    mixed: bool = False
    at_rest: bool = False
    labels: Floats | None = None
    whole: WholeGroup | None = None


class WholeGroup(NamedTuple):
    """Properties of a whole group, which the trees of its parts share.

    Attributes
    ----------
    facing : bool
        Its normals are not all equal.
    largest_range : float
        The largest radius of its photons' balls over the range axes.
    """

    facing: bool
    largest_range: float


def neighbour_groups(photons: PhotonMap, n_threads: int) -> list[Group]:
    """Groups of photons that may be neighbours, on faces of similar normals.

    Photons on a sensor are neighbours of no others: the same light crosses it and arrives on the
    surface behind it. Nor are those of different parts of the spectrum, which are sheets of their
    own.
    """
    parts = _surface_numbers(photons), spectrum_parts(photons)
    labels = [part for part in parts if part is not None]
    if not labels:
        return _groups_on_surface(photons, n_threads)
    _, label = np.unique(np.column_stack(labels), axis=0, return_inverse=True)
    all_rows = [np.flatnonzero(label == one) for one in range(int(label.max(initial=-1)) + 1)]
    return [
        _among_all(group, rows, len(photons))
        for rows in all_rows
        for group in _groups_on_surface(photons.subset(rows), n_threads)
    ]


def _surface_numbers(photons: PhotonMap) -> NDArray[np.int64] | None:
    """Number (n,) of each photon's sensor, -1 on others; None if all are."""
    on_sensor = photons.on_sensor
    if photons.object_id is None or not on_sensor.any():
        return None
    return np.where(on_sensor, photons.object_id, -1)


def spectrum_parts(photons: PhotonMap) -> NDArray[np.int64] | None:
    """Number (n,) of the part of the spectrum that each photon is of; None if all are white.

    There are as many parts as wavelengths into which a path is dispersed: in each, photons are as
    dense as those of white light would be. White light is part -1.
    """
    if photons.wavelength is None:
        return None
    n_parts = photons.n_wavelengths or 1
    share = (photons.wavelength - SHORTEST) / (LONGEST - SHORTEST)
    part = np.clip(np.floor(n_parts * share), 0, n_parts - 1).astype(np.int64)
    return np.where(photons.wavelength > 0.0, part, -1)


def _among_all(group: Group, rows: NDArray[np.intp], n: int) -> Group:
    """The group, of photons with these rows in a map of n."""
    if group.labels is None:
        return group._replace(rows=rows[group.rows])
    labels = np.zeros((n, 1))
    labels[rows] = group.labels
    return group._replace(rows=rows[group.rows], labels=labels)


def _groups_on_surface(photons: PhotonMap, n_threads: int) -> list[Group]:
    """Groups of photons that are not told apart by the sensors they are on.

    An emitter's photons are a group by themselves where they make up a part of the light that has
    a structure of its own; those of other emitters are grouped by `emitter_pools`. Many groups
    share a tree, so that time does not grow with their number.

    Only surfaces of few planes are separated by their normals here; range axes of `group_tree`
    separate the others.
    """
    face, present = _face_labels(photons.normal)
    emitter = photons.emitter_id
    if emitter is not None and (emitter != emitter[:1]).any():
        return _groups_of_emitters(emitter_pools(photons, n_threads), face)
    if len(present) < 2:
        return [Group(slice(None))]
    return [Group(np.flatnonzero(face == one)) for one in present]


def _groups_of_emitters(pools: EmitterPools, face: NDArray) -> list[Group]:
    """Groups of photons of one emitter or pool, whose faces have one label."""
    label = face + MAX_FACES * pools.number
    present, n_photons = np.unique(label, return_counts=True)
    own = present < MAX_FACES * pools.first_pool
    alone, together = trees_of_labels(present[own], n_photons[own])
    groups = [Group(np.flatnonzero(label == one)) for one in alone]
    if len(together):
        labels = label[:, np.newaxis].astype(np.float64)
        groups.append(Group(np.flatnonzero(np.isin(label, together)), labels=labels))
    for one in present[~own]:
        at_rest = bool(one >= MAX_FACES * pools.first_at_rest)
        groups.append(Group(np.flatnonzero(label == one), mixed=True, at_rest=at_rest))
    return groups


def trees_of_labels(label: NDArray, n_photons: NDArray) -> tuple[NDArray, NDArray]:
    """Labels of groups that have a tree each, of most photons, and of those that share one."""
    order = np.argsort(-n_photons, kind="stable")
    return label[order[:_MAX_TREES]], label[order[_MAX_TREES:]]


def _face_labels(normal: Floats) -> tuple[NDArray, NDArray]:
    """Return a label for each of the normals (n, 3), and all labels.

    Normals connected by steps of up to MAX_NORMAL_CHORD have one label; all have the same where
    they are too many to compare.
    """
    faces, face = group_normals(normal, MAX_FACES)
    if faces is None or len(faces) < 2:
        return np.zeros(len(normal), dtype=np.int8), np.zeros(1, dtype=np.int8)
    label = connected_faces(faces)
    return label[face], np.unique(label)


def connected_faces(faces: Floats) -> NDArray[np.int8]:
    """Label (f,) of each of some normals, the same for those connected by steps."""
    connected = within_chord(faces)
    # Squaring the matrix doubles the number of steps.
    for _ in range(len(faces).bit_length()):
        connected = connected @ connected
    return connected.argmax(axis=1).astype(np.int8)
