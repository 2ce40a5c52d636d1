"""Processors and libraries that the last bits of results may depend on."""

from __future__ import annotations

import platform
import warnings
from collections.abc import Collection
from functools import cache
from typing import NamedTuple

import numpy as np


class Platform(NamedTuple):
    """Features of a processor, and the libraries that choose code by them."""

    machine: str
    features: tuple[str, ...]
    embreex: str
    libc: str


@cache
def platform_of_process() -> Platform:
    """The platform that this process runs on."""
    # Workers alone need it.
    from importlib.metadata import PackageNotFoundError, version

    try:
        embreex = version("embreex")
    except PackageNotFoundError:
        embreex = "none"
    found = np.show_config(mode="dicts")["SIMD Extensions"]
    features = tuple(sorted((*found.get("baseline", ()), *found.get("found", ()))))
    return Platform(platform.machine(), features, embreex, " ".join(platform.libc_ver()))


def warn_of_mixture(platforms: Collection[Platform]) -> None:
    """Warn if there are several platforms."""
    if len(platforms) < 2:
        return
    ordered = sorted(platforms)
    shared = set.intersection(*(set(each.features) for each in ordered))
    texts = (
        f"{each.machine} with {' '.join(sorted(set(each.features) - shared)) or 'no more'}, "
        f"embreex {each.embreex}, {each.libc or 'libc unknown'}"
        for each in ordered
    )
    warnings.warn(
        f"workers have different platforms: {'; '.join(texts)}. Embree and libm choose code by "
        "processor, so that the last bits of results depend on which worker did what",
        stacklevel=2,
    )
