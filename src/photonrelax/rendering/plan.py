"""Plan of a render: the components of light that a scene has, and the photons of each."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from .._util.parallel import thread_count
from .._util.validation import Floats, count
from ..photons.photon_map import PhotonMap
from ..scene.scene import Scene
from ..transport.direct_light import has_many_lamps
from ..transport.emission import MAX_PHOTONS
from ..transport.raycast import RayCaster
from ..transport.trace import stored_per_path

COMPONENTS = ("emission", "direct", "caustic", "indirect")
"""Components of the light that a camera sees."""
# Photons of indirect light to store. Their noise is that of k, whatever their number; what more
# photons would give is less blur.
_STORED = 1_000_000
# Distance of points from a plane, over their extent, up to which they are in it.
_PLANAR = 1e-6


class Part(NamedTuple):
    """A component, whether it is modelled, and why or why not."""

    component: str
    is_modelled: bool
    reason: str


@dataclass(frozen=True)
class Plan:
    """The components that a render models.

    Attributes
    ----------
    parts : tuple of Part
        One per component.
    n_emitted, n_global : int
        Photons to emit for caustics and for indirect light; zero where none are needed.
    """

    parts: tuple[Part, ...]
    n_emitted: int
    n_global: int

    def models(self, component: str) -> bool:
        """Whether a component is modelled."""
        return any(part.component == component and part.is_modelled for part in self.parts)


def plan(
    scene: Scene,
    *,
    n_emitted: int = 1_000_000,
    n_global: int | None = None,
    components: Iterable[str] | None = None,
    photons: PhotonMap | None = None,
    caster: RayCaster | None = None,
    n_threads: int | None = None,
) -> Plan:
    """Find the components of light that a scene has, and the photons that they take.

    Parameters
    ----------
    scene : Scene
        Objects and emitters.
    n_emitted : int
        Photons to emit for caustics.
    n_global : int, optional
        Photons to emit for indirect light, 0 for none. By default as many as store a million, by
        the share of a few thousand paths that are stored, but no more than for caustics.
    components : iterable of str, optional
        Of ``emission``, ``direct``, ``caustic`` and ``indirect``, those to model if the scene has
        them; by default all.
    photons : PhotonMap, optional
        Photons that are there already: of caustics, or of all light, indirect included.
    caster : RayCaster, optional
        Of the scene: building it takes time.
    n_threads : int, optional
        Threads; all available by default. The result does not depend on it.

    Raises
    ------
    TypeError, ValueError
        If a number or a component is invalid.
    """
    n_emitted = count(n_emitted, "n_emitted", high=MAX_PHOTONS)
    if n_global is not None:
        n_global = count(n_global, "n_global", low=0, high=MAX_PHOTONS)
    elif photons is not None and photons.paths != "caustic":
        n_global = 0
    wanted = checked_components(components)
    threads = thread_count(n_threads)
    caustic = _caustic(scene, wanted, photons, caster, threads)
    indirect = _indirect(scene, wanted, n_global)
    if indirect.is_modelled and n_global is None:
        stored = stored_per_path(scene, "global", caster, threads)
        most = n_emitted if photons is None else photons.n_emitted or n_emitted
        n_global = min(int(np.ceil(_STORED / stored)), most) if stored else 0
        if not stored:
            reason = "of a few thousand paths none meets a diffuse surface after another"
            indirect = Part("indirect", False, reason)
    return Plan(
        (_emission(scene, wanted), _direct(scene, wanted), caustic, indirect),
        n_emitted if caustic.is_modelled and photons is None else 0,
        (n_global or 0) if indirect.is_modelled else 0,
    )


def checked_components(components: Iterable[str] | None) -> tuple[str, ...]:
    """Components by name, all by default; raises if one is unknown."""
    if components is None:
        return COMPONENTS
    if isinstance(components, str):
        raise TypeError(f"components should be several names, but is {components!r}")
    names = tuple(components)
    unknown = [name for name in names if name not in COMPONENTS]
    if unknown:
        raise ValueError(f"components should be of {', '.join(COMPONENTS)}, but has {unknown[0]!r}")
    return names


def _emission(scene: Scene, wanted: tuple[str, ...]) -> Part:
    if "emission" not in wanted:
        return Part("emission", False, "not asked for")
    seen = sum(emitter.surface is not None or emitter.is_background for emitter in scene.emitters)
    if seen == 0:
        return Part("emission", False, "no emitter has a surface that a camera could see")
    return Part("emission", True, f"emitters that a camera may see: {seen}")


def _direct(scene: Scene, wanted: tuple[str, ...]) -> Part:
    if "direct" not in wanted:
        return Part("direct", False, "not asked for")
    to = "some of many lamps" if has_many_lamps(scene) else "each emitter"
    return Part("direct", True, f"shadow rays from the points seen to {to}")


def _caustic(
    scene: Scene,
    wanted: tuple[str, ...],
    photons: PhotonMap | None,
    caster: RayCaster | None,
    n_threads: int,
) -> Part:
    if "caustic" not in wanted:
        return Part("caustic", False, "not asked for")
    if photons is not None:
        return Part("caustic", True, "photons are given")
    n = len(scene.specular_objects)
    if n == 0:
        return Part("caustic", False, "no object is a Mirror or Dielectric")
    if not any(item.material.row().kind == "diffuse" for item in scene.objects):
        return Part("caustic", False, "no object is Diffuse, on which light would be seen")
    if _is_own_light(scene) and not stored_per_path(scene, "caustic", caster, n_threads):
        reason = "of a few thousand paths none returns to the Mirror or Dielectric that emits it"
        return Part("caustic", False, reason)
    dispersed = "; light is dispersed" if scene.has_dispersion else ""
    return Part("caustic", True, f"objects that are Mirror or Dielectric: {n}{dispersed}")


def _indirect(scene: Scene, wanted: tuple[str, ...], n_global: int | None) -> Part:
    """Indirect light as far as the scene's objects tell."""
    if "indirect" not in wanted:
        return Part("indirect", False, "not asked for")
    if n_global == 0:
        return Part("indirect", False, "n_global is 0")
    rows = [item.material.row() for item in scene.objects]
    diffuse = [i for i, row in enumerate(rows) if row.kind == "diffuse"]
    if not any(np.any(rows[i].reflectance) for i in diffuse):
        return Part("indirect", False, "no diffuse surface reflects light")
    if not scene.specular_objects and is_planar([scene.objects[i].mesh.vertices for i in diffuse]):
        return Part("indirect", False, "all surfaces are in one plane, and light none another")
    return Part("indirect", True, "diffuse surfaces may light one another")


def _is_own_light(scene: Scene) -> bool:
    """Whether the only specular surface is that of the only emitter."""
    n_objects = len(scene.objects)
    return len(scene.emitters) == 1 and scene.specular_objects == (n_objects,)


def is_planar(points: list[Floats]) -> bool:
    """Whether all points are in one plane."""
    together = np.concatenate(points)
    centred = together - together.mean(axis=0)
    extents = np.linalg.svd(centred, compute_uv=False)
    return bool(extents[-1] <= _PLANAR * extents[0])
