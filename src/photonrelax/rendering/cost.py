"""Time and memory of a render, from a small one: stages scale with what they count."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from ..scene.scene import Scene
from ..transport.trace import PHOTON_BYTES
from .plan import Plan
from .render import render
from .view import PIXEL_BYTES, resized

# Photons and pixels along the longer side of the small render: enough for times of some
# milliseconds, and so few that it takes less than a second.
_PHOTONS, _SIDE = 32_768, 96


@dataclass(frozen=True)
class Cost:
    """Time and memory of a stage.

    Attributes
    ----------
    seconds : float
        Of the stage.
    photons, n_bytes : int
        Photons stored by it, 0 if none are, and memory of what it returns.
    """

    seconds: float
    photons: int = 0
    n_bytes: int = 0


def estimate_costs(scene: Scene, planned: Plan, n_threads: int | None = None) -> dict[str, Cost]:
    """Estimated cost of each stage of a render, with the default method and settings.

    Parameters
    ----------
    scene : Scene
        With a camera.
    planned : Plan
        What is modelled of it.
    n_threads : int, optional
        Threads; all available by default.

    Raises
    ------
    ValueError
        If the scene has no camera, or no photon of a caustic is stored.
    """
    small = resized(scene, *_small_side(scene))
    n_emitted, n_global = min(planned.n_emitted, _PHOTONS), min(planned.n_global, _PHOTONS)
    image = render(
        small,
        n_emitted=n_emitted or 1,
        n_global=n_global,
        components=[part.component for part in planned.parts if part.is_modelled],
        n_threads=n_threads,
    )
    caustic = planned.n_emitted / max(n_emitted, 1)
    indirect = planned.n_global / max(n_global, 1)
    pixels = _n_pixels(scene) / _n_pixels(small)
    costs = {}
    for name, stage in image.stats["stages"].items():
        of_pixels = name == "render"
        scale = pixels if of_pixels else indirect if "indirect" in name else caustic
        costs[name] = _scaled(stage, scale, PIXEL_BYTES * _n_pixels(scene) if of_pixels else 0)
    return costs


def _scaled(stage: dict[str, Any], scale: float, n_bytes: int) -> Cost:
    photons = int(scale * stage.get("stored", 0))
    return Cost(scale * stage["seconds"], photons, n_bytes + PHOTON_BYTES * photons)


def _small_side(scene: Scene) -> tuple[int | None, int | None]:
    """Width or height of the small image, the other of which keeps the proportions."""
    camera = scene.camera
    if camera is None:
        raise ValueError("scene should have a camera to be rendered")
    if camera.width >= camera.height:
        return min(camera.width, _SIDE), None
    return None, min(camera.height, _SIDE)


def _n_pixels(scene: Scene) -> int:
    assert scene.camera is not None, "small scenes are made of scenes with a camera"
    return scene.camera.width * scene.camera.height
