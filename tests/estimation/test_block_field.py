"""Gathering from photons in blocks: the irradiance of one piece, whatever the blocks."""

import numpy as np
import pytest

import photonrelax as pr
from photonrelax.estimation.block_field import BlockedField
from tests.helpers.executors import shared_pool

RADIUS = 0.05


@pytest.fixture(scope="module")
def ring(tmp_path_factory):
    """A scene, its relaxed photons in blocks, and the same in memory."""
    folder, scene = tmp_path_factory.mktemp("ring"), pr.gallery.scene("ring")
    parts = pr.trace_parts(scene, 9000, folder / "parts", chunk=9000)
    blocked = pr.relax_parts(parts, folder / "blocks", scene=scene, photons_per_block=1000)
    return scene, blocked, blocked.photon_map()


def irradiance(field, executor=None):
    return pr.irradiance_map(field, (-1, -1, 0), (2, 0, 0), (0, 2, 0), (40, 30), executor=executor)


def small(blocked, **settings):
    """A field that has few photons in memory at a time."""
    gather = pr.GatherSettings(**{"gather_radius": RADIUS, **settings})
    return BlockedField(blocked, gather, photons_per_block=300)


@pytest.mark.parametrize("settings", [{}, {"k": 60, "refinement": "differential-checking"}])
def test_maps_are_those_of_one_piece(ring, settings):
    _, blocked, photons = ring
    gather = pr.GatherSettings(**{"gather_radius": RADIUS, **settings})
    whole = irradiance(pr.irradiance_field(photons, method="standard", gather=gather))
    assert whole.max() > 0.0
    found = irradiance(small(blocked, **settings))
    np.testing.assert_allclose(found, whole, rtol=1e-12, atol=1e-12 * whole.max())


def test_estimates_at_points_and_of_other_values(ring):
    _, blocked, photons = ring
    gather = pr.GatherSettings(gather_radius=RADIUS)
    rng = np.random.default_rng(3)
    points = np.column_stack([rng.uniform(-1, 1, (200, 2)), np.zeros(200)])
    normals = np.broadcast_to([0.0, 0.0, 1.0], points.shape)
    one = pr.irradiance_field(photons, method="standard", gather=gather)
    np.testing.assert_allclose(small(blocked)(points, normals), one(points, normals), rtol=1e-12)
    lengths = small(blocked).densities(blocked.columns.read("path_length")[:, np.newaxis])
    expected = one.densities(photons.path_length[:, np.newaxis])(points, normals)
    np.testing.assert_allclose(lengths(points, normals), expected, rtol=1e-12)


def test_edges_of_surfaces(ring):
    scene, blocked, photons = ring
    gather = pr.GatherSettings(gather_radius=RADIUS)
    given = {"scene": scene, "method": "standard", "gather": gather}
    fields = [pr.irradiance_field(some, **given) for some in (blocked, photons)]
    low = scene.objects[0].mesh.bounds[0]
    corner, side = [
        pr.irradiance_map(field, low, (0.3, 0, 0), (0, 0.3, 0), (6, 6)) for field in fields
    ]
    np.testing.assert_allclose(corner, side, rtol=1e-12, atol=1e-12)


def test_only_photons_near_points_are_in_memory(ring, monkeypatch):
    _, blocked, _ = ring
    numbers = []
    fill = BlockedField._fill_from
    monkeypatch.setattr(
        BlockedField, "_fill_from", lambda *given: numbers.append(len(given[1])) or fill(*given)
    )
    irradiance(small(blocked))
    assert len(numbers) > 4
    assert max(numbers) < len(blocked) / 3


def test_the_automatic_radius_is_that_of_a_sample(ring):
    _, blocked, photons = ring
    whole = pr.irradiance_field(photons, method="standard").settings.gather_radius
    assert BlockedField(blocked).settings.gather_radius == pytest.approx(whole, rel=1e-12)


def test_workers_gather_the_same_bytes(ring):
    _, blocked, _ = ring
    field = small(blocked)
    np.testing.assert_array_equal(irradiance(field, shared_pool()), irradiance(field))


def test_methods_that_estimate_in_another_way_are_refused(ring):
    _, blocked, _ = ring
    with pytest.raises(ValueError, match="gathered as they are, but method is 'diffusion'"):
        pr.irradiance_field(blocked, method="diffusion")
