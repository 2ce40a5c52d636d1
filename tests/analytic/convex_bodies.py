"""Rays through convex bodies that overlap, each a set of half-spaces, without stacks of media.

The medium at a point is that of the largest priority among the bodies that the point lies in, so it
is looked up anew in the middle of every piece of a ray between two faces. There is a surface where
the media on both sides differ.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from tests.analytic.interface import Floats

# Pieces of rays shorter than this lie at corners where faces meet.
_SHORT = 1e-9


@dataclass(frozen=True)
class Body:
    """Points x with `normals` (m, 3) · x ≤ `heights` (m,), and what they are of.

    An opaque body has no index, and ends rays.
    """

    normals: Floats
    heights: Floats
    ior: float | None = None
    priority: int = 0
    absorption: Floats | float = 0.0
    tint: Floats | float = 1.0


@dataclass(frozen=True)
class Path:
    """A ray, the flux that it carries of 1, radiance over it, and what it went through before."""

    origin: Floats
    direction: Floats
    flux: Floats
    radiance: float = 1.0
    length: float = 0.0
    bounces: int = 0


def paths_to_opaque(
    bodies: list[Body], start: Path, max_bounces: int, least: float = 0.0
) -> Iterator[Path]:
    """Yield the ends on opaque bodies of all paths from a ray, by reflection and refraction.

    Paths whose flux times radiance is less than `least` in all channels are not followed.
    """
    met = next_surface(bodies, start)
    if met is None:
        return
    end, body, (before, beyond) = met
    if body.ior is None:
        yield end
        return
    if end.bounces == max_bounces:
        return
    for path in scattered(end, normal_at(body, end), before, beyond, body.tint):
        if (path.flux * path.radiance).max() >= least:
            yield from paths_to_opaque(bodies, path, max_bounces, least)


def next_surface(bodies: list[Body], path: Path) -> tuple[Path, Body, tuple[float, float]] | None:
    """End of a ray at the next surface, its body, and the indices before and beyond it."""
    crossings = sorted((t, i) for i, body in enumerate(bodies) for t in crossed(body, path))
    distance = np.array([0.0, *(t for t, _ in crossings), np.inf])
    flux = path.flux
    for (before, here, beyond), (_, i) in zip(
        zip(distance[:-2], distance[1:-1], distance[2:], strict=True), crossings, strict=True
    ):
        inner = medium_at(bodies, path, before, here)
        flux = flux * np.exp(-np.multiply(inner.absorption, here - before))
        outer = medium_at(bodies, path, here, min(beyond, here + 1.0))
        if bodies[i].ior is None or inner is not outer:
            end = replace(
                path,
                origin=path.origin + here * path.direction,
                flux=flux,
                length=path.length + here,
            )
            return end, bodies[i], (inner.ior, outer.ior)
    return None


def crossed(body: Body, path: Path) -> list[float]:
    """Distances along a ray at which it enters and leaves a body, beyond its origin."""
    rate = body.normals @ path.direction
    t = (body.heights - body.normals @ path.origin) / rate
    enter, leave = t[rate < 0.0].max(), t[rate > 0.0].min()
    return [x for x in (enter, leave) if x > _SHORT] if enter < leave else []


AIR = Body(np.empty((0, 3)), np.empty(0), ior=1.0)


def medium_at(bodies: list[Body], path: Path, first: float, last: float) -> Body:
    """Body that rules in the middle of a piece of a ray."""
    point = path.origin + 0.5 * (first + last) * path.direction
    around = [
        body
        for body in bodies
        if body.ior is not None and (body.normals @ point < body.heights).all()
    ]
    return max(around, key=lambda body: body.priority, default=AIR)


def normal_at(body: Body, path: Path) -> Floats:
    """Normal of a body where a ray meets it, against the ray."""
    face = np.abs(body.normals @ path.origin - body.heights).argmin()
    normal = body.normals[face]
    return -normal * np.sign(normal @ path.direction)


def scattered(
    path: Path, normal: Floats, n1: float, n2: float, tint: Floats | float
) -> Iterator[Path]:
    """Yield the reflected and the refracted ray at a surface, by Snell and Fresnel."""
    d, path = path.direction, replace(path, bounces=path.bounces + 1)
    cos_i = -d @ normal
    mirrored = d + 2.0 * cos_i * normal
    sin2_t = (n1 / n2) ** 2 * (1.0 - cos_i**2)
    if sin2_t >= 1.0:
        yield replace(path, direction=mirrored)
        return
    cos_t = np.sqrt(1.0 - sin2_t)
    s = (n1 * cos_i - n2 * cos_t) / (n1 * cos_i + n2 * cos_t)
    p = (n1 * cos_t - n2 * cos_i) / (n1 * cos_t + n2 * cos_i)
    reflected = 0.5 * (s**2 + p**2)
    yield replace(path, direction=mirrored, flux=reflected * path.flux)
    yield replace(
        path,
        direction=n1 / n2 * d + (n1 / n2 * cos_i - cos_t) * normal,
        flux=(1.0 - reflected) * np.multiply(tint, path.flux),
        radiance=path.radiance * (n1 / n2) ** 2,
    )
