"""Hit points of a picture made in passes: kept, or moved about in their pixels by every pass."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import asdict, dataclass, field
from functools import partial
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from .._util.validation import Floats
from ..estimation.progressive import (
    HitPointStatistics,
    InitialRadius,
    PhotonPass,
    ProgressiveSettings,
)
from ..photons.photon_map import PhotonMap
from ..photons.photon_trees import PhotonTrees, morton_order
from ..scene.scene import Scene
from ..transport.raycast import RayCaster
from ..transport.sampling import halton, seed_shift
from .view import Band, bands, joined


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

    def looked_at(self, photons: PhotonMap) -> Look:
        """Return a pass of photons, ready to be gathered."""
        return Look(self, photons)

    def discs(self, radius: Floats, n_before: int) -> HitPointStatistics:
        """Return discs that found nothing in so many passes."""
        discs = HitPointStatistics(
            radius, 3, alpha=self.recipe.settings.alpha, n_threads=self.n_threads
        )
        discs.n_passes = n_before
        discs.weight = float(n_before * self.recipe.photons_per_pass)
        return discs


class Look:
    """A pass of photons as hit points look at it."""

    def __init__(self, view: View, photons: PhotonMap) -> None:
        trees = PhotonTrees(photons, view.n_threads)
        settings = view.recipe.settings
        self.found = PhotonPass(trees, photons.flux, view.n_threads).within
        self.weight = float(view.recipe.photons_per_pass)
        self.is_empty = len(photons) == 0
        self._first = partial(InitialRadius, photons, settings, view.n_threads, trees)

    def initial_radius(self) -> InitialRadius:
        return self._first()


@dataclass(frozen=True)
class Kept:
    """What a run keeps of its passes; never changed, but followed by that after the next pass.

    Attributes
    ----------
    discs : HitPointStatistics or None
        None until a photon was stored: there is no telling how far to look for it.
    seen : dict
        Sums over passes of the layers that need no photons, where these change.
    """

    discs: HitPointStatistics | None = None
    seen: dict[str, Floats] = field(default_factory=dict)

    def arrays(self) -> dict[str, Any]:
        """Return all that later passes build upon."""
        seen = {f"seen_{name}": layer for name, layer in self.seen.items()}
        if self.discs is None:
            return seen
        discs = {name: getattr(self.discs, name) for name in ("radius", "n", "tau", "weight")}
        return {**discs, "disc_passes": self.discs.n_passes, **seen}

    @classmethod
    def of(cls, arrays: dict[str, NDArray], view: View) -> Kept:
        """Return what `arrays` returned such of."""
        ahead = "seen_"
        seen = {n.removeprefix(ahead): a for n, a in arrays.items() if n.startswith(ahead)}
        if "radius" not in arrays:
            return cls(None, seen)
        discs = view.discs(arrays["radius"], int(arrays["disc_passes"]))
        discs.n, discs.tau = arrays["n"], arrays["tau"]
        discs.weight = float(arrays["weight"])
        return cls(discs, seen)


class Points(Protocol):
    """Where photons are gathered."""

    def after(self, kept: Kept, photons: PhotonMap, number: int) -> Kept:
        """Return what is kept after a pass by its number, from zero, and those before it."""

    def layers(self, kept: Kept, n_passes: int) -> dict[str, Floats]:
        """Return the layers of the picture after so many passes, but for the radiance."""


class FixedPoints:
    """Hit points that stay: each has a disc of its own."""

    def __init__(self, view: View) -> None:
        self._view = view
        seen, hits, scale = [], [], []
        for band in view.bands():
            seen.append(band.fixed_layers())
            hits.append((band.hits.position, band.hits.normal, band.hits.pixel))
            scale.append(band.hits.weight * band.hits.albedo / np.pi)
        self._seen = joined(seen)
        position, normal, self._pixel = (
            np.concatenate(column) for column in zip(*hits, strict=True)
        )
        self._points = position, normal
        self._order = morton_order(position, view.n_threads)
        self._scale = np.concatenate(scale)

    def after(self, kept: Kept, photons: PhotonMap, number: int) -> Kept:
        look, discs = self._view.looked_at(photons), kept.discs
        if discs is None:
            if look.is_empty:
                return kept
            discs = self._view.discs(look.initial_radius()(*self._points), number)
        discs = discs.copy()
        discs.update(*look.found(self._points, discs.radius, self._order), look.weight)
        return Kept(discs)

    def layers(self, kept: Kept, n_passes: int) -> dict[str, Floats]:
        caustic = np.zeros((*self._view.shape, 3))
        if kept.discs is not None:
            for channel, column in enumerate((self._scale * kept.discs.densities()).T):
                sums = np.bincount(self._pixel, column, minlength=caustic[..., 0].size)
                caustic[..., channel] = sums.reshape(self._view.shape)
        return {"caustic": caustic, **self._seen}


class MovingPoints:
    """Hit points that move with every pass: those of a pixel share its disc.

    What is kept of a pixel's photons is their flux times what turns irradiance at the hit point
    into the pixel's radiance; what is kept of other layers are sums over passes.
    """

    def __init__(self, view: View) -> None:
        self._view = view

    def after(self, kept: Kept, photons: PhotonMap, number: int) -> Kept:
        look, discs = self._view.looked_at(photons), kept.discs
        if discs is None and not look.is_empty:
            discs = self._view.discs(self._initial_radius(look, number), number)
        layers, found = [], []
        for band in self._view.bands(self._view.offset(number)):
            layers.append(band.fixed_layers())
            if discs is not None:
                found.append(_found(look, band, discs.radius))
        if discs is not None:
            counts, sums = (np.concatenate(column) for column in zip(*found, strict=True))
            discs = discs.copy()
            discs.update(counts, sums, look.weight)
        return Kept(discs, _merged(kept.seen, joined(layers)))

    def _initial_radius(self, look: Look, number: int) -> Floats:
        """Return the least radius of the hit points of each pixel."""
        first = look.initial_radius()
        radius = np.full(self._view.shape, first.largest).ravel()
        for band in self._view.bands(self._view.offset(number)):
            np.minimum.at(radius, band.hits.pixel, first(band.hits.position, band.hits.normal))
        return radius

    def layers(self, kept: Kept, n_passes: int) -> dict[str, Floats]:
        caustic = np.zeros((*self._view.shape, 3))
        if kept.discs is not None:
            caustic = kept.discs.densities().reshape(caustic.shape)
        seen = {n: layer if n == "Z" else layer / n_passes for n, layer in kept.seen.items()}
        return {"caustic": caustic, **seen}


def _found(look: Look, band: Band, radius: Floats) -> tuple[NDArray, Floats]:
    """Return numbers and sums of the photons that each pixel of a band sees."""
    hits = band.hits
    counts, sums = look.found((hits.position, hits.normal), radius[hits.pixel])
    numbers = band.sums(counts[:, np.newaxis].astype(np.float64))
    return numbers.ravel().astype(np.int64), band.radiance(sums).reshape(-1, 3)


def _merged(before: dict[str, Floats], layers: dict[str, Floats]) -> dict[str, Floats]:
    """Return sums over passes, of the depth the least."""
    if not before:
        return layers
    return {
        name: (np.minimum if name == "Z" else np.add)(before[name], layer)
        for name, layer in layers.items()
    }
