"""Inputs: photons of the prism's caustic, hit points of its camera, degenerate photons.

Only public names of photonrelax are imported up here, so that `versions` can measure builds whose
modules lie elsewhere.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from functools import cache, lru_cache

import numpy as np
import trimesh
from numpy.typing import NDArray

import photonrelax as pr
from photonrelax import gallery

Floats = NDArray[np.float64]
Ids = NDArray[np.intp]

# Share of the photons aimed at the prism that is stored, rounded down.
STORED = 0.31
_SHARE_COINCIDENT = 0.15


@cache
def scene(pixels: int = 600) -> pr.Scene:
    """Return the prism, whose caustic varies in density by a factor of some thousand."""
    if pixels != 600:
        whole = scene()
        return replace(whole, camera=replace(whole.camera, width=pixels, height=pixels))
    return gallery.scene("prism")


@cache
def nearly_empty_scene() -> pr.Scene:
    """Return the light of the prism and a triangle that few of its rays hit."""
    triangle = trimesh.Trimesh([[2.0, 2.0, 0.0], [4.0, 2.0, 0.0], [2.0, 4.0, 0.0]], [[0, 1, 2]])
    return pr.Scene([pr.SceneObject(triangle, pr.Diffuse(0.5))], scene().emitters)


@lru_cache(maxsize=2)
def caustic(n: int) -> pr.PhotonMap:
    """Return exactly n photons of the prism, in order of emission: at random in space."""
    photons = pr.trace_photons(scene(), int(n / STORED) + 1000)
    if len(photons) < n:
        raise RuntimeError(f"{n} photons should have been stored, but {len(photons)} were")
    density = photons.emitter_density * (n / len(photons))
    return photons.replace(emitter_density=density).subset(slice(0, n))


@lru_cache(maxsize=2)
def hit_points(pixels: int) -> pr.HitPoints:
    """Hit points of the prism's camera, 4 samples a pixel, in order of the pixels.

    Without footprints, for estimates at points.
    """
    from photonrelax.transport.hit_points import trace_hit_points
    from photonrelax.transport.raycast import RayCaster

    seen = scene(pixels)
    hits, _ = trace_hit_points(
        seen, RayCaster(seen.objects), seen.camera, range(pixels), supersampling=2
    )
    order = np.argsort(hits.pixel, kind="stable")
    optional = ("footprint", "emission")
    names = [field.name for field in fields(hits) if field.name not in optional]
    return pr.HitPoints(**{name: getattr(hits, name)[order] for name in names})


# --- Morton order ---------------------------------------------------------------------------------

_BITS = 21
# Steps that move apart the bits of a 21-bit number until two zeros follow each.
_SPREAD = (
    (32, 0x1F00000000FFFF),
    (16, 0x1F0000FF0000FF),
    (8, 0x100F00F00F00F00F),
    (4, 0x10C30C30C30C30C3),
    (2, 0x1249249249249249),
)


def morton_order(points: Floats) -> Ids:
    """Return rows of points (n, 2|3) in Morton order of cubic cells, 2²¹ to the longest side.

    Coded here, as peers should not be given the order that photonrelax builds its tree from.
    """
    low = points.min(axis=0)
    cells = (points - low) * ((2**_BITS - 1) / max(np.ptp(points, axis=0).max(), 1e-300))
    code = np.zeros(len(points), dtype=np.uint64)
    for axis, column in enumerate(cells.astype(np.uint64).T):
        code |= _spread(column) << np.uint64(axis)
    return np.argsort(code, kind="stable")


def _spread(bits: NDArray[np.uint64]) -> NDArray[np.uint64]:
    for shift, mask in _SPREAD:
        bits = (bits | (bits << np.uint64(shift))) & np.uint64(mask)
    return bits


def in_morton_order(photons: pr.PhotonMap) -> pr.PhotonMap:
    """Return photons in Morton order of their positions: the best order for every search."""
    return photons.subset(morton_order(photons.position))


# --- constrained searches -------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class RangedPhotons:
    """Points and ranges of the constrained search.

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


def ranged(photons: pr.PhotonMap, n_axes: int = 6) -> RangedPhotons:
    """Return photons with the ranges of structure detection.

    Over directions (6 axes) or over an equal-area chart of them (5).
    """
    settings, coords = pr.StructureSettings(), photons.emitter_coords
    radius = settings.range_scale * np.sqrt(settings.k / (np.pi * photons.emitter_density))
    return RangedPhotons(
        photons.position, coords if n_axes == 6 else equal_area_chart(coords), radius
    )


def equal_area_chart(directions: Floats) -> Floats:
    """Return unit vectors (n, 3) on a plane that keeps areas equal (Lambert), (n, 2).

    These are emitter coordinates as a plane emitter has them.
    """
    axis = directions.mean(axis=0)
    axis /= np.linalg.norm(axis)
    u = np.cross(axis, np.eye(3)[np.abs(axis).argmin()])
    u /= np.linalg.norm(u)
    scale = np.sqrt(2.0 / (1.0 + directions @ axis))
    return scale[:, np.newaxis] * (directions @ np.column_stack([u, np.cross(axis, u)]))


# --- degenerate photons ---------------------------------------------------------------------------


def degenerate(kind: str, n: int) -> pr.PhotonMap:
    """Return n photons of degenerate positions; neighbours on the emitter stay neighbours.

    Parameters
    ----------
    kind : {"generic", "coincident", "collinear", "lattice", "rounded"}
        A caustic as it is; with 15 % of its photons at one point; projected onto a line; photons
        emitted from a lattice and laid on one, four sheets over one another; a caustic whose
        positions are rounded to a lattice.
    n : int
        Photons.
    """
    return _DEGENERATE[kind](caustic(n))


def _coincident(photons: pr.PhotonMap) -> pr.PhotonMap:
    position = photons.position.copy()
    position[: int(_SHARE_COINCIDENT * len(position))] = np.median(position, axis=0)
    return photons.replace(position=position)


def _collinear(photons: pr.PhotonMap) -> pr.PhotonMap:
    position = photons.position.copy()
    # Along y: the photons on the wall share their x, and those on the floor their z.
    position[:, [0, 2]] = position[0, [0, 2]]
    return photons.replace(position=position)


def _lattice(photons: pr.PhotonMap) -> pr.PhotonMap:
    """Emit from a lattice, as many per steradian as before, and fold the light over itself."""
    n = len(photons)
    # Even, so that each photon of a sheet falls on one of each other sheet.
    side = 2 * int(np.ceil(0.5 * np.sqrt(n)))
    cells = np.stack(np.divmod(np.arange(n), side), axis=1)
    chart = (cells - 0.5 * (side - 1)) / np.sqrt(photons.emitter_density[:, np.newaxis])
    folded = np.minimum(cells, side - 1 - cells)
    return photons.replace(
        position=np.column_stack([folded / side, np.zeros(n)]),
        normal=np.tile([0.0, 0.0, 1.0], (n, 1)),
        emitter_coords=_on_sphere(chart),
    )


def _on_sphere(chart: Floats) -> Floats:
    """Return the unit vectors around z of which `chart` (n, 2) is the equal-area chart."""
    squared = (chart**2).sum(axis=1)
    return np.column_stack([chart * np.sqrt(1.0 - squared[:, np.newaxis] / 4.0), 1.0 - squared / 2])


def _rounded(photons: pr.PhotonMap) -> pr.PhotonMap:
    """Round to cells that hold five photons where light is of the median density.

    Most photons then share their place with a few others, and those of the brightest edges with
    more than a neighbourhood holds.
    """
    reach = pr.KDTree(photons.position).farthest(50)
    cell = np.median(reach) * np.sqrt(np.pi / 10.0)
    return photons.replace(position=np.round(photons.position / cell) * cell)


# Times of the others are compared with those of the first.
_DEGENERATE = {
    "generic": lambda photons: photons,
    "coincident": _coincident,
    "collinear": _collinear,
    "lattice": _lattice,
    "rounded": _rounded,
}
DEGENERATE = tuple(_DEGENERATE)
