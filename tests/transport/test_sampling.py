from fractions import Fraction

import numpy as np
import pytest
from scipy.stats import qmc

from photonrelax.transport import sampling


def interior_points(n=20_000, seed=5):
    """Random points of the square away from its edges and the diagonals, where maps have seams."""
    points = np.random.default_rng(seed).uniform(0.01, 0.99, (n, 2))
    x, y = np.abs(2 * points - 1).T
    return points[(np.abs(x - y) > 0.01) & (np.abs(x + y - 1) > 0.01) & (x > 0.01) & (y > 0.01)]


@pytest.mark.parametrize("first", [0, 1, 12345])
def test_halton_equals_scipys(first):
    oracle = qmc.Halton(2, scramble=False)
    oracle.fast_forward(first)
    np.testing.assert_allclose(sampling.halton(first, 500), oracle.random(500), rtol=0, atol=1e-15)


def mirrored_digits(index, base):
    value, scale = Fraction(0), Fraction(1, base)
    while index:
        index, digit = divmod(index, base)
        value, scale = value + digit * scale, scale / base
    return value


@pytest.mark.parametrize("index", [3**20 - 1, 2**40 - 1, 10**9, 10**15 + 7])
def test_halton_is_the_exact_radical_inverse_rounded(index):
    expected = [float(mirrored_digits(index, base)) for base in (2, 3)]
    np.testing.assert_array_equal(sampling.halton(index, 1)[0], expected)


def test_halton_stays_below_one():
    assert (sampling.halton(2**63 - 1, 1, shift=(0.0, 0.0)) < 1.0).all()


def test_halton_point_depends_on_its_index_alone():
    whole = sampling.halton(0, 1000, shift=(0.3, 0.9), n_threads=1)
    for n_threads in (2, 7):
        again = sampling.halton(0, 1000, shift=(0.3, 0.9), n_threads=n_threads)
        assert whole.tobytes() == again.tobytes()
    parts = [sampling.halton(i, 100, shift=(0.3, 0.9)) for i in range(0, 1000, 100)]
    assert whole.tobytes() == np.concatenate(parts).tobytes()


def test_shift_is_modulo_one():
    plain, moved = sampling.halton(0, 100), sampling.halton(0, 100, shift=(0.25, 0.75))
    np.testing.assert_allclose(moved, (plain + np.array([0.25, 0.75])) % 1.0, rtol=0, atol=1e-15)
    assert ((moved >= 0.0) & (moved < 1.0)).all()


def test_seeds_and_streams_shift_differently():
    shifts = np.array([sampling.seed_shift(s, e) for s in (0, 1, 2**64 - 1) for e in range(100)])
    assert ((shifts >= 0.0) & (shifts < 1.0)).all()
    assert len(np.unique(shifts, axis=0)) == len(shifts)
    # Scattered over the square: the mean of 300 uniform numbers has a deviation of 0.017.
    np.testing.assert_allclose(shifts.mean(axis=0), 0.5, atol=0.07)


def test_the_disk_is_sampled_with_constant_density():
    points, step = interior_points(), 1e-6
    du, dv = (
        (sampling.square_to_disk(points + e) - sampling.square_to_disk(points - e)) / (2 * step)
        for e in ([step, 0.0], [0.0, step])
    )
    area = np.abs(du[:, 0] * dv[:, 1] - du[:, 1] * dv[:, 0])
    np.testing.assert_allclose(area, np.pi, rtol=1e-5)


def test_the_square_maps_onto_the_disk():
    grid = np.linspace(0.0, 1.0, 9)
    out = sampling.square_to_disk([(a, b) for a in grid for b in grid])
    radius = np.linalg.norm(out, axis=1).reshape(9, 9)
    np.testing.assert_allclose(radius[[0, -1]], 1.0, rtol=1e-15)
    np.testing.assert_allclose(radius[:, [0, -1]], 1.0, rtol=1e-15)
    assert (radius[1:-1, 1:-1] < 1.0).all()
    assert radius[4, 4] == 0.0
    # Evenly: squares around the centre become circles.
    np.testing.assert_allclose(radius[2:7, 2], 0.5, rtol=1e-15)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: sampling.halton(-1, 2), "first should be at least 0"),
        (lambda: sampling.halton(0, 2, shift=(0.5, 1.0)), r"shift should lie in \[0, 1\)²"),
        (lambda: sampling.seed_shift(-1), "seed should be at least 0"),
        (lambda: sampling.seed_shift(2**64), r"seed should be below 2\^64"),
        (lambda: sampling.square_to_disk([[0.5, 1.5]]), r"points should lie in \[0, 1\]²"),
        (lambda: sampling.square_to_disk([0.5, 0.5]), "points should have shape"),
    ],
)
def test_errors_name_the_argument(call, message):
    with pytest.raises(ValueError, match=message):
        call()
