"""Statistics of photons at hit points over the passes of a progressive render."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from .._util import validation
from .._util.npz import check_names, scalar
from .._util.validation import Floats
from ..estimation.indirect import IndirectField
from ..estimation.nearest import GatherSettings
from ..estimation.progressive import (
    HitPointStatistics,
    InitialRadius,
    PhotonPass,
    ProgressiveSettings,
)
from ..imaging.image import MAY_BE_INFINITE
from ..photons.photon_map import PhotonMap
from ..photons.photon_trees import PhotonTrees, morton_order
from ..transport.sampling import halton, seed_shift
from .layers import band_layers, merge_passes, merged_layers
from .view import Band, View, concatenate_bands, pixel_sums

# Names of arrays in checkpoints: of statistics, and before those of layers.
_STATISTICS = ("radius", "n", "tau", "weight", "disc_passes")
_SEEN = "seen_"


@dataclass(frozen=True)
class PassSettings:
    """Parameters that the passes of a run depend on, beside the scene."""

    settings: ProgressiveSettings
    photons_per_pass: int
    seed: int
    supersampling: int
    stochastic: bool
    max_depth: int
    light_samples: int | None = None
    n_global: int = 0
    indirect: GatherSettings | None = None

    def to_dict(self) -> dict[str, Any]:
        """All values by their names, for JSON; those of some lights only where there are any."""
        values = asdict(self)
        for name in ("light_samples", "n_global", "indirect"):
            if not values[name]:
                del values[name]
        settings = values.pop("settings")
        del settings["n_passes"]  # of photon maps that are split into passes
        return {**settings, **values}

    def statistics(self, radius: Floats, n_before: int, n_threads: int) -> HitPointStatistics:
        """Statistics with initial radii, after a number of passes without photons."""
        statistics = HitPointStatistics(radius, 3, n_threads=n_threads, **self._shrinkage)
        statistics.n_passes = n_before
        statistics.weight = float(n_before * self.photons_per_pass)
        return statistics

    @property
    def _shrinkage(self) -> dict[str, Any]:
        return {"alpha": self.settings.alpha, "is_global": self.settings.is_global}

    def restored(
        self, arrays: Mapping[str, NDArray], n_points: int, n_passes: int, n_threads: int
    ) -> HitPointStatistics | None:
        """Statistics saved after a number of passes, None if they have none.

        Raises
        ------
        TypeError, ValueError
            If the arrays are not of so many hit points and passes.
        """
        if not arrays.keys() & set(_STATISTICS):
            return None
        check_names(arrays, _STATISTICS)
        columns = {name: arrays[name] for name in ("radius", "n", "tau")}
        statistics = HitPointStatistics.from_columns(
            **columns, shape=(n_points, 3), n_threads=n_threads, **self._shrinkage
        )
        statistics.n_passes = validation.count(scalar(arrays, "disc_passes", "iu"), "disc_passes")
        statistics.weight = validation.positive(scalar(arrays, "weight", "f"), "weight")
        if statistics.n_passes != n_passes or statistics.weight != n_passes * self.photons_per_pass:
            raise ValueError(
                f"disc_passes and weight should be of {n_passes} passes of "
                f"{self.photons_per_pass} photons, but are {statistics.n_passes} and "
                f"{statistics.weight:g}"
            )
        return statistics


@dataclass(frozen=True)
class PassState:
    """State of a run after some passes; immutable, each pass makes another.

    Attributes
    ----------
    statistics : HitPointStatistics or None
        None until a photon was stored, from which the initial radii follow.
    combined : dict
        Layers that do not depend on photons, combined over passes, if they vary between these.
    """

    statistics: HitPointStatistics | None = None
    combined: dict[str, Floats] = field(default_factory=dict)

    def arrays(self) -> dict[str, Any]:
        """The state as arrays for a checkpoint."""
        combined = {f"{_SEEN}{name}": layer for name, layer in self.combined.items()}
        s = self.statistics
        if s is None:
            return combined
        values = {name: getattr(s, name) for name in ("radius", "n", "tau", "weight")}
        return {**values, "disc_passes": s.n_passes, **combined}


class PassSums(NamedTuple):
    """Numbers (m,) and sums (m, 3) of the photons of a pass, and layers that it sees by itself."""

    counts: Floats
    sums: Floats
    layers: dict[str, Floats]


_NOTHING = PassSums(np.empty(0), np.empty((0, 3)), {})


class PassHitPoints(ABC):
    """Hit points that passes of photons are gathered at."""

    def __init__(self, view: View, settings: PassSettings) -> None:
        self._view = view
        self._settings = settings

    def after(self, state: PassState, photons: PhotonMap, number: int) -> PassState:
        """State after the pass of a number, from zero, given that before it."""
        gathered = _Gatherer(photons, self._settings, self._view)
        statistics = state.statistics
        if statistics is None and not gathered.is_empty:
            start = self._initial_radius(gathered, number)
            statistics = self._settings.statistics(start, number, self._view.n_threads)
        radius = None if statistics is None else statistics.pass_radius()
        return self.with_sums(state, statistics, self._sums(gathered, number, radius))

    def sums(self, photons: PhotonMap, number: int, radius: Floats) -> PassSums:
        """Sums of the photons of the pass of a number within radii (m,)."""
        return self._sums(_Gatherer(photons, self._settings, self._view), number, radius)

    def with_sums(
        self, state: PassState, statistics: HitPointStatistics | None, found: PassSums
    ) -> PassState:
        """State to whose statistics, or first ones, what a pass found is added."""
        if statistics is not None:
            statistics = statistics.copy()
            weight = float(self._settings.photons_per_pass)
            statistics.update(found.counts, found.sums, weight)
        return PassState(statistics, merge_passes(state.combined, found.layers))

    @abstractmethod
    def _initial_radius(self, gathered: _Gatherer, number: int) -> Floats:
        """Initial radii (m,), from the photons of the first pass that has any."""

    @abstractmethod
    def _sums(self, gathered: _Gatherer, number: int, radius: Floats | None) -> PassSums:
        """Sums within radii (m,), None before there are photons."""

    @abstractmethod
    def restored(self, arrays: Mapping[str, NDArray], n_passes: int) -> PassState:
        """State whose `PassState.arrays` are given, after a number of passes.

        Raises
        ------
        TypeError, ValueError
            If they are those of no such state.
        """

    @abstractmethod
    def layers(self, state: PassState, n_passes: int) -> dict[str, Floats]:
        """Layers of the image after a number of passes, except ``radiance``."""


class FixedHitPoints(PassHitPoints):
    """Hit points that are the same in every pass (PPM); each piece of surface has statistics.

    Estimates are means over pieces, as in `Band.estimates`.
    """

    def __init__(
        self, view: View, settings: PassSettings, indirect: IndirectField | None = None
    ) -> None:
        super().__init__(view, settings)
        view.check_hits_fit()
        fixed, pieces, hits = [], [], []
        n_pieces = 0
        for band in view.bands():
            fixed.append(_layers_of(band, indirect))
            *piece, of_hit = band.pieces()
            pieces.append(piece)
            hits.append((n_pieces + of_hit, band.hits.pixel, band.reflectance))
            n_pieces += len(piece[0])
        self._fixed = concatenate_bands(fixed)
        position, normal, self._footprint = map(np.concatenate, zip(*pieces, strict=True))
        self._points = position, normal
        self._order = morton_order(position, view.n_threads)
        self._piece, self._pixel, self._scale = map(np.concatenate, zip(*hits, strict=True))

    def _initial_radius(self, gathered: _Gatherer, number: int) -> Floats:
        edges = self._view.surface.edges
        return gathered.initial_radius()(*self._points, self._footprint, edges)

    def _sums(self, gathered: _Gatherer, number: int, radius: Floats | None) -> PassSums:
        if radius is None:
            return _NOTHING
        found = gathered.within(self._points, radius, self._order, self._footprint)
        return PassSums(*found, {})

    def restored(self, arrays: Mapping[str, NDArray], n_passes: int) -> PassState:
        n_points, threads = len(self._footprint), self._view.n_threads
        return PassState(self._settings.restored(arrays, n_points, n_passes, threads))

    def layers(self, state: PassState, n_passes: int) -> dict[str, Floats]:
        caustic = np.zeros((*self._view.shape, 3))
        if state.statistics is not None:
            densities = state.statistics.densities()
            caustic = pixel_sums(
                self._pixel, densities, self._view.shape, self._piece, weight=self._scale
            )
        return {"caustic": caustic, **self._fixed}


class StochasticHitPoints(PassHitPoints):
    """Hit points that are jittered in their pixels by every pass and share its statistics (SPPM).

    The statistics of a pixel are of the radiance that photons cause: flux times weight · albedo / π
    of the hit point.
    """

    def __init__(
        self, view: View, settings: PassSettings, indirect: IndirectField | None = None
    ) -> None:
        super().__init__(view, settings)
        self._indirect = indirect
        self._shift = seed_shift(settings.seed)

    def _initial_radius(self, gathered: _Gatherer, number: int) -> Floats:
        return self._least_radius(gathered.initial_radius(), self.offset(number))

    def _sums(self, gathered: _Gatherer, number: int, radius: Floats | None) -> PassSums:
        layers, found = [], []
        for band in self._view.bands(self.offset(number), number):
            layers.append(_layers_of(band, self._indirect))
            if radius is not None:
                found.append(gathered.within_pixels(band, radius))
        seen = concatenate_bands(layers)
        if radius is None:
            return _NOTHING._replace(layers=seen)
        counts, sums = (np.concatenate(column) for column in zip(*found, strict=True))
        return PassSums(counts, sums, seen)

    def restored(self, arrays: Mapping[str, NDArray], n_passes: int) -> PassState:
        height, width = self._view.shape
        threads = self._view.n_threads
        statistics = self._settings.restored(arrays, height * width, n_passes, threads)
        seen = _layers_of(next(self._view.bands(self.offset(0))), self._indirect)
        check_names(arrays, [f"{_SEEN}{name}" for name in seen])
        combined = {
            name: _restored_layer(arrays[f"{_SEEN}{name}"], name, (height, *layer.shape[1:]))
            for name, layer in seen.items()
        }
        return PassState(statistics, combined)

    def offset(self, number: int) -> tuple[float, float]:
        """Sample offset of a pass: the Halton points of all passes fill the pixel evenly."""
        right, down = halton(number, 1, shift=self._shift)[0].tolist()
        return right, down

    def _least_radius(self, initial: InitialRadius, offset: tuple[float, float]) -> Floats:
        """Least initial radius of the hit points of each pixel."""
        radius = np.full(self._view.shape, initial.largest).ravel()
        for band in self._view.bands(offset):
            np.minimum.at(radius, band.hits.pixel, initial(band.hits.position, band.hits.normal))
        return radius

    def layers(self, state: PassState, n_passes: int) -> dict[str, Floats]:
        caustic = np.zeros((*self._view.shape, 3))
        if state.statistics is not None:
            caustic = state.statistics.densities().reshape(caustic.shape)
        return {"caustic": caustic, **merged_layers(state.combined, n_passes)}


def _layers_of(band: Band, indirect: IndirectField | None) -> dict[str, Floats]:
    """Layers of a band that do not depend on the photons of passes."""
    estimates = {}
    if indirect is not None:
        estimates["indirect"] = band.radiance(*band.estimates(indirect))
    return band_layers(band, estimates)


def _restored_layer(values: NDArray, name: str, shape: tuple[int, ...]) -> Floats:
    """Layer that was combined over passes, infinite only where one of an image may be."""
    may_be_infinite = name in MAY_BE_INFINITE
    layer = validation.float_array(values, f"{_SEEN}{name}", shape, finite=not may_be_infinite)
    if np.isnan(layer).any() or (layer == -np.inf).any():
        raise ValueError(f"{_SEEN}{name} should hold numbers, but some are NaN or -inf")
    return layer


class _Gatherer:
    """Photons of a pass, ready to be gathered at hit points."""

    def __init__(self, photons: PhotonMap, settings: PassSettings, view: View) -> None:
        n_threads = view.n_threads
        trees = PhotonTrees(photons, n_threads)
        self.within = PhotonPass(trees, photons.flux, n_threads, view.surface).within
        self.is_empty = len(photons) == 0
        self.initial_radius = partial(InitialRadius, photons, settings.settings, n_threads, trees)

    def within_pixels(self, band: Band, radius: Floats) -> tuple[Floats, Floats]:
        """Numbers and sums of the photons within the radii of the pixels of a band."""
        hits = band.hits
        counts, sums = self.within((hits.position, hits.normal), radius[hits.pixel])
        numbers = band.sums(counts[:, np.newaxis])
        return numbers.ravel(), band.radiance(sums).reshape(-1, 3)
