"""Renders of photons that go on until an error is reached, and what may take their place."""

import json

import numpy as np
import pytest

import photonrelax as pr
from photonrelax.cli import main
from photonrelax.imaging.image import Image, read_exr
from photonrelax.rendering import error_target
from photonrelax.rendering.error_target import Goal, render_to_goal

SHAPE = (64, 64, 3)
TRUTH = 1.0 + np.random.default_rng(5).random(SHAPE)
PATTERN = np.random.default_rng(6).standard_normal(SHAPE)
OTHER_PATTERN = np.random.default_rng(7).standard_normal(SHAPE)


def image_of(n, seed, *, noise=1.0, bias=1.0):
    """Truth with independent noise and a bias, both as N^-½; biases of few and many are alike."""
    drawn = np.random.default_rng(seed).standard_normal(SHAPE)
    turned = 0.3 * np.log2(n)
    pattern = np.cos(turned) * PATTERN + np.sin(turned) * OTHER_PATTERN
    values = TRUTH + (noise * drawn + bias * pattern) / np.sqrt(n)
    stats = {"stages": {"render": {"seconds": 0.0}}}
    return Image({"radiance": values, "Z": np.full(SHAPE[:2], np.inf)}, {}, stats)


def test_photons_are_added_until_the_error_is_reached():
    image = render_to_goal(image_of, Goal(error=0.004), 1000, 0, "radiance")
    reached = image.stats["error"]
    assert reached["is_met"]
    assert 0.002 < reached["estimate"] <= 0.004
    error = np.abs(image.layers["radiance"] - TRUTH).sum() / TRUTH.sum()
    assert 0.5 < error / reached["estimate"] < 1.25
    assert json.loads(image.metadata["photonrelax.error"]) == reached
    assert np.isinf(image.layers["Z"]).all()


def test_seeds_of_images_differ():
    seeds = []

    def render(n, seed):
        seeds.append(seed)
        return image_of(n, seed)

    render_to_goal(render, Goal(error=0.004), 1000, 7, "radiance")
    assert len(set(seeds)) == len(seeds) > 3


def test_times_are_kept_and_used_and_longer_ones_reach_smaller_errors(monkeypatch):
    now, errors = [0.0], []
    monkeypatch.setattr(error_target, "perf_counter", lambda: now[0])

    def render(n, seed):
        now[0] += 0.02 + 1e-5 * n
        return image_of(n, seed)

    for seconds in (1.0, 4.0, 20.0, 100.0, 600.0):
        now[0] = 0.0
        image = render_to_goal(render, Goal(seconds=seconds), 1000, 0, "radiance")
        assert 0.8 * seconds < now[0] < seconds
        errors.append(np.abs(image.layers["radiance"] - TRUTH).sum())
    assert errors == sorted(errors, reverse=True)
    assert errors[-1] < 0.1 * errors[0]


def test_what_is_reached_stays_where_more_does_not_fit_in_memory():
    def render(n, seed):
        if n > 10_000:
            raise MemoryError
        return image_of(n, seed)

    reached = render_to_goal(render, Goal(error=1e-4), 1000, 0, "radiance").stats["error"]
    assert not reached["is_met"]


class Attempt:
    """Another way to an image that is worth it, once, and finds one or not."""

    def __init__(self, image):
        self.found, self.tried = image, 0

    def is_worth(self, trials, goal, left):
        return True

    def image(self, trials, goal, left):
        self.tried += 1
        return self.found


def test_an_alternative_takes_the_place_of_photons():
    other = image_of(1, 1)
    found = render_to_goal(image_of, Goal(0.004), 1000, 0, "radiance", alternative=Attempt(other))
    assert found is other


def test_an_alternative_that_fails_is_not_tried_again():
    attempt = Attempt(None)
    found = render_to_goal(image_of, Goal(0.004), 1000, 0, "radiance", alternative=attempt)
    assert found.stats["error"]["is_met"]
    assert attempt.tried == 1


def test_a_time_alone_takes_the_most_exact_preset():
    assert Goal(seconds=1.0).preset_error == 0.0
    assert Goal(error=0.1, seconds=1.0).preset_error == 0.1
    assert Goal().preset_error is None


def test_a_scene_is_rendered_to_an_error(ring):
    reached = pr.render(ring, error=0.3).stats["error"]
    assert reached["is_met"]
    assert reached["asked"] == 0.3


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"error": 0.0}, "error should be"),
        ({"seconds": -1.0}, "seconds should be"),
        ({"error": 0.1, "photons": "traced"}, "photons should not be given"),
        ({"preset": "best"}, "preset should be one of draft"),
    ],
)
def test_goals_that_cannot_be_reached_are_refused(ring, arguments, message):
    if "photons" in arguments:
        arguments = arguments | {"photons": pr.trace_photons(ring, 1000)}
    with pytest.raises(ValueError, match=message):
        pr.render(ring, **arguments)


def test_the_command_line_says_what_was_reached(tmp_path, capsys):
    command = ["render", "ring", "-o", str(tmp_path / "ring.exr"), "--width", "16"]
    assert main([*command, "--error", "0.5", "--seconds", "60"]) == 0
    told = capsys.readouterr().out
    assert "(asked: 0.5" in told
    assert "relative L1 of radiance: noise" in told


@pytest.mark.parametrize(
    "options",
    [
        ["--error", "0"],
        ["--error", "0.1", "--photon-map", "x.npz"],
        ["--error", "0.1", "--passes", "2"],
    ],
)
def test_wrong_usage(tmp_path, options):
    with pytest.raises(SystemExit):
        main(["render", "ring", "-o", str(tmp_path / "ring.exr"), *options])


def test_a_map_is_made_to_an_error(tmp_path, capsys):
    path = tmp_path / "map.exr"
    command = ["irradiance", "ring", "--on", "floor", "-o", str(path), "--texels", "16"]
    assert main([*command, "--error", "0.3"]) == 0
    assert "relative L1 of irradiance: noise" in capsys.readouterr().out
    told = json.loads(read_exr(path).metadata["photonrelax.error"])
    assert told["is_met"]
    assert told["of"] == "irradiance"


@pytest.mark.parametrize("options", [["--size", "0.1"], ["--method", "envelope"]])
def test_maps_that_do_not_compare_are_wrong_usage(tmp_path, options):
    command = ["irradiance", "ring", "--on", "floor", "-o", str(tmp_path / "map.exr")]
    with pytest.raises(SystemExit):
        main([*command, "--error", "0.3", *options])
