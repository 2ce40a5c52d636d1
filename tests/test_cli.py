"""The command line: what it parses, prints, writes and returns."""

import subprocess
import sys

import numpy as np
import pytest

import photonrelax as pr
from photonrelax import cli, gallery
from photonrelax._text import describe_photons, stage_table

HEAVY = ("scipy", "trimesh", "matplotlib", "OpenEXR", "tqdm")


def run(*arguments):
    return cli.main([str(argument) for argument in arguments])


def run_in_process(*arguments, **options):
    command = [sys.executable, "-m", "photonrelax", *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, timeout=60, **options)


@pytest.fixture
def small_map(tmp_path):
    rng = np.random.default_rng(3)
    position = np.column_stack([rng.uniform(0, 1, (500, 2)), np.zeros(500)])
    photons = pr.PhotonMap(
        position=position,
        normal=np.tile([0.0, 0.0, 1.0], (500, 1)),
        flux=np.full(500, 0.002),
        emitter_coords=position[:, :2],
        emitter_density=np.full(500, 500.0),
        n_emitted=500,
    )
    photons.save(tmp_path / "photons.npz")
    return photons


def test_help_imports_nothing_heavy():
    code = (
        "import sys; from photonrelax.cli import main\n"
        "try: main(['--help'])\n"
        f"finally: print([name for name in {HEAVY} if name in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60)
    assert done.returncode == 0, done.stderr
    assert "render" in done.stdout
    assert done.stdout.splitlines()[-1] == "[]"


def test_list_names_every_scene(capsys):
    assert run("list") == 0
    lines = capsys.readouterr().out.splitlines()
    assert [line.split()[0] for line in lines] == list(gallery.names())


@pytest.mark.parametrize(
    ("arguments", "complaint"),
    [
        ([], "required"),
        (["render", "teapot", "-o", "a.exr"], "invalid choice: 'teapot'"),
        (["render", "ring"], "-o/--output"),
        (["render", "ring", "-o", "a.exr", "--method", "magic"], "invalid choice: 'magic'"),
        (["render", "ring", "-o", "a.exr", "--photons", "many"], "a whole number, but is 'many'"),
        (["render", "ring", "-o", "a.exr", "--photons", "2.5"], "a whole number, but is '2.5'"),
        (["render", "ring", "-o", "a.exr", "--k", "0"], "at least 1, but is '0'"),
        (["render", "ring", "-o", "a.exr", "--seed", "-1"], "a whole number, but is '-1'"),
        (["render", "ring", "-o", "a.exr", "--iterations", "7"], "expected 2 arguments"),
    ],
)
def test_wrong_usage_exits_2_and_says_why(arguments, complaint, capsys):
    with pytest.raises(SystemExit) as caught:
        run(*arguments)
    assert caught.value.code == 2
    assert complaint in capsys.readouterr().err


@pytest.mark.parametrize(
    ("text", "number"),
    [("7", 7), ("2e6", 2_000_000), ("1_000", 1000), (str(2**60 + 1), 2**60 + 1)],
)
def test_numbers_may_be_written_as_people_write_them(text, number):
    assert cli._whole(text) == number


@pytest.mark.parametrize("text", ["inf", "nan", "1e999", "-3", "", "0x10"])
def test_what_is_no_whole_number_is_refused(text):
    with pytest.raises(cli.argparse.ArgumentTypeError):
        cli._whole(text)


def test_an_output_that_cannot_be_written_is_an_error_before_the_work(tmp_path, capsys):
    nowhere = tmp_path / "missing" / "ring.exr"
    assert run("render", "ring", "-o", nowhere) == 1
    error = capsys.readouterr().err
    assert (
        error
        == f"photonrelax: error: cannot write {nowhere}: there is no folder {nowhere.parent}\n"
    )
    assert run("render", "ring", "-o", tmp_path / "ring.jpg") == 1
    assert "should be named *.exr" in capsys.readouterr().err
    assert run("trace", "ring", "-o", tmp_path) == 1
    (tmp_path / "folder.npz").mkdir()
    assert run("trace", "ring", "-o", tmp_path / "folder.npz") == 1
    assert "it is a folder" in capsys.readouterr().err


def test_info_describes_a_photon_map(small_map, tmp_path, capsys):
    assert run("info", tmp_path / "photons.npz") == 0
    out = capsys.readouterr().out
    assert out == describe_photons(small_map) + "\n"
    assert "500 photons of 500 emitted" in out
    assert "flux: (1, 1, 1) W" in out


def test_info_tells_the_ledger_of_each_emitter():
    flux = {name: np.full((1, 3), value) for name, value in LEDGER.items()}
    ends = {name: [10 * i] for i, name in enumerate(LEDGER) if name != "emitted"}
    photons = pr.PhotonMap(
        position=np.zeros((0, 3)),
        normal=np.zeros((0, 3)),
        flux=np.zeros((0, 3)),
        ledger=pr.EnergyLedger(**flux, ends=ends),
    )
    lines = describe_photons(photons).splitlines()
    assert "emitter 0: emitted (10, 10, 10) W" in lines
    assert "  stored: (4, 4, 4) W, paths 10" in lines
    assert "  escaped: (2, 2, 2) W, paths 30" in lines


LEDGER = {"emitted": 10, "stored": 4, "absorbed": 3, "escaped": 2, "cut": 0.5, "discarded": 0.5}


def test_info_describes_an_image(tmp_path, capsys):
    pixels = np.ones((4, 6, 3))
    pr.Image({"radiance": pixels, "N": pixels}, {"method": "standard"}).write_exr(
        tmp_path / "a.exr"
    )
    assert run("info", tmp_path / "a.exr") == 0
    assert capsys.readouterr().out.splitlines() == [
        "6 x 4 pixels",
        "layers: N, radiance",
        "method: standard",
    ]


def test_info_refuses_what_it_does_not_know(tmp_path, capsys):
    (tmp_path / "notes.txt").write_text("hello")
    assert run("info", tmp_path / "notes.txt") == 1
    assert "should be an EXR file or a photon map, but is neither" in capsys.readouterr().err
    assert run("info", tmp_path / "nothing.exr") == 1
    assert "No such file" in capsys.readouterr().err


def test_stage_table_lines_up():
    stages = {"trace": {"seconds": 1.25, "n_emitted": 1000000}, "relax": {"seconds": 10.5}}
    assert stage_table(stages).splitlines() == [
        "trace      1.25 s  n emitted 1,000,000",
        "relax     10.50 s",
        "total     11.75 s",
    ]


def test_relax_reads_a_map_and_writes_another(small_map, tmp_path, capsys):
    output = tmp_path / "relaxed.npz"
    arguments = ["relax", tmp_path / "photons.npz", "-o", output, "--iterations", 2, 1]
    assert run(*arguments, "--threads", 1) == 0
    assert f"wrote {output}" in capsys.readouterr().out
    relaxed = pr.PhotonMap.load(output)
    settings = pr.RelaxSettings(n_iterations=(2, 1))
    expected = pr.relax(small_map, pr.detect_structure(small_map), settings)
    np.testing.assert_array_equal(relaxed.position, expected.position)


def test_quiet_prints_nothing(small_map, tmp_path, capsys):
    assert run("relax", tmp_path / "photons.npz", "-o", tmp_path / "r.npz", "--quiet") == 0
    assert capsys.readouterr() == ("", "")


def test_bars_follow_stages(capsys):
    with cli._Bars(quiet=False) as bars:
        bars._disable = False
        for done in (1, 2, 4):
            bars("trace", done, 4)
        bars("relax", 3, 6)
    error = capsys.readouterr().err
    assert "trace: 100%" in error
    assert "relax:  50%" in error
