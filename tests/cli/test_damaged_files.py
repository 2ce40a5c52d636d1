"""Files that are damaged, or that are others: one line that names them, and nothing replaced."""

import json

import numpy as np
import pytest

import photonrelax as pr
from photonrelax.cli import commands
from photonrelax.imaging.image import read_exr
from photonrelax.rendering import progressive_render
from tests.helpers.damage import Unpickled, arrays_of, cut_off, flipped, save

SIZE = ("--width", 12, "--height", 12, "--supersampling", 1, "--quiet")
PASSES = ("render", "ring", "--method", "progressive", "--photons", 2000, *SIZE, "--passes")
WRONG_COLUMNS = {
    "missing": lambda a: None,
    "half": lambda a: a[: len(a) // 2],
    "one": lambda a: a[:1],
    "one more": lambda a: np.concatenate([a, a[:1]]),
    "empty": lambda a: a[:0],
    "one axis more": lambda a: a[..., np.newaxis],
    "scalar": lambda a: np.float64(3.0),
    "NaN": lambda a: np.where(np.arange(a.size).reshape(a.shape) == 0, np.nan, a),
    "infinite": lambda a: np.full(a.shape, -np.inf),
    "complex": lambda a: a.astype(complex),
    "text": lambda a: a.astype(str),
    "bytes": lambda a: a.astype(bytes),
    "records": lambda a: np.zeros(a.shape, [("a", "f8"), ("b", "i4")]),
    "objects": lambda a: np.full(a.shape, Unpickled(), dtype=object),
}


def run(*arguments):
    return commands.main([str(argument) for argument in arguments])


@pytest.fixture
def refused(capfd):
    """One line that names a file, on standard error alone, and exit code 1."""

    def refused(path, *arguments):
        assert run(*arguments) == 1
        out, err = capfd.readouterr()
        assert out == ""
        assert err.startswith("photonrelax: error: ")
        assert err.count("\n") == 1
        assert str(path) in err
        return err

    return refused


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """A photon map, an image, and the states of runs, as bytes by their names."""
    folder = tmp_path_factory.mktemp("made")
    emission = ("--photons", 2000, "--quiet")
    assert run("trace", "ring", "-o", folder / "map.npz", *emission) == 0
    output = ("-o", folder / "image.exr")
    for name, options in (("fixed.npz", ()), ("jittered.npz", ("--stochastic",))):
        assert run(*PASSES, 1, *output, "--state", folder / name, *options) == 0
    return {path.name: path.read_bytes() for path in folder.iterdir()}


@pytest.fixture
def photon_map(made, tmp_path):
    path = tmp_path / "map.npz"
    path.write_bytes(made["map.npz"])
    return path


# --- photon maps ----------------------------------------------------------------------------------


def test_photon_maps_cut_off_anywhere_are_refused(photon_map, refused):
    for content in cut_off(photon_map.read_bytes(), 20):
        photon_map.write_bytes(content)
        refused(photon_map, "relax", photon_map, "-o", photon_map.with_name("r.npz"))


def test_photon_maps_with_flipped_bytes_are_refused_or_the_same(photon_map):
    whole, messages = pr.PhotonMap.load(photon_map), []
    for content in flipped(photon_map.read_bytes(), 200):
        photon_map.write_bytes(content)
        try:
            loaded = pr.PhotonMap.load(photon_map)
        except ValueError as error:
            messages.append(str(error))
            continue
        np.testing.assert_array_equal(loaded.position, whole.position)
        np.testing.assert_array_equal(loaded.flux, whole.flux)
    assert all(str(photon_map) in message for message in messages)


@pytest.mark.parametrize("wrong", WRONG_COLUMNS)
@pytest.mark.parametrize("name", ["position", "normal", "flux"])
def test_columns_of_photon_maps_are_checked(name, wrong, photon_map, refused):
    arrays = arrays_of(photon_map)
    save(photon_map, arrays | {name: WRONG_COLUMNS[wrong](arrays[name])})
    refused(photon_map, "info", photon_map)


@pytest.mark.parametrize(
    "change",
    [
        {"emitter_coords": np.zeros((3, 2))},
        {"emitter_density": np.float16(-1.0)},
        {"emitter_id": np.zeros(3, np.int32)},
        {"n_bounces": -1},
        {"object_id": 2**40},
        {"path_length": -1.0},
        {"n_emitted": np.int64(-5)},
        {"n_emitted": np.uint64(2**64 - 1)},
        {"n_emitted": np.float64(np.inf)},
        {"seed": "0"},
        {"sampler": 3},
        {"paths": np.array(["caustic", "all"])},
        {"well_spaced": 1.0},
        {"photonmap_version": 3},
        {"photonmap_version": np.float64(1.0)},
        {"photonmap_version": None},
        {"ledger_emitted": None},
        {"ledger_stored": np.zeros((7, 3))},
        {"ledger_ends_cut": np.array([-1])},
        {"flux": np.float64(1e200)},
    ],
    ids=str,
)
def test_numbers_of_photon_maps_are_checked(change, photon_map, refused):
    arrays = arrays_of(photon_map)
    columns = {
        name: np.full(arrays[name].shape, value)
        if name in arrays and np.ndim(value) == 0 and value is not None and arrays[name].ndim
        else value
        for name, value in change.items()
    }
    save(photon_map, arrays | columns)
    refused(photon_map, "info", photon_map)


@pytest.mark.parametrize("dtype", [">f8", np.float16, np.float32])
def test_numbers_of_other_sizes_and_orders_are_read(dtype, photon_map):
    arrays = arrays_of(photon_map)
    save(photon_map, arrays | {"position": arrays["position"].astype(dtype)})
    expected = arrays["position"].astype(dtype).astype(np.float64)
    np.testing.assert_array_equal(pr.PhotonMap.load(photon_map).position, expected)


@pytest.mark.parametrize("name", ["fixed.npz", "image.exr", "image.png"])
def test_other_files_are_no_photon_maps(name, made, tmp_path, refused):
    path = tmp_path / name
    path.write_bytes(made[name])
    refused(path, "relax", path, "-o", tmp_path / "r.npz")
    refused(path, "render", "ring", "-o", tmp_path / "r.exr", "--photon-map", path)
    assert [each.name for each in tmp_path.iterdir()] == [name]


# --- states of progressive renders ----------------------------------------------------------------


@pytest.fixture
def refused_state(tmp_path, refused, monkeypatch):
    """A state that is refused before a pass, and left as it is."""
    path = tmp_path / "state.npz"
    monkeypatch.setattr(progressive_render._Run, "advance", lambda _: pytest.fail("a pass began"))

    def refuse(content=None, *options):
        if content is not None:
            path.write_bytes(content)
        before = path.read_bytes()
        message = refused(path, *PASSES, 2, "-o", tmp_path / "a.exr", "--state", path, *options)
        assert path.read_bytes() == before
        assert [each.name for each in tmp_path.iterdir()] == ["state.npz"]
        return message

    refuse.path = path
    return refuse


def test_states_cut_off_anywhere_are_refused(made, refused_state):
    for content in cut_off(made["fixed.npz"], 12):
        assert "move it away" in refused_state(content)


@pytest.mark.parametrize("wrong", WRONG_COLUMNS)
@pytest.mark.parametrize("name", ["radius", "n", "tau"])
def test_columns_of_states_are_checked(name, wrong, made, refused_state):
    refused_state.path.write_bytes(made["fixed.npz"])
    arrays = arrays_of(refused_state.path)
    save(refused_state.path, arrays | {name: WRONG_COLUMNS[wrong](arrays[name])})
    refused_state()


@pytest.mark.parametrize("wrong", [name for name in WRONG_COLUMNS if name != "infinite"])
@pytest.mark.parametrize("name", ["radius", "seen_Z", "seen_N"])
def test_columns_of_stochastic_states_are_checked(name, wrong, made, refused_state):
    refused_state.path.write_bytes(made["jittered.npz"])
    arrays = arrays_of(refused_state.path)
    save(refused_state.path, arrays | {name: WRONG_COLUMNS[wrong](arrays[name])})
    refused_state(None, "--stochastic")


@pytest.mark.parametrize(
    "change",
    [
        {"n_passes": None},
        {"n_passes": np.float64(np.inf)},
        {"n_passes": np.int64(-5)},
        {"n_passes": np.int64(0)},
        {"n_passes": np.int64(2**62)},
        {"n_passes": np.arange(3)},
        {"n_stored": None},
        {"n_stored": np.int64(-1)},
        {"n_stored": np.int64(0)},
        {"weight": np.float64(np.nan)},
        {"weight": np.float64(0.0)},
        {"weight": np.float64(1e300)},
        {"weight": "2000"},
        {"disc_passes": np.int64(7)},
        {"disc_passes": None},
        dict.fromkeys(("radius", "n", "tau", "weight", "disc_passes")),
        {"identity": None},
        {"identity": np.float64(3)},
        {"identity": "3"},
        {"identity": "[" * 100_000},
        {"identity": "{}"},
        {"identity": b"{}"},
        {"identity": np.array(["{}", "{}"])},
    ],
    ids=lambda change: str(change)[:40],
)
def test_numbers_of_states_are_checked(change, made, refused_state):
    refused_state.path.write_bytes(made["fixed.npz"])
    save(refused_state.path, arrays_of(refused_state.path) | change)
    refused_state()


def test_negative_statistics_are_refused(made, refused_state):
    for name in ("radius", "n", "tau"):
        refused_state.path.write_bytes(made["fixed.npz"])
        arrays = arrays_of(refused_state.path)
        save(refused_state.path, arrays | {name: -1.0 - arrays[name]})
        assert name in refused_state()


@pytest.mark.parametrize("name", ["map.npz", "image.exr", "image.png", "jittered.npz"])
def test_other_files_are_no_states(name, made, refused_state):
    refused_state(made[name])


def test_a_state_of_another_version_is_refused(made, refused_state):
    refused_state.path.write_bytes(made["fixed.npz"])
    arrays = arrays_of(refused_state.path)
    identity = json.loads(str(arrays["identity"])) | {"version": "0.0.1"}
    save(refused_state.path, arrays | {"identity": json.dumps(identity)})
    assert "its version is 0.0.1" in refused_state()


def test_a_state_that_is_whole_is_resumed(made, tmp_path):
    path = tmp_path / "state.npz"
    path.write_bytes(made["fixed.npz"])
    assert run(*PASSES, 2, "-o", tmp_path / "a.exr", "--state", path) == 0
    assert arrays_of(path)["n_passes"] == 2


# --- images ---------------------------------------------------------------------------------------


@pytest.fixture
def image(made, tmp_path):
    path = tmp_path / "image.exr"
    path.write_bytes(made["image.exr"])
    return path


def test_images_cut_off_anywhere_are_refused(image, refused):
    for content in cut_off(image.read_bytes(), 60):
        image.write_bytes(content)
        refused(image, "info", image)


def test_images_with_flipped_bytes_print_nothing_of_their_own(image, capfd):
    messages = []
    for content in flipped(image.read_bytes(), 300):
        image.write_bytes(content)
        try:
            read_exr(image)
        except (ValueError, MemoryError) as error:
            messages.append(str(error))
        assert capfd.readouterr() == ("", "")
    assert all(str(image) in message for message in messages)


@pytest.mark.parametrize("size", [(2**31 - 1, 1), (10**6, 10**6), (100_000, 8), (12, 2**30)])
def test_sizes_of_images_that_are_not_there_are_refused(size, image, refused):
    content = bytearray(image.read_bytes())
    at = content.index(b"dataWindow\0box2i\0") + len(b"dataWindow\0box2i\0") + 12
    content[at : at + 8] = (np.array(size) - 1).astype("<i4").tobytes()
    image.write_bytes(content)
    refused(image, "info", image)


@pytest.mark.parametrize("text", ["{", "[]", "3", '{"emitted": 1}', '{"emitted": "a"}', "null"])
def test_the_cost_of_a_reference_is_checked(text, image, refused):
    found = read_exr(image)
    pr.Image(found.layers, found.metadata | {"photonrelax.reference_cost": text}).write_exr(image)
    folder = image.with_name("out")
    command = ("compare", "ring", "-o", folder, "--reference", image, *SIZE)
    assert "reference_cost" in refused(image, *command)
    assert not folder.exists()


@pytest.mark.parametrize("content", [b"", b"text", b"v/1\x01", b"\x89PNG\r\n\x1a\n"])
def test_a_cached_reference_that_is_damaged_is_kept(content, tmp_path, refused):
    folder = tmp_path / "out"
    folder.mkdir()
    cached = folder / "reference.exr"
    cached.write_bytes(content)
    assert "move it away" in refused(cached, "compare", "ring", "-o", folder, *SIZE)
    assert cached.read_bytes() == content


@pytest.mark.parametrize(
    "content", [b"", b"text", b"PK\x03\x04", b"v/1\x01\x02\0\0\0", b"\x80\x04"]
)
def test_files_of_any_content_are_described_or_refused(content, tmp_path, refused):
    for name in ("a.npz", "a.exr", "a"):
        path = tmp_path / name
        path.write_bytes(content)
        refused(path, "info", path)


def test_a_damaged_run_of_a_reference_is_found_before_the_work(
    tmp_path, refused, monkeypatch, capfd
):
    folder = tmp_path / "out"
    options = ("--reference-passes", 4, "--reference-photons", 2000, "--photons", 2000)
    compare = ("compare", "ring", "-o", folder, "--methods", "standard", *SIZE, *options)
    advance = progressive_render._Run.advance

    def interrupted(run):
        advance(run)
        raise KeyboardInterrupt

    monkeypatch.setattr(progressive_render._Run, "advance", interrupted)
    assert run(*compare) == 130
    capfd.readouterr()
    [state] = folder.glob(".reference.*.0.npz")
    damaged = state.read_bytes()[:-100]
    state.write_bytes(damaged)
    monkeypatch.setattr(progressive_render._Run, "advance", lambda _: pytest.fail("a pass began"))
    refused(state, *compare)
    assert state.read_bytes() == damaged
