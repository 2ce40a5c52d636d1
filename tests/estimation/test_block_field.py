"""Gathering from photons in blocks: the irradiance of one piece, whatever the blocks."""

import numpy as np
import pytest
import trimesh

import photonrelax as pr
from photonrelax.estimation.block_field import BlockedField
from photonrelax.rendering.object_map import blocks_of_surface, photons_of_surface
from tests.helpers.executors import shared_pool
from tests.helpers.photon_maps import in_parts, mapped, plane

RADIUS = 0.06


@pytest.fixture(scope="module")
def light(tmp_path_factory):
    """Photons in blocks, relaxed on the unit square, and the same in memory."""
    folder = tmp_path_factory.mktemp("light")
    parts = in_parts(mapped("linear", 4000, "random"), folder / "parts")
    blocked = pr.relax_parts(
        *(parts, folder / "blocks"),
        method="parameterised",
        photons_per_block=700,
        relax=pr.RelaxSettings((1, 1)),
    )
    return blocked, blocked.photon_map()


def irradiance(field, executor=None):
    return pr.irradiance_map(field, (0, 0, 0), (1, 0, 0), (0, 1, 0), (24, 20), executor=executor)


def gather(**settings):
    return pr.GatherSettings(**{"gather_radius": RADIUS, **settings})


def small(blocked, **settings):
    """A field that has few photons in memory at a time."""
    return BlockedField(blocked, gather(**settings), photons_per_block=300)


def assert_same(found, expected):
    assert expected.max() > 0.0
    np.testing.assert_allclose(found, expected, rtol=1e-12, atol=1e-12 * expected.max())


@pytest.mark.parametrize("settings", [{}, {"k": 60, "refinement": "differential-checking"}])
def test_maps_are_those_of_one_piece(light, settings):
    blocked, photons = light
    whole = pr.irradiance_field(photons, method="standard", gather=gather(**settings))
    assert_same(irradiance(small(blocked, **settings)), irradiance(whole))


def test_estimates_at_points_and_of_other_values(light):
    blocked, photons = light
    points, normals = plane(np.random.default_rng(3).uniform(-0.2, 1.2, (200, 2)))
    whole, field = pr.irradiance_field(photons, method="standard", gather=gather()), small(blocked)
    assert_same(field(points, normals), whole(points, normals))
    coords = blocked.columns.read("emitter_coords")
    expected = whole.densities(photons.emitter_coords)(points, normals)
    assert_same(field.densities(coords)(points, normals), expected)


def test_footprints_of_any_sizes(light):
    blocked, photons = light
    points, normals = plane(np.random.default_rng(4).random((60, 2)))
    sides = 10.0 ** np.random.default_rng(5).uniform(-3, 0, 60)
    whole = pr.irradiance_field(photons, method="standard", gather=gather())
    found = small(blocked)(points, normals, footprint=sides)
    assert_same(found, whole(points, normals, footprint=sides))


def test_photons_on_sensors_are_those_of_each_sensor_alone(tmp_path):
    square = trimesh.Trimesh([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], [[0, 1, 2], [0, 2, 3]])
    floor, *sensors = (pr.SceneObject(square, each) for each in (pr.Diffuse(), *2 * [pr.Sensor()]))
    scene = pr.Scene([floor, *sensors], [pr.PointEmitter((0, 0, 9), 1.0)])
    photons = mapped("linear", 3000, "random")
    photons = photons.replace(
        object_id=np.arange(len(photons), dtype=np.int32) % 2, sensor_ids=[1, 2]
    )
    one_step = {"method": "parameterised", "relax": pr.RelaxSettings((1, 1))}
    parts = in_parts(photons, tmp_path / "parts")
    blocked = pr.relax_parts(parts, tmp_path / "blocks", photons_per_block=900, **one_step)
    for i in (0, 1):
        there = photons_of_surface(blocked.photon_map(), scene, i)
        assert len(there) == 1500
        found, expected = (
            pr.irradiance_field(each, method="standard", scene=scene, gather=gather())
            for each in (blocks_of_surface(blocked, scene, i), there)
        )
        assert_same(irradiance(found), irradiance(expected))
    assert len(blocks_of_surface(blocked, scene, 2)) == 0


def test_edges_of_surfaces(light):
    square = trimesh.Trimesh([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], [[0, 1, 2], [0, 2, 3]])
    scene = pr.Scene([pr.SceneObject(square, pr.Diffuse())], [pr.PointEmitter((0, 0, 9), 1.0)])
    given = {"method": "standard", "gather": gather()}
    found, whole = (
        irradiance(pr.irradiance_field(photons, scene=scene, **given)) for photons in light
    )
    assert_same(found, whole)
    endless = irradiance(pr.irradiance_field(light[0], **given))
    assert (whole[0] > 1.05 * endless[0]).any(), "edges count"


def test_only_photons_near_points_are_in_memory(light, monkeypatch):
    blocked, _ = light
    numbers, fill = [], BlockedField._fill_from
    monkeypatch.setattr(
        BlockedField, "_fill_from", lambda *given: numbers.append(len(given[1])) or fill(*given)
    )
    irradiance(small(blocked, gather_radius=0.01))
    assert 0 < max(numbers) < len(blocked) / 3


def test_the_automatic_radius_is_that_of_one_piece_where_all_photons_are_in_its_sample(light):
    blocked, photons = light
    whole = pr.irradiance_field(photons, method="standard").settings.gather_radius
    found = pr.irradiance_field(blocked).settings.gather_radius
    assert found == pytest.approx(whole, rel=1e-12)


def test_workers_gather_the_same_bytes(light):
    field = small(light[0])
    np.testing.assert_array_equal(irradiance(field, shared_pool()), irradiance(field))


def test_what_cannot_be_gathered_by_blocks_is_refused(light, tmp_path):
    with pytest.raises(ValueError, match="gathered as they are, but method is 'diffusion'"):
        pr.irradiance_field(light[0], method="diffusion")
    photons = mapped("linear", 200, "random").replace(wavelength=np.full(200, 500e-9))
    parts = in_parts(photons, tmp_path / "parts")
    blocked = pr.relax_parts(parts, tmp_path / "blocks", method="parameterised")
    with pytest.raises(ValueError, match="light that is not dispersed"):
        pr.irradiance_field(blocked)
