"""Findings about a scene of a file, without rendering."""

from __future__ import annotations

import os
import warnings
from collections.abc import Iterator
from dataclasses import replace
from itertools import combinations

import numpy as np

from .._util.memory import check_memory
from .._util.validation import Floats
from ..scene.scene import Scene, SceneObject, object_label
from ..scene.winding import signed_crossings
from ..transport.raycast import RayCaster
from .load import load_with
from .objects import Finding, MendingMaker
from .options import LIGHT_UNITS, LoadOptions

# Bytes of a pixel in the layers of an image, at least.
_PIXEL_BYTES = 100.0
# Edges of a mesh that are tested at most.
_MAX_EDGES = 1_000_000


def check_scene(
    path: str | os.PathLike[str], options: LoadOptions
) -> tuple[list[Finding], Scene | None]:
    """Findings about the scene of a file, and the scene, its meshes mended where that was needed.

    Parameters
    ----------
    path : path
    options : LoadOptions
        Its maker is not used.

    Returns
    -------
    findings : list of Finding
    scene : Scene, optional
        None where the file cannot be read.
    """
    maker = MendingMaker()
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        try:
            scene = load_with(path, replace(options, maker=maker))
        except (ValueError, TypeError, OSError) as error:
            return [*maker.findings, Finding(str(error))], None
    told = [str(each.message) for each in caught]
    notes = [Finding(text, spoils=" is a Dielectric and should" in text) for text in told]
    mended = {each.text for each in maker.findings}
    notes = [note for note in notes if not (note.spoils and mended)]
    return [*maker.findings, *notes, *scene_findings(scene)], scene


def findings_left(found: list[Finding], written: str | os.PathLike[str]) -> tuple[Finding, ...]:
    """Findings about the file that a mended scene was written to, whose own were found before."""
    there = check_scene(written, LoadOptions(None, LIGHT_UNITS[0], False, {}))[0]
    return (*(each for each in found if each.stays), *there)


def scene_findings(scene: Scene) -> Iterator[Finding]:
    """Findings about a scene whose meshes are sound by themselves."""
    if all(item.material.is_specular for item in scene.surfaces):
        yield Finding(
            "there is no diffuse object and no sensor: photons have nothing to land on", spoils=True
        )
    yield from _image_findings(scene)
    yield from _place_findings(scene)
    yield from _overlap_findings(scene)


def _image_findings(scene: Scene) -> Iterator[Finding]:
    camera = scene.camera
    if camera is None:
        yield Finding("there is no camera: irradiance can be mapped, but no image rendered", False)
        return
    size = f"an image of {camera.width} x {camera.height} pixels"
    try:
        check_memory(
            _PIXEL_BYTES * camera.width * camera.height, f"layers of {size}", "make it smaller"
        )
    except MemoryError as error:
        yield Finding(str(error))


def _place_findings(scene: Scene) -> Iterator[Finding]:
    """Emitters and the camera inside of objects."""
    points = {
        f"emitters[{i}], a {type(emitter).__name__}": emitter.point
        for i, emitter in enumerate(scene.emitters)
        if emitter.point is not None
    }
    if scene.camera is not None and scene.camera.orthographic_height is None:
        points["the camera"] = np.asarray(scene.camera.origin)
    for i, item in enumerate(scene.objects):
        triangles = np.asarray(item.mesh.vertices)[np.asarray(item.mesh.faces)]
        low, high = triangles.min(axis=(0, 1)), triangles.max(axis=(0, 1))
        for name, point in points.items():
            near = point is not None and (low <= point).all() and (point <= high).all()
            if near and not item.material.is_sensor and _is_inside(np.asarray(point), triangles):
                yield _inside_finding(name, object_label(i, item), item)


def _inside_finding(name: str, label: str, item: SceneObject) -> Finding:
    if item.material.has_inside:
        return Finding(f"{name} is inside of {label}, and in its medium", spoils=False)
    return Finding(f"{name} is inside of {label}, which is opaque: move it out")


def _is_inside(point: Floats, triangles: Floats) -> bool:
    """True for a point around which a surface winds, by a line along an axis of no usual mesh."""
    turn = np.linalg.qr(np.random.default_rng(1).normal(size=(3, 3)))[0]
    return bool(signed_crossings(point @ turn, triangles @ turn).sum())


def _overlap_findings(scene: Scene) -> Iterator[Finding]:
    """Pairs of transparent objects in the same place, or of equal priority whose surfaces cross."""
    bodies = [i for i, item in enumerate(scene.objects) if item.material.has_inside]
    low, high = scene.object_bounds
    for i, j in combinations(bodies, 2):
        if (low[i] > high[j]).any() or (low[j] > high[i]).any():
            continue
        one, other = scene.objects[i], scene.objects[j]
        labels = f"{object_label(i, one)} and {object_label(j, other)}"
        if _coincide(one, other):
            yield Finding(f"{labels}, both transparent, are in the same place: remove one")
        elif one.material.row().priority == other.material.row().priority:
            n = _crossing_edges(one, other) + _crossing_edges(other, one)
            if n:
                yield Finding(
                    f"{labels}, both transparent, interpenetrate: {n} edges of one cross the "
                    "other. Move them apart, or give the one that rules the larger priority"
                )


def _coincide(one: SceneObject, other: SceneObject) -> bool:
    """True if all vertices of both are those of the other, but for rounding."""
    from scipy.spatial import cKDTree

    a, b = (np.asarray(item.mesh.vertices) for item in (one, other))
    tolerance = 1e-6 * float(np.linalg.norm(np.ptp(a, axis=0)))
    return all(
        np.isfinite(cKDTree(p).query(q, distance_upper_bound=tolerance)[0]).all()
        for p, q in ((a, b), (b, a))
    )


def _crossing_edges(one: SceneObject, other: SceneObject) -> int:
    """Number of edges of one object that the other's surface crosses."""
    edges = np.asarray(one.mesh.edges_unique)[:_MAX_EDGES]
    start, end = (np.asarray(one.mesh.vertices)[edges[:, k]] for k in range(2))
    length = np.linalg.norm(end - start, axis=1)
    use = length > 0.0
    start, direction, length = start[use], (end - start)[use] / length[use, None], length[use]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        caster = RayCaster([other])
    hits = caster.intersect(start, direction)
    # Contacts are no crossings.
    margin = 8.0 * caster.resolution.at(start)
    crossing = hits.hit & (hits.distance > margin) & (hits.distance < length - margin)
    return int(np.count_nonzero(crossing))
