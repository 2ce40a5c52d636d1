"""Damaged versions of files: cut off, with flipped bits, and archives with other arrays."""

import io
import random
import zipfile

import numpy as np


def cut_off(content, n, seed=0):
    """Beginnings of a file, of n lengths that are spread over it, and of none and all but one."""
    rng = random.Random(seed)
    lengths = {0, 1, len(content) // 2, len(content) - 1, *rng.sample(range(len(content)), n)}
    return [content[:length] for length in sorted(lengths)]


def flipped(content, n, seed=0):
    """Files with a few bytes of other values: near the names and sizes of members, or anywhere."""
    rng = random.Random(seed)
    marks = [at for at in range(len(content)) if content[at : at + 2] == b"PK"] or [0]
    for _ in range(n):
        damaged = bytearray(content)
        for _ in range(rng.choice([1, 1, 2, 5])):
            near = rng.choice(marks) + rng.randrange(200)
            at = rng.choice([near, rng.randrange(len(content))]) % len(content)
            damaged[at] = rng.choice([damaged[at] ^ (1 << rng.randrange(8)), 0, 127, 128, 255])
        yield bytes(damaged)


def arrays_of(path):
    with np.load(path) as file:
        return dict(file)


def save(path, arrays):
    """An archive of arrays, those that are None left out; objects are pickled."""
    np.savez(path, **{name: array for name, array in arrays.items() if array is not None})


def header_only(path, name, shape, dtype="<f8"):
    """An archive of one array that has no more than its header."""
    member = io.BytesIO()
    header = {"descr": dtype, "fortran_order": False, "shape": shape}
    np.lib.format.write_array_header_1_0(member, header)
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr(f"{name}.npy", member.getvalue())


def bomb(path, name, shape):
    """A small file of an array of zeros that is large."""
    member = io.BytesIO()
    header = {"descr": "<f8", "fortran_order": False, "shape": shape}
    np.lib.format.write_array_header_1_0(member, header)
    zeros = bytes(2**20)
    with (
        zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive,
        archive.open(f"{name}.npy", "w", force_zip64=True) as file,
    ):
        file.write(member.getvalue())
        for _ in range(8 * int(np.prod(shape)) // len(zeros)):
            file.write(zeros)


class Unpickled:
    """Fails the test if it is unpickled."""

    def __reduce__(self):
        return _unpickled, ()


def _unpickled():
    raise AssertionError("a file was unpickled")
