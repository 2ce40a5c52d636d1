"""Scenes whose map from the emitter to the receiver is known, and means of light over texels."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import trimesh

import photonrelax as pr
from photonrelax import gallery
from photonrelax.gallery.analytic import RingIrradiance
from photonrelax.gallery.meshes import floor, grid_faces, join, make_mesh
from tests.analytic.interface import Floats
from tests.analytic.slab import slab_transmittance

IOR = 1.33
# Points of Gauss and Legendre along each side of a texel.
_N_POINTS = 4


@dataclass(frozen=True)
class KnownMap:
    """A scene and the light on a rectangle of it.

    Attributes
    ----------
    frame : (3, 3) array
        A corner of the rectangle and its sides from there, m.
    means : (ny, nx) array
        Of the light over texels, W/m²; NaN where it is not known.
    """

    scene: pr.Scene
    frame: Floats
    means: Floats

    @property
    def texel(self) -> float:
        """The shorter side of texels, m."""
        return float((np.linalg.norm(self.frame[1:], axis=1) / self.means.shape[::-1]).min())

    def error(self, **limits: float) -> tuple[float, pr.Envelope]:
        """Relative L1 error of an envelope, resolved to texels, where the light is known."""
        envelope = pr.trace_envelope(self.scene, footprint=self.texel, n_threads=1, **limits)
        field = pr.irradiance_field(envelope, method="envelope", n_threads=1)
        found = pr.irradiance_map(field, *self.frame, self.means.shape[::-1])[..., 0]
        known = np.isfinite(self.means)
        exact = self.means[known]
        return float(np.abs(found[known] - exact).sum() / exact.sum()), envelope


def texel_means(light: Callable[[Floats], Floats], frame: Floats, shape: tuple[int, int]) -> Floats:
    """Means (ny, nx) of light at points (n, 3) over the texels of a rectangle."""
    offset, weight = np.polynomial.legendre.leggauss(_N_POINTS)
    along = [(np.arange(n)[:, np.newaxis] + 0.5 + 0.5 * offset).ravel() / n for n in shape]
    v, u = np.meshgrid(*along, indexing="ij")
    points = frame[0] + np.multiply.outer(u, frame[1]) + np.multiply.outer(v, frame[2])
    values = light(points.reshape(-1, 3)).reshape(shape[0], _N_POINTS, shape[1], _N_POINTS)
    return np.einsum("ipjq,p,q->ij", values, 0.5 * weight, 0.5 * weight)


def paraboloid(n_texels: int = 40, resolution: int = 256, distance: float = 0.1) -> KnownMap:
    """Light that a part of z = r²/4 throws towards its focus, (0, 0, 1), on a plane before that.

    All of it passes the focus, so that at `distance` before it r falls on
    distance · r / (1 - r²/4).
    """
    x, y = np.linspace(-0.4, 0.4, resolution + 1), np.linspace(0.8, 1.6, resolution + 1)
    x, y = (each.ravel() for each in np.meshgrid(x, y))
    normals = np.column_stack([-x / 2.0, -y / 2.0, np.ones_like(x)])
    normals /= np.linalg.norm(normals, axis=1)[:, np.newaxis]
    points = np.column_stack([x, y, 0.25 * (x**2 + y**2)])
    mirror = make_mesh(points, grid_faces(resolution + 1, resolution + 1), normals)
    z = 1.0 - distance
    plate = np.array([[-0.5, 0, z], [-0.5, 0.6, z], [0.5, 0.6, z], [0.5, 0, z]])
    objects = [
        pr.SceneObject(make_mesh(plate, np.array([[0, 1, 2], [0, 2, 3]])), pr.Diffuse()),
        pr.SceneObject(mirror, pr.Mirror(1.0), smooth=True),
    ]

    def light(points: Floats) -> Floats:
        far = np.hypot(points[:, 0], points[:, 1])
        r = 2.0 * (np.hypot(distance, far) - distance) / far
        rest = 1.0 - 0.25 * r**2
        return r / (far * distance * (rest + 0.5 * r**2) / rest**2)

    # Wholly lit, and the normal towards the mirror.
    frame = np.array([[-0.05, 0.17, z], [0.0, 0.1, 0.0], [0.1, 0.0, 0.0]])
    means = texel_means(light, frame, (n_texels, n_texels))
    return KnownMap(pr.Scene(objects, [pr.CollimatedEmitter((0, 0, -1))]), frame, means)


def nephroid(n_texels: int = 100, half: float = 0.9) -> KnownMap:
    """The gallery's ring; the light is known in texels that lie away from folds and borders."""
    frame = half * np.array([[-1.0, -1.0, 0.0], [2.0, 0.0, 0.0], [0.0, 2.0, 0.0]])
    exact = RingIrradiance(margin=1.5 * half / n_texels)

    def light(points: Floats) -> Floats:
        values, known = exact(points, np.tile([0.0, 0.0, 1.0], (len(points), 1)))
        return np.where(known, values, np.nan)

    scene = gallery.scene("ring")
    return KnownMap(scene, frame, texel_means(light, frame, (n_texels, n_texels)))


def plate(ior: float = 1.5) -> KnownMap:
    """Flat glass in light along its normal: all orders of reflection fall on one place."""
    solid = trimesh.creation.box([4.0, 4.0, 0.02])
    solid.apply_translation([0.0, 0.0, 1.0])
    objects = [floor(4.0), pr.SceneObject(solid, pr.Dielectric(ior))]
    scene = pr.Scene(objects, [pr.CollimatedEmitter((0, 0, -1))])
    frame = np.array([[-1.5, -1.5, 0.0], [3.0, 0.0, 0.0], [0.0, 3.0, 0.0]])
    return KnownMap(scene, frame, np.full((50, 50), slab_transmittance(ior)))


def refractor(n_bands: int = 160, resolution: int = 2048, n_rays: int = 20_000) -> KnownMap:
    """Bands of a floor under glass with a wave along x, by quadrature of rays in one dimension.

    Normals are those of the wave, not of facets; light between two rays is even between both.
    """
    half, width, depth = 0.4, 0.4, 0.8
    x = np.linspace(-0.5, 0.5, resolution + 1)
    height, normals = _wave(x, depth)
    scene = pr.Scene(
        [
            floor(4.0),
            pr.SceneObject(_glass(x, height, normals, width), pr.Dielectric(IOR), smooth=True),
        ],
        [pr.CollimatedEmitter((0, 0, -1))],
    )
    x = np.linspace(-0.5, 0.5, n_rays + 1)
    height, normals = _wave(x, depth)
    incoming = normals[:, 2]
    outgoing = np.sqrt(1.0 - (1.0 - incoming**2) / IOR**2)
    turned = (incoming / IOR - outgoing)[:, np.newaxis] * normals + [0.0, 0.0, -1.0 / IOR]
    across = (IOR * incoming - outgoing) / (IOR * incoming + outgoing)
    along = (incoming - IOR * outgoing) / (incoming + IOR * outgoing)
    passed = 1.0 - 0.5 * (across**2 + along**2)
    at = x - turned[:, 0] / turned[:, 2] * height
    low, high = np.sort([at[:-1], at[1:]], axis=0)
    edges = np.linspace(-half, half, n_bands + 1)[:, np.newaxis]
    below = np.clip((edges - low) / (high - low), 0.0, 1.0)
    light = np.diff(below @ (0.5 * (passed[:-1] + passed[1:]) / n_rays))
    # Farther out light arrives from the walls of the glass.
    frame = np.array([[-half, -0.5, 0.0], [2.0 * half, 0.0, 0.0], [0.0, 1.0, 0.0]])
    return KnownMap(scene, frame, width * light[np.newaxis] * n_bands / (2.0 * half))


def _wave(x: Floats, depth: float) -> tuple[Floats, Floats]:
    """Heights (n,) and unit normals (n, 3) of a wave."""
    slope = 0.18 * np.cos(9.0 * x)
    normals = np.column_stack([-slope, np.zeros_like(x), np.ones_like(x)])
    return depth + 0.02 * np.sin(9.0 * x), normals / np.hypot(1.0, slope)[:, np.newaxis]


def _glass(x: Floats, height: Floats, normals: Floats, width: float) -> trimesh.Trimesh:
    """A solid that reaches from below the floor up to a wave along x."""
    n, sides = len(x), (-width / 2.0, width / 2.0)
    top = np.concatenate([np.column_stack([x, np.full_like(x, y), height]) for y in sides])
    base = np.where([False, False, True], -0.2, top)
    down = np.tile([0.0, 0.0, -1.0], (2 * n, 1))
    faces = grid_faces(2, n)
    parts = [(top, np.tile(normals, (2, 1)), faces), (base, down, faces[:, ::-1])]
    rim = np.arange(2 * n).reshape(2, n)
    outside = ([0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0])
    for edge, away in zip((rim[0], rim[:, -1], rim[1, ::-1], rim[::-1, 0]), outside, strict=True):
        wall = np.concatenate([base[edge], top[edge]])
        parts.append((wall, np.tile(away, (len(wall), 1)), grid_faces(2, len(edge))))
    return join(parts)


KNOWN_MAPS = {
    "paraboloid": paraboloid,
    "nephroid": nephroid,
    "plate": plate,
    "refractor": refractor,
}
