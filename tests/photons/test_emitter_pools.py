"""Emitters whose photons are neighbours of one another alone, and pools of the others."""

import numpy as np
import pytest

from photonrelax.photons.emitter_pools import emitter_pools
from photonrelax.photons.neighbourhoods import neighbour_groups
from tests.helpers.photon_maps import flat_map, unit_square

N = 20_000


def of_emitters(number, xy=None, flux=1.0):
    """Photons of 1 W in all over the unit square, of the emitters numbered."""
    xy = unit_square(len(number), "random") if xy is None else xy
    photons = flat_map(xy, len(number), emitter_id=number)
    return photons.replace(flux=photons.flux * np.reshape(flux, (-1, 1)))


def pooled(photons):
    """Number of each photon's pool, counted from 0; -1 for those of emitters by themselves."""
    pools = emitter_pools(photons, 1)
    return np.where(pools.number < pools.first_pool, -1, pools.number - pools.first_pool)


@pytest.mark.parametrize("n_emitters", [2, 5, 8])
def test_emitters_of_a_part_of_the_light_are_by_themselves(n_emitters):
    number = np.arange(N) % n_emitters
    groups = neighbour_groups(of_emitters(number), 1)
    assert len(groups) == n_emitters
    assert all(len(np.unique(number[group.rows])) == 1 for group in groups)
    assert not any(group.mixed or group.at_rest for group in groups)


@pytest.mark.parametrize("n_emitters", [12, 1000, N])
def test_many_emitters_of_one_light_are_one_pool(n_emitters):
    (group,) = neighbour_groups(of_emitters(np.arange(N) % n_emitters), 1)
    assert group.mixed
    assert not group.at_rest
    assert len(group.rows) == N


def test_emitters_with_a_place_of_their_own_are_by_themselves():
    """Two hundred spots side by side, and a few photons of others that lie on them."""
    number = np.arange(N) % 200
    spots = np.column_stack([number, np.zeros(N)]) + 0.5 * unit_square(N, "random")
    number = np.where(np.arange(N) < 40, 200, number)
    pool = pooled(of_emitters(number, spots))
    assert (pool[40:] == -1).all()
    assert (pool[:40] == 0).all()


def test_a_pool_is_of_similar_flux():
    number = np.arange(N) % 1000
    flux = np.array([1.0, 3.0, 40.0, 100.0])[number % 4]
    pool = pooled(of_emitters(number, flux=flux))
    np.testing.assert_array_equal(pool[flux < 10], pool[flux < 10][0])
    np.testing.assert_array_equal(pool[flux > 10], pool[flux > 10][0])
    assert pool[0] != pool[2]


def test_pools_of_little_light_are_at_rest():
    """Twenty lamps of a hundredth of the photons among those of a large one."""
    number = np.where(np.arange(N) % 100 == 0, 1 + np.arange(N) // 100 % 20, 0)
    at_rest = {group.at_rest: group.rows for group in neighbour_groups(of_emitters(number), 1)}
    np.testing.assert_array_equal(at_rest[True], np.flatnonzero(number))
    np.testing.assert_array_equal(at_rest[False], np.flatnonzero(number == 0))


def test_the_order_of_the_photons_does_not_matter():
    number = np.where(np.arange(N) % 3, 0, np.arange(N) % 400)
    photons, order = of_emitters(number), np.random.default_rng(0).permutation(N)
    np.testing.assert_array_equal(pooled(photons.subset(order)), pooled(photons)[order])


def test_many_groups_share_a_tree():
    number = np.arange(N) % 200
    spots = np.column_stack([number, np.zeros(N)]) + 0.5 * unit_square(N, "random")
    groups = neighbour_groups(of_emitters(number, spots), 1)
    assert len(groups) == 17
    together = groups[-1]
    np.testing.assert_array_equal(
        np.unique(number[together.rows]), np.unique(together.labels[together.rows] // 64)
    )


def test_emitters_at_the_same_points_share_the_light():
    """Of a beam's photons, stored at its axis, each emitter has one."""
    axes = unit_square(200, "random")[np.arange(N) % 200]
    pool = pooled(of_emitters(np.arange(N) // 200 % 2, axes))
    assert (pool == -1).all()
