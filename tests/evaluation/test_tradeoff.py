"""Sweeps: fronts of points, what goes on, and files that are whole and resumed."""

import json
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

import photonrelax as pr
from photonrelax.cli import main
from photonrelax.evaluation import tradeoff as sweeps
from photonrelax.evaluation.reference import ReferenceSettings
from photonrelax.evaluation.tradeoff import Point, TradeoffRequest, front, seconds_for, survivors
from photonrelax.imaging.image import read_exr
from photonrelax.imaging.metrics import Errors
from photonrelax.rendering.presets import Choice, preset_names


def point(seconds, error, method="standard"):
    errors = Errors(error, error, 0.0, 1.0, 0.0)
    return Point(Choice(method, 1), 1, {"cast": seconds}, seconds, float("nan"), errors)


QUICK, MIDDLE, SLOW = point(1.0, 0.4), point(2.0, 0.2), point(4.0, 0.1)
WORSE = point(3.0, 0.3)


def test_no_point_of_the_front_is_beaten_in_both():
    assert front([SLOW, WORSE, MIDDLE, QUICK]) == [QUICK, MIDDLE, SLOW]
    assert front([]) == []


@pytest.mark.parametrize(
    ("error", "seconds"), [(0.5, 1.0), (0.4, 1.0), (0.2, 2.0), (0.1, 4.0), (0.05, np.inf)]
)
def test_times_of_errors(error, seconds):
    assert seconds_for([QUICK, MIDDLE, SLOW], error) == seconds


def test_between_points_time_is_a_power_of_the_error():
    assert seconds_for([QUICK, MIDDLE], 0.4 / np.sqrt(2.0)) == pytest.approx(np.sqrt(2.0))


def test_the_better_half_and_the_best_of_each_method_go_on():
    slow = point(9.0, 0.9, "diffusion")
    assert survivors([QUICK, MIDDLE, WORSE, slow]) == [QUICK, MIDDLE, slow]


def test_rungs_grow_to_the_number_asked_for():
    assert TradeoffRequest(100_000).rungs == [1000, 3162, 10_000, 31_623, 100_000]


SMALL = TradeoffRequest(1000, ("mapped", "envelope"), 0, ReferenceSettings(2, 2000))


@pytest.fixture(scope="module")
def found(tmp_path_factory):
    folder = tmp_path_factory.mktemp("sweep")
    scene = pr.gallery.scene("ring", pixels=16, sections=64)
    return scene, folder, pr.tradeoff(scene, folder, SMALL)


def test_all_of_a_method_is_measured(found):
    _, _, trade = found
    assert {each.choice.method for each in trade.points} == {"mapped", "envelope"}
    assert all(each.total > 0.0 and np.isfinite(each.error) for each in trade.points)
    assert trade.doubt > 0.0
    for each in trade.of("mapped"):
        assert {"camera", "cast", "structure", "rest_density", "relax", "gather"} == {*each.seconds}


def test_settings_of_presets_go_on_to_the_last_rung(found):
    _, _, trade = found
    last = {each.choice.name for each in trade.of("mapped") if each.choice.n_emitted == 1000}
    assert {each for each in preset_names() if each.startswith("mapped relax")} <= last
    assert len(last) < sum(each.method == "mapped" for each in sweeps.CHOICES)


def test_what_is_measured_is_read_again(found, monkeypatch):
    scene, folder, trade = found
    monkeypatch.setattr(sweeps.Sweep, "_run", None)
    again = pr.tradeoff(scene, folder, SMALL)
    assert [each.choice for each in again.points] == [each.choice for each in trade.points]
    assert [each.errors for each in again.points] == [each.errors for each in trade.points]


def test_workers_compute_the_reference_alone(found, tmp_path):
    scene, folder, _ = found
    tasks = []

    class Recorder(ThreadPoolExecutor):
        def submit(self, *arguments, **named):
            tasks.append(arguments[0])
            return super().submit(*arguments, **named)

    settings = TradeoffRequest(1000, ("standard",), 0, SMALL.reference)
    with Recorder(2) as executor:
        pr.tradeoff(scene, tmp_path, settings, executor=executor)
        made = (each / sweeps.REFERENCE for each in (tmp_path, folder))
        one, other = (read_exr(path).layers["caustic"].tobytes() for path in made)
        assert one == other
        assert tasks
        tasks.clear()
        (tmp_path / sweeps.STATE).unlink()
        assert pr.tradeoff(scene, tmp_path, settings, executor=executor).of("standard")
        assert not tasks


def test_an_executor_is_one():
    with pytest.raises(TypeError, match="executor should be"):
        pr.tradeoff(pr.gallery.scene("ring", pixels=4), ".", executor=2)


def test_a_damaged_sweep_is_named(found, tmp_path):
    scene, _, _ = found
    (tmp_path / sweeps.STATE).write_text("[1]")
    with pytest.raises(ValueError, match=r"tradeoff\.json should be a sweep"):
        pr.tradeoff(scene, tmp_path, SMALL)


def test_the_command_writes_table_plot_numbers_and_page(tmp_path, capsys):
    folder = tmp_path / "ring"
    command = ["tradeoff", "ring", "-o", str(folder), "--width", "16", "--photons", "1000"]
    few = ["--reference-passes", "2", "--reference-photons", "2000", "--methods", "standard"]
    assert main([*command, *few]) == 0
    told = capsys.readouterr().out
    assert told.startswith("this takes about")
    assert "doubt" in told
    names = {path.name for path in folder.iterdir()}
    assert names == {"index.html", "front.png", "front.md", "tradeoff.json", "reference.exr"}
    data = json.loads((folder / "tradeoff.json").read_text())
    assert len(data["points"]) > 4
    assert (folder / "front.png").read_bytes().startswith(b"\x89PNG")
    assert "data:image/png" in (folder / "index.html").read_text()


def test_too_small_a_sweep_is_refused():
    with pytest.raises(ValueError, match="n_emitted should be at least 1000"):
        TradeoffRequest(10)
    with pytest.raises(ValueError, match="methods should be one of standard"):
        TradeoffRequest(methods=("relaxation",))
