"""What is measured: photons of the prism's caustic, its camera's hit points, awkward points."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from functools import cache, lru_cache

import numpy as np

import photonrelax as pr
from bench.speed.morton import Floats, morton_order
from photonrelax import gallery
from photonrelax.relaxation.structure import emitter_range
from photonrelax.transport import raycast
from photonrelax.transport.hit_points import HitPoints, trace_hit_points

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
    """Return exactly n photons of the prism, in order of emission: at random in space."""
    photons = pr.trace_photons(scene(), int(n / STORED) + 1000)
    if len(photons) < n:
        raise RuntimeError(f"{n} photons should have been stored, but {len(photons)} were")
    density = photons.emitter_density * (n / len(photons))
    return photons.replace(emitter_density=density).subset(slice(0, n))


@lru_cache(maxsize=1)
def along_curve(n: int) -> pr.PhotonMap:
    """Return the same photons in Morton order of their positions: the best order for all."""
    photons = caustic(n)
    return photons.subset(morton_order(photons.position))


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
    """Return the caustic over directions (6 axes) or over an equal-area chart of them (5).

    In Morton order of the positions.
    """
    whole = sheet_of(along_curve(n))
    return whole if n_axes == 6 else replace(whole, coords=equal_area_chart(whole.coords))


def sheet_of(photons: pr.PhotonMap) -> Sheet:
    """Return photons with the range that structure detection allows them."""
    ranges = emitter_range(photons, pr.StructureSettings())
    return Sheet(photons.position, photons.emitter_coords, ranges)


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
def hit_points(pixels: int) -> HitPoints:
    """Return what the prism's camera sees at 4 samples a pixel, in the order of the pixels."""
    seen = scene(pixels)
    hits, _ = trace_hit_points(
        seen, raycast.RayCaster(seen.objects), seen.camera, range(pixels), supersampling=2
    )
    order = np.argsort(hits.pixel, kind="stable")
    rows = {field.name: getattr(hits, field.name)[order] for field in fields(hits)}
    return HitPoints(**rows)


def degenerate(kind: str, n: int) -> pr.PhotonMap:
    """Return n photons whose positions are awkward, those of a sheet still side by side.

    Parameters
    ----------
    kind : {"generic", "coincident", "collinear", "lattice", "rounded"}
        A caustic as it is; with 15 % of its photons at one point; thrown on a line; photons
        emitted from a lattice and laid on one, four sheets over one another; a caustic whose
        positions are rounded to a lattice.
    n : int
        Photons.
    """
    return _AWKWARD[kind](caustic(n))


def _coincident(photons: pr.PhotonMap) -> pr.PhotonMap:
    position = photons.position.copy()
    position[: int(_N_COINCIDENT * len(position))] = np.median(position, axis=0)
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

    So most photons share their place with a few others, and those of the brightest edges with
    more than belong to a neighbourhood.
    """
    reach = pr.KDTree(photons.position).farthest(50)
    cell = np.median(reach) * np.sqrt(np.pi / 10.0)
    return photons.replace(position=np.round(photons.position / cell) * cell)


# The first is the others' measure.
_AWKWARD = {
    "generic": lambda photons: photons,
    "coincident": _coincident,
    "collinear": _collinear,
    "lattice": _lattice,
    "rounded": _rounded,
}
DEGENERATE = tuple(_AWKWARD)
