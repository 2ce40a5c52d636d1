"""Irradiance maps of flat objects of a scene, and the flux within circles on them."""

from __future__ import annotations

import warnings
from collections.abc import Iterator, Sequence
from concurrent.futures import Executor
from functools import cached_property

import numpy as np

from .._util.validation import Floats
from ..estimation.block_field import BlockedField
from ..estimation.field import Field, PhotonField
from ..estimation.irradiance_map import irradiance_map, texel_grid
from ..imaging.image import Image
from ..photons.blocks import BlockedPhotons
from ..photons.photon_map import PhotonMap
from ..scene.scene import Scene, SceneObject, object_label
from .metadata import photon_metadata
from .render import on_surfaces

# Height of a flat object over its size, at most.
_FLAT = 1e-6
# Cosine of the angle to the x axis from which on maps run along y.
_ALONG_X = 0.9


class ObjectMap:
    """Irradiance map of a flat object, on the side with most light.

    The map is the rectangle around the object in whose plane u runs along x, or along y where the
    object faces along x, and v runs down as seen from that side. Texels are square.

    Parameters
    ----------
    field : Field
        Of light in the scene.
    scene : Scene
    name : str
        Name or number of the object.
    n_texels : int
        Texels along the longer side.
    size : float, optional
        Side of a square around the middle of the light on the object, m, in place of all of it;
        moved, and cut if it is larger, so that it is within the rectangle.
    photons : PhotonMap or BlockedPhotons, optional
        Photons of the scene, which tell the lit side and encircled flux; by default the field's.
    executor : concurrent.futures.Executor, optional
        As of `irradiance_map`.

    Attributes
    ----------
    object_id : int
    grid : TexelGrid
        The rectangle.

    Raises
    ------
    ValueError
        If there is no such object, several have the name, or it is not flat; if the photons have no
        `object_id`.
    """

    def __init__(
        self,
        field: Field,
        scene: Scene,
        name: str,
        n_texels: int,
        *,
        size: float | None = None,
        photons: PhotonMap | BlockedPhotons | None = None,
        executor: Executor | None = None,
    ) -> None:
        if photons is None:
            if not isinstance(field, PhotonField | BlockedField):
                raise TypeError("photons should be given with a field that has none")
            photons = field.photons
        self._field, self._photons, self._scene = field, photons, scene
        self._executor = executor
        self.object_id = object_named(scene, name)
        item = scene.objects[self.object_id]
        normal = _plane_normal(item, object_label(self.object_id, item))
        behind, before, total, moment = 0.0, 0.0, 0.0, np.zeros(3)
        for there in self._on_object():
            facing, flux = there.normal @ normal, there.flux.sum(axis=1)
            behind, before = behind + flux[facing < 0.0].sum(), before + flux[facing > 0.0].sum()
            total += flux.sum()
            moment += (flux[:, np.newaxis] * there.position).sum(axis=0)
        if behind > before:
            normal = -normal
        vertices = np.asarray(item.mesh.vertices, dtype=np.float64)
        sides = _sides_on(normal)
        low, high = (vertices @ sides.T).min(axis=0), (vertices @ sides.T).max(axis=0)
        if size is not None and total > 0.0:
            half = np.minimum(size, high - low) / 2.0
            middle = np.clip(moment / total @ sides.T, low + half, high - half)
            low, high = middle - half, middle + half
        nx, ny = np.maximum(np.rint((high - low) / (high - low).max() * n_texels), 1).astype(int)
        origin = low @ sides + (vertices[0] @ normal) * normal
        u, v = (high - low)[:, np.newaxis] * sides
        self.grid = texel_grid(origin, u, v, (int(nx), int(ny)), normal=normal)

    def _on_object(self) -> Iterator[PhotonMap]:
        """Photons on the object, a block at a time where they are in blocks."""
        for photons in _pieces(self._photons):
            if photons.object_id is None:
                raise ValueError("photons should have object_id, to tell which are on the object")
            yield photons.subset(photons.object_id == self.object_id)

    @cached_property
    def irradiance(self) -> Floats:
        """Means over the texels (ny, nx, 3), row 0 on top, W/m²; 0 off the object."""
        grid = self.grid
        with warnings.catch_warnings():
            # Around an object that is no rectangle.
            warnings.filterwarnings("ignore", message=".* points have no surface of the scene")
            found = irradiance_map(
                *(self._field, grid.origin, grid.u, grid.v, grid.shape),
                normal=grid.normal,
                executor=self._executor,
            )
        return np.nan_to_num(found, copy=False, nan=0.0)

    @property
    def image(self) -> Image:
        """Layers ``irradiance`` and ``radiance``, the latter of a white surface, W/(m² sr).

        The rectangle is in the metadata.
        """
        layers = {"radiance": self.irradiance / np.pi, "irradiance": self.irradiance}
        frame = {name: getattr(self.grid, name).tolist() for name in ("origin", "u", "v", "normal")}
        others = {"scene": self._scene.name, "object": self.object_id, "settings": self._field.used}
        return Image(layers, photon_metadata(self._photons, frame=frame, **others))

    @property
    def centre(self) -> Floats:
        """Centre (3,) of the map."""
        centre: Floats = self.grid.origin + (self.grid.u + self.grid.v) / 2.0
        return centre

    @property
    def brightest(self) -> Floats:
        """Centre (3,) of the texel of most irradiance."""
        row, column = divmod(int(self.irradiance.sum(axis=2).argmax()), self.grid.shape[0])
        centre: Floats = self.grid.centres(range(row, row + 1))[column]
        return centre

    def encircled_flux(self, point: Floats, radii: Sequence[float]) -> Floats:
        """Flux (n, 3) of the photons on the object within radii (n,) of a point, counted, W."""
        encircled = np.zeros((len(radii), 3))
        for there in self._on_object():
            distance = np.linalg.norm(there.position - point, axis=1)
            encircled += [there.flux[distance <= radius].sum(axis=0) for radius in radii]
        return encircled


def _pieces(photons: PhotonMap | BlockedPhotons) -> Iterator[PhotonMap]:
    """Photons of a map, or of one block after another."""
    if isinstance(photons, PhotonMap):
        yield photons
        return
    for start, stop in zip(photons.segments.first, photons.segments.stop, strict=True):
        yield photons.photons(start, stop)


def photons_of_surface(photons: PhotonMap, scene: Scene, object_id: int) -> PhotonMap:
    """Photons that a map of an object is estimated from.

    Those on a sensor alone, as light stored there is stored again behind it; else those on all
    objects that are not sensors.
    """
    if scene.objects[object_id].material.is_sensor:
        return photons.subset(photons.object_id == object_id)
    return on_surfaces(photons)


def blocks_of_surface(
    photons: BlockedPhotons, scene: Scene, object_id: int
) -> BlockedPhotons | PhotonMap:
    """Those of photons in blocks; a map of none if there are none."""
    is_sensor = scene.objects[object_id].material.is_sensor
    there = photons.on_sensor(object_id if is_sensor else None)
    return there if len(there) else photons.photons(0, 0)


def object_named(scene: Scene, name: str) -> int:
    """Id of the object of a scene with a name, or else with this number.

    Raises
    ------
    ValueError
        If there is none, or several have the name.
    """
    ids = [i for i, item in enumerate(scene.objects) if item.name == name]
    if len(ids) == 1:
        return ids[0]
    if not ids and name.isdecimal() and int(name) < len(scene.objects):
        return int(name)
    labels = ", ".join(object_label(i, item) for i, item in enumerate(scene.objects))
    found = f"{len(ids)} have" if ids else "none has"
    raise ValueError(f"one object should have the name or number {name!r}, but {found}: {labels}")


def _plane_normal(item: SceneObject, label: str) -> Floats:
    """Unit normal of a flat object, its largest coordinate positive."""
    vertices = np.asarray(item.mesh.vertices, dtype=np.float64)
    _, extent, axes = np.linalg.svd(vertices - vertices.mean(axis=0), full_matrices=False)
    if extent[2] > _FLAT * extent[0]:
        raise ValueError(
            f"{label} should be flat for an irradiance map, but is not: photonrelax.lightmap maps "
            "the texture coordinates of any mesh"
        )
    normal: Floats = axes[2] * np.sign(axes[2, np.abs(axes[2]).argmax()])
    return normal


def _sides_on(normal: Floats) -> Floats:
    """Unit vectors (2, 3) to the right and down in a plane, seen from the side of its normal."""
    right = np.eye(3)[1 if abs(normal[0]) > _ALONG_X else 0]
    right = right - (right @ normal) * normal
    right /= np.linalg.norm(right)
    return np.array([right, np.cross(right, normal)])
