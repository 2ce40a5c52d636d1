"""References: with estimates of their own errors, cached, resumed; foreign ones refused."""

import json
from dataclasses import replace

import numpy as np
import pytest

import photonrelax as pr
from photonrelax import gallery
from photonrelax.evaluation import ComparisonRequest, SceneSubject, compare, reference
from photonrelax.evaluation.reference import ABOUT, ReferenceSettings
from photonrelax.evaluation.report import table as tables
from photonrelax.rendering.passes import pass_seed

SIZE = 24
SETTINGS = ReferenceSettings(passes=4, photons=5000)


@pytest.fixture(scope="module")
def comparison_request():
    scene = gallery.scene("ring", pixels=SIZE, sections=128)
    return ComparisonRequest(
        subject=SceneSubject(scene), methods=("standard",), n_emitted=5000, supersampling=1
    )


def test_a_reference_is_the_mean_of_two_runs_of_small_discs(comparison_request, tmp_path):
    image = reference.cached_reference(tmp_path / "reference.exr", comparison_request, SETTINGS)
    halves = [
        pr.render_progressive(
            comparison_request.subject.scene,
            n_passes=2,
            photons_per_pass=5000,
            seed=pass_seed(0, half),
            settings=pr.ProgressiveSettings(k=4),
            supersampling=1,
            stochastic=True,
        )
        for half in range(2)
    ]
    expected = sum(half.layers["caustic"] for half in halves) / 2
    np.testing.assert_array_equal(image.layers["caustic"], np.float32(expected))
    about = image.metadata[ABOUT]
    assert about.startswith("progressive photon mapping, two runs of 2 passes of 5,000 photons (")
    assert "its own noise" in about
    assert "its bias about" in about


def test_photons_of_a_reference_are_not_those_compared(comparison_request, tmp_path):
    """So one reference serves any number of photons."""
    path = tmp_path / "reference.exr"
    reference.cached_reference(path, comparison_request, SETTINGS)
    before = path.read_bytes()
    reference.cached_reference(
        path, replace(comparison_request, n_emitted=99, sampler="random"), SETTINGS
    )
    assert path.read_bytes() == before
    assert ReferenceSettings().photons == 1_000_000
    assert ReferenceSettings().k <= 4


def test_noise_and_bias_are_separated():
    """A step is blurred by so much, and by twice as much; noise is independent between runs."""
    rng = np.random.default_rng(0)
    x = np.linspace(-1.0, 1.0, 400)[np.newaxis, :, np.newaxis] * np.ones((300, 1, 3))

    def blurred(width):
        return np.clip(0.5 + x / (2.0 * width), 0.0, 1.0)

    exact = (x > 0.0).astype(float)
    noise = [0.05 * rng.normal(size=x.shape) for _ in range(2)]
    small = [blurred(0.1) + n for n in noise]
    wide = [blurred(0.2) + n + 0.02 * rng.normal(size=x.shape) for n in noise]
    found = reference.estimate_uncertainty(small, wide)
    mean = 0.5 * (small[0] + small[1])
    scale_l1, scale_l2 = np.abs(mean).sum(), np.linalg.norm(mean)
    bias, left = blurred(0.1) - exact, mean - blurred(0.1)
    assert found.noise_l1 == pytest.approx(np.abs(left).sum() / scale_l1, rel=0.02)
    assert found.noise_l2 == pytest.approx(np.linalg.norm(left) / scale_l2, rel=0.02)
    assert found.bias_l1 == pytest.approx(np.abs(bias).sum() / scale_l1, rel=0.2)
    assert found.bias_l2 == pytest.approx(np.linalg.norm(bias) / scale_l2, rel=0.3)
    independent = reference.estimate_uncertainty(
        small, [s + 0.02 * rng.normal(size=x.shape) for s in small]
    )
    assert independent.bias_l1 < 0.05 * found.bias_l1


def test_larger_discs_are_found_to_have_more_bias(comparison_request, tmp_path):
    uncertainties = [
        reference.uncertainty_of(
            reference.cached_reference(
                tmp_path / f"{k}.exr", comparison_request, replace(SETTINGS, k=k)
            )
        )
        for k in (4, 40)
    ]
    assert uncertainties[1].bias_l1 > 2.0 * uncertainties[0].bias_l1
    assert uncertainties[1].noise_l1 < uncertainties[0].noise_l1


def test_a_reference_is_computed_once_and_kept(comparison_request, tmp_path, monkeypatch):
    path = tmp_path / "reference.exr"
    first = reference.cached_reference(path, comparison_request, SETTINGS)
    assert [p.name for p in tmp_path.iterdir()] == ["reference.exr"]
    monkeypatch.setattr(reference, "_computed", None)
    again = reference.cached_reference(path, comparison_request, SETTINGS)
    assert again.layers["caustic"].tobytes() == first.layers["caustic"].tobytes()


@pytest.mark.parametrize("change", [{"photons": 4000}, {"k": 5}, {"seed": 1}, {"passes": 3}])
def test_a_reference_of_something_else_is_replaced(
    change, comparison_request, tmp_path, monkeypatch
):
    path = tmp_path / "reference.exr"
    few = replace(SETTINGS, passes=1)
    reference.cached_reference(path, comparison_request, few)
    calls = []
    computed = reference._computed
    monkeypatch.setattr(reference, "_computed", lambda *a: calls.append(a) or computed(*a))
    for _ in range(2):
        reference.cached_reference(path, comparison_request, replace(few, **change))
    assert len(calls) == 1


@pytest.mark.parametrize("foreign", ["text", "image"])
def test_what_was_not_computed_here_is_not_replaced(foreign, comparison_request, tmp_path):
    path = tmp_path / "reference.exr"
    if foreign == "text":
        path.write_text("not an image")
    else:
        pr.Image({"radiance": np.ones((SIZE, SIZE, 3))}).write_exr(path)
    before = path.read_bytes()
    with pytest.raises(ValueError, match="should be a reference that was computed here"):
        reference.cached_reference(path, comparison_request, SETTINGS)
    assert path.read_bytes() == before


def test_a_reference_that_was_stopped_is_gone_on_with(comparison_request, tmp_path):
    straight = reference.cached_reference(tmp_path / "straight.exr", comparison_request, SETTINGS)
    path, seen = tmp_path / "stopped.exr", []

    def stop(stage, done, total):
        seen.append((stage, done))
        if "run 2" in stage and done == 1:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        reference.cached_reference(path, comparison_request, SETTINGS, stop)
    assert not path.exists()
    again = []
    resumed = reference.cached_reference(
        path, comparison_request, SETTINGS, lambda *progress: again.append(progress[:2])
    )
    assert again[0][1] == 2
    assert "run 2" in again[0][0]
    for name, layer in straight.layers.items():
        np.testing.assert_array_equal(resumed.layers[name], layer)
    assert sorted(p.name for p in tmp_path.iterdir()) == ["stopped.exr", "straight.exr"]


def test_the_run_is_the_last_column_of_the_table(comparison_request, tmp_path):
    computed = reference.cached_reference(tmp_path / "reference.exr", comparison_request, SETTINGS)
    shown = tables.table(
        compare(replace(comparison_request, methods=("standard", "progressive")), computed)
    )
    assert shown.column_titles == ["standard", "progressive, split passes", "reference"]
    cells = {name: cells[-1] for name, cells, _ in shown.rows}
    cost = json.loads(computed.metadata["photonrelax.reference_cost"])
    assert cells["photons emitted"] == "20,000"
    assert cells["photons absorbed"] == f"{cost['stored']:,}"
    assert cells["total"] == f"{cost['seconds']:.2f} s"
    assert cells["SSIM"] == "–"
    assert any(note.startswith("split passes: ") for note in shown.notes)


# --- references given ----------------------------------------------------------------------------

GIVEN = np.ones((SIZE, SIZE, 3))
DARK, BROKEN = 0.0 * GIVEN, GIVEN.copy()
BROKEN[3, 4, 1] = np.nan


@pytest.mark.parametrize(
    ("layers", "complaint"),
    [
        ({"Z": np.ones((SIZE, SIZE))}, "should have channels R, G and B"),
        ({"radiance": np.ones((SIZE, SIZE + 1, 3))}, "should have 24 x 24 pixels"),
        ({"radiance": GIVEN, "caustic": np.ones((SIZE, SIZE))}, "three channels of caustic"),
        ({"radiance": BROKEN}, "should be finite, but 1 pixels of radiance are not"),
        ({"radiance": GIVEN, "caustic": BROKEN}, "1 pixels of caustic are not"),
        ({"radiance": DARK}, "should not be black"),
    ],
)
def test_a_reference_that_cannot_be_measured_against_is_refused_before_the_work(
    layers, complaint, comparison_request, monkeypatch
):
    monkeypatch.setattr(SceneSubject, "photons", None)
    with pytest.raises(ValueError, match=complaint):
        compare(comparison_request, pr.Image(layers))
