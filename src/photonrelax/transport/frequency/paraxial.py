"""Paraxial rays: rays that carry the linear map of their neighbourhood through a scene.

The map is the operator K of `operators` on the frequencies of the light as it left its source. It
is the product of the operators of all events since: free flight, reflection and refraction, the
last two with the derivatives of the normals (Durand et al. 2005; Belcour et al. 2013). Any path
will do, whether it starts at an emitter or at a camera.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace

import numpy as np
from numpy.typing import NDArray

from ..._ext.transport.materials import Materials
from ..._util.validation import Floats
from ...scene.scene import Scene
from ..curvature import NormalDerivatives
from ..frequency import operators
from ..media import Media
from ..optics import from_behind, reflect, refract
from ..raycast import Intersections

# Sines of incidence below this leave the plane of incidence undefined: any will do.
_MIN_SINE = 1e-12
# The axes that follow each.
_NEXT, _AFTER = [1, 2, 0], [2, 0, 1]


@dataclass(frozen=True, eq=False)
class ParaxialRays:
    """Rays with frames across them, and the operators of their paths so far.

    Attributes
    ----------
    origin, direction : (n, 3)
        m, unit vectors.
    across : (n, 2, 3)
        Unit vectors perpendicular to the ray.
    operator : (n, 4, 4)
        From the frequencies of the light as it left its source to those along `across`.
    origin_offset : (n, 3)
        `Intersections.offset` of where the ray starts, NaN in free space.
    throughput : (n, 3)
        Transmitted share of the light, without tints and the reflectances of mirrors that are the
        same for all rays of a path.
    media : (n,) uint64
        Stack of the media that the ray is in.
    """

    origin: Floats
    direction: Floats
    across: Floats
    operator: Floats
    origin_offset: Floats
    throughput: Floats
    media: Media

    def __getitem__(self, rows: NDArray) -> ParaxialRays:
        return ParaxialRays(**{f.name: getattr(self, f.name)[rows] for f in fields(self)})


def emitted_rays(
    origin: Floats, direction: Floats, across: Floats, *, travelled: float, media: int
) -> ParaxialRays:
    """Rays in media, whose origins lie at a distance `travelled`, m, from their source."""
    n = len(origin)
    operator = operators.propagate(np.full(n, travelled), 2)
    free, stack = np.full((n, 3), np.nan), np.full(n, media, dtype=np.uint64)
    return ParaxialRays(origin, direction, across, operator, free, np.ones((n, 3)), stack)


class ParaxialOptics:
    """Propagation and scattering of paraxial rays in a scene of `materials`."""

    def __init__(self, scene: Scene) -> None:
        self.materials = Materials(scene.material_table())
        self._derivatives = NormalDerivatives(scene.surfaces)

    def propagate(self, rays: ParaxialRays, hits: Intersections) -> ParaxialRays:
        """Rays at their hits: the operator of free flight, and the absorption on the way."""
        operator = operators.propagate(hits.distance, 2) @ rays.operator
        media, transmitted = self.materials.arrive(rays.direction, hits, rays.media)
        throughput = transmitted * rays.throughput
        return replace(
            rays, origin=hits.position, operator=operator, throughput=throughput, media=media
        )

    def scatter(
        self, rays: ParaxialRays, hits: Intersections, reflected: NDArray[np.bool_]
    ) -> ParaxialRays:
        """Rays that leave specular surfaces, `reflected` (n,) or else refracted.

        Rays that cannot be refracted go straight on.
        """
        at = self.materials.interfaces(rays.direction, hits, rays.media)
        incidence = _Incidence.of(rays, at.normal)
        side = np.where(at.is_shading, _side(rays.direction, hits), 0.0)
        shape = side[:, np.newaxis, np.newaxis] * incidence.along(self._derivatives.at(hits))
        direction = _scattered(rays.direction, at.normal, at.n1, at.n2, reflected)
        cosine_out = np.abs(_dot(direction, at.normal))
        operator = np.where(
            reflected[:, np.newaxis, np.newaxis],
            operators.reflect(incidence.cosine, shape),
            operators.refract(incidence.cosine, cosine_out, at.n1 / at.n2, shape),
        )
        share = np.where(reflected, at.reflected, 1.0 - at.reflected)
        return ParaxialRays(
            rays.origin,
            direction,
            incidence.across(direction),
            operator @ incidence.operator,
            hits.offset,
            share[:, np.newaxis] * at.rising * rays.throughput,
            np.where(reflected, rays.media, at.beyond),
        )


def at_receivers(rays: ParaxialRays, hits: Intersections) -> tuple[Floats, Floats, Floats]:
    """Light at the surfaces that receive it.

    Returns
    -------
    normal : (n, 3)
        Geometric normals on the side of the light.
    axes : (n, 2, 3)
        Unit vectors along the surface, in the plane of incidence and perpendicular to it.
    operator : (n, 4, 4)
        From the frequencies of the light as it left its source to those along the axes.
    """
    normal = _side(rays.direction, hits)[:, np.newaxis] * hits.geometric_normal
    incidence = _Incidence.of(rays, normal)
    return normal, incidence.axes, operators.project(incidence.cosine, 2) @ incidence.operator


@dataclass(frozen=True, eq=False)
class _Incidence:
    """Rays in the frames of their planes of incidence: tangent × normal = sagittal."""

    normal: Floats
    tangent: Floats
    sagittal: Floats
    cosine: Floats
    operator: Floats

    @classmethod
    def of(cls, rays: ParaxialRays, normal: Floats) -> _Incidence:
        """Rotate the frames across rays into their planes of incidence."""
        sagittal = _cross(rays.direction, normal)
        sine = np.linalg.norm(sagittal, axis=1, keepdims=True)
        upright = sine < _MIN_SINE
        sagittal = np.where(upright, rays.across[:, 1], sagittal / np.where(upright, 1.0, sine))
        tangent = _cross(normal, sagittal)
        cosine = -_dot(rays.direction, normal)
        first = cosine[:, np.newaxis] * tangent + sine * normal
        rotation = np.stack([first, sagittal], axis=1) @ np.swapaxes(rays.across, 1, 2)
        operator = operators.rotate(rotation) @ rays.operator
        return cls(normal, tangent, sagittal, cosine, operator)

    @property
    def axes(self) -> Floats:
        """Unit vectors (n, 2, 3) along the surface."""
        return np.stack([self.tangent, self.sagittal], axis=1)

    def along(self, derivative: Floats) -> Floats:
        """Derivatives (n, 3, 3) of normals in the axes along the surface, (n, 2, 2)."""
        shape: Floats = self.axes @ derivative @ np.swapaxes(self.axes, 1, 2)
        return shape

    def across(self, direction: Floats) -> Floats:
        """Frames (n, 2, 3) across rays that leave in the plane of incidence."""
        up, ahead = _dot(direction, self.normal), _dot(direction, self.tangent)
        first = np.abs(up)[:, np.newaxis] * self.tangent
        first -= (np.sign(up) * ahead)[:, np.newaxis] * self.normal
        return np.stack([first, self.sagittal], axis=1)


def _scattered(
    direction: Floats, normal: Floats, n1: Floats, n2: Floats, reflected: NDArray[np.bool_]
) -> Floats:
    """Reflected or else refracted directions (n, 3); unchanged where there is no refraction."""
    mirrored = reflect(direction, normal, n_threads=1)
    refracted, exists = refract(direction, normal, n1, n2, n_threads=1)
    refracted = np.where(exists[:, np.newaxis], refracted, direction)
    return np.where(reflected[:, np.newaxis], mirrored, refracted)


def _side(direction: Floats, hits: Intersections) -> Floats:
    """Signs (n,) that turn geometric normals to the side of the light."""
    return np.where(from_behind(direction, hits.geometric_normal), -1.0, 1.0)


def _dot(a: Floats, b: Floats) -> Floats:
    dots: Floats = np.einsum("ni,ni->n", a, b)
    return dots


def _cross(a: Floats, b: Floats) -> Floats:
    """Vector products (n, 3); for few vectors `np.cross` takes several times as long."""
    product: Floats = np.take(a, _NEXT, axis=1) * np.take(b, _AFTER, axis=1)
    product -= np.take(a, _AFTER, axis=1) * np.take(b, _NEXT, axis=1)
    return product
