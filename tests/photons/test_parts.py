"""Photon maps in parts: the same photons, runs that go on, damaged folders."""

import filecmp
import json

import numpy as np
import pytest
import trimesh

import photonrelax as pr
from photonrelax.photons.parts import MANIFEST
from photonrelax.transport import parts as tracing

N, CHUNK = 6000, 2500


@pytest.fixture(scope="module")
def scene():
    return pr.gallery.scene("ring", pixels=8)


@pytest.fixture
def folder(scene, tmp_path):
    pr.trace_parts(scene, N, tmp_path / "parts", chunk=CHUNK)
    return tmp_path / "parts"


def same_files(one, other):
    names = sorted(path.relative_to(one) for path in one.rglob("*") if path.is_file())
    assert names == sorted(path.relative_to(other) for path in other.rglob("*") if path.is_file())
    return not filecmp.cmpfiles(one, other, names, shallow=False)[1]


@pytest.mark.parametrize("name", ["ring", "spectrum"])
def test_parts_are_the_map_of_one_piece(name, tmp_path):
    scene = pr.gallery.scene(name)
    parts = pr.trace_parts(scene, N, tmp_path / "parts", chunk=CHUNK)
    joined, whole = parts.photon_map(), pr.trace_photons(scene, N)
    assert parts.is_whole
    assert len(parts) == len(whole)
    for column in ("position", "flux", "emitter_coords", "emitter_density", "path_signature"):
        np.testing.assert_array_equal(getattr(joined, column), getattr(whole, column))
    assert joined.well_spaced == whole.well_spaced
    assert joined.seed == whole.seed
    assert joined.emitted_ranges is None
    np.testing.assert_allclose(joined.ledger.stored, whole.ledger.stored, rtol=1e-12)


def test_an_interrupted_run_goes_on_to_the_same_bytes(scene, folder, tmp_path, monkeypatch):
    trace, calls = tracing.trace_photons, []

    def interrupted(*arguments, **options):
        calls.append(options["photons"])
        if len(calls) == 2:
            raise KeyboardInterrupt
        return trace(*arguments, **options)

    monkeypatch.setattr(tracing, "trace_photons", interrupted)
    with pytest.raises(KeyboardInterrupt):
        pr.trace_parts(scene, N, tmp_path / "other", chunk=CHUNK)
    assert not pr.PhotonParts.open(tmp_path / "other").is_whole
    (tmp_path / "other" / "part-000001").mkdir()
    pr.trace_parts(scene, N, tmp_path / "other", chunk=CHUNK)
    assert calls == [range(2500), range(2500, 5000), range(2500, 5000), range(5000, 6000)]
    assert same_files(folder, tmp_path / "other")


def test_a_folder_of_other_arguments_is_refused(scene, folder):
    with pytest.raises(ValueError, match="same seed, 1, to go on with it, but is of 0"):
        pr.trace_parts(scene, N, folder, chunk=CHUNK, seed=1)
    with pytest.raises(ValueError, match="same chunk"):
        pr.trace_parts(scene, N, folder, chunk=CHUNK + 1)


def test_a_folder_of_other_files_is_refused(scene, tmp_path):
    (tmp_path / "notes.txt").write_text("mine")
    with pytest.raises(FileExistsError, match="has other files"):
        pr.trace_parts(scene, N, tmp_path, chunk=CHUNK)


def edited(folder, change):
    content = json.loads((folder / MANIFEST).read_text())
    change(content)
    (folder / MANIFEST).write_text(json.dumps(content))


@pytest.mark.parametrize(
    ("damage", "message"),
    [
        (lambda f: (f / MANIFEST).unlink(), "has no manifest.json"),
        (lambda f: (f / MANIFEST).write_text("{"), "is damaged"),
        (lambda f: (f / MANIFEST).write_text("[]"), "not one of photons in parts"),
        (
            lambda f: edited(f, lambda c: c.update(photonparts_version=9)),
            "of version 1, but is of 9",
        ),
        (lambda f: edited(f, lambda c: c["parts"].pop(0)), "does not go on"),
        (lambda f: edited(f, lambda c: c["parts"][0].pop("columns")), "missing or of a wrong kind"),
        (lambda f: (f / "part-000001" / "flux.npy").unlink(), "flux.npy should have .* is missing"),
        (lambda f: (f / "part-000000" / "flux.npy").write_bytes(b"x"), "but has 1"),
    ],
)
def test_damage_is_one_clear_error(folder, damage, message):
    damage(folder)
    with pytest.raises((ValueError, FileNotFoundError), match=message):
        pr.PhotonParts.open(folder)


def test_columns_pass_the_checks_of_maps(folder):
    path = folder / "part-000000" / "position.npy"
    position = np.load(path)
    position[3] = np.nan
    np.save(path, position)
    with pytest.raises(ValueError, match="part-000000 is not a part of a photon map: position"):
        pr.PhotonParts.open(folder).photon_map()


def test_fewer_photons_than_asked_are_a_whole_emission_too(tmp_path):
    """Of a ball that another hides but for a sliver, no photon is found."""
    floor = trimesh.creation.box((9, 9, 0.1))
    balls = [
        trimesh.creation.icosphere(subdivisions=2, radius=radius).apply_translation(centre)
        for radius, centre in ((1.0, (0, 0, 2)), (0.3, (0.795, 0, 0.6)))
    ]
    objects = [pr.SceneObject(ball, pr.Dielectric(1.5), smooth=True) for ball in balls]
    scene = pr.Scene(
        [pr.SceneObject(floor, pr.Diffuse(0.5)), *objects], [pr.PointEmitter((0.6, 0, 8), 1.0)]
    )
    whole = pr.trace_photons(scene, 400)
    assert whole.n_emitted < 400
    assert whole.emitted_ranges is None
    for _ in range(2):
        # The second time all parts are there.
        parts = pr.trace_parts(scene, 400, tmp_path / "parts", chunk=300)
        assert parts.is_whole
        np.testing.assert_array_equal(parts.photon_map().position, whole.position)
