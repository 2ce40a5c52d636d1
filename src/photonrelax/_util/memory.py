"""Memory that is available, and the refusal of work that surely does not fit in it."""

from __future__ import annotations

import os
import resource
from functools import lru_cache
from pathlib import Path

from .cgroups import control_groups, text_of

_PROC = Path("/proc")
# A number of bytes that was estimated is divided by this, to be sure of it.
ESTIMATE_MARGIN = 2.0
# What is less is not worth a look at the system's files.
_SMALL = 2**20
_UNITS = ("bytes", "kB", "MB", "GB", "TB", "PB", "EB")


def check_memory(n_bytes: float, what: str, remedy: str) -> None:
    """Raise MemoryError if `what`, so many bytes at least, cannot fit in memory.

    Parameters
    ----------
    n_bytes : float
        A lower bound: work that may fit is not refused.
    what, remedy : str
        Subject of the message, in the plural, and how to need less.
    """
    if n_bytes < _SMALL:
        return
    available = available_memory()
    if n_bytes > available:
        raise MemoryError(
            f"{what} take at least {size_text(n_bytes)} of memory, "
            f"but {size_text(available)} are available: {remedy}"
        )


def available_memory() -> float:
    """Bytes that this process may still allocate, swap included; infinite where unknown.

    The least of what the machine has free, the limits of the control groups (containers) of this
    process, and the limit of its address space (``ulimit -v``).
    """
    machine = _kilobytes(_PROC / "meminfo")
    swap = machine.get("SwapFree", 0.0)
    return min([_free(machine) + swap, _address_space(), _group_limit() + swap])


def size_text(n_bytes: float) -> str:
    """A number of bytes in a fitting unit, as ``1.5 GB``."""
    unit = 0
    while n_bytes >= 1000.0 and unit < len(_UNITS) - 1:
        n_bytes, unit = n_bytes / 1000.0, unit + 1
    return f"{n_bytes:.3g} {_UNITS[unit]}"


def _free(machine: dict[str, float]) -> float:
    """Free memory of the machine."""
    if "MemAvailable" in machine:
        return machine["MemAvailable"]
    # macOS has no such file.
    return float(os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE"))


def _address_space() -> float:
    limit = resource.getrlimit(resource.RLIMIT_AS)[0]
    if limit == resource.RLIM_INFINITY:
        return float("inf")
    return max(limit - _kilobytes(_PROC / "self" / "status").get("VmSize", 0.0), 0.0)


def _group_limit() -> float:
    """Least limit of the control groups of this process and of those around them.

    What they use already may be caches that are given back: it is not subtracted.
    """
    texts = (text_of(path).strip() for path in _limit_files(control_groups("memory")))
    return min((float(text) for text in texts if text.isdigit()), default=float("inf"))


@lru_cache
def _limit_files(groups: tuple[Path, ...]) -> tuple[Path, ...]:
    """Files of the limits of groups, of versions 2 and 1."""
    names = "memory.max", "memory.limit_in_bytes"
    return tuple(path for folder in groups for name in names if (path := folder / name).exists())


def _kilobytes(path: Path) -> dict[str, float]:
    """Bytes by their names, of a file of lines like ``MemFree: 8 kB``."""
    lines = (line.split() for line in text_of(path).splitlines())
    return {
        words[0].rstrip(":"): 1024.0 * float(words[1])
        for words in lines
        if len(words) == 3 and words[2] == "kB"
    }


def reset_peak_memory() -> bool:
    """Start to measure the peak anew; False where the system does not measure it."""
    try:
        (_PROC / "self" / "clear_refs").write_text("5")
    except OSError:
        return False
    return True


def peak_memory() -> float:
    """Most bytes that this process has had resident since `reset_peak_memory`; NaN if unknown."""
    return _kilobytes(_PROC / "self" / "status").get("VmHWM", float("nan"))
