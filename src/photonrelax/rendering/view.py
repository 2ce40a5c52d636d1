"""Hit points of a view, in bands of rows."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from time import perf_counter

import numpy as np

from .._util.parallel import thread_count
from .._util.progress import Progress, Reporter
from .._util.validation import Floats
from ..estimation.field import Field
from ..scene.camera import Camera
from ..scene.scene import Scene
from ..transport.direct_light import direct_irradiance
from ..transport.hit_points import FirstSurfaces, HitPoints, trace_hit_points
from ..transport.raycast import RayCaster

# Camera rays followed at a time, which bounds the memory a picture takes.
_RAYS_PER_BAND = 400_000


@dataclass(frozen=True, eq=False)
class Band:
    """Some rows of a picture: the points seen, and all that does not depend on photons.

    Attributes
    ----------
    rows : range
        Of the picture, row 0 at the top.
    width : int
        Of the picture.
    hits : HitPoints
        The diffuse points seen.
    first : FirstSurfaces
        Normal and depth of the first surface.
    direct : (m, 3)
        Irradiance at the hit points from emitters in plain sight, W/m².
    """

    rows: range
    width: int
    hits: HitPoints
    first: FirstSurfaces
    direct: Floats

    def fixed_layers(self) -> dict[str, Floats]:
        """Return the layers that need no photons."""
        return {
            "direct": self.radiance(self.direct),
            "albedo": self.sums(self.hits.weight * self.hits.albedo),
            "N": self.first.normal,
            "Z": self.first.depth,
        }

    def radiance(self, irradiance: Floats) -> Floats:
        """Return radiance (rows, width, 3) of irradiance (m, 3) at the hit points."""
        return self.sums(self.hits.weight * self.hits.albedo / np.pi * irradiance)

    def sums(self, values: Floats) -> Floats:
        """Return the sums (rows, width, c) over the hit points of each pixel."""
        pixel = self.hits.pixel - self.rows.start * self.width
        sums = np.zeros((len(self.rows) * self.width, values.shape[1]))
        for channel, column in enumerate(values.T):
            sums[:, channel] = np.bincount(pixel, column, minlength=len(sums))
        return sums.reshape(len(self.rows), self.width, -1)


def bands(
    scene: Scene,
    camera: Camera,
    *,
    supersampling: int,
    max_depth: int,
    n_threads: int,
    offset: tuple[float, float] = (0.5, 0.5),
    caster: RayCaster | None = None,
) -> Iterator[Band]:
    """Yield what a camera sees, from the top down, so many rows at a time as memory allows.

    Where samples are in the cells of their pixel's grid is `offset`; see `camera.pixel_rays`.
    Making the caster of the scene's objects takes time, unless it is given.
    """
    caster = caster or RayCaster(scene.objects)
    rows_per_band = max(_RAYS_PER_BAND // (camera.width * supersampling**2), 1)
    for top in range(0, camera.height, rows_per_band):
        rows = range(top, min(top + rows_per_band, camera.height))
        hits, first = trace_hit_points(
            scene,
            caster,
            camera,
            rows,
            supersampling=supersampling,
            offset=offset,
            max_depth=max_depth,
            n_threads=n_threads,
        )
        direct = direct_irradiance(scene, caster, hits.position, hits.normal, n_threads=n_threads)
        yield Band(rows, camera.width, hits, first, direct)


def resized(scene: Scene, width: int | None, height: int | None) -> Scene:
    """Return a scene with pictures of another size; in proportion if one side alone is given."""
    camera = scene.camera
    if camera is None:
        raise ValueError("scene should have a camera to be resized")
    if width is None and height is None:
        return scene
    if width is None or height is None:
        scale = (width or camera.width) / camera.width * (height or camera.height) / camera.height
        width = max(round(scale * camera.width), 1)
        height = max(round(scale * camera.height), 1)
    return replace(scene, camera=replace(camera, width=width, height=height))


def joined(parts: list[dict[str, Floats]]) -> dict[str, Floats]:
    """Return the layers of a picture whose bands are given from the top down."""
    return {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}


@dataclass(frozen=True, eq=False)
class View:
    """The points a camera sees, kept.

    Attributes
    ----------
    bands : list of Band
        From the top down.
    fixed : dict
        Layers that need no photons.
    seconds : float
        What finding them took.
    """

    bands: list[Band]
    fixed: dict[str, Floats]
    seconds: float

    def caustic(self, field: Field, progress: Progress | None) -> Floats:
        """Return the radiance (height, width, 3) of a field's irradiance."""
        report = Reporter(progress, "render", sum(len(band.rows) for band in self.bands))
        parts = []
        for band in self.bands:
            parts.append(band.radiance(field(band.hits.position, band.hits.normal)))
            report.advance(len(band.rows))
        return np.concatenate(parts)


def look(
    scene: Scene,
    *,
    supersampling: int,
    max_depth: int,
    n_threads: int | None,
    progress: Progress | None,
) -> View:
    """Find what a scene's camera sees."""
    if scene.camera is None:
        raise ValueError("scene should have a camera to be seen")
    started = perf_counter()
    report = Reporter(progress, "camera", scene.camera.height)
    seen = []
    for band in bands(
        scene,
        scene.camera,
        supersampling=supersampling,
        max_depth=max_depth,
        n_threads=thread_count(n_threads),
    ):
        seen.append(band)
        report.advance(len(band.rows))
    fixed = joined([band.fixed_layers() for band in seen])
    return View(seen, fixed, perf_counter() - started)
