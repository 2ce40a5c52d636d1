"""Processor time that control groups (containers) allow a process."""

import math
import os

import pytest

from photonrelax._util import cgroups
from photonrelax._util.parallel import thread_count

N_CORES = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()


@pytest.fixture
def groups(tmp_path, monkeypatch):
    """Write the membership of this process and the files of a tree of groups."""

    def write(membership, files):
        (tmp_path / "membership").write_text(membership)
        for name, text in files.items():
            path = tmp_path / "root" / name
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(text)
        cgroups.cpu_quota.cache_clear()

    monkeypatch.setattr(cgroups, "_ROOT", tmp_path / "root")
    monkeypatch.setattr(cgroups, "_MEMBERSHIP", tmp_path / "membership")
    yield write
    cgroups.cpu_quota.cache_clear()


@pytest.mark.parametrize(
    ("membership", "files", "quota"),
    [
        ("0::/\n", {"cpu.max": "50000 100000\n"}, 0.5),
        ("0::/\n", {"cpu.max": "max 100000\n"}, math.inf),
        ("0::/a/b\n", {"a/cpu.max": "150000 100000\n", "a/b/cpu.max": "max 100000\n"}, 1.5),
        ("0::/a/b\n", {"a/cpu.max": "300000 100000", "a/b/cpu.max": "200000 100000"}, 2.0),
        # The group's path is one of the host, which the container does not see.
        ("0::/docker/f00\n", {"cpu.max": "100000 100000\n"}, 1.0),
        (
            "4:cpu,cpuacct:/x\n3:memory:/y\n",
            {"cpu/x/cpu.cfs_quota_us": "25000\n", "cpu/x/cpu.cfs_period_us": "100000\n"},
            0.25,
        ),
        (
            "4:cpu:/\n",
            {"cpu/cpu.cfs_quota_us": "-1\n", "cpu/cpu.cfs_period_us": "100000\n"},
            math.inf,
        ),
        ("3:memory:/y\n", {"cpu/y/cpu.max": "1 100000\n"}, math.inf),
        ("", {}, math.inf),
        ("0::/\n", {"cpu.max": "damaged"}, math.inf),
    ],
)
def test_the_quota_is_the_least_of_the_groups_around(groups, membership, files, quota):
    groups(membership, files)
    assert cgroups.cpu_quota() == quota


@pytest.mark.parametrize(
    ("quota", "n_threads"),
    [("1000", 1), ("100000", 1), ("150000", min(2, N_CORES)), ("100000000", N_CORES)],
)
def test_by_default_no_more_threads_than_the_quota(groups, quota, n_threads):
    groups("0::/\n", {"cpu.max": f"{quota} 100000\n"})
    assert thread_count(None) == n_threads
    assert thread_count(3) == 3


def test_names_that_are_not_text_are_read(groups, tmp_path):
    folder = tmp_path / "root" / os.fsdecode(b"caf\xe9")
    groups("", {f"{folder.name}/cpu.max": "50000 100000\n"})
    (tmp_path / "membership").write_bytes(b"0::/caf\xe9\n")
    assert cgroups.cpu_quota() == 0.5
