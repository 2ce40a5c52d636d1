"""Trees and neighbours, beside SciPy, pykdtree, numba-kdtree and recipes of NumPy and SciPy."""

import pytest

import photonrelax as pr
from bench.speed import checks, inputs, peers, stages

PEERS = [peer.name for peer in peers.ALL]
# A recipe takes minutes for more photons than this.
MOST_FOR_RECIPES = 1_000_000


def task_of(n, k, n_threads):
    return f"neighbours {n} {k=} {n_threads=}"


@pytest.fixture(scope="session")
def points(n):
    """Positions in Morton order: searches, peers' and photonrelax's, are given the same array."""
    return inputs.along_curve(n).position


def found(neighbours):
    return neighbours.ids, neighbours.distance


def peer_named(name):
    try:
        return peers.named(name)
    except LookupError as error:
        pytest.skip(str(error))


@pytest.mark.parametrize("who", PEERS)
def test_build_by_peers(timed, points, n, who):
    peer = peer_named(who)
    with peers.threads(1):
        timed(lambda _: peer.build(points), n, f"build {n}", who, prepare=object)


@pytest.mark.parametrize("n_axes", [3, 5, 6])
def test_build(timed, n, n_axes):
    sheet = inputs.sheet(n, max(n_axes, 5))
    points = sheet.position if n_axes == 3 else sheet.points
    task = f"build {n}" if n_axes == 3 else f"build {n}, {n_axes} axes"
    timed(lambda: pr.KDTree(points, n_threads=1), n, task)


@pytest.mark.parametrize("k", [50, 16, 15])
@pytest.mark.parametrize("who", PEERS)
def test_neighbours_by_peers(timed, points, n, n_threads, k, who):
    tree = peers.Ordered(peer_named(who), points)
    with peers.threads(n_threads):
        result = timed(lambda: tree.search(k, n_threads), n, task_of(n, k, n_threads), who)
    rows = checks.sample(n)
    checks.assert_nearest(tree.answers(result, rows), points, points[rows])


@pytest.mark.parametrize("k", [50, 16, 15])
def test_neighbours(timed, points, n, n_threads, k):
    _time_search(timed, points, k, n_threads, task=task_of(n, k, n_threads))


def test_neighbours_in_order_of_emission(timed, photons, n, n_threads):
    """Beside the same search in Morton order: what order costs."""
    beside = task_of(n, 50, n_threads)
    task = f"{beside}, order of emission"
    _time_search(timed, photons.position, 50, n_threads, task=task, beside=beside)


def _time_search(timed, points, k, n_threads, **names):
    result = timed(
        lambda tree: tree.query_self(k, n_threads=n_threads),
        len(points),
        prepare=lambda: pr.KDTree(points),
        **names,
    )
    rows = checks.sample(len(points))
    checks.assert_nearest((result.ids[rows], result.distance[rows]), points, points[rows])


@pytest.mark.parametrize("n_axes", [5, 6])
@pytest.mark.parametrize("who", peers.RECIPES)
def test_constrained_by_recipes(timed, n, n_threads, n_axes, who):
    if n > MOST_FOR_RECIPES:
        pytest.skip(f"recipes are timed for up to {MOST_FOR_RECIPES} photons, not for {n}")
    sheet = inputs.sheet(n, n_axes)
    with peers.threads(n_threads):
        result = timed(
            lambda: peers.RECIPES[who](sheet, 50, n_threads),
            n,
            f"constrained {n} {n_axes=} {n_threads=}",
            who,
            rounds=1,
        )
    checks.assert_nearest_in_range(result, sheet, 50)


@pytest.mark.parametrize("n_axes", [5, 6])
def test_constrained(timed, n, n_threads, n_axes):
    sheet = inputs.sheet(n, n_axes)
    result = timed(
        lambda tree: tree.query_self(50, range_radius=sheet.radius, n_threads=n_threads),
        n,
        f"constrained {n} {n_axes=} {n_threads=}",
        prepare=lambda: stages.tree(sheet, constrained=True),
    )
    checks.assert_nearest_in_range(found(result), sheet, 50)
