"""Photon maps: frozen arrays that every stage after tracing takes and returns.

A map may come from any renderer: only position, normal and flux are required.
"""

from __future__ import annotations

import os
from collections.abc import Iterable
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .._util.frozen import Ints, frozen, read_only, set_field
from .._util.npz import check_names, read_npz, scalar, write_npz
from .._util.validation import (
    Floats,
    are_unit,
    check_magnitude,
    check_not_negative,
    check_seed,
    count,
    float_array,
    int_array,
    not_negative,
    unit_vectors,
)
from . import joining
from .energy_ledger import LEDGER_NAMES, EnergyLedger, ledger_arrays, ledger_from

FORMAT_VERSION = 1
"""Version of files of white light."""
DISPERSED_VERSION = 2
"""Version of files of photons with wavelengths."""


@dataclass(frozen=True, eq=False)
class PhotonMap:
    """Photons as arrays, one row each; the arrays are read-only.

    Parameters
    ----------
    position : (n, 3) array_like
        On the surface the photon is stored on, m.
    normal : (n, 3) array_like
        Geometric normal of the surface on the side the light came from; stored as unit vectors.
    flux : (n, 3) or (n,) array_like
        W, already divided by the number of photons emitted; one column stands for grey.
    wi : (n, 3) array_like, optional
        Incident direction, from the surface towards the light; stored as unit vectors.
    emitter_coords : (n, 2) or (n, 3) array_like, optional
        Emitter coordinates: m on the emitter plane, or a unit vector (SJ13 §4.1).
    emitter_density : (n,) array_like, optional
        Photons emitted per unit of emitter area (m² or sr) around those coordinates.
    emitter_id, object_id : (n,) array_like of int, optional
        Index of the emitter in the scene, and of the object the photon lies on.
    path_signature : (n,) array_like of int, optional
        Hash of the surfaces and events of the path.
    n_bounces : (n,) array_like of int, optional
        Specular events before the deposit.
    path_length : (n,) array_like, optional
        Length of the path from the emitter, m.
    spectrum : (n, 3) array_like, optional
        (e, b, c) of the local frequency spectrum of the light, in cycles²/m², cycles²/rad² and
        cycles²/(m rad), see `photonrelax.transport.frequency.operators`; rows of NaN for none.
    wavelength : (n,) array_like, optional
        nm, zero of white light. Where it is not zero, flux has the colour of the wavelength, of
        which a component may be negative.
    n_emitted : int, optional
        Paths started to make this map.
    well_spaced : bool
        Photons are evenly spaced within each sheet of rays (Halton or relaxed), not independent.
    ledger : EnergyLedger, optional
        Balance of the emitted flux.
    seed, sampler, paths : int, str, str, optional
        Arguments of `trace_photons`.
    sensor_ids : (m,) array_like of int, optional
        Those of the objects that are sensors, ascending. Photons on them are stored again where
        their paths go on to.
    extended_ids : (m,) array_like of int, optional
        Those of the emitters that are extended, ascending: many of their rays have the same
        emitter coordinates.
    n_wavelengths : int, optional
        Wavelengths into which a path is dispersed, each with a photon in the mean; 1 by default.
    emitted_ranges : (m, 2) array_like of int, optional
        Starts and stops of the photons emitted, by index among all `n_emitted`, whose paths were
        traced, ascending; None, as also if they join to all, for a whole emission.
    scene_digest : str, optional
        Digest of the objects and emitters of the scene; its camera and names do not count.

    Raises
    ------
    TypeError, ValueError
        If an array has the wrong type or shape, is not finite, a direction is zero, flux (of white
        light), density, length, wavelength or number of bounces is negative, or position, flux or
        coordinates exceed 1e150.
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
    wavelength: Floats | None = None
    n_emitted: int | None = None
    well_spaced: bool = False
    ledger: EnergyLedger | None = None
    seed: int | None = None
    sampler: str | None = None
    paths: str | None = None
    sensor_ids: NDArray[np.int32] | None = None
    extended_ids: NDArray[np.int32] | None = None
    n_wavelengths: int | None = None
    emitted_ranges: Ints | None = None
    scene_digest: str | None = None

    if TYPE_CHECKING:
        # What may be given is wider than what the fields then hold.
        def __init__(  # noqa: PLR0913
            self,
            position: ArrayLike,
            normal: ArrayLike,
            flux: ArrayLike,
            wi: ArrayLike | None = None,
            emitter_coords: ArrayLike | None = None,
            *,
            emitter_density: ArrayLike | None = None,
            emitter_id: ArrayLike | None = None,
            path_signature: ArrayLike | None = None,
            n_bounces: ArrayLike | None = None,
            path_length: ArrayLike | None = None,
            object_id: ArrayLike | None = None,
            spectrum: ArrayLike | None = None,
            wavelength: ArrayLike | None = None,
            n_emitted: int | None = None,
            well_spaced: bool = False,
            ledger: EnergyLedger | None = None,
            seed: int | None = None,
            sampler: str | None = None,
            paths: str | None = None,
            sensor_ids: ArrayLike | None = None,
            extended_ids: ArrayLike | None = None,
            n_wavelengths: int | None = None,
            emitted_ranges: ArrayLike | None = None,
            scene_digest: str | None = None,
        ) -> None: ...

    def __post_init__(self) -> None:
        position = float_array(self.position, "position", (None, 3), finite=False)
        check_magnitude(position, "position")
        n = len(position)
        set_field(self, "position", frozen(position))
        set_field(self, "normal", _directions(self.normal, "normal", n))
        if self.wavelength is not None:
            set_field(self, "wavelength", frozen(not_negative(self.wavelength, "wavelength", (n,))))
        set_field(self, "flux", _flux(self.flux, self.wavelength, n))
        if self.wi is not None:
            set_field(self, "wi", _directions(self.wi, "wi", n))
        if self.emitter_coords is not None:
            set_field(self, "emitter_coords", _emitter_coords(self.emitter_coords, n))
        for name in ("emitter_density", "path_length"):
            if getattr(self, name) is not None:
                set_field(self, name, frozen(not_negative(getattr(self, name), name, (n,))))
        if self.spectrum is not None:
            set_field(self, "spectrum", _spectrum(self.spectrum, n))
        for name, dtype in _INTEGER_FIELDS.items():
            if getattr(self, name) is not None:
                set_field(self, name, frozen(int_array(getattr(self, name), name, (n,), dtype)))
        if self.n_bounces is not None and self.n_bounces.min(initial=0) < 0:
            raise ValueError(f"n_bounces should not be negative, but one is {self.n_bounces.min()}")
        self._check_scalars()

    def _check_scalars(self) -> None:
        for name in _ID_LISTS:
            if getattr(self, name) is not None:
                ids = int_array(getattr(self, name), name, (None,), np.int32)
                set_field(self, name, frozen(np.unique(ids)))
        for name, low in (("n_emitted", 0), ("n_wavelengths", 1)):
            if getattr(self, name) is not None:
                set_field(self, name, count(getattr(self, name), name, low=low))
        if self.emitted_ranges is not None:
            set_field(self, "emitted_ranges", _emitted_ranges(self.emitted_ranges, self.n_emitted))
        set_field(self, "well_spaced", bool(self.well_spaced))
        if self.seed is not None:
            set_field(self, "seed", check_seed(self.seed))
        for name in ("sampler", "paths", "scene_digest"):
            if not isinstance(getattr(self, name), str | None):
                raise TypeError(f"{name} should be text, but is {getattr(self, name)!r}")

    def __len__(self) -> int:
        return len(self.position)

    @property
    def on_sensor(self) -> NDArray[np.bool_]:
        """Mask (n,) of the photons that are on sensors."""
        if self.sensor_ids is None or self.object_id is None:
            return np.zeros(len(self), dtype=bool)
        return np.isin(self.object_id, self.sensor_ids)

    @property
    def is_of_extended(self) -> NDArray[np.bool_]:
        """Mask (n,) of the photons of extended emitters."""
        if self.extended_ids is None or self.emitter_id is None:
            return np.zeros(len(self), dtype=bool)
        return np.isin(self.emitter_id, self.extended_ids)

    @property
    def photons_per_path(self) -> float:
        """Photons that one of white light is dispersed into, in the mean over those of the map."""
        if self.wavelength is None or self.n_wavelengths is None or not len(self):
            return 1.0
        n_dispersed = np.count_nonzero(self.wavelength)
        n_paths = len(self) - n_dispersed + n_dispersed / self.n_wavelengths
        return len(self) / n_paths

    def counted(self, k: int) -> int:
        """Number of photons that come of k of white light."""
        return round(k * self.photons_per_path)

    def __repr__(self) -> str:
        given = [name for name in ARRAY_FIELDS if getattr(self, name) is not None]
        return f"PhotonMap({len(self)} photons: {', '.join(given)}; n_emitted={self.n_emitted})"

    def replace(self, **changes: Any) -> PhotonMap:
        """Return a map with some fields changed."""
        return replace(self, **changes)

    def subset(self, index: ArrayLike | slice) -> PhotonMap:
        """Return the photons selected by a mask, an array of indices or a slice.

        The flux of each photon, `n_emitted` and the ledger stay as they are.
        """
        selected = index if isinstance(index, slice) else _row_index(index, len(self))
        rows = {
            name: getattr(self, name)[selected]
            for name in ARRAY_FIELDS
            if getattr(self, name) is not None
        }
        return replace(self, **rows)

    @staticmethod
    def concatenate(maps: Iterable[PhotonMap]) -> PhotonMap:
        """Parts of one emission, of disjoint ranges, as one map.

        Its photons are those of the whole emission to the bit if the ranges are all of it. Ledgers
        are added, which rounds once more. It is well spaced if the parts are and their ranges join.

        Parameters
        ----------
        maps : iterable of PhotonMap
            Of ``trace_photons(photons=range(a, b))``, in any order.

        Raises
        ------
        TypeError, ValueError
            If there are none, they are of different emissions, or ranges overlap.
        """
        return joining.concatenate(_maps(maps), ARRAY_FIELDS)

    @staticmethod
    def average(maps: Iterable[PhotonMap]) -> PhotonMap:
        """Independent maps of one scene, traced with different seeds, as one.

        Flux is divided by their number and emitter densities are added; it is not well spaced.

        Parameters
        ----------
        maps : iterable of PhotonMap
            Of whole emissions, relaxed or not.

        Raises
        ------
        TypeError, ValueError
            If there are none, two are of the same seed and number, or some cannot be of one scene.
        """
        return joining.average(_maps(maps), ARRAY_FIELDS)

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the map as an ``.npz`` file, whole or not at all."""
        arrays: dict[str, Any] = {
            name: getattr(self, name) for name in ARRAY_FIELDS if getattr(self, name) is not None
        }
        white = self.wavelength is None
        arrays["photonmap_version"] = FORMAT_VERSION if white else DISPERSED_VERSION
        for name in (*_SCALARS, *_LISTS):
            if getattr(self, name) is not None:
                arrays[name] = getattr(self, name)
        if self.ledger is not None:
            arrays.update(ledger_arrays(self.ledger))
        write_npz(Path(path), arrays)

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> PhotonMap:
        """Read a map written by `save`.

        Raises
        ------
        ValueError
            If the file is damaged, not a photon map, or one of another version. Its arrays pass the
            same checks as those given to `PhotonMap`.
        OSError, MemoryError
            If it cannot be read, or does not fit in memory.
        """
        arrays = _read_arrays(Path(path))
        known: dict[str, Any] = {
            name: read_only(arrays[name]) for name in ARRAY_FIELDS if name in arrays
        }
        try:
            scalars = {name: scalar(arrays, name, kinds) for name, kinds in _SCALARS.items()}
            return cls(
                **known,
                **scalars | {"well_spaced": bool(scalars["well_spaced"])},
                sensor_ids=arrays.get("sensor_ids"),
                extended_ids=arrays.get("extended_ids"),
                emitted_ranges=arrays.get("emitted_ranges"),
                ledger=ledger_from(arrays) if arrays.keys() & set(LEDGER_NAMES) else None,
            )
        except (TypeError, ValueError) as error:
            raise _no_photon_map(Path(path), error) from None


_INTEGER_FIELDS: dict[str, type] = {
    "emitter_id": np.int32,
    "path_signature": np.int64,
    "n_bounces": np.int32,
    "object_id": np.int32,
}
# Fields with one value, and the kinds of dtype it is saved with.
_SCALARS = {
    "n_emitted": "iu",
    "n_wavelengths": "iu",
    "well_spaced": "b",
    "seed": "iu",
    "sampler": "U",
    "paths": "U",
    "scene_digest": "U",
}
# Fields that list objects or emitters.
_ID_LISTS = ("sensor_ids", "extended_ids")
# Fields that hold neither an array with a row for each photon nor a single value.
_LISTS = (*_ID_LISTS, "emitted_ranges")
ARRAY_FIELDS = tuple(
    f.name for f in fields(PhotonMap) if f.name not in (*_SCALARS, *_LISTS, "ledger")
)
"""Fields that hold an array with a row for each photon."""


# Arrays of a file; others are not read.
_NAMES = frozenset(["photonmap_version", *ARRAY_FIELDS, *_SCALARS, *_LISTS, *LEDGER_NAMES])


class NothingStoredError(ValueError):
    """No photon was stored; `photons` is the empty map with its ledger."""

    def __init__(self, message: str, photons: PhotonMap) -> None:
        super().__init__(message)
        self.photons = photons

    def __reduce__(self) -> tuple[type, tuple[str, PhotonMap]]:
        return type(self), (str(self), self.photons)


def _maps(maps: Iterable[PhotonMap]) -> list[PhotonMap]:
    if isinstance(maps, PhotonMap):
        raise TypeError("maps should be several photon maps, but is one")
    given = list(maps)
    if not given or not all(isinstance(each, PhotonMap) for each in given):
        kinds = ", ".join(type(each).__name__ for each in given) or "none"
        raise TypeError(f"maps should be PhotonMaps, at least one, but are {kinds}")
    return given


def _emitted_ranges(value: ArrayLike, n_emitted: int | None) -> Ints | None:
    """Checked ranges (m, 2) of an emission; None if they are all of it."""
    ranges = int_array(value, "emitted_ranges", (None, 2), np.int64)
    bounds = ranges.ravel()
    if n_emitted is None or not len(bounds) or (np.diff(bounds) < 0).any():
        raise ValueError(
            "emitted_ranges should be one or more starts and stops in ascending order, of "
            f"n_emitted photons, but are {ranges.tolist()} of {n_emitted}"
        )
    if bounds[0] < 0 or bounds[-1] > n_emitted:
        raise ValueError(
            f"emitted_ranges should lie in {range(n_emitted)}, but are {ranges.tolist()}"
        )
    return None if ranges.tolist() == [[0, n_emitted]] else frozen(ranges)


def _row_index(index: ArrayLike, n: int) -> NDArray:
    """Return a mask or indices of n rows as an array; an empty list has no dtype of its own."""
    array = np.asarray(index)
    if array.dtype == bool:
        if array.shape != (n,):
            raise ValueError(f"index should be a mask of {n}, but has shape {array.shape}")
        return array
    return array if array.size else array.astype(np.intp)


def _directions(value: ArrayLike, name: str, n: int) -> Floats:
    array = float_array(value, name, (n, 3))
    # Unit vectors are left as they are: saving, loading and replacing are exact to the bit.
    if not are_unit(array):
        array = unit_vectors(array, name, (n, 3))
    return frozen(array)


def _flux(value: ArrayLike, wavelength: Floats | None, n: int) -> Floats:
    array = np.asarray(value)
    if array.ndim == 1:
        array = np.repeat(array[:, np.newaxis], 3, axis=1)
    flux = check_magnitude(float_array(array, "flux", (n, 3), finite=False), "flux")
    check_not_negative(flux if wavelength is None else flux[wavelength == 0.0], "flux")
    return frozen(flux)


def _emitter_coords(value: ArrayLike, n: int) -> Floats:
    array = float_array(value, "emitter_coords", (n, None), finite=False)
    if array.shape[1] not in (2, 3):
        raise ValueError(f"emitter_coords should have 2 or 3 columns, but has {array.shape[1]}")
    return frozen(check_magnitude(array, "emitter_coords"))


def _spectrum(value: ArrayLike, n: int) -> Floats:
    array = float_array(value, "spectrum", (n, 3), finite=False)
    known = ~np.isnan(array)
    if not (known.all(axis=1) | ~known.any(axis=1)).all():
        raise ValueError("spectrum should have rows of numbers or of NaN, but has one of both")
    if np.isinf(array).any() or (array[:, :2] < 0.0).any():
        raise ValueError("spectrum should be finite and e and b not negative, but are not")
    return frozen(array)


def _read_arrays(path: Path) -> dict[str, NDArray]:
    """The arrays of a photon map's file, of the version that this package reads."""
    try:
        arrays = read_npz(path, _NAMES)
        check_names(arrays, ["photonmap_version"])
        version = scalar(arrays, "photonmap_version", "iu")
        if version in (FORMAT_VERSION, DISPERSED_VERSION):
            check_names(arrays, ["position", "normal", "flux"])
    except ValueError as error:
        raise _no_photon_map(path, error) from None
    if version not in (FORMAT_VERSION, DISPERSED_VERSION):
        raise ValueError(
            f"{path} should be a photon map of version {FORMAT_VERSION} or {DISPERSED_VERSION}, "
            f"but is of version {version}: save it again with this package"
        )
    return arrays


def _no_photon_map(path: Path, error: Exception) -> ValueError:
    return ValueError(f"{path} is not a photon map: {error}; save or copy it again")
