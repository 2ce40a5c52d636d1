"""Light in a cube with a ball of glass, by particles that are counted where they land.

Nothing of the library is used: walls and ball are equations, paths are followed in NumPy, and the
light that arrives on a wall is the sum of what its particles carry.
"""

from typing import NamedTuple

import numpy as np

COMPONENTS = ("direct", "caustic", "indirect")
_STEP = 1e-9


class Room(NamedTuple):
    """A cube from -1 to 1 around a ball of glass.

    Attributes
    ----------
    albedos : (6, 3)
        Of the walls: 2a is that of the lowest coordinate on axis a, 2a + 1 that of the greatest.
    lamps : list of ((3,), (3,))
        Positions and powers of point emitters.
    centre, radius, ior : (3,), float, float
        Of the ball.
    """

    albedos: np.ndarray
    lamps: list
    centre: np.ndarray
    radius: float
    ior: float


class Particles(NamedTuple):
    """Particles on their way, a row each."""

    at: np.ndarray
    way: np.ndarray
    flux: np.ndarray
    within: np.ndarray
    n_specular: np.ndarray
    n_diffuse: np.ndarray

    def some(self, rows):
        return Particles(*(each[rows] for each in self))


def irradiance(room, n, n_batches, seed):
    """Irradiance (n_batches, 3, 6, 3) of the walls by component, W/m²: n particles of each lamp."""
    rng = np.random.default_rng(seed)
    return np.array([_batch(room, n // n_batches, rng) for _ in range(n_batches)])


def _batch(room, n, rng):
    tally = np.zeros((3, 6, 3))
    for position, power in room.lamps:
        live = _emitted(position, np.asarray(power) / n, n, rng)
        while len(live.at):
            live = _advanced(room, live, tally, rng)
    return tally / 4.0


def _emitted(position, flux, n, rng):
    way = rng.normal(size=(n, 3))
    way /= np.linalg.norm(way, axis=1, keepdims=True)
    none = np.zeros(n, dtype=int)
    return Particles(np.tile(position, (n, 1)), way, np.tile(flux, (n, 1)), none > 0, none, none)


def _advanced(room, live, tally, rng):
    """Particles after their next event, those that go on."""
    to_ball = _distance_to_ball(room, live)
    with np.errstate(divide="ignore"):
        to_walls = (np.sign(live.way) - live.at) / live.way
    axis = to_walls.argmin(axis=1)
    to_wall = to_walls.min(axis=1)
    hits_ball = to_ball < to_wall
    at = live.at + np.minimum(to_ball, to_wall)[:, None] * live.way
    live = live._replace(at=at)
    through = _refracted(room, live.some(hits_ball), rng)
    walls = live.some(~hits_ball)
    side = 2 * axis[~hits_ball] + (walls.way[np.arange(len(walls.at)), axis[~hits_ball]] > 0)
    scattered = _scattered(room, walls, side, tally, rng)
    return Particles(*map(np.concatenate, zip(through, scattered, strict=True)))


def _distance_to_ball(room, live):
    away = live.at - room.centre
    b = (away * live.way).sum(axis=1)
    under = b**2 - (away**2).sum(axis=1) + room.radius**2
    root = np.sqrt(np.maximum(under, 0.0))
    near, far = -b - root, -b + root
    distance = np.where(live.within, far, near)
    return np.where((under > 0.0) & (distance > _STEP), distance, np.inf)


def _refracted(room, live, rng):
    """Particles reflected or refracted at the ball, by chance."""
    normal = (live.at - room.centre) / room.radius
    normal = np.where(live.within[:, None], -normal, normal)
    eta = np.where(live.within, room.ior, 1.0 / room.ior)[:, None]
    cos_i = -(live.way * normal).sum(axis=1, keepdims=True)
    squared = 1.0 - eta**2 * (1.0 - cos_i**2)
    cos_t = np.sqrt(np.maximum(squared, 0.0))
    s = (eta * cos_i - cos_t) / (eta * cos_i + cos_t)
    p = (cos_i - eta * cos_t) / (cos_i + eta * cos_t)
    reflectance = np.where(squared > 0.0, 0.5 * (s**2 + p**2), 1.0)[:, 0]
    reflects = rng.random(len(live.at)) < reflectance
    reflection = live.way + 2.0 * cos_i * normal
    refraction = eta * live.way + (eta * cos_i - cos_t) * normal
    way = np.where(reflects[:, None], reflection, refraction)
    way /= np.linalg.norm(way, axis=1, keepdims=True)
    within = live.within ^ ~reflects
    return live._replace(way=way, within=within, n_specular=live.n_specular + 1)


def _scattered(room, live, side, tally, rng):
    """Count particles on walls; those that are not absorbed go on at random."""
    axis = side // 2
    kind = np.where(live.n_diffuse > 0, 2, np.where(live.n_specular > 0, 1, 0))
    np.add.at(tally, (kind, side), live.flux)
    flux = live.flux * room.albedos[side]
    # By roulette, what is left of the brightest channel.
    chance = flux.max(axis=1) / live.flux.max(axis=1)
    on = rng.random(len(chance)) < chance
    live, side, axis = live.some(on), side[on], axis[on]
    flux = flux[on] / chance[on][:, None]
    way = rng.normal(size=live.way.shape)
    way /= np.linalg.norm(way, axis=1, keepdims=True)
    # A point on the sphere that touches the wall has the cosine's density.
    way[np.arange(len(way)), axis] += np.where(side % 2, -1.0, 1.0)
    way /= np.linalg.norm(way, axis=1, keepdims=True)
    return live._replace(flux=flux, way=way, n_diffuse=live.n_diffuse + 1)
