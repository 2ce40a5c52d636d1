"""Groups of photons that may be neighbours, of maps that are read in parts.

The same groups as those of `neighbour_groups`, from a few passes over the parts: what depends on
the whole map (its faces, emitters, pools and numbers of photons) is found first, after which each
photon's group follows from itself alone.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from .._ext.photons.normals import group_normals
from .._util.validation import Floats
from .axes import MAX_FACES
from .emitter_pools import Numbers, PoolNumbers, Thinned, kept_by_thinning, pool_numbers
from .neighbourhoods import connected_faces, spectrum_parts, trees_of_labels
from .photon_map import PhotonMap

Parts = Callable[[], Iterable[PhotonMap]]
"""Yields the parts of a map, anew at each call."""


class StreamedGroup(NamedTuple):
    """A group; see `photonrelax.photons.neighbourhoods.Group`.

    `labelled` says that some groups share its tree.
    """

    mixed: bool = False
    at_rest: bool = False
    labelled: bool = False


@dataclass
class _Light:
    """Photons on one sensor or none, of one part of the spectrum: what is found of all of them."""

    # None where they are too many.
    faces: Floats | None = field(default_factory=lambda: np.empty((0, 3)))
    # Of each emitter.
    n_photons: dict[int, int] = field(default_factory=dict)
    flux: dict[int, float] = field(default_factory=dict)
    pools: PoolNumbers | None = None
    # By label, the group.
    group_of: NDArray[np.int32] | None = None

    def add(self, photons: PhotonMap) -> None:
        """Count the faces and emitters of some photons."""
        if self.faces is not None:
            normals = np.concatenate([self.faces, photons.normal])
            self.faces, _ = group_normals(normals, MAX_FACES)
        if photons.emitter_id is None:
            return
        ids, place = np.unique(photons.emitter_id, return_inverse=True)
        flux = np.bincount(place, photons.flux.mean(axis=1))
        for emitter, n, watts in zip(ids.tolist(), np.bincount(place), flux, strict=True):
            self.n_photons[emitter] = self.n_photons.get(emitter, 0) + int(n)
            self.flux[emitter] = self.flux.get(emitter, 0.0) + float(watts)

    @property
    def has_pools(self) -> bool:
        return len(self.n_photons) > 1

    @property
    def counts(self) -> Numbers:
        """Photons of each emitter, in the order of their ids."""
        return np.array([self.n_photons[each] for each in sorted(self.n_photons)])

    def sums_of_flux(self) -> Floats:
        """Flux of each emitter, in the order of their ids."""
        return np.array([self.flux[each] for each in sorted(self.flux)])

    def place(self, emitter_id: NDArray[np.int32]) -> Numbers:
        """Places of photons' emitters among all."""
        return np.searchsorted(sorted(self.n_photons), emitter_id)

    def labels(self, photons: PhotonMap) -> NDArray[np.int64]:
        """Label (n,) of each photon: of its face, and its emitter or pool."""
        label = np.zeros(len(photons), dtype=np.int64)
        if self.faces is not None and len(self.faces) > 1:
            normals = np.concatenate([self.faces, photons.normal])
            _, face = group_normals(normals, MAX_FACES)
            label += connected_faces(self.faces)[face[len(self.faces) :]]
        if self.pools is not None and photons.emitter_id is not None:
            label += MAX_FACES * self.pools.number[self.place(photons.emitter_id)]
        return label


class StreamedGroups:
    """The groups of a map, and those of the photons of any of its parts.

    Attributes
    ----------
    groups : list of StreamedGroup
    """

    def __init__(self, parts: Parts, n_threads: int) -> None:
        self._lights: dict[int, _Light] = {}
        self.groups: list[StreamedGroup] = []
        for photons in parts():
            for number, _, some in _by_light(photons):
                self._lights.setdefault(number, _Light()).add(some)
        self._lights = dict(sorted(self._lights.items()))
        self._find_pools(parts, n_threads)
        self._number(parts)

    def assign(self, photons: PhotonMap) -> tuple[NDArray[np.int32], Floats]:
        """Group (n,) of each photon, and its label (n,) in that."""
        group, label = np.empty(len(photons), dtype=np.int32), np.zeros(len(photons))
        for number, rows, some in _by_light(photons):
            light = self._lights[number]
            assert light.group_of is not None, "groups are numbered"
            label[rows] = light.labels(some)
            group[rows] = light.group_of[label[rows].astype(np.intp)]
        labelled = np.array([each.labelled for each in self.groups])
        label[~labelled[group]] = 0.0
        return group, label

    def _find_pools(self, parts: Parts, n_threads: int) -> None:
        """Find the pools of lights of several emitters, from photons thinned as in one piece."""
        pooled = {number: light for number, light in self._lights.items() if light.has_pools}
        if not pooled:
            return
        thinned: dict[int, list[Thinned]] = {number: [] for number in pooled}
        for photons in parts():
            for number, _, some in _by_light(photons):
                if number in pooled:
                    thinned[number].append(_thinned(some, pooled[number]))
        for number, light in pooled.items():
            columns = (np.concatenate(each) for each in zip(*thinned.pop(number), strict=True))
            light.pools = pool_numbers(
                Thinned(*columns), light.counts, light.sums_of_flux, n_threads=n_threads
            )

    def _number(self, parts: Parts) -> None:
        """Number the groups of all lights by their labels."""
        n_photons: dict[int, NDArray] = dict.fromkeys(self._lights, np.zeros(0, dtype=np.int64))
        for photons in parts():
            for number, _, some in _by_light(photons):
                found = np.bincount(self._lights[number].labels(some))
                width = max(len(found), len(n_photons[number]))
                n_photons[number] = np.pad(
                    n_photons[number], (0, width - len(n_photons[number]))
                ) + np.pad(found, (0, width - len(found)))
        for number, light in self._lights.items():
            self._number_light(light, n_photons[number])

    def _number_light(self, light: _Light, n_photons: NDArray) -> None:
        present = np.flatnonzero(n_photons)
        light.group_of = np.full(len(n_photons), -1, dtype=np.int32)
        first_pool, first_at_rest = len(n_photons), len(n_photons)
        if light.pools is not None:
            first_pool = MAX_FACES * light.pools.first_pool
            first_at_rest = MAX_FACES * light.pools.first_at_rest
        own = present[present < first_pool]
        alone, together = own, own[:0]
        if light.pools is not None:
            alone, together = trees_of_labels(own, n_photons[own])
        for label in alone:
            self._append(light.group_of, label, StreamedGroup())
        if len(together):
            self._append(light.group_of, together, StreamedGroup(labelled=True))
        for label in present[present >= first_pool]:
            at_rest = bool(label >= first_at_rest)
            self._append(light.group_of, label, StreamedGroup(mixed=True, at_rest=at_rest))

    def _append(self, group_of: NDArray, labels: NDArray, group: StreamedGroup) -> None:
        group_of[labels] = len(self.groups)
        self.groups.append(group)


def _by_light(photons: PhotonMap) -> Iterable[tuple[int, NDArray | slice, PhotonMap]]:
    """Number of each light of some photons, their rows, and themselves."""
    part, on_sensor = spectrum_parts(photons), photons.on_sensor
    if part is None and not on_sensor.any():
        yield 0, slice(None), photons
        return
    number = np.zeros(len(photons), dtype=np.int64)
    if part is not None:
        number += part + 1
    if photons.object_id is not None:
        n_parts = 2 + (photons.n_wavelengths or 1)
        number += n_parts * np.where(on_sensor, photons.object_id.astype(np.int64) + 1, 0)
    for one in np.unique(number).tolist():
        rows = np.flatnonzero(number == one)
        yield one, rows, photons.subset(rows)


def _thinned(photons: PhotonMap, light: _Light) -> Thinned:
    assert photons.emitter_id is not None, "photons of pools have emitter ids"
    kept = kept_by_thinning(photons.position, light.counts)
    rows: NDArray | slice = slice(None) if kept is None else np.flatnonzero(kept)
    return Thinned(
        photons.position[rows], photons.normal[rows], light.place(photons.emitter_id[rows])
    )
