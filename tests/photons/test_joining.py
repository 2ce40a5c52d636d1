"""Maps of parts of an emission, joined; independent maps, averaged."""

from itertools import pairwise

import numpy as np
import pytest

import photonrelax as pr
from photonrelax.photons.energy_ledger import PATH_OUTCOMES
from tests.helpers.tracing_scenes import SCENES, floor, glass_ball
from tests.transport.test_trace import PER_PHOTON

N = 3000
each_scene = pytest.mark.parametrize("scene", SCENES.values(), ids=SCENES.keys())


def parts(scene, *bounds, n=N, **settings):
    ranges = [range(*pair) for pair in pairwise(bounds)]
    return [pr.trace_photons(scene, n, photons=each, **settings) for each in ranges]


@each_scene
@pytest.mark.parametrize("paths", ["caustic", "all"])
def test_parts_of_an_emission_join_to_the_bytes_of_the_whole(scene, paths):
    whole = pr.trace_photons(scene, N, paths=paths)
    some = parts(scene, 0, 1, 1024, 1500, N, paths=paths)
    joined = pr.PhotonMap.concatenate([some[2], some[0], some[3], some[1]])
    for name in PER_PHOTON:
        assert getattr(joined, name).tobytes() == getattr(whole, name).tobytes(), name
    assert joined.well_spaced == whole.well_spaced
    assert joined.emitted_ranges is None
    for name in ("emitted", *PATH_OUTCOMES):
        expected = getattr(whole.ledger, name)
        np.testing.assert_allclose(getattr(joined.ledger, name), expected, rtol=1e-13, atol=1e-13)
    np.testing.assert_equal(joined.ledger.ends, whole.ledger.ends)


@each_scene
def test_the_ledger_of_a_part_is_balanced(scene):
    for part in parts(scene, 0, 700, N, paths="all"):
        assert part.ledger.imbalance < 1e-12


def test_so_is_that_of_a_part_of_a_coloured_sky():
    sky = pr.EnvironmentEmitter(np.random.default_rng(0).random((8, 16, 3)))
    for part in parts(pr.Scene([floor(), glass_ball()], [sky]), 0, 700, N):
        assert part.ledger.imbalance < 1e-12


def test_parts_joined_may_be_joined_again(tmp_path):
    one, two, three = parts(SCENES["glass ball"], 0, 1000, 2000, N)
    pr.PhotonMap.concatenate([two, one]).save(tmp_path / "part.npz")
    most = pr.PhotonMap.load(tmp_path / "part.npz")
    assert most.emitted_ranges.tolist() == [[0, 2000]]
    assert most.well_spaced
    assert pr.PhotonMap.concatenate([three, most]).emitted_ranges is None


def test_ranges_with_gaps_are_kept_and_not_well_spaced():
    one, _, three = parts(SCENES["glass ball"], 0, 1000, 2000, N)
    apart = pr.PhotonMap.concatenate([three, one])
    assert apart.emitted_ranges.tolist() == [[0, 1000], [2000, N]]
    assert not apart.well_spaced


def test_parts_that_do_not_fit_are_refused_in_words():
    scene = SCENES["glass ball"]
    one, two = parts(scene, 0, 1000, N)
    (other,) = parts(scene, 1000, N, seed=1)
    concatenate = pr.PhotonMap.concatenate
    with pytest.raises(ValueError, match="seed differs: 0, 1"):
        concatenate([one, other])
    with pytest.raises(ValueError, match="goes on to photon 1000 and another starts at 0"):
        concatenate([one, two, one])
    with pytest.raises(ValueError, match="whose seed and number are known"):
        concatenate([one, one.replace(emitted_ranges=None, seed=None)])
    with pytest.raises(ValueError, match="some are missing"):
        concatenate([one, two.replace(wi=None)])
    with pytest.raises(
        ValueError, match="their ledgers, sensors, extended emitters, wavelengths or digests"
    ):
        concatenate([one, two.replace(ledger=None)])
    with pytest.raises(TypeError, match="at least one, but are none"):
        concatenate([])
    with pytest.raises(TypeError, match="but is one"):
        concatenate(one)


@pytest.mark.parametrize("photons", [range(0), range(5, N + 1), range(0, 10, 2), range(-1, 5)])
def test_photons_that_are_not_of_the_emission_are_refused(photons):
    with pytest.raises(ValueError, match="photons should be some of range"):
        pr.trace_photons(SCENES["glass ball"], N, photons=photons)
    with pytest.raises(TypeError, match="photons should be a range of indices, but is list"):
        pr.trace_photons(SCENES["glass ball"], N, photons=list(photons))


def test_ranges_that_are_none_of_the_emission_are_refused():
    (part,) = parts(SCENES["glass ball"], 0, 1000)
    for ranges in ([[5, 3]], [[0, N + 1]], [], [[10, 20], [0, 5]]):
        with pytest.raises(ValueError, match="emitted_ranges should"):
            part.replace(emitted_ranges=np.reshape(ranges, (-1, 2)))


def test_an_average_has_the_mean_flux_and_the_density_of_all():
    scene = SCENES["glass ball"]
    maps = [pr.trace_photons(scene, n, seed=seed) for seed, n in enumerate((1000, 3000))]
    mean = pr.PhotonMap.average(maps)
    flux = [each.flux.sum(axis=0) for each in maps]
    np.testing.assert_allclose(mean.flux.sum(axis=0), np.mean(flux, axis=0))
    np.testing.assert_allclose(mean.emitter_density[0], 4.0 * maps[0].emitter_density[0])
    np.testing.assert_allclose(mean.ledger.stored, mean.flux.sum(axis=0)[np.newaxis])
    assert (mean.n_emitted, mean.seed, mean.well_spaced) == (4000, None, False)


def test_maps_that_are_not_independent_are_refused():
    one, two = parts(SCENES["glass ball"], 0, 1000, N)
    whole = pr.PhotonMap.concatenate([one, two])
    with pytest.raises(ValueError, match="one is of a range of photons"):
        pr.PhotonMap.average([one, two])
    with pytest.raises(ValueError, match="two have the same seed"):
        pr.PhotonMap.average([whole, whole])
    with pytest.raises(ValueError, match="their paths differ"):
        pr.PhotonMap.average([whole, whole.replace(paths="all", seed=1)])


def test_a_part_is_not_rendered_as_if_it_were_all_light():
    scene = pr.gallery.scene("ring")
    part = pr.trace_photons(scene, N, photons=range(1000))
    with pytest.raises(ValueError, match=r"\[\[0, 1000\]\] of 3000: join its parts"):
        pr.render(scene, photons=part)
