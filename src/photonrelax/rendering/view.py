"""Hit points of a camera view, in bands of rows."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from time import perf_counter
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from .._ext.transport.samples import add_by_pixel, merge_samples
from .._util import validation
from .._util.memory import ESTIMATE_MARGIN, available_memory, check_memory
from .._util.parallel import thread_count
from .._util.parcels import state_without_caches
from .._util.progress import Progress, Reporter
from .._util.validation import Floats
from ..estimation.field import Densities, Field
from ..estimation.indirect import IndirectField
from ..estimation.surface import Surface
from ..scene.camera import Camera, places_of
from ..scene.scene import Scene
from ..transport.direct_light import Lights, LightSamples, default_light_samples, samples_light
from ..transport.hit_points import MAX_DEPTH, FirstSurfaces, HitPoints, trace_hit_points
from ..transport.raycast import RayCaster

# Camera rays traced together, which bounds the memory of an image.
_RAYS_PER_BAND = 400_000
# Bytes of the layers of a pixel, and of a camera ray and of a hit point that are kept, at least.
PIXEL_BYTES, _RAY_BYTES, _HIT_BYTES = 128, 56, 176
# Bytes of a hit point that is kept for other images, with its direct light of so many seeds.
_KEPT_BYTES, _LIGHTS = 290, 3
# Rays a side of the small image from which the number of hit points is estimated.
_PILOT_SIDE = 64
# Samples of a pixel are on one piece of surface if they are on a grid and their edges are equal, up
# to a share of an edge, and their normals alike, by the cosines between them.
_SAME_PIECE, _ALIKE = 0.25, 0.95
# Between the seeds of passes: an odd number, so that all differ.
_SEEDS_APART = 0x9E3779B97F4A7C15
# Position of samples in the cells of the s·s grid of their pixel.
CENTRE = (0.5, 0.5)


class Pieces(NamedTuple):
    """Pieces of surface, one for all samples of a pixel that are on it.

    Attributes
    ----------
    position, normal, footprint : (p, 3), (p, 3), (p, 2, 3) float array
        Their middles, normals of any length, and edges.
    of_hit : (m,) intp array
        The piece of each hit point.
    """

    position: Floats
    normal: Floats
    footprint: Floats
    of_hit: NDArray[np.intp]


@dataclass(frozen=True, eq=False)
class Band:
    """Hit points of some rows of an image, and all that does not depend on photons.

    Attributes
    ----------
    rows : range
        Of the image, row 0 at the top.
    width : int
        Of the image.
    hits : HitPoints
        The diffuse points seen.
    first : FirstSurfaces
        Normal and depth of the first surface.
    direct : (m, 3), optional
        Direct irradiance at the hit points, W/m², if that is modelled.
    supersampling : int
        s·s samples a pixel.
    columns : range, optional
        Of the image, by default all.
    """

    rows: range
    width: int
    hits: HitPoints
    first: FirstSurfaces
    direct: Floats | None
    supersampling: int = 1
    columns: range | None = None

    def estimates(
        self, field: Field | Densities | IndirectField
    ) -> tuple[Floats, NDArray[np.intp] | None]:
        """Estimates of a field, means over what each hit point stands for.

        Samples of a pixel that are on one piece of surface share one estimate, over all of it.
        Estimates are at the hit points where the field has no others, or they have no footprints.

        Returns
        -------
        (p, c) float array, (m,) intp array or None
            Estimates, and that of each hit point; None if it has the one of its own row.
        """
        hits = self.hits
        if hits.footprint is None or not field.has_footprints:
            return field(hits.position, hits.normal), None
        pieces = self.pieces()
        estimates: Floats = field(pieces.position, pieces.normal, footprint=pieces.footprint)
        return estimates, pieces.of_hit

    def pieces(self) -> Pieces:
        """Pieces of surface that the hit points, which have footprints, stand for.

        Samples of a pixel that are on one piece of surface share it.
        """
        return Pieces(
            *merge_samples(
                self.hits, self.supersampling, tolerance=_SAME_PIECE, least_cosine=_ALIKE
            )
        )

    def radiance(self, irradiance: Floats, of_hit: NDArray[np.intp] | None = None) -> Floats:
        """Radiance (rows, columns, 3) of irradiance (p, 3), and that of each hit point."""
        return self.sums(irradiance, of_hit, weight=self.reflectance)

    @property
    def reflectance(self) -> Floats:
        """Radiance in its pixel (m, 3) over the irradiance of each hit point, 1/sr."""
        return self.hits.weight * self.hits.albedo / np.pi

    def sums(
        self,
        values: Floats,
        of_hit: NDArray[np.intp] | None = None,
        *,
        weight: Floats | None = None,
    ) -> Floats:
        """Sums (rows, columns, c) of the values (p, c) of the hit points of each pixel.

        `of_hit` (m,) are their rows of the values, by default their own, and `weight`, (m, c) or
        (m, 1), factors of these.
        """
        columns = range(self.width) if self.columns is None else self.columns
        place = places_of(self.hits.pixel, self.rows, columns, self.width)
        return pixel_sums(place, values, (len(self.rows), len(columns)), of_hit, weight=weight)


def pixel_sums(
    pixel: NDArray[np.int64],
    values: Floats,
    shape: tuple[int, int],
    of_hit: NDArray[np.intp] | None = None,
    *,
    weight: Floats | None = None,
) -> Floats:
    """Sums (height, width, c) by their pixels (m,) in images of a shape; see `Band.sums`."""
    n_channels = values.shape[1] if weight is None else max(values.shape[1], weight.shape[1])
    sums = np.zeros((shape[0] * shape[1], n_channels))
    add_by_pixel(sums, pixel, values, of_hit, weight)
    return sums.reshape(*shape, -1)


class _KeptBands(NamedTuple):
    """Bands by their rows, their direct light by rows and turn, and numbers of seeds."""

    bands: dict[tuple[int, int], Band]
    direct: dict[tuple[tuple[int, int], int], Floats]
    seeds: dict[int, int]

    def turn(self, seed: int) -> int:
        """Which direct light images of a seed have."""
        return self.seeds.setdefault(seed, len(self.seeds)) % _LIGHTS


class View:
    """Hit points that the camera of a scene sees, computed in bands of rows.

    Parameters
    ----------
    scene : Scene
        With a camera.
    supersampling, max_depth : int
        s·s samples a pixel; maximum number of specular surfaces on a camera path.
    light_samples, seed : int, optional
        Shadow rays from each hit point to each extended emitter, and to all of many lamps, by
        default enough for noise below 2 % of a pixel; their seed.
    crop : (int, int, int, int), optional
        First column and row of the pixels to see, and the ends of these; by default of all.
    n_threads : int, optional
        Threads; all available by default. Results do not depend on it.

    Attributes
    ----------
    scene, supersampling, max_depth, light_samples, seed, n_threads
        As given, or by default.
    rows, columns : range
        Of the pixels seen.
    camera : Camera
        Of the scene.
    kept_bytes : float
        Estimated memory of the bands that are kept; see `keep_bands`.

    Raises
    ------
    TypeError, ValueError
        If the scene has no camera, a number is out of its range, or `crop` is not of the image.
    MemoryError
        If an image of that size cannot fit in memory.
    """

    def __init__(
        self,
        scene: Scene,
        *,
        supersampling: int = 2,
        max_depth: int = 8,
        light_samples: int | None = None,
        seed: int = 0,
        crop: tuple[int, int, int, int] | None = None,
        n_threads: int | None = None,
    ) -> None:
        if scene.camera is None:
            raise ValueError("scene should have a camera to be rendered")
        self.scene = scene
        self.camera = scene.camera
        self.rows, self.columns = _cropped(scene.camera, crop)
        self.supersampling = validation.count(
            supersampling, "supersampling", high=validation.MAX_REPEATS
        )
        self.max_depth = validation.count(max_depth, "max_depth", low=0, high=MAX_DEPTH)
        if light_samples is None:
            light_samples = default_light_samples(scene, self.supersampling**2)
        self.light_samples = validation.count(
            light_samples, "light_samples", high=validation.MAX_REPEATS
        )
        self.seed = validation.check_seed(seed)
        self.n_threads = thread_count(n_threads)
        self._kept: _KeptBands | None = None
        self.kept_bytes = 0.0
        self._check_image_fits()

    def __getstate__(self) -> dict[str, Any]:
        # The caster is kept by processes that unpickle it.
        return state_without_caches(self) | {"caster": self.caster, "_kept": None}

    def variant(self, *, seed: int | None = None, supersampling: int | None = None) -> View:
        """The view with another seed of shadow rays, or other samples, and the same ray caster."""
        other = View(
            self.scene,
            supersampling=self.supersampling if supersampling is None else supersampling,
            max_depth=self.max_depth,
            light_samples=self.light_samples,
            seed=self.seed if seed is None else seed,
            crop=self.crop,
            n_threads=self.n_threads,
        )
        for name in ("caster", "lights"):
            if name in vars(self):
                vars(other)[name] = vars(self)[name]
        if other.supersampling == self.supersampling:
            other._kept, other.kept_bytes = self._kept, self.kept_bytes
        return other

    def keep_bands(self, n_bytes: float) -> None:
        """Trace camera rays once for all images of this view and its variants to come.

        Unless their hit points are estimated to take more than `n_bytes`. Direct light that is
        sampled is that of the first three seeds, in turns: it does not depend on photons.
        """
        height, width = self.shape
        each = _KEPT_BYTES * max(self._hits_per_ray(), 1.0)
        needed = each * height * width * self.supersampling**2
        if needed <= n_bytes:
            self._kept, self.kept_bytes = _KeptBands({}, {}, {}), needed

    def _check_image_fits(self) -> None:
        height, width = self.shape
        check_memory(
            PIXEL_BYTES * height * width,
            f"the layers of {width} x {height} pixels",
            "make the image smaller (width, height)",
        )
        check_memory(
            _RAY_BYTES * width * self.supersampling**2,
            f"the {self.supersampling} x {self.supersampling} samples of each pixel of a row",
            "take fewer (supersampling)",
        )

    def check_hits_fit(self) -> None:
        """Raise MemoryError if all hit points together surely do not fit in memory."""
        height, width = self.shape
        n_samples = height * width * self.supersampling**2
        if _HIT_BYTES * n_samples <= available_memory():
            return
        check_memory(
            _HIT_BYTES * n_samples * self._hits_per_ray() / ESTIMATE_MARGIN,
            f"the hit points of {self.supersampling} x {self.supersampling} samples in each of "
            f"{width} x {height} pixels",
            "make the image smaller (width, height), or take fewer samples (supersampling)",
        )

    def _hits_per_ray(self) -> float:
        """Hit points for each camera ray, of a small image."""
        hits, scale = self._pilot()
        return len(hits) / max(scale**2 * self.camera.height * self.camera.width, 1.0)

    def pixel_side(self) -> float | None:
        """Median side of pixels on the surfaces seen, m; None if none is seen."""
        hits, scale = self._pilot()
        if hits.footprint is None or not len(hits):
            return None
        u, v = hits.footprint[:, 0], hits.footprint[:, 1]
        return scale * float(np.sqrt(np.median(np.linalg.norm(np.cross(u, v), axis=1)))) or None

    def _pilot(self) -> tuple[HitPoints, float]:
        """Hit points of a small image of all pixels, and its size over that of theirs."""
        sides = self.camera.height, self.camera.width
        scale = min(_PILOT_SIDE / max(sides), 1.0)
        height, width = (max(round(scale * side), 1) for side in sides)
        camera = replace(self.camera, width=width, height=height)
        hits, _ = trace_hit_points(
            self.scene, self.caster, camera, range(height), max_depth=self.max_depth
        )
        return hits, scale

    @property
    def shape(self) -> tuple[int, int]:
        """Height and width of images."""
        return len(self.rows), len(self.columns)

    @property
    def crop(self) -> tuple[int, int, int, int] | None:
        """As given; None of the whole image."""
        if self.shape == (self.camera.height, self.camera.width):
            return None
        return self.columns.start, self.rows.start, self.columns.stop, self.rows.stop

    @property
    def settings(self) -> dict[str, Any]:
        """Supersampling, maximum depth and, where they are, samples of light and the crop."""
        settings: dict[str, Any] = {
            "supersampling": self.supersampling,
            "max_depth": self.max_depth,
        }
        if samples_light(self.scene, self.light_samples):
            settings["light_samples"] = self.light_samples
        if self.crop is not None:
            settings["crop"] = self.crop
        return settings

    @cached_property
    def caster(self) -> RayCaster:
        """Ray caster of the scene's objects, built on first use."""
        return RayCaster(self.scene.surfaces)

    @cached_property
    def lights(self) -> Lights:
        """Emitters of the scene, prepared for direct light on first use."""
        return Lights(self.scene, self.caster)

    @cached_property
    def surface(self) -> Surface:
        """Surfaces of the scene that light is estimated on."""
        return Surface(self.scene, self.n_threads)

    def bands(
        self, offset: tuple[float, float] = CENTRE, number: int = 0, *, direct: bool = True
    ) -> Iterator[Band]:
        """Trace the camera rays, band by band from the top down, and direct light if wanted.

        Samples lie at `offset` in the cells of the grid of their pixel; see `pixel_rays`. Those of
        extended emitters differ by `number`, that of a pass.
        """
        for rows in self.row_ranges():
            yield self.band(rows, offset, number, direct=direct)

    def row_ranges(self, n_bands: int = 1, at_once: int = 1) -> list[range]:
        """Rows of bands from the top down, at least so many bands if there are so many rows.

        Bands are smaller where several are traced at once.
        """
        height, width = self.shape
        rays = _RAYS_PER_BAND // at_once
        rows_per_band = max(rays // (width * self.supersampling**2), 1)
        rows_per_band = min(rows_per_band, -(-height // n_bands))
        return [self.rows[i : i + rows_per_band] for i in range(0, height, rows_per_band)]

    def band(
        self,
        rows: range,
        offset: tuple[float, float] = CENTRE,
        number: int = 0,
        *,
        direct: bool = True,
    ) -> Band:
        """Trace the camera rays of some rows; see `bands`."""
        kept = self._kept
        if kept is None or offset != CENTRE or number:
            return self._traced(rows, offset, number, direct=direct)
        key = rows.start, rows.stop
        if key not in kept.bands:
            kept.bands[key] = self._traced(rows, offset, number, direct=False)
        band = kept.bands[key]
        if not direct:
            return band
        turn = kept.turn(self.seed) if samples_light(self.scene, self.light_samples) else 0
        if (key, turn) not in kept.direct:
            kept.direct[key, turn] = self._direct(band.hits, number)
        return replace(band, direct=kept.direct[key, turn])

    def _traced(
        self, rows: range, offset: tuple[float, float], number: int, *, direct: bool
    ) -> Band:
        hits, first = trace_hit_points(
            self.scene,
            self.caster,
            self.camera,
            rows,
            columns=self.columns,
            supersampling=self.supersampling,
            offset=offset,
            max_depth=self.max_depth,
            n_threads=self.n_threads,
        )
        light = self._direct(hits, number) if direct else None
        width = self.camera.width
        return Band(rows, width, hits, first, light, self.supersampling, self.columns)

    def _direct(self, hits: HitPoints, number: int) -> Floats:
        return self.lights.irradiance(
            hits.position,
            hits.normal,
            samples=LightSamples(self.light_samples, _seed_of(self.seed, number), hits.pixel),
            n_threads=self.n_threads,
        )

    def stored(self, progress: Progress | None) -> StoredView:
        """Trace all bands and keep them in memory."""
        self.check_hits_fit()
        started = perf_counter()
        report = Reporter(progress, "camera", len(self.rows))
        bands = []
        for band in self.bands():
            bands.append(band)
            report.advance(len(band.rows))
        return StoredView(bands, perf_counter() - started)


def _cropped(camera: Camera, crop: tuple[int, int, int, int] | None) -> tuple[range, range]:
    """Rows and columns of a crop of an image; raises ValueError if it is none."""
    if crop is None:
        return range(camera.height), range(camera.width)
    bounds = np.asarray(crop)
    if bounds.shape != (4,) or bounds.dtype.kind not in "iu":
        raise ValueError(f"crop should be four whole numbers, x0, y0, x1 and y1, but is {crop}")
    x0, y0, x1, y1 = bounds.tolist()
    if not (0 <= x0 < x1 <= camera.width and 0 <= y0 < y1 <= camera.height):
        raise ValueError(
            f"crop should be pixels [x0, x1) x [y0, y1) of the image of {camera.width} x "
            f"{camera.height}, but is {x0}, {y0}, {x1}, {y1}"
        )
    return range(y0, y1), range(x0, x1)


def _seed_of(seed: int, number: int) -> int:
    """Seed of a pass: another one for each, modulo 2^64."""
    return (seed + number * _SEEDS_APART) % 2**64


@dataclass(frozen=True, eq=False)
class StoredView:
    """Bands of a view in memory, to evaluate several fields at the same hit points.

    Attributes
    ----------
    bands : list of Band
        From the top down.
    seconds : float
        Time of tracing them.
    """

    bands: list[Band]
    seconds: float

    def caustic(self, field: Field, progress: Progress | None) -> Floats:
        """Radiance (height, width, 3) of the irradiance of a field."""
        report = Reporter(progress, "render", sum(len(band.rows) for band in self.bands))
        parts = []
        for band in self.bands:
            parts.append(band.radiance(*band.estimates(field)))
            report.advance(len(band.rows))
        return np.concatenate(parts)


def concatenate_bands(parts: list[dict[str, Floats]]) -> dict[str, Floats]:
    """Layers of an image from those of its bands, from the top down."""
    return {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}


def resized(scene: Scene, width: int | None, height: int | None) -> Scene:
    """Scene with images of another size; one side alone keeps their proportions."""
    camera = scene.camera
    if width is None and height is None:
        return scene
    if camera is None:
        raise ValueError("scene should have a camera to be resized")
    if width is None or height is None:
        scale = (width or camera.width) / camera.width * (height or camera.height) / camera.height
        width = max(round(scale * camera.width), 1)
        height = max(round(scale * camera.height), 1)
    return replace(scene, camera=replace(camera, width=width, height=height))
