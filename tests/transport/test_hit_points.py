"""Camera rays against the geometry and optics of plane, sphere and slab."""

import numpy as np
import pytest
import trimesh

import photonrelax as pr
from photonrelax.scene.camera import pixel_rays
from photonrelax.transport import hit_points
from photonrelax.transport.direct_light import direct_irradiance
from photonrelax.transport.hit_points import trace_hit_points
from photonrelax.transport.raycast import RayCaster

DOWN = pr.CollimatedEmitter((0, 0, -1))


def plane(z=0.0, half=50.0, material=None, *, up=True):
    """A horizontal square; with `up` its face winds towards +z."""
    corners = [[-half, -half, z], [half, -half, z], [half, half, z], [-half, half, z]]
    faces = [[0, 1, 2], [0, 2, 3]] if up else [[2, 1, 0], [3, 2, 0]]
    mesh = trimesh.Trimesh(corners, faces, process=False)
    return pr.SceneObject(mesh, material or pr.Diffuse())


def box(low, high, material):
    mesh = trimesh.creation.box(bounds=[low, high])
    return pr.SceneObject(mesh, material)


def sphere(material, radius=1.0, subdivisions=5):
    mesh = trimesh.creation.icosphere(subdivisions=subdivisions, radius=radius)
    return pr.SceneObject(mesh, material, smooth=True)


def trace_view(objects, camera, **options):
    scene = pr.Scene(objects, [DOWN])
    caster = RayCaster(scene.objects)
    options.setdefault("rows", range(camera.height))
    return trace_hit_points(scene, caster, camera, **options)


def trace_weights_from(least, monkeypatch):
    """Leave rays out only if they have less weight."""
    monkeypatch.setattr(hit_points, "MIN_WEIGHT", least)


def one_ray(origin, target):
    """A camera of one pixel: one ray from origin to target."""
    up = (0, 1, 0) if origin[1] == target[1] else (0, 0, 1)
    return pr.Camera(origin, target, up=up, width=1, height=1)


def pixel_sums(points, camera):
    return np.stack(
        [np.bincount(points.pixel, w, camera.width * camera.height) for w in points.weight.T], 1
    )


def fresnel(cos_i, n1, n2):
    """Unpolarised reflectance, straight from the textbook."""
    cos_t = np.sqrt(1 - (n1 / n2) ** 2 * (1 - cos_i**2))
    s = (n1 * cos_i - n2 * cos_t) / (n1 * cos_i + n2 * cos_t)
    p = (n1 * cos_t - n2 * cos_i) / (n1 * cos_t + n2 * cos_i)
    return (s**2 + p**2) / 2


def test_edges_of_the_picture_are_at_the_field_of_view():
    camera = pr.Camera((0, -5, 0), (0, 0, 0), vertical_fov=60, width=301, height=101)
    origins, directions, pixel = pixel_rays(camera, range(101))
    directions = directions.reshape(101, 301, 3)
    np.testing.assert_array_equal(pixel, np.arange(101 * 301))
    np.testing.assert_array_equal(origins, np.tile([0.0, -5.0, 0.0], (101 * 301, 1)))
    np.testing.assert_allclose(np.linalg.norm(directions, axis=2), 1)
    np.testing.assert_allclose(directions[50, 150], [0, 1, 0], atol=1e-15)
    # Centres of the outer pixels lie half a pixel inside the edge; row 0 is up, column 0 left.
    slope = directions[..., 2] / directions[..., 1]
    aside = directions[..., 0] / directions[..., 1]
    edge = np.tan(np.radians(30))
    np.testing.assert_allclose(slope[0], edge * 100 / 101)
    np.testing.assert_allclose(slope[-1], -edge * 100 / 101)
    np.testing.assert_allclose(aside[:, 0], -edge * 300 / 101)


def test_orthographic_rays_are_parallel_and_a_pixel_apart():
    camera = pr.Camera((0, 0, 9), (0, 0, 0), (0, 1, 0), width=4, height=2, orthographic_height=3)
    origins, directions, _ = pixel_rays(camera, range(2))
    np.testing.assert_allclose(directions, np.tile([0, 0, -1], (8, 1)), atol=1e-15)
    x, y = [-2.25, -0.75, 0.75, 2.25], [0.75, -0.75]
    expected = [[a, b, 9] for b in y for a in x]
    np.testing.assert_allclose(origins, expected, atol=1e-14)


def test_samples_lie_on_a_regular_grid_in_their_pixel():
    camera = pr.Camera((0, 0, 9), (0, 0, 0), (0, 1, 0), width=2, height=2, orthographic_height=2)
    origins, _, pixel = pixel_rays(camera, range(1, 2), supersampling=2)
    np.testing.assert_array_equal(pixel, [2, 2, 2, 2, 3, 3, 3, 3])
    expected = [[x, y, 9] for y in (-0.25, -0.75) for x in (-0.75, -0.25)]
    np.testing.assert_allclose(origins[:4], expected, atol=1e-14)


@pytest.mark.parametrize("rows", [range(-1, 2), range(3, 5), range(0)])
def test_rows_outside_the_picture_are_refused(rows):
    with pytest.raises(ValueError, match="rows"):
        pixel_rays(pr.Camera((0, 0, 1), (0, 0, 0), (0, 1, 0), width=4, height=4), rows)


def test_a_floor_is_hit_where_the_rays_meet_it():
    camera = pr.Camera((1, -6, 3), (0, 0, 0), width=9, height=7)
    floor = plane(half=4.0, material=pr.Diffuse((0.1, 0.2, 0.3)), up=False)
    points, first = trace_view([floor], camera)

    origins, directions, pixel = pixel_rays(camera, range(7))
    t = -origins[:, 2] / directions[:, 2]
    expected = origins + t[:, None] * directions
    on = (t > 0) & (np.abs(expected[:, :2]) < 4).all(axis=1)
    assert 10 < on.sum() < 63
    np.testing.assert_array_equal(points.pixel, pixel[on])
    np.testing.assert_allclose(points.position, expected[on], atol=1e-12)
    np.testing.assert_allclose(points.normal, np.tile([0, 0, 1], (on.sum(), 1)), atol=1e-15)
    np.testing.assert_array_equal(points.albedo, np.tile([0.1, 0.2, 0.3], (on.sum(), 1)))
    np.testing.assert_array_equal(points.weight, np.ones((on.sum(), 3)))

    forward = camera.axes()[2]
    depth = np.where(on, t * (directions @ forward), np.inf).reshape(7, 9)
    np.testing.assert_allclose(first.depth, depth)
    np.testing.assert_allclose(
        first.normal, np.where(np.isfinite(depth), 1, 0)[..., None] * [0, 0, 1]
    )


def test_depth_of_a_pixel_is_that_of_its_nearest_sample():
    camera = pr.Camera((0, 0, 9), (0, 0, 0), (0, 1, 0), width=2, height=1, orthographic_height=1)
    low, high = plane(z=0.0), box((0.1, -9, 1.0), (9, 9, 2.0), pr.Diffuse())
    # The second pixel spans x from 0 to 1: its samples see both.
    _, first = trace_view([low, high], camera, supersampling=8)
    np.testing.assert_allclose(first.depth, [[9, 7]])


def test_a_mirror_shows_what_a_mirrored_camera_sees():
    mirror = plane(half=30.0, material=pr.Mirror((0.9, 0.5, 0.1)))
    ceiling = plane(z=5.0, half=30.0)
    camera = pr.Camera((0, 0, 2), (3, 1, 0), width=8, height=6, vertical_fov=30)
    below = pr.Camera((0, 0, -2), (3, 1, 0), width=8, height=6, vertical_fov=30)
    reflected, first = trace_view([mirror, ceiling], camera)
    direct, _ = trace_view([ceiling], below)
    upside_down = direct.position.reshape(6, 8, 3)[::-1].reshape(-1, 3)
    np.testing.assert_allclose(reflected.position, upside_down, atol=1e-10)
    np.testing.assert_allclose(reflected.weight, np.tile([0.9, 0.5, 0.1], (48, 1)))
    np.testing.assert_allclose(reflected.normal, np.tile([0, 0, -1], (48, 1)), atol=1e-12)
    np.testing.assert_allclose(first.normal[..., 2], 1)  # the mirror itself


def test_a_schlick_mirror_shows_more_at_grazing_angles():
    mirror = plane(half=30.0, material=pr.Mirror((0.9, 0.5, 0.1), schlick=True))
    for degrees in (0.0, 45.0, 80.0):
        angle = np.radians(degrees)
        toward = np.array([np.sin(angle), 0.0, -np.cos(angle)])
        camera = one_ray(np.array([0.0, 0.0, 2.0]), np.array([0.0, 0.0, 2.0]) + toward)
        points, _ = trace_view([mirror, plane(z=5.0, half=300.0)], camera)
        rise = (1.0 - np.cos(angle)) ** 5
        expected = [r + (1.0 - r) * rise for r in (0.9, 0.5, 0.1)]
        np.testing.assert_allclose(points.weight, [expected], rtol=1e-9)


@pytest.mark.parametrize("degrees", [0.0, 30.0, 75.0])
def test_a_slab_transmits_what_all_its_internal_reflections_let_through(degrees, monkeypatch):
    trace_weights_from(1e-12, monkeypatch)
    thickness, ior, absorption = 0.5, 1.5, np.array([0.0, 0.4, 2.0])
    slab = box((-40, -40, 1), (40, 40, 1 + thickness), pr.Dielectric(ior, 1.0, absorption))
    angle = np.radians(degrees)
    toward = np.array([np.sin(angle), 0, -np.cos(angle)])
    start = np.array([0.1, 0.2, 1.7])
    camera = one_ray(start, start + toward)
    points, _ = trace_view([slab, plane()], camera, max_depth=40)

    inner = np.arcsin(np.sin(angle) / ior)
    reflected = fresnel(np.cos(angle), 1.0, ior)
    through = np.exp(-absorption * thickness / np.cos(inner))
    transmitted = (1 - reflected) ** 2 * through / (1 - (reflected * through) ** 2)
    np.testing.assert_allclose(points.weight.sum(axis=0), transmitted, rtol=1e-9)

    # The strongest path leaves in parallel, displaced as Snell's law has it.
    x = start[0] + np.tan(angle) * (1 + 0.2) + np.tan(inner) * thickness
    np.testing.assert_allclose(points.position[0], [x, 0.2, 0], atol=1e-9)


def test_radiance_inside_glass_is_seen_through_the_square_of_the_index():
    ior, absorption = 1.5, np.array([0.1, 0.5, 1.0])
    glass = box((-5, -5, -1), (5, 5, 1), pr.Dielectric(ior, 1.0, absorption))
    points, _ = trace_view([glass, plane(half=4.0)], one_ray((0.1, 0.2, 3), (0.1, 0.2, 0)))
    seen = (1 - fresnel(1.0, 1.0, ior)) / ior**2 * np.exp(-absorption * 1.0)
    np.testing.assert_allclose(points.weight, [seen])


def test_total_reflection_keeps_all_radiance():
    absorption = np.array([0.1, 0.5, 1.0])
    glass = box((-50, -50, -1), (50, 50, 1), pr.Dielectric(1.5, 1.0, absorption))
    start, angle = np.array([0.1, 0.2, 0.5]), np.radians(60)
    camera = one_ray(start, start + np.array([np.sin(angle), 0, np.cos(angle)]))
    points, _ = trace_view([glass, plane(half=4.0)], camera)
    path = 1.5 / np.cos(angle)
    np.testing.assert_allclose(points.weight, [np.exp(-absorption * path)])
    np.testing.assert_allclose(points.position[0], [0.1 + 1.5 * np.tan(angle), 0.2, 0], atol=1e-9)


def test_a_smooth_mirror_ball_reflects_like_a_sphere():
    camera = pr.Camera(
        (0, 0, 9), (0, 0, 0), (0, 1, 0), width=40, height=40, orthographic_height=0.9
    )
    origins, _, _ = pixel_rays(camera, range(40))
    points, _ = trace_view([sphere(pr.Mirror()), plane(z=10.0, half=1e3)], camera)
    x, y = origins[:, :2].T
    z = np.sqrt(1 - x**2 - y**2)
    normal = np.stack([x, y, z], axis=1)
    direction = 2 * z[:, None] * normal - [0, 0, 1]
    expected = normal + direction * ((10 - z) / direction[:, 2])[:, None]
    order = np.argsort(points.pixel)
    error = np.linalg.norm(points.position[order] - expected, axis=1)
    assert (error / np.linalg.norm(expected, axis=1)).max() < 0.01


@pytest.mark.parametrize(("smooth", "fov"), [(False, 30), (True, 15)])
def test_in_a_closed_room_weights_add_up_to_one(smooth, fov, monkeypatch):
    """White furnace: whatever glass does to the rays, radiance that is 1 everywhere stays 1.

    A crystal holds light for many reflections. A smooth ball is looked at away from its rim,
    where interpolated normals can hold light for ever.
    """
    trace_weights_from(1e-6, monkeypatch)
    room = box((-6, -6, -6), (6, 6, 6), pr.Diffuse(1.0))
    mesh = trimesh.creation.icosphere(subdivisions=5 if smooth else 1)
    ball = pr.SceneObject(mesh, pr.Dielectric(1.5), smooth=smooth)
    camera = pr.Camera((4, 1, 2), (0, 0, 0), width=40, height=40, vertical_fov=fov)
    points, first = trace_view([room, ball], camera, max_depth=300)
    assert (first.depth < 4.6).mean() > 0.3
    assert len(points) > 1.5 * 40**2
    np.testing.assert_allclose(pixel_sums(points, camera), 1.0, atol=2e-5)


def test_faint_rays_and_long_paths_are_left_out(monkeypatch):
    trace_weights_from(1e-9, monkeypatch)
    slab = box((-40, -40, 1), (40, 40, 1.5), pr.Dielectric())
    camera = one_ray((0.1, 0.2, 3), (0.1, 0.2, 0))
    seen = {
        depth: len(trace_view([slab, plane()], camera, max_depth=depth)[0])
        for depth in (0, 1, 2, 3, 4)
    }
    assert seen == {0: 0, 1: 0, 2: 1, 3: 1, 4: 2}
    trace_weights_from(0.5, monkeypatch)
    assert len(trace_view([slab, plane()], camera, max_depth=9)[0]) == 0


def test_bands_of_rows_and_threads_do_not_change_a_bit():
    camera = pr.Camera((0, -6, 3), (0, 0, 0), width=30, height=20)
    objects = [plane(z=-1.0), sphere(pr.Dielectric(), subdivisions=3)]
    whole, first = trace_view(objects, camera, supersampling=2)
    bands = [
        trace_view(objects, camera, rows=range(a, a + 5), supersampling=2, n_threads=3)
        for a in range(0, 20, 5)
    ]
    np.testing.assert_array_equal(np.concatenate([b[1].depth for b in bands]), first.depth)
    np.testing.assert_array_equal(np.concatenate([b[1].normal for b in bands]), first.normal)
    order = np.argsort(whole.pixel, kind="stable")
    pixel = np.concatenate([b[0].pixel for b in bands])
    again = np.argsort(pixel, kind="stable")
    np.testing.assert_array_equal(pixel[again], whole.pixel[order])
    for name in ("position", "normal", "weight", "object_id", "footprint"):
        concatenated = np.concatenate([getattr(b[0], name) for b in bands])
        np.testing.assert_array_equal(
            concatenated[again], getattr(whole, name)[order], err_msg=name
        )


def narrow_camera(origin, target, *, orthographic=False):
    """A camera of 3 x 3 pixels, so small that their images are those of a linear map."""
    height = 1e-5 if orthographic else None
    return pr.Camera(
        *(origin, target, (0, 1, 0.2)),
        width=3,
        height=3,
        vertical_fov=1e-4,
        orthographic_height=height,
    )


def differences(points):
    """Edges of the middle pixel by the positions of those around it, by path, (n, 2, 3)."""
    grid = points.position.reshape(-1, 3, 3, 3)
    return np.stack([grid[:, 1, 2] - grid[:, 1, 0], grid[:, 2, 1] - grid[:, 0, 1]], axis=1) / 2


def assert_footprints_are_derivatives(objects, camera, n_paths, rtol=1e-4):
    points, _ = trace_view(objects, camera)
    assert len(points) >= 9 * n_paths
    by_path = np.arange(len(points)).reshape(-1, 9)
    np.testing.assert_array_equal(points.pixel, np.tile(np.arange(9), len(by_path)))
    edges, expected = points.footprint[by_path[:, 4]], differences(points)
    size = np.linalg.norm(expected, axis=2, keepdims=True)
    np.testing.assert_allclose(edges / size, expected / size, atol=rtol)


@pytest.mark.parametrize("orthographic", [False, True])
def test_footprints_seen_directly_are_the_edges_of_pixels(orthographic):
    camera = narrow_camera((1.0, -3.0, 2.0), (0.3, 0.2, 0.0), orthographic=orthographic)
    assert_footprints_are_derivatives([plane()], camera, 1)


@pytest.mark.parametrize("orthographic", [False, True])
@pytest.mark.parametrize("smooth", [False, True])
@pytest.mark.parametrize("material", [pr.Mirror(), pr.Dielectric(1.5)])
def test_footprints_follow_mirrors_and_glass(material, smooth, orthographic, monkeypatch):
    """By way of a ball, flat or smooth: through its interior and off it."""
    trace_weights_from(0.02, monkeypatch)
    mesh = trimesh.creation.icosphere(subdivisions=2)
    ball = pr.SceneObject(mesh, material, smooth=smooth)
    camera = narrow_camera((3.0, 0.4, 4.0), (0.2, 0.33, 0.1), orthographic=orthographic)
    room = box((-6, -6, -6), (6, 6, 6), pr.Diffuse())
    n_paths = 1 if isinstance(material, pr.Mirror) else 2
    assert_footprints_are_derivatives([room, ball], camera, n_paths, rtol=1e-3)


def test_footprints_of_samples_cover_their_pixel():
    camera = pr.Camera((0, 0, 9), (0, 0, 0), (0, 1, 0), width=4, height=2, orthographic_height=3)
    points, _ = trace_view([plane()], camera, supersampling=3)
    np.testing.assert_allclose(
        points.footprint, np.tile([[0.5, 0, 0], [0, -0.5, 0]], (len(points), 1, 1)), atol=1e-12
    )


def test_edges_of_footprints_are_no_longer_than_the_scene():
    """At the grazing rays of a horizon and at the critical angle they would be infinite."""
    camera = pr.Camera((0, -40, 0.035), (0, 0, 0.035), width=32, height=20, vertical_fov=1)
    points, _ = trace_view([plane()], camera)
    length = np.linalg.norm(points.footprint, axis=2)
    assert np.isfinite(length).all()
    assert length.max() <= np.linalg.norm([100, 100]) * (1 + 1e-12)
    assert length.max() > 141


def test_an_empty_view_gives_no_points():
    points, first = trace_view([plane()], one_ray((0, 0, 1), (0, 0, 2)))
    assert len(points) == 0
    assert first.depth[0, 0] == np.inf
    np.testing.assert_array_equal(first.normal, np.zeros((1, 1, 3)))


def irradiance(emitter, *objects, position, normal):
    scene = pr.Scene([plane(), *objects], [emitter])
    return direct_irradiance(scene, RayCaster(scene.objects), position, normal)


def test_direct_light_of_each_emitter_is_the_closed_form():
    position = np.array([[0.0, 0, 0], [3.0, 0, 0], [0, -4.0, 0]])
    normal = np.tile([0, 0, 1.0], (3, 1))
    options = {"position": position, "normal": normal}
    offset = np.array([0, 0, 2.0]) - position
    r = np.linalg.norm(offset, axis=1)
    cosine = 2.0 / r
    power = np.array([1.0, 2.0, 3.0])

    slanted = pr.CollimatedEmitter((3, 0, -4), power)
    np.testing.assert_allclose(irradiance(slanted, **options), np.tile(0.8 * power, (3, 1)))

    point = pr.PointEmitter((0, 0, 2), power)
    expected = (cosine / (4 * np.pi * r**2))[:, None] * power
    np.testing.assert_allclose(irradiance(point, **options), expected)

    lamp = pr.LambertianEmitter((0, 0, 2), (0, 0, -1), power)
    expected = (cosine**2 / (np.pi * r**2))[:, None] * power
    np.testing.assert_allclose(irradiance(lamp, **options), expected)


def test_direct_light_of_a_point_integrates_to_half_its_power():
    grid = (np.arange(400) + 0.5) / 400 * 80 - 40
    x, y = np.meshgrid(grid, grid)
    position = np.stack([x.ravel(), y.ravel(), np.zeros(x.size)], axis=1)
    arriving = irradiance(
        pr.PointEmitter((0, 0, 1)), position=position, normal=np.tile([0, 0, 1.0], (x.size, 1))
    )
    # Solid angle of a square of half side a at height 1: 4 asin(a² / (1 + a²)).
    fraction = 4 * np.arcsin(40**2 / (1 + 40**2)) / (4 * np.pi)
    np.testing.assert_allclose(arriving.sum(axis=0) * 0.2**2, fraction, rtol=1e-3)


@pytest.mark.parametrize("material", [pr.Diffuse(), pr.Mirror(), pr.Dielectric()])
def test_every_object_casts_a_shadow(material):
    roof = box((-1, -1, 1), (1, 1, 1.2), material)
    position = np.array([[0.2, 0.1, 0], [1.5, 0, 0]])
    normal = np.tile([0, 0, 1.0], (2, 1))
    arriving = irradiance(DOWN, roof, position=position, normal=normal)
    np.testing.assert_array_equal(arriving, [[0, 0, 0], [1, 1, 1]])


def test_light_from_behind_does_not_count_and_walls_do_not_hide_their_lamp():
    options = {"position": [[0.3, 0.4, 0.0]], "normal": [[0, 0, -1.0]]}
    assert not irradiance(DOWN, **options).any()
    ceiling = plane(z=2.0)
    lamp = pr.LambertianEmitter((0.3, 0.4, 2.0), (0, 0, -1), np.pi)
    arriving = irradiance(lamp, ceiling, position=[[0.3, 0.4, 0.0]], normal=[[0, 0, 1.0]])
    np.testing.assert_allclose(arriving, 0.25)


@pytest.mark.parametrize(
    "emitter", [pr.PointEmitter((0, 0, 1)), pr.LambertianEmitter((0, 0, 1), (0, 0, -1))]
)
def test_points_at_an_emitter_get_nothing_from_it(emitter):
    gap = pr.Scene([plane()], [emitter]).emitter_offset(emitter)
    position = np.array([0, 0, 1.0]) - np.outer([0, 0.5, 0.999, 1.001, 100], [0, 0, gap])
    arriving = irradiance(emitter, position=position, normal=np.tile([0, 0, 1.0], (5, 1)))
    assert not arriving[:3].any()
    intensity = 1 / np.pi if isinstance(emitter, pr.LambertianEmitter) else 1 / (4 * np.pi)
    expected = intensity / (gap * np.array([1.001, 100])) ** 2
    np.testing.assert_allclose(arriving[3:, 0], expected, rtol=1e-6)
