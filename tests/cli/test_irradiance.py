"""`photonrelax irradiance`: files, frame and flux within circles."""

import json
from dataclasses import replace

import numpy as np
import pytest
import trimesh

import photonrelax as pr
from photonrelax import cli, gallery
from photonrelax.imaging.image import read_exr
from photonrelax.rendering.object_map import ObjectMap, photons_of_surface

ARGUMENTS = ["irradiance", "ring", "--on", "floor", "--photons", "2e4", "--texels", "24"]


@pytest.fixture(scope="module")
def written(tmp_path_factory):
    folder = tmp_path_factory.mktemp("map")
    plot = ["--plot", str(folder / "plot.png")]
    assert cli.main([*ARGUMENTS, "--quiet", "-o", str(folder / "map.exr"), *plot]) == 0
    return folder


@pytest.fixture(scope="module")
def field():
    scene = gallery.scene("ring")
    return pr.irradiance_field(pr.trace_photons(scene, 20_000), scene=scene)


def test_the_file_is_the_map_of_the_field_in_its_frame(written, field):
    image = read_exr(written / "map.exr")
    frame = json.loads(image.metadata["photonrelax.frame"])
    ny, nx = image.layers["irradiance"].shape[:2]
    expected = pr.irradiance_map(
        field, frame["origin"], frame["u"], frame["v"], (nx, ny), normal=frame["normal"]
    )
    np.testing.assert_allclose(image.layers["irradiance"], expected, rtol=1e-6, atol=1e-12)
    np.testing.assert_allclose(image.layers["radiance"], expected / np.pi, rtol=1e-6, atol=1e-12)


def test_the_map_is_seen_from_the_lit_side_with_row_0_on_top(written):
    """Of the floor: x runs to the right, y up."""
    frame = json.loads(read_exr(written / "map.exr").metadata["photonrelax.frame"])
    np.testing.assert_allclose(frame["normal"], [0, 0, 1])
    assert frame["u"][0] > 0.0
    assert frame["v"][1] < 0.0
    vertices = gallery.scene("ring").objects[0].mesh.vertices
    np.testing.assert_allclose(
        np.add(frame["origin"], np.add(frame["u"], frame["v"]) / 2)[:2],
        (vertices.min(axis=0) + vertices.max(axis=0))[:2] / 2,
        atol=1e-12,
    )


def test_previews_and_plots_are_images(written):
    from PIL import Image

    with Image.open(written / "map.png") as preview:
        assert preview.size[0] == 24
    with Image.open(written / "plot.png") as plot:
        assert min(plot.size) > 300


def test_flux_within_circles_is_that_of_the_photons_there(field, tmp_path, capsys):
    output = ["-o", str(tmp_path / "map.exr")]
    assert cli.main([*ARGUMENTS, *output, "--encircled", "0.3,100"]) == 0
    lines = capsys.readouterr().out.splitlines()
    scene = gallery.scene("ring")
    found = ObjectMap(field, scene, "floor", 24)
    on_floor = field.photons.object_id == 0
    total = field.photons.flux[on_floor].sum(axis=0)
    np.testing.assert_allclose(found.encircled_flux(found.centre, [100.0])[0], total)
    distance = np.linalg.norm(field.photons.position - found.brightest, axis=1)
    near = field.photons.flux[on_floor & (distance <= 0.3)].sum(axis=0)
    np.testing.assert_allclose(found.encircled_flux(found.brightest, [0.3])[0], near)
    assert [line.split()[0] for line in lines] == [
        "within",
        "0.3",
        "100",
        "within",
        "0.3",
        "100",
        "wrote",
    ]
    assert f"{total[0]:.6g}" in lines[2]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (["--on", "wall"], "should have the name or number 'wall', but none has: objects[0]"),
        (["--on", "7"], "number '7'"),
        (["--on", "ring"], "should be flat for an irradiance map"),
        (["--plot", "map.exr"], "should be named *.png"),
        (["--plot", "map.png"], "--plot and the preview"),
    ],
)
def test_errors_say_what_is_wrong(change, message, tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert cli.main([*ARGUMENTS, "--quiet", "-o", "map.exr", *change]) == 1
    assert message in capsys.readouterr().err
    assert not list(tmp_path.iterdir())


def test_a_size_maps_a_square_around_the_middle_of_the_light(field):
    scene = gallery.scene("ring")
    grid = ObjectMap(field, scene, "floor", 16, size=0.5).grid
    on_floor = field.photons.object_id == 0
    flux = field.photons.flux[on_floor].sum(axis=1)
    middle = np.average(field.photons.position[on_floor], axis=0, weights=flux)
    np.testing.assert_allclose(grid.origin + (grid.u + grid.v) / 2, middle, atol=1e-9)
    np.testing.assert_allclose(grid.u, [0.5, 0, 0], atol=1e-12)
    assert grid.shape == (16, 16)


def test_a_square_that_would_leave_the_object_is_moved_or_cut(field):
    scene = gallery.scene("ring")
    corners = scene.objects[0].mesh.vertices[:, :2]
    low, high = corners.min(axis=0), corners.max(axis=0)
    off_centre = field.photons.position[:, 0] > 0.9 * field.photons.position[:, 0].max()
    at_the_edge = field.photons.subset(off_centre)
    for size, side in ((high[0] - 0.1, high[0] - 0.1), (100.0, high[0] - low[0])):
        grid = ObjectMap(field, scene, "floor", 16, size=size, photons=at_the_edge).grid
        np.testing.assert_allclose(grid.u, [side, 0, 0])
        found = np.array([grid.origin + grid.v, grid.origin + grid.u])[:, :2]
        assert (found >= low - 1e-12).all()
        assert (found <= high + 1e-12).all()


def test_texels_off_a_round_object_are_dark():
    """A disc in uniform light, in its square."""
    disc = pr.SceneObject(pr.Disk((0, 0, 0), (0, 0, 1), 1.0).mesh(), pr.Diffuse(0.5), "disc")
    scene = pr.Scene([disc], [pr.CollimatedEmitter((0, 0, -1), 2.0)])
    photons = pr.trace_photons(scene, 20_000, paths="all")
    field = pr.irradiance_field(photons, scene=scene, method="standard")
    found = ObjectMap(field, scene, "disc", 40)
    middle = (np.arange(40) + 0.5) / 20 - 1
    distance = np.hypot(*np.meshgrid(middle, middle))
    assert (found.irradiance[distance > 1.2] == 0.0).all()
    np.testing.assert_allclose(found.irradiance[distance < 0.8].mean(), 2.0, rtol=0.02)
    assert np.isfinite(found.image.layers["radiance"]).all()


def test_objects_go_by_name_or_number(field):
    scene = gallery.scene("ring")
    by_number = ObjectMap(field, scene, "0", 8)
    assert by_number.object_id == ObjectMap(field, scene, "floor", 8).object_id == 0
    floors = pr.Scene([scene.objects[0], scene.objects[0]], scene.emitters)
    with pytest.raises(ValueError, match="but 2 have"):
        ObjectMap(field, floors, "floor", 8)


def test_light_on_sensors_counts_on_each_sensor_alone():
    """Two sensors above a floor that the same light meets, one after the other."""
    scene = gallery.scene("ring")
    low, high = (
        pr.SceneObject(trimesh.creation.box((4, 4, 0)), pr.Sensor(), name)
        for name in ("low", "high")
    )
    scene = replace(scene, objects=[*scene.objects, raised(low, 0.01), raised(high, 0.02)])
    photons = pr.trace_photons(scene, 20_000)
    maps = [
        ObjectMap(
            pr.irradiance_field(photons_of_surface(photons, scene, i), method="standard"),
            *(scene, str(i), 32),
        )
        for i in (0, 2, 3)
    ]
    assert photons.on_sensor.sum() > 1000
    for found in maps:
        total = photons.flux[photons.object_id == found.object_id].sum(axis=0)
        np.testing.assert_allclose(found.encircled_flux(found.centre, [100.0])[0], total)
        nx, ny = found.grid.shape
        area = np.linalg.norm(np.cross(found.grid.u, found.grid.v)) / (nx * ny)
        np.testing.assert_allclose(found.irradiance.sum(axis=(0, 1)) * area, total, rtol=0.05)


def raised(item, height):
    mesh = trimesh.Trimesh(
        np.add(item.mesh.vertices, [0, 0, height]), item.mesh.faces, process=False
    )
    return replace(item, mesh=mesh)
