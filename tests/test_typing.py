"""Types as a user's script sees them: lists and float32 pass, wrong keywords do not."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

import photonrelax

RIGHT = """
import numpy as np
import photonrelax as pr

photons = pr.PhotonMap(np.zeros((3, 3), np.float32), [[0, 0, 1]] * 3, [1.0, 2.0, 3.0], n_emitted=3)
photons = photons.replace(well_spaced=True).subset([True, False, True])
field = pr.irradiance_field(photons, method="standard", gather=pr.GatherSettings(k=2))
total: float = float(field([[0, 0, 0]], np.ones((1, 3), np.float32)).sum())
found = pr.KDTree(np.zeros((3, 3), np.float32)).query([[0, 0, 0]], 2)
nearest: int = int(found.ids[0, 0])

glass = pr.Dielectric(ior=1.5, absorption=[0.1, 0.2, 0.3])
emitters = [pr.PointEmitter([0, 0, 1], power=2), pr.CollimatedEmitter(np.ones(3, np.float32))]
camera = pr.Camera([0, 0, 1], (0, 0, 0), up=[0, 1, 0], width=64)
objects = pr.gallery.scene("ring").objects
scene = pr.Scene(objects, emitters, camera, name="mine")
traced = pr.trace_photons(scene, 1000, sampler="random", seed=3)
structure = pr.detect_structure(traced, pr.StructureSettings(k=30))
relaxed = pr.relax(traced, structure, pr.RelaxSettings((3, 3)), scene=scene)
image = pr.render(scene, n_emitted=1000, relax=pr.RelaxSettings((3, 3)))
mean: float = float(image.layers["radiance"].mean())
image.write_exr("mine.exr")
pr.render_progressive(scene, n_passes=2, settings=pr.ProgressiveSettings(k=3))
"""
WRONG = [
    "pr.render(scene, n_photons=1000)",
    "pr.render(scene, relaxation=pr.RelaxSettings())",
    "pr.irradiance_field(photons, gather=pr.RelaxSettings())",
    "pr.irradiance_field(photons, methods='standard')",
    "pr.trace_photons(scene, n=1000)",
    "pr.PhotonMap(positions=[[0, 0, 0]], normal=[[0, 0, 1]], flux=[1.0])",
    "pr.GatherSettings(K=15)",
    "pr.Camera([0, 0, 1], [0, 0, 0], fov=45)",
    "pr.Scene([], [], cameras=None)",
    "pr.KDTree([[0, 0, 0]]).query([[0, 0, 0]], 1, radius=2)",
    "pr.nonsense",
]
PREAMBLE = "import photonrelax as pr\n\ndef run(scene: pr.Scene, photons: pr.PhotonMap) -> None:\n"


@pytest.fixture(scope="module")
def checked(tmp_path_factory):
    """The lines of two scripts that mypy finds fault with, and what it printed."""
    folder = tmp_path_factory.mktemp("typing")
    (folder / "right.py").write_text(RIGHT)
    (folder / "wrong.py").write_text(PREAMBLE + "".join(f"    {line}\n" for line in WRONG))
    environment = dict(os.environ)
    home = Path(photonrelax.__file__).parents[1]
    if home.name != "site-packages":
        environment["MYPYPATH"] = str(home)
    options = ("--strict", "--cache-dir", ".mypy")
    command = [sys.executable, "-m", "mypy", *options, "right.py", "wrong.py"]
    done = subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True)
    return done.stdout


def test_lists_and_float32_arrays_pass(checked):
    assert "right.py" not in checked


@pytest.mark.parametrize("line", WRONG)
def test_a_wrong_keyword_or_type_fails(line, checked):
    number = len(PREAMBLE.splitlines()) + 1 + WRONG.index(line)
    assert f"wrong.py:{number}: error" in checked
