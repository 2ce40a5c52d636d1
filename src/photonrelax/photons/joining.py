"""Photon maps of several maps: parts of one emission joined, independent maps averaged."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise
from math import fsum
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from .._util.validation import Floats
from .energy_ledger import PATH_OUTCOMES, EnergyLedger

if TYPE_CHECKING:
    from .photon_map import PhotonMap

Columns = dict[str, list[NDArray]]
"""Those of several maps, by the fields that all of them have."""

# Fields that the parts of an emission share.
_OF_EMISSION = ("n_emitted", "seed", "sampler", "paths")


def concatenate(maps: Sequence[PhotonMap], names: Sequence[str]) -> PhotonMap:
    """Parts of one emission as one map with columns of some names."""
    parts = sorted(maps, key=lambda part: _ranges(part)[0, 0])
    _check_one_emission(parts)
    ranges = _merged(np.concatenate([_ranges(part) for part in parts]))
    columns = _columns(parts, names)
    if len(columns) < sum(getattr(parts[0], name) is not None for name in names):
        raise ValueError("maps should have the same arrays, but some are missing in some of them")
    return _joined(
        parts[0],
        columns,
        names,
        well_spaced=len(ranges) == 1 and all(part.well_spaced for part in parts),
        ledger=summed([part.ledger for part in parts]),
        emitted_ranges=ranges,
    )


def average(maps: Sequence[PhotonMap], names: Sequence[str]) -> PhotonMap:
    """Independent maps of one scene as one map with columns of some names."""
    _check_independent(maps)
    columns = _columns(maps, names)
    columns["flux"] = [flux / len(maps) for flux in columns["flux"]]
    numbers = [each.n_emitted for each in maps if each.n_emitted]
    n_emitted = sum(numbers) if len(numbers) == len(maps) else None
    densities = columns.pop("emitter_density", None)
    if densities is not None and n_emitted is not None:
        pairs = zip(densities, numbers, strict=True)
        columns["emitter_density"] = [density * (n_emitted / n) for density, n in pairs]
    ledger = summed([each.ledger for each in maps])
    return _joined(
        maps[0],
        columns,
        names,
        n_emitted=n_emitted,
        seed=None,
        well_spaced=False,
        ledger=None if ledger is None else _divided(ledger, len(maps)),
    )


def _joined(first: PhotonMap, columns: Columns, names: Sequence[str], **values: Any) -> PhotonMap:
    arrays: dict[str, Any] = dict.fromkeys(names)
    for name, parts in columns.items():
        # In place of copies that `PhotonMap` would make of arrays that may still be written.
        arrays[name] = np.concatenate(parts)
        arrays[name].setflags(write=False)
    return replace(first, **arrays, **values)


def _columns(maps: Sequence[PhotonMap], names: Sequence[str]) -> Columns:
    columns = {name: [getattr(each, name) for each in maps] for name in names}
    return {
        name: parts for name, parts in columns.items() if all(part is not None for part in parts)
    }


def _ranges(part: PhotonMap) -> NDArray[np.int64]:
    """Ranges (m, 2) of the photons of an emission that a map is of."""
    if part.emitted_ranges is not None:
        return part.emitted_ranges
    if part.n_emitted is None or part.seed is None:
        raise ValueError(
            "maps should be parts of an emission whose seed and number are known, but one is not: "
            "trace them by trace_photons(photons=range(a, b)); PhotonMap.average takes any"
        )
    return np.array([[0, part.n_emitted]])


def _check_one_emission(parts: Sequence[PhotonMap]) -> None:
    for name in _OF_EMISSION:
        values = {getattr(part, name) for part in parts}
        if len(values) > 1:
            raise ValueError(
                f"maps should be parts of one emission, but {name} differs: "
                f"{', '.join(map(repr, sorted(values, key=str)))}; PhotonMap.average takes maps "
                "of several"
            )
    _check_same_emitters(parts)
    for one, other in pairwise(parts):
        (_, stop), start = _ranges(one)[-1], _ranges(other)[0, 0]
        if start < stop:
            raise ValueError(
                "maps should be of ranges apart from one another, but one of them goes on to "
                f"photon {stop} and another starts at {start}"
            )


def _check_independent(maps: Sequence[PhotonMap]) -> None:
    if any(each.emitted_ranges is not None for each in maps):
        raise ValueError(
            "maps should be of whole emissions, but one is of a range of photons: join those of "
            "one emission by PhotonMap.concatenate first"
        )
    if len({each.paths for each in maps}) > 1:
        raise ValueError("maps should be of the same kind of light, but their paths differ")
    _check_same_emitters(maps)
    known = [(each.seed, each.n_emitted) for each in maps if each.seed is not None]
    if len(set(known)) < len(known):
        raise ValueError(
            "maps should be independent, but two have the same seed and number of photons: trace "
            "each with a seed of its own"
        )


def _check_same_emitters(maps: Sequence[PhotonMap]) -> None:
    """Raise ValueError if the maps cannot be of one scene."""
    ledgers = {None if each.ledger is None else len(each.ledger.emitted) for each in maps}
    lists = {_id_lists(each) for each in maps}
    scenes = {each.scene_digest for each in maps}
    spectral = {(each.wavelength is None, each.n_wavelengths) for each in maps}
    if max(len(ledgers), len(lists), len(spectral), len(scenes)) > 1:
        raise ValueError(
            "maps should be of one scene, but their ledgers, sensors, extended emitters, "
            "wavelengths or digests of the scene differ"
        )


def _id_lists(photons: PhotonMap) -> tuple[tuple[int, ...] | None, ...]:
    lists = (photons.sensor_ids, photons.extended_ids)
    return tuple(None if ids is None else tuple(ids.tolist()) for ids in lists)


def _merged(ranges: NDArray[np.int64]) -> NDArray[np.int64]:
    """Ascending ranges (m, 2) with those that join as one."""
    starts = np.concatenate([[True], ranges[1:, 0] > ranges[:-1, 1]])
    ends = np.concatenate([starts[1:], [True]])
    return np.column_stack([ranges[starts, 0], ranges[ends, 1]])


def summed(ledgers: Sequence[EnergyLedger | None]) -> EnergyLedger | None:
    """Sum of the ledgers of parts, of those that are known."""
    known = [ledger for ledger in ledgers if ledger is not None]
    if not known:
        return None
    flux = {name: _sum([getattr(each, name) for each in known]) for name in _FLUX}
    ends = {name: np.sum([each.ends[name] for each in known], axis=0) for name in PATH_OUTCOMES}
    return EnergyLedger(**flux, ends=ends)


def _divided(ledger: EnergyLedger, n: int) -> EnergyLedger:
    """A ledger with the n-th part of its flux; paths are counted as they are."""
    return replace(ledger, **{name: getattr(ledger, name) / n for name in _FLUX})


def _sum(arrays: Sequence[Floats]) -> Floats:
    """Correctly rounded sum, which does not depend on the order."""
    columns = np.reshape(arrays, (len(arrays), -1)).T
    return np.reshape([fsum(column) for column in columns], arrays[0].shape)


_FLUX = ("emitted", *PATH_OUTCOMES)
