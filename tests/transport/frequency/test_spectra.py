"""Local frequency spectra of photons: along their paths, and against the light they describe."""

from functools import cache

import numpy as np
import pytest

import photonrelax as pr
from photonrelax import gallery
from photonrelax.transport.emission import plan_emission
from photonrelax.transport.frequency.operators import diffused, kernel_radius
from photonrelax.transport.frequency.path_replay import PathEvents, PathReplayer
from photonrelax.transport.frequency.spectra import _Bundle
from photonrelax.transport.raycast import RayCaster
from tests.helpers.tracing_scenes import DOWN, SCENES, box, floor


def allowed(photons):
    return kernel_radius(diffused(photons.spectrum)[:, 0])


def carriers(photons):
    return photons.subset(~np.isnan(photons.spectrum[:, 0]))


PATHS = {
    "off the bend": ("reflector", {}, [[1, 0]], [[True, False]], [[-0.1, 0.45], [0.25, 0.3]]),
    "through the ball": (
        "sphere",
        {"subdivisions": 6},
        [[1, 1, 0]],
        [[False, False, False]],
        [[0.2, 0.1], [-0.35, 0.3], [0.5, -0.1]],
    ),
    "through the waves": (
        "ripples",
        {},
        [[1, 1, 0]],
        [[False, False, False]],
        [[0.2, 0.1], [-0.4, 0.3], [0.1, -0.5]],
    ),
}


@pytest.mark.kernels_run_elsewhere
@pytest.mark.parametrize("path", PATHS)
@pytest.mark.parametrize("point", [False, True])
def test_operators_predict_where_neighbouring_rays_land(path, point):
    """The operator is carried along; the rays are cast."""
    _, _, objects, reflected, places = PATHS[path]
    scene, caster = scene_of(path)
    if point:  # far enough for its rays to fall almost as the parallel ones do
        towards = np.asarray(scene.emitters[0].direction)
        lamp = pr.PointEmitter(scene.bounding_sphere([1])[0] - 15.0 * towards)
        scene = pr.Scene(scene.objects, [lamp])
    region = plan_emission(scene, 1000).regions[0]
    n = len(places)
    bundle = bundle_at(region, np.array(places))
    events = PathEvents(
        np.repeat(objects, n, 0), np.repeat(reflected, n, 0), np.full(n, len(objects[0]))
    )
    replayer = PathReplayer(scene, caster)
    hits = replayer.replay(bundle.rays(), events)
    assert not np.isnan(hits.position).any()
    # Some facets wide; on each of them normals turn at one rate, which differs by some percent.
    step = 0.01 if not point else 0.01 / 15.0
    jacobian = bundle.jacobian(hits)
    for axis in np.eye(2):
        there, back = (
            replayer.replay(bundle.probes(np.tile(s * step * axis, (n, 1))), events)
            for s in (1, -1)
        )
        moved = np.einsum("nij,nj->ni", hits.axes, there.position - back.position)
        found = moved / (2 * step)
        limit = 0.05 * np.linalg.norm(jacobian, axis=(1, 2))
        assert (np.linalg.norm(found - jacobian @ axis, axis=1) < limit).all()


@cache
def scene_of(path):
    name, sizes = PATHS[path][:2]
    scene = gallery.scene(name, **sizes)
    return scene, RayCaster(scene.objects)


def bundle_at(region, places):
    if region.is_plane:
        origin = region.origin + places @ region.frame[:2]
        return _Bundle(region, origin, np.tile(region.frame[2], (len(places), 1)))
    direction = region.frame[2] + places / 15.0 @ region.frame[:2]
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    return _Bundle(region, region.origin + region.start_distance * direction, direction)


@pytest.mark.kernels_run_elsewhere
@pytest.mark.parametrize("paths", ["caustic", "all"])
@pytest.mark.parametrize("name", SCENES)
def test_spectra_depend_on_no_thread_and_no_batch_and_change_no_photon(name, paths):
    scene = SCENES[name]
    given = {"paths": paths, "max_bounces": 8}
    plain, one, other = (
        pr.trace_photons(scene, 1_500, **given, **more)
        for more in (
            {},
            {"frequency_share": 0.1, "n_threads": 1},
            {"frequency_share": 0.1, "n_threads": 3, "batch_size": 256},
        )
    )
    assert plain.spectrum is None
    assert one.spectrum.tobytes() == other.spectrum.tobytes()
    assert plain.flux.tobytes() == one.flux.tobytes()
    assert plain.position.tobytes() == one.position.tobytes()
    first = np.unique(one.emitter_coords, axis=0)
    assert 0.05 * len(first) < len(carriers(one)) < 0.15 * len(first)


def test_larger_shares_hold_the_smaller():
    few, many = (
        pr.trace_photons(SCENES["glass ball"], 3_000, frequency_share=share) for share in (0.1, 0.4)
    )
    chosen = ~np.isnan(few.spectrum[:, 0])
    np.testing.assert_array_equal(many.spectrum[chosen], few.spectrum[chosen])
    assert len(carriers(many)) > 2 * len(carriers(few))


def test_scattered_photons_carry_none():
    scene = SCENES["glass and mirror in an enclosure"]
    photons = pr.trace_photons(scene, 1_000, paths="all", frequency_share=1.0)
    _, first = np.unique(photons.emitter_coords, axis=0, return_index=True)
    known = ~np.isnan(photons.spectrum[:, 0])
    assert known[first].mean() > 0.99
    assert not np.delete(known, first).any()


def test_kernels_stay_off_the_edge_of_a_shadow_and_grow_with_the_distance_from_it():
    """Light from above past a plate; the floor's own border is far."""
    plate = pr.SceneObject(box([1.0, 20.0, 0.01], [-0.5, 0.0, 1.0]), pr.Diffuse())
    scene = pr.Scene([floor(9.0), plate], [DOWN])
    photons = carriers(pr.trace_photons(scene, 6_000, paths="all", frequency_share=1.0))
    x, y, z = photons.position.T
    beside = (z == 0.0) & (x > 0.05) & (x < 3.0) & (np.abs(y) < 4.0)
    assert beside.sum() > 200
    radius = allowed(photons.subset(beside))
    # Offsets 2^(1/4) apart, and angles between probes, cost at most 1/1.4.
    assert (radius < 0.33 * x[beside]).all()
    assert (radius > 0.15 * x[beside]).all()


def test_plates_are_seen_that_are_as_narrow_as_two_thirds_of_their_distance():
    plate = pr.SceneObject(box([0.3, 20.0, 0.01], [-0.15, 0.0, 1.0]), pr.Diffuse())
    scene = pr.Scene([floor(9.0), plate], [DOWN])
    photons = carriers(pr.trace_photons(scene, 20_000, paths="all", frequency_share=1.0))
    x, y, z = photons.position.T
    distance = np.where(x > 0.0, x, -0.3 - x)
    # The emitter reaches some 11 m, and the first probes a 64th of it.
    beside = (z == 0.0) & (distance > 0.2) & (distance < 0.45) & (np.abs(y) < 6.0)
    assert beside.sum() > 200
    assert (allowed(photons.subset(beside)) < 0.33 * distance[beside]).all()


@pytest.mark.kernels_run_elsewhere
def test_kernels_stay_off_the_edge_of_total_reflection():
    """A lamp in glass, mirrored by its upper face; a plate below, in the glass."""
    glass = pr.SceneObject(box([20.0, 20.0, 2.0]), pr.Dielectric(1.5))
    scene = pr.Scene([floor(8.0), glass], [pr.PointEmitter([0.0, 0.0, 0.5])])
    photons = carriers(pr.trace_photons(scene, 12_000, frequency_share=0.5))
    edge = 1.5 / np.sqrt(1.5**2 - 1.0)
    photons = photons.subset(photons.n_bounces == 1)
    outside = np.linalg.norm(photons.position, axis=1) - edge
    bright = (outside > 0.02) & (outside < 0.3)
    dim = (outside < -0.02) & (outside > -0.3)
    radius = allowed(photons)
    assert min(bright.sum(), dim.sum()) > 30
    assert (radius[bright] < outside[bright]).all()
    assert (radius[dim] < -outside[dim]).all()


@pytest.mark.parametrize("kappa", [0.0, 3.0])
def test_throughput_is_that_of_fresnel_and_of_beer_and_lambert(kappa):
    """Straight down through a slab, as if nothing were reflected within."""
    glass = pr.SceneObject(box([4, 4, 0.5], [0, 0, 1]), pr.Dielectric(1.5, absorption=kappa))
    scene = pr.Scene([floor(), glass], [DOWN])
    region = plan_emission(scene, 10).regions[0]
    events = PathEvents(np.array([[1, 1, 0]]), np.zeros((1, 3), dtype=bool), np.array([3]))
    replayer = PathReplayer(scene, RayCaster(scene.objects))
    hits = replayer.replay(bundle_at(region, np.array([[0.1, 0.2]])).rays(), events)
    np.testing.assert_allclose(hits.throughput, 0.96**2 * np.exp(-0.5 * kappa), rtol=1e-9)


@pytest.mark.parametrize("lamp", [pr.PointEmitter, pr.LambertianEmitter])
def test_radii_bound_the_bias_below_a_lamp(lamp):
    """Irradiance under a point at height h is known; a disc's mean is by quadrature."""
    above = ([0, 0, 1.0],) if lamp is pr.PointEmitter else ([0, 0, 1.0], [0, 0, -1])
    scene = pr.Scene([floor(20.0)], [lamp(*above)])
    photons = carriers(pr.trace_photons(scene, 600, paths="all", frequency_share=1.0))
    near = photons.subset(np.linalg.norm(photons.position, axis=1) < 3.0)
    power = 3 if lamp is pr.PointEmitter else 4

    def irradiance(points):
        return (1.0 + (points**2).sum(axis=-1)) ** (-power / 2)

    ring = np.sqrt((np.arange(20) + 0.5) / 20)[:, None] * np.exp(2j * np.pi * np.arange(24) / 24)
    disc = np.stack([ring.real.ravel(), ring.imag.ravel()], axis=-1)
    centre = near.position[:, None, :2]
    means = irradiance(centre + allowed(near)[:, None, None] * disc).mean(axis=1)
    bias = np.abs(means / irradiance(centre[:, 0]) - 1.0)
    assert len(near) > 100
    assert bias.max() < 0.05
    assert np.median(allowed(near)) > 0.05


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"frequency_share": 1.5}, r"frequency_share should lie in \[0, 1\], but is 1.5"),
        ({"frequency_share": -0.1}, "frequency_share should lie in"),
        ({"frequency_share": np.nan}, r"frequency_share should lie in \[0, 1\], but is nan"),
        ({"frequency_share": np.inf}, r"frequency_share should lie in \[0, 1\], but is inf"),
        ({"frequency_share": 0.1, "paths": "global"}, "have no spectra"),
    ],
)
def test_errors_name_the_argument(change, message):
    with pytest.raises(ValueError, match=message):
        pr.trace_photons(SCENES["glass ball"], 10, **change)
