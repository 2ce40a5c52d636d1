"""Relaxation by blocks of space: the photons of one piece, whatever the blocks."""

import json

import numpy as np
import pytest

import photonrelax as pr
from photonrelax._util.parallel import thread_count
from photonrelax.estimation.methods import MethodInput, Settings, relaxed_photons
from photonrelax.photons import block_search
from photonrelax.photons.neighbourhoods import neighbour_groups
from photonrelax.photons.parts import PhotonParts
from photonrelax.photons.streamed_groups import StreamedGroups
from photonrelax.relaxation import blocks
from photonrelax.relaxation.relax import Relaxation
from tests.helpers.executors import shared_pool
from tests.helpers.photon_maps import in_parts

CLOSE = 1e-12


def difference(photons, folder, *, method="mapped", scene=None, block=700, **options):
    """Largest difference of positions from those of one piece, over the extent of the map."""
    parts = in_parts(photons, folder / "parts")
    blocked = pr.relax_parts(
        parts, folder / "blocks", method=method, scene=scene, photons_per_block=block, **options
    )
    assert len(set(blocked.segments.block.tolist())) > 1
    one = relaxed_photons(method, MethodInput(photons, Settings(), scene, None, None)).photons
    found = blocked.photon_map()
    np.testing.assert_array_equal(found.flux, photons.flux)
    np.testing.assert_array_equal(found.path_signature, photons.path_signature)
    np.testing.assert_allclose(found.normal, one.normal, atol=CLOSE)
    assert np.abs(one.position - photons.position).max() > 1e-3, "photons move"
    extent = np.ptp(photons.position, axis=0).max()
    return np.abs(found.position - one.position).max() / extent


@pytest.mark.parametrize("method", ["parameterised", "mapped"])
@pytest.mark.parametrize("name", ["ring"])
def test_blocks_relax_as_one_piece(name, method, tmp_path):
    scene = pr.gallery.scene(name)
    photons = pr.trace_photons(scene, 6000)
    block = len(photons) // 3
    assert difference(photons, tmp_path, method=method, scene=scene, block=block) < CLOSE


def sheets_that_meet(n=3000, n_emitters=1):
    """Two sheets of light over the same square, whose photons left the emitter far apart.

    The second is turned by a right angle and brighter on one side; isolated photons lie far off.
    """
    rng = np.random.default_rng(4)
    u = rng.random((n, 2))
    first, second = u[: n // 2].copy(), u[n // 2 :].copy()
    second[:, 0] = second[:, 0] ** 2
    position = np.zeros((n, 3))
    position[: n // 2, :2], position[n // 2 :, :2] = first, second[:, ::-1]
    position[::500, :2] += 40.0
    coords = u.copy()
    coords[n // 2 :, 0] += 1000.0
    return pr.PhotonMap(
        position,
        np.broadcast_to([0.0, 0.0, 1.0], (n, 3)),
        np.ones(n),
        emitter_coords=coords,
        emitter_density=np.full(n, n / 2),
        emitter_id=rng.integers(0, n_emitters, n),
        path_signature=np.zeros(n, dtype=np.int64),
        n_emitted=n,
    )


@pytest.mark.parametrize("method", ["parameterised", "mapped"])
def test_sheets_that_meet_in_space_but_not_on_the_emitter(method, tmp_path):
    assert difference(sheets_that_meet(), tmp_path, method=method) < CLOSE


@pytest.mark.parametrize(("factor", "value"), [("_GROWTH", 0.4), ("_FLAT", 0.3)])
def test_photons_that_search_or_go_farther_than_is_expected(factor, value, tmp_path, monkeypatch):
    monkeypatch.setattr(blocks, factor, value)
    calls = []
    stage = Relaxation.staged
    monkeypatch.setattr(
        Relaxation, "staged", lambda *given, **named: calls.append(1) or stage(*given, **named)
    )
    assert difference(sheets_that_meet(1200), tmp_path, block=600) < CLOSE
    n_blocks, n_stages = 2, 2
    assert len(calls) > n_blocks * n_stages, "stages are done again"


@pytest.mark.parametrize("of_typical", [1.2, 0.0])
def test_isolated_photons_that_go_where_they_were_not_expected_to(
    of_typical, tmp_path, monkeypatch
):
    """Of which there are more where those that search a little farther are isolated, or all."""
    monkeypatch.setattr(block_search, "ISOLATED", of_typical)
    monkeypatch.setattr(block_search, "_SPARE", -0.3)
    monkeypatch.setattr(block_search, "_MORE_SPARE", 0.0)
    added = []
    add = block_search._Wider.add
    monkeypatch.setattr(block_search._Wider, "add", lambda *given: added.append(1) or add(*given))
    assert difference(sheets_that_meet(1200), tmp_path, block=600) < CLOSE
    assert added, "layers have more photons than was expected"


def test_many_emitters_that_share_trees_and_pools(tmp_path):
    assert difference(sheets_that_meet(4000, n_emitters=23), tmp_path) < CLOSE


def test_photons_without_emitter_coordinates(tmp_path):
    photons = sheets_that_meet().replace(emitter_coords=None, emitter_density=None)
    assert difference(photons, tmp_path, method="parameterised") < CLOSE


@pytest.mark.parametrize("apart", [0.0, 0.02])
def test_photons_at_the_same_point_stay_together(apart, tmp_path):
    """Even where they left the emitter at some distance from one another."""
    photons = sheets_that_meet()
    rows = np.concatenate([np.arange(len(photons)), np.arange(0, len(photons), 7)])
    photons = photons.subset(np.random.default_rng(1).permutation(rows))
    shift = apart * np.random.default_rng(2).random((len(photons), 2))
    photons = photons.replace(emitter_coords=photons.emitter_coords + shift)
    assert difference(photons, tmp_path, method="parameterised") < CLOSE


@pytest.mark.parametrize("name", ["ring", "spectrum", "pool"])
def test_groups_of_parts_are_those_of_the_map(name):
    photons = pr.trace_photons(pr.gallery.scene(name), 8000)
    some = [photons.subset(slice(a, a + 700)) for a in range(0, len(photons), 700)]
    streamed = StreamedGroups(lambda: some, thread_count(None))
    number = np.concatenate([streamed.assign(each)[0] for each in some])
    groups = neighbour_groups(photons, 1)
    assert len(groups) == len(streamed.groups)
    for place, group in enumerate(groups):
        rows = np.arange(len(photons))[group.rows]
        np.testing.assert_array_equal(np.flatnonzero(number == place), rows)
        assert (group.mixed, group.at_rest) == streamed.groups[place][:2]


def test_workers_relax_to_the_same_bytes(tmp_path):
    parts = in_parts(sheets_that_meet(), tmp_path / "parts")
    options = {"photons_per_block": 900, "n_threads": 1}
    alone = pr.relax_parts(parts, tmp_path / "alone", **options)
    shared = pr.relax_parts(parts, tmp_path / "shared", executor=shared_pool(), **options)
    for name in alone.names():
        np.testing.assert_array_equal(alone.columns.read(name), shared.columns.read(name))


def test_what_cannot_be_relaxed_is_refused(tmp_path):
    photons = sheets_that_meet(600)
    parts = in_parts(photons, tmp_path / "parts")
    with pytest.raises(ValueError, match="but is 'relaxation'"):
        pr.relax_parts(parts, tmp_path / "blocks", method="relaxation")
    with pytest.raises(FileExistsError, match="should be a new folder"):
        pr.relax_parts(parts, tmp_path)
    begun = PhotonParts.create(tmp_path / "begun", {})
    begun = begun.append(
        photons.replace(n_emitted=2 * len(photons), emitted_ranges=[(0, len(photons))])
    )
    with pytest.raises(ValueError, match="go on tracing"):
        pr.relax_parts(begun, tmp_path / "blocks")
    assert not list(tmp_path.glob(".*.part"))


def test_damaged_blocks_are_one_clear_error(tmp_path):
    parts = in_parts(sheets_that_meet(600), tmp_path / "parts")
    blocked = pr.relax_parts(parts, tmp_path / "blocks", method="parameterised")
    assert pr.BlockedPhotons.open(tmp_path / "blocks").photon_map().well_spaced
    path = blocked.columns.folder / "blocks.json"
    content = json.loads(path.read_text())
    content["segments"] = content["segments"][:0]
    path.write_text(json.dumps(content))
    with pytest.raises(ValueError, match=r"blocks.json is damaged: its segments"):
        pr.BlockedPhotons.open(tmp_path / "blocks")
