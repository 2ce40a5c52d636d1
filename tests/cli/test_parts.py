"""Photon maps larger than memory on the command line."""

import numpy as np
import pytest

import photonrelax as pr
from photonrelax.cli import commands
from photonrelax.cli.parts import photons_given
from photonrelax.imaging.image import read_exr


def run(*arguments):
    return commands.main([str(argument) for argument in arguments])


def test_photons_are_traced_in_parts_and_relaxed_by_blocks(tmp_path):
    parts, blocks = tmp_path / "parts", tmp_path / "blocks"
    traced = ("trace", "ring", "-o", parts, "--photons", 3000, "--chunk", 2000, "--quiet")
    assert run(*traced) == run(*traced) == 0
    relax = ("relax", parts, "--iterations", 1, 1, "--quiet")
    assert run(*relax, "-o", blocks) == 0
    before = pr.PhotonParts.open(parts).photon_map()
    after = pr.BlockedPhotons.open(blocks).photon_map()
    assert after.well_spaced
    np.testing.assert_array_equal(after.flux, before.flux)
    assert (after.position != before.position).any()


def test_maps_of_blocks_are_those_of_one_piece(tmp_path):
    parts, blocks, one = tmp_path / "parts", tmp_path / "blocks", tmp_path / "one.npz"
    run("trace", "ring", "-o", parts, "--photons", 3000, "--chunk", 2000, "--quiet")
    run("relax", parts, "-o", blocks, "--block", 700, "--iterations", 1, 1, "--quiet")
    pr.BlockedPhotons.open(blocks).photon_map().save(one)
    maps = {}
    for name, photons, method in (("a", blocks, "mapped"), ("b", one, "standard")):
        place = ("--on", "floor", "--texels", 16, "--size", 2, "--set", "gather.gather_radius=.1")
        how = ("--photon-map", photons, "--method", method, "-o", tmp_path / f"{name}.exr")
        assert run("irradiance", "ring", *place, *how, "--quiet") == 0
        maps[name] = read_exr(tmp_path / f"{name}.exr")
    assert maps["b"].layers["irradiance"].any()
    for layer, values in maps["a"].layers.items():
        np.testing.assert_allclose(values, maps["b"].layers[layer], rtol=1e-6)
    for key in ("photons_emitted", "photons_stored", "ledger", "scene"):
        name = f"photonrelax.{key}"
        assert maps["a"].metadata[name] == maps["b"].metadata[name]


def test_photons_of_another_scene_are_refused(tmp_path, capsys):
    one = tmp_path / "one.npz"
    run("trace", "ring", "-o", one, "--photons", 300, "--quiet")
    with pytest.raises(ValueError, match="should be of the scene rendered"):
        photons_given(one, pr.gallery.scene("prism", subdivisions=1))
    place = ("--on", "floor", "-o", tmp_path / "map.exr", "--photon-map", one)
    with pytest.raises(SystemExit):
        run("irradiance", "ring", *place, "--photons", 5)
    assert "leave out --photons" in capsys.readouterr().err


def test_options_that_contradict_parts_are_refused(tmp_path, capsys):
    with pytest.raises(SystemExit):
        run("trace", "ring", "-o", tmp_path / "a", "--chunk", 9, "--frequency-share", 0.5)
    assert "leave out --frequency-share" in capsys.readouterr().err
    assert run("relax", tmp_path, "-o", tmp_path / "b") == 1
    assert "has no manifest.json" in capsys.readouterr().err
