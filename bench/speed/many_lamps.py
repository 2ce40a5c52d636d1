"""Times and noise of a room with one lamp, and with many."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Sequence
from time import process_time

import numpy as np
import trimesh
from numpy.typing import NDArray

import photonrelax as pr
from bench.arguments import numbers
from bench.markdown import markdown_table
from photonrelax.gallery.solids import ball, cuboid
from photonrelax.transport.direct_light import Lights, LightSamples, default_light_samples
from photonrelax.transport.raycast import RayCaster

Floats = NDArray[np.float64]

# Size of the room and height of its lamps, m; power of all lamps, W, or irradiance of beams, W/m².
_ROOM, _HEIGHT, _POWER, _IRRADIANCE = (4.0, 4.0, 2.5), 2.4, 60.0, 4.0
# Estimates at each point.
_ESTIMATES = 32
_TABLES = ("times", "noise")


def point(at: Floats, power: Floats, aim: Floats) -> pr.PointEmitter:
    """Lamp that shines in all directions."""
    return pr.PointEmitter(at, power)


def lobe(at: Floats, power: Floats, aim: Floats) -> pr.LambertianEmitter:
    """Lamp with a cosine lobe, down."""
    return pr.LambertianEmitter(at, (0, 0, -1), power)


def spot(at: Floats, power: Floats, aim: Floats) -> pr.SpotEmitter:
    """Spot that points down."""
    return pr.SpotEmitter(at, (0, 0, -1), power, 30.0, 60.0)


def scattered_spot(at: Floats, power: Floats, aim: Floats) -> pr.SpotEmitter:
    """Narrow spot that points anywhere below."""
    return pr.SpotEmitter(at, aim, power, 20.0, 40.0)


def beam(at: Floats, power: Floats, aim: Floats) -> pr.CollimatedEmitter:
    """Parallel light from above."""
    return pr.CollimatedEmitter(aim, _IRRADIANCE / _POWER * power)


KINDS = {
    "points": point,
    "cosine lobes": lobe,
    "spots, down": spot,
    "narrow spots, anywhere": scattered_spot,
    "beams": beam,
}


def lamps(n: int, kind: Callable[..., pr.Emitter]) -> list[pr.Emitter]:
    """Lamps of unequal powers below a ceiling, one in each square of a grid."""
    rng = np.random.default_rng(n)
    side = int(np.ceil(np.sqrt(n)))
    cell = np.stack(np.divmod(np.arange(n), side), axis=1)
    xy = 0.95 * _ROOM[0] * ((cell + (0.5 if n == 1 else rng.random((n, 2)))) / side - 0.5)
    at = np.column_stack([xy, np.full(n, _HEIGHT)])
    power = np.exp(rng.normal(size=(n, 1))) * rng.uniform(0.5, 1.0, (n, 3))
    aim = rng.normal([0.0, 0.0, -1.0], 0.4, (n, 3))
    power *= _POWER / power.sum(axis=0).mean()
    return [kind(*each) for each in zip(at, power, aim, strict=True)]


def room(n: int, kind: Callable[..., pr.Emitter], pixels: int) -> pr.Scene:
    """Room with a ball of glass, a white one and a box; open above for beams."""
    walls = trimesh.creation.box(_ROOM)
    walls.apply_translation((0, 0, _ROOM[2] / 2))
    walls.invert()
    if kind is beam:
        walls.update_faces(walls.triangles_center[:, 2] < _HEIGHT)
    things = [
        pr.SceneObject(walls, pr.Diffuse(0.7), "room"),
        pr.SceneObject(ball((0.5, -0.5, 0.4), 0.38, 4), pr.Dielectric(1.5), "glass", smooth=True),
        pr.SceneObject(ball((-0.6, 0.3, 0.5), 0.45, 4), pr.Diffuse(0.7), "white", smooth=True),
        pr.SceneObject(cuboid((0.3, 0.8, 0.6), (0.5, 0.5, 1.2)), pr.Diffuse(0.6), "box"),
    ]
    eye, target = (0.0, -1.9, 1.6), (0.0, 0.2, 0.6)
    camera = pr.Camera(eye, target, vertical_fov=70.0, width=pixels, height=pixels)
    return pr.Scene(things, lamps(n, kind), camera)


def times(n: int, options: argparse.Namespace) -> dict[str, float]:
    """Processor seconds of the parts of work with n lamps that are points."""
    scene = room(n, point, options.pixels)
    found: dict[str, float] = {}

    def timed(name: str, work: Callable[[], object]) -> object:
        started = process_time()
        result = work()
        found[name] = process_time() - started
        return result

    photons = timed("tracing", lambda: pr.trace_photons(scene, options.photons))
    field = timed("relaxing", lambda: pr.irradiance_field(photons))
    corner, side = np.array([-2.0, -2.0, 0.0]), 4.0
    timed("map", lambda: pr.irradiance_map(field, corner, (side, 0, 0), (0, side, 0), (512, 512)))
    timed("plan", lambda: pr.plan(scene, n_emitted=options.photons))
    timed("direct light", lambda: pr.render(scene, components=("direct",)))
    timed("render", lambda: pr.render(scene, n_emitted=options.photons))
    passes = {"n_passes": 2, "photons_per_pass": options.photons // 10, "n_global": 0}
    timed("two passes", lambda: pr.render_progressive(scene, **passes))
    return found


def noise(kind: Callable[..., pr.Emitter], options: argparse.Namespace) -> list[float]:
    """Root mean square errors of default samples over light without occlusion: mean, 95 %, most.

    Of pixels that are points on the floor of the room.
    """
    scene = room(options.lamps[-1], kind, 8)
    xy = np.random.default_rng(0).uniform(-1.9, 1.9, (options.points, 2))
    at = np.column_stack([xy, np.zeros(len(xy))]), np.tile([0.0, 0.0, 1.0], (len(xy), 1))
    exact, unoccluded = summed(scene, scene.objects, at), summed(scene, scene.objects[:1], at)
    lights, n = Lights(scene, RayCaster(scene.surfaces)), default_light_samples(scene, 1)
    errors = [
        lights.irradiance(*at, samples=LightSamples(n, seed)).mean(axis=1) - exact
        for seed in range(_ESTIMATES)
    ]
    relative = np.sqrt(np.square(errors).mean(axis=0)) / unoccluded
    return [float(each) for each in (relative.mean(), np.quantile(relative, 0.95), relative.max())]


def summed(scene: pr.Scene, objects: Sequence[pr.SceneObject], at: tuple[Floats, Floats]) -> Floats:
    """Mean over channels (points,) of the irradiance from all lamps, each with a ray."""
    (position, normal), caster = at, RayCaster(objects)
    step = caster.resolution.at(position)[:, np.newaxis] * normal
    total = np.zeros(len(position))
    for emitter, offset in zip(scene.emitters, scene.emitter_offsets, strict=True):
        light = emitter.direct(position, float(offset))
        cosine = np.einsum("ni,ni->n", light.direction, normal)
        rows = np.flatnonzero((cosine > 0.0) & light.irradiance.any(axis=1))
        rays = position[rows], light.direction[rows], light.distance[rows] - offset
        rows = rows[~caster.occluded(*rays, origin_offset=step[rows])]
        total[rows] += cosine[rows] * light.irradiance[rows].mean(axis=1)
    return total


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of the benchmark."""
    parser.add_argument("--lamps", type=numbers, default=[1, 100, 10_000])
    parser.add_argument("--pixels", type=int, default=600)
    parser.add_argument("--photons", type=lambda text: int(float(text)), default=1_000_000)
    parser.add_argument("--points", type=int, default=200)
    parser.add_argument("--tables", nargs="+", choices=_TABLES, default=_TABLES)


def run(options: argparse.Namespace) -> None:
    """Print the tables."""
    if "times" in options.tables:
        print_times(options)
    if "noise" in options.tables:
        print_noise(options)


def print_times(options: argparse.Namespace) -> None:
    """Print the table of times."""
    found = [times(n, options) for n in options.lamps]
    rows = [
        [part, *(f"{each[part]:.1f}" for each in found), f"{found[-1][part] / found[0][part]:.2f}"]
        for part in found[0]
    ]
    titles = ["processor seconds", *(f"{n:,}" for n in options.lamps), "last over first"]
    print(markdown_table(titles, rows), end="\n\n", flush=True)


def print_noise(options: argparse.Namespace) -> None:
    """Print the table of noise, of the most lamps."""
    rows = [
        [name, *(f"{100 * error:.1f} %" for error in noise(kind, options))]
        for name, kind in KINDS.items()
    ]
    print(markdown_table([f"{options.lamps[-1]:,} lamps", "mean", "95 %", "most"], rows))
