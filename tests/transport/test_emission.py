import numpy as np
import pytest

import photonrelax as pr
from photonrelax.transport.aim import LUMINANCE
from photonrelax.transport.emission import emit, plan_emission
from tests.helpers import tracing_scenes
from tests.helpers.tracing_scenes import floor

CENTRE, RADIUS = np.array([1.0, -2.0, 3.0]), 0.7
N = 20_000


def near(*offset):
    return CENTRE + np.array(offset)


def ball():
    return pr.SceneObject(tracing_scenes.ball(RADIUS, CENTRE), pr.Mirror())


def scene(*emitters):
    return pr.Scene([ball(), floor(10.0)], emitters)


def planned(emitter, n=N, paths="caustic", **options):
    return plan_emission(scene(emitter), n, paths, **options)


def rays_of(emitter, n=N, **options):
    return emit(planned(emitter, n, **options), 0, range(n))


def at(tilt, distance, power=(1.0, 2.0, 3.0)):
    """A Lambertian emitter that sees the ball off its normal by `tilt`, from `distance`."""
    away = np.array([0.36, 0.48, 0.8])
    side = np.array([0.8, -0.6, 0.0])
    position = CENTRE - distance * away
    return pr.LambertianEmitter(position, np.cos(tilt) * away + np.sin(tilt) * side, power)


def impact(rays):
    """Distance of each ray's line from the ball's centre."""
    return np.linalg.norm(np.cross(CENTRE - rays.origin, rays.direction), axis=1)


def test_collimated_flux_is_irradiance_times_the_target_disk():
    plan = planned(pr.CollimatedEmitter([1, 2, -3], (1.0, 2.0, 3.0)))
    np.testing.assert_allclose(
        plan.flux_per_photon[0] * N, np.pi * RADIUS**2 * np.array([1.0, 2.0, 3.0]), rtol=1e-12
    )


@pytest.mark.parametrize("distance", [0.7001, 1.0, 5.0, 1e4, 1e9])
def test_point_flux_is_the_share_of_the_cones_solid_angle(distance):
    plan = planned(pr.PointEmitter(near(0.0, 0.0, distance), 2.0))
    # (1 - cos)/2 = sin²/4 (1 + sin²/4 + ...) where 1 - cos itself would cancel.
    sin2 = np.longdouble(RADIUS / distance) ** 2
    share = float((1 - np.sqrt(1 - sin2)) / 2 if distance < 100 else sin2 / 4 * (1 + sin2 / 4))
    # The mesh touches its sphere to rounding only, which weighs when the emitter almost touches.
    np.testing.assert_allclose(plan.flux_per_photon[0] * N, 2.0 * share, rtol=1e-7)


@pytest.mark.parametrize("tilt", [0.0, 0.5, 1.2])
def test_lambertian_flux_is_the_share_of_the_projected_solid_angle(tilt):
    plan = planned(at(tilt, 3.0))
    share = (RADIUS / 3.0) ** 2 * np.cos(tilt)
    np.testing.assert_allclose(plan.flux_per_photon[0] * N, share * np.array([1, 2, 3]), rtol=1e-9)


@pytest.mark.parametrize(
    "emitter",
    [
        pr.PointEmitter(near(0.1, 0.2, 0.3), (1.0, 2.0, 3.0)),
        at(0.0, 0.5),
        at(1.5, 3.0),
        at(1.7, 3.0),
    ],
    ids=["point inside", "lambertian inside", "cone to the horizon", "cone mostly behind"],
)
def test_whole_power_goes_out_where_no_cone_fits(emitter):
    plan = planned(emitter)
    np.testing.assert_allclose(plan.flux_per_photon[0] * N, [1.0, 2.0, 3.0], rtol=1e-12)


def all_directions(emitter, n, rng):
    """Directions of the whole emitter, by methods of their own: normal deviates and rejection."""
    rays = rng.normal(size=(n, 3))
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    if isinstance(emitter, pr.LambertianEmitter):
        rays = rays[rays @ emitter.direction > rng.random(n)]
    return rays


@pytest.mark.kernels_run_elsewhere
@pytest.mark.parametrize(
    "emitter",
    [pr.PointEmitter(near(0.0, 1.0, 1.0)), at(0.0, 1.0), at(0.6, 1.5), at(1.0, 2.0)],
    ids=["point", "lambertian facing", "lambertian tilted", "lambertian far tilted"],
)
@pytest.mark.parametrize("sampler", ["halton", "random"])
def test_aimed_emission_equals_rejection_from_the_whole_emitter(emitter, sampler):
    everywhere = all_directions(emitter, 600_000, np.random.default_rng(7))
    passes = np.linalg.norm(np.cross(CENTRE - emitter.position, everywhere), axis=1) < RADIUS
    passes &= everywhere @ (CENTRE - emitter.position) > 0.0
    kept = everywhere[passes]
    share = len(kept) / len(everywhere)
    aimed = rays_of(emitter, sampler=sampler).direction
    flux = planned(emitter).flux_per_photon[0] * N / emitter.power
    sigma = np.sqrt(share * (1 - share) / len(everywhere))
    np.testing.assert_allclose(flux, share, rtol=0, atol=5 * sigma)
    # The first two moments of the directions agree to five deviations of the two samples.
    moments = [np.column_stack([d, d[:, [0, 1, 2]] * d[:, [1, 2, 0]], d**2]) for d in (kept, aimed)]
    error = np.hypot(*(m.std(axis=0) / np.sqrt(len(m)) for m in moments))
    assert (np.abs(moments[0].mean(axis=0) - moments[1].mean(axis=0)) < 5 * error).all()


@pytest.mark.parametrize(
    ("emitter", "measure"),
    [
        (pr.CollimatedEmitter([0, 1, -1]), np.pi * RADIUS**2),
        (pr.PointEmitter(CENTRE), 4 * np.pi),
        (pr.PointEmitter(near(0, 0, 2)), 2 * np.pi * (1 - np.sqrt(1 - (RADIUS / 2) ** 2))),
        (at(0.9, 2.0), 2 * np.pi * (1 - np.sqrt(1 - (RADIUS / 2) ** 2))),
    ],
    ids=["plane", "sphere", "cap", "ellipse"],
)
def test_one_over_density_sums_to_the_measure_of_the_region(emitter, measure):
    rays = rays_of(emitter)
    assert np.sum(1.0 / rays.emitter_density) == pytest.approx(measure, rel=2e-4)


@pytest.mark.parametrize(("sampler", "limit"), [("halton", 2e-3), ("random", 0.015)])
def test_a_point_inside_its_target_shines_evenly_in_all_directions(sampler, limit):
    """Heights and azimuths of directions on the sphere are uniform, and independent."""
    rays = rays_of(pr.PointEmitter(CENTRE), sampler=sampler)
    x, y, z = rays.direction.T
    np.testing.assert_allclose(np.linalg.norm(rays.direction, axis=1), 1.0, rtol=1e-15)
    azimuth = np.arctan2(y, x) / np.pi
    for number in (x, y, z, azimuth):
        expected = np.linspace(-1.0, 1.0, N)
        np.testing.assert_allclose(np.sort(number), expected, atol=2 * limit)
    cells = np.histogram2d(z, azimuth, bins=(8, 8), range=[[-1, 1], [-1, 1]])[0]
    np.testing.assert_allclose(cells / N, 1 / 64, atol=limit)


def test_lambertian_density_is_proportional_to_the_cosine():
    emitter = at(0.9, 2.0)
    rays = rays_of(emitter)
    ratio = rays.emitter_density / (rays.direction @ emitter.direction)
    np.testing.assert_allclose(ratio, ratio[0], rtol=1e-12)


@pytest.mark.parametrize("distance", [10.0, 1e5, 1e9])
@pytest.mark.parametrize("kind", ["point", "lambertian"])
def test_thin_cones_cover_the_target_evenly_from_nearby(kind, distance):
    emitter = at(0.4, distance)
    if kind == "point":
        emitter = pr.PointEmitter(emitter.position)
    rays = rays_of(emitter)
    assert impact(rays).max() <= RADIUS * (1 + 1e-5)
    # From afar the target is a disk, where the mean square radius is half the largest.
    assert np.mean(impact(rays) ** 2) == pytest.approx(RADIUS**2 / 2, rel=0.01)
    np.testing.assert_allclose(np.linalg.norm(rays.direction, axis=1), 1.0, rtol=1e-15)
    np.testing.assert_array_equal(rays.emitter_coords, rays.direction)
    gap = np.linalg.norm(rays.origin - emitter.position, axis=1)
    np.testing.assert_allclose(gap, rays.travelled, rtol=1e-9)
    assert np.linalg.norm(rays.origin, axis=1).max() < 40.0


@pytest.mark.parametrize("distance", [0.0, 0.3, 2.0])
def test_rays_start_off_the_surface_their_emitter_may_lie_on(distance):
    emitter = pr.PointEmitter(near(0, 0, distance))
    rays = rays_of(emitter, 100)
    gap = scene(emitter).emitter_offset(emitter)
    offset = gap * rays.direction
    np.testing.assert_allclose(rays.origin - emitter.position, offset, rtol=0, atol=1e-14)
    assert rays.travelled == gap


def test_parallel_rays_start_before_the_scene_and_cover_the_target():
    direction = np.array([2.0, 3.0, -6.0]) / 7.0
    rays = rays_of(pr.CollimatedEmitter(direction))
    np.testing.assert_allclose(rays.direction, np.tile(direction, (N, 1)), rtol=0, atol=1e-15)
    corners = np.concatenate([item.mesh.vertices for item in (ball(), floor(10.0))])
    assert (rays.origin @ direction).max() < (corners @ direction).min()
    np.testing.assert_allclose(
        impact(rays), np.linalg.norm(rays.emitter_coords, axis=1), atol=1e-12
    )
    assert impact(rays).max() == pytest.approx(RADIUS, rel=1e-3)
    # Emitter coordinates are metres: distances on the plane are distances in the world.
    np.testing.assert_allclose(
        np.linalg.norm(rays.origin[1:] - rays.origin[0], axis=1),
        np.linalg.norm(rays.emitter_coords[1:] - rays.emitter_coords[0], axis=1),
        atol=1e-12,
    )


def test_other_paths_aim_at_the_whole_scene():
    emitter = pr.CollimatedEmitter([0, 0, -1])
    radius = scene(emitter).bounding_sphere()[1]
    for paths in ("global", "all"):
        flux = planned(emitter, paths=paths).flux_per_photon[0] * N
        np.testing.assert_allclose(flux, np.pi * radius**2, rtol=1e-12)


@pytest.mark.parametrize("sampler", ["halton", "random"])
def test_a_ray_depends_on_seed_and_index_alone(sampler):
    emitter = at(0.3, 3.0)
    rays = rays_of(emitter, 1000, sampler=sampler, seed=3)
    plan = planned(emitter, 2000, sampler=sampler, seed=3)
    for n_threads, cut in ((1, 10), (2, 500), (7, 999)):
        parts = [
            emit(plan, 0, part, n_threads=n_threads) for part in (range(cut), range(cut, 1000))
        ]
        together = np.concatenate([part.direction for part in parts])
        assert together.tobytes() == rays.direction.tobytes()
    other = rays_of(emitter, 1000, sampler=sampler, seed=4)
    assert not (other.direction == rays.direction).all(axis=1).any()


@pytest.mark.parametrize("sampler", ["halton", "random"])
def test_identical_emitters_do_not_emit_the_same_rays(sampler):
    plan = plan_emission(scene(at(0.3, 3.0), at(0.3, 3.0)), 2000, sampler=sampler)
    one, other = (emit(plan, e, range(1000)).direction for e in (0, 1))
    assert not np.isin(one[:, 0], other[:, 0]).any()


def test_photons_are_shared_in_proportion_to_luminance():
    emitters = [
        pr.CollimatedEmitter([0, 0, -1], (1.0, 0.0, 0.0)),
        pr.CollimatedEmitter([0, 0, -1], (0.0, 2.0, 0.0)),
        pr.CollimatedEmitter([0, 0, -1], (0.0, 0.0, 0.0)),
        pr.CollimatedEmitter([0, 0, -1], (0.0, 0.0, 1e-9)),
    ]
    plan = plan_emission(scene(*emitters), 10_001)
    assert plan.counts.sum() == 10_001
    assert plan.counts[2] == 0
    assert plan.counts[3] == 1
    share = LUMINANCE[0] / (LUMINANCE[0] + 2 * LUMINANCE[1])
    assert abs(plan.counts[0] - 10_000 * share) <= 1.0
    flux = plan.counts[:, np.newaxis] * plan.flux_per_photon
    expected = np.pi * RADIUS**2 * np.array([e.irradiance for e in emitters])
    np.testing.assert_allclose(flux, expected, rtol=1e-12)
    assert plan_emission(scene(*emitters), 3).counts.tolist() == [1, 1, 0, 1]
    assert len(emit(plan, 2, range(0))) == 0


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: planned(at(0, 3), paths="direct"), "paths should be one of caustic, global, all"),
        (lambda: planned(at(np.pi, 3.0)), "emitters should shine on the specular objects"),
        (lambda: planned(pr.PointEmitter([0, 0, 9], 0.0)), "have no power or face away"),
        (lambda: planned(at(0, 3), n=0), "n_emitted should be at least 1"),
        (
            lambda: plan_emission(scene(at(0, 3), at(0, 4)), 1),
            "n_emitted should be at least 2, one for each emitter",
        ),
        (
            lambda: plan_emission(pr.Scene([floor(10.0)], [at(0, 3)]), 10),
            "none of the 1 objects is a Mirror or Dielectric",
        ),
        (lambda: rays_of(at(0, 3), sampler="sobol"), "sampler should be one of halton, random"),
        (lambda: rays_of(at(0, 3), seed=-1), "seed should be at least 0"),
        (lambda: emit(planned(at(0, 3), 10), 0, range(5, 11)), r"photons should lie in range"),
    ],
)
def test_errors_name_the_argument(call, message):
    with pytest.raises(ValueError, match=message):
        call()


class Counted(pr.PointEmitter):
    """A point that counts the regions that are asked of it."""

    n_asked = 0

    def emission_region(self, *towards):
        type(self).n_asked += 1
        return super().emission_region(*towards)


def test_stages_of_a_render_share_the_regions_of_emitters():
    lit = pr.Scene([ball(), floor(10.0)], [Counted(near(0, 0, 2.0 + i)) for i in range(5)])
    for paths in ("caustic", "global"):
        pr.trace_photons(lit, 2000, paths=paths)
    n_asked = Counted.n_asked
    plans = [plan_emission(lit, n, "global", seed=seed) for seed, n in enumerate((100, 2000))]
    pr.trace_photons(lit, 3000, paths="caustic", seed=1)
    assert Counted.n_asked == n_asked
    assert plans[0].regions[3] is plans[1].regions[3]


def test_offsets_of_emitters_are_those_of_each():
    surface = pr.AreaEmitter(pr.Disk((3.0, 0.0, 5.0), (0, 0, -1), 0.5), radiance=1.0)
    points = [pr.PointEmitter(near(0, 0, 10.0**i)) for i in range(4)]
    lit = scene(points[0], pr.CollimatedEmitter((0, 0, -1)), surface, *points[1:])
    offsets = [lit.emitter_offset(emitter) for emitter in lit.emitters]
    np.testing.assert_array_equal(lit.emitter_offsets, offsets)
    assert len(set(offsets)) == 6
