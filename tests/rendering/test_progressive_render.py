"""Images made in passes: what they show, and that stopping and resuming leaves no trace."""

import gc
import json
import multiprocessing
import os
import signal
import tracemalloc
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh

import photonrelax as pr
from photonrelax import gallery
from photonrelax._util import files
from photonrelax.estimation.progressive import initial_radius
from photonrelax.rendering import passes
from photonrelax.rendering.pass_statistics import (
    FixedHitPoints,
    PassSettings,
    PassState,
    StochasticHitPoints,
)
from photonrelax.rendering.passes import pass_seed
from photonrelax.rendering.view import View
from photonrelax.scene.digest import scene_digest
from tests.helpers.short_runs import FEW, layers_bytes
from tests.helpers.tracing_scenes import box, floor, glass_ball


def test_layers_are_those_of_render(ring):
    image = pr.render_progressive(ring, n_passes=2, **FEW)
    usual = pr.render(ring, n_emitted=4000, method="standard")
    names = ["radiance", "caustic", "direct", "albedo", "N", "Z"]
    assert sorted(image.layers) == sorted(names)
    for name in names[2:]:
        np.testing.assert_array_equal(image.layers[name], usual.layers[name])
    np.testing.assert_allclose(
        image.layers["radiance"], image.layers["caustic"] + image.layers["direct"]
    )
    assert image.layers["caustic"].mean() == pytest.approx(usual.layers["caustic"].mean(), rel=0.1)


@pytest.mark.parametrize("stochastic", [False, True])
def test_passes_lead_to_the_reflected_light_of_the_floor(stochastic):
    """Albedo/π · E₀ cos θ from the mirror image of the light, W/(m² sr)."""
    scene = mirrored_floor()
    settings = pr.ProgressiveSettings(radius=0.3)
    image = pr.render_progressive(
        scene, n_passes=6, photons_per_pass=20_000, settings=settings, stochastic=stochastic
    )
    expected = np.array([0.8, 0.4, 0.2]) / np.pi * np.array([2, 3, 4]) * np.sqrt(0.5)
    caustic = image.layers["caustic"]
    np.testing.assert_allclose(caustic.mean(axis=(0, 1)), expected, rtol=0.02)
    np.testing.assert_allclose(image.layers["direct"].mean(axis=(0, 1)), expected, rtol=1e-9)


def mirrored_floor():
    quad = trimesh.Trimesh([[-9, -9, 0], [9, -9, 0], [9, 9, 0], [-9, 9, 0]], [[0, 1, 2], [0, 2, 3]])
    mirror = trimesh.Trimesh(
        [[4, -4, 0.001], [4, 4, 0.001], [4, 4, 8], [4, -4, 8]], [[0, 1, 2], [0, 2, 3]]
    )
    return pr.Scene(
        [pr.SceneObject(quad, pr.Diffuse((0.8, 0.4, 0.2))), pr.SceneObject(mirror, pr.Mirror())],
        [pr.CollimatedEmitter((1, 0, -1), irradiance=(2, 3, 4))],
        pr.Camera((0, -1, 6), (0, 0, 0), width=4, height=4, vertical_fov=2.0),
    )


def test_moving_points_smooth_what_fixed_ones_see_as_steps():
    """Over the edge of the floor, one sample a pixel: covered or not, or by how much."""
    scene = mirrored_floor()
    edge = replace(scene.camera, origin=(-9, 0, 50), target=(-9, 0, 0), up=(0.1, 1, 0))
    scene = replace(scene, camera=replace(edge, width=12, height=12))
    how = {"n_passes": 16, "photons_per_pass": 500, "supersampling": 1}
    covered = {}
    for stochastic in (False, True):
        image = pr.render_progressive(scene, stochastic=stochastic, **how)
        covered[stochastic] = image.layers["albedo"][..., 0] / 0.8
        # Straight down: of all samples the nearest, however many passes there were.
        seen = covered[stochastic] > 0.0
        np.testing.assert_allclose(image.layers["Z"][seen], 50.0, rtol=1e-6)
    exact = pr.render(scene, n_emitted=500, method="standard", supersampling=32)
    exact = exact.layers["albedo"][..., 0] / 0.8
    assert set(np.unique(covered[False])) == {0.0, 1.0}
    assert np.abs(covered[True] - exact).max() < 0.1 < np.abs(covered[False] - exact).max()


def test_fixed_points_see_means_over_their_pixels(ring):
    """Where a pixel sees nothing but floor: folds as of 16 x 16 samples, from one a pixel."""
    photons = pr.trace_photons(ring, 1_000_000, seed=9)
    field = pr.irradiance_field(photons, method="standard")
    bands = list(View(ring, supersampling=16).bands())
    expected = np.concatenate(
        [band.radiance(field(band.hits.position, band.hits.normal)) for band in bands]
    )
    albedo = np.concatenate([band.sums(band.hits.weight * band.hits.albedo) for band in bands])
    how = {"n_passes": 32, "photons_per_pass": 10_000}
    one, many = (pr.render_progressive(ring, supersampling=s, **how).layers for s in (1, 2))
    floor = (np.isclose(one["albedo"], albedo) & (albedo > 0.0)).all(axis=2)
    assert floor.mean() > 0.5
    total = expected[floor].sum()
    # At points the errors are 0.26 and 0.25.
    assert np.abs(one["caustic"] - expected)[floor].sum() < 0.05 * total
    apart = np.abs(one["caustic"] - many["caustic"])[floor].sum()
    assert apart < 0.005 * total


def test_samples_on_one_piece_of_surface_share_statistics():
    """A floor alone: one disc a pixel, with any number of samples."""
    lasting, scene = pr.ProgressiveSettings(), mirrored_floor()
    settings = PassSettings(lasting, 4000, seed=3, supersampling=3, stochastic=False, max_depth=8)
    points = FixedHitPoints(View(scene, supersampling=3, n_threads=1), settings)
    state = points.after(PassState(), pr.trace_photons(scene, 4000), 0)
    assert state.statistics.n.shape == (16,)


def test_discs_of_moving_points_start_with_the_least_radius_in_their_pixel(ring):
    lasting = pr.ProgressiveSettings(alpha=1.0)
    settings = PassSettings(lasting, 4000, seed=3, supersampling=2, stochastic=True, max_depth=8)
    view, photons = View(ring, n_threads=1), pr.trace_photons(ring, 4000)
    points = StochasticHitPoints(view, settings)
    discs = points.after(PassState(), photons, 0).statistics
    hits = next(view.bands(points.offset(0))).hits
    radius = initial_radius(photons, hits.position, hits.normal, lasting)
    pixels = np.unique(hits.pixel)
    expected = [radius[hits.pixel == pixel].min() for pixel in pixels]
    np.testing.assert_allclose(discs.radius[pixels], expected, rtol=1e-12)
    last = radius[len(radius) - 1 - np.unique(hits.pixel[::-1], return_index=True)[1]]
    assert (last > 1.01 * np.array(expected)).sum() > 20


def test_a_pass_has_a_seed_of_its_own():
    seeds = {pass_seed(seed, number) for seed in range(20) for number in range(20)}
    assert len(seeds) == 400
    assert pass_seed(2**64 - 1, 5) == pass_seed(2**64 - 1, 5) < 2**64
    # NumPy keeps this function as it is.
    assert pass_seed(0, 0) == int(np.random.SeedSequence((0, 0)).generate_state(1, np.uint64)[0])


@pytest.mark.parametrize("stochastic", [False, True])
def test_same_bytes_for_every_number_of_threads(ring, stochastic):
    images = [
        layers_bytes(
            pr.render_progressive(ring, n_passes=2, stochastic=stochastic, n_threads=n, **FEW)
        )
        for n in (1, 2, 7)
    ]
    assert images[0] == images[1] == images[2]


@pytest.mark.parametrize("stochastic", [False, True])
def test_a_run_resumed_is_a_run_never_stopped(ring, stochastic, tmp_path):
    how = {"stochastic": stochastic, **FEW}
    kept, whole = tmp_path / "kept.npz", tmp_path / "whole.npz"
    straight = pr.render_progressive(
        ring, n_passes=5, checkpoints=pr.Checkpoints(state=whole), **how
    )
    for n_passes in (1, 2, 5):
        resumed = pr.render_progressive(
            ring, n_passes=n_passes, checkpoints=pr.Checkpoints(state=kept), **how
        )
    assert layers_bytes(resumed) == layers_bytes(straight)
    assert resumed.metadata == straight.metadata
    assert kept.read_bytes() == whole.read_bytes()
    assert resumed.stats["stages"]["passes"]["passes"] == 5


def test_a_run_is_resumed_with_the_normals_it_began_with(tmp_path):
    """In one process, of a mesh that came without any."""
    ball = trimesh.creation.icosphere(3, 0.5)
    ball = trimesh.Trimesh(np.add(ball.vertices, [4, 0, 1]), ball.faces, process=False)
    scene = mirrored_floor()
    glass = pr.SceneObject(ball, pr.Dielectric(), smooth=True)
    scene = replace(scene, objects=[scene.objects[0], glass])
    kept, whole = tmp_path / "kept.npz", tmp_path / "whole.npz"
    given = {"n_global": 0, **FEW}
    for n_passes in (1, 3):
        state = pr.Checkpoints(state=kept)
        pr.render_progressive(scene, n_passes=n_passes, checkpoints=state, **given)
    again = trimesh.Trimesh(ball.vertices, ball.faces, process=False)
    scene = replace(scene, objects=[scene.objects[0], replace(glass, mesh=again)])
    pr.render_progressive(scene, n_passes=3, checkpoints=pr.Checkpoints(state=whole), **given)
    assert kept.read_bytes() == whole.read_bytes()


def test_the_image_so_far_is_shown_at_intervals(ring):
    shown = []
    on_image = pr.Checkpoints(interval=1e-9, on_image=shown.append)
    last = pr.render_progressive(ring, n_passes=3, checkpoints=on_image, **FEW)
    passes = [image.stats["stages"]["passes"]["passes"] for image in shown]
    assert passes == [1, 2, 3, 3]
    assert layers_bytes(shown[-1]) == layers_bytes(last)
    two = pr.render_progressive(ring, n_passes=2, **FEW)
    assert layers_bytes(shown[1]) == layers_bytes(two)
    seldom = []
    rarely = pr.Checkpoints(interval=np.inf, on_image=seldom.append)
    pr.render_progressive(ring, n_passes=3, checkpoints=rarely, **FEW)
    assert len(seldom) == 1


def test_passes_go_on_for_a_time(ring):
    seen = []
    image = pr.render_progressive(
        ring, seconds=0.5, progress=lambda *step: seen.append(step), **FEW
    )
    assert image.stats["seconds"] >= 0.5
    assert image.stats["stages"]["passes"]["passes"] == len(seen) > 1
    assert {(stage, total) for stage, _, total in seen} == {("seconds", 1)}
    assert pr.render_progressive(ring, seconds=1e-6, **FEW).stats["stages"]["passes"]["passes"] == 1


def test_progress_counts_passes(ring):
    seen = []
    pr.render_progressive(ring, n_passes=2, progress=lambda *step: seen.append(step), **FEW)
    assert seen == [("passes", 1, 2), ("passes", 2, 2)]


@pytest.mark.kernels_run_elsewhere
@pytest.mark.parametrize("stochastic", [False, True])
def test_memory_does_not_grow_with_passes(ring, stochastic):
    """Garbage of a pass, which is collected at some time, is not counted."""

    def collect(*step):
        gc.collect()

    def peak(n_passes):
        gc.collect()
        # What is there already is not looked through for garbage after every pass.
        gc.freeze()
        tracemalloc.start()
        options = {"n_passes": n_passes, "stochastic": stochastic, "progress": collect}
        pr.render_progressive(ring, n_threads=1, **options, **FEW)
        most = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
        gc.unfreeze()
        return most

    peak(3)
    # Eight bytes for each hit point and pass would be ten times as much.
    assert peak(12) - peak(3) < 9 * 8 * 16 * 16 * 4 / 10


# Processes fork from one that has imported what they need.
PROCESSES = multiprocessing.get_context("forkserver")
PROCESSES.set_forkserver_preload([__name__, "trimesh", "embreex", "OpenEXR"])


def run_killed(state, stochastic, output, kill):
    """A run that is killed at a call of a function, before or after its work."""
    where, when, number = kill
    owner = {"trace_photons": passes, "fsync": os, "replace": Path}[where]
    work, calls = getattr(owner, where), []

    def killed(*arguments, **more):
        calls.append(where)
        last = len(calls) == number
        if last and when == "before":
            os.kill(os.getpid(), signal.SIGKILL)
        result = work(*arguments, **more)
        if last:
            os.kill(os.getpid(), signal.SIGKILL)
        return result

    setattr(owner, where, killed)
    run_in_peace(state, stochastic, output)


def run_in_peace(state, stochastic, output):
    output = files.output_path(output)
    pr.render_progressive(
        gallery.scene("ring", pixels=16, sections=64),
        n_passes=8,
        stochastic=stochastic,
        checkpoints=pr.Checkpoints(
            state=state, interval=1e-9, on_image=lambda image: image.write_exr(output)
        ),
        n_threads=1,
        **FEW,
    )


def exit_code(work, *arguments):
    """Of a process of its own."""
    process = PROCESSES.Process(target=work, args=arguments, daemon=True)
    process.start()
    process.join(60)
    return process.exitcode


KILLS = [
    ("trace_photons", "before", 1),
    ("fsync", "before", 1),
    ("replace", "before", 3),  # every second one is that of the image
    ("replace", "after", 1),
    ("replace", "before", 2),
    ("trace_photons", "before", 2),
]


@pytest.mark.parametrize("stochastic", [False, True])
def test_killing_it_at_any_moment_leaves_no_trace(ring, stochastic, tmp_path):
    """SIGKILL, run after run, until one comes through: the bytes of one left in peace."""
    state, output = tmp_path / "run.npz", tmp_path / "run.exr"
    passes_left, half_written = [], 0
    for kill in KILLS:
        assert exit_code(run_killed, state, stochastic, output, kill) == -signal.SIGKILL
        passes_left.append(int(np.load(state)["n_passes"]) if state.exists() else 0)
        half_written += any(path.suffix == ".part" for path in tmp_path.iterdir())
    assert passes_left == [0, 0, 1, 2, 3, 4]
    assert half_written >= 3
    assert exit_code(run_in_peace, state, stochastic, output) == 0
    peace = tmp_path / "peace.npz"
    image = pr.render_progressive(
        ring, n_passes=8, stochastic=stochastic, checkpoints=pr.Checkpoints(state=peace), **FEW
    )
    image.write_exr(tmp_path / "peace.exr")
    assert output.read_bytes() == (tmp_path / "peace.exr").read_bytes()
    assert state.read_bytes() == peace.read_bytes()
    # What was half written when a run was killed is cleared away by the next.
    assert sorted(os.listdir(tmp_path)) == ["peace.exr", "peace.npz", "run.exr", "run.npz"]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"seed": 4}, "holds another run: its seed is 3, not 4"),
        ({"photons_per_pass": 100}, "its photons_per_pass is 2000, not 100"),
        ({"supersampling": 1}, "its supersampling is 2, not 1"),
        ({"stochastic": True}, "its stochastic is False, not True"),
        ({"settings": pr.ProgressiveSettings(alpha=0.5)}, "its alpha is 0.7, not 0.5"),
        ({"n_passes": 1}, "n_passes should be at least the 2 that .* holds already, but is 1"),
    ],
)
def test_another_run_is_not_resumed(ring, change, message, tmp_path):
    state = pr.Checkpoints(state=tmp_path / "run.npz")
    pr.render_progressive(ring, n_passes=2, checkpoints=state, **FEW)
    before = (tmp_path / "run.npz").read_bytes()
    with pytest.raises(ValueError, match=message):
        pr.render_progressive(ring, **{"n_passes": 3, "checkpoints": state, **FEW, **change})
    assert (tmp_path / "run.npz").read_bytes() == before


def test_statistics_of_points_are_not_resumed(ring, tmp_path):
    """Those that fixed hit points had before they were means over footprints."""
    state = pr.Checkpoints(state=tmp_path / "run.npz")
    pr.render_progressive(ring, n_passes=1, checkpoints=state, **FEW)
    arrays = dict(np.load(state.state))
    identity = json.loads(str(arrays.pop("identity")))
    del identity["estimates"]
    np.savez(state.state, identity=json.dumps(identity), **arrays)
    with pytest.raises(ValueError, match="its estimates is None, not over footprints"):
        pr.render_progressive(ring, n_passes=2, checkpoints=state, **FEW)


def test_another_scene_is_not_resumed(ring, tmp_path):
    state = pr.Checkpoints(state=tmp_path / "run.npz")
    pr.render_progressive(ring, n_passes=1, checkpoints=state, **FEW)
    others = {
        "emitters": gallery.scene("ring", pixels=16, sections=64, irradiance=2.0),
        "objects": gallery.scene("ring", pixels=16, sections=65),
        "camera": gallery.scene("ring", pixels=17, sections=64),
    }
    for part, other in others.items():
        with pytest.raises(ValueError, match=f"its digest of the {part} is"):
            pr.render_progressive(other, n_passes=2, checkpoints=state, **FEW)


def test_scenes_that_differ_in_anything_have_other_digests(ring):
    def with_first(item):
        return replace(ring, objects=[item, *ring.objects[1:]])

    floor = ring.objects[0]
    lifted = np.add(floor.mesh.vertices, [0.0, 0.0, 1e-12])
    moved = trimesh.Trimesh(lifted, floor.mesh.faces, process=False)
    scenes = [
        ring,
        replace(ring, camera=replace(ring.camera, width=17)),
        replace(ring, emitters=[*ring.emitters, pr.PointEmitter((0, 0, 1))]),
        with_first(replace(floor, material=pr.Diffuse(0.5))),
        with_first(replace(floor, material=pr.Mirror(0.5))),
        with_first(replace(floor, smooth=True)),
        with_first(replace(floor, mesh=moved)),
    ]
    assert len({scene_digest(scene) for scene in scenes}) == len(scenes)
    assert scene_digest(gallery.scene("ring", pixels=16, sections=64)) == scene_digest(ring)


@pytest.mark.parametrize("content", [b"", b"PK\x03\x04 cut off", b"no archive"])
def test_a_file_that_is_no_run_is_refused_and_kept(ring, content, tmp_path):
    path = tmp_path / "run.npz"
    path.write_bytes(content)
    with pytest.raises(ValueError, match=r"run\.npz does not hold a run to be resumed"):
        pr.render_progressive(ring, n_passes=1, checkpoints=pr.Checkpoints(state=path), **FEW)
    assert path.read_bytes() == content


@pytest.mark.parametrize(
    ("arguments", "error", "message"),
    [
        ({}, ValueError, "n_passes or seconds should be given"),
        ({"n_passes": 0}, ValueError, "n_passes should be at least 1"),
        ({"seconds": 0.0}, ValueError, "seconds should be a positive number"),
        ({"n_passes": 1, "photons_per_pass": 0}, ValueError, "photons_per_pass should be at least"),
        ({"n_passes": 1, "seed": -1}, ValueError, "seed should be at least 0"),
        ({"n_passes": 1, "supersampling": 0}, ValueError, "supersampling should be at least 1"),
        ({"n_passes": 1, "settings": 0.7}, TypeError, "settings should be ProgressiveSettings"),
    ],
)
def test_bad_arguments_are_refused(ring, arguments, error, message):
    with pytest.raises(error, match=message):
        pr.render_progressive(ring, **arguments)


def test_a_scene_without_a_camera_and_a_bad_interval_are_refused(ring):
    with pytest.raises(ValueError, match="should have a camera"):
        pr.render_progressive(replace(ring, camera=None), n_passes=1)
    with pytest.raises(ValueError, match="interval should be a positive number"):
        pr.Checkpoints(interval=0.0)
    nowhere = pr.Checkpoints(state="/nowhere/run.npz")
    with pytest.raises(FileNotFoundError, match="there is no folder"):
        pr.render_progressive(ring, n_passes=1, checkpoints=nowhere)


def corner():
    """A floor and a wall that light one another, and a ball of glass."""
    camera = pr.Camera((2.0, -3.0, 2.0), (0, 0, 0.3), width=16, height=16)
    wall = pr.SceneObject(box([4.0, 0.1, 2.0], [0, 1.0, 1.0]), pr.Diffuse((0.8, 0.2, 0.2)))
    lamp = pr.PointEmitter((0.5, -0.5, 2.0), 10.0)
    return pr.Scene([floor(2.0), wall, glass_ball()], [lamp], camera)


FEW_PHOTONS = {"photons_per_pass": 2000, "seed": 3, "n_threads": 2}


@pytest.mark.parametrize("stochastic", [False, True])
def test_passes_hold_all_light(stochastic):
    """Indirect light is that of `render` from as many photons, whatever the number of passes."""
    scene = corner()
    n_global = pr.plan(scene, n_emitted=20_000).n_global
    assert n_global > 0
    image, more = (
        pr.render_progressive(scene, n_passes=n, stochastic=stochastic, **FEW_PHOTONS)
        for n in (1, 3)
    )
    once = pr.render(scene, n_emitted=20_000, n_global=n_global, seed=3)
    layers = image.layers
    np.testing.assert_array_equal(
        layers["radiance"], layers["caustic"] + layers["direct"] + layers["indirect"]
    )
    assert layers["indirect"].max() > 0.01 * layers["direct"].max()
    if stochastic:
        means = [each.layers["indirect"].mean(axis=(0, 1)) for each in (more, once)]
        np.testing.assert_allclose(*means, rtol=0.03)
    else:
        np.testing.assert_array_equal(layers["indirect"], once.layers["indirect"])
        np.testing.assert_array_equal(more.layers["indirect"], once.layers["indirect"])
    assert image.stats["stages"]["indirect"]["emitted"] == n_global


@pytest.mark.parametrize("stochastic", [False, True])
def test_a_run_with_indirect_light_is_resumed(stochastic, tmp_path):
    state = pr.Checkpoints(tmp_path / "run.npz")
    how = {"stochastic": stochastic, **FEW_PHOTONS}
    whole = pr.render_progressive(corner(), n_passes=3, **how)
    for n_passes in (1, 3):
        resumed = pr.render_progressive(corner(), n_passes=n_passes, checkpoints=state, **how)
    for name, layer in whole.layers.items():
        np.testing.assert_array_equal(resumed.layers[name], layer, err_msg=name)
    for other in ({"n_global": 0}, {"indirect": pr.GatherSettings(k=60)}):
        with pytest.raises(ValueError, match="holds another run: its"):
            pr.render_progressive(corner(), n_passes=4, checkpoints=state, **how, **other)


def test_indirect_light_is_left_out_of_passes_if_none_is_asked_for():
    none = pr.render_progressive(corner(), n_passes=1, n_global=0, **FEW_PHOTONS)
    assert "indirect" not in none.layers
    assert "indirect" not in none.stats["stages"]


def test_passes_have_as_many_samples_of_lights_as_asked_for():
    scene = corner()
    lamp = pr.AreaEmitter(pr.Disk((0.5, -0.5, 2.0), (0, 0, -1), 0.5), power=10.0)
    scene = pr.Scene(scene.objects, [lamp], scene.camera)
    noisy, fine = (
        pr.render_progressive(scene, n_passes=1, n_global=0, light_samples=n, **FEW_PHOTONS)
        for n in (1, 64)
    )
    settings = json.loads(noisy.metadata["photonrelax.settings"])
    assert settings["light_samples"] == 1
    assert not np.array_equal(noisy.layers["direct"], fine.layers["direct"])
