"""Products of many rows with a matrix."""

from __future__ import annotations

import numpy as np

from .validation import Floats

# Multiplications that OpenBLAS, which comes with NumPy, leaves to the calling thread: half of them.
_BY_ONE_THREAD = 1 << 17


def product(rows: Floats, matrix: Floats) -> Floats:
    """Product rows @ matrix, (n, k), of rows (n, m) and a matrix (m, k), by the calling thread.

    Threads of a BLAS wait for one another by spinning. For a few columns they gain next to nothing,
    and on a busy machine they take a hundred times as long.
    """
    out = np.empty((len(rows), matrix.shape[1]))
    step = max(_BY_ONE_THREAD // max(matrix.size, 1), 1)
    for first in range(0, len(rows), step):
        part = slice(first, first + step)
        np.matmul(rows[part], matrix, out=out[part])
    return out
