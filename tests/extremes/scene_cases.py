"""Extremes of scenes: errors of tracing, of images, and of every method's light below a plate."""

import warnings
from functools import cache, partial

import numpy as np
import trimesh

import photonrelax as pr
from photonrelax.estimation.methods import METHODS
from photonrelax.transport.optics import fresnel
from tests.analytic.slab import slab_transmittance
from tests.extremes.case import Case
from tests.helpers.tracing_scenes import DOWN, box, cube_wall, enclosure, floor, glass_ball

N = 20_000
SIZES = ("unit of length 1e-09 m", "unit of length 1e+09 m", "1e+06 sizes from the origin")


def relative(found, expected):
    return float(np.abs(np.asarray(found) / expected - 1.0).max())


def plate(thickness=0.02, height=1.0, **glass):
    """A plate of glass of 4 m, over which nothing else is."""
    mesh = box([4.0, 4.0, thickness], [0.0, 0.0, height])
    return pr.SceneObject(mesh, pr.Dielectric(**glass))


def placed(scene, scale, shift):
    """A scene of collimated light with its lengths times a scale, moved by a shift."""
    objects = [
        pr.SceneObject(
            trimesh.Trimesh(scale * item.mesh.vertices + shift, item.mesh.faces, process=False),
            item.material,
        )
        for item in scene.objects
    ]
    return pr.Scene(objects, scene.emitters)


# --- every method -----------------------------------------------------------------------------


@cache
def traced(scale, shift):
    """A plate over a floor, of any size and anywhere, and its photons."""
    scene = placed(pr.Scene([floor(), plate()], [DOWN]), scale, shift)
    return scene, pr.trace_photons(scene, 4000, frequency_share=0.1)


def below_plate(method, *, scale=1.0, sizes=0.0):
    """Mean irradiance below a plate of glass, of a scene of any size and place."""
    shift = tuple(scale * sizes * np.array([1.0, -0.7, 0.3]))
    scene, photons = traced(scale, shift)
    if not METHODS[method].needs_photons:
        photons = None
    field = pr.irradiance_field(photons, method=method, scene=scene)
    places = np.random.default_rng(3).uniform(-1.0, 1.0, (100, 2))
    points = scale * np.column_stack([places, np.zeros(100)]) + shift
    found = field(points, np.tile([0.0, 0.0, 1.0], (100, 1)))
    return relative(found.mean(axis=0), slab_transmittance(1.5))


FIELD_CASES = tuple(
    Case(f"plate, {name}", "transmittance", 0.03, partial(below_plate, **where))
    for name, where in zip(SIZES, ({"scale": 1e-9}, {"scale": 1e9}, {"sizes": 1e6}), strict=True)
)


# --- tracing ----------------------------------------------------------------------------------


def stored(objects, emitters=(DOWN,), n=N, **options):
    """Photons of a scene, of which nothing that it warns of matters here."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)
        return pr.trace_photons(pr.Scene(list(objects), list(emitters)), n, **options)


def through_plate(*, ior=1.5, thickness=0.02, triangles=0):
    """Flux through a plate, its faces divided until there are so many."""
    glass = plate(thickness, ior=ior)
    while len(glass.mesh.faces) < triangles:
        glass = pr.SceneObject(glass.mesh.subdivide(), glass.material)
    flux = stored([floor(), glass], max_bounces=1000).flux[:, 0].sum()
    return relative(flux, 16.0 * slab_transmittance(ior))


def absorbed():
    """Flux through a plate that is thinner than its scene by 1e-4 and absorbs 1e6 per metre."""
    half, thickness = 1e-3, 1e-6
    glass = pr.SceneObject(
        box([2 * half, 2 * half, thickness], [0.0, 0.0, half]), pr.Dielectric(1.5, absorption=1e6)
    )
    flux = stored([floor(2 * half), glass], n=200_000).flux[:, 0].sum()
    expected = slab_transmittance(1.5, absorption=1e6, thickness=thickness)
    return relative(flux, 4.0 * half**2 * expected)


def opaque():
    """Flux absorbed by a plate of twenty thousand lengths of absorption: all but the reflected."""
    objects = [floor(), plate(absorption=1e6)]
    # Without a glass ball beside it nothing would be stored.
    ball = glass_ball()
    ball.mesh.apply_translation([3.0, 0.0, 0.0])
    ledger = stored([*objects, ball], n=100_000).ledger
    return relative(ledger.absorbed[0, 0], 16.0 * (1.0 - 0.04))


def by_one_triangle():
    """Flux that a mirror of one triangle sends down to the floor."""
    corners = [[0.0, -1.0, 2.0], [0.0, 1.0, 2.0], [1.0, 0.0, 1.0]]
    mirror = pr.SceneObject(trimesh.Trimesh(corners, [[0, 1, 2]], process=False), pr.Mirror())
    flux = stored([floor(), mirror], [pr.CollimatedEmitter([1.0, 0.0, 0.0])]).flux[:, 0].sum()
    return relative(flux, 1.0)


def on_needles():
    """Flux on a floor twenty needles of 1 : 1e5 of which lie across the middle."""
    cuts = np.concatenate([[-4.0], 8e-5 * np.arange(-10, 11), [4.0]])
    x, y = (a.ravel() for a in np.meshgrid(cuts, [-4.0, 4.0]))
    n, i = len(cuts), np.arange(len(cuts) - 1)
    below = np.column_stack([i, i + 1, i + n + 1]), np.column_stack([i, i + n + 1, i + n])
    vertices = np.column_stack([x, y, np.zeros_like(x)])
    needles = trimesh.Trimesh(vertices, np.concatenate(below), process=False)
    # Through glass whose middle is over them.
    objects = [pr.SceneObject(needles, pr.Diffuse(0.5)), plate()]
    return relative(stored(objects).flux[:, 0].sum(), 16.0 * slab_transmittance(1.5))


def between_mirrors(*, reflectance):
    """Flux absorbed by grey walls around mirrors that face one another, and by these."""
    mirrors = [pr.SceneObject(cube_wall(2, side), pr.Mirror(reflectance)) for side in (-1, 1)]
    walls = [pr.SceneObject(cube_wall(a, s), pr.Diffuse(0.5)) for a in (0, 1) for s in (-1, 1)]
    lamp = pr.PointEmitter([0.1, 0.2, 0.3])
    photons = stored([*mirrors, *walls], [lamp], paths="all", max_bounces=1000)
    return relative(0.5 * photons.flux.sum(axis=0) + photons.ledger.absorbed[0], 1.0)


def in_closed_box(*, position):
    """Flux absorbed by the walls of a closed grey box, over that of an emitter in it or on it."""
    lamp = pr.LambertianEmitter(position, [0.0, 0.0, -1.0])
    photons = stored([enclosure(0.5)], [lamp], paths="all", max_bounces=1000)
    return relative(0.5 * photons.flux.sum(axis=0), 1.0)


TRACING_CASES = (
    Case("index 1 + 1e-9", "transmittance", 0.005, partial(through_plate, ior=1 + 1e-9)),
    Case("index 1/1.5", "transmittance", 0.005, partial(through_plate, ior=1 / 1.5)),
    Case("index 4", "transmittance", 0.01, partial(through_plate, ior=4.0)),
    Case(
        "plate of 1e-6 of the scene", "transmittance", 0.005, partial(through_plate, thickness=4e-6)
    ),
    Case("absorption 1e6 per m, a length of it", "transmittance", 0.02, absorbed),
    Case("absorption 1e6 per m, 20,000 lengths", "all absorbed but reflected", 0.005, opaque),
    Case("one triangle", "flux of its cross-section", 0.005, by_one_triangle),
    Case("needles of 1 : 1e5", "transmittance", 0.005, on_needles),
    *(
        Case(
            f"mirrors of {r:g} facing one another",
            "flux emitted",
            0.01,
            partial(between_mirrors, reflectance=r),
        )
        for r in (0.999, 1.0)
    ),
    Case(
        "emitter in a closed box",
        "flux emitted",
        0.01,
        partial(in_closed_box, position=[0, 0, 0.3]),
    ),
    Case("emitter on a wall", "flux emitted", 0.01, partial(in_closed_box, position=[0, 0, 1.0])),
)
TEN_MILLION = Case(
    "ten million triangles", "transmittance", 0.005, partial(through_plate, triangles=10_000_000)
)


# --- optics -----------------------------------------------------------------------------------


def grazing(*, degrees, ior):
    """Reflectance near 90°, by the first term of its series in the angle to the surface.

    With n² - 1 = s it is 1 - 2 (1 + n²) / √s · x, x the cosine of incidence.
    """
    cosine = np.cos(np.radians(degrees))
    lost = 2.0 * (1.0 + ior**2) / np.sqrt(ior**2 - 1.0) * cosine
    return relative(1.0 - fresnel(cosine, 1.0, ior), lost)


def critical(*, above):
    """Transmittance beside the critical angle: none above it, a square root of the rest below.

    Just below it is 4 (n + n⁻¹)/2 · t / √(1 - n⁻²), with n the index of the denser side and t the
    cosine of refraction.
    """
    n, angle = 1.5, np.arcsin(1.0 / 1.5)
    offset = 1e-9 if above else -1e-9
    found = 1.0 - fresnel(np.cos(angle + offset), n, 1.0)
    if above:
        return float(np.abs(found))
    cos_i = np.sqrt(1.0 - 1.0 / n**2)
    cos_t = np.sqrt(2.0 * n * cos_i * 1e-9)
    return relative(found, 2.0 * (1.0 / n + n) * cos_t / cos_i)


OPTICS_CASES = (
    Case("incidence 89.99°", "series", 0.005, partial(grazing, degrees=89.99, ior=1.5)),
    Case("critical angle + 1e-9", "total reflection", 0.0, partial(critical, above=True)),
    Case("critical angle - 1e-9", "series", 1e-3, partial(critical, above=False)),
)


# --- cameras ----------------------------------------------------------------------------------


def seen(objects, emitters, camera, **options):
    """Radiance of direct light and of emitters in the image of a scene."""
    scene = pr.Scene(objects, emitters, camera)
    options = {"components": ("emission", "direct"), "supersampling": 1} | options
    return pr.render(scene, **options).layers["radiance"]


def camera_in_glass():
    """Sky of radiance 1 all around, from within glass: n² of it."""
    camera = pr.Camera((0, 0, 1.0), (0.3, 0.2, 2.0), width=4, height=4, vertical_fov=20)
    sky = pr.EnvironmentEmitter(1.0)
    found = seen([glass_ball(smooth=False)], [sky], camera, max_depth=64)
    return relative(found, 1.5**2)


def camera_on_surface():
    """Sky of radiance 1 from a point of the floor."""
    camera = pr.Camera((0.3, 0.2, 0), (0.3, 0.2, 1), up=(0, 1, 0), width=4, height=4)
    return relative(seen([floor()], [pr.EnvironmentEmitter(1.0)], camera), 1.0)


def of_view(*, degrees, height, pixels=5):
    """Radiance of a lit floor, seen from straight above through any angle."""
    camera = pr.Camera(
        (0, 0, height), (0, 0, 0), up=(0, 1, 0), vertical_fov=degrees, width=pixels, height=pixels
    )
    return relative(seen([floor()], [DOWN], camera), 0.8 / np.pi)


CAMERA_CASES = (
    Case("camera in glass", "n² times the sky", 0.01, camera_in_glass),
    Case("camera on a surface", "sky", 1e-9, camera_on_surface),
    Case("field of view 0.001°", "lit floor", 1e-9, partial(of_view, degrees=1e-3, height=1.0)),
    Case("field of view 179.9°", "lit floor", 1e-9, partial(of_view, degrees=179.9, height=1e-3)),
    Case("one pixel", "lit floor", 1e-9, partial(of_view, degrees=45.0, height=1.0, pixels=1)),
)
