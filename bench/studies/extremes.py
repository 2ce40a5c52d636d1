"""Errors at the extremes, beside their bounds: the cases of `tests/extremes`."""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from functools import partial

from tests.extremes import photon_cases, scene_cases
from tests.extremes.case import Case
from tests.helpers import simd_paths

import photonrelax as pr
from bench.markdown import markdown_table
from photonrelax.estimation.methods import METHODS

_PATHS = ("avx512", "avx2", "portable")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--ten-million", action="store_true", help="a plate of ten million triangles too: 5 GB"
    )


def run(options: argparse.Namespace) -> None:
    """Print the table."""
    print(markdown(ten_million=options.ten_million))


def markdown(*, ten_million: bool = False) -> str:
    """Table of the cases, their bounds and the largest errors reached."""
    rows = [*_photon_rows(), *_plate_rows(), *_scene_rows(ten_million)]
    table = markdown_table(["extreme", "against", "bound", "error", "of"], rows)
    paths = ", ".join(_paths())
    return f"{table}\n\nThe largest over the methods and over searches on {paths}.\n"


def _paths() -> list[str]:
    return [path for path in _PATHS if simd_paths.has(path)]


def _photon_rows() -> Iterator[list[str]]:
    methods = [m.name for m in METHODS.values() if m.needs_photons and not m.needs_spectra]
    for case in photon_cases.CASES:
        errors = {}
        for path in _paths():
            with simd_paths.forced(path):
                for method in methods:
                    field_of = partial(pr.irradiance_field, method=method)
                    errors[method] = max(errors.get(method, 0.0), case.error(field_of))
        yield _row(case, errors)


def _plate_rows() -> Iterator[list[str]]:
    for case in scene_cases.FIELD_CASES:
        yield _row(case, {method: case.error(method) for method in METHODS})


def _scene_rows(ten_million: bool) -> Iterator[list[str]]:
    cases = [*scene_cases.TRACING_CASES, *scene_cases.OPTICS_CASES, *scene_cases.CAMERA_CASES]
    for case in cases + [scene_cases.TEN_MILLION] * ten_million:
        yield _row(case, {"": case.error()})


def _row(case: Case, errors: dict[str, float]) -> list[str]:
    worst = max(errors, key=lambda name: errors[name])
    error = f"{errors[worst]:.1e}"
    if errors[worst] > case.bound:
        error = f"**{error}**"
    return [case.name, case.against, f"{case.bound:.0e}", error, worst]
