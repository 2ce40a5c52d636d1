"""Memory of renders and maps, estimated before it is allocated; what does not fit is refused."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import NamedTuple

from .._util.memory import available_memory, size_text
from .._util.validation import positive
from ..scene.scene import Scene
from ..transport.trace import stored_per_path
from .view import View

# Bytes of a stored photon at the peak of the stages it goes through, its place in the map included:
# relaxation to rest densities and diffusion for caustics, gathering for indirect light. See
# docs/measurements/memory.md.
_BYTES = {"caustic": 560, "indirect": 280}
# Of these, its place in the map, which photons that are given have already.
_PLACE_BYTES = 156
# Bytes of an envelope for each ray that is traced for it; rays unless they are told, and those that
# it should have at least.
_RAY_BYTES, _MOST_RAYS, _LEAST_RAYS = 3600, 1_000_000, 20_000
# Bytes of the layers of a pixel and of their bands, of a sample of a band, of libraries, and of a
# triangle of the scene.
_PIXEL_BYTES, _SAMPLE_BYTES, _LIBRARY_BYTES, _TRIANGLE_BYTES = 350, 1500, 200e6, 400
# Samples of a band, at most; a row has more if it is wide.
_SAMPLES = 400_000
# Bytes of a texel of a map and of its image, of one of a band; texels of a band, at most.
_TEXEL_BYTES, _BAND_TEXEL_BYTES, _BAND_TEXELS = 150, 300, 1 << 18
# Paths that store a photon of indirect light more than once do so a few times; so does each sensor.
_MOST_PER_PATH = 4.0
# Share of the free memory that is taken, unless a limit is given, and share of the limit that hit
# points kept for several images may take.
_SHARE, _KEPT_SHARE = 0.9, 0.125
_PATHS = {"caustic": "caustic", "indirect": "global"}
_ARGUMENTS = {"caustic": "n_emitted", "indirect": "n_global"}
_SMALLER_IMAGE = "make the image smaller (width, height)"
_PASSES = "render in passes of fresh photons (--passes, render_progressive), "


class _Need(NamedTuple):
    """Bytes of `n` things alike; `remedy` says that there should be at most `{most}` of them."""

    text: str
    n: int
    each: float
    remedy: str

    @property
    def n_bytes(self) -> float:
        return self.n * self.each


def memory_limit(memory: float | None) -> float:
    """Bytes that may be taken: those given, or nine tenths of what is free."""
    if memory is None:
        return _SHARE * available_memory()
    return positive(memory, "memory")


def kept_limit(memory: float | None) -> float:
    """Bytes that hit points may take that are kept for several images."""
    return _KEPT_SHARE * memory_limit(memory)


def rays_within(view: View, n_rays: int | None, memory: float | None) -> int | None:
    """Rays of envelopes that an error or a time ends, at most: as told, if they fit into memory.

    Otherwise as many as fit, but 20,000 at least, which `check_render_fits` refuses.
    """
    fits = int((memory_limit(memory) - _image_bytes(view)) / _RAY_BYTES)
    return n_rays if (n_rays or _MOST_RAYS) <= fits else max(fits, _LEAST_RAYS)


def check_render_fits(
    view: View,
    emitted: Mapping[str, int],
    memory: float | None,
    *,
    n_given: int = 0,
    n_rays: int = 0,
) -> None:
    """Raise MemoryError if a render is estimated to take more memory than it may.

    Parameters
    ----------
    view : View
        Of the render.
    emitted : mapping
        Photons to emit by component.
    memory : float, optional
        Bytes that may be taken, by default nine tenths of what is free.
    n_given, n_rays : int
        Photons that are there already, and rays of envelopes.
    """
    limit, (height, width) = memory_limit(memory), view.shape
    image = _Need(f"an image of {width} x {height} pixels", 1, _image_bytes(view), _SMALLER_IMAGE)
    others = [_of_given(n_given), _of_rays(n_rays)]
    sure = image.n_bytes + sum(need.n_bytes for need in others)
    if sure + _MOST_PER_PATH * sum(_BYTES[name] * n for name, n in emitted.items()) <= limit:
        return
    photons = [
        _of_emitted(name, n, _stored(view, name) if n else 0.0) for name, n in emitted.items()
    ]
    _check(limit, image, [*photons, *others], _PASSES)


def check_map_fits(
    scene: Scene,
    n_emitted: int,
    n_texels: int,
    memory: float | None,
    *,
    n_rays: int = 0,
) -> None:
    """Raise MemoryError if an irradiance map is estimated to take more memory than it may.

    Parameters
    ----------
    scene : Scene
    n_emitted, n_texels : int
        Photons to emit, and texels along the longer side, those of a square counted.
    memory : float, optional
        Bytes that may be taken, by default nine tenths of what is free.
    n_rays : int
        Of envelopes.
    """
    limit = memory_limit(memory)
    texels = n_texels**2
    map_bytes = _TEXEL_BYTES * texels + _BAND_TEXEL_BYTES * min(texels, _BAND_TEXELS)
    n_bytes = _LIBRARY_BYTES + _scene_bytes(scene) + map_bytes
    image = _Need(f"a map of {n_texels} texels a side", 1, n_bytes, "take fewer texels (texels)")
    rays, most = _of_rays(n_rays), _MOST_PER_PATH * (1 + len(scene.sensors))
    if n_bytes + rays.n_bytes + _of_emitted("caustic", n_emitted, most).n_bytes <= limit:
        return
    stored = stored_per_path(scene, "caustic", sensors=True)
    _check(limit, image, [_of_emitted("caustic", n_emitted, stored), rays])


def _image_bytes(view: View) -> float:
    """Bytes of the layers of an image, of a band of it, and of scene and libraries."""
    height, width = view.shape
    samples = view.supersampling**2
    band = min(max(_SAMPLES, width * samples), height * width * samples)
    image = _PIXEL_BYTES * height * width + _SAMPLE_BYTES * band
    return _LIBRARY_BYTES + _scene_bytes(view.scene) + image + view.kept_bytes


def _scene_bytes(scene: Scene) -> float:
    """Bytes of the meshes of a scene, and of the trees that rays find them by."""
    return _TRIANGLE_BYTES * sum(len(each.mesh.faces) for each in scene.objects)


def _stored(view: View, component: str) -> float:
    """Photons that each path stores, by the first few thousand."""
    return stored_per_path(view.scene, _PATHS[component], view.caster, view.n_threads)


def _of_emitted(component: str, n: int, stored: float) -> _Need:
    return _Need(
        f"the photons of {n:,} emitted for {component} light",
        n,
        _BYTES[component] * stored,
        f"emit at most {{most:,}} ({_ARGUMENTS[component]})",
    )


def _of_given(n: int) -> _Need:
    each = _BYTES["caustic"] - _PLACE_BYTES
    return _Need(f"the stages of {n:,} photons given", n, each, "give at most {most:,} (photons)")


def _of_rays(n: int) -> _Need:
    remedy = "trace at most {most:,} (EnvelopeSettings.n_rays)"
    return _Need(f"the envelope of {n:,} rays", n, _RAY_BYTES, remedy)


def _check(limit: float, image: _Need, needs: Iterable[_Need], otherwise: str = "") -> None:
    """Raise MemoryError, with the numbers and what would fit, if needs are above the limit."""
    needs = [image, *(need for need in needs if need.n_bytes)]
    total = sum(need.n_bytes for need in needs)
    if total <= limit:
        return
    largest = max(needs[1:], key=lambda need: need.n_bytes, default=image)
    most = int((limit - total + largest.n_bytes) / largest.each)
    remedy = largest.remedy if most > 0 else image.remedy
    parts = [f"{need.text} about {size_text(need.n_bytes)}" for need in needs]
    raise MemoryError(
        f"{' and '.join(parts)} of memory, but memory is {size_text(limit)}: "
        f"{remedy.format(most=most)}, {otherwise}or allow more (memory)"
    )
