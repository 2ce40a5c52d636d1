"""Both branches of rays at dielectrics, and roulette for the faint ones."""

import numpy as np
import pytest
from photonrelax._ext.transport.splitting import sheets

import photonrelax as pr
from photonrelax._util.parallel import thread_executor
from photonrelax.transport.splitting import SplittingTracer
from tests.helpers.tracing_scenes import floor, mirror_ball, slab

DOWN = np.array([0.0, 0.0, -1.0])


def scene(*objects):
    return pr.Scene([floor(), *objects], [pr.CollimatedEmitter(DOWN)])


def down(n, seed=1):
    """Rays from above onto the middle of the scene."""
    xy = np.random.default_rng(seed).uniform(-0.3, 0.3, (n, 2))
    origin = np.column_stack([xy, np.full(n, 3.0)])
    return origin, np.tile(DOWN, (n, 1)), np.arange(n, dtype=np.uint64)


def arrivals(of, n=200, least=1e-12, n_threads=1):
    with thread_executor(n_threads) as executor:
        return SplittingTracer(of, least, executor=executor).explore(*down(n), 0)[0]


def test_a_slab_passes_every_order_of_internal_reflection():
    """(1 - R)² R^(2k), each a signature of its own, at the ray's own place."""
    found = arrivals(scene(slab(ior=1.5)), n=5)
    reflectance = 0.2**2
    for node in range(5):
        here = found[found.node == node]
        orders = (1.0 - reflectance) ** 2 * reflectance ** (2.0 * np.arange(len(here)))
        np.testing.assert_allclose(-np.sort(-here.throughput[:, 0]), orders, rtol=1e-9)
        assert len(np.unique(here.sheet)) == len(here) == 5
        np.testing.assert_allclose(here.position[:, :2], down(5)[0][[node] * 5, :2], atol=1e-6)
    assert not found.is_single.any()
    first = found[found.node == 0].sheet
    assert (np.sort(found[found.node == 4].sheet) == np.sort(first)).all()


@pytest.mark.parametrize("least", [1e-4, 1e-2, 0.5])
def test_roulette_loses_no_light_on_average(least):
    exact = arrivals(scene(slab(ior=1.5)), n=5).throughput.sum() / 5
    n = 40_000
    found = arrivals(scene(slab(ior=1.5)), n=n, least=least)
    light = np.bincount(found.node, found.throughput.sum(axis=1), minlength=n)
    assert abs(light.mean() - exact) < 4.0 * light.std() / np.sqrt(n) + 1e-12 * exact
    assert found.throughput[found.is_single].max(initial=0.0) <= least * (1.0 + 1e-12)
    assert (found.throughput[~found.is_single].max(axis=1) >= least).all()


def test_wanted_sheets_alone_are_followed():
    """The same arrivals as of all paths, however faint, without rays of others."""
    tracer = SplittingTracer(scene(slab(ior=1.5)), 1e-12)
    origin, direction, key = down(20)
    found, signatures = tracer.explore(origin, direction, key, 0)
    n_segments = tracer.n_segments
    before = dict(signatures.tolist())
    for order in (found[found.node == 0].throughput[:, 0].argmin(), 0):
        wanted = found[found.node == 0][[order]]
        path = int(sheets(wanted.sheet, wanted.object_id)[0])
        followed = {int(wanted.sheet[0])}
        while path:
            followed.add(path)
            path = before[path]
        again = tracer.trace(origin, direction, np.array(sorted(followed), np.uint64), 0)
        for name in vars(again):
            expected = getattr(found[found.sheet == wanted.sheet[0]], name)
            np.testing.assert_array_equal(getattr(again, name), expected)
    assert tracer.n_segments < 2 * n_segments


def test_light_that_meets_nothing_specular_does_not_arrive():
    assert len(arrivals(scene())) == 0


def test_mirrors_take_their_share_and_absorption_its_own():
    found = arrivals(scene(slab(absorption=(0.5, 1.0, 0.0))), n=3)
    first = found[found.throughput[:, 2] > 0.5]
    thickness = np.ptp(slab().mesh.vertices[:, 2])
    expected = np.exp(-thickness * np.array([0.5, 1.0, 0.0]))
    np.testing.assert_allclose(
        first.throughput / first.throughput[:, 2:], np.tile(expected, (3, 1)), rtol=1e-9
    )


def test_threads_and_batches_do_not_matter():
    of = scene(slab(ior=1.5), mirror_ball(0.9))
    one, many = (arrivals(of, n=30_000, least=0.01, n_threads=n) for n in (1, 7))
    for name in vars(one):
        assert getattr(one, name).tobytes() == getattr(many, name).tobytes()


def test_rays_that_do_not_fit_are_refused():
    tracer = SplittingTracer(scene(slab()), 0.01)
    origin, direction, key = down(10)
    with pytest.raises(ValueError, match="do not fit one another"):
        tracer.explore(origin[:, :2].copy(), direction, key, 0)
    origin[3] = np.nan
    with pytest.raises(ValueError, match="should be finite"):
        tracer.explore(origin, direction, key, 0)
