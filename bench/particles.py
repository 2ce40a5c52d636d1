"""A particle tracer of its own: trimesh casts rays, the rest is NumPy.

It shares meshes, their shading normals and materials with the package, and no other code. Particles
of equal flux leave the emitters over the whole scene; a share of them, which weighs less, towards a
sphere of interest. They are counted in patches.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from trimesh.ray.ray_pyembree import RayMeshIntersector
from trimesh.util import concatenate

import photonrelax as pr

Floats = NDArray[np.float64]

COMPONENTS = ("direct", "caustic", "indirect")
# Share of the particles that are aimed at the sphere of interest; events of a path, at most.
_AIMED, _MAX_EVENTS = 0.7, 200
# Start of rays from their surfaces, over the size of the scene.
_STEP = 3e-6


class Patch(NamedTuple):
    """Part of an object within a box, of an area, m², and the normal on its lit side."""

    object_id: int
    low: Floats
    high: Floats
    area: float
    normal: Floats


class Rays(NamedTuple):
    """Particles under way."""

    origin: Floats
    direction: Floats
    flux: Floats
    inside: NDArray[np.bool_]
    history: NDArray[np.int64]

    def where(self, mask: NDArray) -> Rays:
        """Some of them."""
        return Rays(*(column[mask] for column in self))


class Hits(NamedTuple):
    """First hits of rays: positions, distances, surfaces, geometric and shading normals."""

    position: Floats
    distance: Floats
    owner: NDArray[np.int64]
    normal: Floats
    shading: Floats


@dataclass
class Tracer:
    """Scene, sphere of interest (centre, radius), and patches to count particles in."""

    scene: pr.Scene
    interest: tuple[Floats, float]
    patches: Sequence[Patch]

    def __post_init__(self) -> None:
        surfaces = self.scene.surfaces
        self.mesh = concatenate([_flat(item.mesh) for item in surfaces])
        sizes = [len(item.mesh.faces) for item in surfaces]
        self.owner = np.repeat(np.arange(len(surfaces)), sizes)
        self.corners = np.concatenate([_corner_normals(item) for item in surfaces])
        self.caster = RayMeshIntersector(self.mesh)
        self.triangles = np.asarray(self.mesh.triangles)
        self.table = self.scene.material_table()
        self.kind = np.array(self.table.kind)
        low, high = self.mesh.bounds
        self.whole = (0.5 * (low + high), 0.5 * float(np.linalg.norm(high - low)))
        self.step = _STEP * self.whole[1]

    def irradiance(self, n: int, batches: int, seed: int = 0) -> Floats:
        """Irradiance by batch, patch, component and channel, W/m²."""
        rng = np.random.default_rng(seed)
        return np.array([self._batch(n, rng) for _ in range(batches)])

    def _batch(self, n: int, rng: np.random.Generator) -> Floats:
        found = np.zeros((len(self.patches), 3, 3))
        for rays in self._emitted(n, rng):
            self._follow(rays, rng, found)
        areas = np.array([patch.area for patch in self.patches])
        return found / areas[:, None, None]

    def _emitted(self, n: int, rng: np.random.Generator) -> Iterator[Rays]:
        for emitter in self.scene.emitters:
            for aimed, share in ((True, _AIMED), (False, 1.0 - _AIMED)):
                some = int(share * n)
                origin, direction, flux = _rays(self, emitter, some, aimed, rng)
                inside = np.zeros((len(origin), len(self.kind)), dtype=bool)
                history = np.zeros(len(origin), dtype=np.int64)
                yield Rays(origin, direction, flux / some, inside, history)

    def _follow(self, rays: Rays, rng: np.random.Generator, found: Floats) -> None:
        for _ in range(_MAX_EVENTS):
            if not len(rays.origin):
                return
            face = self.caster.intersects_first(rays.origin, rays.direction)
            rays, face = rays.where(face >= 0), face[face >= 0]
            hits = self._at(rays, face)
            rays = rays._replace(flux=rays.flux * self._transmitted(rays.inside, hits.distance))
            self._count(hits, rays, found)
            rays = self._scattered(rays, hits, rng)

    def _at(self, rays: Rays, face: NDArray) -> Hits:
        a, b, c = self.triangles[face].transpose(1, 0, 2)
        cross = np.cross(b - a, c - a)
        normal = cross / np.linalg.norm(cross, axis=1, keepdims=True)
        along = _dot(rays.direction, normal)
        distance = np.maximum(_dot(a - rays.origin, normal) / along, 0.0)
        position = rays.origin + distance[:, None] * rays.direction
        weight_b = _dot(np.cross(position - a, c - a), cross) / _dot(cross, cross)
        weight_c = _dot(np.cross(b - a, position - a), cross) / _dot(cross, cross)
        weights = np.stack([1.0 - weight_b - weight_c, weight_b, weight_c], axis=1)
        shading = np.einsum("ni,nij->nj", weights, self.corners[face])
        shading /= np.linalg.norm(shading, axis=1, keepdims=True)
        return Hits(position, distance, self.owner[face], normal, shading)

    def _transmitted(self, inside: NDArray, distance: Floats) -> Floats:
        medium = self._medium(inside)
        absorption = np.where(medium[:, None] >= 0, self.table.absorption[medium], 0.0)
        return np.exp(-absorption * distance[:, None])

    def _medium(self, inside: NDArray) -> NDArray:
        """The object of the largest priority among those that rays are in, or -1."""
        ranked = np.where(inside, self.table.priority + 1.0, 0.0)
        return np.where(inside.any(axis=1), ranked.argmax(axis=1), -1)

    def _count(self, hits: Hits, rays: Rays, found: Floats) -> None:
        is_diffuse = self.kind[hits.owner] == "diffuse"
        for number, patch in enumerate(self.patches):
            there = is_diffuse & (hits.owner == patch.object_id)
            there &= rays.direction @ patch.normal < 0.0
            there &= (hits.position >= patch.low).all(axis=1)
            there &= (hits.position <= patch.high).all(axis=1)
            for each in range(len(COMPONENTS)):
                mine = there & (rays.history == each)
                found[number, each] += rays.flux[mine].sum(axis=0)

    def _scattered(self, rays: Rays, hits: Hits, rng: np.random.Generator) -> Rays:
        """Rays that go on; those left of absorption carry the flux of all."""
        owner, kind = hits.owner, self.kind[hits.owner]
        facing = np.where(_dot(rays.direction, hits.normal) < 0.0, 1.0, -1.0)[:, None]
        is_glass, is_diffuse = kind == "dielectric", kind == "diffuse"
        toward, passed = facing * hits.shading, np.zeros(len(owner), dtype=bool)
        direction = rays.direction - 2.0 * _dot(rays.direction, toward)[:, None] * toward
        direction[is_diffuse] = _cosine((facing * hits.normal)[is_diffuse], rng)
        goes_through, bent = self._refracted(rays, hits, toward, is_glass, rng)
        passed[is_glass] = goes_through
        direction[passed] = bent[goes_through]
        inside, history = rays.inside.copy(), rays.history.copy()
        rows = np.flatnonzero(passed)
        inside[rows, owner[rows]] = facing[rows, 0] > 0.0
        is_event = ~self._hidden(rays.inside, owner)
        history[is_event] = np.maximum(history[is_event], 1)
        history[is_diffuse] = 2
        side = np.where(passed[:, None], -facing, facing) * hits.normal
        reflected = np.where(is_glass[:, None], 1.0, self.table.reflectance[owner])
        probability = reflected.max(axis=1)
        # Shading normals may bend light into its surface.
        alive = (_dot(direction, side) > 0.0) & (rng.random(len(owner)) < probability)
        flux = rays.flux * reflected / np.maximum(probability, 1e-300)[:, None]
        origin = hits.position + self.step * side
        return Rays(origin, direction, flux, inside, history).where(alive)

    def _hidden(self, inside: NDArray, owner: NDArray) -> NDArray:
        """Whether an object of larger priority makes that a surface is not there."""
        others = inside.copy()
        others[np.arange(len(owner)), owner] = False
        priority = np.where(others, self.table.priority, np.iinfo(np.int64).min)
        return priority.max(axis=1) > self.table.priority[owner]

    def _refracted(
        self, rays: Rays, hits: Hits, toward: Floats, rows: NDArray, rng: np.random.Generator
    ) -> tuple[NDArray, Floats]:
        """Whether light goes through a dielectric's surface, and its direction then."""
        here, direction, toward = hits.owner[rows], rays.direction[rows], toward[rows]
        entered = rays.inside[rows].copy()
        index = np.append(self.table.ior, 1.0)
        n1 = index[self._medium(entered)]
        flipped = ~entered[np.arange(len(here)), here]
        entered[np.arange(len(here)), here] = flipped
        n2 = index[self._medium(entered)]
        hidden = self._hidden(rays.inside[rows], here)
        n2 = np.where(hidden, n1, n2)
        cosine = np.clip(-_dot(direction, toward), 1e-12, 1.0)
        ratio = n1 / n2
        squared = 1.0 - ratio**2 * (1.0 - cosine**2)
        inner = np.sqrt(np.maximum(squared, 0.0))
        parallel = (n2 * cosine - n1 * inner) / (n2 * cosine + n1 * inner)
        across = (n1 * cosine - n2 * inner) / (n1 * cosine + n2 * inner)
        reflectance = np.where(squared <= 0.0, 1.0, 0.5 * (parallel**2 + across**2))
        reflectance = np.where(hidden, 0.0, reflectance)
        bent = ratio[:, None] * direction + (ratio * cosine - inner)[:, None] * toward
        bent = np.where(hidden[:, None], direction, bent)
        return rng.random(len(here)) >= reflectance, bent


def _dot(a: Floats, b: Floats) -> Floats:
    return np.einsum("ij,ij->i", a, b)


def _flat(mesh):
    import trimesh

    return trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)


def _corner_normals(item: pr.SceneObject) -> Floats:
    if not item.smooth:
        return np.repeat(np.asarray(item.mesh.face_normals)[:, None], 3, axis=1)
    shading = item.shading_normals
    return shading.normal[shading.faces]


def _cosine(normal: Floats, rng: np.random.Generator) -> Floats:
    """Directions by the cosine about normals: a point of the unit sphere on top of each."""
    onto = rng.standard_normal(normal.shape)
    onto = normal + onto / np.linalg.norm(onto, axis=1, keepdims=True)
    return onto / np.linalg.norm(onto, axis=1, keepdims=True)


def _frame(axis: Floats) -> Floats:
    u = np.cross(axis, np.eye(3)[np.abs(axis).argmin()])
    u /= np.linalg.norm(u)
    return np.array([u, np.cross(axis, u), axis])


def _cap(axis: Floats, low: float, high: float, n: int, rng: np.random.Generator) -> Floats:
    """Uniform directions whose cosine to an axis is between two."""
    z, azimuth = rng.uniform(low, high, n), rng.uniform(0.0, 2 * np.pi, n)
    across = np.sqrt(1.0 - z * z)
    return np.column_stack([across * np.cos(azimuth), across * np.sin(azimuth), z]) @ _frame(axis)


def _rays(
    tracer: Tracer, emitter: pr.Emitter, n: int, aimed: bool, rng: np.random.Generator
) -> tuple[Floats, Floats, Floats]:
    """Origins, directions and the flux that all n rays share, W (n, 3)."""
    if emitter.point is not None:
        return _from_point(tracer, emitter, n, aimed, rng)
    if emitter.surface is not None:
        return _from_surface(emitter, n, 0.5, rng)
    return _from_afar(tracer, emitter, n, aimed, rng)


def _from_point(tracer, emitter, n, aimed, rng):
    position = emitter.point
    centre, radius = tracer.interest
    away = centre - position
    distance = np.linalg.norm(away)
    cosine = np.sqrt(1.0 - (radius / distance) ** 2)
    low, high = (cosine, 1.0) if aimed else (-1.0, cosine)
    direction = _cap(away / distance, low, high, n, rng)
    # Intensity, by the definitions of the emitters.
    if isinstance(emitter, pr.SpotEmitter):
        outer, inner = (np.cos(np.radians(a)) for a in (emitter.outer_angle, emitter.inner_angle))
        fall = np.clip((direction @ emitter.direction - outer) / (inner - outer), 0.0, 1.0) ** 2
        solid = 2 * np.pi * (1 - inner + (inner - outer) / 3)
        intensity = fall[:, None] * np.asarray(emitter.power) / solid
    else:
        intensity = np.tile(np.asarray(emitter.power) / (4 * np.pi), (n, 1))
    return np.tile(position, (n, 1)), direction, intensity * 2 * np.pi * (high - low)


def _from_surface(emitter, n, share, rng):
    mesh = emitter.surface.mesh
    corners = np.asarray(mesh.triangles)
    cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    area = 0.5 * np.linalg.norm(cross, axis=1)
    face = rng.choice(len(area), n, p=area / area.sum())
    u, v = np.sqrt(rng.random(n))[:, None], rng.random(n)[:, None]
    a, b, c = corners[face].transpose(1, 0, 2)
    normal = cross[face] / (2.0 * area[face][:, None])
    origin = (1 - u) * a + u * (1 - v) * b + u * v * c + 1e-6 * normal
    radiance = emitter.surface_radiance(np.zeros(1, dtype=bool))
    # Both shares of the particles leave alike, with half the flux each.
    return origin, _cosine(normal, rng), np.tile(share * np.pi * area.sum() * radiance, (n, 1))


def _from_afar(tracer, emitter, n, aimed, rng):
    (middle, radius), (centre, small) = tracer.whole, tracer.interest
    if isinstance(emitter, pr.EnvironmentEmitter):
        direction = _cap(np.array([0.0, 0.0, 1.0]), -1.0, 1.0, n, rng)
        per_area = 4 * np.pi * np.asarray(emitter.radiance)
    else:
        direction = np.tile(np.asarray(emitter.direction), (n, 1))
        per_area = np.asarray(emitter.irradiance)
    # A disc across the ray, around the sphere of interest or around all but without that.
    aside = rng.standard_normal((n, 3))
    aside -= _dot(aside, direction)[:, None] * direction
    aside /= np.linalg.norm(aside, axis=1, keepdims=True)
    size, around = (small, centre) if aimed else (radius, middle)
    origin = around + size * np.sqrt(rng.random(n))[:, None] * aside
    flux = np.tile(per_area * np.pi * size**2, (n, 1))
    if not aimed:
        apart = origin - centre
        apart -= _dot(apart, direction)[:, None] * direction
        flux[np.linalg.norm(apart, axis=1) < small] = 0.0
    origin = origin - _dot(origin - middle, direction)[:, None] * direction
    return origin - 2.0 * radius * direction, direction, flux
