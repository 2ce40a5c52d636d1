"""Of many lamps some are chosen at each point: in the mean their light is that of all."""

import numpy as np
import pytest

import photonrelax as pr
from photonrelax.scene.lamps import LampTable
from photonrelax.transport.direct_light import (
    Lights,
    LightSamples,
    default_light_samples,
    direct_irradiance,
)
from photonrelax.transport.light_tree import light_tree
from photonrelax.transport.raycast import RayCaster
from tests.helpers.tracing_scenes import box, floor

FEW = 30
COPIES = 200


@pytest.fixture
def rng():
    return np.random.default_rng(1)


def positions(n, rng):
    """Above the floor, between and behind what stands on it, and a few below."""
    return rng.uniform([-2, -2, -0.3], [2, 2, 3], (n, 3))


def points(n, rng):
    power = rng.lognormal(size=(n, 3))
    return [pr.PointEmitter(at, w) for at, w in zip(positions(n, rng), power, strict=True)]


def cosine_lobes(n, rng):
    axes = rng.normal([0, 0, -1], 0.5, (n, 3))
    return [pr.LambertianEmitter(*at) for at in zip(positions(n, rng), axes, strict=True)]


def spots(n, rng):
    axes, outer = rng.normal([0, 0, -1], 0.3, (n, 3)), rng.uniform(20, 90, n)
    return [
        pr.SpotEmitter(at, axis, 1.0, 0.5 * angle, angle)
        for at, axis, angle in zip(positions(n, rng), axes, outer, strict=True)
    ]


def beams(n, rng):
    return [pr.CollimatedEmitter(axis, 0.1) for axis in rng.normal([0, 0, -1], 0.5, (n, 3))]


def black(n, rng):
    return [pr.PointEmitter(at, 0.0) for at in positions(n, rng)]


def mixed(n, rng):
    return [
        emitter for kind in (points, cosine_lobes, spots, beams, black) for emitter in kind(n, rng)
    ]


KINDS = (points, cosine_lobes, spots, beams, mixed)


def lit(emitters, *more, **material):
    """A scene with a box on a floor, and other objects."""
    stand = pr.SceneObject(box([0.8, 0.8, 1.0], [0.3, 0.2, 0.55]), pr.Diffuse())
    return pr.Scene([floor(), stand, *more], emitters)


def places(rng, n=12):
    """Points on the floor, lit from above, and points of walls that look to all sides."""
    position = rng.uniform([-2, -2, 0], [2, 2, 0], (n, 3))
    normal = np.tile([0.0, 0, 1], (n, 1))
    position[n // 2 :, 2] = 0.8
    normal[n // 2 :] = rng.normal(size=(n - n // 2, 3))
    return position, normal


def light(scene, at, n, seed=0, **options):
    samples = LightSamples(n, seed, options.pop("pixel", None))
    caster = RayCaster(scene.surfaces)
    return direct_irradiance(scene, caster, *at, samples=samples, **options)


def summed(scene, at):
    """Light of groups of emitters that are so few that each is asked for."""
    groups = [scene.emitters[i : i + FEW] for i in range(0, len(scene.emitters), FEW)]
    return sum(light(pr.Scene(scene.objects, group), at, 1) for group in groups)


def estimates(scene, at, n):
    """Independent estimates (copies, points, 3)."""
    copies = [np.tile(rows, (COPIES, 1)) for rows in at]
    return light(scene, copies, n).reshape(COPIES, -1, 3)


def check_mean(scene, at, n=8):
    found, exact = estimates(scene, at, n), summed(scene, at)
    doubt = found.std(axis=0) / np.sqrt(COPIES)
    assert (np.abs(found.mean(axis=0) - exact) <= 5.0 * doubt + 1e-9 * exact.max()).all()
    return found, exact


@pytest.mark.parametrize("kind", KINDS)
def test_the_mean_over_samples_is_the_sum_over_lamps(kind, rng):
    found, exact = check_mean(lit(kind(150, rng)), places(rng))
    assert (exact > 0.0).any()
    assert ((exact > 0.0) | (found == 0.0).all(axis=0)).all()


@pytest.mark.kernels_run_elsewhere
@pytest.mark.parametrize("kind", [points, cosine_lobes, spots, beams])
def test_noise_is_less_than_that_of_independent_samples_by_power(kind, rng):
    """Of which the closed form is (Σ f²/p - F²)/n, for lamps of light f and probability p."""
    scene, at = lit(kind(200, rng)), places(rng)
    each = np.array([light(pr.Scene(scene.objects, [lamp]), at, 1) for lamp in scene.emitters])
    bright = each.sum(axis=0).min(axis=1) > 0.1 * each.sum(axis=0).max()
    at, each = [rows[bright] for rows in at], each[:, bright]
    exact = each.sum(axis=0)
    at_once = np.zeros((1, 3))
    power = [np.sum(getattr(lamp, "power", at_once + 1.0)) for lamp in scene.emitters]
    share = (power / np.sum(power))[:, np.newaxis, np.newaxis]
    by_power = np.sqrt(((np.square(each) / share).sum(axis=0) / exact**2 - 1.0).mean())
    few, many = (np.sqrt(np.square(estimates(scene, at, n) / exact - 1.0).mean()) for n in (8, 96))
    assert few < 0.5 * by_power / np.sqrt(8)
    assert many < 0.25 * by_power / np.sqrt(96)


def test_neighbours_in_a_tree_are_near_one_another(rng):
    """Leaves of a square grid of lamps are squares, each beside or aslant of the one before."""
    side, leaf = 32, 4
    cell = np.stack(np.divmod(rng.permutation(side**2), side), axis=1)
    lamps = LampTable.of(pr.PointEmitter((*xy, 2.0)) for xy in cell)
    way = light_tree(lamps, np.zeros(len(lamps)))[1].position[:, :2]
    middles = way.reshape(-1, leaf**2, 2).mean(axis=1)
    assert np.abs(np.diff(middles, axis=0)).max() == leaf


@pytest.mark.parametrize("kind", [points, cosine_lobes, spots, beams])
def test_lamps_that_are_alike_have_no_noise(kind, rng):
    """So what kernels evaluate is the light of the emitter, in its cone and out of it."""
    one, at = kind(1, rng), places(rng, 200)
    caster_of = lit(one)
    np.testing.assert_allclose(
        light(lit(one * 200), at, 5), 200 * light(caster_of, at, 1), rtol=1e-9, atol=1e-12
    )


def test_a_lamp_that_brings_most_of_the_light_has_no_noise(rng):
    dim = [pr.PointEmitter(at, 1e-9) for at in positions(300, rng)]
    bright = pr.PointEmitter((-1, -1, 2.0), 100.0)
    at = places(rng)
    alone = light(lit([bright]), at, 1)
    np.testing.assert_allclose(light(lit([*dim, bright]), at, 8), alone, rtol=1e-5, atol=1e-6)


def test_lamps_in_absorbing_water_and_in_bubbles_of_it(rng):
    """A sea of larger priority than the glass in it, which does not occlude."""
    sea = pr.SceneObject(box([9, 9, 8]), pr.Dielectric(1.33, absorption=(0.3, 0.1, 0), priority=1))
    glass = pr.SceneObject(box([1, 1, 1], [-1, 0.5, 1.2]), pr.Dielectric(1.5))
    at = places(rng)
    exact = check_mean(lit(points(100, rng), sea, glass), at)[1]
    clear = summed(lit(points(100, rng)), at)
    assert not np.allclose(exact, clear, rtol=0.05)


def test_bits_do_not_depend_on_threads_nor_on_other_points(rng):
    scene = lit(mixed(100, rng))
    at = [np.repeat(rows, 500, axis=0) for rows in places(rng)]
    pixel = np.arange(6000) // 4
    whole = light(scene, at, 4, seed=5, pixel=pixel, n_threads=2)
    np.testing.assert_array_equal(whole, light(scene, at, 4, seed=5, pixel=pixel, n_threads=1))
    part = [rows[2000:2400] for rows in at]
    again = light(scene, part, 4, seed=5, pixel=pixel[2000:2400])
    np.testing.assert_array_equal(whole[2000:2400], again)
    assert (whole != light(scene, at, 4, seed=6, pixel=pixel)).any()


def test_points_of_a_pixel_share_evenly_spaced_samples(rng):
    """Four points of n samples are as good as one of 4 n."""
    scene, (position, normal) = lit(points(300, rng)), places(rng)
    at = [np.repeat(rows[:6], 4 * COPIES, axis=0) for rows in (position, normal)]
    exact = summed(scene, (position[:6], normal[:6]))
    pixel = np.arange(len(at[0])) // 4
    together = light(scene, at, 16, pixel=pixel).reshape(6, COPIES, 4, 3).mean(axis=2)
    single = light(scene, [rows[::4] for rows in at], 64).reshape(6, COPIES, 3)
    noise = [np.sqrt(np.square(each - exact[:, None]).mean()) for each in (together, single)]
    assert noise[0] < 1.1 * noise[1]


def test_few_lamps_are_summed_and_emitters_without_a_record_always(rng):
    class Own(pr.PointEmitter):
        """An emitter of a user, of which kernels know nothing."""

        lamp = None

    at = places(rng)
    for emitters in (points(32, rng), [Own(each.position) for each in points(50, rng)]):
        scene = lit(emitters)
        np.testing.assert_allclose(light(scene, at, 1), summed(scene, at), rtol=1e-12, atol=1e-15)
        assert default_light_samples(scene, 4) == 1
    assert default_light_samples(lit(points(33, rng)), 4) == 12


def test_lamps_in_different_directions_have_more_samples(rng):
    down = [pr.SpotEmitter(at, (0, 0, -1), 1.0, 20, 40) for at in positions(100, rng)]
    assert default_light_samples(lit(down), 4) == 16
    for kind in (beams, spots, cosine_lobes):
        assert default_light_samples(lit(kind(100, rng)), 4) == 48


@pytest.mark.parametrize("kind", [points, beams])
def test_lamps_that_are_summed_in_place_of_default_samples_have_no_noise(kind, rng):
    scene, at = lit(kind(60, rng)), places(rng)
    caster = RayCaster(scene.surfaces)
    for n_points in (1, 2):
        samples = LightSamples(default_light_samples(scene, n_points))
        found = direct_irradiance(scene, caster, *at, samples=samples)
        if 2 * samples.n >= 60:
            np.testing.assert_allclose(found, summed(scene, at), rtol=1e-12, atol=1e-15)


def test_scattered_narrow_spots_have_noise_below_two_per_cent(rng):
    """In the mean over points of a floor, over the light of all."""
    n = 1000
    at = rng.uniform([-2, -2, 2.4], [2, 2, 2.4], (n, 3))
    axes, power = rng.normal([0, 0, -1], 0.4, (n, 3)), rng.lognormal(size=n)
    lamps = [pr.SpotEmitter(*each, 20, 40) for each in zip(at, axes, power, strict=True)]
    scene = pr.Scene([floor()], lamps)
    lights, samples = Lights(scene, RayCaster(scene.surfaces)), default_light_samples(scene, 1)
    place = rng.uniform([-1.9, -1.9, 0], [1.9, 1.9, 0], (40, 3)), np.tile([0.0, 0, 1], (40, 1))
    exact = lights.irradiance(*place, samples=LightSamples(n))
    errors = [lights.irradiance(*place, samples=LightSamples(samples, i)) - exact for i in range(8)]
    noise = np.sqrt(np.square(errors).mean(axis=0)) / exact
    assert 1e-4 < noise.mean() < 0.02


def test_pixels_of_a_room_have_noise_below_two_per_cent(rng):
    """That of direct light, over the light of all lamps without what casts shadows."""
    grid = (np.stack(np.meshgrid(*2 * [np.arange(12)]), -1).reshape(-1, 2) + 0.5) / 3.0 - 2.0
    weights = rng.lognormal(size=144)
    lamps = [pr.PointEmitter((*xy, 2.5), w) for xy, w in zip(grid, weights, strict=True)]
    camera = pr.Camera((0, -3, 2), (0, 0, 0.3), width=16, height=16)

    def seen(objects, emitters, **options):
        scene = pr.Scene(objects, emitters, camera)
        return pr.render(scene, components=("direct",), **options).layers["direct"][..., 0]

    objects = lit(lamps).objects
    exact = sum(seen(objects, lamps[i : i + FEW]) for i in range(0, 144, FEW))
    empty = sum(seen(objects[:1], lamps[i : i + FEW]) for i in range(0, 144, FEW))
    found = np.array([seen(objects, lamps, seed=seed) for seed in range(4)])
    there = empty > 0
    noise = np.sqrt(np.square(found - exact).mean(axis=0))[there] / empty[there]
    assert noise.mean() < 0.02
    assert noise.mean() > 1e-4


def test_settings_name_the_samples(rng):
    scene = pr.Scene(
        [floor()], points(200, rng), pr.Camera((0, -3, 2), (0, 0, 0), width=8, height=8)
    )
    image = pr.render(scene, components=("direct",))
    assert '"light_samples": 12' in image.metadata["photonrelax.settings"]
    image = pr.render(scene, components=("direct",), light_samples=3)
    assert '"light_samples": 3' in image.metadata["photonrelax.settings"]
