"""Envelopes: light laid down over the images of the emitters, sheet by sheet.

A caustic is the image of an emitter under a map from its coordinates to where light lands, one map
for each path signature. A chart of the coordinates is divided into triangles; each carries its
flux to its image, and images add up. Nothing is random, and no density is estimated.
docs/methods/envelope.md has the derivation.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from time import perf_counter

import numpy as np

from ..._util import validation
from ..._util.frozen import set_field
from ..._util.parallel import thread_count
from ..._util.parcels import state_without_caches
from ..._util.validation import Floats
from ...scene.scene import Scene
from ...spatial.box_tree import BoxTree
from ...transport.splitting import SplittingTracer
from .borders import joined
from .charts import charts_of
from .elements import areas, first_corners, luminances, six_places
from .lattice import Lattice
from .laying import Laid, Points, laid, squares
from .refinement import Refinement

# Cells of the first grid of a chart.
_FIRST_CELLS = 32 * 32
# Branches of less of a node's light are followed as single photons.
_LEAST_THROUGHPUT = 1e-2
# Footprints across all light, where nothing says how fine it is looked at.
_FOOTPRINTS = 400
# Misplaced light, over all, unless asked for.
_ERROR = 0.01
# Share of the misplaced light that is left to leaves not divided in a pass.
_LEFT = 0.5


@dataclass(frozen=True)
class EnvelopeSettings:
    """Limits of the division of elements, and the length that images are resolved to.

    Attributes
    ----------
    n_rays : int, optional
        Rays from emitters, at most.
    error : float, optional
        Share of the light that may be misplaced; 0.01 unless rays or time are limited.
    seconds : float, optional
        Time for tracing, at most; which elements are divided then depends on the machine.
    footprint : float, optional
        Length that images are resolved to, m: the side of a texel, say. By default that of the
        pixels of a render, or 1/400 of the extent of the light.
    """

    n_rays: int | None = None
    error: float | None = None
    seconds: float | None = None
    footprint: float | None = None

    def __post_init__(self) -> None:
        if self.n_rays is not None:
            n_rays = validation.count(self.n_rays, "EnvelopeSettings.n_rays")
            set_field(self, "n_rays", n_rays)
        for name in ("error", "seconds", "footprint"):
            if getattr(self, name) is not None:
                value = validation.positive(getattr(self, name), f"EnvelopeSettings.{name}")
                set_field(self, name, value)

    @property
    def misplaced(self) -> float:
        """Share of the light that may be misplaced."""
        if self.error is not None:
            return self.error
        return _ERROR if self.n_rays is None and self.seconds is None else 0.0


@dataclass(frozen=True, eq=False)
class Envelope:
    """Images of all emitters of a scene as straight triangles.

    Attributes
    ----------
    position : (n, 3, 3) float64
        Corners, m.
    normal : (n, 3) float64
        Unit normals of the surfaces they lie on, on the side of the light.
    flux : (n, 3) float64
        W, even over each triangle.
    misplaced : (n,) float64
        Estimated luminance of each that lies elsewhere by a footprint or more, W.
    emitted : (3,) float64
        Flux that left through the charts, W.
    torn : (3,) float64
        Flux laid down around points, as it has no image that is smooth, W.
    settings : EnvelopeSettings
        Those used.
    n_rays, n_segments : int
        Rays from emitters, and of all.
    seconds : dict
        Time of each stage, s.
    """

    position: Floats
    normal: Floats
    flux: Floats
    misplaced: Floats
    emitted: Floats
    torn: Floats
    settings: EnvelopeSettings
    n_rays: int
    n_segments: int
    seconds: dict[str, float]

    __getstate__ = state_without_caches

    def __len__(self) -> int:
        return len(self.flux)

    @property
    def error(self) -> float:
        """Estimated share of the light that is misplaced."""
        total = float(luminances(self.flux).sum())
        return float(self.misplaced.sum()) / total if total else 0.0

    @cached_property
    def tree(self) -> BoxTree:
        """Boxes of the triangles."""
        return BoxTree(self.position.min(axis=1), self.position.max(axis=1))


def trace_envelope(
    scene: Scene,
    *,
    n_rays: int | None = None,
    error: float | None = None,
    seconds: float | None = None,
    footprint: float | None = None,
    n_threads: int | None = None,
) -> Envelope:
    """Lay the light of the emitters of a scene over its images.

    Parameters
    ----------
    scene : Scene
        Its emitters are parallel or points.
    n_rays, error, seconds, footprint : int, float, float, float, optional
        As of `EnvelopeSettings`.
    n_threads : int, optional
        Threads; all by default. The result does not depend on them.

    Returns
    -------
    Envelope
        For ``irradiance_field(envelope, method="envelope")``.

    Raises
    ------
    TypeError, ValueError
        If an emitter is extended, no light arrives, or a number is out of its range.
    """
    return laid_envelope(scene, EnvelopeSettings(n_rays, error, seconds, footprint), n_threads)


def laid_envelope(
    scene: Scene, settings: EnvelopeSettings, n_threads: int | None = None
) -> Envelope:
    """Envelope of a scene; see `trace_envelope`."""
    started = perf_counter()
    tracer = SplittingTracer(scene, _LEAST_THROUGHPUT, thread_count(n_threads))
    lattices = [Lattice(chart, tracer, _FIRST_CELLS) for chart in charts_of(scene)]
    for lattice in lattices:
        lattice.nodes(six_places(first_corners(lattice)).reshape(-1, 2))
    if not any(len(lattice.arrivals) for lattice in lattices):
        raise ValueError(
            "light should arrive on a Diffuse surface by way of a specular one, but none of that "
            f"of {sum(map(len, lattices)):,} rays does"
        )
    footprint = settings.footprint or _extent(lattices) / _FOOTPRINTS
    settings = replace(settings, footprint=footprint)
    refinements = [Refinement(lattice, footprint) for lattice in lattices]
    _refine(refinements, settings, started)
    traced = perf_counter()
    found = [laid(each) for each in refinements]
    scattered = joined(Points, [points for _, points in found])
    around = squares(scattered, footprint)
    return Envelope(
        *joined(Laid, [*(images for images, _ in found), around]),
        emitted=np.sum([_emitted(each) for each in refinements], axis=0),
        torn=scattered.flux.sum(axis=0),
        settings=settings,
        n_rays=sum(len(lattice) for lattice in lattices),
        n_segments=tracer.n_segments,
        seconds={"trace envelope": traced - started, "lay": perf_counter() - traced},
    )


def _refine(refinements: list[Refinement], settings: EnvelopeSettings, started: float) -> None:
    """Divide elements, where most light is misplaced first, up to one of the limits."""
    end = np.inf if settings.seconds is None else started + settings.seconds
    most = np.inf if settings.n_rays is None else settings.n_rays
    while perf_counter() < end:
        score = np.array([each.score for each in refinements])
        allowed = settings.misplaced * sum(each.luminance for each in refinements)
        left = most - sum(each.n_rays for each in refinements)
        if score.sum() <= allowed or left < 0:
            return
        share = score / score.sum()
        divided = [
            each.divide(_LEFT * allowed * part, left * part)
            for each, part in zip(refinements, share, strict=True)
        ]
        if not any(divided):
            return


def _extent(lattices: list[Lattice]) -> float:
    """Extent of most of the light, m: four deviations along the axis of the most."""
    position = np.concatenate([each.arrivals.position for each in lattices])
    weight = luminances(np.concatenate([each.light for each in lattices]))
    weight /= weight.sum()
    spread = weight @ np.square(position - weight @ position)
    return float(4.0 * np.sqrt(spread.max())) or 1.0


def _emitted(refinement: Refinement) -> Floats:
    """Flux (3,) that leaves through a chart, W."""
    area = areas(refinement.lattice, refinement.leaves.corners)
    power = refinement.lattice.power[refinement.leaves.nodes[:, 3:]].mean(axis=1)
    total: Floats = area @ power
    return total
