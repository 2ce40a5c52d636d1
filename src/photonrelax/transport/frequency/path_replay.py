"""Rays sent the way a photon went: along the same surfaces, reflected and refracted as it was.

Along with a ray goes the operator (see `spectrum`) of all that has happened to it.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace

import numpy as np
from numpy.typing import NDArray

from ..._util.parallel import thread_count
from ..._util.validation import Floats
from ...scene.materials import DIELECTRIC
from ...scene.scene import Scene
from ..frequency import operators
from ..optics import beer_lambert, fresnel, reflect, refract
from ..raycast import Intersections, RayCaster
from .curvature import NormalGradients

# Rays this near to the normal have any plane for their plane of incidence.
_LEAST_SINE = 1e-12
# Photons are followed this many at a time.
CHUNK = 4096


@dataclass(frozen=True, eq=False)
class Ways:
    """Which way n photons went, to the first diffuse surface they met.

    Attributes
    ----------
    objects : (n, depth) int32
        What was met, the diffuse receiver last; -1 beyond.
    reflected : (n, depth) bool
        Whether the light stayed on its side there.
    length : (n,) intp
        How many objects were met.
    """

    objects: NDArray[np.int32]
    reflected: NDArray[np.bool_]
    length: NDArray[np.intp]

    def __len__(self) -> int:
        return len(self.length)

    def __getitem__(self, rows: NDArray | slice) -> Ways:
        return Ways(**{f.name: getattr(self, f.name)[rows] for f in fields(self)})


@dataclass(frozen=True, eq=False)
class Beams:
    """Rays with frames across them, and what has happened to them so far.

    Attributes
    ----------
    origin, direction : (n, 3)
        m, unit vectors.
    across : (n, 2, 3)
        Unit vectors across the ray.
    operator : (n, 4, 4)
        On the frequencies of the light as it left the emitter.
    origin_normal : (n, 3)
        Normal of the surface left, NaN at the emitter.
    throughput : (n, 3)
        Share of the light that has come this far on this way.
    medium : (n,) int32
        Object that the ray is in, -1 in none.
    """

    origin: Floats
    direction: Floats
    across: Floats
    operator: Floats
    origin_normal: Floats
    throughput: Floats
    medium: NDArray[np.int32]

    def __getitem__(self, rows: NDArray) -> Beams:
        return Beams(**{f.name: getattr(self, f.name)[rows] for f in fields(self)})


@dataclass(frozen=True, eq=False)
class Landings:
    """Where rays came to the diffuse surface that ends their way; NaN for those that strayed.

    Attributes
    ----------
    position, normal : (n, 3)
        m, and the normal on the side of the light.
    axes : (n, 2, 3)
        Unit vectors along the surface: in the plane of incidence and across it.
    operator : (n, 4, 4)
        From the frequencies of the light as it left the emitter to those along `axes`.
    throughput : (n, 3)
        Share of the light that has come this way.
    """

    position: Floats
    normal: Floats
    axes: Floats
    operator: Floats
    throughput: Floats

    def __getitem__(self, rows: NDArray | slice) -> Landings:
        return Landings(**{f.name: getattr(self, f.name)[rows] for f in fields(self)})


def started(origin: Floats, direction: Floats, across: Floats, travelled: float) -> Beams:
    """Return beams that have travelled freely from their emitter, m."""
    n = len(origin)
    operator = operators.travel(np.full(n, travelled), 2)
    nowhere, medium = np.full((n, 3), np.nan), np.full(n, -1, dtype=np.int32)
    return Beams(origin, direction, across, operator, nowhere, np.ones((n, 3)), medium)


class Follower:
    """A scene ready to send rays the way photons went."""

    def __init__(self, scene: Scene, caster: RayCaster, n_threads: int | None = None) -> None:
        self._caster = caster
        self._materials = scene.material_table()
        self._gradients = NormalGradients(scene.objects)
        self._n_threads = thread_count(n_threads)

    def follow(self, beams: Beams, ways: Ways) -> Landings:
        """Return where beams come along the given ways, a row each."""
        n = len(ways)
        shapes = ((n, 3), (n, 3), (n, 2, 3), (n, 4, 4), (n, 3))
        out = Landings(*(np.full(shape, np.nan) for shape in shapes))
        rows = np.arange(n)
        for event in range(int(ways.length.max(initial=0))):
            hits = self._caster.intersect(
                beams.origin,
                beams.direction,
                origin_normal=beams.origin_normal,
                n_threads=self._n_threads,
            )
            true = hits.object_id == ways.objects[rows, event]
            rows, beams, hits = rows[true], beams[true], hits[true]
            beams = self._moved(beams, hits)
            ends = ways.length[rows] == event + 1
            _land(out, rows[ends], beams[ends], hits[ends])
            rows, beams, hits = rows[~ends], beams[~ends], hits[~ends]
            beams = self._past(beams, hits, ways.reflected[rows, event])
        return out

    def _past(self, beams: Beams, hits: Intersections, reflected: NDArray[np.bool_]) -> Beams:
        """Take beams past the smooth surfaces they have come to."""
        here, beyond = self._indices(beams.direction, hits)
        normal, leans = _facing_normal(beams.direction, hits, here, beyond)
        incidence = _Incidence.of(beams, normal)
        shape = incidence.shape(self._gradients.at(hits), _side(beams.direction, hits), leans)
        away = reflect(beams.direction, normal, n_threads=1)
        through = _through(beams.direction, normal, here, beyond)
        direction = np.where(reflected[:, np.newaxis], away, through)
        cosine_out = np.abs(_dot(direction, normal))
        operator = np.where(
            reflected[:, np.newaxis, np.newaxis],
            operators.reflect(incidence.cosine, shape),
            operators.refract(incidence.cosine, cosine_out, here / beyond, shape),
        )
        kept = fresnel(incidence.cosine, here, beyond, n_threads=1)
        kept = np.where(reflected, kept, 1.0 - kept)
        return Beams(
            beams.origin,
            direction,
            incidence.across(direction),
            operator @ incidence.operator,
            hits.geometric_normal,
            np.where(self._is_glass(hits), kept, 1.0)[:, np.newaxis] * beams.throughput,
            self._medium_past(beams.direction, hits, reflected),
        )

    def _moved(self, beams: Beams, hits: Intersections) -> Beams:
        operator = operators.travel(hits.distance, 2) @ beams.operator
        inside = (beams.medium >= 0)[:, np.newaxis]
        absorption = np.where(inside, self._materials.absorption[beams.medium], 0.0)
        left = beer_lambert(absorption, hits.distance, n_threads=1)
        throughput = left * beams.throughput
        return replace(beams, origin=hits.position, operator=operator, throughput=throughput)

    def _is_glass(self, hits: Intersections) -> NDArray[np.bool_]:
        glass: NDArray[np.bool_] = self._materials.kind[hits.object_id] == DIELECTRIC
        return glass

    def _medium_past(
        self, direction: Floats, hits: Intersections, reflected: NDArray[np.bool_]
    ) -> NDArray[np.int32]:
        """Return the object that rays are in when they have passed a smooth surface."""
        from_inside = _dot(direction, hits.geometric_normal) > 0.0
        inside = self._is_glass(hits) & (from_inside == reflected)
        return np.where(inside, hits.object_id, -1).astype(np.int32)

    def _indices(self, direction: Floats, hits: Intersections) -> tuple[Floats, Floats]:
        """Return the index of refraction on the side of the light and beyond; mirrors have 1."""
        table, object_id = self._materials, hits.object_id
        glass = self._is_glass(hits)
        inner = np.where(glass, table.ior[object_id], 1.0)
        outer = np.where(glass, table.exterior_ior[object_id], 1.0)
        inside = _dot(direction, hits.geometric_normal) > 0.0
        return np.where(inside, inner, outer), np.where(inside, outer, inner)


@dataclass(frozen=True, eq=False)
class _Incidence:
    """Beams as seen in their planes of incidence: tangent × normal = sagittal."""

    normal: Floats
    tangent: Floats
    sagittal: Floats
    cosine: Floats
    operator: Floats

    @classmethod
    def of(cls, beams: Beams, normal: Floats) -> _Incidence:
        """Turn the frames across beams into their planes of incidence."""
        sagittal = np.cross(beams.direction, normal)
        sine = np.linalg.norm(sagittal, axis=1, keepdims=True)
        upright = sine < _LEAST_SINE
        sagittal = np.where(upright, beams.across[:, 1], sagittal / np.where(upright, 1.0, sine))
        tangent = np.cross(normal, sagittal)
        cosine = -_dot(beams.direction, normal)
        first = cosine[:, np.newaxis] * tangent + sine * normal
        rotation = np.stack([first, sagittal], axis=1) @ np.swapaxes(beams.across, 1, 2)
        operator = operators.rotate(rotation) @ beams.operator
        return cls(normal, tangent, sagittal, cosine, operator)

    @property
    def axes(self) -> Floats:
        return np.stack([self.tangent, self.sagittal], axis=1)

    def shape(self, gradient: Floats, side: Floats, leans: NDArray[np.bool_]) -> Floats:
        """Return how the normal that faces the light turns along the axes, (n, 2, 2)."""
        along: Floats = self.axes @ gradient @ np.swapaxes(self.axes, 1, 2)
        turning: Floats = np.where(leans, side, 0.0)[:, np.newaxis, np.newaxis] * along
        return turning

    def across(self, direction: Floats) -> Floats:
        """Return the frames across what leaves in the plane of incidence."""
        up, ahead = _dot(direction, self.normal), _dot(direction, self.tangent)
        first = np.abs(up)[:, np.newaxis] * self.tangent
        first -= (np.sign(up) * ahead)[:, np.newaxis] * self.normal
        return np.stack([first, self.sagittal], axis=1)


def _land(out: Landings, rows: NDArray, beams: Beams, hits: Intersections) -> None:
    normal = _side(beams.direction, hits)[:, np.newaxis] * hits.geometric_normal
    incidence = _Incidence.of(beams, normal)
    out.position[rows] = hits.position
    out.normal[rows] = normal
    out.axes[rows] = incidence.axes
    out.operator[rows] = operators.project(incidence.cosine, 2) @ incidence.operator
    out.throughput[rows] = beams.throughput


def _facing_normal(
    direction: Floats, hits: Intersections, here: Floats, beyond: Floats
) -> tuple[Floats, NDArray[np.bool_]]:
    """Return the normals light meets surfaces with, and whether these are the shading normals.

    The shading normal serves where the reflection about it stays before the face and the
    refraction goes behind, as in tracing.
    """
    side = _side(direction, hits)[:, np.newaxis]
    face, shading = side * hits.geometric_normal, side * hits.shading_normal
    leans = _dot(direction, shading) < 0.0
    normal = np.where(leans[:, np.newaxis], shading, face)
    leans &= _dot(reflect(direction, normal, n_threads=1), face) > 0.0
    bent, refracts = refract(direction, normal, here, beyond, n_threads=1)
    leans &= ~refracts | (_dot(bent, face) < 0.0)
    return np.where(leans[:, np.newaxis], shading, face), leans


def _through(direction: Floats, normal: Floats, here: Floats, beyond: Floats) -> Floats:
    """Return refracted directions; where there are none, rays that go on and stray."""
    bent, refracts = refract(direction, normal, here, beyond, n_threads=1)
    return np.where(refracts[:, np.newaxis], bent, direction)


def _side(direction: Floats, hits: Intersections) -> Floats:
    """Return the sign that turns the normal of a face to the side of the light."""
    return np.where(_dot(direction, hits.geometric_normal) > 0.0, -1.0, 1.0)


def _dot(a: Floats, b: Floats) -> Floats:
    dots: Floats = np.einsum("ni,ni->n", a, b)
    return dots
