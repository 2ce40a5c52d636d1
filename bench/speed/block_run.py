"""Relaxation of parts by blocks, or in one piece, in the process that runs it (Linux only)."""

from __future__ import annotations

import argparse
import json
import shutil
from pathlib import Path
from time import process_time
from typing import Any

import numpy as np

import photonrelax as pr
from bench.speed.memory_stage import resident
from photonrelax.estimation.methods import MethodInput, Settings, relaxed_photons

# Rows of which positions are compared at once.
_ROWS = 1 << 20


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("scene")
    parser.add_argument("method")
    parser.add_argument("folder", type=Path)
    parser.add_argument("size", type=int)


def run(options: argparse.Namespace) -> None:
    """Relax in this process; print CPU time, s, and peak of memory, bytes, as JSON."""
    relaxed = _by_blocks if options.size else _in_one_piece
    print(json.dumps(relaxed(options, pr.gallery.scene(options.scene))))


def _in_one_piece(options: argparse.Namespace, scene: pr.Scene) -> dict[str, Any]:
    photons = pr.PhotonParts.open(options.folder / "parts").photon_map()
    started = process_time()
    given = MethodInput(photons, Settings(), scene, None, None)
    relaxed = relaxed_photons(options.method, given).photons
    measured = {"cpu": process_time() - started, "peak": resident("VmHWM")}
    np.save(options.folder / "one.npy", relaxed.position)
    return measured


def _by_blocks(options: argparse.Namespace, scene: pr.Scene) -> dict[str, Any]:
    parts, folder = pr.PhotonParts.open(options.folder / "parts"), options.folder / "blocks"
    started = process_time()
    blocked = pr.relax_parts(
        parts, folder, method=options.method, scene=scene, photons_per_block=options.size
    )
    measured = {"cpu": process_time() - started, "peak": resident("VmHWM")}
    measured["n_blocks"] = len(np.unique(blocked.segments.block))
    measured["difference"] = _difference(blocked, options.folder / "one.npy")
    shutil.rmtree(folder)
    return measured


def _difference(blocked: pr.BlockedPhotons, one: Path) -> float:
    """Largest difference of positions from those of one piece, over the extent of the map."""
    expected, columns, largest = np.load(one, mmap_mode="r"), blocked.columns, 0.0
    for start in range(0, len(blocked), _ROWS):
        rows = start, start + _ROWS
        difference = columns.read("position", *rows) - expected[columns.read("row", *rows)]
        largest = max(largest, float(np.abs(difference).max()))
    return largest / float(np.ptp(expected, axis=0).max())
