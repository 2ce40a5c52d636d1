"""PhotonMap: the frozen arrays every stage after tracing takes and returns.

A map may come from any renderer: only position, normal and flux are required.
"""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ._arrays import Floats, are_unit, count, float_array, int_array, unit_vectors
from ._files import NOT_READABLE, whole_file

Ints = NDArray[np.int64]

FORMAT_VERSION = 1
# What can become of emitted flux; with "emitted" before them, the rows of an EnergyLedger.
FATES = ("stored", "absorbed", "escaped", "cut", "discarded")


@dataclass(frozen=True, eq=False)
class EnergyLedger:
    """What became of the flux each emitter sent out; emitted is the sum of the others.

    Attributes
    ----------
    emitted : (n_emitters, 3) float64
        Flux of all paths started, W.
    stored : (n_emitters, 3) float64
        Flux that stayed where a photon was stored: all of it where the path ends there, otherwise
        what came in less what travels on (a path that wins at roulette may take more than came).
    absorbed : (n_emitters, 3) float64
        Flux lost to mirrors and to absorbing media.
    escaped : (n_emitters, 3) float64
        Flux that left the scene.
    cut : (n_emitters, 3) float64
        Flux still under way after `max_bounces` events.
    discarded : (n_emitters, 3) float64
        Flux that stayed on a diffuse surface as light of a kind that was not asked for.
    ends : mapping of str to (n_emitters,) int64
        For each of stored, absorbed, escaped, cut, discarded: how many paths ended so.
    """

    emitted: Floats
    stored: Floats
    absorbed: Floats
    escaped: Floats
    cut: Floats
    discarded: Floats
    ends: Mapping[str, Ints]

    def __post_init__(self) -> None:
        shape = (len(self.emitted), 3)
        for name in ("emitted", *FATES):
            _set(self, name, _frozen(float_array(getattr(self, name), name, shape)))
        if set(self.ends) != set(FATES):
            raise ValueError(f"ends should have the keys {FATES}, but has {tuple(self.ends)}")
        ends = {k: _frozen(int_array(self.ends[k], f"ends[{k!r}]", shape[:1])) for k in FATES}
        _set(self, "ends", ends)

    @property
    def imbalance(self) -> float:
        """Largest difference between emitted and accounted flux, relative to the emitted."""
        accounted = np.sum([getattr(self, name) for name in FATES], axis=0)
        scale = np.maximum(self.emitted, np.finfo(np.float64).tiny)
        return float((np.abs(self.emitted - accounted) / scale).max(initial=0.0))

    def to_dict(self) -> dict[str, Any]:
        """Return plain lists and numbers, for JSON."""
        flux = {name: getattr(self, name).tolist() for name in ("emitted", *FATES)}
        return {**flux, "ends": {name: self.ends[name].tolist() for name in FATES}}


@dataclass(frozen=True, eq=False)
class PhotonMap:
    """Photons as arrays, one row each; the arrays are read-only.

    Parameters
    ----------
    position : (n, 3) array_like
        Where the photon landed, m.
    normal : (n, 3) array_like
        Geometric normal of the surface on the side the light came from; stored as unit vectors.
    flux : (n, 3) or (n,) array_like
        W, already divided by the number of photons emitted; one column stands for grey.
    wi : (n, 3) array_like, optional
        From the surface toward where the light came from; stored as unit vectors.
    emitter_coords : (n, 2) or (n, 3) array_like, optional
        Where the photon left its emitter: m on the emitter plane, or a unit vector (SJ13 §4.1).
    emitter_density : (n,) array_like, optional
        Photons emitted per unit of emitter area (m² or sr) around those coordinates.
    emitter_id, object_id : (n,) array_like of int, optional
        Index of the emitter in the scene, and of the object the photon lies on.
    path_signature : (n,) array_like of int, optional
        One number for the surfaces and events of the path.
    n_bounces : (n,) array_like of int, optional
        Specular events before the deposit.
    path_length : (n,) array_like, optional
        Length of the path from the emitter, m.
    spectrum : (n, 3) array_like, optional
        (e, b, c) of the local spectrum of light, in cycles²/m², cycles²/rad², cycles²/(m rad), as
        in `photonrelax.spectrum`; rows of NaN for photons that carry none.
    n_emitted : int, optional
        Paths started to make this map.
    well_spaced : bool
        Photons are evenly spaced within each sheet of rays (Halton or relaxed), not independent.
    ledger : EnergyLedger, optional
        What became of the emitted flux.
    seed, sampler, paths : int, str, str, optional
        How the map was traced; see `trace_photons`.

    Raises
    ------
    TypeError, ValueError
        If an array has the wrong type or shape, is not finite, flux or density is negative, or a
        direction is zero.
    """

    position: Floats
    normal: Floats
    flux: Floats
    wi: Floats | None = None
    emitter_coords: Floats | None = None
    emitter_density: Floats | None = None
    emitter_id: NDArray[np.int32] | None = None
    path_signature: Ints | None = None
    n_bounces: NDArray[np.int32] | None = None
    path_length: Floats | None = None
    object_id: NDArray[np.int32] | None = None
    spectrum: Floats | None = None
    n_emitted: int | None = None
    well_spaced: bool = False
    ledger: EnergyLedger | None = None
    seed: int | None = None
    sampler: str | None = None
    paths: str | None = None

    def __post_init__(self) -> None:
        position = float_array(self.position, "position", (None, 3))
        n = len(position)
        _set(self, "position", _frozen(position))
        _set(self, "normal", _directions(self.normal, "normal", n))
        _set(self, "flux", _flux(self.flux, n))
        if self.wi is not None:
            _set(self, "wi", _directions(self.wi, "wi", n))
        if self.emitter_coords is not None:
            _set(self, "emitter_coords", _emitter_coords(self.emitter_coords, n))
        for name in ("emitter_density", "path_length"):
            if getattr(self, name) is not None:
                _set(self, name, _not_negative(getattr(self, name), name, (n,)))
        if self.spectrum is not None:
            _set(self, "spectrum", _spectrum(self.spectrum, n))
        for name, dtype in _INTEGER_FIELDS.items():
            if getattr(self, name) is not None:
                _set(self, name, _frozen(int_array(getattr(self, name), name, (n,), dtype)))
        if self.n_emitted is not None:
            _set(self, "n_emitted", count(self.n_emitted, "n_emitted", low=0))
        _set(self, "well_spaced", bool(self.well_spaced))
        if self.seed is not None:
            _set(self, "seed", count(self.seed, "seed", low=0))

    def __len__(self) -> int:
        return len(self.position)

    def __repr__(self) -> str:
        given = [name for name in _ARRAY_FIELDS if getattr(self, name) is not None]
        return f"PhotonMap({len(self)} photons: {', '.join(given)}; n_emitted={self.n_emitted})"

    def replace(self, **changes: Any) -> PhotonMap:
        """Return a map with some fields changed."""
        return replace(self, **changes)

    def subset(self, index: ArrayLike | slice) -> PhotonMap:
        """Return the photons chosen by a mask, an array of indices or a slice.

        The flux of each photon, `n_emitted` and the ledger stay as they are.
        """
        chosen = index if isinstance(index, slice) else np.asarray(index)
        if isinstance(chosen, np.ndarray) and chosen.size == 0 and chosen.dtype != bool:
            chosen = chosen.astype(np.intp)
        if isinstance(chosen, np.ndarray) and chosen.dtype == bool and chosen.shape != (len(self),):
            raise ValueError(f"index should be a mask of {len(self)}, but has shape {chosen.shape}")
        rows = {
            name: getattr(self, name)[chosen]
            for name in _ARRAY_FIELDS
            if getattr(self, name) is not None
        }
        return replace(self, **rows)

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the map as an ``.npz`` file, whole or not at all."""
        arrays: dict[str, Any] = {
            name: getattr(self, name) for name in _ARRAY_FIELDS if getattr(self, name) is not None
        }
        arrays["photonmap_version"] = FORMAT_VERSION
        for name in _SCALARS:
            if getattr(self, name) is not None:
                arrays[name] = getattr(self, name)
        if self.ledger is not None:
            arrays.update(_ledger_arrays(self.ledger))
        _write_npz(Path(path), arrays)

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> PhotonMap:
        """Read a map written by `save`.

        Raises
        ------
        ValueError
            If the file is not a photon map, or one of another version.
        """
        arrays = _read_npz(Path(path))
        known: dict[str, Any] = {
            name: _read_only(arrays[name]) for name in _ARRAY_FIELDS if name in arrays
        }
        try:
            scalars = {name: _scalar(arrays, name, kinds) for name, kinds in _SCALARS.items()}
            return cls(
                **known,
                **scalars | {"well_spaced": bool(scalars["well_spaced"])},
                ledger=_ledger_from(arrays) if "ledger_emitted" in arrays else None,
            )
        except (TypeError, ValueError) as error:
            raise ValueError(f"{path} is not a photon map: {error}") from None


_INTEGER_FIELDS: dict[str, type] = {
    "emitter_id": np.int32,
    "path_signature": np.int64,
    "n_bounces": np.int32,
    "object_id": np.int32,
}
# Fields with one value, and the kinds of dtype it is saved with.
_SCALARS = {"n_emitted": "iu", "well_spaced": "b", "seed": "iu", "sampler": "U", "paths": "U"}
_KIND_NAMES = {"iu": "integer", "b": "truth value", "U": "text"}
_ARRAY_FIELDS = tuple(f.name for f in fields(PhotonMap) if f.name not in (*_SCALARS, "ledger"))


class NothingStoredError(ValueError):
    """No photon was stored; `photons` is the empty map with its ledger."""

    def __init__(self, message: str, photons: PhotonMap) -> None:
        super().__init__(message)
        self.photons = photons


def _set(instance: object, name: str, value: object) -> None:
    object.__setattr__(instance, name, value)


def _frozen(array: NDArray) -> NDArray:
    """Return a read-only array that nobody else can write to; copies only if somebody could."""
    owner = array if array.base is None else array.base
    if not isinstance(owner, np.ndarray) or owner.flags.writeable:
        array = array.copy()
    return _read_only(array)


def _read_only(array: NDArray) -> NDArray:
    array.setflags(write=False)
    return array


def _directions(value: ArrayLike, name: str, n: int) -> Floats:
    array = float_array(value, name, (n, 3))
    # Leaving unit vectors untouched keeps saving, loading and replacing bit-exact.
    if not are_unit(array):
        array = unit_vectors(array, name, (n, 3))
    return _frozen(array)


def _not_negative(value: ArrayLike, name: str, shape: tuple[int, ...]) -> Floats:
    array = float_array(value, name, shape)
    if array.min(initial=0.0) < 0.0:
        raise ValueError(f"{name} should not be negative, but its least value is {array.min()}")
    return _frozen(array)


def _flux(value: ArrayLike, n: int) -> Floats:
    array = np.asarray(value)
    if array.ndim == 1:
        array = np.repeat(array[:, np.newaxis], 3, axis=1)
    return _not_negative(array, "flux", (n, 3))


def _emitter_coords(value: ArrayLike, n: int) -> Floats:
    array = float_array(value, "emitter_coords", (n, None))
    if array.shape[1] not in (2, 3):
        raise ValueError(f"emitter_coords should have 2 or 3 columns, but has {array.shape[1]}")
    return _frozen(array)


def _spectrum(value: ArrayLike, n: int) -> Floats:
    array = float_array(value, "spectrum", (n, 3), finite=False)
    known = ~np.isnan(array)
    if not (known.all(axis=1) | ~known.any(axis=1)).all():
        raise ValueError("spectrum should have rows of numbers or of NaN, but has one of both")
    if np.isinf(array).any() or (array[:, :2] < 0.0).any():
        raise ValueError("spectrum should be finite and e and b not negative, but are not")
    return _frozen(array)


def _ledger_arrays(ledger: EnergyLedger) -> dict[str, NDArray]:
    flux = {f"ledger_{name}": getattr(ledger, name) for name in ("emitted", *FATES)}
    return flux | {f"ledger_ends_{name}": ledger.ends[name] for name in FATES}


def _ledger_from(arrays: Mapping[str, NDArray]) -> EnergyLedger:
    columns = [f"ledger_{name}" for name in FATES] + [f"ledger_ends_{name}" for name in FATES]
    _check_names(arrays, columns)
    return EnergyLedger(
        **{name: arrays[f"ledger_{name}"] for name in ("emitted", *FATES)},
        ends={name: arrays[f"ledger_ends_{name}"] for name in FATES},
    )


def _write_npz(path: Path, arrays: Mapping[str, Any]) -> None:
    with whole_file(path) as partial, partial.open("wb") as file:
        np.savez(file, **arrays)


def _read_npz(path: Path) -> dict[str, NDArray]:
    try:
        with path.open("rb") as stream, np.load(stream, allow_pickle=False) as file:
            # What is no array in the archive comes as bytes.
            arrays = {name: np.asarray(file[name]) for name in file.files}
        _check_names(arrays, ["photonmap_version"])
        version = _scalar(arrays, "photonmap_version", "iu")
        if version == FORMAT_VERSION:
            _check_names(arrays, ["position", "normal", "flux"])
    except NOT_READABLE as error:
        raise ValueError(f"{path} is not a photon map: {error}") from None
    if version != FORMAT_VERSION:
        raise ValueError(
            f"{path} should be a photon map of version {FORMAT_VERSION}, "
            f"but is of version {version}"
        )
    return arrays


def _check_names(arrays: Mapping[str, NDArray], names: Sequence[str]) -> None:
    missing = [name for name in names if name not in arrays]
    if missing:
        raise ValueError(f"it has no {', '.join(missing)}")


def _scalar(arrays: Mapping[str, NDArray], name: str, kinds: str) -> Any:
    """Return one value, None where there is none."""
    if name not in arrays:
        return None
    array = arrays[name]
    if array.shape != () or array.dtype.kind not in kinds:
        raise ValueError(
            f"{name} should be one {_KIND_NAMES[kinds]}, "
            f"but has shape {array.shape} and dtype {array.dtype}"
        )
    return array.item()
