"""Animations: photons leave alike in all frames, and what does not move does not change."""

from dataclasses import replace

import numpy as np
import pytest
import trimesh

import photonrelax as pr
from photonrelax.imaging.metrics import flip_map
from photonrelax.rendering.animation import Animation
from photonrelax.scene.casters import common_targets
from photonrelax.scene.digest import scene_digest
from photonrelax.transport.emission import emit, plan_emission


def sheet(corner, first, second):
    corners = np.array(corner) + np.array([np.zeros(3), first, np.add(first, second), second])
    return trimesh.Trimesh(corners, [[0, 1, 2], [0, 2, 3]])


def ball():
    mesh = trimesh.creation.icosphere(subdivisions=3, radius=0.5)
    mesh.apply_translation((-1.5, 0.0, 0.51))
    return mesh


def moving(time):
    """A glass ball that stays, and far from it a plate that moves and reflects light to a wall."""
    return pr.Scene(
        [
            pr.SceneObject(sheet((-4, -4, 0), (8, 0, 0), (0, 8, 0)), pr.Diffuse(0.8)),
            pr.SceneObject(sheet((4, -4, 0), (0, 8, 0), (0, 0, 4)), pr.Diffuse(0.8)),
            pr.SceneObject(ball(), pr.Dielectric(1.5), smooth=True),
            pr.SceneObject(
                sheet((2.5 + 0.2 * time, -0.3, 0.4), (0.3, 0, -0.3), (0, 0.6, 0)), pr.Mirror(0.9)
            ),
        ],
        [pr.PointEmitter((0.0, 1.0, 4.0), 60.0), pr.CollimatedEmitter((0.1, 0.0, -1.0))],
        pr.Camera((0, -1, 7), (0, 0, 0), vertical_fov=60.0, width=64, height=32),
    )


# Otherwise it is that of the photons of each frame.
RADIUS = pr.GatherSettings(gather_radius=0.3)


@pytest.fixture(scope="module")
def animation():
    sizes = {"n_emitted": 8000, "n_global": 0, "supersampling": 1}
    return Animation(moving, [0.0, 0.5, 1.0], **sizes, gather=RADIUS)


def test_photons_have_the_same_emitter_coordinates_in_all_frames(animation):
    plans = [plan_emission(animation.scene(number), 4000) for number in range(3)]
    assert all((plan.counts == plans[0].counts).all() for plan in plans)
    for region, n in enumerate(plans[0].counts):
        first, *others = [emit(plan, region, range(n)) for plan in plans]
        for rays in others:
            np.testing.assert_array_equal(rays.emitter_coords, first.emitter_coords)
            np.testing.assert_array_equal(rays.direction, first.direction)


def test_the_digest_of_a_scene_knows_what_is_aimed_at(animation):
    assert scene_digest(animation.scene(0)) != scene_digest(moving(0.0))
    assert scene_digest(replace(animation.scene(0), aim=None)) == scene_digest(moving(0.0))


def test_all_frames_have_their_flux(animation):
    """Though emitters aim at more than one frame needs."""
    photons = pr.trace_photons(animation.scene(1), 40_000)
    alone = pr.trace_photons(moving(0.5), 40_000)
    assert photons.flux.sum() == pytest.approx(alone.flux.sum(), rel=0.02)


def test_what_does_not_move_does_not_change(animation):
    first, last = (animation.frame(number).layers["radiance"] for number in (0, 2))
    flip = flip_map(np.clip(last, 0, 1), np.clip(first, 0, 1))
    np.testing.assert_allclose(last[:, :20], first[:, :20], atol=1e-9)
    # FLIP looks a few pixels around.
    assert flip[:, :12].max() == 0.0
    assert flip[:, 40:].max() > 0.02


def test_common_targets_hold_those_of_all_scenes():
    every = [moving(time).targets for time in (0.0, 1.0)]
    common = common_targets(every)
    for targets in every:
        for sphere in (*targets.casters, targets.around_casters, targets.around):
            held = [
                np.linalg.norm(sphere.centre - each.centre) + sphere.radius <= each.radius + 1e-12
                for each in (*common.casters, common.around)
            ]
            assert any(held)


def test_scenes_with_and_without_casters_have_no_common_targets():
    dark = pr.Scene(moving(0.0).objects[:1], moving(0.0).emitters)
    with pytest.raises(ValueError, match="specular objects, or none, but of 2 scenes 1 have some"):
        common_targets([moving(0.0).targets, dark.targets])


SMALL = {"components": ["direct", "caustic"], "method": "standard", "supersampling": 1}


@pytest.fixture(scope="module")
def to_an_error():
    return Animation(moving, [0.0, 0.5], error=0.2, n_emitted=4000, gather=RADIUS, **SMALL)


def test_a_goal_of_the_first_frame_fixes_the_photons_of_all(to_an_error):
    emitted = {
        image.metadata["photonrelax.photons_emitted"] for image in to_an_error.frames([1, 0])
    }
    assert to_an_error.reached["is_met"]
    assert emitted == {str(to_an_error.reached["photons_of_image"])}


def test_what_does_not_move_does_not_change_with_a_goal(to_an_error):
    first, last = (image.layers["radiance"] for image in to_an_error.frames([0, 1]))
    np.testing.assert_allclose(last[:, :20], first[:, :20], atol=1e-9)


def test_frames_are_as_exact_as_the_first_is_estimated_to_be(to_an_error):
    truth = Animation(moving, [0.0, 0.5], n_emitted=200_000, **SMALL).frame(0).layers["radiance"]
    error = np.abs(to_an_error.frame(0).layers["radiance"] - truth).sum() / truth.sum()
    assert error <= 1.25 * to_an_error.reached["estimate"]


def test_frames_of_a_preset_are_renders_of_it():
    chosen = {"preset": "draft", "method": "mapped", "n_global": 0, "n_emitted": 2000}
    animation = Animation(moving, [0.0], **chosen)
    expected = pr.render(animation.scene(0), **chosen).layers["radiance"]
    np.testing.assert_array_equal(animation.frame(0).layers["radiance"], expected)


def test_a_goal_needs_photons():
    with pytest.raises(ValueError, match="envelope has none: take another method"):
        Animation(moving, [0.0], error=0.1, method="envelope")
