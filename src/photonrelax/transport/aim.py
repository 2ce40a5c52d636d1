"""The emission regions of each emitter: the outlines of the groups of casters it may light.

Outlines that overlap count once: a photon of a region that lies in an earlier one, too, is not
emitted. So the regions of an emitter are a partition of the union of the outlines. Those of nested
spheres, the smallest first, are a ball and the shells around it.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from .._util.validation import Floats
from ..scene.casters import SAVING
from ..scene.emission_region import AREA, SUN, EmissionRegion, Sphere
from ..scene.emitters import Emitter
from ..scene.sky_map import LUMINANCE

Bools = NDArray[np.bool_]

# Components of frames of one emitter differ by rounding alone.
_SAME_FRAME = 1e-9


def aimed_regions(
    emitter: Emitter, targets: tuple[Sphere, ...], around: Sphere, scene: Sphere, offset: float
) -> list[EmissionRegion]:
    """Regions of one emitter, the largest first; the one around all targets if that is as good.

    Parameters
    ----------
    emitter : Emitter
        Its regions share one chart of emitter coordinates.
    targets : tuple of Sphere
        What photons are aimed at.
    around, scene : Sphere
        Around all targets, and around all objects.
    offset : float
        As of `Emitter.emission_region`.

    Raises
    ------
    ValueError
        If they do not share one chart.
    """
    whole = emitter.emission_region(around, scene, offset)
    if len(targets) == 1:
        return [whole]
    regions = [
        _in_chart(emitter, emitter.emission_region(each, scene, offset), whole) for each in targets
    ]
    lit = _outermost([region for region in regions if region.flux.any()])
    if sum(luminance(region) for region in lit) > SAVING * luminance(whole):
        return [whole]
    return lit or regions[:1]


def nested_spheres(inner: Sphere, outer: Sphere) -> list[Sphere]:
    """Spheres from an inner one to an outer one around it, each in the next and half as large."""
    n = int(np.log2(max(outer.radius / inner.radius, 1.0)))
    spheres = []
    for radius in inner.radius * 2.0 ** np.arange(n + 1):
        if radius < outer.radius:
            along = (radius - inner.radius) / (outer.radius - inner.radius)
            centre = inner.centre + along * (outer.centre - inner.centre)
            spheres.append(Sphere(centre, float(radius)))
    return [*spheres, outer]


def nested_regions(
    emitter: Emitter, spheres: list[Sphere], scene: Sphere, offset: float
) -> list[EmissionRegion]:
    """Regions of one emitter towards nested spheres, the smallest first.

    Those are left out that are hardly smaller than the next, as from a point within both spheres.
    Arguments and errors are otherwise those of `aimed_regions`.
    """
    whole = emitter.emission_region(spheres[-1], scene, offset)
    regions = [whole]
    for sphere in spheres[-2::-1]:
        region = _in_chart(emitter, emitter.emission_region(sphere, scene, offset), whole)
        if region.flux.any() and luminance(region) <= SAVING * luminance(regions[-1]):
            regions.append(region)
    return regions[::-1]


def luminance(region: EmissionRegion) -> float:
    """Luminance of the flux that leaves through a region."""
    return float(region.flux @ LUMINANCE)


def overlapped(regions: list[EmissionRegion]) -> list[Floats]:
    """Outlines (m, 4) of the earlier regions that overlap each: centre and squared radius.

    Centres are emitter coordinates, of disks with a third one of zero. That of a region which is
    clipped is the last, with a negative square: its photons lie within it.
    """
    if len(regions) == 1 and regions[0].clip is None:
        return [np.empty((0, 4))]
    table, radius, distance = _outlines(regions)
    overlaps = _overlaps(regions, radius, distance)
    within = table * [1.0, 1.0, 1.0, -1.0]
    return [
        np.concatenate([table[:i][overlaps[i, :i]], within[i : i + (region.clip is not None)]])
        for i, region in enumerate(regions)
    ]


def _in_chart(emitter: Emitter, region: EmissionRegion, whole: EmissionRegion) -> EmissionRegion:
    """A region whose emitter coordinates are those of the whole one."""
    if region.is_plane:
        same = whole.kind == region.kind and np.abs(region.frame - whole.frame).max() < _SAME_FRAME
        if region.target is not None and whole.target is not None:
            offset = whole.frame @ (region.target - whole.target)
        else:
            offset = whole.frame[:2] @ (region.origin - whole.origin)
        region = replace(region, coords_offset=offset)
    else:
        same = not whole.is_plane and np.array_equal(region.origin, whole.origin)
    if not same:
        raise ValueError(
            "the emission regions of an emitter should be disks with one frame, or directions from "
            f"one point, but those of {type(emitter).__name__} differ by target"
        )
    return region


def _outermost(regions: list[EmissionRegion]) -> list[EmissionRegion]:
    """Regions that lie in no other, the largest first."""
    if len(regions) < 2:
        return regions
    regions = sorted(regions, key=lambda region: -region.outline[1])
    _, radius, distance = _outlines(regions)
    # Surely inside, as chords of arcs that add up are shorter. What holds it may lie in another.
    inside = distance + radius[:, np.newaxis] <= radius
    return [region for i, region in enumerate(regions) if not inside[i, :i].any()]


def _outlines(regions: list[EmissionRegion]) -> tuple[Floats, Floats, Floats]:
    """Outlines (m, 4) as of `overlapped`, radii (m,), and distances (m, m) of the centres."""
    centres, radii = zip(*(region.outline for region in regions), strict=True)
    table = np.zeros((len(regions), 4))
    table[:, : len(centres[0])], table[:, 3] = centres, np.square(radii)
    between = table[:, np.newaxis, :3] - table[:, :3]
    return table, np.array(radii), np.sqrt(np.einsum("ijk,ijk->ij", between, between))


def _overlaps(regions: list[EmissionRegion], radius: Floats, distance: Floats) -> Bools:
    """Matrix (m, m), true for regions that may have rays in common.

    Those of suns do where the nearest that any direction of the light takes their targets to one
    another is less than the sum of their radii; those of areas always may.
    """
    if regions[0].kind == AREA:
        return np.ones(distance.shape, dtype=bool)
    if regions[0].kind == SUN:
        centres = np.array([region.outline[0] for region in regions])
        along = (centres[:, np.newaxis] - centres) @ regions[0].frame[2]
        aside = np.sqrt(np.maximum(distance**2 - along**2, 0.0))
        angle = np.arccos(1.0 - regions[0].shape[1])
        turned = np.arctan2(aside, np.abs(along)) - angle
        distance = distance * np.sin(np.clip(turned, 0.0, 0.5 * np.pi))
    overlaps: Bools = distance < radius[:, np.newaxis] + radius
    return overlaps
