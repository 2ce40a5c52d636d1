"""Values sent to other processes."""

import numpy as np
import pytest

from photonrelax._util import parcels
from photonrelax._util.parcels import Parcel, kept, unpack, unpack_file


def example():
    frozen = np.arange(9000.0).reshape(3000, 3)
    frozen.setflags(write=False)
    return {"frozen": frozen, "writable": np.ones((1000, 2)), "small": frozen[:2, :1], "word": "a"}


def assert_same(one, other):
    assert one.keys() == other.keys()
    for name, value in one.items():
        np.testing.assert_array_equal(value, other[name])


def test_a_value_is_the_same_from_bytes_and_from_a_file(tmp_path):
    parcel = Parcel(example())
    parcel.write(tmp_path / "parcel")
    assert parcel.n_bytes == (tmp_path / "parcel").stat().st_size == len(parcel.to_bytes())
    assert_same(unpack(parcel.to_bytes()), example())
    assert_same(unpack_file(tmp_path / "parcel"), example())


def test_large_read_only_arrays_are_mapped_and_others_may_be_written(tmp_path):
    Parcel(example()).write(tmp_path / "parcel")
    value = unpack_file(tmp_path / "parcel")
    assert not value["frozen"].flags.owndata
    assert not value["frozen"].flags.writeable
    value["writable"][:] = 2.0


def test_a_digest_is_that_of_the_value():
    other = example()
    other["writable"][0] = 3.0
    assert Parcel(example()).digest == Parcel(example()).digest != Parcel(other).digest


@pytest.fixture
def nothing_kept():
    parcels._kept.clear()


@pytest.mark.usefixtures("nothing_kept")
def test_a_value_is_built_once_and_the_last_ones_used_are_kept():
    built = []

    def build(key):
        built.append(key)
        return key

    for key in ("first", "first", *map(str, range(parcels._MOST_KEPT - 1)), "first", "more"):
        assert kept(key, lambda key=key: build(key)) == key
    assert len(built) == parcels._MOST_KEPT + 1
    kept("first", lambda: build("first"))
    assert len(built) == parcels._MOST_KEPT + 1
    kept("0", lambda: build("0"))
    assert len(built) == parcels._MOST_KEPT + 2
