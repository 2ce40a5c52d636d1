"""Control groups of this process, by which containers limit what it may use."""

from __future__ import annotations

import os
from functools import cache, lru_cache
from pathlib import Path

_ROOT = Path("/sys/fs/cgroup")
_MEMBERSHIP = Path("/proc/self/cgroup")


def control_groups(controller: str) -> tuple[Path, ...]:
    """Folders of the groups of this process and of those around them, versions 2 and 1.

    Parameters
    ----------
    controller : str
        ``cpu`` or ``memory``; a group of version 2 has the files of all.
    """
    return _folders(_ROOT, text_of(_MEMBERSHIP), controller)


@lru_cache
def _folders(cgroups: Path, membership: str, controller: str) -> tuple[Path, ...]:
    """Folders that are there of the groups that a process is a member of."""
    folders: list[Path] = []
    for line in membership.splitlines():
        _, controllers, path = line.split(":", 2)
        if controllers == "":
            root = cgroups
        elif controller in controllers.split(","):
            root = cgroups / controller
        else:
            continue
        own = root / path.lstrip("/")
        folders += [own, *(folder for folder in own.parents if folder.is_relative_to(root))]
    return tuple(folder for folder in folders if folder.is_dir())


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
