"""The light that a render models: what a scene has, and what is asked for."""

from dataclasses import replace

import numpy as np
import pytest

import photonrelax as pr
from photonrelax.cli.reports import cost_table, plan_table
from photonrelax.rendering.cost import estimate_costs
from tests.helpers.tracing_scenes import DOWN, ball, box, enclosure, floor, glass_ball, sheet

CAMERA = pr.Camera((0.0, -0.8, 0.0), (0.0, 0.5, 0.0), width=16, height=16)
LAMP = pr.PointEmitter([0.0, 0.0, 0.5])


def reasons(scene, **options):
    """Components that are modelled, and reasons of those that are not."""
    parts = pr.plan(scene, n_emitted=5000, **options).parts
    return {part.component: part.reason if not part.is_modelled else True for part in parts}


def test_a_plane_alone_has_direct_light_alone():
    found = reasons(pr.Scene([floor()], [DOWN]))
    assert found["direct"] is True
    assert "Mirror" in found["caustic"]
    assert "plane" in found["indirect"]


def test_glass_above_a_floor_has_caustics():
    planned = pr.plan(pr.Scene([floor(), glass_ball()], [DOWN]), n_emitted=5000)
    assert planned.models("caustic")
    assert planned.n_emitted == 5000


def test_glass_and_mirrors_alone_have_no_caustics():
    """As in a white furnace: what is seen is the background, through glass too."""
    camera = pr.Camera((0.0, -3.0, 1.0), (0.0, 0.0, 1.0), width=8, height=8)
    objects = [glass_ball(), pr.SceneObject(sheet(1.0), pr.Sensor())]
    scene = pr.Scene(objects, [pr.EnvironmentEmitter(0.5)], camera)
    assert "Diffuse" in reasons(scene)["caustic"]
    radiance = pr.render(scene).layers["radiance"]
    np.testing.assert_allclose(radiance.mean(), 0.5, rtol=0.01)


def test_black_surfaces_scatter_no_light():
    assert "reflects" in reasons(pr.Scene([enclosure(0.0)], [LAMP]))["indirect"]


def test_a_ball_lit_from_outside_does_not_light_itself():
    planned = pr.plan(pr.Scene([pr.SceneObject(ball(1.0, [0, 0, 0]), pr.Diffuse())], [DOWN]))
    assert not planned.models("indirect")
    assert planned.n_global == 0


@pytest.mark.parametrize("albedo", [0.5, 0.9])
def test_indirect_light_takes_a_million_photons_at_most(albedo):
    """A path in an enclosure is stored a / (1 - a) times."""
    planned = pr.plan(pr.Scene([enclosure(albedo)], [LAMP]), n_emitted=10**8)
    np.testing.assert_allclose(planned.n_global, 1e6 * (1 - albedo) / albedo, rtol=0.05)
    few = pr.plan(pr.Scene([enclosure(albedo)], [LAMP]), n_emitted=1000)
    assert few.n_global == 1000


def test_a_choice_overrides_the_scene():
    scene = pr.Scene([enclosure(0.5), glass_ball()], [LAMP])
    assert pr.plan(scene, n_global=7, n_emitted=5000).n_global == 7
    assert reasons(scene, n_global=0)["indirect"] == "n_global is 0"
    assert reasons(scene, components=("caustic",)) == {
        "emission": "not asked for",
        "direct": "not asked for",
        "caustic": True,
        "indirect": "not asked for",
    }


def test_photons_that_are_given_are_not_emitted_again():
    scene = pr.Scene([floor(), glass_ball()], [DOWN])
    photons = pr.trace_photons(scene, 2000)
    planned = pr.plan(scene, photons=photons)
    assert planned.models("caustic")
    assert planned.n_emitted == 0
    whole = pr.trace_photons(scene, 2000, paths="all")
    assert not pr.plan(scene, photons=whole).models("indirect")


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"components": ("direct", "bounce")}, "components should be of emission.*'bounce'"),
        ({"components": "direct"}, "components should be several names, but is 'direct'"),
        ({"n_global": -1}, "n_global should be at least 0, but is -1"),
        ({"n_emitted": 0}, "n_emitted should be at least 1, but is 0"),
    ],
)
def test_what_makes_no_sense_is_refused(options, message):
    with pytest.raises((TypeError, ValueError), match=message):
        pr.plan(pr.Scene([floor()], [DOWN]), **options)


def test_the_table_has_a_line_a_component():
    table = plan_table(pr.plan(pr.Scene([floor(), glass_ball()], [DOWN]), n_emitted=5000))
    assert [line.split()[0] for line in table.splitlines()] == [
        "emission",
        "direct",
        "caustic",
        "indirect",
    ]
    assert "5,000 photons" in table


@pytest.mark.kernels_run_elsewhere
def test_costs_scale_with_photons_and_pixels():
    """Counts are exact up to what the sequence leaves of a share; times are positive."""
    scene = pr.Scene([enclosure(0.5), glass_ball()], [LAMP], replace(CAMERA, width=200))
    planned = pr.plan(scene, n_emitted=200_000, n_global=100_000)
    costs = estimate_costs(scene, planned)
    photons = pr.trace_photons(scene, 200_000)
    assert costs["trace"].photons == pytest.approx(len(photons), rel=0.02)
    # A path in an enclosure of albedo a is stored a / (1 - a) times.
    assert costs["trace indirect"].photons == pytest.approx(100_000, rel=0.03)
    assert all(cost.seconds > 0.0 for cost in costs.values())
    assert [line.split()[0] for line in cost_table(costs).splitlines()][-1] == "total"


def test_a_closed_room_has_the_radiance_of_its_furnace():
    """Everywhere L = a E / π, with E = Φ / (A (1 - a)); direct light alone is not even."""
    room = pr.Scene([enclosure(0.5)], [pr.PointEmitter([0, 0, 0])], CAMERA)
    image = pr.render(room, n_emitted=100_000)
    direct, indirect = image.layers["direct"], image.layers["indirect"]
    np.testing.assert_allclose(image.layers["radiance"], direct + indirect)
    assert "caustic" not in image.layers
    one = pr.render(room, n_emitted=100_000, components=("indirect",))
    np.testing.assert_array_equal(one.layers["radiance"], indirect)
    assert "direct" not in one.layers
    assert image.metadata["photonrelax.indirect_stored"] == str(
        image.stats["stages"]["trace indirect"]["stored"]
    )


def test_each_component_is_what_it_is_in_the_whole():
    objects = [enclosure(0.5), glass_ball()]
    objects[1] = pr.SceneObject(ball(0.3, [0.3, 0.3, -0.6]), pr.Dielectric(), smooth=True)
    room = pr.Scene(objects, [LAMP], CAMERA)
    whole = pr.render(room, n_emitted=5000).layers
    for component in ("direct", "caustic", "indirect"):
        alone = pr.render(room, n_emitted=5000, components=(component,)).layers
        np.testing.assert_array_equal(alone[component], whole[component])
    without = pr.render(room, n_emitted=5000, n_global=0).layers
    np.testing.assert_array_equal(without["radiance"], whole["direct"] + whole["caustic"])


def test_a_scene_without_any_light_to_model_is_black():
    scene = pr.Scene([pr.SceneObject(sheet(1.0), pr.Diffuse())], [DOWN], CAMERA)
    image = pr.render(scene, components=("caustic", "indirect"))
    assert not image.layers["radiance"].any()
    assert set(image.layers) >= {"radiance", "albedo", "N", "Z"}


def test_nothing_stored_is_no_indirect_light():
    """Between planes whose light never meets both."""
    upper = pr.SceneObject(box([1, 1, 0.1], [0, 0, -1]), pr.Diffuse())
    scene = pr.Scene([floor(0.1), upper], [DOWN], CAMERA)
    image = pr.render(scene, n_global=1)
    assert not image.layers["indirect"].any()
