"""Structure detection and relaxation, beside what a plain search takes its peers."""

import pytest

import photonrelax as pr
from bench.speed import checks, inputs, stages
from bench.speed.bench_search import task_of


def test_structure(timed, photons, n, n_threads):
    found = timed(
        lambda: pr.detect_structure(photons, n_threads=n_threads),
        n,
        f"structure {n} {n_threads=}",
        beside=task_of(n, 50, n_threads),
    )
    checks.assert_neighbourhoods(found, photons, 50)


def test_structure_with_trees_built(timed, n, n_threads):
    photons = inputs.along_curve(n)
    found = timed(
        lambda detect: detect(),
        n,
        f"structure, trees built {n} {n_threads=}",
        beside=task_of(n, 50, n_threads),
        prepare=lambda: stages.with_trees_built(photons, n_threads),
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
        beside=task_of(n, 16, n_threads),
    )
    moved = (relaxed.position != photons.position).any(axis=1)
    assert moved.mean() > 0.9
