"""Products of many rows with a matrix, in parts."""

import numpy as np
import pytest

from photonrelax._util.products import product


@pytest.mark.parametrize("n", [0, 1, 7, 50_000])
@pytest.mark.parametrize(("m", "k"), [(3, 3), (2, 20), (400, 400)])
def test_parts_are_the_whole(n, m, k):
    n = min(n, 2000) if m * k > 1000 else n
    rng = np.random.default_rng(0)
    rows, matrix = rng.normal(size=(n, m)), rng.normal(size=(k, m)).T
    np.testing.assert_allclose(product(rows, matrix), rows @ matrix, rtol=1e-12, atol=1e-12)
