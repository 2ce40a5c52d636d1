"""Requests of comparisons: wrong ones are refused before the work; times are those of stages."""

from dataclasses import replace
from itertools import count

import numpy as np
import pytest

import photonrelax as pr
from photonrelax import gallery
from photonrelax.estimation.methods import Settings
from photonrelax.evaluation import (
    ComparisonRequest,
    PhotonPatternSubject,
    SceneSubject,
    compare,
    comparison,
    gallery_subject,
)
from photonrelax.evaluation.report import table as tables

SIZE = 16
N = 3000


@pytest.fixture(scope="module")
def subject():
    return SceneSubject(gallery.scene("ring", pixels=SIZE, sections=128))


@pytest.fixture(scope="module")
def reference_image(subject):
    return pr.render(subject.scene, method="standard", n_emitted=10 * N, seed=1, supersampling=1)


@pytest.fixture
def comparison_request(subject):
    return ComparisonRequest(subject=subject, methods=("standard",), n_emitted=N, supersampling=1)


@pytest.mark.parametrize(
    ("change", "complaint"),
    [
        ({"subject": PhotonPatternSubject("shapes", (10, 40))}, "at least 11 x 11 pixels"),
        ({"seed": 2**64}, "seed should be below"),
        ({"seed": -1}, "seed should be at least 0"),
        ({"sampler": "sobol"}, "sampler should be one of halton, random"),
        ({"rounds": 0}, "rounds should be at least 1"),
        (
            {"subject": PhotonPatternSubject("shapes"), "methods": ("frequency",)},
            "photons that were not traced carry no spectra",
        ),
        ({"variants": {"mine": ("magic", Settings())}}, "method should be one of"),
    ],
)
def test_what_cannot_be_compared_is_refused_before_the_work(change, complaint, comparison_request):
    with pytest.raises(ValueError, match=complaint):
        replace(comparison_request, **change)


class Clock:
    """A clock that advances where a test makes it, and nowhere else."""

    def __init__(self, monkeypatch):
        self.now = 0.0
        monkeypatch.setattr(comparison, "perf_counter", lambda: self.now)

    def slow(self, monkeypatch, seconds_of):
        photons = SceneSubject.photons

        def cast(subject, *a, frequency_share, **k):
            self.now += seconds_of(frequency_share)
            return photons(subject, *a, frequency_share=frequency_share, **k)

        monkeypatch.setattr(SceneSubject, "photons", cast)


def test_spectra_are_paid_for_by_the_method_that_needs_them(
    comparison_request, reference_image, monkeypatch
):
    clock = Clock(monkeypatch)
    clock.slow(monkeypatch, lambda share: 10.0 if share > 0.0 else 2.0)
    comparison_request = replace(comparison_request, methods=("standard", "frequency"))
    standard, frequency = compare(comparison_request, reference_image).entries
    assert standard.seconds["cast"] == frequency.seconds["cast"] == 2.0
    assert "spectra" not in standard.seconds
    assert frequency.seconds["spectra"] == 8.0
    assert tables.seconds_by_row(frequency.seconds)["photon cast"] == 10.0


def test_camera_rays_count_in_every_total(comparison_request, reference_image, monkeypatch):
    view, turns = SceneSubject.view, count()

    def slow(*a, **k):
        return replace(view(*a, **k), seconds=(500.0, 300.0, 100.0)[next(turns)])

    monkeypatch.setattr(SceneSubject, "view", slow)
    made = compare(
        replace(comparison_request, methods=("standard", "diffusion"), rounds=3), reference_image
    )
    rows = {name: cells for name, cells, _ in tables.table(made).rows}
    for entry, total in zip(made.entries, rows["total"], strict=True):
        assert entry.seconds["camera"] == 300.0
        assert tables.seconds_by_row(entry.seconds)["render"] >= 300.0
        assert float(total.removesuffix(" s")) >= 300.0


def test_preparing_that_no_stage_claims_is_part_of_gathering(
    comparison_request, reference_image, monkeypatch
):
    clock, prepare = Clock(monkeypatch), comparison.prepare

    def slow(method, task):
        clock.now += 5.0
        field = prepare(method, task)
        field.seconds = {"structure": 2.0}
        return field

    monkeypatch.setattr(comparison, "prepare", slow)
    (entry,) = compare(comparison_request, reference_image).entries
    assert entry.seconds["structure"] == 2.0
    assert entry.seconds["gather"] == 3.0


def test_times_are_medians_of_rounds(comparison_request, reference_image, monkeypatch):
    clock, turns = Clock(monkeypatch), count()
    clock.slow(monkeypatch, lambda share: (9.0, 2.0, 1.0)[next(turns)])
    (entry,) = compare(replace(comparison_request, rounds=3), reference_image).entries
    assert entry.seconds["cast"] == 2.0


def test_methods_take_turns(comparison_request, reference_image, monkeypatch):
    prepared, prepare = [], comparison.prepare
    monkeypatch.setattr(comparison, "prepare", lambda m, t: prepared.append(m) or prepare(m, t))
    comparison_request = replace(comparison_request, methods=("relaxation", "diffusion"), rounds=2)
    compare(comparison_request, reference_image)
    assert prepared[1:] == 2 * ["relaxation", "diffusion"]


def test_variants_are_columns_of_their_own(comparison_request, reference_image):
    wide = Settings(gather=pr.GatherSettings(k=50))
    one, other = compare(
        replace(comparison_request, variants={"K = 50": ("standard", wide)}), reference_image
    ).entries
    assert (one.name, one.method, other.name, other.method) == (
        *("standard", "standard"),
        *("K = 50", "standard"),
    )
    alone = compare(replace(comparison_request, settings=wide), reference_image).entries[0]
    assert other.errors == alone.errors != one.errors


def test_a_distribution_is_seen_band_by_band(monkeypatch):
    monkeypatch.setattr("photonrelax.evaluation.subject._POINTS_PER_BAND", 300)
    subject = PhotonPatternSubject("shapes", (20, 30))
    view = subject.view(2, 8, n_threads=None, progress=None)
    assert [len(band.rows) for band in view.bands] == 10 * [3]
    known = gallery.pattern("shapes")

    def field(points, normals):
        return known.irradiance(points)

    np.testing.assert_array_equal(view.caustic(field, None), subject.exact(2))


def test_known_light_is_measured_against_where_it_is_known():
    subject = gallery_subject("ring", 32, 32)
    comparison_request = ComparisonRequest(subject=subject, methods=("standard",), n_emitted=20_000)
    reference_image = pr.render(subject.scene, method="standard", n_emitted=100_000, seed=1)
    made = compare(comparison_request, reference_image)
    (entry,) = made.entries
    assert 0.1 < made.reference.analytic_share < 0.9
    assert (
        made.reference.analytic_errors["relative_l1"] < entry.analytic_errors["relative_l1"] < 0.3
    )
    view = subject.view(2, 8, n_threads=None, progress=None)
    known = subject.analytic_pixels(view)
    pixels = entry.image.layers["caustic"][known.where], known.caustic[known.where]
    assert entry.analytic_errors["energy_bias"] == pixels[0].sum() / pixels[1].sum() - 1.0
    rows = {name: cells for name, cells, _ in tables.table(made).rows}
    assert rows["relative L1, analytic"] == [f"{entry.analytic_errors['relative_l1']:.2%}"]
    other = compare(
        replace(comparison_request, subject=SceneSubject(subject.scene)), reference_image
    )
    assert other.entries[0].analytic_errors == {}
    assert other.entries[0].errors == entry.errors
