"""Rest density of photon maps larger than memory, a block of the emitters' coordinates at a time.

Maps from emitter coordinates to positions are fitted to photons that are close on their emitter,
wherever in space these are: photons are sorted a second time, into blocks over the emitter
coordinates. Halos are as those of `photonrelax.relaxation.blocks`. Medians over sheets and numbers
of photons without a map are of the whole map, and found once all blocks are done.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .._util.files import make_folder
from .._util.progress import Reporter
from .._util.workers import Workers
from ..photons.axes import MAX_NORMAL_CHORD
from ..photons.block_search import (
    BlockSearch,
    Columns,
    Found,
    GroupTiles,
    Neighbourhood,
)
from ..photons.blocks import GROUP, LABEL, ROW, BlockedPhotons, Cells, sort_blocks
from ..photons.columns import ColumnFolder, Scatter
from .rest_density import (
    RestDensitySettings,
    SheetNoise,
    limit_without,
    medians_of_sheets,
    noise_keys,
    prescribed,
)

# Columns by which photons are sorted and their maps are fitted.
_SORTED = ("position", "emitter_coords", "normal", "sheet", ROW)
_SHEET = "sheet"
# Photons from which cells are found, for each of them.
_SAMPLE_OF_CELL = 4096


@dataclass(frozen=True)
class _Sheets:
    """Sheets of a group: its path signatures and labels, ascending."""

    signatures: NDArray[np.int64]
    labels: NDArray[np.float64]

    @property
    def n_sheets(self) -> int:
        return len(self.signatures) * len(self.labels)

    def of(self, signature: NDArray[np.int64], label: NDArray[np.float64]) -> NDArray[np.intp]:
        """Number of the sheet of each photon."""
        place = np.searchsorted(self.signatures, signature)
        return place * len(self.labels) + np.searchsorted(self.labels, label)


@dataclass(frozen=True)
class _GroupWork:
    """The search of a group over the emitter coordinates."""

    search: BlockSearch
    settings: RestDensitySettings
    n_threads: int


def rest_density_by_blocks(
    photons: BlockedPhotons, settings: RestDensitySettings, workers: Workers, report: Reporter
) -> None:
    """Write the columns `slope` and `limit` of the rest density of blocked photons."""
    columns = photons.columns
    columns.create("slope", np.float64, (3,))
    columns.create("limit", np.float64)
    for start, stop in zip(photons.segments.first, photons.segments.stop, strict=True):
        columns.write("limit", int(start), np.full(int(stop - start), np.inf))
    if "emitter_coords" not in columns:
        report.advance(len(photons))
        return
    extended = _extended(photons)
    sheets = {}
    for number, group in enumerate(photons.groups):
        if extended[number]:
            report.advance(_n_photons(photons, number))
        elif group.mixed or group.at_rest:
            _limit_unmapped(photons, number)
            report.advance(_n_photons(photons, number))
        else:
            sheets[number] = _sheets(photons, number)
    if sheets:
        sorted_photons = _sorted_over_emitters(photons, sheets, workers.n_threads)
        for place, number in enumerate(sheets):
            _prescribe(sorted_photons, place, settings, workers, report)
            _write_back(photons, sorted_photons, place, sheets[number], settings)
        sorted_photons.columns.remove(*_SORTED, "slope", "residual", "noise")
        sorted_photons.columns.folder.rmdir()


def _extended(photons: BlockedPhotons) -> list[bool]:
    """Whether a group has photons of extended emitters."""
    ids, found = photons.shared["extended_ids"], [False] * len(photons.groups)
    if ids is None or "emitter_id" not in photons.columns:
        return found
    for number in range(len(found)):
        for rows in _ranges(photons, number):
            found[number] |= bool(np.isin(photons.columns.read("emitter_id", *rows), ids).any())
    return found


def _ranges(photons: BlockedPhotons, group: int) -> list[tuple[int, int]]:
    """Rows of the segments of a group."""
    numbers = photons.segments.of_group(group)
    firsts, stops = photons.segments.first[numbers], photons.segments.stop[numbers]
    return list(zip(firsts.tolist(), stops.tolist(), strict=True))


def _n_photons(photons: BlockedPhotons, group: int) -> int:
    return sum(stop - start for start, stop in _ranges(photons, group))


def _limit_unmapped(photons: BlockedPhotons, group: int) -> None:
    """Limit the photons of a group that has no maps."""
    limit = limit_without(_n_photons(photons, group))
    for start, stop in _ranges(photons, group):
        photons.columns.write("limit", start, np.full(stop - start, limit))


def _sheets(photons: BlockedPhotons, group: int) -> _Sheets:
    signatures, labels = [np.zeros(0, dtype=np.int64)], [np.zeros(0)]
    for rows in _ranges(photons, group):
        signatures.append(np.unique(_signature(photons, rows)))
        labels.append(np.unique(photons.columns.read(LABEL, *rows)))
    return _Sheets(np.unique(np.concatenate(signatures)), np.unique(np.concatenate(labels)))


def _signature(photons: BlockedPhotons, rows: tuple[int, int]) -> NDArray[np.int64]:
    if "path_signature" not in photons.columns:
        return np.zeros(rows[1] - rows[0], dtype=np.int64)
    return photons.columns.read("path_signature", *rows)


def _sorted_over_emitters(
    photons: BlockedPhotons, sheets: dict[int, _Sheets], n_threads: int
) -> BlockedPhotons:
    """Photons of the groups that have sheets, sorted into blocks over the emitter coordinates.

    Groups are numbered in the order of `sheets`; ROW is that among the blocks of space.
    """
    source = photons.columns
    ranges = [(place, rows) for place, n in enumerate(sheets) for rows in _ranges(photons, n)]
    n = sum(stop - start for _, (start, stop) in ranges)
    n_blocks = len(np.unique(photons.segments.block))
    depth = max(int(np.ceil(np.log2(n_blocks))), 0)
    step = max(n // (_SAMPLE_OF_CELL << depth), 1)
    sample = [source.read("emitter_coords", *rows)[::step] for _, rows in ranges]
    cells = Cells(np.concatenate(sample), depth)
    n_rows = np.zeros(1 << depth, dtype=np.int64)
    for _, rows in ranges:
        block = cells.of(source.read("emitter_coords", *rows))
        n_rows += np.bincount(block, minlength=len(n_rows))
    columns = _new_columns(source, n)
    scatter, known = Scatter(columns, n_rows), list(sheets.values())
    for place, rows in ranges:
        values = {name: source.read(name, *rows) for name in _SORTED[:3]}
        label = source.read(LABEL, *rows)
        values[_SHEET] = known[place].of(_signature(photons, rows), label).astype(np.float64)
        values |= {ROW: np.arange(*rows), GROUP: np.full(rows[1] - rows[0], place)}
        scatter.write(cells.of(values["emitter_coords"]), **values)
    segments = sort_blocks(columns, n_rows, _SORTED, along="emitter_coords", n_threads=n_threads)
    columns.remove(GROUP)
    groups = tuple(photons.groups[number] for number in sheets)
    return BlockedPhotons(columns, {}, groups, segments)


def _new_columns(source: ColumnFolder, n: int) -> ColumnFolder:
    """A folder for n photons sorted over the emitter coordinates, and their rest density."""
    make_folder(source.folder / "rest", [])
    columns = ColumnFolder(source.folder / "rest", n)
    for name in _SORTED[:3]:
        like = source.read(name, 0, 1)
        columns.create(name, like.dtype, like.shape[1:])
    for name in (_SHEET, "residual", "noise"):
        columns.create(name, np.float64)
    columns.create("slope", np.float64, (3,))
    columns.create(ROW, np.int64)
    columns.create(GROUP, np.int32)
    return columns


def _prescribe(
    photons: BlockedPhotons,
    group: int,
    settings: RestDensitySettings,
    workers: Workers,
    report: Reporter,
) -> None:
    """Write slopes, residuals and noise of a group, in the order over the emitter coordinates."""
    tiles, columns = GroupTiles(photons, group), photons.columns
    for segment in range(tiles.n_segments):
        for name in ("emitter_coords", "normal", _SHEET):
            tiles.bound(segment, name, columns.read(name, *tiles.rows(segment)))
    axes = (("emitter_coords", 1.0), (_SHEET, 2.0), ("normal", 1.0 / MAX_NORMAL_CHORD))
    search = BlockSearch(columns, tiles, axes, None, np.ones(len(tiles.first)), settings.k)
    value = _GroupWork(search, settings, workers.n_threads)
    found = workers.map(_prescribed, value, range(tiles.n_segments))
    for segment, values in enumerate(found):
        start, stop = tiles.rows(segment)
        for name, column in values.items():
            columns.write(name, start, column)
        report.advance(stop - start)


def _prescribed(given: _GroupWork, segment: int) -> Columns:
    """Slopes, residuals and noise of the photons of a segment."""

    def compute(some: Neighbourhood) -> Found:
        columns = [some.read(name) for name in _SORTED[:3]]
        sheet, own = some.read(_SHEET).astype(np.intp), slice(0, some.n_own)
        reached = np.empty(len(sheet))
        report = Reporter(None, "rest density", len(sheet))
        slope, residual, noise = prescribed(
            columns,
            sheet,
            given.settings,
            reached=reached,
            n_threads=given.n_threads,
            report=report,
        )
        found = {"slope": slope[own], "residual": residual[own], "noise": noise[own]}
        return Found(found, reached[own])

    return given.search.run(segment, compute)


def _write_back(
    photons: BlockedPhotons,
    prescribed_photons: BlockedPhotons,
    group: int,
    sheets: _Sheets,
    settings: RestDensitySettings,
) -> None:
    """Write slopes and limits of a group to the rows of the blocks of space."""
    source, ranges = prescribed_photons.columns, _ranges(prescribed_photons, group)
    fits, count = np.zeros(sheets.n_sheets), np.zeros(sheets.n_sheets)
    keys, n_unmapped = [np.zeros(0, dtype=np.int64)], 0
    for rows in ranges:
        sheet = source.read(_SHEET, *rows).astype(np.intp)
        residual = source.read("residual", *rows)
        fits += np.bincount(sheet, residual <= settings.max_residual, minlength=len(fits))
        count += np.bincount(sheet, minlength=len(count))
        keys.append(noise_keys(source.read("noise", *rows), sheet))
        n_unmapped += int(np.count_nonzero(~np.isfinite(residual)))
    medians = medians_of_sheets(np.concatenate(keys), sheets.n_sheets)
    noise = SheetNoise(medians, fits / np.maximum(count, 1))
    for rows in ranges:
        sheet = source.read(_SHEET, *rows).astype(np.intp)
        residual, place = source.read("residual", *rows), source.read(ROW, *rows)
        limit = noise.limits(residual, sheet, settings)
        limit[~np.isfinite(residual)] = limit_without(n_unmapped)
        photons.columns.put("slope", place, source.read("slope", *rows))
        photons.columns.put("limit", place, limit)
