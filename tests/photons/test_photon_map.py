import os
import zipfile

import numpy as np
import pytest

from photonrelax.photons.energy_ledger import PATH_OUTCOMES, EnergyLedger
from photonrelax.photons.photon_map import PhotonMap


def ledger():
    shares = {name: np.full((2, 3), 1.0 + i) for i, name in enumerate(PATH_OUTCOMES)}
    ends = {name: np.array([i, 2 * i]) for i, name in enumerate(PATH_OUTCOMES)}
    return EnergyLedger(emitted=np.full((2, 3), 15.0), **shares, ends=ends)


def full_map(n=5):
    rng = np.random.default_rng(1)
    return PhotonMap(
        position=rng.random((n, 3)),
        normal=rng.normal(size=(n, 3)),
        flux=rng.random((n, 3)),
        wi=rng.normal(size=(n, 3)),
        emitter_coords=rng.random((n, 2)),
        emitter_density=rng.random(n),
        emitter_id=np.arange(n) % 2,
        path_signature=rng.integers(-(2**62), 2**62, n),
        n_bounces=np.arange(n),
        path_length=rng.random(n),
        object_id=np.arange(n),
        spectrum=np.where(np.arange(n)[:, None] % 2, np.nan, rng.random((n, 3))),
        wavelength=np.linspace(0.0, 700.0, n),
        n_wavelengths=8,
        n_emitted=3 * n,
        well_spaced=True,
        ledger=ledger(),
    )


ARRAYS = [
    "position",
    "normal",
    "flux",
    "wi",
    "emitter_coords",
    "emitter_density",
    "emitter_id",
    "path_signature",
    "n_bounces",
    "path_length",
    "object_id",
    "spectrum",
    "wavelength",
]


def test_only_position_normal_and_flux_are_required():
    photons = PhotonMap([[0, 0, 0]], [[0, 0, 2]], [3])
    assert len(photons) == 1
    np.testing.assert_array_equal(photons.normal, [[0.0, 0.0, 1.0]])
    np.testing.assert_array_equal(photons.flux, [[3.0, 3.0, 3.0]])
    assert photons.wi is None
    assert photons.n_emitted is None
    assert photons.position.dtype == photons.flux.dtype == np.float64


def test_a_map_may_be_empty():
    photons = PhotonMap(np.empty((0, 3)), np.empty((0, 3)), np.empty((0, 3)))
    assert len(photons) == 0
    assert len(photons.subset(slice(None))) == 0


def test_arrays_cannot_be_written_through_the_map_or_from_outside():
    mine = np.zeros((2, 3))
    photons = PhotonMap(mine, np.ones((2, 3)), mine)
    mine[0] = 7.0
    assert not photons.position.any()
    assert not photons.flux.any()
    with pytest.raises(ValueError, match="read-only"):
        photons.position[0] = 1.0
    base = np.zeros((4, 3))
    view = base[:2]
    view.setflags(write=False)
    photons = PhotonMap(view, np.ones((2, 3)), view)
    base[:] = 7.0
    assert not photons.position.any()


def test_maps_share_arrays_they_did_not_change():
    photons = full_map()
    changed = photons.replace(position=photons.position + 1.0)
    assert np.shares_memory(changed.flux, photons.flux)
    np.testing.assert_array_equal(changed.position, photons.position + 1.0)


def test_subset_takes_masks_indices_and_slices():
    photons = full_map()
    mask = np.array([True, False, True, False, False])
    for index in (mask, [0, 2], slice(0, 4, 2)):
        part = photons.subset(index)
        for name in ARRAYS:
            np.testing.assert_array_equal(getattr(part, name), getattr(photons, name)[[0, 2]])
        assert part.n_emitted == photons.n_emitted
    with pytest.raises(ValueError, match="mask of 5"):
        photons.subset(mask[:3])


@pytest.mark.parametrize("name", ["map.npz", "map without suffix"])
def test_a_saved_map_comes_back_bit_for_bit(tmp_path, name):
    photons = full_map()
    photons.save(tmp_path / name)
    assert os.listdir(tmp_path) == [name]
    back = PhotonMap.load(tmp_path / name)
    for field in ARRAYS:
        mine, loaded = getattr(photons, field), getattr(back, field)
        assert mine.dtype == loaded.dtype
        np.testing.assert_array_equal(mine, loaded)
    assert back.n_emitted == photons.n_emitted
    assert back.n_wavelengths == 8
    assert back.well_spaced
    assert back.ledger.to_dict() == photons.ledger.to_dict()


def test_a_minimal_map_comes_back_minimal(tmp_path):
    photons = PhotonMap(np.zeros((2, 3)), np.ones((2, 3)), [1, 2])
    photons.save(tmp_path / "map.npz")
    back = PhotonMap.load(tmp_path / "map.npz")
    assert back.wi is back.ledger is back.n_emitted is None
    assert not back.well_spaced


@pytest.mark.parametrize(("wavelength", "version"), [(None, 1), ([500.0, 0.0], 2)])
def test_files_without_wavelengths_are_of_the_first_version(tmp_path, wavelength, version):
    flux = [[-1.0, 1.0, 1.0], [1.0, 1.0, 1.0]] if wavelength else np.ones(2)
    photons = PhotonMap(np.zeros((2, 3)), np.ones((2, 3)), flux, wavelength=wavelength)
    photons.save(tmp_path / "map.npz")
    with np.load(tmp_path / "map.npz") as arrays:
        assert arrays["photonmap_version"] == version
    np.testing.assert_array_equal(PhotonMap.load(tmp_path / "map.npz").flux, photons.flux)


def test_a_failing_save_leaves_the_old_file_and_no_other(tmp_path, monkeypatch):
    path = tmp_path / "map.npz"
    full_map().save(path)
    before = path.read_bytes()

    def interrupted(*_, **__):
        raise KeyboardInterrupt

    monkeypatch.setattr(np, "savez", interrupted)
    with pytest.raises(KeyboardInterrupt):
        full_map(7).save(path)
    assert path.read_bytes() == before
    assert os.listdir(tmp_path) == ["map.npz"]


def write_text(path):
    path.write_text("not a zip file")


def write_other_npz(path):
    np.savez(path, position=np.zeros((1, 3)))


def write_newer(path):
    np.savez(path, photonmap_version=99)


def write_incomplete(path):
    np.savez(path, photonmap_version=1, position=np.zeros((1, 3)))


@pytest.mark.parametrize(
    ("write", "message"),
    [
        (write_text, "is not a photon map"),
        (write_other_npz, "no photonmap_version"),
        (write_newer, "is of version 99"),
        (write_incomplete, "no normal, flux"),
    ],
)
def test_load_says_what_is_wrong_with_a_file(tmp_path, write, message):
    path = tmp_path / "map.npz"
    write(path)
    with pytest.raises(ValueError, match=message):
        PhotonMap.load(path)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"position": np.full((5, 3), "here")}, "position should be an array of real numbers"),
        ({"position": np.zeros((5, 2))}, "position should have shape"),
        ({"object_id": np.zeros(5)}, "object_id should be an array of integers"),
        ({"photonmap_version": np.ones(2, int)}, "photonmap_version should be one integer"),
        ({"photonmap_version": "one"}, "photonmap_version should be one integer"),
        ({"n_emitted": 2.5}, "n_emitted should be one integer"),
        ({"well_spaced": [True, False]}, "well_spaced should be one truth value"),
        ({"ledger_cut": None}, "it has no ledger_cut"),
        ({"ledger_ends_cut": None}, "it has no ledger_ends_cut"),
        ({"ledger_emitted": 1.0}, r"emitted should have shape \(n, 3\)"),
    ],
)
def test_a_map_with_a_malformed_column_is_no_photon_map(tmp_path, change, message):
    path = tmp_path / "map.npz"
    full_map().save(path)
    with np.load(path) as file:
        arrays = dict(file) | change
    np.savez(path, **{name: array for name, array in arrays.items() if array is not None})
    with pytest.raises(ValueError, match=rf"map\.npz is not a photon map: .*{message}"):
        PhotonMap.load(path)


def test_bytes_in_the_archive_are_no_array(tmp_path):
    path = tmp_path / "map.npz"
    full_map().save(path)
    with zipfile.ZipFile(path) as archive:
        members = {name: archive.read(name) for name in archive.namelist()}
    with zipfile.ZipFile(path, "w") as archive:
        for name, content in members.items():
            archive.writestr(name, b"noise" if name == "flux.npy" else content)
    with pytest.raises(ValueError, match=r"map\.npz is not a photon map"):
        PhotonMap.load(path)


def test_a_truncated_map_is_no_photon_map(tmp_path):
    path = tmp_path / "map.npz"
    full_map().save(path)
    path.write_bytes(path.read_bytes()[:-200])
    with pytest.raises(ValueError, match=r"map\.npz is not a photon map"):
        PhotonMap.load(path)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"position": np.full((5, 3), np.nan)}, "position should be finite"),
        ({"normal": np.zeros((5, 3))}, "vector 0 is zero"),
        ({"normal": np.ones((4, 3))}, r"normal should have shape \(5, 3\)"),
        ({"flux": -np.ones(5)}, "flux should not be negative"),
        ({"flux": -np.ones(5), "wavelength": None}, "flux should not be negative"),
        ({"wavelength": -np.ones(5)}, "wavelength should not be negative"),
        ({"n_wavelengths": 0}, "n_wavelengths should be at least 1"),
        ({"flux": np.ones(4)}, r"flux should have shape \(5, 3\), but has \(4, 3\)"),
        ({"emitter_coords": np.ones((5, 4))}, "2 or 3 columns, but has 4"),
        ({"emitter_density": np.ones((5, 1))}, r"emitter_density should have shape \(5\)"),
        ({"emitter_id": np.ones(4, int)}, "emitter_id should have shape"),
        ({"spectrum": np.ones((5, 2))}, r"spectrum should have shape \(5, 3\)"),
        ({"spectrum": [[1, np.nan, 0]] * 5}, "rows of numbers or of NaN"),
        ({"spectrum": [[-1, 1, 0]] * 5}, "e and b not negative"),
        ({"n_emitted": -1}, "n_emitted should be at least 0"),
    ],
)
def test_errors_name_the_argument(change, message):
    with pytest.raises(ValueError, match=message):
        full_map().replace(**change)


def test_integer_fields_refuse_floats():
    with pytest.raises(TypeError, match="n_bounces should be an array of integers"):
        full_map().replace(n_bounces=np.ones(5))


def test_ledger_balance_is_the_worst_channel():
    balanced = ledger()
    assert balanced.imbalance == 0.0
    lost = balanced.stored - [[0.0, 0.0, 0.0], [0.0, 0.15, 0.0]]
    shares = {name: getattr(balanced, name) for name in PATH_OUTCOMES} | {"stored": lost}
    off = EnergyLedger(emitted=balanced.emitted, **shares, ends=balanced.ends)
    assert off.imbalance == pytest.approx(0.01)


def test_ledger_refuses_unknown_ends():
    shares = {name: np.zeros((1, 3)) for name in PATH_OUTCOMES}
    with pytest.raises(ValueError, match="ends should have the keys"):
        EnergyLedger(emitted=np.zeros((1, 3)), **shares, ends={"lost": [1]})


def test_an_empty_list_chooses_nothing():
    photons = PhotonMap(np.zeros((2, 3)), [[0, 0, 1]] * 2, np.ones(2))
    assert len(photons.subset([])) == 0


def test_how_a_map_was_traced_is_saved_with_it(tmp_path):
    photons = PhotonMap(
        np.zeros((1, 3)), [[0, 0, 1]], np.ones(1), seed=2**64 - 1, sampler="halton", paths="all"
    ).replace(scene_digest="0f")
    photons.save(tmp_path / "map.npz")
    loaded = PhotonMap.load(tmp_path / "map.npz")
    assert (loaded.seed, loaded.sampler, loaded.paths) == (2**64 - 1, "halton", "all")
    assert loaded.scene_digest == "0f"
    PhotonMap(np.zeros((1, 3)), [[0, 0, 1]], np.ones(1)).save(tmp_path / "older.npz")
    assert PhotonMap.load(tmp_path / "older.npz").scene_digest is None
