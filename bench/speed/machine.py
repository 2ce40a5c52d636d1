"""Machine and versions of a measurement."""

from __future__ import annotations

import os
import platform
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

import numpy as np
import scipy

import photonrelax as pr

_OPTIONAL = ("embreex", "pykdtree", "numba-kdtree", "numba")


def versions() -> dict[str, str]:
    """Return versions of Python and of the packages measured."""
    found = {
        "photonrelax": pr.__version__,
        "Python": platform.python_version(),
        "NumPy": np.__version__,
        "SciPy": scipy.__version__,
    }
    for package in _OPTIONAL:
        try:
            found[package] = version(package)
        except PackageNotFoundError:
            continue
    return found


def machine() -> dict[str, str | int]:
    """Return processor, cores, vector instructions and system."""
    facts = _cpu_facts()
    flags = set(facts.get("flags", "").split())
    widest = next((name for name in ("avx512f", "avx2") if name in flags), "unknown")
    return {
        "processor": facts.get("model name") or platform.processor() or platform.machine(),
        "cores": len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else 0,
        "vectors": {"avx512f": "AVX-512", "avx2": "AVX2"}.get(widest, widest),
        "system": f"{platform.system()} {platform.machine()}",
    }


def _cpu_facts() -> dict[str, str]:
    """Return Linux's facts of the first core; empty elsewhere."""
    info = Path("/proc/cpuinfo")
    if not info.exists():
        return {}
    lines = (line.split(":", 1) for line in info.read_text().split("\n\n")[0].splitlines())
    return {pair[0].strip(): pair[1].strip() for pair in lines if len(pair) == 2}


def description() -> str:
    """Return machine and versions in one line."""
    here = machine()
    packages = ", ".join(f"{name} {number}" for name, number in versions().items())
    return (
        f"{here['processor']}, {here['cores']} cores, {here['vectors']}, {here['system']}; "
        f"{packages}"
    )
