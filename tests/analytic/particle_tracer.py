"""Light in a cube with a ball of glass or of shells, by particles that are counted where they land.

Nothing of the library is used: walls and ball are equations, paths are followed in NumPy, and the
light that arrives on a wall is the sum of what its particles carry.
"""

from typing import NamedTuple

import numpy as np

COMPONENTS = ("direct", "caustic", "indirect")
_STEP = 1e-9
_GOLDEN_RATIO = (1.0 + np.sqrt(5.0)) / 2.0


class Shell(NamedTuple):
    """The space of a sphere up to the next smaller one.

    Attributes
    ----------
    radius, ior : float
        Of the sphere, and the refractive index in it.
    absorption : (3,)
        1/m.
    """

    radius: float
    ior: float
    absorption: tuple = (0.0, 0.0, 0.0)


class Room(NamedTuple):
    """A cube from -1 to 1 around a ball.

    Attributes
    ----------
    albedos : (6, 3)
        Of the walls: 2a is that of the lowest coordinate on axis a, 2a + 1 that of the greatest.
    lamps : list of ((3,), (3,))
        Positions and powers of point emitters.
    centre : (3,)
        Of the ball.
    shells : list of Shell
        That the ball is made of, the largest first.
    """

    albedos: np.ndarray
    lamps: list
    centre: np.ndarray
    shells: list


class Particles(NamedTuple):
    """Particles on their way, a row each; `depth` counts the spheres that they are within."""

    at: np.ndarray
    way: np.ndarray
    flux: np.ndarray
    depth: np.ndarray
    n_specular: np.ndarray
    n_diffuse: np.ndarray

    def some(self, rows):
        return Particles(*(each[rows] for each in self))


def irradiance(room, n, n_batches, seed):
    """Irradiance (n_batches, 3, 6, 3) of the walls by component, W/m²: n particles of each lamp."""
    rng = np.random.default_rng(seed)
    return np.array([_batch(room, n // n_batches, _emitted, rng) for _ in range(n_batches)])


def caustics(room, n, n_batches, seed):
    """Irradiance (n_batches, 6, 3) of the walls by light of the ball alone: n aimed particles."""
    rng = np.random.default_rng(seed)
    black = room._replace(albedos=np.zeros((6, 3)))
    batches = [_batch(black, n // n_batches, _aimed, rng) for _ in range(n_batches)]
    return np.array(batches)[:, COMPONENTS.index("caustic")]


def _batch(room, n, emitted, rng):
    tally = np.zeros((3, 6, 3))
    for position, power in room.lamps:
        live = emitted(room, position, power, n, rng)
        while len(live.at):
            live = _advanced(room, live, tally, rng)
    return tally / 4.0


def _emitted(room, position, power, n, rng):
    """Particles in all directions, evenly."""
    return _from_lamp(position, np.asarray(power), _spiral(n, 2.0, rng))


def _aimed(room, position, power, n, rng):
    """Particles in the directions of the ball, evenly."""
    axis = np.subtract(room.centre, position)
    distance = np.sqrt(axis @ axis)
    drop = 1.0 - np.sqrt(1.0 - (room.shells[0].radius / distance) ** 2)
    axis /= distance
    u = np.cross(axis, np.eye(3)[np.abs(axis).argmin()])
    u /= np.sqrt(u @ u)
    way = _spiral(n, drop, rng) @ [u, np.cross(axis, u), axis]
    return _from_lamp(position, 0.5 * drop * np.asarray(power), way)


def _spiral(n, drop, rng):
    """Directions (n, 3) less than `drop` below the top of a sphere, on a spiral, shifted."""
    z = 1.0 - drop * (np.arange(n) + rng.random(n)) / n
    azimuth = 2.0 * np.pi * ((np.arange(n) / _GOLDEN_RATIO + rng.random()) % 1.0)
    aside = np.sqrt(1.0 - z * z)
    return np.column_stack([aside * np.cos(azimuth), aside * np.sin(azimuth), z])


def _from_lamp(position, power, way):
    n, none = len(way), np.zeros(len(way), dtype=int)
    return Particles(np.tile(position, (n, 1)), way, np.tile(power / n, (n, 1)), none, none, none)


def _advanced(room, live, tally, rng):
    """Particles after their next event, those that go on."""
    to_spheres = np.array([_distance_to_sphere(room, i, live) for i in range(len(room.shells))])
    sphere, to_ball = to_spheres.argmin(axis=0), to_spheres.min(axis=0)
    with np.errstate(divide="ignore"):
        to_walls = ((np.sign(live.way) - live.at) / live.way).T
    axis = np.where(to_walls[1] < to_walls[0], 1, 0)
    to_wall = np.minimum(to_walls[0], to_walls[1])
    axis[to_walls[2] < to_wall] = 2
    to_wall = np.minimum(to_wall, to_walls[2])
    hits_ball = to_ball < to_wall
    distance = np.minimum(to_ball, to_wall)[:, None]
    absorption = np.array([(0.0, 0.0, 0.0), *(shell.absorption for shell in room.shells)])
    flux = live.flux * np.exp(-absorption[live.depth] * distance)
    live = live._replace(at=live.at + distance * live.way, flux=flux)
    through = _refracted(room, live.some(hits_ball), sphere[hits_ball], rng)
    walls = live.some(~hits_ball)
    side = 2 * axis[~hits_ball] + (walls.way[np.arange(len(walls.at)), axis[~hits_ball]] > 0)
    scattered = _scattered(room, walls, side, tally, rng)
    return Particles(*map(np.concatenate, zip(through, scattered, strict=True)))


def _distance_to_sphere(room, sphere, live):
    away = live.at - room.centre
    b = _dots(away, live.way)
    under = b**2 - _dots(away, away) + room.shells[sphere].radius ** 2
    root = np.sqrt(np.maximum(under, 0.0))
    near, far = -b - root, -b + root
    distance = np.where(live.depth > sphere, far, near)
    return np.where((under > 0.0) & (distance > _STEP), distance, np.inf)


def _refracted(room, live, sphere, rng):
    """Particles reflected or refracted at spheres, by chance."""
    iors = np.array([1.0, *(shell.ior for shell in room.shells)])
    radii = np.array([shell.radius for shell in room.shells])
    within = live.depth > sphere
    normal = (live.at - room.centre) / radii[sphere][:, None]
    normal = np.where(within[:, None], -normal, normal)
    # Beyond a sphere lies what is around it, or what it holds.
    beyond = np.where(within, sphere, sphere + 1)
    eta = (iors[live.depth] / iors[beyond])[:, None]
    cos_i = -_dots(live.way, normal)[:, None]
    squared = 1.0 - eta**2 * (1.0 - cos_i**2)
    cos_t = np.sqrt(np.maximum(squared, 0.0))
    s = (eta * cos_i - cos_t) / (eta * cos_i + cos_t)
    p = (cos_i - eta * cos_t) / (cos_i + eta * cos_t)
    reflectance = np.where(squared > 0.0, 0.5 * (s**2 + p**2), 1.0)[:, 0]
    reflects = rng.random(len(live.at)) < reflectance
    reflection = live.way + 2.0 * cos_i * normal
    refraction = eta * live.way + (eta * cos_i - cos_t) * normal
    way = np.where(reflects[:, None], reflection, refraction)
    way /= np.sqrt(_dots(way, way))[:, None]
    depth = np.where(reflects, live.depth, beyond)
    return live._replace(way=way, depth=depth, n_specular=live.n_specular + 1)


def _scattered(room, live, side, tally, rng):
    """Count particles on walls; those that are not absorbed go on at random."""
    axis = side // 2
    kind = np.where(live.n_diffuse > 0, 2, np.where(live.n_specular > 0, 1, 0))
    for channel in range(3):
        counted = np.bincount(6 * kind + side, live.flux[:, channel], minlength=18)
        tally[:, :, channel] += counted.reshape(3, 6)
    flux = live.flux * room.albedos[side]
    # By roulette, what is left of the brightest channel.
    chance = np.maximum.reduce(flux.T) / np.maximum.reduce(live.flux.T)
    on = rng.random(len(chance)) < chance
    live, side, axis = live.some(on), side[on], axis[on]
    flux = flux[on] / chance[on][:, None]
    way = rng.normal(size=live.way.shape)
    way /= np.sqrt(_dots(way, way))[:, None]
    # A point on the sphere that touches the wall has the cosine's density.
    way[np.arange(len(way)), axis] += np.where(side % 2, -1.0, 1.0)
    way /= np.sqrt(_dots(way, way))[:, None]
    return live._replace(flux=flux, way=way, n_diffuse=live.n_diffuse + 1)


def _dots(a, b):
    return np.einsum("ij,ij->i", a, b)
