"""Photon maps in parts: a folder of columns that are mapped, with a manifest.

A map that is larger than memory lies on disk as parts of one emission, in the order of their
photons' indices. A part is a folder of columns, an ``.npy`` file each, which are mapped when they
are read. What is whole is what the manifest says: a part is added to it when all of its files are
written.
"""

from __future__ import annotations

import json
import os
import shutil
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from .._util.files import make_folder, whole_file, write_json
from .energy_ledger import EnergyLedger
from .photon_map import ARRAY_FIELDS, PhotonMap

MANIFEST = "manifest.json"
FORMAT_VERSION = 1


@dataclass(frozen=True)
class PhotonParts:
    """A photon map in parts, of a folder.

    Attributes
    ----------
    folder : Path
    about : dict
        What the parts are of, by names of JSON: all that their photons depend on.
    shared : dict
        Fields of `PhotonMap` that all parts share.
    parts : tuple of dict
        For each part the range of the photons emitted, `start` and `stop`, `n_photons` stored, the
        bytes of each of its `columns`, and its `ledger`.
    """

    folder: Path
    about: Mapping[str, Any]
    shared: Mapping[str, Any]
    parts: tuple[Mapping[str, Any], ...] = field(repr=False)

    @classmethod
    def open(cls, folder: str | os.PathLike[str]) -> PhotonParts:
        """The parts in a folder, whose manifest and sizes of files are checked.

        Raises
        ------
        FileNotFoundError
            If there is no manifest.
        ValueError
            If it is damaged or of another version, or a file is missing or of another size.
        """
        folder = Path(folder)
        manifest = _read_manifest(folder)
        try:
            opened = cls(folder, manifest["about"], manifest["shared"], tuple(manifest["parts"]))
            opened._check_parts()
        except (KeyError, TypeError, AttributeError) as error:
            raise _damaged(folder, f"an entry is missing or of a wrong kind ({error})") from None
        return opened

    @classmethod
    def create(cls, folder: str | os.PathLike[str], about: Mapping[str, Any]) -> PhotonParts:
        """A folder without parts yet; made unless there is one, which has to be empty."""
        folder = Path(folder)
        make_folder(folder, [MANIFEST])
        if any(not path.name.startswith(".") for path in folder.iterdir()):
            raise FileExistsError(
                f"{folder} should be empty or a folder of photons in parts, but has other files"
            )
        created = cls(folder, about, {}, ())
        created._write_manifest()
        return created

    def __len__(self) -> int:
        return sum(part["n_photons"] for part in self.parts)

    @property
    def n_traced(self) -> int:
        """Photons emitted whose paths are in the parts."""
        return self.parts[-1]["stop"] if self.parts else 0

    @property
    def is_whole(self) -> bool:
        """True if the parts are of the whole emission."""
        return bool(self.parts) and self.n_traced == self.shared["n_emitted"]

    def maps(self) -> Iterator[PhotonMap]:
        """Yield the parts, one after the other, each mapped from its files.

        Raises
        ------
        ValueError
            If a file is damaged; arrays pass the checks of `PhotonMap`.
        """
        dispersed = any("wavelength" in part["columns"] for part in self.parts)
        for number in range(len(self.parts)):
            photons = self._map(number)
            if dispersed and photons.wavelength is None:
                # Of a part of white light alone.
                photons = photons.replace(wavelength=np.zeros(len(photons)))
            yield photons

    def photon_map(self) -> PhotonMap:
        """The photons of all parts as one map in memory."""
        return PhotonMap.concatenate(self.maps())

    def append(self, photons: PhotonMap) -> PhotonParts:
        """The parts with one more, the photons of the next range of the emission."""
        ranges = photons.emitted_ranges
        stop = photons.n_emitted if ranges is None else ranges[-1, 1]
        number, shared = len(self.parts), shared_fields(photons)
        if self.parts and shared != self.shared:
            raise ValueError(f"photons should be of the emission in {self.folder}, but are not")
        columns = _write_columns(self.folder / _part_name(number), photons)
        part = {
            "start": self.n_traced,
            "stop": int(stop or 0),
            "n_photons": len(photons),
            "columns": columns,
            "ledger": None if photons.ledger is None else photons.ledger.to_dict(),
        }
        appended = PhotonParts(self.folder, self.about, shared, (*self.parts, part))
        appended._write_manifest()
        return appended

    def _write_manifest(self) -> None:
        content = {
            "photonparts_version": FORMAT_VERSION,
            "about": self.about,
            "shared": self.shared,
            "parts": list(self.parts),
        }
        with whole_file(self.folder / MANIFEST) as path:
            write_json(path, content)

    def _check_parts(self) -> None:
        """Raise ValueError unless ranges join and all files are there, of their sizes."""
        stop = 0
        for number, part in enumerate(self.parts):
            if part["start"] != stop or part["stop"] <= stop:
                raise _damaged(self.folder, f"part {number} does not go on where the last ends")
            stop = part["stop"]
            unknown = set(part["columns"]) - set(ARRAY_FIELDS)
            if unknown:
                raise _damaged(self.folder, f"part {number} has columns {sorted(unknown)}")
            for name, n_bytes in part["columns"].items():
                self._check_size(self.folder / _part_name(number) / f"{name}.npy", n_bytes)

    def _check_size(self, path: Path, n_bytes: int) -> None:
        found = path.stat().st_size if path.is_file() else None
        if found != n_bytes:
            has = "is missing" if found is None else f"has {found}"
            raise ValueError(
                f"{path} should have {n_bytes} bytes, but {has}: copy the folder again, or trace "
                "it again"
            )

    def _map(self, number: int) -> PhotonMap:
        part, folder = self.parts[number], self.folder / _part_name(number)
        fields: dict[str, Any] = dict(self.shared)
        fields |= {name: _mapped(folder / f"{name}.npy") for name in part["columns"]}
        ranges = [(part["start"], part["stop"])]
        try:
            ledger = None if part["ledger"] is None else EnergyLedger.from_dict(part["ledger"])
            photons = PhotonMap(**fields, ledger=ledger, emitted_ranges=ranges)
        except (TypeError, ValueError, KeyError) as error:
            raise ValueError(
                f"{folder} is not a part of a photon map: {error}; copy or trace it again"
            ) from None
        if len(photons) != part["n_photons"]:
            raise _damaged(self.folder, f"part {number} has {len(photons)} photons")
        return photons


def _read_manifest(folder: Path) -> dict[str, Any]:
    path = folder / MANIFEST
    if not path.is_file():
        raise FileNotFoundError(
            f"{folder} should be a folder of photons in parts, but has no {MANIFEST}"
        )
    try:
        manifest = json.loads(path.read_bytes())
    except (ValueError, RecursionError) as error:
        raise _damaged(folder, str(error)) from None
    if not isinstance(manifest, dict) or "photonparts_version" not in manifest:
        raise _damaged(folder, "it is not one of photons in parts")
    version = manifest["photonparts_version"]
    if version != FORMAT_VERSION:
        raise ValueError(
            f"{path} should be of version {FORMAT_VERSION}, but is of {version}: trace it again "
            "with this package"
        )
    return manifest


def _damaged(folder: Path, reason: str) -> ValueError:
    return ValueError(
        f"{folder / MANIFEST} is damaged: {reason}; copy the folder again, or trace it again"
    )


def shared_fields(photons: PhotonMap) -> dict[str, Any]:
    """Fields, for JSON, that all parts of an emission share."""
    ids = {
        name: None if getattr(photons, name) is None else getattr(photons, name).tolist()
        for name in ("sensor_ids", "extended_ids")
    }
    names = ("n_emitted", "seed", "sampler", "paths", "n_wavelengths", "well_spaced")
    return {name: getattr(photons, name) for name in names} | ids


def _part_name(number: int) -> str:
    return f"part-{number:06d}"


def _write_columns(folder: Path, photons: PhotonMap) -> dict[str, int]:
    """Write a part's columns to a new folder; bytes of each."""
    if folder.exists():
        # Left by a run that ended before the manifest was written.
        shutil.rmtree(folder)
    folder.mkdir()
    sizes = {}
    for name in ARRAY_FIELDS:
        column = getattr(photons, name)
        if column is not None:
            np.save(folder / f"{name}.npy", column, allow_pickle=False)
            sizes[name] = (folder / f"{name}.npy").stat().st_size
    return sizes


def _mapped(path: Path) -> np.ndarray:
    try:
        return np.load(path, mmap_mode="r" if path.stat().st_size > 128 else None)
    except (ValueError, OSError) as error:
        raise ValueError(f"{path} is not an array: {error}; copy or trace it again") from None
