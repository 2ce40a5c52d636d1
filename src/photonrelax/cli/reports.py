"""Texts that the command line prints of stages, images and photon maps."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from .._util.validation import Floats
from ..imaging.image import Image
from ..photons.energy_ledger import EnergyLedger
from ..photons.photon_map import PhotonMap
from ..rendering.cost import Cost
from ..rendering.object_map import ObjectMap
from ..rendering.plan import COMPONENTS, Plan
from ..rendering.simplifications import Simplification


def stage_table(stages: Mapping[str, Mapping[str, Any]]) -> str:
    """Table of seconds and counts, a line a stage and one for the total.

    Parameters
    ----------
    stages : mapping
        ``seconds`` and any counts of each stage, by its name.
    """
    width = max(map(len, [*stages, "total"]))
    lines = [
        f"{name:{width}}  {values['seconds']:8.2f} s  {_counts(values)}".rstrip()
        for name, values in stages.items()
    ]
    total = sum(values["seconds"] for values in stages.values())
    return "\n".join([*lines, f"{'total':{width}}  {total:8.2f} s"])


def _counts(values: Mapping[str, Any]) -> str:
    return ", ".join(
        f"{name.replace('_', ' ')} {value:,}"
        for name, value in values.items()
        if name != "seconds" and isinstance(value, int)
    )


def light_layers(image: Image) -> list[str]:
    """Names of the components of light that an image has."""
    return [name for name in COMPONENTS if name in image.layers]


def reached_line(reached: Mapping[str, Any]) -> str:
    """Error that a render has reached, and what was asked, in one line."""
    asked = [] if reached["asked"] is None else [f"asked: {reached['asked']:.2g}"]
    if not reached["is_met"]:
        asked.append("not reached")
    if reached["asked_seconds"] is not None:
        asked.append(f"{reached['seconds']:.1f} of {reached['asked_seconds']:g} s")
    return (
        f"error about {reached['estimate']:.2g} ({', '.join(asked)}), {reached['metric']} of "
        f"{reached['of']}: noise {reached['noise']:.2g}, bias {reached['bias']:.2g}"
    )


def plan_table(plan: Plan) -> str:
    """Table of the components of light, a line each, and why each is modelled or is not."""
    photons = {"caustic": plan.n_emitted, "indirect": plan.n_global}
    lines = []
    for component, is_modelled, reason in plan.parts:
        n = f"{photons[component]:,} photons" if photons.get(component) else ""
        lines.append(f"{component:9} {'yes' if is_modelled else 'no':4} {n:18} {reason}")
    return "\n".join(lines)


def simplification_table(found: Iterable[Simplification]) -> str:
    """Table of what kernels leave out, a line each, and why or why not."""
    return "\n".join(
        f"{what:35} {'left out' if is_made else 'done':8}  {reason}"
        for what, is_made, reason in found
    )


def cost_table(costs: Mapping[str, Cost]) -> str:
    """Table of estimated times, photons stored and memory of the stages of a render."""
    width = max(map(len, [*costs, "total"]))
    total = Cost(
        sum(cost.seconds for cost in costs.values()),
        sum(cost.photons for cost in costs.values()),
        sum(cost.n_bytes for cost in costs.values()),
    )
    lines = [f"{'about':{width}}   seconds  photons stored  megabytes"]
    for name, cost in {**costs, "total": total}.items():
        photons = f"{cost.photons:,}" if cost.photons else ""
        size = f"{cost.n_bytes / 1e6:.0f}" if cost.n_bytes else ""
        lines.append(f"{name:{width}}  {cost.seconds:8.1f}  {photons:>14}  {size:>9}".rstrip())
    return "\n".join(lines)


def encircled_table(
    found: ObjectMap,
    radii: Sequence[float],
    unit: tuple[str, float] = ("m", 1.0),
    axis: Floats | None = None,
) -> str:
    """Flux within radii of the centre of a map, of its brightest point and of an axis, a line each.

    Radii are in a unit, which has a name and a length, m.
    """
    lines = []
    name, metres = unit
    points = {"axis": axis, "centre": found.centre, "brightest point": found.brightest}
    for label, point in points.items():
        if point is None:
            continue
        lines.append(f"within a radius of the {label}, {_numbers(point / metres)} {name}:")
        flux = found.encircled_flux(point, [metres * r for r in radii])
        lines += [f"  {r:g} {name}  {_watts(some)}" for r, some in zip(radii, flux, strict=True)]
    return "\n".join(lines)


def describe_image(image: Image) -> str:
    """Size, layers and metadata of an image, a line each."""
    height, width = np.shape(next(iter(image.layers.values())))[:2]
    lines = [f"{width} x {height} pixels", f"layers: {', '.join(sorted(image.layers))}"]
    return "\n".join(lines + [f"{name}: {value}" for name, value in sorted(image.metadata.items())])


def describe_photons(photons: PhotonMap) -> str:
    """Counts, flux, extent and energy ledger of a photon map."""
    emitted = "an unknown number" if photons.n_emitted is None else f"{photons.n_emitted:,}"
    lines = [
        f"{len(photons):,} photons of {emitted} emitted",
        f"flux: {_watts(photons.flux[~photons.on_sensor].sum(axis=0))}",
    ]
    if photons.emitted_ranges is not None:
        ranges = ", ".join(f"{a:,} to {b:,}" for a, b in photons.emitted_ranges.tolist())
        lines.append(f"part of an emission: photons {ranges}")
    if photons.scene_digest is not None:
        lines.append(f"scene: {photons.scene_digest}, the digest of its objects and emitters")
    lines += _describe_sensors(photons)
    if len(photons):
        low, high = photons.position.min(axis=0), photons.position.max(axis=0)
        lines.append(f"box: {_numbers(low)} to {_numbers(high)} m")
    if photons.wavelength is not None and photons.wavelength.any():
        nm = photons.wavelength[photons.wavelength > 0.0]
        lines.append(f"dispersed: {len(nm):,} photons, {nm.min():.0f} to {nm.max():.0f} nm")
    if photons.emitter_coords is None:
        lines.append("without emitter coordinates: relaxes in space alone")
    if photons.ledger is not None:
        lines += _describe_ledger(photons.ledger)
    return "\n".join(lines)


def _describe_sensors(photons: PhotonMap) -> list[str]:
    """Photons and flux on each sensor, a line each."""
    if photons.sensor_ids is None or photons.object_id is None:
        return []
    lines = []
    for sensor in photons.sensor_ids:
        mine = photons.object_id == sensor
        flux = _watts(photons.flux[mine].sum(axis=0))
        lines.append(f"sensor, object {sensor}: {np.count_nonzero(mine):,} photons, flux {flux}")
    return lines


def _describe_ledger(ledger: EnergyLedger) -> list[str]:
    lines = []
    for emitter, emitted in enumerate(ledger.emitted):
        lines.append(f"emitter {emitter}: emitted {_watts(emitted)}")
        for outcome, paths in ledger.ends.items():
            flux = getattr(ledger, outcome)[emitter]
            lines.append(f"  {outcome}: {_watts(flux)}, paths {int(paths[emitter]):,}")
    return lines


def _watts(flux: Iterable[float]) -> str:
    return f"{_numbers(flux)} W"


def _numbers(values: Iterable[float]) -> str:
    return "(" + ", ".join(f"{value:.6g}" for value in values) + ")"
