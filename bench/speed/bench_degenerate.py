"""Photons that defeat trees: many at one place, on a line, on a lattice."""

import pytest

from bench.speed import checks, inputs, peers, stages

WORK = ("neighbours", "constrained neighbours", "structure", "relaxation", "gathering")


@pytest.fixture(scope="session")
def n_degenerate(request):
    return 4_000 if request.config.getoption("benchmark_disable") else 200_000


@pytest.mark.parametrize("work", WORK)
@pytest.mark.parametrize("kind", inputs.DEGENERATE)
def test_degenerate(timed, n_degenerate, kind, work):
    photons = inputs.degenerate(kind, n_degenerate)
    call = stages.awkward_calls(photons)[work]
    result = timed(call, n_degenerate, f"degenerate {work}", kind)
    if work == "neighbours":
        points = photons.position
        rows = checks.sample(n_degenerate)
        checks.assert_nearest((result.ids[rows], result.distance[rows]), points, points[rows])
    elif work == "constrained neighbours":
        found = result.ids, result.distance
        checks.assert_nearest_in_range(found, inputs.sheet_of(photons), 50)
    elif work == "structure":
        checks.assert_neighbourhoods(result, photons, 50)


def test_peers_too(timed, n_degenerate):
    """How pykdtree fares with many photons at one point."""
    points = inputs.degenerate("coincident", n_degenerate).position
    try:
        tree = peers.Ordered(peers.named("pykdtree"), points)
    except LookupError as error:
        pytest.skip(str(error))
    with peers.threads(1):
        timed(lambda: tree.search(50, 1), n_degenerate, "coincident", "pykdtree", rounds=1)
