"""Work that a scene spares the kernels of a render, with the reasons."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from .._ext.transport.materials import Materials
from ..scene.scene import Scene
from .plan import is_planar


class Simplification(NamedTuple):
    """Something that kernels may leave out, whether they do, and why or why not."""

    what: str
    is_made: bool
    reason: str


def simplifications(scene: Scene) -> tuple[Simplification, ...]:
    """Work that a scene spares a render, and work that it does not."""
    materials = Materials(scene.material_table())
    return (
        _emitters(len(scene.emitters)),
        _receivers(scene),
        _absorption(scene),
        _hidden(materials),
        _sampled_lights(scene),
    )


def _emitters(n: int) -> Simplification:
    if n == 1:
        return Simplification("groups by emitter", True, "one emitter")
    return Simplification("groups by emitter", False, f"photons of {n} emitters are kept apart")


def _receivers(scene: Scene) -> Simplification:
    """Photons that stay on their triangle need no ray, and rays find flat neighbours' faces."""
    receivers = [
        item.mesh.vertices
        for item in scene.objects
        if not (item.material.is_specular or item.material.is_sensor)
    ]
    curved = sum(not is_planar([vertices]) for vertices in receivers)
    if curved:
        reason = f"diffuse objects that are not flat: {curved}"
        return Simplification("projection of moved photons by rays", False, reason)
    reason = "diffuse objects are flat: rays only from one triangle to another"
    return Simplification("projection of moved photons by rays", True, reason)


def _absorption(scene: Scene) -> Simplification:
    n = sum(bool(np.any(item.material.row().absorption)) for item in scene.surfaces)
    if n:
        return Simplification("absorption along rays", False, f"objects that absorb: {n}")
    return Simplification("absorption along rays", True, "no medium absorbs")


def _hidden(materials: Materials) -> Simplification:
    if materials.has_hidden:
        return Simplification("search for hidden surfaces", False, "dielectrics have priorities")
    return Simplification(
        "search for hidden surfaces", True, "no surface is below a larger priority"
    )


def _sampled_lights(scene: Scene) -> Simplification:
    n = sum(emitter.is_extended for emitter in scene.emitters)
    if n:
        return Simplification("samples of lights", False, f"emitters that are extended: {n}")
    return Simplification("samples of lights", True, "a shadow ray to each emitter is enough")
