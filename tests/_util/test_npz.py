"""Archives that are damaged, or that nobody should trust."""

import os
import zipfile

import numpy as np
import pytest

from photonrelax._util import memory
from photonrelax._util.npz import read_npz
from tests.helpers.damage import Unpickled, bomb, cut_off, flipped, header_only


@pytest.fixture
def archive(tmp_path):
    path = tmp_path / "a.npz"
    np.savez(path, n=np.arange(4), text="word", position=np.linspace(0, 1, 12).reshape(4, 3))
    return path


def test_what_was_written_is_read(archive):
    arrays = read_npz(archive)
    assert arrays["text"] == "word"
    np.testing.assert_array_equal(arrays["position"].ravel(), np.linspace(0, 1, 12))
    assert read_npz(archive, ["n", "none"]).keys() == {"n"}


@pytest.mark.parametrize("compressed", [False, True])
def test_layouts_of_other_programs_are_read(compressed, tmp_path):
    columns = {"fortran": np.asfortranarray(np.eye(3)), "big": np.arange(3, dtype=">i4")}
    (np.savez_compressed if compressed else np.savez)(tmp_path / "a.npz", **columns)
    for name, array in read_npz(tmp_path / "a.npz").items():
        np.testing.assert_array_equal(array, columns[name])


def test_every_length_but_the_whole_is_damaged(archive):
    for content in cut_off(archive.read_bytes(), 100):
        archive.write_bytes(content)
        with pytest.raises(ValueError, match=r"."):
            read_npz(archive)


def test_flipped_bytes_are_found_or_do_no_harm(archive):
    whole = read_npz(archive)
    for content in flipped(archive.read_bytes(), 500):
        archive.write_bytes(content)
        try:
            arrays = read_npz(archive)
        except ValueError:
            continue
        for name in arrays.keys() & whole.keys():
            np.testing.assert_array_equal(arrays[name], whole[name])


@pytest.mark.parametrize(
    ("shape", "dtype"),
    [
        ((10**18, 3), "<f8"),
        ((2**31,), "<i4"),
        ((-4,), "<f8"),
        ((), "<f8"),
        ((), "<U100000000"),
        ((10**18,), "<U0"),
        ((10**18,), "|V0"),
        ((4,), "|O"),
    ],
)
def test_sizes_that_are_not_there_take_no_memory(shape, dtype, tmp_path):
    header_only(tmp_path / "a.npz", "a", shape, dtype)
    with pytest.raises(ValueError, match=r"a\.npy"):
        read_npz(tmp_path / "a.npz")


@pytest.mark.parametrize(
    "array",
    [
        np.array([Unpickled()], dtype=object),
        np.zeros(3, [("a", "f8"), ("b", "i4")]),
        np.zeros(3, [("a", object)]),
        np.zeros(3, "M8[s]"),
    ],
    ids=["object", "record", "record of objects", "date"],
)
def test_arrays_that_are_not_plain_are_refused_and_not_unpickled(array, tmp_path):
    np.savez(tmp_path / "a.npz", a=array)
    with pytest.raises(ValueError, match=r"a\.npy should be a plain array|is no plain array"):
        read_npz(tmp_path / "a.npz")


def test_what_unpacks_to_more_than_memory_is_refused(tmp_path, monkeypatch):
    bomb(tmp_path / "a.npz", "a", (2**23,))
    assert (tmp_path / "a.npz").stat().st_size < 100_000
    monkeypatch.setattr(memory, "available_memory", lambda: 6e7)
    with pytest.raises(MemoryError, match=r"a\.npz take at least 67.1 MB .* 60 MB are available"):
        read_npz(tmp_path / "a.npz")


@pytest.mark.parametrize("compression", [zipfile.ZIP_BZIP2, zipfile.ZIP_LZMA])
def test_compressions_that_numpy_does_not_write_are_refused(archive, compression):
    with zipfile.ZipFile(archive, "w", compression) as file:
        file.writestr("a.npy", b"noise")
    with pytest.raises(ValueError, match="compressed in a way"):
        read_npz(archive)


@pytest.mark.parametrize(
    "content", [b"", b"text", b"\x93NUMPY\x01\x00", b"\x80\x04\x95", b"PK\x03\x04"]
)
def test_other_files_are_no_archives(content, tmp_path):
    (tmp_path / "a.npz").write_bytes(content)
    with pytest.raises(ValueError, match=r"it is empty|not a zip file"):
        read_npz(tmp_path / "a.npz")


def test_what_is_no_regular_file_is_named(tmp_path):
    os.mkfifo(tmp_path / "pipe")
    for name, complaint in (("none", "there is no file"), (".", "folder"), ("pipe", "pipe")):
        with pytest.raises(OSError, match=complaint) as caught:
            read_npz(tmp_path / name)
        assert str(tmp_path / name) in str(caught.value)


def test_a_file_that_may_not_be_read_is_named(archive, monkeypatch):
    def refused(self, mode):
        raise PermissionError(13, os.strerror(13), str(self))

    monkeypatch.setattr(type(archive), "open", refused)
    with pytest.raises(PermissionError, match=r"cannot read .*a\.npz: Permission denied"):
        read_npz(archive)
