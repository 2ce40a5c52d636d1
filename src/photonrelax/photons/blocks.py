"""Photon maps larger than memory in blocks of space, on disk: an external sort.

Cells of a k-d tree over a sample of the photons divide space into blocks of about equal numbers.
In a block photons are sorted by their group, then along a Morton curve, whose runs are tiles.
"""

from __future__ import annotations

import json
import os
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from .._ext.spatial.morton import morton_order
from .._util.files import make_folder, whole_file, write_json
from .._util.validation import Floats
from .columns import ColumnFolder, Scatter
from .energy_ledger import EnergyLedger
from .joining import summed
from .parts import shared_fields
from .photon_map import ARRAY_FIELDS, PhotonMap
from .streamed_groups import Parts, StreamedGroup, StreamedGroups

PHOTONS_PER_BLOCK = 1_000_000
"""Photons of a block, about: a block with its halo takes some 500 bytes for each."""

MANIFEST = "blocks.json"
FORMAT_VERSION = 1
# Photons from which cells are found, for each of them.
_SAMPLE_OF_CELL = 4096
# What lies in a blocked map beside the columns of a `PhotonMap`.
ROW, LABEL, GROUP = "row", "label", "group"


class Segments(NamedTuple):
    """Runs of rows of one block and one group, in the order of blocks.

    `first` and `stop` (s,) are rows, `block` and `group` (s,) their numbers.
    """

    first: NDArray[np.int64]
    stop: NDArray[np.int64]
    block: NDArray[np.int64]
    group: NDArray[np.int64]

    def of_group(self, group: int) -> NDArray[np.intp]:
        """Numbers of the segments of a group."""
        return np.flatnonzero(self.group == group)


@dataclass(frozen=True)
class BlockedPhotons:
    """A photon map in blocks, of a folder.

    Attributes
    ----------
    columns : ColumnFolder
        Those of `PhotonMap` that the photons have, `row` in the map that they were sorted from, and
        `label` in groups that share trees.
    shared : dict
        Fields of `PhotonMap` beside its arrays, for JSON.
    groups : tuple of StreamedGroup
    segments : Segments
    """

    columns: ColumnFolder
    shared: Mapping[str, Any]
    groups: tuple[StreamedGroup, ...]
    segments: Segments

    @classmethod
    def open(cls, folder: str | os.PathLike[str]) -> BlockedPhotons:
        """The blocked photons of a folder.

        Raises
        ------
        FileNotFoundError, ValueError
            If there are none, or they are damaged.
        """
        path = Path(folder) / MANIFEST
        if not path.is_file():
            raise FileNotFoundError(
                f"{folder} should be a folder of photons in blocks, but has no {MANIFEST}"
            )
        try:
            content = json.loads(path.read_bytes())
            if content["photonblocks_version"] != FORMAT_VERSION:
                raise ValueError(f"it is of version {content['photonblocks_version']}")
            segments = np.array(content["segments"], dtype=np.int64).reshape(-1, 4)
            groups = tuple(StreamedGroup(*map(bool, group)) for group in content["groups"])
            columns = ColumnFolder(Path(folder), int(content["n_photons"]))
            opened = cls(columns, dict(content["shared"]), groups, Segments(*segments.T))
            if sum(opened.segments.stop - opened.segments.first) != columns.n_rows:
                raise ValueError("its segments do not have all photons")
        except (ValueError, KeyError, TypeError, RecursionError) as error:
            raise ValueError(f"{path} is damaged: {error}; sort the photons again") from None
        return opened

    def __len__(self) -> int:
        return int((self.segments.stop - self.segments.first).sum())

    def names(self) -> Iterator[str]:
        """Names of the columns of `PhotonMap` that the photons have."""
        return (name for name in ARRAY_FIELDS if name in self.columns)

    def photons(self, start: int = 0, stop: int | None = None) -> PhotonMap:
        """Photons of a range of rows, in the order of blocks."""
        columns = {name: self.columns.read(name, start, stop) for name in self.names()}
        return self.photons_of(columns)

    def photons_of(self, columns: Mapping[str, NDArray]) -> PhotonMap:
        """Some photons of the map, whose columns these are."""
        for column in columns.values():
            column.setflags(write=False)
        fields, ledger = {**self.shared, **columns}, self.shared["ledger"]
        fields["ledger"] = None if ledger is None else EnergyLedger.from_dict(ledger)
        return PhotonMap(**fields)

    def photon_map(self) -> PhotonMap:
        """All photons in memory, in the order of the map that they were sorted from."""
        order = np.argsort(self.columns.read(ROW))
        return self.photons().subset(order)

    def on_sensor(self, sensor: int | None) -> BlockedPhotons:
        """Segments of the photons on a sensor, of None on no sensor: groups have either."""
        if "object_id" not in self.columns:
            return self
        object_id = self.columns.take("object_id", self.segments.first)
        mine = object_id == sensor
        if sensor is None:
            mine = ~np.isin(object_id, self.shared["sensor_ids"] or ())
        return replace(self, segments=Segments(*(column[mine] for column in self.segments)))

    def write_manifest(self) -> None:
        """Write what is not in columns: the folder is whole."""
        content = {
            "photonblocks_version": FORMAT_VERSION,
            "n_photons": len(self),
            "shared": dict(self.shared),
            "groups": [list(group) for group in self.groups],
            "segments": np.column_stack(self.segments).tolist(),
        }
        with whole_file(self.columns.folder / MANIFEST) as path:
            write_json(path, content)

    def with_shared(self, **changes: Any) -> BlockedPhotons:
        """The same photons, with some shared fields changed."""
        return replace(self, shared={**self.shared, **changes})


def sort_into_blocks(
    parts: Parts,
    n_photons: int,
    folder: Path,
    *,
    photons_per_block: int = PHOTONS_PER_BLOCK,
    n_threads: int,
) -> BlockedPhotons:
    """Sort the photons of some parts into blocks of space, in a new folder.

    Parameters
    ----------
    parts : callable
        Yields parts of one emission, anew at each call.
    n_photons : int
        Of all parts.
    folder : Path
    photons_per_block : int
        Photons of a block, about.
    n_threads : int
    """
    make_folder(folder, [])
    groups = StreamedGroups(parts, n_threads)
    columns = ColumnFolder(folder, n_photons)
    depth = max(int(np.ceil(np.log2(max(n_photons, 1) / photons_per_block))), 0)
    cells = Cells(_sampled(parts, n_photons, _SAMPLE_OF_CELL << depth), depth)
    n_rows, names = _scattered(parts, columns, groups, cells)
    segments = sort_blocks(
        columns, n_rows, [*names, ROW, LABEL], along="position", n_threads=n_threads
    )
    columns.remove(GROUP)
    blocked = BlockedPhotons(columns, _shared(parts), tuple(groups.groups), segments)
    blocked.write_manifest()
    return blocked


def _scattered(
    parts: Parts, columns: ColumnFolder, groups: StreamedGroups, cells: Cells
) -> tuple[NDArray[np.int64], list[str]]:
    """Write the photons to their cells; their numbers, and the names of columns of `PhotonMap`."""
    n_rows, names = np.zeros(cells.n_cells, dtype=np.int64), list[str]()
    for photons in parts():
        names = names or _create_columns(columns, photons)
        n_rows += np.bincount(cells.of(photons.position), minlength=cells.n_cells)
    scatter, row = Scatter(columns, n_rows), 0
    for photons in parts():
        group, label = groups.assign(photons)
        values = {name: getattr(photons, name) for name in names}
        values |= {ROW: np.arange(row, row + len(photons)), LABEL: label, GROUP: group}
        scatter.write(cells.of(photons.position), **values)
        row += len(photons)
    return n_rows, names


def _shared(parts: Parts) -> dict[str, Any]:
    """Fields of the whole map beside its arrays, for JSON."""
    shared: dict[str, Any] = {}
    ledgers = []
    for photons in parts():
        shared = shared or shared_fields(photons)
        ledgers.append(photons.ledger)
    ledger = summed(ledgers)
    return shared | {"ledger": None if ledger is None else ledger.to_dict()}


class Cells:
    """Cells of a k-d tree of some depth over points, which divide space.

    Points that coincide are in one cell.
    """

    def __init__(self, sample: Floats, depth: int) -> None:
        self._depth = depth
        n_inner = (1 << depth) - 1
        self._axis, self._value = np.zeros(n_inner, dtype=np.intp), np.full(n_inner, np.inf)
        runs = [sample]
        for node in range(n_inner):
            points = runs[node]
            if len(points):
                axis = int(np.argmax(np.ptp(points, axis=0)))
                value = np.partition(points[:, axis], len(points) // 2)[len(points) // 2]
                self._axis[node], self._value[node] = axis, value
                above = points[:, axis] >= value
                runs += [points[~above], points[above]]
            else:
                runs += [points, points]

    @property
    def n_cells(self) -> int:
        return 1 << self._depth

    def of(self, points: Floats) -> NDArray[np.intp]:
        """Cells (n,) of points (n, axes)."""
        node, rows = np.zeros(len(points), dtype=np.intp), np.arange(len(points))
        for _ in range(self._depth):
            node = 2 * node + 1 + (points[rows, self._axis[node]] >= self._value[node])
        return node - ((1 << self._depth) - 1)


def _sampled(parts: Parts, n_photons: int, n_sample: int) -> Floats:
    """Positions of photons spread evenly over the parts."""
    step = max(n_photons // n_sample, 1)
    return np.concatenate([photons.position[::step] for photons in parts()])


def _create_columns(columns: ColumnFolder, photons: PhotonMap) -> list[str]:
    """Make the columns of a map of photons like these; names of those of `PhotonMap`."""
    names = [name for name in ARRAY_FIELDS if getattr(photons, name) is not None]
    for name in names:
        column = getattr(photons, name)
        columns.create(name, column.dtype, column.shape[1:])
    columns.create(ROW, np.int64)
    columns.create(LABEL, np.float64)
    columns.create(GROUP, np.int32)
    return names


def sort_blocks(
    columns: ColumnFolder,
    n_rows: NDArray[np.int64],
    names: Sequence[str],
    *,
    along: str,
    n_threads: int,
) -> Segments:
    """Sort the rows of each block by their group, then along a Morton curve of some column.

    The columns named are sorted, and that of groups read.
    """
    segments = [np.empty((0, 4), dtype=np.int64)]
    first = 0
    for block, n in enumerate(n_rows.tolist()):
        group, points = (columns.read(name, first, first + n) for name in (GROUP, along))
        order = morton_order(points, points.shape[1], n_threads)
        order = order[np.argsort(group[order], kind="stable")]
        for name in names:
            values = columns.read(name, first, first + n)
            columns.write(name, first, np.take(values, order, axis=0))
        present, start, counts = np.unique(group[order], return_index=True, return_counts=True)
        found = [first + start, first + start + counts, np.full(len(present), block), present]
        segments.append(np.column_stack(found).astype(np.int64))
        first += n
    return Segments(*np.concatenate(segments).T)
