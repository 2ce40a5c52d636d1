"""Memory of a render, estimated before it is allocated; what does not fit is refused."""

from __future__ import annotations

from collections.abc import Mapping

from .._util.memory import available_memory, size_text
from .._util.validation import positive
from ..transport.trace import stored_per_path
from .view import View

# Bytes of a stored photon at the peak of the stages it goes through, its place in the map included:
# relaxation to rest densities and diffusion for caustics, gathering for indirect light. See
# docs/measurements/memory.md.
_BYTES = {"caustic": 560, "indirect": 280}
# Bytes of the layers of a pixel and of their bands, of a sample of a band, and of libraries.
_PIXEL_BYTES, _SAMPLE_BYTES, _LIBRARY_BYTES = 350, 1500, 200e6
# Samples of a band, at most; a row has more if it is wide.
_SAMPLES = 400_000
# Paths that store a photon of indirect light more than once do so a few times.
_MOST_PER_PATH = 4.0
# Share of the free memory that is taken, unless a limit is given.
_SHARE = 0.9
_PATHS = {"caustic": "caustic", "indirect": "global"}
_ARGUMENTS = {"caustic": "n_emitted", "indirect": "n_global"}


def memory_limit(memory: float | None) -> float:
    """Bytes that may be taken: those given, or nine tenths of what is free."""
    if memory is None:
        return _SHARE * available_memory()
    return positive(memory, "memory")


def check_render_fits(view: View, emitted: Mapping[str, int], memory: float | None) -> None:
    """Raise MemoryError if a render is estimated to take more memory than it may.

    Parameters
    ----------
    view : View
        Of the render.
    emitted : mapping
        Photons to emit by component.
    memory : float, optional
        Bytes that may be taken, by default nine tenths of what is free.
    """
    limit, image = memory_limit(memory), _image_bytes(view)
    if image + _MOST_PER_PATH * sum(_BYTES[name] * n for name, n in emitted.items()) <= limit:
        return
    per_path = {name: _bytes_per_path(view, name) if n else 0.0 for name, n in emitted.items()}
    photons = {name: per_path[name] * n for name, n in emitted.items()}
    if image + sum(photons.values()) > limit:
        raise MemoryError(_refusal(view, image, photons, emitted, limit))


def _image_bytes(view: View) -> float:
    """Bytes of the layers of an image, of a band of it, and of the libraries that make it."""
    height, width = view.shape
    samples = view.supersampling**2
    band = min(max(_SAMPLES, width * samples), height * width * samples)
    return _LIBRARY_BYTES + _PIXEL_BYTES * height * width + _SAMPLE_BYTES * band


def _bytes_per_path(view: View, component: str) -> float:
    """Bytes of photons for each one emitted, by those that the first few thousand paths store."""
    paths = _PATHS[component]
    return _BYTES[component] * stored_per_path(view.scene, paths, view.caster, view.n_threads)


def _refusal(
    view: View,
    image: float,
    photons: Mapping[str, float],
    emitted: Mapping[str, int],
    limit: float,
) -> str:
    """The numbers, and what would fit."""
    parts = [f"an image of {view.shape[1]} x {view.shape[0]} pixels about {size_text(image)}"]
    parts += [
        f"the photons of {emitted[name]:,} emitted for {name} light about {size_text(n_bytes)}"
        for name, n_bytes in photons.items()
        if n_bytes
    ]
    largest = max(photons, key=lambda name: photons[name])
    others = image + sum(photons.values()) - photons[largest]
    remedy = "make the image smaller (width, height)"
    if others < limit and photons[largest]:
        most = int(emitted[largest] * (limit - others) / photons[largest])
        remedy = f"emit at most {most:,} ({_ARGUMENTS[largest]})"
    return (
        f"{' and '.join(parts)} of memory, but memory is {size_text(limit)}: {remedy}, "
        "render in passes of fresh photons (--passes, render_progressive), or allow more (memory)"
    )
