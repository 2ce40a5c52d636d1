"""Subjects of a comparison: a scene, or a photon pattern of the gallery."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from .. import gallery
from .._util.memory import check_memory
from .._util.progress import Progress
from .._util.validation import MAX_REPEATS, Floats, count
from ..gallery.analytic import AnalyticIrradiance, analytic_irradiance
from ..gallery.stencil import PHOTON_BYTES
from ..photons.photon_map import PhotonMap
from ..rendering.view import Band, StoredView, View, resized
from ..scene.scene import Scene
from ..transport.hit_points import FirstSurfaces, HitPoints
from ..transport.trace import check_photons_fit, trace_photons
from .analytic_pixels import AnalyticPixels, analytic_pixels

# Points of a plane evaluated together, which bounds the memory of estimates.
_POINTS_PER_BAND = 400_000
# Bytes of a point of a plane and of what is kept of it.
_SAMPLE_BYTES = 176


class Subject(Protocol):
    """Source of photons, and points that they are evaluated at.

    Attributes
    ----------
    name : str
        Name in tables.
    scene : Scene or None
        Scene that photons are traced in.
    size : (int, int)
        Width and height of images.
    """

    @property
    def name(self) -> str: ...
    @property
    def scene(self) -> Scene | None: ...
    @property
    def size(self) -> tuple[int, int]: ...

    def check_memory(self, n_emitted: int, supersampling: int, max_depth: int) -> None:
        """Raise MemoryError if photons or view surely do not fit in memory."""

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
        """Photons that all methods share."""

    def view(
        self,
        supersampling: int,
        max_depth: int,
        *,
        n_threads: int | None,
        progress: Progress | None,
    ) -> StoredView:
        """Hit points that all methods are evaluated at."""

    def exact(self, supersampling: int) -> Floats | None:
        """Exact radiance (height, width, 3), None where it is unknown.

        Means over the s·s samples of each pixel of `view`, as those of an estimate.
        """

    def analytic_pixels(self, view: StoredView) -> AnalyticPixels | None:
        """Caustic of the pixels that are known analytically, None where none is."""


@dataclass(frozen=True, eq=False)
class SceneSubject:
    """A scene with a camera.

    Parameters
    ----------
    scene : Scene
    irradiance : AnalyticIrradiance, optional
        Analytic irradiance of its caustics; see `photonrelax.gallery.analytic`.
    """

    scene: Scene
    irradiance: AnalyticIrradiance | None = None

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

    def check_memory(self, n_emitted: int, supersampling: int, max_depth: int) -> None:
        """Raise MemoryError if photons or view surely do not fit in memory."""
        check_photons_fit(self.scene, n_emitted)
        View(self.scene, supersampling=supersampling, max_depth=max_depth).check_hits_fit()

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
            sensors=False,
        )

    def view(
        self,
        supersampling: int,
        max_depth: int,
        *,
        n_threads: int | None,
        progress: Progress | None,
    ) -> StoredView:
        """Trace camera rays."""
        view = View(
            self.scene, supersampling=supersampling, max_depth=max_depth, n_threads=n_threads
        )
        return view.stored(progress)

    def exact(self, supersampling: int) -> None:
        """None: no scene has an exact image."""

    def analytic_pixels(self, view: StoredView) -> AnalyticPixels | None:
        """Caustic of the pixels that are known analytically, None where none is."""
        return None if self.irradiance is None else analytic_pixels(view, self.irradiance)


@dataclass(frozen=True)
class PhotonPatternSubject:
    """Photon pattern of the gallery on a white plane, seen straight from above: radiance is E/π.

    Parameters
    ----------
    name : str
        One of `photonrelax.gallery.pattern_names`.
    size : (int, int)
        Width and height of images.
    """

    name: str
    size: tuple[int, int] = (600, 600)

    def __post_init__(self) -> None:
        gallery.about(self.name)
        for side in self.size:
            count(side, "size", high=MAX_REPEATS)

    @property
    def scene(self) -> None:
        """None: photon patterns have no scene."""

    def check_memory(self, n_emitted: int, supersampling: int, max_depth: int) -> None:
        """Raise MemoryError if photons and view do not fit in memory."""
        (width, height), samples = self.size, supersampling**2
        check_memory(
            PHOTON_BYTES * n_emitted + _SAMPLE_BYTES * width * height * samples,
            f"{n_emitted:,} photons and {samples:,} samples in each of {width} x {height} pixels",
            "emit fewer, make the image smaller or take fewer samples (supersampling)",
        )

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
        """Photons of the pattern; they have no paths, and no spectra."""
        return gallery.pattern(self.name, n=n_emitted, seed=seed, sampler=sampler).photons

    def view(
        self,
        supersampling: int,
        max_depth: int,
        *,
        n_threads: int | None,
        progress: Progress | None,
    ) -> StoredView:
        """Points of s·s samples a pixel of the white plane, without direct light."""
        (width, height), samples = self.size, supersampling**2
        pattern = gallery.pattern(self.name, n=0)
        points, _ = pattern.samples(width, height, supersampling)
        per_row = width * samples
        step = max(_POINTS_PER_BAND // per_row, 1)
        bands = []
        for top in range(0, height, step):
            rows = range(top, min(top + step, height))
            some = points[rows.start * per_row : rows.stop * per_row]
            bands.append(_band_of_plane(some, rows, width, samples))
        return StoredView(bands, seconds=0.0)

    def exact(self, supersampling: int) -> Floats:
        """Mean exact radiance of the points of `view` in each pixel, (height, width, 3).

        Means over the area of a pixel with an edge differ from these by more than the error of a
        good estimate.
        """
        pattern = gallery.pattern(self.name, n=0)
        irradiance = pattern.image(
            lambda points, _: pattern.irradiance(points), *self.size, supersampling
        )
        return irradiance / np.pi

    def analytic_pixels(self, view: StoredView) -> None:
        """None: the whole image is `exact`."""


def _band_of_plane(points: Floats, rows: range, width: int, samples: int) -> Band:
    """Rows of an image of the white plane."""
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


def gallery_subject(name: str, width: int | None = None, height: int | None = None) -> Subject:
    """Subject of the gallery, with images of its own size unless another is given."""
    if name in gallery.pattern_names():
        side = width or height or 600
        return PhotonPatternSubject(name, (width or side, height or side))
    return SceneSubject(resized(gallery.scene(name), width, height), analytic_irradiance(name))
