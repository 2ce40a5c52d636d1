"""Whole files: symbolic links and modes stay, errors name the file that was asked for."""

import errno
import io
import os
import stat

import pytest

from photonrelax._util.files import (
    WriteError,
    check_writable,
    first_bytes,
    remove_leftovers,
    whole_file,
)


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


def test_links_that_lead_nowhere_are_refused_and_stay(tmp_path):
    (tmp_path / "missing.txt").symlink_to("none/real.txt")
    (tmp_path / "loop.txt").symlink_to("loop.txt")
    for name, complaint in (("missing.txt", "there is no folder .*none"), ("loop.txt", "links")):
        for refuse in (check_writable, lambda path: write(path, "after")):
            with pytest.raises(OSError, match=rf"cannot write .*{name}: .*{complaint}"):
                refuse(tmp_path / name)
        assert (tmp_path / name).is_symlink()


def test_names_that_are_too_long_are_refused_before_the_work(tmp_path):
    with pytest.raises(OSError, match=r"cannot write .*aaa: File name too long"):
        check_writable(tmp_path / ("a" * 300))


def test_a_file_that_cannot_be_read_to_its_end_is_named(tmp_path, monkeypatch):
    class Broken(io.BytesIO):
        def read(self, n=-1):
            raise OSError(errno.EIO, os.strerror(errno.EIO))

    (tmp_path / "a").write_bytes(b"content")
    assert first_bytes(tmp_path / "a", 3) == b"con"
    monkeypatch.setattr(type(tmp_path), "open", lambda self, mode: Broken())
    with pytest.raises(OSError, match=r"cannot read .*a: Input/output error"):
        first_bytes(tmp_path / "a", 3)
