"""What is measured: photons of the prism's caustic, its camera's hit points, awkward points."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from functools import cache, lru_cache

import numpy as np
from numpy.typing import NDArray

import photonrelax as pr
from photonrelax import camera, gallery, raycast
from photonrelax.structure import emitter_range

Floats = NDArray[np.float64]

# The share of the photons aimed at the prism that is stored, from below.
STORED = 0.31
_N_COINCIDENT = 0.15


@cache
def scene(pixels: int = 600) -> pr.Scene:
    """Return the prism, whose light spreads over a factor of some thousand in density."""
    if pixels != 600:
        whole = scene()
        return replace(whole, camera=replace(whole.camera, width=pixels, height=pixels))
    return gallery.scene("prism")


@lru_cache(maxsize=2)
def caustic(n: int) -> pr.PhotonMap:
    """Return exactly n photons of the prism."""
    photons = pr.trace_photons(scene(), int(n / STORED) + 1000)
    if len(photons) < n:
        raise RuntimeError(f"{n} photons should have been stored, but {len(photons)} were")
    density = photons.emitter_density * (n / len(photons))
    return photons.replace(emitter_density=density).subset(slice(0, n))


@dataclass(frozen=True, eq=False)
class Sheet:
    """Photons and what limits the constrained search to their sheet.

    Attributes
    ----------
    position : (n, 3) float array
    coords : (n, 2) or (n, 3) float array
        Emitter coordinates.
    radius : (n,) float array
        Range over them (SJ13 Eq. 1).
    """

    position: Floats
    coords: Floats
    radius: Floats

    @property
    def points(self) -> Floats:
        """All axes, those of the metric first."""
        return np.hstack([self.position, self.coords])


def sheet(n: int, n_axes: int) -> Sheet:
    """Return the caustic over directions (6 axes) or over an equal-area chart of them (5)."""
    photons = caustic(n)
    coords = photons.emitter_coords if n_axes == 6 else equal_area_chart(photons.emitter_coords)
    return Sheet(photons.position, coords, emitter_range(photons, pr.StructureSettings()))


def equal_area_chart(directions: Floats) -> Floats:
    """Return unit vectors (n, 3) on a plane on which equal areas stay equal (Lambert), (n, 2).

    This is how a plane emitter would hold the same photons.
    """
    axis = directions.mean(axis=0)
    axis /= np.linalg.norm(axis)
    u = np.cross(axis, np.eye(3)[np.abs(axis).argmin()])
    u /= np.linalg.norm(u)
    scale = np.sqrt(2.0 / (1.0 + directions @ axis))
    return scale[:, np.newaxis] * (directions @ np.column_stack([u, np.cross(axis, u)]))


@lru_cache(maxsize=2)
def hit_points(pixels: int) -> camera.HitPoints:
    """Return what the prism's camera sees at 4 samples a pixel, in the order of the pixels."""
    seen = scene(pixels)
    hits, _ = camera.trace_hit_points(
        seen, raycast.RayCaster(seen.objects), seen.camera, range(pixels), supersampling=2
    )
    order = np.argsort(hits.pixel, kind="stable")
    rows = {field.name: getattr(hits, field.name)[order] for field in fields(hits)}
    return camera.HitPoints(**rows)


def degenerate(kind: str, n: int) -> pr.PhotonMap:
    """Return a caustic of n photons with its positions made awkward.

    Parameters
    ----------
    kind : {"generic", "coincident", "collinear", "lattice"}
        As they are; 15 % of them at one point; all on a line; all on a square lattice.
    n : int
        Photons.
    """
    photons = caustic(n)
    return photons.replace(position=_MOVED[kind](photons.position.copy()))


def _coincident(position: Floats) -> Floats:
    position[: int(_N_COINCIDENT * len(position))] = np.median(position, axis=0)
    return position


def _collinear(position: Floats) -> Floats:
    position[:, 1:] = position[0, 1:]
    return position


def _lattice(position: Floats) -> Floats:
    side = int(np.ceil(np.sqrt(len(position))))
    cells = np.stack(np.divmod(np.arange(len(position)), side), axis=1)
    position[:, :2] = cells / side
    position[:, 2] = 0.0
    return position


# The first is the others' measure.
_MOVED = {
    "generic": lambda position: position,
    "coincident": _coincident,
    "collinear": _collinear,
    "lattice": _lattice,
}
DEGENERATE = tuple(_MOVED)
