"""Envelopes that are divided until an error is reached, and when they take the place of photons."""

from dataclasses import replace

import numpy as np
import pytest
import trimesh

import photonrelax as pr
from photonrelax.imaging.image import Image
from photonrelax.rendering import envelope_target, error_target
from photonrelax.rendering.envelope_target import EnvelopeAttempt, Parts, divide_to_goal
from photonrelax.rendering.error_target import Goal, render_to_goal
from photonrelax.rendering.presets import Work

SHAPE = (32, 32, 3)
TRUTH = 1.0 + np.random.default_rng(5).random(SHAPE)
OTHER = 0.5 * np.ones(SHAPE)


def image_of(values, name, **stats):
    layers = {"radiance": values, name: values}
    return Image(layers, {}, {"stages": {"render": {"seconds": 0.0}}, **stats})


def noisy(scale, seed):
    return scale * np.random.default_rng(seed).standard_normal(SHAPE)


class Divided:
    """Envelopes whose error over pixels is half of the light that is misplaced."""

    def __init__(self, of_photons=0.0, least=0.0):
        self.limits, self._of_photons, self._least = [], of_photons, least

    def __call__(self, limits):
        self.limits.append(limits)
        misplaced = max(limits.misplaced, self._least)
        values = TRUTH + noisy(0.6 * misplaced * TRUTH.mean(), len(self.limits))
        found = {"error": misplaced, "rays": round(3000.0 / misplaced), "noise": 0.0}
        return image_of(values, "caustic", envelope=found | {"of_photons": self._of_photons})


def photons(n, seed):
    caustic = TRUTH + noisy(20.0 / np.sqrt(n), seed)
    layers = {"radiance": caustic + OTHER, "caustic": caustic, "direct": OTHER}
    return Image(layers, {}, {"stages": {"render": {"seconds": 0.0}}})


def true_error(image, truth=TRUTH):
    return np.abs(image.layers["radiance"] - truth).sum() / truth.sum()


@pytest.mark.parametrize("error", [0.05, 0.01])
def test_envelopes_are_divided_until_the_error_is_reached(error):
    image = divide_to_goal(Parts(Divided()), Goal(error), 0)
    reached = image.stats["error"]
    assert reached["is_met"]
    assert 0.5 < true_error(image) / reached["estimate"] < 1.25


def test_an_envelope_that_misplaces_little_is_the_only_one():
    divided = Divided()
    assert divide_to_goal(Parts(divided), Goal(0.05), 0).stats["error"]["is_met"]
    assert len(divided.limits) == 1


def test_envelopes_that_do_not_get_finer_end_and_say_that_it_is_not_reached():
    divided = Divided(least=0.2)
    image = divide_to_goal(Parts(divided), Goal(0.001), 0)
    assert not image.stats["error"]["is_met"]
    assert len(divided.limits) <= 3


def test_other_light_is_rendered_until_the_error_of_both_is_reached():
    def others(n, seed):
        return image_of(OTHER + noisy(5.0 / np.sqrt(n), seed), "indirect")

    image = divide_to_goal(Parts(Divided(), others, True, True), Goal(0.01), 0)
    reached = image.stats["error"]
    assert reached["is_met"]
    assert reached["photons_of_image"] > 4000
    assert 0.4 < true_error(image, TRUTH + OTHER) / reached["estimate"] < 1.25


def attempt(divided):
    parts = Parts(divided, lambda n, seed: image_of(OTHER, "direct"))
    return EnvelopeAttempt(parts, Work(photon=1e-5, envelope=0.5), 0)


@pytest.mark.parametrize(("error", "is_tried"), [(0.1, False), (0.01, True)])
def test_envelopes_are_tried_where_photons_would_take_longer(error, is_tried):
    divided = Divided()
    other = attempt(divided)
    image = render_to_goal(photons, Goal(error), 1000, 0, "radiance", alternative=other)
    assert bool(divided.limits) == is_tried
    assert image.stats["error"]["is_met"]
    assert true_error(image, TRUTH + OTHER) < 1.25 * error


def test_light_that_is_left_to_photons_is_rendered_by_these():
    divided = Divided(of_photons=0.9)
    other = attempt(divided)
    image = render_to_goal(photons, Goal(0.01), 1000, 0, "radiance", alternative=other)
    assert len(divided.limits) == 1
    assert "envelope" not in image.stats
    assert image.stats["error"]["is_met"]


def test_divisions_that_would_take_longer_than_photons_are_given_up():
    divided = Divided(least=0.2)
    other = attempt(divided)
    image = render_to_goal(photons, Goal(0.01), 1000, 0, "radiance", alternative=other)
    assert "envelope" not in image.stats
    assert image.stats["error"]["is_met"]


@pytest.mark.parametrize("seconds", [3.0, 10.0, 60.0])
def test_a_time_is_kept_by_what_reaches_most_in_it(monkeypatch, seconds):
    now, divided = [0.0], Divided()
    for module in (error_target, envelope_target):
        monkeypatch.setattr(module, "perf_counter", lambda: now[0])

    def divide(limits):
        image = divided(limits)
        now[0] += 5e-5 * image.stats["envelope"]["rays"]
        return image

    def render(n, seed):
        now[0] += 1e-5 * n
        return photons(n, seed)

    estimates = []
    for other in (None, attempt(divide)):
        now[0] = 0.0
        image = render_to_goal(render, Goal(None, seconds), 1000, 0, "radiance", alternative=other)
        assert 0.8 * seconds < now[0] < seconds
        estimates.append(image.stats["error"]["estimate"])
    assert divided.limits
    # A try that fails takes time; one that does not is worth more.
    assert estimates[1] < (0.8 if seconds == 60.0 else 1.5) * estimates[0]


def test_an_envelope_is_rendered_to_an_error(ring):
    reached = pr.render(ring, method="envelope", error=0.05).stats["error"]
    assert reached["is_met"]
    assert reached["estimate"] > 0.0


def test_the_method_follows_from_the_error(ring):
    methods = [pr.render(ring, error=each).metadata["photonrelax.method"] for each in (0.3, 0.01)]
    assert methods == ["mapped", "envelope"]


def test_settings_that_are_given_keep_the_method(ring):
    image = pr.render(ring, error=0.05, gather=pr.GatherSettings(k=9))
    assert image.metadata["photonrelax.method"] == "mapped"


def test_indirect_light_is_in_the_image_of_an_envelope(ring):
    corners = [(-2.0, 0.5, 0.0), (2.0, 0.5, 0.0), (2.0, 0.5, 2.0), (-2.0, 0.5, 2.0)]
    wall = trimesh.Trimesh(corners, [[0, 1, 2], [0, 2, 3]], process=False)
    scene = replace(ring, objects=(*ring.objects, pr.SceneObject(wall, pr.Diffuse((0.8,) * 3))))
    image = pr.render(scene, method="envelope", error=0.05)
    light = ("caustic", "direct", "indirect")
    total = sum(np.asarray(image.layers[each]) for each in light)
    np.testing.assert_allclose(image.layers["radiance"], total)
    assert image.layers["indirect"].any()
    assert image.stats["error"]["noise"] > 0.0
