"""Inputs, recipes, timing and tables of the benchmarks."""

import argparse
import os
import sys
from functools import cache, partial
from pathlib import Path

import numpy as np
import pytest
from bench.speed import contention, inputs, peers, plot, report, stages, versions, workbench
from bench.speed.checks import assert_nearest, assert_nearest_in_range
from bench.speed.timing import Case, Timing, interleave
from bench.studies import (
    dispersion,
    envelope,
    envelope_cost,
    envelope_times,
    equal_error,
    figure3,
    figure7,
    frequency,
    initial_radius,
    methods,
    pixel_means,
    promises,
    refinements,
    resolution,
    shapes,
    slopes,
    table1,
)

import photonrelax as pr
from photonrelax import gallery
from photonrelax.estimation.methods import PHOTON_METHODS
from photonrelax.evaluation import gallery_subject
from photonrelax.evaluation.reference import ReferenceSettings

K = 7


@cache
def coarse_scene(pixels=600):
    return gallery.scene("prism", pixels=pixels, subdivisions=4)


@pytest.fixture(autouse=True)
def scene_built_in_no_time(monkeypatch):
    monkeypatch.setattr(inputs, "scene", coarse_scene)


@pytest.fixture
def photons():
    """Two sheets over one another in space, apart on the emitter, dense at their start."""
    coords = np.random.default_rng(1).random((600, 2)) ** 2
    position = np.column_stack([coords % 0.5, np.zeros(600)])
    return inputs.RangedPhotons(position, coords, np.full(600, 0.1))


def brute_force(photons, k):
    """The definition: sorted distances to those in range, infinite where there is none."""
    apart = np.linalg.norm(photons.coords[:, None] - photons.coords, axis=2)
    distance = np.linalg.norm(photons.position[:, None] - photons.position, axis=2)
    distance[apart > photons.radius[:, None]] = np.inf
    return np.sort(distance, axis=1)[:, :k]


@pytest.mark.parametrize("recipe", peers.RECIPES.values(), ids=peers.RECIPES)
@pytest.mark.parametrize("n_threads", [1, 2])
def test_recipes_are_exact(photons, recipe, n_threads):
    expected = brute_force(photons, K)
    ids, distance = recipe(photons, K, n_threads)
    assert np.isinf(expected).any()
    assert np.isfinite(expected[:, -1]).any()
    np.testing.assert_allclose(distance, expected, rtol=1e-12)
    np.testing.assert_array_equal(ids == len(expected), np.isinf(expected))
    assert_nearest_in_range((ids, distance), photons, K)


def test_a_neighbour_out_of_range_is_noticed(photons):
    ids, distance = peers.constrained_by_block(photons, K)
    ids[0, -1] = np.linalg.norm(photons.coords - photons.coords[0], axis=1).argmax()
    with pytest.raises(AssertionError):
        assert_nearest_in_range((ids, distance), photons, K)


@pytest.mark.parametrize("name", [peer.name for peer in peers.ALL])
def test_peers_find_neighbours_of_points_and_of_queries(name):
    if name in peers.missing():
        pytest.skip(peers.missing()[name])
    rng = np.random.default_rng(2)
    points, queries = rng.random((500, 3)), rng.random((300, 3))
    tree = peers.Ordered(peers.named(name), points)
    assert_nearest(tree.answers(tree.search(K, 1), np.arange(500)), points, points)
    tree = peers.Ordered(peers.named(name), points, queries)
    rows = np.arange(0, 300, 2)
    assert_nearest(tree.answers(tree.search(K, 1, 0.1), rows), points, queries[rows], 0.1)


def test_morton_order_follows_the_curve():
    cells = np.stack(np.meshgrid(range(4), range(4), range(4), indexing="ij"), axis=-1)
    points = cells.reshape(-1, 3).astype(float)
    # The bits of x, y, z in turn, x lowest, are the place on the curve.
    bits = points.astype(int)
    place = sum(((bits[:, a] >> b) & 1) << (3 * b + a) for a in range(3) for b in range(2))
    np.testing.assert_array_equal(place[inputs.morton_order(points)], np.arange(64))


def test_the_chart_keeps_areas():
    """A cap of height h about any axis near the middle has the area 2 π h of the sphere."""
    rng = np.random.default_rng(3)
    directions = rng.normal(size=(200_000, 3))
    directions /= np.linalg.norm(directions, axis=1)[:, None]
    chart = inputs.equal_area_chart(directions[directions[:, 2] > 0.0])
    inside = (np.linalg.norm(chart, axis=1) < 0.5).mean()
    assert inside == pytest.approx(0.5**2 / 2.0, rel=0.02)


def test_photons_side_by_side_follow_each_other_in_the_best_order():
    emitted = inputs.caustic(3000)
    ordered = inputs.in_morton_order(emitted)
    steps = [np.linalg.norm(np.diff(p.position, axis=0), axis=1).mean() for p in (emitted, ordered)]
    assert steps[1] < 0.2 * steps[0]
    for array in ("position", "emitter_coords"):
        both = (np.sort(getattr(photons, array), axis=0) for photons in (emitted, ordered))
        np.testing.assert_array_equal(*both)


def test_the_lattice_is_four_sheets_that_fall_on_the_same_points():
    photons = inputs.degenerate("lattice", 4 * 30**2)
    points, counts = np.unique(photons.position, axis=0, return_counts=True)
    assert len(points) == 30**2
    assert (counts == 4).all()
    np.testing.assert_allclose(np.linalg.norm(photons.emitter_coords, axis=1), 1.0, rtol=1e-12)
    # Whoever left the emitter next to a photon, one of the 450 in its range, is next to it.
    found = pr.detect_structure(photons)
    assert (found.n_found == 50).all()
    assert np.median(found.radius) == pytest.approx(np.sqrt(50 / np.pi) / 60, rel=0.05)


def test_photons_stay_beside_those_of_their_sheet_when_rounded():
    photons, generic = (inputs.degenerate(kind, 5000) for kind in ("rounded", "generic"))
    assert np.median(np.unique(photons.position, axis=0, return_counts=True)[1]) < 50
    moved = np.linalg.norm(photons.position - generic.position, axis=1)
    reach = pr.KDTree(generic.position).farthest(50)
    assert 0.0 < np.median(moved) < 0.3 * np.median(reach)


def test_structure_is_the_same_with_trees_built_before(monkeypatch):
    photons = inputs.in_morton_order(inputs.caustic(3000))
    expected = pr.detect_structure(photons)
    detect = stages.with_trees_built(photons, 1)
    monkeypatch.setattr("photonrelax.spatial.kdtree.KDTree.__init__", None)
    for found in (detect(), detect()):
        for name in ("constraint", "basis", "radius", "n_found", "reach"):
            np.testing.assert_array_equal(getattr(found, name), getattr(expected, name))


def test_cases_take_turns_and_are_checked_once():
    calls, checked = [], []
    cases = {
        "a": Case(lambda x: calls.append(x), prepare=lambda: "a", check=checked.append),
        "b": Case(lambda _: calls.append("b"), rounds=1),
    }
    timings = interleave(cases, 3)
    assert calls == ["a", "b", "a", "a"]
    assert len(checked) == 1
    assert [len(timings[name].wall) for name in "ab"] == [3, 1]


def test_cases_of_a_workbench_are_those_of_its_tasks_and_of_the_peers_at_hand():
    bench = workbench.Workbench(inputs.caustic(2_000), 1, 8)
    cases = bench.cases(["constrained 6", "gather"])
    found = [f"{peer.name}: gather" for peer in peers.available()]
    recipes = [f"{recipe}: constrained 6" for recipe in peers.RECIPES]
    assert list(cases) == ["constrained 6", *recipes, "gather", *found]
    bench.n = 10**7
    with pytest.raises(peers.UnavailableError, match="ball recipe"):
        bench.case("constrained 6", "ball recipe")


def test_iterations_are_separated_from_the_tree_they_share():
    tasks = ["1 collapsed", "8 collapsed"]
    results = workbench.Workbench(inputs.caustic(2_000), 1, 8).measured(tasks, 2)
    assert list(results) == ["collapsed iteration"]
    assert len(results["collapsed iteration"].wall) == 2


def test_builds_are_compared_on_the_same_inputs(tmp_path):
    """A build compared with itself, as no other is at hand."""
    versions.save_inputs(tmp_path, 2_000, 8)
    python, arguments = Path(sys.executable), [str(tmp_path), "1", "8"]
    tasks = ("build", "gather", "neighbours 15")
    with (
        versions.worker(python, arguments, dict(os.environ)) as one,
        versions.worker(python, arguments, dict(os.environ)) as other,
    ):
        timings = {task: versions.compared(task, (one, other), 2) for task in tasks}
    assert all(len(timing.wall) == 2 for both in timings.values() for timing in both)
    lines = versions.markdown("2,000 photons", timings | {"trace": None}).splitlines()
    assert [line.split(" | ")[0] for line in lines[2:6]] == [*(f"| {task}" for task in tasks), ""]


def test_stages_are_timed_beside_busy_processes(capsys):
    tasks = ("build", "gather")
    contention.run(argparse.Namespace(photons=2e3, threads=2, rounds=1, pixels=8, tasks=tasks))
    lines = capsys.readouterr().out.splitlines()
    assert [line.split(" | ")[0] for line in lines[2:5]] == [*(f"| {task}" for task in tasks), ""]


def test_a_task_that_a_build_cannot_do_is_left_out(monkeypatch, capsys):
    def unavailable(build, task):
        raise peers.UnavailableError("no module")

    monkeypatch.setattr(versions, "_once", unavailable)
    assert versions.compared("emission", (None, None), 2) is None
    assert "left out: no module" in capsys.readouterr().err


def test_tables_show_medians_the_fastest_peer_and_nothing_unmeasured():
    one = {
        "neighbours 50": Timing([1.0, 2.0, 9.0], [1.0, 1.0, 1.0]),
        "slow: neighbours 50": Timing([50.0], [50.0]),
        "fast: neighbours 50": Timing([30.0], [20.0]),
        "constrained 6": Timing([3.0], [3.0]),
    }
    two = one | {"neighbours 50": Timing([1.0], [2.0])}
    text = report.Report(863_000, 3, "here", {1: one, 2: two}).markdown()
    assert "| 863,000 photons of a caustic |" in text
    assert "| all neighbours, K = 50 | 2 s | fast | 30 s | 15× | 30× |" in text
    assert "| constrained over plain search, 6-D | 1.50 | 3.00 |" in text
    assert "| all neighbours, K = 50 | 2 s | 1 s | 2× |" in text
    assert "5-D" not in text
    assert "embree" not in text
    cpu = report.Report(863_000, 3, "here", {1: one}, clock="cpu").markdown()
    assert "| all neighbours, K = 50 | 1 s | fast | 20 s | 20× |" in cpu


def test_degenerate_photons_are_compared_with_a_caustic():
    times = {"generic: gathering": 2.0, "lattice: gathering": 3.0, "generic: structure": 1.0}
    degenerate = {name: Timing([seconds], [seconds]) for name, seconds in times.items()}
    text = report.Report(863_000, 1, "here", degenerate=degenerate).markdown()
    assert "| time over a caustic's | coincident | collinear | lattice | rounded |" in text
    assert "| gathering | | | 1.50 | |" in text


def test_table_1_has_a_row_a_stage(capsys):
    text = table1.markdown(20_000, 3_000, 1)
    assert [line.split(" | ")[0][2:] for line in text.splitlines()[2:9]] == list(table1.PAPER)
    assert "| photons emitted | 20,000,000 | 20,000 | 9,677 |" in text
    stages = [line.split(":")[0] for line in capsys.readouterr().err.splitlines()]
    assert stages == 2 * ["... trace", "... structure", "... relax", "... render"]


def test_table_1_has_a_column_for_every_method(monkeypatch):
    """On a scene that is built in no time."""
    ring = gallery.scene("ring", pixels=16, sections=64)
    monkeypatch.setattr(inputs, "scene", lambda pixels: ring)
    lines = table1.every_method(300, 1, 1).splitlines()
    assert lines[0].endswith(" | ".join(["", *table1.PAPER_OF, ""]).strip().removeprefix("| "))
    cells = {row.split(" | ")[0][2:]: row.split(" | ")[1:] for row in lines[2:9]}
    assert list(cells) == list(table1.PAPER)
    assert cells["photons emitted"][-1].endswith("(4,600,000,000) |")
    assert [cell.startswith("–") for cell in cells["relaxation"]] == [
        True,
        False,
        True,
        False,
        True,
    ]
    assert [cell.startswith("–") for cell in cells["structure (feature detect)"]] == [
        True,
        False,
        False,
        False,
        True,
    ]
    assert cells["total"][0].endswith("(14.8 s)")


def test_promises_are_told_with_the_method_chosen(monkeypatch):
    ring = gallery.scene("ring", pixels=16, sections=64)
    monkeypatch.setattr(gallery, "scene", lambda name: ring)
    sizes = {"pixels": 16, "reference_error": 0.05, "reference_photons": 5000}
    sizes |= {"counted": ("ring",), "numbers": (3000,)}
    study = promises.Study(("ring",), errors=(0.3,), seeds=2, **sizes)
    ((scene, method, asked, runs, estimate, *_, best, ratio),) = promises.rows(study)
    assert (scene, method, asked, runs) == ("ring", "chosen: mapped", "0.3", "2")
    assert 0.0 < float(estimate) < 0.3
    assert best.split()[0] in ("standard", "parameterised", "mapped")
    assert float(ratio) > 0.0


def test_estimates_of_trials_are_told_beside_true_errors(monkeypatch):
    ring = gallery.scene("ring", pixels=16, sections=64)
    monkeypatch.setattr(gallery, "scene", lambda name: ring)
    sizes = {"pixels": 16, "reference_error": 0.05, "reference_photons": 5000}
    sizes |= {"counted": ("ring",), "trials": (1000, 4000)}
    study = promises.Study(("ring",), seeds=1, **sizes)
    rows = [line.split("|")[1:-1] for line in promises.trials_markdown(study).splitlines()[2:4]]
    assert [row[1].strip() for row in rows] == ["1,000", "4,000"]
    few, many = (float(row[4]) for row in rows)
    assert 0.0 < many < few < 1.0


def test_the_papers_settings_are_told_beside_quicker_ones_with_errors():
    lines = table1.by_settings(300, 2, 1).splitlines()
    cells = [[cell.strip() for cell in line.strip("|").split("|")] for line in lines[:11]]
    assert cells[0] == ["prism", *table1.SETTINGS]
    assert all(float(cell.rstrip("%")) > 0.0 for cell in cells[-1][1:])
    # Fewer iterations and neighbours take other photons nowhere.
    assert len(set(cells[3][1:])) == 1


def test_squared_errors_are_located_in_the_brightest_pixels():
    exact = np.ones((4, 5, 3))
    exact[1, 2], exact[2, 3] = 9.0, 7.0
    found = exact.copy()
    found[1, 2], found[0, 0] = 5.0, 3.0
    text = methods.at_the_brightest(*(pr.Image({"caustic": a}) for a in (found, exact)), 2)
    assert text == "80% of it is in the 2 brightest pixels, which it shows at 75%"


def test_refinements_and_initial_radii_are_measured_against_references(tmp_path, monkeypatch):
    ring = gallery_subject("ring", 16)
    monkeypatch.setattr(initial_radius, "gallery_subject", lambda *_: ring)
    monkeypatch.setattr(initial_radius, "KS", (15, 4))
    monkeypatch.setattr(refinements, "MOST_KS", (30,))
    few = ReferenceSettings(passes=2, photons=1_000)
    cases = (("shapes", 3_000, "random"), ("ring", 3_000, "halton"))
    study = refinements.Study(16, few, tmp_path, cases)
    lines = refinements.markdown(study).splitlines()
    assert [row.split(" | ")[0][2:] for row in lines[2:7]] == [
        *("standard", "differential-checking", "bias-compensation"),
        *("relaxation", "parameterised"),
    ]
    assert ", k = " in lines[2]
    text = initial_radius.markdown(1, 1_000, pixels=16, references=few, folder=tmp_path)
    assert text.count("initial radius of k = ") == 2
    assert "The reference: its own noise" in text
    cases = (("ring", 3_000, "halton"), ("ring", 3_000, "random"))
    text = initial_radius.split(cases, pixels=16, references=few, folder=tmp_path)
    titles, _, *rows = text.splitlines()
    assert [row.split(" | ")[0] for row in rows] == ["| ring, 3,000 halton", "| ring, 3,000 random"]
    assert all(row.count("%") == len(initial_radius.SPLIT) + 2 for row in rows)
    assert titles.count("| k = ") == len(initial_radius.SPLIT)


def test_a_best_at_the_border_of_the_settings_tried_is_marked():
    floor = equal_error.Floor("ring", 1.0, 4)
    estimates = [(f"k = {k}", "standard", pr.GatherSettings(k=k)) for k in (5, 20)]
    run = equal_error.best(floor, np.ones((4, 4)), 300, "random", estimates)
    assert run.settings.endswith("(at the border of those tried)")


def test_lines_kept_at_a_noise_that_is_not_reached_are_not_made_up():
    found = [shapes.Measures(line, noise, 0.0, 0.0) for line, noise in ((0.1, 0.02), (0.5, 0.08))]
    assert shapes.line_at_equal_noise(found, 0.04) == pytest.approx(0.3)
    assert shapes.line_at_equal_noise(found, 0.01) is None
    assert shapes.line_at_equal_noise(found, 0.09) is None


def test_figure_3_has_sets_whose_borders_hold_only_where_sets_are_told_apart():
    sets = figure3.Sets(4000, n_iterations=3)
    outside, within_other, away = sets.constraints(sets.structure)
    assert min(outside, within_other) > away + 0.5
    assert sets.constraints(sets.gradient)[1] < within_other - 0.3
    assert sets.outside(sets.photons) == 0.0
    assert sets.outside(sets.by_gradient) > 2 * sets.outside(sets.together)
    assert sets.unevenness(sets.together) < 0.6 * sets.unevenness(sets.within_sets)


def test_figure_7_has_the_distance_of_the_eigenvalues_from_a_gaussian(tmp_path):
    found = figure7.second_eigenvalues(20_000)
    assert found.mean() == pytest.approx(figure7.PAPER["mean"], abs=5e-4)
    gaussian = np.random.default_rng(1).normal(0.2, 0.01, 20_000)
    assert figure7.farthest_from_gaussian(gaussian) < 0.01
    assert figure7.farthest_from_gaussian(np.abs(gaussian - 0.2)) > 0.05
    assert "| mean | 0.2219 | 0.22" in figure7.markdown(found)


def test_frequency_is_compared_with_progressive_in_every_region():
    text = frequency.markdown(
        [20_000], samplers=("random",), n_seeds=1, passes=4, n_reference=50_000
    )
    rows = [line.split(" | ")[0][2:] for line in text.splitlines() if line.endswith("× |")]
    assert rows[:-1] == list(frequency.REGIONS)
    assert rows[-1].startswith("worst of ")


def test_methods_stand_side_by_side_on_every_scene(tmp_path):
    scenes = ("ring", "shapes")
    matrix = methods.Matrix(
        (3_000,),
        scenes=scenes,
        pixels=32,
        references=ReferenceSettings(passes=1, photons=3_000),
        folder=tmp_path,
        longest=2,
    )
    lines = methods.markdown(matrix).splitlines()
    titles, _, *rows = lines[:6]
    assert [row.split(" | ")[0][2:] for row in rows] == [
        f"{scene}, 3,000 {sampler}" for scene in scenes for sampler in methods.SAMPLERS
    ]
    for name in ("standard", "parameterised", *methods.VARIANTS):
        assert f"| {name} |" in titles
    for row in rows:
        assert row.count("**") == 4
        assert row.endswith("| exact |") == row.startswith("| shapes")
        assert row.count(" · ") == titles.count("|") - 3
    squares = lines[lines.index("Relative L2:") + 4 :][:4]
    assert [row.split(" | ")[0] for row in squares] == [row.split(" | ")[0] for row in rows]
    analytic = [line for line in lines if "where irradiance is analytic: off by" in line]
    assert [line.split(" where")[0] for line in analytic] == [
        f"Reference of ring, 3,000 {sampler}" for sampler in methods.SAMPLERS
    ]
    assert all(", parameterised " in line for line in analytic)
    first = next(i for i, line in enumerate(lines) if line.startswith("| seconds"))
    times = lines[first + 2 : first + 4]
    assert [row.split(" | ")[0] for row in times] == [f"| {s}, 3,000 halton" for s in scenes]
    assert " passes, " in times[0]
    assert times[1].endswith("| – |")


def test_methods_say_what_is_missing_before_the_work(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "flip_evaluator", None)
    monkeypatch.setattr(methods.Matrix, "rows", None)
    with pytest.raises(ImportError, match="pip install"):
        methods.markdown(methods.Matrix((3_000,), folder=tmp_path))


def test_a_report_of_nothing_has_no_tables():
    assert "|" not in report.Report(863_000, 3, "here").markdown()


def test_slope_is_the_exponent():
    assert plot.slope([10, 100, 1000], [0.2, 2.0, 20.0]) == pytest.approx(1.0)


def test_photons_for_an_error_are_read_off_the_ladder():
    ladder = [equal_error.Run("", n, e, s) for n, e, s in ((100, 0.4, 1.0), (400, 0.1, 9.0))]
    sign, photons, seconds = equal_error.needed(ladder, 0.2)
    assert (sign, photons, seconds) == ("", pytest.approx(200), pytest.approx(3))
    assert equal_error.needed(ladder, 0.5)[:2] == ("<", pytest.approx(100))
    assert equal_error.needed(ladder, 0.05)[:2] == (">", pytest.approx(400))


def test_counted_floors_and_pictures_are_the_same_way_up():
    """Photons in one corner of the floor of a square metre."""
    floor = equal_error.Floor("ring", 0.5, 10)
    xy = np.random.default_rng(0).uniform([0.2, -0.5], [0.5, -0.2], (20_000, 2))
    photons = pr.PhotonMap(
        np.column_stack([xy, np.zeros(len(xy))]),
        np.tile([0.0, 0.0, 1.0], (len(xy), 1)),
        np.full(len(xy), 0.09 / len(xy)),
    )
    counted = floor.counted(photons)
    assert counted[:3, 7:].mean() == pytest.approx(1.0)
    shown = floor.image(pr.IrradianceField(photons, pr.GatherSettings(k=50)))
    np.testing.assert_allclose(shown[:2, 8:], counted[:2, 8:], atol=0.25)
    assert shown[4:, :6].max() == 0.0


def test_means_over_texels_have_a_row_for_every_method():
    study = pixel_means.Study(
        ("ring",), (2_000,), texels=8, pixels=48, reference_passes=2, photons_per_pass=5_000
    )
    lines = pixel_means.markdown(study).splitlines()
    names = [line.split("|")[2].strip() for line in lines[2:] if line.startswith("|")]
    assert names == ["reference", *PHOTON_METHODS, "differential-checking", "bias-compensation"]


def test_slopes_have_a_row_for_each_map_and_keep_references(tmp_path, monkeypatch):
    """On water of few faces."""
    monkeypatch.setattr(slopes, "water", partial(slopes.water, resolution=32))
    study = slopes.Study(
        *(("water",), (2_000,), (1, 2)),
        texels=8,
        reference_passes=2,
        photons_per_pass=5_000,
        cache=tmp_path,
    )
    table = slopes.markdown(study)
    lines = [line.split("|") for line in table.splitlines()[2:] if line.startswith("|")]
    assert [line[2].strip() for line in lines] == ["reference", "2,000", "2,000"]
    assert len(list(tmp_path.iterdir())) == 1
    assert slopes.markdown(study) == table


def test_dispersed_light_has_a_row_for_each_way(monkeypatch):
    monkeypatch.setattr(dispersion, "PLATES", {"thin": dispersion.PLATES["thin crown"]})
    lines = dispersion.markdown(2_000, ("standard",)).splitlines()[2:]
    cells = [[cell.strip() for cell in line.split("|")] for line in lines]
    assert [each[2] for each in cells] == [way.name for way in dispersion.WAYS]
    of_colour = [float(each[5].strip("%")) for each in cells]
    assert of_colour[0] < 1e-6
    # One index, one wavelength a path, and eight.
    assert of_colour[5] < 0.2 * of_colour[1]


def test_envelopes_and_relaxed_photons_have_a_row_each(monkeypatch):
    monkeypatch.setattr(slopes, "water", partial(slopes.water, resolution=8))
    references = slopes.Study(texels=8, reference_passes=2, photons_per_pass=5_000)
    study = envelope.Study(("water",), (0.5,), 0.05, (2_000,), references)
    lines = [line.split("|") for line in envelope.markdown(study).splitlines()[2:]]
    names = [line[2].strip() for line in lines if len(line) > 1]
    assert names == ["reference", "envelope, error 0.5", "mapped, k = 8"]
    held = [float(cell) for cell in lines[1][8:10]]
    assert all(0.0 < share <= 1.0 for share in held)


def test_envelopes_of_more_rays_have_more_triangles(monkeypatch):
    monkeypatch.setattr(envelope_cost, "water", partial(slopes.water, resolution=8))
    monkeypatch.setattr(envelope_cost, "_TEXELS", 20)
    first, second, _ = envelope_cost.rows((2_000, 4_000))
    assert int(first[2].replace(",", "")) < int(second[2].replace(",", ""))
    assert 0 < int(second[4]) < int(second[5])


def test_finer_envelopes_are_nearer_and_take_time(monkeypatch):
    case = envelope_times.Case(0.01, (0.8, 0.02), block=2, fine=0.01)
    monkeypatch.setitem(envelope_times.CASES, "ring", case)
    coarse, fine = envelope_times.rows(["ring"], 1, 1, envelope_times.Study(texels=100))
    assert float(coarse[3].split()[0]) > float(fine[3].split()[0])
    assert float(fine[5]) > 0.0


def test_errors_of_resolution_are_small_where_there_is_no_warning():
    cells = [row.split(" | ")[1:] for row in resolution.markdown(5_000, 8).splitlines()[2:10]]
    assert [thickness.startswith("(") for _, thickness, *_ in cells] == 5 * [False] + 3 * [True]
    errors = [float(cell.strip("%| ")) for row in cells for cell in (row[0], row[3])]
    assert np.abs(errors).max() < 2.0
