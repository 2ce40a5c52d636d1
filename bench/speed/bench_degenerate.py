"""Photons that are the worst case of trees: many at one place, on a line, on a lattice."""

import pytest

from bench.speed import inputs, peers
from bench.speed.timing import Case
from bench.speed.workbench import DEGENERATE, degenerate_cases


@pytest.fixture(scope="session")
def n_degenerate(request):
    return 4_000 if request.config.getoption("benchmark_disable") else 200_000


@pytest.fixture(scope="session", params=inputs.DEGENERATE)
def kind(request):
    return request.param


@pytest.fixture(scope="session")
def cases(kind, n_degenerate):
    return degenerate_cases(inputs.degenerate(kind, n_degenerate))


@pytest.mark.parametrize("name", DEGENERATE)
def test_degenerate(timed, cases, n_degenerate, kind, name):
    timed(cases[name], n_degenerate, f"degenerate {name}", kind)


def test_coincident_photons_by_a_peer(timed, n_degenerate):
    points = inputs.degenerate("coincident", n_degenerate).position
    try:
        tree = peers.Ordered(peers.named("pykdtree"), points)
    except peers.UnavailableError as error:
        pytest.skip(str(error))
    with peers.threads(1):
        case = Case(lambda _: tree.search(50, 1), rounds=1)
        timed(case, n_degenerate, "coincident", "pykdtree")
