"""What is compared on: a scene, or photons of the gallery that no scene was traced for."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from .. import gallery
from .._util.progress import Progress
from .._util.validation import Floats, count
from ..gallery.analytic import KnownLight, known_light
from ..photons.photon_map import PhotonMap
from ..rendering.view import Band, View, joined, look, resized
from ..scene.scene import Scene
from ..transport.hit_points import FirstSurfaces, HitPoints
from ..transport.trace import trace_photons
from .analytic_pixels import Known, analytic_pixels

# Points of a plane that are looked at together, which bounds the memory estimates take.
_POINTS_PER_BAND = 400_000


class Subject(Protocol):
    """Where photons come from and where they are seen.

    Attributes
    ----------
    name : str
        What tables call it.
    scene : Scene or None
        That photons were traced in.
    size : (int, int)
        Width and height of its pictures.
    """

    @property
    def name(self) -> str: ...
    @property
    def scene(self) -> Scene | None: ...
    @property
    def size(self) -> tuple[int, int]: ...

    def photons(
        self,
        n_emitted: int,
        *,
        seed: int,
        sampler: str,
        frequency_share: float,
        n_threads: int | None,
        progress: Progress | None,
    ) -> PhotonMap:
        """Return the photons that all methods share."""

    def view(
        self,
        supersampling: int,
        max_depth: int,
        *,
        n_threads: int | None,
        progress: Progress | None,
    ) -> View:
        """Return the points that all methods are seen at."""

    def exact(self, supersampling: int) -> Floats | None:
        """Return the picture of the true irradiance at the points of `view`, if it is known.

        (height, width, 3): means over the s·s samples of each pixel, as of any estimate.
        """

    def known(self, view: View) -> Known | None:
        """Return the caustic of a view where it is known without photons, if a part of it is."""


@dataclass(frozen=True, eq=False)
class SceneSubject:
    """A scene with a camera.

    Parameters
    ----------
    scene : Scene
    light : KnownLight, optional
        What is known of its caustics without photons; see `photonrelax.gallery.analytic`.
    """

    scene: Scene
    light: KnownLight | None = None

    def __post_init__(self) -> None:
        if self.scene.camera is None:
            raise ValueError("scene should have a camera to be compared on")

    @property
    def name(self) -> str:
        """The scene's name."""
        return self.scene.name

    @property
    def size(self) -> tuple[int, int]:
        """The camera's size."""
        camera = self.scene.camera
        assert camera is not None, "a subject has a camera"
        return camera.width, camera.height

    def photons(
        self,
        n_emitted: int,
        *,
        seed: int,
        sampler: str,
        frequency_share: float,
        n_threads: int | None,
        progress: Progress | None,
    ) -> PhotonMap:
        """Trace photons."""
        return trace_photons(
            self.scene,
            n_emitted,
            seed=seed,
            sampler=sampler,
            frequency_share=frequency_share,
            n_threads=n_threads,
            progress=progress,
        )

    def view(
        self,
        supersampling: int,
        max_depth: int,
        *,
        n_threads: int | None,
        progress: Progress | None,
    ) -> View:
        """Follow camera rays."""
        return look(
            self.scene,
            supersampling=supersampling,
            max_depth=max_depth,
            n_threads=n_threads,
            progress=progress,
        )

    def exact(self, supersampling: int) -> None:
        """Return nothing: no whole picture of a scene is known."""

    def known(self, view: View) -> Known | None:
        """Return the picture of the light that is known."""
        return None if self.light is None else analytic_pixels(view, self.light)


@dataclass(frozen=True)
class DistributionSubject:
    """Photons of the gallery on a white plane, seen straight from above: radiance is E/π.

    Parameters
    ----------
    name : str
        One of `photonrelax.gallery.distribution_names`.
    size : (int, int)
        Width and height of pictures.
    """

    name: str
    size: tuple[int, int] = (600, 600)

    def __post_init__(self) -> None:
        gallery.about(self.name)
        for side in self.size:
            count(side, "size")

    @property
    def scene(self) -> None:
        """There is none."""

    def photons(
        self,
        n_emitted: int,
        *,
        seed: int,
        sampler: str,
        frequency_share: float,
        n_threads: int | None,
        progress: Progress | None,
    ) -> PhotonMap:
        """Make the distribution's photons; they have no paths, and no spectra."""
        made = gallery.distribution(self.name, n=n_emitted, seed=seed, sampler=sampler)
        return made.photons

    def view(
        self,
        supersampling: int,
        max_depth: int,
        *,
        n_threads: int | None,
        progress: Progress | None,
    ) -> View:
        """Return s·s points a pixel of the white plane, which nothing else lights."""
        (width, height), samples = self.size, supersampling**2
        distribution = gallery.distribution(self.name, n=0)
        points, _ = distribution.samples(width, height, supersampling)
        per_row = width * samples
        step = max(_POINTS_PER_BAND // per_row, 1)
        seen = []
        for top in range(0, height, step):
            rows = range(top, min(top + step, height))
            some = points[rows.start * per_row : rows.stop * per_row]
            seen.append(_band_of_plane(some, rows, width, samples))
        return View(seen, joined([band.fixed_layers() for band in seen]), 0.0)

    def exact(self, supersampling: int) -> Floats:
        """Return the mean radiance of the points of `view` in each pixel, (height, width, 3).

        Means over the area of pixels differ from these where edges cut them, by more than the
        error of a good estimate.
        """
        known = gallery.distribution(self.name, n=0)
        picture = known.picture(
            lambda points, _: known.irradiance(points), *self.size, supersampling
        )
        return picture / np.pi

    def known(self, view: View) -> None:
        """Return nothing: the whole picture is `exact` already."""


def _band_of_plane(points: Floats, rows: range, width: int, samples: int) -> Band:
    """Return some rows of a picture of the white plane."""
    white, up = np.ones_like(points), np.zeros_like(points)
    up[:, 2] = 1.0
    pixels = np.arange(rows.start * width, rows.stop * width)
    hits = HitPoints(
        pixel=np.repeat(pixels, samples),
        position=points,
        normal=up,
        albedo=white,
        weight=white / samples,
        object_id=np.zeros(len(points), dtype=np.int32),
    )
    shape = (len(rows), width)
    first = FirstSurfaces(np.broadcast_to(up[0], (*shape, 3)), np.ones(shape))
    return Band(rows, width, hits, first, np.zeros_like(points))


def named(name: str, width: int | None = None, height: int | None = None) -> Subject:
    """Return what the gallery knows by a name, its pictures of a size of their own if not given."""
    if name in gallery.distribution_names():
        side = width or height or 600
        return DistributionSubject(name, (width or side, height or side))
    return SceneSubject(resized(gallery.scene(name), width, height), known_light(name))
