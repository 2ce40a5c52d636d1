"""Division of elements where their images misplace light."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..._ext.estimation.envelope_images import measure
from ..._util.validation import Floats
from .borders import joined
from .elements import (
    NEW_NODES,
    PARTS,
    Elements,
    Patches,
    areas,
    first_corners,
    first_elements_at,
    luminances,
    nodes_of_neighbours,
    parts_at,
    patches_of,
    six_places,
)
from .lattice import MAX_LEVEL, Ids, Lattice
from .sheets import Points

# Share of the flux of a torn image that is taken to be misplaced: borders are cut.
_OF_TORN = 0.1
# Misplaced distance over the misfit of a parent, and over the bend where there is no parent. Images
# that bend by more than a share of their longest side, and a footprint, jump.
_RULES = {"of_misfit": 0.125, "of_bend": 0.25, "of_torn": _OF_TORN, "jump": 0.35}
# Rays that an element with torn images costs, at most, when their borders are cut.
_RAYS_OF_BORDER = 12
# Leaves divided in one pass have at least this share of the largest score.
_GREED = 0.05
# New nodes of a divided leaf, most of which it shares with neighbours.
_RAYS_OF_LEAF = 5


class Measures(NamedTuple):
    """Light of images, and how far it is misplaced.

    Attributes
    ----------
    flux, score : (p,) float64
        Luminance of each, and what of it is misplaced, W.
    jumps : (p,) bool
        Images whose nodes do not follow one smooth map.
    """

    flux: Floats
    score: Floats
    jumps: NDArray[np.bool_]

    def of(self, rows: NDArray) -> Measures:
        """Those of some rows."""
        return Measures(*(column[rows] for column in self))


class Refinement:
    """The elements of a chart, divided until little light is misplaced or rays are used up.

    Attributes
    ----------
    lattice : Lattice
    footprint : float
        Length that images are resolved to, m.
    leaves : Elements
    patches : Patches
        Images of the leaves.
    measures : Measures
        Of the images.
    missed : (n,) float64
        Luminance that leaves misplace of sheets that none of their nodes sees, but one of a
        neighbour on a side of theirs, and that of the first rays in parts of them that are not
        laid down, W.
    """

    def __init__(self, lattice: Lattice, footprint: float, n_threads: int) -> None:
        self.lattice, self.footprint, self._n_threads = lattice, footprint, n_threads
        corners = first_corners(lattice)
        self.leaves = self._elements(corners, np.zeros(len(corners), np.int8))
        self.patches = patches_of(lattice, self.leaves.nodes)
        self.measures = self._measures(self.leaves, self.patches, Patches.none())
        self._points = lattice.followed.points(lattice.chart, followed=True)
        self._leaf = first_elements_at(lattice, lattice.in_lattice(self._points.place))
        self.missed = self._missed()

    @property
    def score(self) -> float:
        """Luminance that is misplaced, W."""
        return float(self.measures.score.sum() + self.missed.sum())

    @property
    def luminance(self) -> float:
        """Luminance of the light of all images, W."""
        return float(self.measures.flux.sum())

    @property
    def n_rays_of_borders(self) -> int:
        """Rays that cutting borders would take."""
        torn = self.patches.element[~self.patches.is_whole]
        return _RAYS_OF_BORDER * len(np.unique(torn))

    def rays_of_borders(self, is_cut: NDArray[np.bool_]) -> int:
        """Rays that cutting those of some of the sheets that are followed (k,) would take."""
        torn = self.patches.element[~self.patches.is_whole & is_cut[self._numbers]]
        return _RAYS_OF_BORDER * len(np.unique(torn))

    @property
    def light_of_sheets(self) -> Floats:
        """Luminance (k, 2) of each sheet that is followed, all of it and that of rough images, W.

        What is missed is rough.
        """
        flux, is_rough = self.measures.flux, self.is_rough
        return np.column_stack([self._of_sheets(each) for each in (flux, flux * is_rough)])

    @property
    def misplaced_of_sheets(self) -> Floats:
        """Luminance (k,) of each sheet that is followed that is misplaced, W."""
        return self._of_sheets(self.measures.score)

    @property
    def is_rough(self) -> NDArray[np.bool_]:
        """(p,) true for images that are torn or jump."""
        return ~self.patches.is_whole | self.measures.jumps

    def _of_sheets(self, luminance: Floats) -> Floats:
        """Sums (k,) over the images of each sheet, and what is missed of it."""
        n, missed = len(self.lattice.followed.sheets), self.missed_points
        number = np.searchsorted(self.lattice.followed.sheets, missed.sheet)
        of_images = np.bincount(self._numbers, luminance, n).astype(np.float64)
        return of_images + np.bincount(number, luminances(missed.flux), n)

    def rough_elements(self, is_rough: NDArray[np.bool_]) -> NDArray[np.intp]:
        """Elements (k, 2) on which sheets are rough, all, and those where no other sheet is.

        `is_rough` (k,) are the sheets looked at, which the others are not.
        """
        number, n = self._numbers, len(self.lattice.followed.sheets)
        rough = self.is_rough
        others = self.patches.element[rough & ~is_rough[number]]
        alone = rough & ~np.isin(self.patches.element, others)
        return np.column_stack([np.bincount(number[each], minlength=n) for each in (rough, alone)])

    @property
    def _numbers(self) -> NDArray[np.intp]:
        """Rows (p,) of the images' sheets among those that are followed."""
        return np.searchsorted(self.lattice.followed.sheets, self.patches.sheet)

    @property
    def missed_points(self) -> Points:
        """Light of the first rays in parts of leaves of which no corner sees its sheet."""
        return self._points.of(self._is_missed)

    @property
    def _is_missed(self) -> NDArray[np.bool_]:
        """(k,) true for the light of the first rays that borders, if they are cut, leave out."""
        keys, wanted = self._keys, self._leaf_keys(self._leaf, self._points.sheet)
        image = np.minimum(np.searchsorted(keys, wanted), len(keys) - 1)
        corners = self.patches.arrival[image[:, np.newaxis], PARTS[self._part]]
        seen = (keys[image] == wanted) & (corners >= 0).any(axis=1)
        return ~seen

    @property
    def _part(self) -> Ids:
        """Parts (k,) of their leaves that the light of the first rays is from."""
        places = self.lattice.in_lattice(self._points.place)
        return parts_at(self.leaves.corners[self._leaf], places)

    @property
    def _keys(self) -> NDArray[np.intp]:
        """Numbers (p,), ascending, that tell leaves and sheets of images."""
        return self._leaf_keys(self.patches.element, self.patches.sheet)

    def _leaf_keys(self, leaf: Ids, sheet: NDArray[np.uint64]) -> NDArray[np.intp]:
        sheets = self.lattice.followed.sheets
        return leaf * len(sheets) + np.searchsorted(sheets, sheet)

    def drop_unfollowed(self) -> None:
        """Leave out images of sheets that are not followed any more."""
        rows = self.lattice.drop_unfollowed()
        kept = np.isin(self.patches.sheet, self.lattice.followed.sheets)
        patches = self.patches[kept]
        # The last row is that of nodes without an arrival.
        arrival = np.append(rows, -1)[patches.arrival]
        self.patches = Patches(patches.element, patches.sheet, arrival)
        self.measures = self.measures.of(kept)
        kept = np.isin(self._points.sheet, self.lattice.followed.sheets)
        self._points, self._leaf = self._points.of(kept), self._leaf[kept]
        self.missed = self._missed()

    def divide(self, misplaced: float, n_rays: float) -> bool:
        """Divide leaves of the largest scores once; false if there are none.

        Enough of them that the scores of the others sum to `misplaced`, no more than take `n_rays`
        new rays.
        """
        score = self.missed + np.bincount(
            self.patches.element, self.measures.score, len(self.leaves)
        )
        score[self.leaves.level >= MAX_LEVEL] = 0.0
        order = np.argsort(-score, kind="stable")
        left = score.sum() - np.cumsum(score[order])
        wanted = float(np.count_nonzero(left > misplaced) + 1)
        large = float(np.count_nonzero(score > _GREED * score.max(initial=0.0)))
        n = int(min(wanted, large, n_rays / _RAYS_OF_LEAF))
        if n <= 0:
            return False
        self._divide(np.sort(order[:n]))
        return True

    def _divide(self, rows: Ids) -> None:
        kept = np.ones(len(self.leaves), dtype=bool)
        kept[rows] = False
        of_parents = ~kept[self.patches.element]
        above = self.patches[of_parents]
        above = Patches(np.searchsorted(rows, above.element), above.sheet, above.arrival)
        leaves = self._elements(*self.leaves[rows].parts())
        patches = patches_of(self.lattice, leaves.nodes)
        measures = self._measures(leaves, patches, above)
        others = self.patches[~of_parents]
        number = np.cumsum(kept) - 1
        first = int(np.count_nonzero(kept))
        self._leaf = self._moved(rows, number, first)
        self.leaves = self.leaves[kept].joined(leaves)
        self.patches = Patches(
            np.concatenate([number[others.element], first + patches.element]),
            np.concatenate([others.sheet, patches.sheet]),
            np.concatenate([others.arrival, patches.arrival]),
        )
        self.measures = joined(Measures, [self.measures.of(~of_parents), measures])
        self.missed = self._missed()

    def _moved(self, rows: Ids, number: Ids, first: int) -> Ids:
        """Leaves (k,) of the first rays as leaves `rows` are divided, and others get new rows."""
        divided = np.isin(self._leaf, rows)
        part = first + 4 * np.searchsorted(rows, self._leaf) + self._part
        return np.where(divided, part, number[self._leaf])

    def _missed(self) -> Floats:
        """Luminance (n,) of sheets that leaves miss, W.

        As much as if images were torn where neighbours see them, and the light of the first rays,
        each of which stands for no more of the chart than its leaf has.
        """
        is_missed = self._is_missed
        leaf = self._leaf[is_missed]
        area = areas(self.lattice, self.leaves.corners[leaf])
        share = np.minimum(area * self.lattice.followed.n_scattered, 1.0)
        light = share * luminances(self._points.flux[is_missed])
        of_points = np.bincount(leaf, light, len(self.leaves))
        return (_OF_TORN * self._missed_of_neighbours() + of_points).astype(np.float64)

    def _missed_of_neighbours(self) -> Floats:
        """Luminance (n,) of sheets that a finer neighbour sees on a common side, W."""
        lattice = self.lattice
        leaf, node = nodes_of_neighbours(lattice, self.leaves.corners)
        count = lattice.count[node]
        leaf, ends = np.repeat(leaf, count), np.cumsum(count)
        arrival = np.repeat(lattice.first[node] - (ends - count), count)
        arrival += np.arange(len(arrival))
        keys = self._leaf_keys(leaf, lattice.arrivals.sheet[arrival])
        keys, first = np.unique(keys, return_index=True)
        first = first[~np.isin(keys, self._keys)]
        leaf = leaf[first]
        light = luminances(lattice.light[arrival[first]]) * areas(
            lattice, self.leaves.corners[leaf]
        )
        return np.bincount(leaf, light, len(self.leaves)).astype(np.float64)

    def _elements(self, corners: NDArray[np.int64], level: NDArray[np.int8]) -> Elements:
        places = six_places(corners).reshape(-1, 2)
        return Elements(corners, self.lattice.nodes(places).reshape(-1, 6), level)

    def _measures(self, leaves: Elements, patches: Patches, above: Patches) -> Measures:
        """Measures (p,) of images of leaves.

        `above` are the images of the elements that the leaves divide, four in sequence each.
        """
        arrivals, n = self.lattice.arrivals, len(patches)
        parent = np.full((n, 6), -1, dtype=np.intp)
        if len(above):
            known, rows = _parents(patches, above)
            parent[known] = above.arrival[rows]
        measures = Measures(np.empty(n), np.empty(n), np.empty(n, dtype=np.bool_))
        measure(
            *(arrivals.position, self.lattice.luminance, patches.arrival),
            *(areas(self.lattice, leaves.corners)[patches.element], parent, patches.element % 4),
            **_RULES,
            new_nodes=NEW_NODES,
            footprint=self.footprint,
            flux=measures.flux,
            score=measures.score,
            jumps=measures.jumps.view(np.uint8),
            n_threads=self._n_threads,
        )
        return measures


def _parents(patches: Patches, above: Patches) -> tuple[Ids, Ids]:
    """Rows of the whole images whose parents are whole, and of these among `above`."""
    sheets, rank = np.unique(np.concatenate([above.sheet, patches.sheet]), return_inverse=True)
    key = above.element * len(sheets) + rank[: len(above)]
    wanted = (patches.element // 4) * len(sheets) + rank[len(above) :]
    order = np.argsort(key)
    at = np.minimum(np.searchsorted(key[order], wanted), len(key) - 1)
    parent = order[at]
    known = np.flatnonzero(patches.is_whole & (key[parent] == wanted) & above.is_whole[parent])
    return known, parent[known]
