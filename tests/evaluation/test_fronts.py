"""Times of methods by error in one table, and the references they are measured against."""

from dataclasses import replace

import numpy as np
import pytest
from bench.studies import fronts, settings
from bench.studies.presets import presets

from photonrelax.evaluation.reference import uncertainty_of
from photonrelax.evaluation.tradeoff import Point, Tradeoff
from photonrelax.imaging.metrics import Errors
from photonrelax.rendering.presets import Choice, preset_data


def point(seconds, error, method):
    errors = Errors(error, error, 0.0, 1.0, 0.0)
    return Point(Choice(method, 1), 1, {"cast": seconds}, 3.0 * seconds, float("nan"), errors)


POINTS = (
    point(1.0, 0.2, "standard"),
    point(4.0, 0.05, "standard"),
    point(3.0, 0.04, "envelope"),
    point(9.0, 0.008, "parameterised"),
)


def sweep(doubt):
    return Tradeoff({"scene": "ring"}, POINTS, "a reference", doubt)


def cells(text):
    rows = [line for line in text.splitlines() if line.startswith("| ring")]
    return [[cell.strip() for cell in row.strip("|").split("|")] for row in rows]


def test_the_table_has_the_best_method_and_those_told():
    rows = cells(fronts.markdown([sweep(0.001)]))
    assert [row[1] for row in rows] == ["10%", "5%", "2%", "1%"]
    # Half way between the points of `standard`, in logarithms.
    assert rows[0] == ["ring", "10%", "0.10%", "standard", "2.00", "9.00", "2.00", "–"]
    assert rows[1] == ["ring", "5%", "0.10%", "envelope", "3.00", "9.00", "4.00", "–"]
    assert rows[3] == ["ring", "1%", "0.10%", "parameterised", "9.00", "9.00", "–", "–"]


@pytest.mark.parametrize(("doubt", "n"), [(0.001, 4), (0.01, 2), (0.04, 0), (float("nan"), 0)])
def test_errors_are_told_only_above_three_times_the_doubt(doubt, n):
    assert len(cells(fronts.markdown([sweep(doubt)]))) == n


@pytest.mark.parametrize(
    ("doubt", "cells_of_one"),
    [
        (0.001, ["standard 2.00", "envelope 3.00", "parameterised 9.00", "parameterised 9.00"]),
        (0.01, ["standard 2.00", "envelope 3.00", "", ""]),
    ],
)
def test_errors_of_a_scene_are_beside_one_another(doubt, cells_of_one):
    (row,) = cells(fronts.by_scene([sweep(doubt)]))
    assert row[1:5] == cells_of_one
    n = sum(cell != "" for cell in cells_of_one)
    assert row[5] == " / ".join(["9.00"] * n)
    assert row[6] == " / ".join(["2.00", "4.00", "–", "–"][:n])


def test_times_may_be_those_of_processors():
    assert cells(fronts.markdown([sweep(0.001)], is_cpu=True))[0][4] == "6.00"


@pytest.fixture(scope="module")
def study(tmp_path_factory):
    folder = tmp_path_factory.mktemp("fronts")
    sizes = {"counts": 2, "counted": 20_000, "reference_error": 0.05, "n_emitted": 3000}
    return fronts.Study(folder, ("ring",), ("mapped", "envelope"), pixels=16, **sizes)


@pytest.fixture(scope="module")
def found(study, ring):
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(fronts.gallery, "scene", lambda name: ring)
        return fronts.swept("ring", study)


def test_a_scene_is_swept_against_an_envelope(found, study, ring, monkeypatch):
    assert {each.choice.method for each in found.points} == {"mapped", "envelope"}
    assert found.reference.startswith("an envelope of error 0.05, checked by counts")
    assert 0.0 < found.doubt < 0.3
    # What is there is read again.
    monkeypatch.setattr(fronts, "reference", None)
    monkeypatch.setattr(fronts.gallery, "scene", lambda name: ring)
    assert fronts.swept("ring", study).points == found.points


def test_counts_are_the_reference_where_envelopes_are_left_to_photons(ring, study, monkeypatch):
    monkeypatch.setattr(fronts, "_envelope", lambda scene, study: None)
    image = fronts.reference(ring, replace(study, counted=2000))
    doubt = uncertainty_of(image)
    assert image.metadata["photonrelax.reference"] == "counts of 2 x 2,000 photons"
    assert doubt.noise_l1 > 0.0
    assert np.asarray(image.layers["caustic"]).any()


def test_settings_of_relaxations_are_measured_once(study, ring, monkeypatch):
    monkeypatch.setattr(fronts.gallery, "scene", lambda name: ring)
    some = settings.Study(study, (1000,), ("halton",))
    text = settings.markdown(some)
    rows = cells(text)
    assert [row[:3] for row in rows] == [["ring", "halton", "1,000"]] * len(settings.PAPER)
    assert all(0.0 < float(row[3]) < 1.0 for row in rows)
    monkeypatch.setattr(settings, "prepare", None)
    assert settings.markdown(some) == text


def test_presets_follow_from_the_sweeps(found, study):
    data = presets([study.folder / "ring"])
    assert data.keys() == preset_data().keys()
    assert data["measured_on"] == {"sharp": ["ring"], "extended": []}
    times = [each.cpu_seconds for each in found.of("envelope")]
    assert data["envelopes"]["sharp"] == pytest.approx(min(times), abs=1e-3)
    assert data["presets"]["sharp"]["draft"].keys() == {"mapped"}
