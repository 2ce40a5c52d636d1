"""Tracing of envelopes: charts, the sheets that are followed, their division, and what is left."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Executor
from contextlib import nullcontext
from dataclasses import replace
from time import perf_counter
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..._util.parallel import thread_count, thread_executor
from ..._util.validation import Floats
from ..._util.workers import checked_executor
from ...scene.emitters import CollimatedEmitter
from ...scene.scene import Scene
from ...transport.aim import LUMINANCE
from ...transport.raycast import RayCaster
from ...transport.splitting import SplittingTracer
from .charts import Chart, charts_of
from .elements import first_corners, luminances, six_places
from .envelope import NOISE, Envelope, EnvelopeLedger, EnvelopeSettings
from .lattice import Lattice
from .laying import OF_IMAGES, Laid, laid, squares
from .refinement import Refinement
from .rest import Rest, photons_wanted, rest_photons
from .sheets import FollowedSheets, Points, followed_sheets
from .suns import FOOTPRINTS, extent, sun_charts

# Rays to trace and photons to emit, at most, unless settings or a render tell.
_MOST_RAYS, _MOST_PHOTONS = 1_000_000, 1_000_000
# Rays for cutting borders, at most, unless settings limit rays: torn images take longest to lay
# down, and gain least by division.
_MOST_OF_BORDERS = 200_000
# Cells of the first grid of a chart, at most and at least, and the share of the rays that may be
# traced that their nodes take, four each.
_MOST_CELLS, _LEAST_CELLS, _OF_RAYS = 32 * 32, 16, 0.25 / 4
# Branches of less of a node's light are followed as single photons.
_LEAST_THROUGHPUT = 1e-2
# Share of a time that rays are traced in: images are laid down in the rest, and photons traced, so
# many at least.
_OF_TRACING, _LEAST_PHOTONS = 0.7, 10_000
# Share of the misplaced light that is left to leaves not divided in a pass.
_LEFT = 0.5
# Sheets are given up if more than these shares of their flux, and of the elements on which they do
# alone, are torn or jump after some divisions.
_GIVEN_UP, _ALONE, _DIVISIONS = 0.9, 0.5, 4
# Where rays are used up, sheets are given up if more than this share of their flux is torn or jumps
# and no more than a share of the rays of borders would be left without them.
_MOSTLY, _OTHERS = 0.6, 0.5


def trace_envelope(
    scene: Scene,
    *,
    n_rays: int | None = None,
    error: float | None = None,
    seconds: float | None = None,
    footprint: float | None = None,
    n_photons: int | None = None,
    n_threads: int | None = None,
    caster: RayCaster | None = None,
    executor: Executor | None = None,
) -> Envelope:
    """Lay the light of the emitters of a scene over its images.

    Parameters
    ----------
    scene : Scene
        Light of emitters with a size, and of sheets that are not smooth, is that of photons.
    n_rays, error, seconds, footprint, n_photons : int, float, float, float, int, optional
        As of `EnvelopeSettings`.
    n_threads : int, optional
        Threads; all by default. The result does not depend on them.
    caster : RayCaster, optional
        Of the scene: building it takes time.
    executor : concurrent.futures.Executor, optional
        Traces in its workers, as `trace_photons` does; the result is the same, to the bit.

    Returns
    -------
    Envelope
        For ``irradiance_field(envelope, method="envelope")``.

    Raises
    ------
    TypeError, ValueError
        If no light arrives, or a number is out of its range.
    """
    settings = EnvelopeSettings(n_rays, error, seconds, footprint, n_photons)
    return laid_envelope(scene, settings, n_threads, caster, checked_executor(executor))


def laid_envelope(
    scene: Scene,
    settings: EnvelopeSettings,
    n_threads: int | None = None,
    caster: RayCaster | None = None,
    executor: Executor | None = None,
) -> Envelope:
    """Envelope of a scene; see `trace_envelope`."""
    threads, caster = thread_count(n_threads), caster or RayCaster(scene.surfaces)
    with nullcontext(executor) if executor else thread_executor(threads) as workers:
        tracer = SplittingTracer(scene, _LEAST_THROUGHPUT, caster=caster, executor=workers)
        return _laid(tracer, scene, settings, n_threads=threads, caster=caster, executor=executor)


def _laid(
    tracer: SplittingTracer,
    scene: Scene,
    settings: EnvelopeSettings,
    *,
    n_threads: int,
    caster: RayCaster,
    executor: Executor | None,
) -> Envelope:
    """Envelope of a scene, by its tracer; the executor is for photons."""
    started = perf_counter()
    charts = _charts(scene, tracer, settings)
    n_rays = settings.n_rays or _MOST_RAYS
    followed = followed_sheets(charts, tracer, n_rays, settings.expected)
    lattices = _lattices(charts, tracer, followed, n_rays)
    if len(followed) == len(scene.emitters) and not lattices:
        raise ValueError(
            "light should arrive on a Diffuse surface by way of a specular one, but none of that "
            f"of {tracer.n_segments:,} rays does"
        )
    if settings.footprint is None and lattices:
        settings = replace(settings, footprint=_extent(lattices) / FOOTPRINTS)
    refinements = [Refinement(each, settings.footprint or 1.0, n_threads) for each in lattices]
    _refine(refinements, list(followed.values()), settings, started)
    traced = perf_counter()
    wanted = _photons_wanted(charts, followed, refinements, settings)
    left = _left_out(charts, followed, wanted)
    of_borders = _rays_for_borders(refinements, settings, started)
    found = _images(
        refinements, charts, left, of_borders, footprint=settings.footprint, n_threads=n_threads
    )
    laid_down = perf_counter()
    rest = rest_photons(
        scene,
        wanted,
        {emitter_id: each.sheets for emitter_id, each in followed.items()},
        n_photons=_most_photons(settings, tracer.n_rays, laid_down - started),
        n_threads=n_threads,
        caster=caster,
        executor=executor,
    )
    return Envelope(
        *found.images,
        chart=found.chart,
        charts=charts,
        objects={k: v for each in followed.values() for k, v in each.surfaces.items()},
        surface_ids=scene.surface_ids,
        rest=rest.photons,
        ledger=_ledger(rest, charts, found),
        settings=settings,
        n_rays=tracer.n_rays,
        n_segments=tracer.n_segments,
        n_elements=sum(len(each.patches) for each in refinements),
        seconds={
            "trace envelope": traced - started,
            "lay": laid_down - traced,
            "trace rest": perf_counter() - laid_down,
        },
    )


def _charts(scene: Scene, tracer: SplittingTracer, settings: EnvelopeSettings) -> list[Chart]:
    """Charts of all emitters, those of the parallel lights in place of suns among them."""
    charts = charts_of(scene)
    for emitter_id, emitter in enumerate(scene.emitters):
        if isinstance(emitter, CollimatedEmitter) and emitter.is_extended:
            charts += sun_charts(scene, emitter_id, tracer, settings)
    return charts


def _lattices(
    charts: list[Chart],
    tracer: SplittingTracer,
    followed: dict[int, FollowedSheets],
    n_rays: int,
) -> list[Lattice]:
    """Lattices of the charts that light of followed sheets arrives from, with their first nodes."""
    most = _OF_RAYS * n_rays / max(len(charts), 1)
    n_cells = int(np.clip(most, _LEAST_CELLS, _MOST_CELLS))
    lattices = [
        Lattice(chart, tracer, followed[chart.emitter_id], n_cells)
        for chart in charts
        if len(followed[chart.emitter_id].sheets)
    ]
    for lattice in lattices:
        lattice.nodes(six_places(first_corners(lattice)).reshape(-1, 2))
    return [lattice for lattice in lattices if len(lattice.arrivals)]


def _refine(
    refinements: list[Refinement],
    followed: list[FollowedSheets],
    settings: EnvelopeSettings,
    started: float,
) -> None:
    """Divide elements, where most light is misplaced first, up to one of the limits."""
    end = np.inf if settings.seconds is None else started + settings.seconds
    n_passes = 0
    while perf_counter() < end:
        if not _divided(refinements, settings, started):
            if _is_fine(refinements, settings) or not _drop(followed, refinements, _takes_rays):
                break
            continue
        n_passes += 1
        if n_passes == _DIVISIONS:
            _drop(followed, refinements, _is_rough)
    _drop(followed, refinements, _falls_short)
    if settings.misplaced > 0.0 and not _is_fine(refinements, settings):
        _drop(followed, refinements, _is_worse_than_photons)


def _divided(refinements: list[Refinement], settings: EnvelopeSettings, started: float) -> bool:
    """Divide elements once; false if none are to be."""
    score = np.array([each.score for each in refinements])
    allowed = _allowed(refinements, settings)
    left = _rays_left(refinements, settings, started)
    if score.sum() <= allowed or left <= 0.0:
        return False
    share = score / score.sum()
    divided = [
        each.divide(_LEFT * allowed * part, left * part)
        for each, part in zip(refinements, share, strict=True)
    ]
    return any(divided)


def _is_fine(refinements: list[Refinement], settings: EnvelopeSettings) -> bool:
    """Whether images misplace no more than they may."""
    return sum(each.score for each in refinements) <= _allowed(refinements, settings)


def _allowed(refinements: list[Refinement], settings: EnvelopeSettings) -> float:
    """Luminance that images may misplace, W."""
    return OF_IMAGES * settings.misplaced * sum(each.luminance for each in refinements)


def _rays_left(refinements: list[Refinement], settings: EnvelopeSettings, started: float) -> float:
    """Rays that may still be traced, without those of borders."""
    traced = refinements[0].lattice.n_traced if refinements else 0
    left: float = min(_MOST_RAYS - traced, _MOST_OF_BORDERS)
    if settings.n_rays is not None:
        left = settings.n_rays - traced
    if settings.seconds is not None:
        taken = perf_counter() - started
        left = min(left, traced * (_OF_TRACING * settings.seconds / taken - 1.0))
    return left - sum(each.n_rays_of_borders for each in refinements)


def _rays_for_borders(
    refinements: list[Refinement], settings: EnvelopeSettings, started: float
) -> float:
    """Rays that cutting borders may take."""
    left = _rays_left(refinements, settings, started)
    return left + sum(each.n_rays_of_borders for each in refinements)


def _most_photons(settings: EnvelopeSettings, n_rays: int, taken: float) -> int:
    """Photons to emit, at most: as many a second as rays in the time taken so far."""
    most = settings.n_photons or _MOST_PHOTONS
    if settings.seconds is None or n_rays == 0:
        return most
    in_time = n_rays * (settings.seconds / taken - 1.0)
    return min(most, max(int(in_time), _LEAST_PHOTONS))


def _drop(
    followed: list[FollowedSheets],
    refinements: list[Refinement],
    is_given_up: Callable[[FollowedSheets, list[Refinement]], NDArray[np.bool_]],
) -> bool:
    """Give up some sheets of each emitter; false if there are none."""
    is_any = False
    for sheets in followed:
        mine = [each for each in refinements if each.lattice.followed is sheets]
        if not mine:
            continue
        given_up = is_given_up(sheets, mine)
        if given_up.any():
            is_any = True
            sheets.drop(sheets.sheets[given_up])
            for each in mine:
                each.drop_unfollowed()
    return is_any


def _is_rough(followed: FollowedSheets, refinements: list[Refinement]) -> NDArray[np.bool_]:
    """Sheets of which hardly anything is smooth, and that take elements of their own for it."""
    whole, rough = np.sum([each.light_of_sheets for each in refinements], axis=0).T
    is_rough = rough > _GIVEN_UP * whole
    n, n_alone = np.sum([each.rough_elements(is_rough) for each in refinements], axis=0).T
    return is_rough & (n_alone > _ALONE * n)


def _takes_rays(followed: FollowedSheets, refinements: list[Refinement]) -> NDArray[np.bool_]:
    """Sheets most of which is not smooth, if rays for borders are mostly theirs."""
    whole, rough = np.sum([each.light_of_sheets for each in refinements], axis=0).T
    takes: NDArray[np.bool_] = rough > _MOSTLY * whole
    of_all = sum(each.n_rays_of_borders for each in refinements)
    of_others = sum(each.rays_of_borders(~takes) for each in refinements)
    return takes & (of_others < _OTHERS * of_all)


def _falls_short(followed: FollowedSheets, refinements: list[Refinement]) -> NDArray[np.bool_]:
    """Sheets of whose light much has not been found."""
    whole, _ = np.sum([each.light_of_sheets for each in refinements], axis=0).T
    return followed.falls_short(whole)


def _is_worse_than_photons(
    followed: FollowedSheets, refinements: list[Refinement]
) -> NDArray[np.bool_]:
    """Sheets of which images misplace more than photons would."""
    whole, _ = np.sum([each.light_of_sheets for each in refinements], axis=0).T
    misplaced = np.sum([each.misplaced_of_sheets for each in refinements], axis=0)
    is_worse: NDArray[np.bool_] = misplaced > NOISE * whole
    return is_worse


def _photons_wanted(
    charts: list[Chart],
    followed: dict[int, FollowedSheets],
    refinements: list[Refinement],
    settings: EnvelopeSettings,
) -> dict[int, float]:
    """Photons to emit for the sheets of each emitter that are not followed."""
    misplaced = sum(each.score for each in refinements) / OF_IMAGES
    luminance = sum(each.luminance for each in refinements)
    reached = misplaced / luminance if luminance else 0.0
    total = sum(each.luminance for each in followed.values())
    wanted = {}
    for emitter_id, each in followed.items():
        emitted = sum(
            chart.emitted @ LUMINANCE for chart in charts if chart.emitter_id == emitter_id
        )
        share = each.left / total if total else 0.0
        wanted[emitter_id] = photons_wanted(share, each.left / emitted, reached)
    return wanted


def _left_out(
    charts: list[Chart], followed: dict[int, FollowedSheets], wanted: dict[int, float]
) -> list[tuple[int, Points]]:
    """Light of charts that no image has and no photon is emitted for, as it was found first."""
    return [
        (number, followed[chart.emitter_id].points(chart, followed=False))
        for number, chart in enumerate(charts)
        if wanted[chart.emitter_id] == 0.0
    ]


class _LaidCharts(NamedTuple):
    """Triangles (n,), the charts that they are of, and the flux (3,) laid down around points, W."""

    images: Laid
    chart: NDArray[np.int32]
    of_points: Floats


def _images(
    refinements: list[Refinement],
    charts: list[Chart],
    left_out: list[tuple[int, Points]],
    n_rays: float,
    *,
    footprint: float | None,
    n_threads: int,
) -> _LaidCharts:
    """Triangles of all images.

    Borders are cut by at most so many rays.
    """
    footprint = footprint or 1.0
    numbers = [charts.index(each.lattice.chart) for each in refinements]
    found = [laid(each, n_rays / len(refinements), n_threads) for each in refinements]
    points = [(k, of_chart) for k, (_, of_chart) in zip(numbers, found, strict=True)] + left_out
    of_points = [squares(each, footprint) for _, each in points]
    parts = [part for images, _ in found for part in images] + of_points
    chart = np.repeat(numbers, [len(images) for images, _ in found]).tolist()
    chart += [number for number, _ in points]
    lengths = [len(each.flux) for each in parts]
    flux = np.sum([each.flux.sum(axis=0) for _, each in points] or [np.zeros(3)], axis=0)
    del found
    images = _joined(parts or [squares(Points.none(), footprint)])
    return _LaidCharts(images, np.repeat(np.array(chart, dtype=np.int32), lengths), flux)


def _joined(parts: list[Laid]) -> Laid:
    """All parts, which are taken from their list: each of their columns is freed once joined."""
    columns = list(zip(*parts, strict=True))
    parts.clear()
    return Laid(*[np.concatenate(columns.pop(0)) for _ in range(len(columns))])


def _extent(lattices: list[Lattice]) -> float:
    """Extent of most of the light, m."""
    position = np.concatenate([each.arrivals.position for each in lattices])
    return extent(position, luminances(np.concatenate([each.light for each in lattices])))


def _ledger(rest: Rest, charts: list[Chart], found: _LaidCharts) -> EnvelopeLedger:
    emitted = rest.emitted + np.sum([each.emitted for each in charts] or [np.zeros(3)], axis=0)
    photons = np.zeros(3) if rest.photons is None else rest.photons.flux.sum(axis=0)
    of_images = found.images.flux.sum(axis=0) - found.of_points
    lost = emitted - of_images - found.of_points - photons
    return EnvelopeLedger(emitted, of_images, found.of_points, photons, lost)
