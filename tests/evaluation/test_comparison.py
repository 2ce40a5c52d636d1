"""Comparisons: the same photons for every method, honest errors, whole files."""

import json
from dataclasses import replace

import numpy as np
import pytest
from PIL import Image as PILImage

import photonrelax as pr
from photonrelax import gallery
from photonrelax.estimation.field import PhotonField
from photonrelax.estimation.methods import Settings
from photonrelax.evaluation import (
    COMPARED_METHODS,
    ComparisonRequest,
    PhotonPatternSubject,
    SceneSubject,
    compare,
    reference,
    subject,
)
from photonrelax.evaluation import comparison as comparisons
from photonrelax.evaluation.reference import Reference
from photonrelax.evaluation.report import folder, images
from photonrelax.evaluation.report import table as tables
from photonrelax.evaluation.report.contact_sheet import contact_sheet
from photonrelax.imaging import metrics
from photonrelax.imaging.image import read_exr, srgb
from photonrelax.rendering.view import View

SIZE = 32
N = 10_000
PAIR = ("standard", "parameterised")


def ring():
    return gallery.scene("ring", pixels=SIZE, sections=128)


class Exact(PhotonField):
    """A field without error."""

    def __init__(self, photons, pattern):
        self.photons, self.seconds, self.used, self._pattern = photons, {}, {}, pattern
        self._n_threads = 1

    def _lay_out(self, values, part):
        return values

    def _fill(self, out, values, points):
        out[points.rows] = self._pattern.irradiance(points.queries[points.rows])[:, :1]


@pytest.fixture(scope="module")
def reference_image():
    """An image of the scene from other and more photons."""
    return pr.render(ring(), method="standard", n_emitted=20 * N, seed=1, supersampling=1)


@pytest.fixture(scope="module")
def comparison_request():
    return ComparisonRequest(
        subject=SceneSubject(ring()), methods=PAIR, n_emitted=N, supersampling=1
    )


@pytest.fixture(scope="module")
def comparison(comparison_request, reference_image):
    return compare(comparison_request, reference_image)


@pytest.fixture(scope="module")
def written(comparison, tmp_path_factory):
    path = tmp_path_factory.mktemp("comparison")
    folder.write(comparison, path)
    return path


def test_every_method_makes_the_image_that_render_makes(comparison):
    for entry in comparison.entries:
        image = pr.render(ring(), method=entry.method, n_emitted=N, supersampling=1)
        for name in ("radiance", "caustic", "direct", "N", "Z"):
            np.testing.assert_array_equal(entry.image.layers[name], image.layers[name])
        assert (entry.n_emitted, entry.n_stored) == (N, image.stats["stages"]["trace"]["stored"])


def test_photons_and_camera_rays_are_traced_once(comparison_request, reference_image, monkeypatch):
    calls = []
    for owner, name in ((subject, "trace_photons"), (View, "bands")):
        work = getattr(owner, name)
        monkeypatch.setattr(
            owner,
            name,
            lambda *a, _name=name, _work=work, **k: calls.append(_name) or _work(*a, **k),
        )
    compare(comparison_request, reference_image)
    assert calls == ["trace_photons", "bands"]


def test_errors_are_those_of_the_layers(comparison, reference_image):
    for entry in comparison.entries:
        layers, errors = entry.image.layers, entry.errors
        caustics = layers["caustic"], reference_image.layers["caustic"]
        assert errors.relative_l1 == metrics.relative_l1(*caustics) > 0.0
        assert errors.relative_l2 == metrics.relative_l2(*caustics)
        assert errors.energy_bias == metrics.energy_bias(*caustics)
        shown = srgb(layers["radiance"]), srgb(reference_image.layers["radiance"])
        assert errors.ssim == metrics.ssim(*shown)
        assert errors.flip == metrics.flip_map(*shown).mean() == layers["flip"].mean()
        np.testing.assert_array_equal(
            layers["difference"], layers["radiance"] - reference_image.layers["radiance"]
        )


def test_an_image_has_no_error_against_itself(comparison_request):
    itself = pr.render(ring(), method="standard", n_emitted=N, supersampling=1)
    entry, other = compare(comparison_request, itself).entries
    assert entry.errors == metrics.Errors(0.0, 0.0, 0.0, 1.0, 0.0)
    assert other.errors.relative_l1 > 0.0


def test_direct_light_is_taken_off_a_reference_that_is_one_image(
    comparison_request, reference_image, comparison
):
    bare = compare(comparison_request, pr.Image({"radiance": reference_image.layers["radiance"]}))
    for entry, expected in zip(bare.entries, comparison.entries, strict=True):
        assert entry.errors.relative_l1 == pytest.approx(expected.errors.relative_l1, rel=1e-9)


def test_exposure_changes_what_is_seen_and_nothing_else(
    comparison_request, reference_image, comparison
):
    dark = compare(replace(comparison_request, exposure=-3.0), reference_image)
    for entry, expected in zip(dark.entries, comparison.entries, strict=True):
        assert entry.errors.relative_l2 == expected.errors.relative_l2
        assert entry.errors.flip != expected.errors.flip


def test_methods_are_those_of_sj13(comparison_request):
    assert ComparisonRequest(subject=SceneSubject(ring())).methods == COMPARED_METHODS
    assert replace(comparison_request, methods=("standard", "standard")).methods == ("standard",)
    with pytest.raises(ValueError, match="method should be one of"):
        replace(comparison_request, methods=("magic",))


def test_settings_and_sampler_reach_their_stages(comparison_request, reference_image):
    settings = Settings(gather=pr.GatherSettings(k=20), relax=pr.RelaxSettings((1, 0)))
    made = compare(
        replace(comparison_request, settings=settings, sampler="random"), reference_image
    )
    assert made.entries[1].settings["relax"]["n_iterations"] == (1, 0)
    assert [entry.settings["gather"]["k"] for entry in made.entries] == [20, 20]
    photons = pr.trace_photons(ring(), N, sampler="random")
    assert made.entries[0].n_stored == len(photons)


def test_photons_without_a_scene_are_measured_against_their_exact_irradiance(tmp_path):
    comparison_request = ComparisonRequest(
        subject=PhotonPatternSubject("shapes", (40, 30)), n_emitted=4000, methods=PAIR
    )
    exact = reference.cached_reference(tmp_path / "none.exr", comparison_request)
    known = gallery.pattern("shapes")
    expected = known.image(lambda points, _: known.irradiance(points), 40, 30, 2) / np.pi
    np.testing.assert_array_equal(exact.layers["radiance"], expected)
    made = compare(comparison_request, exact)
    assert made.reference.description == "exact irradiance at the same points"
    photons = gallery.pattern("shapes", n=4000, sampler="halton").photons
    seen = gallery.pattern("shapes").image(
        pr.irradiance_field(photons, method="parameterised"), 40, 30, 2
    )
    layers = made.entries[1].image.layers
    np.testing.assert_allclose(layers["radiance"], seen / np.pi, rtol=1e-12)
    assert made.entries[1].errors.relative_l1 == metrics.relative_l1(seen / np.pi, expected)


def test_the_exact_irradiance_of_shapes_has_no_error(tmp_path, monkeypatch):
    """Means over the area of these pixels would make it 10 %.."""
    comparison_request = ComparisonRequest(
        subject=PhotonPatternSubject("shapes", (40, 30)), n_emitted=99, methods=PAIR[:1]
    )
    known = gallery.pattern("shapes")
    monkeypatch.setattr(comparisons, "prepare", lambda method, task: Exact(task.photons, known))
    (entry,) = compare(
        comparison_request, reference.cached_reference(tmp_path / "none.exr", comparison_request)
    ).entries
    assert entry.errors == metrics.Errors(0.0, 0.0, 0.0, 1.0, 0.0)


# --- what is written ------------------------------------------------------------------------------


def test_the_folder_holds_what_is_promised(written):
    kinds = [f"{method}{end}" for method in PAIR
             for end in (".exr", ".png", "-flip.png", "-difference.png")]  # fmt: skip
    photons = ["parameter-space.png", "path-edges.png", "constraints.png"]
    others = ["reference.png", "sheet.png", "comparison.json", "index.html"]
    assert sorted(p.name for p in written.iterdir()) == sorted([*kinds, *photons, *others])
    for path in written.glob("*.png"):
        with PILImage.open(path) as image:
            image.load()
            assert path.name == "sheet.png" or image.size == (SIZE, SIZE)


def test_the_contact_sheet_says_whose_photons_were_split_into_passes(
    comparison, tmp_path, monkeypatch
):
    shown = []

    def sheet(groups, title):
        shown.extend(caption for _, caption, _ in groups[0])
        return contact_sheet(groups, title)

    monkeypatch.setattr(folder, "contact_sheet", sheet)
    first, second = comparison.entries
    other = replace(second, name="progressive", method="progressive")
    folder.write(replace(comparison, entries=(first, other)), tmp_path)
    assert shown == ["standard", "progressive, split passes"]


def test_images_are_written_as_they_are(written, comparison):
    for entry in comparison.entries:
        layers = read_exr(written / f"{entry.method}.exr").layers
        np.testing.assert_array_equal(
            layers["radiance"], np.float32(entry.image.layers["radiance"])
        )
        assert {"difference", "flip", "caustic"} <= layers.keys()
        metadata = read_exr(written / f"{entry.name}.exr").metadata
        assert metadata["photonrelax.method"] == entry.method
        assert json.loads(metadata["photonrelax.settings"])["gather"]["k"] == 15
        assert metadata["photonrelax.photons_emitted"] == str(N)
        with PILImage.open(written / f"{entry.method}.png") as shown:
            expected = np.rint(255 * srgb(entry.image.layers["radiance"]))
            np.testing.assert_array_equal(np.asarray(shown), expected)


def test_numbers_are_all_in_one_file(written, comparison):
    numbers = json.loads((written / "comparison.json").read_text())
    assert (numbers["scene"], numbers["n_emitted"], numbers["sampler"]) == ("ring", N, "halton")
    assert list(numbers["methods"]) == list(PAIR)
    for entry in comparison.entries:
        method = numbers["methods"][entry.method]
        assert method["errors"] == entry.errors.to_dict()
        assert method["total_seconds"] == pytest.approx(sum(method["seconds"].values()))
    assert list(numbers["methods"]["parameterised"]["seconds"]) == [
        *("cast", "camera", "structure", "relax", "gather")
    ]


def test_a_folder_used_again_keeps_nothing_of_other_methods(comparison, tmp_path):
    for name in ("diffusion.exr", "diffusion-flip.png", "notes.txt", "reference.exr"):
        (tmp_path / name).write_text("from before")
    folder.write(comparison, tmp_path)
    left = {path.name for path in tmp_path.iterdir()}
    assert {"notes.txt", "reference.exr", "standard.exr", "constraints.png"} <= left
    assert not [name for name in left if name.startswith("diffusion")]


def test_infinite_settings_are_written_as_null(comparison_request, reference_image, tmp_path):
    settings = Settings(gather=pr.GatherSettings(gather_radius=np.inf))
    folder.write(
        compare(
            replace(comparison_request, settings=settings, methods=("standard",)), reference_image
        ),
        tmp_path,
    )
    numbers = json.loads((tmp_path / "comparison.json").read_text())
    assert numbers["methods"]["standard"]["settings"]["gather"]["gather_radius"] is None


def test_the_page_needs_nothing_else(written):
    page = (written / "index.html").read_text()
    assert "http" not in page.replace("http-equiv", "")
    assert page.count("data:image/png;base64,") == 2 * 3 + 1 + 3


def test_nothing_is_written_when_something_fails(comparison, tmp_path, monkeypatch):
    monkeypatch.setattr(folder, "page", lambda *_: 1 / 0)
    with pytest.raises(ZeroDivisionError):
        folder.write(comparison, tmp_path)
    assert list(tmp_path.iterdir()) == []


# --- the images ----------------------------------------------------------------------------------


def test_differences_are_orange_where_too_bright_and_blue_where_too_dark():
    colours = images._signed(np.array([[0.1, 0.0, -0.1]]))[0]
    assert (colours[1] == 0.0).all()
    assert colours[0, 0] > colours[0, 2]
    assert colours[2, 2] > colours[2, 0]


def test_an_image_that_is_too_bright_is_orange_and_one_too_dark_blue(comparison):
    """The difference is the image less the reference, not the reverse."""
    entry = comparison.entries[0]
    for factor, much, little in ((0.5, 0, 2), (2.0, 2, 0)):
        scaled = pr.Image({"radiance": factor * np.asarray(entry.image.layers["radiance"])})
        measured = Reference(scaled, entry.image.layers, exposure=0.0)
        made = images.method_images(replace(comparison, reference=measured))
        colour = made[entry.name]["difference"].astype(float).mean(axis=(0, 1))
        assert colour[much] > colour[little]


def test_colours_that_cancel_are_a_difference_all_the_same():
    found = images._largest(np.array([[[0.2, -0.1, -0.1], [0.1, 0.0, -0.3]]]))
    np.testing.assert_array_equal(found, [[0.2, -0.3]])


def test_path_edges_are_one_more_than_bounces(comparison):
    """Light off a ring once has come along two edges, and a few photons along more."""
    bounces = comparison.photon_layers["photons.bounces"]
    assert np.median(bounces[bounces > 0.0]) == pytest.approx(1.0)
    about = images.photon_images(comparison)["path-edges"].about
    assert "2 (blue) to" in about


def test_constraints_are_those_of_sj13_where_they_are_known(
    comparison_request, reference_image, comparison
):
    def seen(*methods):
        return compare(replace(comparison_request, methods=methods), reference_image).photon_layers

    assert "photons.constraint" not in seen("standard")
    original = seen("standard", "relaxation")["photons.constraint"]
    expected = comparison.photon_layers["photons.constraint"]
    assert not np.array_equal(original, expected)
    found = seen("parameterised", "relaxation")["photons.constraint"]
    np.testing.assert_array_equal(found, expected)


def test_constrained_photons_are_red(comparison):
    red = np.array([[0.0, 1.0]])
    colours = images._constraint_colours(red)[0][0]
    assert np.ptp(colours[0]) == 0.0
    assert colours[1, 0] > 10 * colours[1, 1]


# --- the table ------------------------------------------------------------------------------------


def test_the_table_has_the_rows_of_sj13_and_the_errors(comparison):
    shown = tables.table(comparison)
    assert shown.column_titles == list(PAIR)
    assert [name for name, *_ in shown.rows] == [
        *("photons emitted", "photons absorbed", "photons per estimate", "photon cast"),
        *("feature detection", "relaxation", "render", "total"),
        *("relative L1", "relative L2", "SSIM", "FLIP", "energy bias"),
    ]
    cells = {name: cells for name, cells, _ in shown.rows}
    assert cells["photons emitted"] == ["10,000", "10,000"]
    assert cells["photons per estimate"] == ["15", "15"]
    assert cells["relaxation"][0] == "–"
    assert cells["photon cast"][0] == cells["photon cast"][1]


def test_rows_of_the_table_add_up(comparison):
    for entry in comparison.entries:
        rows = tables.seconds_by_row(entry.seconds)
        assert sum(rows.values()) == pytest.approx(sum(entry.seconds.values()))
        assert rows["photon cast"] == entry.seconds["cast"]
    assert tables.seconds_by_row(comparison.entries[1].seconds)["relaxation"] > 0.0


def test_the_best_is_marked(comparison):
    shown = tables.table(comparison)
    best = {name: best for name, _, best in shown.rows}
    ssim = [entry.errors.ssim for entry in comparison.entries]
    assert best["SSIM"] == int(np.argmax(ssim))
    assert best["total"] == 0
    assert best["photons emitted"] is None


def test_text_lines_up_and_says_what_the_reference_is(comparison):
    lines = tables.table(comparison).text().splitlines()
    assert lines[0].startswith("ring: 10,000 photons emitted (halton, seed 0), 32 x 32 pixels")
    assert len({len(line) for line in lines[1:15]}) == 1
    assert "reference: a given image" in lines
