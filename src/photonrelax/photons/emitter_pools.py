"""Emitters whose photons have a structure of their own, and pools of those whose photons do not.

Photons of different emitters are not neighbours: what separates the sheets of one says nothing of
another's. But of a light of many emitters (LEDs, patches of a sky, triangles of a mesh) each has a
few photons, far apart among those of the others. Moved by one another they would leave the light,
and the noise of all together would stay. So an emitter's photons are by themselves only if

- they are at least as many as a neighbourhood has, and
- they make up at least a ninth of the photons around them, in the mean over them: then the radius
  that holds k of them is no more than three times that which holds k of any, the limit that
  `photonrelax.StructureSettings.reach_scale` puts on sheets of one emitter.

The photons of other emitters are pooled and relaxed in space alone, as those of one emitter without
coordinates: a light is the same however many emitters it is made of. As relaxing assumes photons of
equal flux, those in a pool differ by no more than a factor of four, in the means of the emitters.
Pools of less than a ninth of the photons around theirs stay where they are.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from .._ext.photons.normals import all_nearly_equal
from .._util.validation import Floats
from ..spatial.kdtree import KDTree
from .axes import MAX_NORMAL_CHORD, hstack_rows
from .coincidence import first_equal_rows, row_hashes
from .photon_map import PhotonMap

Numbers = NDArray[np.intp]

# Photons of a neighbourhood, and least number of an emitter that has a structure.
_K = 50
_LEAST_SHARE = 1 / 9
# Largest ratio between the fluxes of photons in a pool.
_FLUX_RATIO = 4.0
# Photons whose neighbours are counted: so many in all, and at least so many of each emitter.
_SAMPLE = 2048
_SAMPLE_OF_EMITTER = 2
# Photons among which that is done, where there are more: so many in all, and of each emitter.
_ENOUGH = 50_000
_ENOUGH_OF_EMITTER = 1000


class EmitterPools(NamedTuple):
    """Emitters by themselves, and pools.

    Attributes
    ----------
    number : (n,) intp array
        By photon: that of its emitter if that is by itself, else that of its pool.
    first_pool : int
        Number of the first pool.
    first_at_rest : int
        Number of the first of the pools that are not relaxed.
    """

    number: Numbers
    first_pool: int
    first_at_rest: int


class PoolNumbers(NamedTuple):
    """Number (emitters,) of each emitter or of its pool; the others as of `EmitterPools`."""

    number: Numbers
    first_pool: int
    first_at_rest: int


class Thinned(NamedTuple):
    """Some photons of a map, in its order: the columns that pools depend on.

    `emitter` (n,) is the place of each photon's emitter among those of the map.
    """

    position: Floats
    normal: Floats
    emitter: Numbers


class _Sample(NamedTuple):
    """Some photons and those around them.

    `rows` (s,) are theirs, `neighbours` (s, k) those around each, -1 for none, and `weight` (s,)
    is the number of photons that each stands for.
    """

    rows: Numbers
    neighbours: Numbers
    weight: Floats

    def shares(self, number: Numbers, n_numbers: int) -> Floats:
        """Mean share (n_numbers,) of photons of the same number around those of each number.

        `number` (n,) is that of all photons that the sample is of.
        """
        mine = number[self.rows]
        found = self.neighbours >= 0
        same = found & (number[self.neighbours] == mine[:, np.newaxis])
        # Without the photon itself.
        n_found = np.maximum(found.sum(axis=1) - 1, 1)
        share = (same.sum(axis=1) - 1) / n_found
        total = np.bincount(mine, self.weight * share, minlength=n_numbers)
        return total / np.maximum(np.bincount(mine, self.weight, minlength=n_numbers), 1.0)


def emitter_pools(photons: PhotonMap, n_threads: int) -> EmitterPools:
    """Emitters by themselves and pools of a map, which has emitter ids."""
    assert photons.emitter_id is not None, "photons have emitter ids"
    emitter, n_photons = _numbered(photons.emitter_id)
    thinned = Thinned(photons.position, photons.normal, emitter)
    kept = kept_by_thinning(photons.position, n_photons)
    if kept is not None:
        thinned = Thinned(photons.position[kept], photons.normal[kept], emitter[kept])

    def flux() -> Floats:
        return np.bincount(emitter, photons.flux.mean(axis=1)).astype(np.float64)

    numbers = pool_numbers(thinned, n_photons, flux, n_threads=n_threads)
    return EmitterPools(numbers.number[emitter], numbers.first_pool, numbers.first_at_rest)


def kept_by_thinning(position: Floats, n_photons: Numbers) -> NDArray[np.bool_] | None:
    """Mask (n,) of the photons from which pools are found, None for all.

    They are chosen by their positions: whatever their order, and together where they coincide.
    `n_photons` (emitters,) are those of the whole map.
    """
    share = min(int(n_photons.sum()) // _ENOUGH, int(n_photons.min()) // _ENOUGH_OF_EMITTER)
    if share <= 1:
        return None
    kept: NDArray[np.bool_] = row_hashes(position) % np.uint64(share) == 0
    return kept


def pool_numbers(
    thinned: Thinned, n_photons: Numbers, flux: Callable[[], Floats], *, n_threads: int
) -> PoolNumbers:
    """Numbers of the emitters by themselves, and of pools.

    Parameters
    ----------
    thinned : Thinned
        The photons that are kept by thinning.
    n_photons : (emitters,) intp array
        Of the whole map.
    flux : callable
        Returns the sums (emitters,) of the flux of all photons, the mean of their channels.
    n_threads : int
    """
    n_emitters = len(n_photons)
    sample = _sampled(thinned, n_photons, n_threads)
    weak = (n_photons < _K) | (sample.shares(thinned.emitter, n_emitters) < _LEAST_SHARE)
    number = np.arange(n_emitters)
    if not weak.any():
        return PoolNumbers(number, n_emitters, n_emitters)
    # That of few photons of pure colours may be negative.
    mean_flux = np.abs(flux()) / n_photons
    number[weak] = n_emitters + _similar(mean_flux[weak])
    n_numbers = number.max() + 1
    share = sample.shares(number[thinned.emitter], n_numbers)[n_emitters:]
    # Pools at rest are the last.
    at_rest = share < _LEAST_SHARE
    renumbered = np.empty(len(share), dtype=np.intp)
    renumbered[np.argsort(at_rest, kind="stable")] = np.arange(len(share))
    number[weak] = n_emitters + renumbered[number[weak] - n_emitters]
    return PoolNumbers(number, n_emitters, n_numbers - int(at_rest.sum()))


def _numbered(emitter_id: NDArray[np.int32]) -> tuple[Numbers, Numbers]:
    """Number (n,) of each photon's emitter, from 0, and numbers of photons (e,)."""
    first = int(emitter_id.min())
    if int(emitter_id.max()) - first > len(emitter_id):
        _, number, counts = np.unique(emitter_id, return_inverse=True, return_counts=True)
        return number, counts
    # Without a sort.
    index = emitter_id - np.int64(first)
    counts = np.bincount(index)
    return (np.cumsum(counts > 0) - 1)[index], counts[counts > 0]


def _similar(flux: Floats) -> Numbers:
    """Number (e,) for each flux, the same for those within a factor of `_FLUX_RATIO`."""
    number = np.full(len(flux), -1, dtype=np.intp)
    n_numbers = 0
    while (number < 0).any():
        rest = number < 0
        number[rest & (flux >= flux[rest].max() / _FLUX_RATIO)] = n_numbers
        n_numbers += 1
    return number


def _sampled(thinned: Thinned, n_photons: Numbers, n_threads: int) -> _Sample:
    """Photons spread evenly over those of each emitter, and over all of emitters that have few."""
    tree, rows = _tree(thinned, n_threads)
    ordered = rows[np.asarray(tree.kernel.ids)]
    unit = np.where(n_photons < _K, 0, 1 + np.arange(len(n_photons)))
    place, weight = _spread(unit[thinned.emitter[ordered]])
    lanes = np.asarray(tree.kernel.coords)
    block = lanes.shape[2]
    found = tree.query(
        lanes[place // block, :, place % block],
        _K,
        range_radius=MAX_NORMAL_CHORD if tree.n_axes > tree.n_metric else None,
        n_threads=n_threads,
    )
    neighbours = np.append(rows, -1)[found.ids]
    return _Sample(ordered[place], neighbours, weight)


def _tree(thinned: Thinned, n_threads: int) -> tuple[KDTree, Numbers]:
    """Tree of photons, normals on range axes unless all are equal, and their rows.

    An emitter's photons at the same point count as one.
    """
    columns = [thinned.position]
    if not all_nearly_equal(thinned.normal, None):
        columns.append(thinned.normal)
    rows = np.arange(len(thinned.position))
    points = hstack_rows(columns, [1.0] * len(columns), slice(None), n_threads)
    tree = KDTree(points, 3, n_threads=n_threads)
    first = None
    if tree.kernel.may_coincide:
        first = first_equal_rows([thinned.position, thinned.emitter])
    if first is not None:
        rows = np.unique(first)
        points = hstack_rows(columns, [1.0] * len(columns), rows, n_threads)
        tree = KDTree(points, 3, n_threads=n_threads)
    return tree, rows


def _spread(unit: Numbers) -> tuple[Numbers, Floats]:
    """Places (s,) spread evenly over those of each number (n,), and how many each stands for."""
    count = np.bincount(unit)
    order = np.argsort(unit.astype(np.min_scalar_type(len(count))), kind="stable")
    each = max(_SAMPLE // int(np.count_nonzero(count)), _SAMPLE_OF_EMITTER)
    stride = -(-count // each)
    unit = unit[order]
    rank = np.arange(len(unit)) - (np.cumsum(count) - count)[unit]
    chosen = np.flatnonzero(rank % np.maximum(stride, 1)[unit] == 0)
    return order[chosen], stride[unit[chosen]].astype(np.float64)
