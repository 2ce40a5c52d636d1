"""Photons are allotted to emitters by what these send out and bring to what is stored."""

import numpy as np
import pytest

import photonrelax as pr
from photonrelax.transport.emission import plan_emission
from tests.helpers.tracing_scenes import box, floor, glass_ball, sheet

LAMPS = [pr.PointEmitter((-1.0, 0, 2.5)), pr.PointEmitter((1.0, 0, 2.5), 2.0)]
N = 20_000


def emitted(photons):
    """Paths of each emitter."""
    return np.sum(list(photons.ledger.ends.values()), axis=0)


def closed_box(lamp):
    """A black box around a lamp."""
    return pr.SceneObject(box([0.2] * 3, lamp.position), pr.Diffuse(0.0))


def test_a_lamp_that_is_shut_in_does_not_eat_the_photons():
    free = pr.Scene([floor(), glass_ball()], LAMPS)
    shut = pr.Scene([floor(), glass_ball(), closed_box(LAMPS[1])], LAMPS)
    half_of_a_path = np.sqrt(0.5 / 1024)
    assert emitted(pr.trace_photons(free, N))[1] > 0.6 * N
    found = emitted(pr.trace_photons(shut, N))
    assert found.sum() == N
    assert 0 < found[1] < 3.0 * half_of_a_path * N


def test_lamps_that_bring_as_much_of_what_they_send_share_by_flux():
    scene = pr.Scene([floor(), glass_ball()], LAMPS)
    np.testing.assert_array_equal(
        emitted(pr.trace_photons(scene, N)), plan_emission(scene, N).counts
    )
    np.testing.assert_allclose(plan_emission(scene, N).counts / N, [1 / 3, 2 / 3], atol=1e-4)


def test_numbers_follow_the_root_of_what_is_sent_and_brought():
    """A roof keeps half of the light of one of two lamps from the glass."""
    glass = pr.SceneObject(box([1, 1, 0.1]), pr.Dielectric())
    roof = pr.SceneObject(box([2, 1, 0.01], [0, 0.5, 1.5]), pr.Diffuse(0.0))
    lamps = [pr.PointEmitter((0, 0, z)) for z in (-2, 2)]
    floors = [pr.SceneObject(sheet(3.0, z=z), pr.Diffuse()) for z in (-3.0, 3.0)]
    scene = pr.Scene([*floors, glass, roof], lamps)
    stored = [pr.trace_photons(scene, numbers).flux.sum() for numbers in ((N, 0), (0, N))]
    found = emitted(pr.trace_photons(scene, N))
    assert stored[1] < 0.6 * stored[0]
    np.testing.assert_allclose(found[0] / found[1], np.sqrt(stored[0] / stored[1]), rtol=0.1)


def test_flux_does_not_depend_on_the_numbers():
    scene = pr.Scene([floor(), glass_ball(), closed_box(LAMPS[1])], LAMPS)
    allotted, even = pr.trace_photons(scene, N), pr.trace_photons(scene, (N // 2, N // 2))
    np.testing.assert_allclose(allotted.ledger.emitted, even.ledger.emitted, rtol=1e-9)
    np.testing.assert_allclose(allotted.flux.sum(axis=0), even.flux.sum(axis=0), rtol=0.01)


def test_the_seed_does_not_change_the_numbers_nor_do_threads():
    scene = pr.Scene([floor(), glass_ball(), closed_box(LAMPS[1])], LAMPS)
    one = pr.trace_photons(scene, N, n_threads=1)
    again = pr.Scene(scene.objects, scene.emitters)
    two = pr.trace_photons(again, N, n_threads=2)
    np.testing.assert_array_equal(one.position, two.position)
    other = pr.trace_photons(scene, N, seed=5, sampler="random")
    np.testing.assert_array_equal(emitted(one), emitted(other))


def test_numbers_that_are_asked_for_are_kept():
    scene = pr.Scene([floor(), glass_ball()], LAMPS)
    photons = pr.trace_photons(scene, (1000, 3000))
    np.testing.assert_array_equal(emitted(photons), [1000, 3000])
    assert photons.n_emitted == 4000
    np.testing.assert_allclose(
        photons.ledger.emitted, pr.trace_photons(scene, 4000).ledger.emitted, rtol=1e-9
    )
    left_out = pr.trace_photons(scene, np.array([0, 500]))
    assert set(left_out.emitter_id) == {1}


def test_maps_of_numbers_asked_for_are_rendered():
    camera = pr.Camera((0, -4, 3), (0, 0, 0), width=8, height=8)
    scene = pr.Scene([floor(), glass_ball()], LAMPS, camera)
    photons = pr.trace_photons(scene, (500, 2000))
    assert pr.render(scene, photons=photons).layers["caustic"].any()


@pytest.mark.parametrize(
    ("numbers", "message"),
    [
        ((100,), "a number for each of the 2 emitters, but has 1"),
        ((100, -1), "at least 0, but is -1"),
        ((0, 0), "at least 1, but is 0"),
    ],
)
def test_numbers_that_make_no_sense_are_refused(numbers, message):
    scene = pr.Scene([floor(), glass_ball()], LAMPS)
    with pytest.raises(ValueError, match=message):
        pr.trace_photons(scene, numbers)


def test_photons_of_an_emitter_that_faces_away_are_refused():
    up = pr.LambertianEmitter((0, 0, 3), (0, 0, 1))
    scene = pr.Scene([floor(), glass_ball()], [LAMPS[0], up])
    with pytest.raises(ValueError, match="0 for emitter 1, which has no power or faces away"):
        pr.trace_photons(scene, (100, 100))
    assert emitted(pr.trace_photons(scene, N))[1] == 0
