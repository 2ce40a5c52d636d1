"""Structure detection and relaxation."""

import pytest

import photonrelax as pr

from . import checks, stages


def test_structure(timed, photons, n, n_threads):
    found = timed(
        lambda: pr.detect_structure(photons, n_threads=n_threads), n, f"structure {n} {n_threads=}"
    )
    checks.assert_neighbourhoods(found, photons, 50)


@pytest.mark.parametrize(
    "iterations", [(1, 0), (0, 1), (7, 7)], ids=["constrained", "collapsed", "all"]
)
def test_relax(timed, photons, structure, n, n_threads, iterations):
    relaxed = timed(
        lambda: stages.relaxed(photons, structure, iterations, n_threads),
        n,
        f"relax {n} {iterations=} {n_threads=}",
    )
    moved = (relaxed.position != photons.position).any(axis=1)
    assert moved.mean() > 0.9
