"""Scenes that scripts make."""

import pytest

import photonrelax as pr
from photonrelax import cli
from photonrelax.scene.digest import scene_digests

SCRIPT = """
import sizes
import photonrelax as pr

def scene(elevation=30.0, pixels=sizes.PIXELS):
    return pr.gallery.scene("ring", elevation=elevation, pixels=pixels)
"""


@pytest.fixture
def script(tmp_path):
    (tmp_path / "sizes.py").write_text("PIXELS = 12\n")
    path = tmp_path / "mine.py"
    path.write_text(SCRIPT)
    return path


def test_it_is_the_scene_of_the_function(script):
    expected = pr.gallery.scene("ring", elevation=50.0, pixels=12)
    loaded = pr.load_scene(script, arguments={"elevation": 50.0})
    assert scene_digests(loaded) == scene_digests(expected)


def test_commands_take_its_arguments(script, tmp_path, capsys):
    output = tmp_path / "image.exr"
    arguments = ["--arg", "elevation=50", "--arg", "pixels=16", "--photons", "2000"]
    assert cli.main(["render", str(script), *arguments, "-o", str(output)]) == 0
    assert cli.main(["info", str(output)]) == 0
    assert "16 x 16 pixels" in capsys.readouterr().out


def test_commands_plan_trace_and_map_it(script, tmp_path):
    name = str(script)
    assert cli.main(["plan", name]) == 0
    photons = tmp_path / "photons.npz"
    assert cli.main(["trace", name, "--photons", "2000", "-o", str(photons)]) == 0
    relaxed = ["-o", str(tmp_path / "relaxed.npz"), "--scene", name]
    assert cli.main(["relax", str(photons), *relaxed]) == 0
    mapped = ["--on", "floor", "--photons", "2000", "--texels", "8"]
    assert cli.main(["irradiance", name, *mapped, "-o", str(tmp_path / "map.exr")]) == 0


@pytest.mark.parametrize(
    ("text", "arguments", "message"),
    [
        ("x = 1", {}, r"should define a function scene\(\)"),
        ("def scene():\n    return 3", {}, "should return a photonrelax.Scene, but returns int"),
        ("def scene():\n    return 1 / 0", {}, "line 2 fails with ZeroDivisionError"),
        ("def scene(:", {}, "fails with SyntaxError"),
        ("import nonsense", {}, "line 1 fails with ModuleNotFoundError"),
        (
            SCRIPT.replace("import sizes", "class sizes:\n PIXELS = 1"),
            {"size": 2},
            "elevation=30.0",
        ),
    ],
)
def test_what_is_wrong_with_it_is_one_line(tmp_path, capsys, text, arguments, message):
    path = tmp_path / "mine.py"
    path.write_text(text)
    with pytest.raises((ValueError, TypeError), match=message):
        pr.load_scene(path, arguments=arguments)
    given = [f"--arg={name}={value}" for name, value in arguments.items()]
    assert cli.main(["plan", str(path), *given]) == 1
    error = capsys.readouterr().err
    assert str(path) in error
    assert error.count("\n") == 1


def test_other_files_are_refused(tmp_path, capsys):
    with pytest.raises(ValueError, match=r"should be a file named \*.py"):
        pr.load_scene(tmp_path / "scene.docx")
    with pytest.raises(FileNotFoundError, match="there is no file"):
        pr.load_scene(tmp_path / "scene.py")
    assert cli.main(["plan", "scene.docx"]) == 1
    assert "should be a file named *.py" in capsys.readouterr().err


def test_a_script_has_its_one_camera(script):
    with pytest.raises(ValueError, match="has the one camera"):
        pr.load_scene(script, camera="Left")


def test_built_in_scenes_have_one_camera(capsys):
    with pytest.raises(SystemExit):
        cli.main(["plan", "ring", "--camera", "Left"])
    assert "--camera is of scenes from files" in capsys.readouterr().err
