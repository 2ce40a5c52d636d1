"""`photonrelax animate`: frames, those that are there, and the movie."""

import json

import pytest
from PIL import Image

from photonrelax import gallery
from photonrelax.cli import main
from photonrelax.imaging.image import read_exr
from photonrelax.rendering.presets import preset_data


@pytest.fixture
def animate(monkeypatch, tmp_path):
    """Frames of 8 pixels of a coarse pool, in a folder of their own."""
    build = gallery.scene
    monkeypatch.setattr(gallery, "scene", lambda name, **given: build(name, resolution=16, **given))
    monkeypatch.chdir(tmp_path)
    size = ("--width", "8", "--photons", "500", "--global", "500", "--supersampling", "1")
    return lambda *arguments: main(["animate", *arguments, *size, "--quiet"])


def test_frames_and_a_movie(animate, tmp_path):
    done = animate("pool", "--frames", "3", "-o", "a.%03d.exr", "--movie", "a.webp", "--fps", "10")
    assert done == 0
    names = {f"a.00{number}.{suffix}" for number in range(3) for suffix in ("exr", "png")}
    assert {path.name for path in tmp_path.iterdir()} == names | {"a.webp"}
    with Image.open("a.webp") as movie:
        assert (movie.n_frames, movie.size) == (3, (8, 8))


def test_a_script_gets_the_time_of_each_frame(animate, tmp_path):
    script = tmp_path / "waves.py"
    script.write_text(
        "from photonrelax import gallery\n"
        "def scene(time, n=16):\n"
        "    return gallery.scene('pool', time=time)\n"
    )
    arguments = ("waves.py", "--arg", "n=8", "--frames", "2", "--fps", "10", "-o", "b.%d.exr")
    assert animate(*arguments) == 0
    assert animate("pool", "--frames", "2", "--fps", "10", "-o", "a.%d.exr") == 0
    for number in range(2):
        made, known = (read_exr(f"{name}.{number}.exr").layers["radiance"] for name in "ba")
        assert made.tobytes() == known.tobytes()


def test_frames_that_are_there_are_kept(animate, tmp_path):
    arguments = ("pool", "--frames", "2", "-o", "a.%d.exr")
    assert animate(*arguments) == 0
    kept, redone = (tmp_path / f"a.{number}.exr" for number in (0, 1))
    content, before = redone.read_bytes(), kept.stat().st_mtime_ns
    redone.unlink()
    assert animate(*arguments) == 0
    assert kept.stat().st_mtime_ns == before
    assert redone.read_bytes() == content


@pytest.mark.parametrize("goal", [("--error", "0.5"), ("--seconds", "0.5")])
def test_frames_have_as_many_photons_as_those_that_are_there(animate, tmp_path, goal):
    arguments = ("pool", "--frames", "2", "-o", "a.%d.exr", *goal)
    assert animate(*arguments) == 0
    redone = tmp_path / "a.0.exr"
    content = redone.read_bytes()
    redone.unlink()
    assert animate(*arguments) == 0
    assert redone.read_bytes() == content


def test_a_preset_of_frames(animate):
    arguments = ("pool", "--frames", "2", "-o", "a.%d.exr", "--preset", "draft")
    assert animate(*arguments, "--method", "standard") == 0
    used = json.loads(read_exr("a.1.exr").metadata["photonrelax.settings"])
    assert (
        used["gather"]["k"]
        == preset_data()["presets"]["sharp"]["draft"]["standard"]["stages"]["gather"]["k"]
    )


@pytest.mark.parametrize(
    ("arguments", "complaint"),
    [
        (
            ("ring", "--frames", "2", "-o", "a.%d.exr"),
            "ring does not move: it has no argument time",
        ),
        (("a.glb", "--frames", "2", "-o", "a.%d.exr"), "should be a script, but is a.glb"),
        (
            ("pool", "--frames", "2", "-o", "a.exr"),
            "one place for numbers, as in %04d, but is a.exr",
        ),
        (("pool", "--frames", "2", "-o", "a.%d.%d.exr"), "one place for numbers"),
        (("pool", "--frames", "2", "-o", "a.%d.exr", "--movie", "a.gif"), "a .webp or .png file"),
    ],
)
def test_what_cannot_be_is_refused(animate, capsys, arguments, complaint):
    assert animate(*arguments) == 1
    assert complaint in capsys.readouterr().err
