"""Rays through surfaces that are not there: those of dielectrics in media of larger priority."""

from __future__ import annotations

from dataclasses import fields
from functools import partial

from .._ext.transport.materials import Materials
from .._util.validation import Floats
from .media import Media
from .raycast import MAX_HIDDEN, Intersections, RayCaster


def first_hits(
    caster: RayCaster,
    materials: Materials,
    rays: tuple[Floats, Floats, Floats],
    media: Media,
    n_threads: int,
) -> tuple[Intersections, Media]:
    """First hits of rays on surfaces that are there, and the media (n,) up to them.

    Parameters
    ----------
    caster, materials : RayCaster, Materials
        Of the scene.
    rays : (n, 3), (n, 3), (n, 3)
        Origins, unit directions, and `origin_offset` as of `RayCaster.intersect`.
    media : (n,)
        Those that the rays start in.
    n_threads : int
        Threads to use.
    """
    origin, direction, offset = rays
    intersect = partial(caster.intersect, n_threads=n_threads)
    hits = intersect(origin, direction, origin_offset=offset)
    if not materials.has_hidden:
        return hits, media
    media = media.copy()
    for _ in range(MAX_HIDDEN):
        rows = materials.pass_hidden(direction, hits, media)
        if len(rows) == 0:
            break
        passed = hits[rows]
        beyond = intersect(passed.position, direction[rows], origin_offset=passed.offset)
        for column in fields(Intersections):
            getattr(hits, column.name)[rows] = getattr(beyond, column.name)
        hits.distance[rows] += passed.distance
    return hits, media
