"""EXR and PNG files: what an independent reader finds in them."""

import os
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import OpenEXR
import OpenImageIO
import pytest
from PIL import Image as PILImage

import photonrelax as pr
from photonrelax._util.files import check_writable, output_path, whole_file
from photonrelax.imaging.image import read_exr, srgb

HEIGHT, WIDTH = 5, 7


@pytest.fixture
def layers():
    rng = np.random.default_rng(1)
    depth = rng.uniform(1, 9, (HEIGHT, WIDTH))
    depth[0] = np.inf
    return {
        "radiance": rng.uniform(0, 5, (HEIGHT, WIDTH, 3)),
        "caustic": rng.uniform(0, 5, (HEIGHT, WIDTH, 3)),
        "N": rng.uniform(-1, 1, (HEIGHT, WIDTH, 3)),
        "Z": depth,
        "photons.constraint": rng.uniform(0, 1, (HEIGHT, WIDTH)),
        "photons.emitter": rng.uniform(0, 1, (HEIGHT, WIDTH, 3)),
    }


def test_openimageio_reads_every_channel_and_the_metadata(layers, tmp_path):
    # Numbers beyond 32 bits survive as text.
    image = pr.Image(layers, {"seed": str(2**40), "method": "parameterised β"})
    image.write_exr(tmp_path / "image.exr")
    buffer = OpenImageIO.ImageBuf(str(tmp_path / "image.exr"))
    spec = buffer.spec()
    expected = {
        "R": layers["radiance"][..., 0],
        "G": layers["radiance"][..., 1],
        "B": layers["radiance"][..., 2],
        "caustic.R": layers["caustic"][..., 0],
        "caustic.B": layers["caustic"][..., 2],
        "N.X": layers["N"][..., 0],
        "N.Y": layers["N"][..., 1],
        "N.Z": layers["N"][..., 2],
        "Z": layers["Z"],
        "photons.constraint": layers["photons.constraint"],
        "photons.emitter.G": layers["photons.emitter"][..., 1],
    }
    assert (spec.height, spec.width, spec.nchannels) == (HEIGHT, WIDTH, 14)
    assert str(spec.format) == "float"
    assert spec.getattribute("compression") == "zip"
    assert spec.getattribute("seed") == str(2**40)
    assert spec.getattribute("method") == "parameterised β"
    pixels = buffer.get_pixels(OpenImageIO.FLOAT)
    for name, values in expected.items():
        channel = pixels[..., spec.channelnames.index(name)]
        np.testing.assert_array_equal(channel, values.astype(np.float32), err_msg=name)


def test_read_exr_gives_back_what_was_written(layers, tmp_path):
    pr.Image(layers, {"seed": "7"}).write_exr(tmp_path / "image.exr")
    image = read_exr(tmp_path / "image.exr")
    assert image.metadata == {"seed": "7"}
    assert set(image.layers) == set(layers)
    for name, values in layers.items():
        np.testing.assert_array_equal(image.layers[name], values.astype(np.float32), err_msg=name)


def test_layers_in_another_memory_order_are_written_right(layers, tmp_path):
    radiance = np.asfortranarray(layers["radiance"])
    flipped = layers["Z"][::-1, ::-1]
    pr.Image({"radiance": radiance, "Z": flipped}).write_exr(tmp_path / "image.exr")
    pixels = OpenImageIO.ImageBuf(str(tmp_path / "image.exr")).get_pixels(OpenImageIO.FLOAT)
    np.testing.assert_array_equal(pixels[..., :3], radiance.astype(np.float32))
    np.testing.assert_array_equal(pixels[..., 3], flipped.astype(np.float32))


def test_png_is_exposed_and_encoded_for_srgb_displays(tmp_path):
    radiance = np.zeros((1, 4, 3))
    radiance[0, :, 0] = [0.0, 0.25 * 0.21586, 0.25, 100.0]
    radiance[0, 2, 1] = 0.25 * 0.002
    pr.Image({"radiance": radiance}).write_png(tmp_path / "image.png", exposure=2.0)
    with PILImage.open(tmp_path / "image.png") as image:
        pixels = np.asarray(image)
    assert pixels.shape == (1, 4, 3)
    # Linear 0.21586 is 128 on the sRGB scale; 0.002 lies on its linear piece.
    np.testing.assert_array_equal(pixels[0, :, 0], [0, 128, 255, 255])
    assert pixels[0, 2, 1] == round(255 * 12.92 * 0.002)


def test_srgb_is_continuous_and_increasing():
    values = srgb(np.linspace(0, 1, 100_001))
    steps = np.diff(values)
    assert steps.min() > 0
    assert steps.max() < 1.3e-4 + 1e-6
    np.testing.assert_allclose(srgb([-1.0, 0.0, 2.0]), [0.0, 0.0, 1.0])


@pytest.mark.parametrize(
    ("change", "error", "message"),
    [
        ({"Z": np.zeros((WIDTH, HEIGHT))}, ValueError, "one size"),
        ({"albedo": np.zeros((HEIGHT, WIDTH, 4))}, ValueError, "layer albedo"),
        ({"albedo": "white"}, TypeError, "layer albedo"),
    ],
)
def test_what_is_no_layer_is_refused_by_name(layers, change, error, message):
    with pytest.raises(error, match=message):
        pr.Image(layers | change)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"radiance": np.full((HEIGHT, WIDTH, 3), np.nan)}, "layer radiance .* nan"),
        ({"radiance": np.full((HEIGHT, WIDTH, 3), np.inf)}, "layer radiance .* inf"),
        ({"radiance": np.full((HEIGHT, WIDTH, 3), 1e39)}, "float32"),
        ({"radiance": np.zeros((HEIGHT, WIDTH))}, "layer radiance should have three"),
        ({"Z": np.full((HEIGHT, WIDTH), -np.inf)}, "layer Z"),
    ],
)
def test_what_cannot_be_shown_is_not_written(layers, change, message, tmp_path):
    image = pr.Image(layers | change)
    with pytest.raises(ValueError, match=message):
        image.write_exr(tmp_path / "image.exr")
    if "radiance" in change:
        with pytest.raises(ValueError, match=message):
            image.write_png(tmp_path / "image.png")
    assert os.listdir(tmp_path) == []


@pytest.mark.parametrize("exposure", [np.nan, np.inf, 1e9, -101])
def test_exposure_beyond_reason_is_refused(layers, exposure, tmp_path):
    with pytest.raises(ValueError, match="exposure should be"):
        pr.Image(layers).write_png(tmp_path / "image.png", exposure=exposure)
    assert os.listdir(tmp_path) == []


@pytest.mark.parametrize(("metadata", "error"), [({"n": 3}, TypeError), ({"type": ""}, ValueError)])
def test_metadata_are_text_under_free_names(layers, metadata, error):
    with pytest.raises(error, match="metadata"):
        pr.Image(layers, metadata)


def test_empty_images_and_those_without_radiance_are_refused(layers, tmp_path):
    with pytest.raises(ValueError, match="empty"):
        pr.Image({})
    with pytest.raises(ValueError, match="radiance"):
        pr.Image({"Z": layers["Z"]}).write_png(tmp_path / "image.png")


def test_reading_what_is_no_exr_file_fails_clearly(tmp_path):
    with pytest.raises(FileNotFoundError, match=r"nothing\.exr"):
        read_exr(tmp_path / "nothing.exr")
    (tmp_path / "text.exr").write_text("no image")
    with pytest.raises(ValueError, match=r"text\.exr is not a whole EXR file"):
        read_exr(tmp_path / "text.exr")


def test_reading_half_an_image_fails_clearly(layers, tmp_path):
    path = tmp_path / "half.exr"
    pr.Image(layers).write_exr(path)
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
    with pytest.raises(ValueError, match=r"half\.exr is not a whole EXR file"):
        read_exr(path)


def write_foreign(path, *parts):
    """Write channels by name, a mapping for each part, as other programs may."""
    header = {"type": OpenEXR.scanlineimage, "compression": OpenEXR.NO_COMPRESSION}
    parts = [
        OpenEXR.Part(header | {"name": f"part {i}"}, dict(channels))
        for i, channels in enumerate(parts)
    ]
    OpenEXR.File(parts).write(str(path))


def test_images_of_other_programs_may_hold_any_values(tmp_path):
    values = np.array([[np.nan, np.inf, -np.inf]], np.float32)
    write_foreign(tmp_path / "a.exr", {"R": values, "G": values, "B": values, "Z": values})
    layers = read_exr(tmp_path / "a.exr").layers
    np.testing.assert_array_equal(layers["radiance"], np.stack(3 * [values], axis=-1))
    np.testing.assert_array_equal(layers["Z"], values)


def test_a_channel_named_as_a_layer_of_three_is_a_layer_of_one(tmp_path):
    grey, red = np.full((1, 3), 1, np.float32), np.full((1, 3), 2, np.float32)
    write_foreign(tmp_path / "grey.exr", {"radiance": grey})
    np.testing.assert_array_equal(read_exr(tmp_path / "grey.exr").layers["radiance"], grey)
    write_foreign(tmp_path / "both.exr", {"radiance": grey, "R": red, "G": red, "B": red})
    both = read_exr(tmp_path / "both.exr").layers
    assert {name: layer[0, 0] for name, layer in both.items()} == {
        "radiance": 1,
        "R": 2,
        "G": 2,
        "B": 2,
    }


def test_an_image_of_several_parts_is_refused_rather_than_shown_in_part(tmp_path):
    values = np.zeros((1, 3), np.float32)
    write_foreign(tmp_path / "a.exr", {"Y": values}, {"Z": values})
    with pytest.raises(ValueError, match=r"a\.exr should be .* of one part, but has 2"):
        read_exr(tmp_path / "a.exr")


def test_a_failing_encoder_is_an_oserror_that_names_the_file(layers, tmp_path, monkeypatch):
    def fails(path):
        raise RuntimeError("disk full")

    monkeypatch.setattr(OpenEXR, "File", lambda *_: SimpleNamespace(write=fails))
    with pytest.raises(OSError, match=r"cannot write .*image\.exr: disk full"):
        pr.Image(layers).write_exr(tmp_path / "image.exr")


@pytest.mark.parametrize("older", [True, False])
@pytest.mark.parametrize("name", ["image.exr", "image.png"])
def test_an_interrupted_encoder_leaves_no_half_image(layers, name, older, tmp_path, monkeypatch):
    def interrupted(path):
        Path(path).write_bytes(b"half")
        raise KeyboardInterrupt

    path = tmp_path / name
    if older:
        path.write_bytes(b"older")
    monkeypatch.setattr(OpenEXR, "File", lambda *_: SimpleNamespace(write=interrupted))
    monkeypatch.setattr(PILImage.Image, "save", lambda _, path, *__: interrupted(path))
    image = pr.Image(layers)
    with pytest.raises(KeyboardInterrupt):
        (image.write_exr if name == "image.exr" else image.write_png)(path)
    assert os.listdir(tmp_path) == ([name] if older else [])
    assert not older or path.read_bytes() == b"older"


def test_files_are_whole_or_not_there(tmp_path):
    path = tmp_path / "file"
    path.write_text("old")

    def interrupted():
        with whole_file(path) as partial:
            partial.write_text("half")
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        interrupted()
    assert path.read_text() == "old"
    with whole_file(path) as partial:
        partial.write_text("new")
    assert path.read_text() == "new"
    assert os.listdir(tmp_path) == ["file"]
    with pytest.raises(FileNotFoundError, match="no folder"), whole_file(tmp_path / "no" / "file"):
        pass


def test_only_what_is_left_of_a_file_of_this_name_is_removed(tmp_path):
    """Names that share forty letters are other names."""
    one, other = (tmp_path / ("n" * 50 + end) for end in ("one", "other"))
    with whole_file(one) as mine, whole_file(other) as theirs:
        mine.write_text("mine")
        theirs.write_text("theirs")
        output_path(other)
        assert mine.exists()
        assert not theirs.exists()
        theirs.write_text("theirs")


def test_what_can_be_written_is_found_out_without_a_trace(tmp_path):
    check_writable(tmp_path / "file")
    check_writable(tmp_path / ("n" * 250))
    assert os.listdir(tmp_path) == []
    with pytest.raises(FileNotFoundError, match="no folder"):
        check_writable(tmp_path / "no" / "file")
    with pytest.raises(IsADirectoryError, match="is a folder"):
        check_writable(tmp_path)
    with pytest.raises(OSError, match="not a regular file"):
        check_writable("/dev/null")
    with pytest.raises(OSError, match="too long"):
        check_writable(tmp_path / ("n" * 300))


@pytest.mark.skipif(not os.path.isdir("/proc"), reason="no folder that nobody can write to")
def test_a_folder_that_takes_no_files_is_found_out():
    with pytest.raises(OSError, match=r"cannot write /proc/file: no file can be made"):
        check_writable("/proc/file")
