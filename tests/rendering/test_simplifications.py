"""A render leaves out, as its plan says, all that the scene does not require."""

import numpy as np

import photonrelax as pr
from photonrelax.cli import commands
from photonrelax.photons.neighbourhoods import neighbour_groups
from photonrelax.rendering.simplifications import simplifications
from tests.helpers.tracing_scenes import DOWN, ball, box, floor, glass_ball


def left_out(*objects, emitters=(DOWN,)):
    scene = pr.Scene(objects, emitters)
    return {what: is_made for what, is_made, _ in simplifications(scene)}


def test_a_floor_a_clear_ball_and_a_beam_are_the_simplest_scene():
    assert all(left_out(floor(), glass_ball()).values())


def test_each_is_done_where_the_scene_requires_it():
    lamp = pr.AreaEmitter(pr.Sphere((0, 0, 5), 0.1), power=1.0)
    hollow = pr.SceneObject(box([0.5] * 3, [0, 0, 1]), pr.Dielectric(1.33, priority=-1))
    cases = {
        "groups by emitter": ((floor(), glass_ball()), (DOWN, pr.PointEmitter((0, 0, 3)))),
        "projection of moved photons by rays": (
            (floor(), pr.SceneObject(ball(1.0, (0, 0, 3)), pr.Diffuse())),
            (DOWN,),
        ),
        "absorption along rays": ((floor(), glass_ball(absorption=1.0)), (DOWN,)),
        "search for hidden surfaces": ((floor(), glass_ball(), hollow), (DOWN,)),
        "samples of lights": ((floor(), glass_ball()), (lamp,)),
    }
    for what, (objects, emitters) in cases.items():
        found = left_out(*objects, emitters=emitters)
        assert [name for name, is_made in found.items() if not is_made] == [what]


def test_photons_of_one_emitter_are_one_group_and_those_of_two_are_not():
    """On one plane, so that normals do not tell them apart."""
    groups = {}
    for emitters in ([DOWN], [DOWN, pr.PointEmitter((0, 0, 3), 5.0)]):
        photons = pr.trace_photons(pr.Scene([floor(), glass_ball()], emitters), 20_000)
        groups[len(emitters)] = neighbour_groups(photons, 1)
    assert len(groups[1]) == 1
    assert groups[1][0].rows == slice(None)
    assert len(groups[2]) == 2


def test_the_command_line_prints_them(capsys):
    assert commands.main(["plan", "ring", "--photons", "2000"]) == 0
    lines = capsys.readouterr().out.splitlines()
    (line,) = (line for line in lines if line.startswith("absorption along rays"))
    assert "left out  no medium absorbs" in line


def test_grey_light_is_the_same_in_all_channels():
    """Kernels carry three: of grey light, three times the same."""
    photons = pr.trace_photons(pr.Scene([floor(), glass_ball()], [DOWN]), 5000)
    points = photons.position[::50]
    found = pr.irradiance_field(photons)(points, np.tile([0.0, 0, 1], (len(points), 1)))
    np.testing.assert_array_equal(found, found[:, :1].repeat(3, axis=1))
