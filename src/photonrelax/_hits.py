"""Hit points of a picture made in passes: kept, or moved about in their pixels by every pass."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass
from functools import partial
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from ._arrays import Floats
from .photonmap import PhotonMap
from .picture import Band, bands, joined
from .progressive import (
    Discs,
    FirstRadius,
    Pass,
    ProgressiveSettings,
    ProgressiveStatistics,
    pass_weight,
)
from .raycast import RayCaster
from .sampling import halton, seed_shift
from .scene import Scene


@dataclass(frozen=True)
class Recipe:
    """What the passes of a run depend on, beside the scene."""

    settings: ProgressiveSettings
    photons_per_pass: int
    seed: int
    supersampling: int
    stochastic: bool
    max_depth: int

    def named(self) -> dict[str, Any]:
        """Return all values by their names, for JSON."""
        values = asdict(self)
        settings = values.pop("settings")
        del settings["n_passes"]  # says how a map is dealt out
        return {**settings, **values}


class View:
    """What the camera of a scene sees of it."""

    def __init__(self, scene: Scene, recipe: Recipe, n_threads: int) -> None:
        if scene.camera is None:
            raise ValueError("scene should have a camera to be rendered")
        self.recipe = recipe
        self.n_threads = n_threads
        self.shape = (scene.camera.height, scene.camera.width)
        self._scene = scene
        self._camera = scene.camera
        self.caster = RayCaster(scene.objects)
        self._shift = seed_shift(recipe.seed)

    def bands(self, offset: tuple[float, float] = (0.5, 0.5)) -> Iterator[Band]:
        """Yield all that is seen, rows by rows."""
        return bands(
            self._scene,
            self._camera,
            supersampling=self.recipe.supersampling,
            max_depth=self.recipe.max_depth,
            n_threads=self.n_threads,
            offset=offset,
            caster=self.caster,
        )

    def offset(self, number: int) -> tuple[float, float]:
        """Return where samples are in a pass: shifted Halton points, so that passes fill pixels."""
        right, down = halton(number, 1, shift=self._shift)[0].tolist()
        return right, down

    def first_radius(self, photons: PhotonMap) -> FirstRadius:
        return FirstRadius(photons, self.recipe.settings, self.n_threads)


class Points(Protocol):
    """Where photons are gathered, and what is kept of them."""

    def passed(self, photons: PhotonMap, number: int) -> Callable[[], None]:
        """Look at a pass; what is returned counts it in when it is called."""

    def arrays(self) -> dict[str, Any]:
        """Return what is kept, of one pass at least."""

    def restore(self, kept: dict[str, NDArray]) -> None:
        """Take up what `arrays` returned."""

    def layers(self, n_passes: int) -> dict[str, Floats]:
        """Return the layers of the picture after so many passes, but for the radiance."""


class FixedPoints:
    """Hit points that stay: each has a disc of its own."""

    def __init__(self, view: View) -> None:
        self._view = view
        self._bands = list(view.bands())
        self._seen = joined([band.fixed_layers() for band in self._bands])
        self._position = np.concatenate([band.hits.position for band in self._bands])
        self._normal = np.concatenate([band.hits.normal for band in self._bands])
        self._statistics: ProgressiveStatistics | None = None

    def passed(self, photons: PhotonMap, number: int) -> Callable[[], None]:
        if self._statistics is None:
            first = self._view.first_radius(photons)
            self._statistics = self._started(first(self._position, self._normal))
        statistics = self._statistics
        statistics.find(Pass(photons, photons.flux, self._view.n_threads))
        return partial(statistics.count_in, pass_weight(photons))

    def arrays(self) -> dict[str, Any]:
        return {} if self._statistics is None else self._statistics.arrays()

    def restore(self, kept: dict[str, NDArray]) -> None:
        self._statistics = self._started(kept["radius"])
        self._statistics.restore(kept)

    def layers(self, n_passes: int) -> dict[str, Floats]:
        assert self._statistics is not None, "pictures are shown after the first pass"
        irradiance = self._statistics.irradiance()
        ends = np.cumsum([len(band.hits) for band in self._bands])[:-1]
        parts = zip(self._bands, np.split(irradiance, ends), strict=True)
        caustic = np.concatenate([band.radiance(part) for band, part in parts])
        return {"caustic": caustic, **self._seen}

    def _started(self, radius: Floats) -> ProgressiveStatistics:
        return ProgressiveStatistics(
            self._position,
            self._normal,
            radius,
            alpha=self._view.recipe.settings.alpha,
            n_threads=self._view.n_threads,
        )


class MovingPoints:
    """Hit points that move with every pass: those of a pixel share its disc.

    What is kept of a pixel's photons is their flux times what turns irradiance at the hit point
    into the pixel's radiance; what is kept of other layers are sums over passes.
    """

    def __init__(self, view: View) -> None:
        self._view = view
        self._discs: Discs | None = None
        self._seen: dict[str, Floats] = {}

    def passed(self, photons: PhotonMap, number: int) -> Callable[[], None]:
        seen = list(self._view.bands(self._view.offset(number)))
        discs = self._discs
        if discs is None:
            discs = self._started(self._first_radius(photons, seen))
        photons_of_pass = Pass(photons, photons.flux, self._view.n_threads)
        found = [self._found(photons_of_pass, band, discs.radius) for band in seen]
        counts, sums = (np.concatenate(column) for column in zip(*found, strict=True))
        layers = joined([band.fixed_layers() for band in seen])
        return partial(self._count_in, discs, layers, (counts, sums, pass_weight(photons)))

    def _count_in(
        self, discs: Discs, layers: dict[str, Floats], found: tuple[NDArray, Floats, float]
    ) -> None:
        self._discs = discs
        discs.narrow(*found)
        for name, layer in layers.items():
            merge = np.minimum if name == "Z" else np.add
            self._seen[name] = merge(self._seen[name], layer) if name in self._seen else layer

    def _found(self, photons: Pass, band: Band, radius: Floats) -> tuple[NDArray, Floats]:
        """Return numbers and sums of the photons that each pixel of a band sees."""
        hits = band.hits
        counts, sums = np.empty(len(hits), dtype=np.int64), np.empty((len(hits), 3))
        points = (hits.position, hits.normal)
        photons.sums_within(points, radius[hits.pixel], out=sums, counts=counts)
        numbers = band.sums(counts[:, np.newaxis].astype(np.float64))
        return numbers.ravel().astype(np.int64), band.radiance(sums).reshape(-1, 3)

    def _first_radius(self, photons: PhotonMap, seen: list[Band]) -> Floats:
        """Return the least radius of the hit points of each pixel."""
        first = self._view.first_radius(photons)
        radius = np.full(self._view.shape, first.largest).ravel()
        for band in seen:
            np.minimum.at(radius, band.hits.pixel, first(band.hits.position, band.hits.normal))
        return radius

    def _started(self, radius: Floats) -> Discs:
        alpha = self._view.recipe.settings.alpha
        return Discs(radius, 3, alpha=alpha, n_threads=self._view.n_threads)

    def arrays(self) -> dict[str, Any]:
        if self._discs is None:
            return {}
        seen = {f"seen_{name}": layer for name, layer in self._seen.items()}
        return {**self._discs.arrays(), **seen}

    def restore(self, kept: dict[str, NDArray]) -> None:
        self._discs = self._started(kept["radius"])
        self._discs.restore(kept)
        self._seen = {name: kept[f"seen_{name}"] for name in ("direct", "albedo", "N", "Z")}

    def layers(self, n_passes: int) -> dict[str, Floats]:
        assert self._discs is not None, "pictures are shown after the first pass"
        seen = {n: layer if n == "Z" else layer / n_passes for n, layer in self._seen.items()}
        return {"caustic": self._discs.densities().reshape(*self._view.shape, 3), **seen}
