"""Time and memory of a render, from small ones.

Stages take a time of their own, and time for each photon or pixel: two sizes tell them apart.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from ..scene.scene import Scene
from ..transport.trace import PHOTON_BYTES
from .plan import Plan
from .render import render
from .view import PIXEL_BYTES, resized

# Photons and pixels along the longer side of the larger one: enough for times of some tens of
# milliseconds, and so few that it takes about a second. The smaller has a share of these.
_PHOTONS, _SIDE, _SHARE = 131_072, 128, 0.25


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
    # The first time loads libraries and starts threads.
    _, less, more = (_Pilot(scene, planned, share, n_threads) for share in (_SHARE, _SHARE, 1.0))
    return {
        name: Cost(
            _extrapolated(less.stages[name], stage, more.scale(name)),
            int(more.scale(name) * stage.get("stored", 0)),
            more.n_bytes(name),
        )
        for name, stage in more.stages.items()
    }


def _extrapolated(less: dict[str, Any], more: dict[str, Any], scale: float) -> float:
    """Seconds of a stage that counts `scale` times as much as the larger of two renders."""
    counted = [next(stage[key] for key in stage if key != "seconds") for stage in (less, more)]
    added = max(more["seconds"] - less["seconds"], 0.0)
    if counted[1] <= counted[0]:
        return float(more["seconds"])
    return float(more["seconds"] + added * (scale - 1.0) * counted[1] / (counted[1] - counted[0]))


class _Pilot:
    """A small render of a scene, with a share of its photons and pixels."""

    def __init__(self, scene: Scene, planned: Plan, share: float, n_threads: int | None) -> None:
        most, side = int(share * _PHOTONS), max(int(share**0.5 * _SIDE), 1)
        small = resized(scene, *_small_side(scene, side))
        n_emitted, n_global = min(planned.n_emitted, most), min(planned.n_global, most)
        image = render(
            small,
            n_emitted=n_emitted or 1,
            n_global=n_global,
            components=[part.component for part in planned.parts if part.is_modelled],
            n_threads=n_threads,
        )
        self.stages: dict[str, dict[str, Any]] = image.stats["stages"]
        self._n_pixels = _n_pixels(scene)
        self._scales = {
            "caustic": planned.n_emitted / max(n_emitted, 1),
            "indirect": planned.n_global / max(n_global, 1),
            "render": _n_pixels(scene) / _n_pixels(small),
        }

    def scale(self, stage: str) -> float:
        """Photons or pixels that a stage of the whole render counts, over those of this one."""
        kind = "indirect" if "indirect" in stage else "render" if stage == "render" else "caustic"
        return self._scales[kind]

    def n_bytes(self, stage: str) -> int:
        """Memory of the photons or layers that a stage of the whole render returns."""
        photons = int(self.scale(stage) * self.stages[stage].get("stored", 0))
        return PHOTON_BYTES * photons + (PIXEL_BYTES * self._n_pixels if stage == "render" else 0)


def _small_side(scene: Scene, most: int) -> tuple[int | None, int | None]:
    """Width or height of a small image, the other of which keeps the proportions."""
    camera = scene.camera
    if camera is None:
        raise ValueError("scene should have a camera to be rendered")
    if camera.width >= camera.height:
        return min(camera.width, most), None
    return None, min(camera.height, most)


def _n_pixels(scene: Scene) -> int:
    assert scene.camera is not None, "small scenes are made of scenes with a camera"
    return scene.camera.width * scene.camera.height
