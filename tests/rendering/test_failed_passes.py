"""Runs that are broken off keep the passes done; passes may store nothing."""

from dataclasses import replace

import numpy as np
import pytest

import photonrelax as pr
from photonrelax.estimation import progressive
from photonrelax.photons.photon_map import NothingStoredError
from photonrelax.rendering import pass_statistics, passes, progressive_render
from photonrelax.rendering.passes import pass_seed
from tests.helpers.short_runs import FEW, layers_bytes

PLACES = {
    "trace_photons": passes,
    "PhotonPass": pass_statistics,
    "update": progressive.HitPointStatistics,
    "PassState": pass_statistics,
}


@pytest.mark.parametrize("stochastic", [False, True])
@pytest.mark.parametrize("error", [KeyboardInterrupt, MemoryError])
@pytest.mark.parametrize("where", PLACES)
def test_errors_and_ctrl_c_keep_whole_passes(
    ring, where, error, stochastic, *, tmp_path, monkeypatch
):
    """In the middle of the third pass, long before an interval is over."""
    interrupt_call(monkeypatch, PLACES[where], where, error, number=3)
    state = pr.Checkpoints(state=tmp_path / "run.npz", interval=np.inf)
    how = {"n_passes": 4, "stochastic": stochastic, **FEW}
    with pytest.raises(error):
        pr.render_progressive(ring, checkpoints=state, **how)
    monkeypatch.undo()
    assert np.load(tmp_path / "run.npz")["n_passes"] == 2
    resumed = pr.render_progressive(ring, checkpoints=state, **how)
    assert layers_bytes(resumed) == layers_bytes(pr.render_progressive(ring, **how))


def interrupt_call(monkeypatch, owner, name, error, *, number):
    """Raise an error in place of one of the calls of a function."""
    work, calls = getattr(owner, name), []

    def interrupted(*arguments, **more):
        calls.append(name)
        if len(calls) == number:
            raise error
        return work(*arguments, **more)

    monkeypatch.setattr(owner, name, interrupted)


@pytest.mark.parametrize("error", [KeyboardInterrupt, OSError])
def test_the_last_save_is_tried_again_when_it_is_broken_off(ring, error, tmp_path, monkeypatch):
    interrupt_call(monkeypatch, progressive_render.Checkpoint, "save", error, number=1)
    state = pr.Checkpoints(state=tmp_path / "run.npz", interval=np.inf)
    with pytest.raises(error):
        pr.render_progressive(ring, n_passes=2, checkpoints=state, **FEW)
    assert np.load(tmp_path / "run.npz")["n_passes"] == 2


@pytest.mark.parametrize("error", [KeyboardInterrupt, RuntimeError])
def test_what_the_interval_had_not_saved_is_saved_when_a_callback_ends_the_run(
    ring, error, tmp_path
):
    def interrupt(stage, done, total):
        if done == 2:
            raise error

    state = pr.Checkpoints(state=tmp_path / "run.npz")
    with pytest.raises(error):
        pr.render_progressive(ring, n_passes=4, checkpoints=state, progress=interrupt, **FEW)
    assert np.load(tmp_path / "run.npz")["n_passes"] == 2


def store_nothing(monkeypatch, n_passes, seed=3):
    """Let the first passes of a run store no photon."""
    dark = {pass_seed(seed, number) for number in range(n_passes)}

    def traced(scene, n_emitted, *, seed, **how):
        photons = pr.trace_photons(scene, n_emitted, seed=seed, **how)
        if seed in dark:
            raise NothingStoredError("all of them escaped", photons.subset([]))
        return photons

    monkeypatch.setattr(passes, "trace_photons", traced)


@pytest.mark.parametrize("stochastic", [False, True])
def test_a_run_goes_on_over_passes_that_store_nothing(ring, stochastic, tmp_path, monkeypatch):
    store_nothing(monkeypatch, 2)
    how = {"stochastic": stochastic, **FEW}
    straight = pr.render_progressive(ring, n_passes=4, **how)
    state = pr.Checkpoints(state=tmp_path / "run.npz")
    with pytest.raises(ValueError, match="no photon was stored in 1 passes; of the last: all of"):
        pr.render_progressive(ring, n_passes=1, checkpoints=state, **how)
    for n_passes in (3, 4):
        resumed = pr.render_progressive(ring, n_passes=n_passes, checkpoints=state, **how)
    assert layers_bytes(resumed) == layers_bytes(straight)
    assert straight.metadata["photonrelax.photons_emitted"] == "8000"


def test_passes_that_store_nothing_count_as_such(ring, monkeypatch):
    """A third of the image of the third pass alone."""
    store_nothing(monkeypatch, 2)
    three = pr.render_progressive(ring, n_passes=3, **FEW).layers["caustic"]
    monkeypatch.setattr(passes, "pass_seed", lambda seed, number: pass_seed(seed, 2))
    alone = pr.render_progressive(ring, n_passes=1, **FEW).layers["caustic"]
    assert alone.any()
    np.testing.assert_allclose(three, alone / 3.0, rtol=1e-12)


def test_passes_of_a_single_photon_need_a_radius(ring):
    with pytest.raises(ValueError, match=r"all at one point.* give ProgressiveSettings\(radius="):
        pr.render_progressive(ring, n_passes=40, photons_per_pass=1)
    given = pr.ProgressiveSettings(radius=0.5)
    image = pr.render_progressive(ring, n_passes=40, photons_per_pass=1, settings=given)
    assert 0 < image.stats["stages"]["passes"]["stored"] < 40


def test_a_run_that_another_process_works_on_is_left_alone(ring, tmp_path):
    state = pr.Checkpoints(state=tmp_path / "run.npz", interval=1e-9)
    refused = []

    def meanwhile(image):
        other = pr.Checkpoints(state=tmp_path / "run.npz")
        with pytest.raises(BlockingIOError, match=r"run\.npz is in use by another run"):
            pr.render_progressive(ring, n_passes=9, checkpoints=other, **FEW)
        refused.append(image)

    pr.render_progressive(ring, n_passes=2, checkpoints=replace(state, on_image=meanwhile), **FEW)
    assert len(refused) == 3
    assert [path.name for path in tmp_path.iterdir()] == ["run.npz"]
    pr.render_progressive(ring, n_passes=3, checkpoints=state, **FEW)


def test_a_state_that_cannot_be_written_is_refused_before_the_view_is_traced(
    ring, tmp_path, monkeypatch
):
    monkeypatch.setattr(pass_statistics.View, "bands", lambda _: pytest.fail("traced"))
    state = pr.Checkpoints(state=tmp_path / "none" / "run.npz")
    with pytest.raises(FileNotFoundError, match=r"cannot write .*run\.npz: there is no folder"):
        pr.render_progressive(ring, n_passes=1, checkpoints=state, **FEW)
