"""Irradiance at what the camera sees, beside the search alone of SciPy, pykdtree, numba-kdtree."""

import pytest

import photonrelax as pr
from bench.speed import checks, peers
from bench.speed.bench_search import PEERS, peer_named
from photonrelax.estimation.nearest import IrradianceField


@pytest.fixture(scope="session")
def field(photons):
    return IrradianceField(photons)


@pytest.mark.parametrize("who", PEERS)
def test_search_by_peers(timed, photons, field, hit_points, n, n_threads, who):
    """Peers look no further than the gather radius, in space alone."""
    limit = field.settings.gather_radius
    tree = peers.Ordered(peer_named(who), photons.position, hit_points.position)
    with peers.threads(n_threads):
        result = timed(
            lambda: tree.search(15, n_threads, limit), len(hit_points), task(n, n_threads), who
        )
    rows = checks.sample(len(hit_points))
    checks.assert_nearest(
        tree.answers(result, rows), photons.position, hit_points.position[rows], limit
    )


def test_gather(timed, photons, hit_points, n, n_threads):
    irradiance = timed(
        lambda field: field(hit_points.position, hit_points.normal),
        len(hit_points),
        task(n, n_threads),
        prepare=lambda: IrradianceField(photons, n_threads=n_threads),
    )
    some = checks.sample(len(hit_points))
    again = pr.estimate_irradiance(photons, hit_points.position[some], hit_points.normal[some])
    assert (irradiance[some] == again).all()
    assert (irradiance > 0.0).any()


def task(n, n_threads):
    return f"gather {n} {n_threads=}"
