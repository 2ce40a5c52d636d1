"""Control groups of this process, by which containers limit what it may use."""

from __future__ import annotations

import os
from collections.abc import Iterator
from functools import cache
from pathlib import Path

_ROOT = Path("/sys/fs/cgroup")
_MEMBERSHIP = Path("/proc/self/cgroup")


def control_groups(controller: str) -> Iterator[Path]:
    """Folders of the groups of this process and of those around them, versions 2 and 1.

    Parameters
    ----------
    controller : str
        ``cpu`` or ``memory``; a group of version 2 has the files of all.
    """
    for line in text_of(_MEMBERSHIP).splitlines():
        _, controllers, path = line.split(":", 2)
        if controllers == "":
            root = _ROOT
        elif controller in controllers.split(","):
            root = _ROOT / controller
        else:
            continue
        own = root / path.lstrip("/")
        yield own
        for folder in own.parents:
            if folder.is_relative_to(root):
                yield folder


def text_of(path: Path) -> str:
    """Text of a file of the system, empty if there is none."""
    try:
        # Names of groups and processes need not be text.
        return os.fsdecode(path.read_bytes())
    except OSError:
        return ""


@cache
def cpu_quota() -> float:
    """Cores' worth of time that the groups allow at the first call, infinite without a limit."""
    return min((_quota(folder) for folder in control_groups("cpu")), default=float("inf"))


def _quota(folder: Path) -> float:
    """Quota over period of a group, both in microseconds."""
    words = text_of(folder / "cpu.max").split() or [
        *text_of(folder / "cpu.cfs_quota_us").split(),
        *text_of(folder / "cpu.cfs_period_us").split(),
    ]
    # No limit is "max", in version 1 -1.
    if len(words) != 2 or not all(word.isdigit() for word in words):
        return float("inf")
    return int(words[0]) / int(words[1])
