"""Whole files: symbolic links and modes stay, errors name the file that was asked for."""

import errno
import os
import stat

import pytest

from photonrelax._util.files import WriteError, check_writable, remove_leftovers, whole_file


def write(path, text):
    with whole_file(path) as partial:
        partial.write_text(text)


@pytest.mark.parametrize("exists", [True, False])
def test_the_file_that_a_link_points_to_is_written(tmp_path, exists):
    folder = tmp_path / "elsewhere"
    folder.mkdir()
    real, link = folder / "real.txt", tmp_path / "link.txt"
    if exists:
        real.write_text("before")
    link.symlink_to(real)
    check_writable(link)
    write(link, "after")
    assert link.is_symlink()
    assert real.read_text() == "after"
    assert sorted(os.listdir(folder)) == ["real.txt"]


@pytest.mark.parametrize("mode", [0o600, 0o640, 0o444])
def test_a_file_that_is_replaced_keeps_its_mode(tmp_path, mode):
    path = tmp_path / "a.txt"
    path.write_text("before")
    path.chmod(mode)
    write(path, "after")
    assert path.read_text() == "after"
    assert stat.S_IMODE(path.stat().st_mode) == mode


def test_leftovers_beside_the_target_of_a_link_are_removed(tmp_path):
    folder = tmp_path / "elsewhere"
    folder.mkdir()
    link = tmp_path / "link.txt"
    link.symlink_to(folder / "real.txt")
    with whole_file(link) as partial:
        partial.write_text("killed")
        remove_leftovers(link)
        assert os.listdir(folder) == []
        partial.write_text("")


def fail(path):
    with whole_file(path):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


def fail_nested(path):
    with whole_file(path) as partial:
        fail(partial)


@pytest.mark.parametrize("failing", [fail, fail_nested])
def test_errors_name_the_file_and_no_temporary_one(tmp_path, failing):
    path = tmp_path / "a.txt"
    with pytest.raises(WriteError) as caught:
        failing(path)
    assert str(caught.value) == f"cannot write {path}: No space left on device"
    assert os.listdir(tmp_path) == []


def test_errors_of_other_files_are_left_as_they_are(tmp_path):
    missing = tmp_path / "missing"
    with pytest.raises(FileNotFoundError, match="missing"), whole_file(tmp_path / "a.txt"):
        missing.read_text()


def test_devices_and_pipes_are_not_replaced(tmp_path):
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(OSError, match=r"cannot write .*pipe: it is a device"):
        write(tmp_path / "pipe", "text")
    with pytest.raises(IsADirectoryError, match="it is a folder"):
        write(tmp_path, "text")
    assert stat.S_ISFIFO((tmp_path / "pipe").stat().st_mode)
