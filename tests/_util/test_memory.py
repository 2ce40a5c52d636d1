"""Memory that is available: the least of machine, containers and limits of the process."""

import resource
import subprocess
import sys

import pytest

from photonrelax._util import cgroups, memory
from photonrelax._util.memory import available_memory, check_memory, size_text


@pytest.mark.parametrize(
    ("n_bytes", "text"),
    [(0, "0 bytes"), (999, "999 bytes"), (1500, "1.5 kB"), (2.5e9, "2.5 GB"), (4e21, "4e+03 EB")],
)
def test_sizes_are_told_in_a_fitting_unit(n_bytes, text):
    assert size_text(n_bytes) == text


def test_what_fits_is_not_refused_and_what_does_not_is():
    available = available_memory()
    check_memory(0.5 * available, "numbers", "take fewer")
    with pytest.raises(MemoryError, match=r"numbers take at least .*available: take fewer"):
        check_memory(2.0 * available + 2**21, "numbers", "take fewer")


@pytest.fixture
def system(tmp_path, monkeypatch):
    """Files of the system, by their paths."""
    proc, groups = tmp_path / "proc", tmp_path / "cgroup"
    monkeypatch.setattr(memory, "_PROC", proc)
    monkeypatch.setattr(cgroups, "_ROOT", groups)
    monkeypatch.setattr(cgroups, "_MEMBERSHIP", proc / "self" / "cgroup")

    def write(files):
        for name, text in files.items():
            path = tmp_path / name
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(text)

    write({"proc/meminfo": "MemTotal: 9000 kB\nMemAvailable: 8000 kB\nSwapFree: 1000 kB\n"})
    return write


def test_swap_counts(system):
    assert available_memory() == 9000 * 1024


@pytest.mark.parametrize(
    "files",
    [
        {"proc/self/cgroup": "0::/a/b\n", "cgroup/a/b/memory.max": "1024000\n"},
        {
            "proc/self/cgroup": "0::/a/b\n",
            "cgroup/a/b/memory.max": "max\n",
            "cgroup/a/memory.max": "1024000\n",
        },
        {"proc/self/cgroup": "0::/../..\n", "cgroup/memory.max": "1024000\n"},
        {
            "proc/self/cgroup": "9:cpu,memory:/a\n0::/\n",
            "cgroup/memory/a/memory.limit_in_bytes": "1024000\n",
        },
    ],
    ids=["own", "around", "root of the container", "version 1"],
)
def test_the_limit_of_a_container_is_found(files, system):
    system(files)
    assert available_memory() == 2000 * 1024


def test_the_limit_of_the_address_space_is_found():
    code = (
        "import resource; resource.setrlimit(resource.RLIMIT_AS, (2**30, -1))\n"
        "from photonrelax._util.memory import available_memory; print(available_memory())"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert 0 < float(done.stdout) < 2**30
    assert resource.getrlimit(resource.RLIMIT_AS)[0] == resource.RLIM_INFINITY
