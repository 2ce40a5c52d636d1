"""Photon maps larger than memory on the command line."""

import numpy as np
import pytest

import photonrelax as pr
from photonrelax.cli import commands


def run(*arguments):
    return commands.main([str(argument) for argument in arguments])


def test_photons_are_traced_in_parts_and_relaxed_by_blocks(tmp_path):
    parts, blocks = tmp_path / "parts", tmp_path / "blocks"
    traced = ("trace", "ring", "-o", parts, "--photons", 3000, "--chunk", 2000, "--quiet")
    assert run(*traced) == run(*traced) == 0
    assert run("relax", parts, "-o", blocks, "--iterations", 1, 1, "--quiet") == 0
    before = pr.PhotonParts.open(parts).photon_map()
    after = pr.BlockedPhotons.open(blocks).photon_map()
    assert after.well_spaced
    np.testing.assert_array_equal(after.flux, before.flux)
    assert (after.position != before.position).any()


def test_options_that_contradict_parts_are_refused(tmp_path, capsys):
    with pytest.raises(SystemExit):
        run("trace", "ring", "-o", tmp_path / "a", "--chunk", 9, "--frequency-share", 0.5)
    assert "leave out --frequency-share" in capsys.readouterr().err
    assert run("relax", tmp_path, "-o", tmp_path / "b") == 1
    assert "has no manifest.json" in capsys.readouterr().err
