"""`photonrelax info`, and the tables that commands print."""

import numpy as np

import photonrelax as pr
from photonrelax.cli import commands
from photonrelax.cli.reports import describe_photons, stage_table


def run(*arguments):
    return commands.main([str(argument) for argument in arguments])


def test_info_describes_a_photon_map(tmp_path, capsys):
    position = np.random.default_rng(3).random((500, 3))
    small_map = pr.PhotonMap(
        position, np.tile([0.0, 0.0, 1.0], (500, 1)), np.full(500, 0.002), n_emitted=500
    )
    small_map.save(tmp_path / "photons.npz")
    assert run("info", tmp_path / "photons.npz") == 0
    out = capsys.readouterr().out
    assert out == describe_photons(small_map) + "\n"
    assert "500 photons of 500 emitted" in out
    assert "flux: (1, 1, 1) W" in out


def test_info_counts_dispersed_photons():
    position, normal = np.zeros((4, 3)), np.tile([0.0, 0.0, 1.0], (4, 1))
    photons = pr.PhotonMap(position, normal, np.ones(4), wavelength=[0.0, 700.0, 450.0, 0.0])
    assert "dispersed: 2 photons, 450 to 700 nm" in describe_photons(photons).splitlines()
    white = photons.replace(wavelength=np.zeros(4))
    assert "dispersed" not in describe_photons(white)


def test_info_counts_flux_on_sensors_apart():
    photons = pr.PhotonMap(
        position=np.zeros((6, 3)),
        normal=np.tile([0.0, 0.0, 1.0], (6, 1)),
        flux=np.ones((6, 3)),
        object_id=[0, 2, 2, 0, 2, 1],
        sensor_ids=[3, 2],
    )
    lines = describe_photons(photons).splitlines()
    assert "flux: (3, 3, 3) W" in lines
    assert "sensor, object 2: 3 photons, flux (3, 3, 3) W" in lines
    assert "sensor, object 3: 0 photons, flux (0, 0, 0) W" in lines


def test_info_prints_the_ledger_of_each_emitter():
    flux = {name: np.full((1, 3), value) for name, value in LEDGER.items()}
    ends = {name: [10 * i] for i, name in enumerate(LEDGER) if name != "emitted"}
    photons = pr.PhotonMap(
        position=np.zeros((0, 3)),
        normal=np.zeros((0, 3)),
        flux=np.zeros((0, 3)),
        ledger=pr.EnergyLedger(**flux, ends=ends),
        scene_digest="0f",
    )
    lines = describe_photons(photons).splitlines()
    assert "scene: 0f, the digest of its objects and emitters" in lines
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


def test_info_refuses_a_malformed_photon_map(tmp_path, capsys):
    np.savez(tmp_path / "a.npz", photonmap_version=1, position=["here"], normal=[0], flux=[0])
    assert run("info", tmp_path / "a.npz") == 1
    error = capsys.readouterr().err
    assert error.startswith(f"photonrelax: error: {tmp_path / 'a.npz'} is not a photon map: ")
    assert error.count("\n") == 1


def test_stage_table_lines_up():
    stages = {"trace": {"seconds": 1.25, "n_emitted": 1000000}, "relax": {"seconds": 10.5}}
    assert stage_table(stages).splitlines() == [
        "trace      1.25 s  n emitted 1,000,000",
        "relax     10.50 s",
        "total     11.75 s",
    ]
