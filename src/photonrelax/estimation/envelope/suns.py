"""Parallel lights in place of a sun, as many as its penumbra asks for."""

from __future__ import annotations

import numpy as np

from ..._util.validation import Floats
from ...scene.emission_region import cap_directions
from ...scene.emitters import CollimatedEmitter
from ...scene.scene import Scene
from ...transport.aim import LUMINANCE
from ...transport.splitting import Arrivals, Signatures, SplittingTracer
from .charts import Chart, parallel_charts
from .envelope import EnvelopeSettings
from .sheets import scattered

# Rays by which the width of the penumbra is found.
_N_PROBES = 1024
# Lights for a penumbra as wide as a footprint, so that what they misplace is a hundredth; it falls
# with their number, of which photons are cheaper than the most.
_LIGHTS, _LEAST, _MOST = 8.0, 4, 64
# Rays that each of them takes at least, if rays are limited.
_RAYS_OF_LIGHT = 4000
# Error where rays or time end the division.
_ERROR = 0.01
# Tells nodes apart in keys.
_ODD = np.uint64(0x9E3779B97F4A7C15)
# Footprints across all light, where nothing says how fine it is looked at.
FOOTPRINTS = 400


def sun_charts(
    scene: Scene, emitter_id: int, tracer: SplittingTracer, settings: EnvelopeSettings
) -> list[Chart]:
    """Charts of parallel lights in place of a sun; none if they would be too many."""
    sun = scene.emitters[emitter_id]
    assert isinstance(sun, CollimatedEmitter)
    ratio = _penumbra(scene, emitter_id, tracer, settings)
    n = max(_LEAST, int(np.ceil(_LIGHTS * ratio**2 * 0.01 / (settings.misplaced or _ERROR))))
    most = _MOST if settings.n_rays is None else min(_MOST, settings.n_rays // _RAYS_OF_LIGHT)
    if n > most:
        return []
    return [
        chart for light in _lights(sun, n) for chart in parallel_charts(scene, light, emitter_id)
    ]


def _lights(sun: CollimatedEmitter, n: int) -> list[CollimatedEmitter]:
    """Parallel lights from directions that are even over a sun."""
    one_minus_cos = 2.0 * np.sin(0.5 * np.radians(sun.angular_radius)) ** 2
    golden = 0.5 * (np.sqrt(5.0) - 1.0)
    sample = np.column_stack([(np.arange(n) + 0.5) / n, np.mod(np.arange(n) * golden, 1.0)])
    centre = np.asarray(sun.direction)
    directions = cap_directions(centre, one_minus_cos, sample)
    irradiance = np.asarray(sun.irradiance) / (directions @ centre).sum()
    return [CollimatedEmitter(each, irradiance) for each in directions]


def _penumbra(
    scene: Scene, emitter_id: int, tracer: SplittingTracer, settings: EnvelopeSettings
) -> float:
    """Width of the penumbra in footprints: movement of the light from one side to the other."""
    sun = scene.emitters[emitter_id]
    assert isinstance(sun, CollimatedEmitter)
    sides = _lights(sun, 16)[-1], CollimatedEmitter(sun.direction, sun.irradiance)
    outer, inner = (_probed(scene, light, emitter_id, tracer) for light in sides)
    _, a, b = np.intersect1d(_keys(outer), _keys(inner), return_indices=True)
    if not len(a):
        return np.inf
    weight = inner.throughput[b] @ LUMINANCE
    moved = np.linalg.norm(outer.position[a] - inner.position[b], axis=1)
    footprint = settings.footprint or extent(inner.position[b], weight) / FOOTPRINTS
    return float(2.0 * (moved @ weight) / weight.sum() / footprint)


def _probed(
    scene: Scene, light: CollimatedEmitter, emitter_id: int, tracer: SplittingTracer
) -> Arrivals:
    """Light of the same places on casters, whichever the light."""
    parts: list[Arrivals] = []
    for chart in parallel_charts(scene, light, emitter_id):
        rays = chart.rays(scattered(_N_PROBES))
        key = np.arange(_N_PROBES, dtype=np.uint64)
        found, _ = tracer.explore(rays.origin, rays.direction, key, emitter_id)
        parts.append(found[~found.is_single].moved(len(parts) * _N_PROBES))
    return Arrivals.concatenate(parts)


def _keys(arrivals: Arrivals) -> Signatures:
    """Numbers (m,) of nodes and sheets."""
    keys: Signatures = arrivals.sheet + arrivals.node.astype(np.uint64) * _ODD
    return keys


def extent(position: Floats, weight: Floats) -> float:
    """Extent of most of the light, m: four deviations along the axis of the most."""
    weight = weight / weight.sum()
    spread = weight @ np.square(position - weight @ position)
    return float(4.0 * np.sqrt(spread.max())) or 1.0
