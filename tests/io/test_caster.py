"""A mesh alone: the light behind it, its units and its place."""

from pathlib import Path

import numpy as np
import pytest
import trimesh

import photonrelax as pr
from photonrelax import cli
from tests.analytic.lens import PlanoConvex
from tests.helpers.stl import stl_bytes

LENS = Path(__file__).parents[1] / "data" / "plano_convex_f200mm.stl"
# W/mm² of the light.
IRRADIANCE = 1e-6


def encircled(output):
    """Flux by radius about the axis, from what the command prints."""
    lines = output.splitlines()
    first = next(i for i, line in enumerate(lines) if "of the axis" in line)
    found = {}
    for line in lines[first + 1 :]:
        if not line.startswith("  "):
            break
        radius, _, flux, *_ = line.split()
        found[float(radius)] = float(flux.strip("(,"))
    return found


def lens_flux(capsys, tmp_path, direction, distance, radii):
    command = ["irradiance", str(LENS), "--material", "glass", "--ior", "1.5", "--units", "mm"]
    light = ["--direction", direction, "--distance", str(distance)]
    quick = ["--method", "standard", "--texels", "64", "--photons", "4e5"]
    output = ["-o", str(tmp_path / "spot.exr"), "--encircled", radii]
    assert cli.main([*command, *light, *quick, *output]) == 0
    return encircled(capsys.readouterr().out)


@pytest.mark.parametrize("distance", [150.0, 180.0, 196.5])
def test_a_lens_has_the_encircled_flux_of_exact_rays(capsys, tmp_path, distance):
    found = lens_flux(capsys, tmp_path, "0,0,-1", distance, "1")
    assert found[1.0] == pytest.approx(
        IRRADIANCE * PlanoConvex().flux_within(1.0, distance), rel=0.02
    )


def test_its_focus_is_as_small_as_that_of_exact_rays(capsys, tmp_path):
    found = lens_flux(capsys, tmp_path, "0,0,-1", 195.0, "0.05,1")
    for radius, flux in found.items():
        expected = IRRADIANCE * PlanoConvex().flux_within(radius, 195.0)
        assert flux == pytest.approx(expected, rel=0.02)


@pytest.mark.parametrize("distance", [150.0, 196.5])
def test_light_on_its_flat_side_lands_as_exact_rays_do(capsys, tmp_path, distance):
    found = lens_flux(capsys, tmp_path, "0,0,1", distance, "1")
    expected = IRRADIANCE * PlanoConvex().flux_within_from_below(1.0, distance)
    assert found[1.0] == pytest.approx(expected, rel=0.02)


@pytest.fixture
def cone(tmp_path):
    """A cone of height 2 on z = 0, its tip up."""
    path = tmp_path / "cone.stl"
    path.write_bytes(stl_bytes(trimesh.creation.cone(1.0, 2.0)))
    return path


def placed(path, **arguments):
    return pr.load_scene(path, arguments=arguments)


def test_the_screen_is_behind_the_last_point_along_the_light(cone):
    for direction in ((0, 0, -1), (0, 0, 2), (1, 2, -2)):
        scene = placed(cone, direction=direction, distance=3.0)
        along = np.array(direction) / np.linalg.norm(direction)
        depth = scene.objects[1].mesh.vertices @ along
        np.testing.assert_allclose(depth, (scene.objects[0].mesh.vertices @ along).max() + 3.0)
        np.testing.assert_allclose(scene.objects[1].mesh.face_normals @ along, -1.0)


def test_units_scale_the_mesh_and_the_distance(cone):
    metres = placed(cone, distance=3.0)
    inches = placed(cone, distance=3.0, units="in")
    for one, other in zip(metres.objects, inches.objects, strict=True):
        np.testing.assert_allclose(other.mesh.vertices, 0.0254 * one.mesh.vertices, atol=1e-12)


@pytest.mark.parametrize(
    ("rotate", "tip"),
    [
        ((90, 0, 0), [0, -2, 0]),
        ((0, 90, 0), [2, 0, 0]),
        ((90, 0, 90), [2, 0, 0]),
        ((0, 0, 90), [0, 0, 2]),
    ],
)
def test_the_mesh_turns_about_x_then_y_then_z(cone, rotate, tip):
    vertices = placed(cone, rotate=rotate).objects[0].mesh.vertices
    assert np.abs(vertices - tip).sum(axis=1).min() == pytest.approx(0.0, abs=1e-12)


def test_materials_and_the_sun(cone):
    assert placed(cone, ior=1.7).objects[0].material.ior == 1.7
    assert isinstance(placed(cone, material="mirror").objects[0].material, pr.Mirror)
    assert isinstance(placed(cone, screen="sensor").objects[1].material, pr.Sensor)
    (light,) = placed(cone, sun_angular_radius=0.25, irradiance=2.0).emitters
    assert light.angular_radius == 0.25
    np.testing.assert_array_equal(light.irradiance, 2.0)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"colour": 3}, "argument of .* should be one of material, ior"),
        ({"units": "furlong"}, "units should be one of m, cm"),
        ({"material": "velvet"}, "material should be one of glass"),
        ({"distance": -1.0}, "distance should be a positive number"),
        ({"direction": (0, 0, 0)}, "direction should hold directions"),
    ],
)
def test_what_has_no_meaning_is_refused(cone, arguments, message):
    with pytest.raises(ValueError, match=message):
        placed(cone, **arguments)
    with pytest.raises(ValueError, match="has no camera"):
        pr.load_scene(cone, camera="Front")


def test_a_mesh_can_be_rendered(cone, tmp_path):
    output = ["-o", str(tmp_path / "cone.exr"), "--width", "24", "--photons", "2000"]
    assert cli.main(["render", str(cone), "--arg", "distance=1.5", *output]) == 0


def test_options_of_meshes_are_of_no_other_scene(capsys):
    with pytest.raises(SystemExit):
        cli.main(["irradiance", "ring", "--on", "floor", "--ior", "1.4", "-o", "map.exr"])
    assert "--ior is of a file of a mesh alone" in capsys.readouterr().err
    with pytest.raises(SystemExit):
        cli.main(["irradiance", "ring", "-o", "map.exr"])
    assert "required: --on" in capsys.readouterr().err
