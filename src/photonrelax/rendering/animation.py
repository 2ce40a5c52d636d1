"""Animations: frames whose photons leave the emitters alike, so that only what moves changes.

Photon i has the same emitter coordinates in every frame: emitters aim at what holds the casters of
all frames, and as many photons are emitted in each. Relaxation starts from the photons as traced.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import Executor
from dataclasses import replace
from typing import Any

from .._util.workers import checked_executor, worker_map
from ..imaging.image import Image
from ..scene.casters import Targets, common_targets
from ..scene.scene import Scene
from .plan import checked_components, plan
from .render import render

SceneAt = Callable[[float], Scene]
"""Maps a time, s, to the scene then."""


class Animation:
    """Frames of a scene that moves, rendered one at a time.

    Parameters
    ----------
    scene_at : callable
        Maps a time, s, to a `Scene`, with as many emitters and objects at all times. It is called
        for all times at once, to aim at what moves, and again for each frame rendered.
    times : sequence of float
        Of the frames, s.
    n_emitted, n_global, components : int, int, iterable of str
        As of `photonrelax.render`; photons of indirect light are as many in all frames, by default
        those that the first frame needs.
    **settings
        Other arguments of `photonrelax.render`.
    """

    def __init__(
        self,
        scene_at: SceneAt,
        times: Sequence[float],
        *,
        n_emitted: int = 1_000_000,
        n_global: int | None = None,
        components: Iterable[str] | None = None,
        **settings: Any,
    ) -> None:
        components = checked_components(components)
        self.times = tuple(times)
        self._scene_at = scene_at
        self._aim = _common_aim(scene_at, self.times)
        found = plan(
            self.scene(0),
            n_emitted=n_emitted,
            n_global=n_global,
            components=components,
            n_threads=settings.get("n_threads"),
        )
        self._settings = settings | {
            "n_emitted": n_emitted,
            "n_global": found.n_global,
            "components": components,
        }

    def scene(self, number: int) -> Scene:
        """The scene of a frame, by its number from zero."""
        return replace(self._scene_at(self.times[number]), aim=self._aim)

    def frames(self, numbers: Iterable[int], executor: Executor | None = None) -> Iterator[Image]:
        """Pictures of some frames in order, a frame a worker; ``progress`` is not called in these.

        Parameters
        ----------
        numbers : iterable of int
            Of the frames, from zero.
        executor : concurrent.futures.Executor, optional
            By default they are rendered here, one after the other. See docs/scaling.md.
        """
        if checked_executor(executor) is None:
            yield from map(self.frame, numbers)
            return
        settings = {name: value for name, value in self._settings.items() if name != "progress"}
        threads = settings.get("n_threads") or 1
        scenes = map(self.scene, numbers)
        yield from worker_map(_picture, settings, scenes, executor, n_threads=threads)

    def frame(self, number: int) -> Image:
        """The picture of a frame, by its number from zero."""
        image: Image = render(self.scene(number), **self._settings)
        return image


def _picture(settings: dict[str, Any], scene: Scene) -> Image:
    """Picture of the scene of a frame, in a worker."""
    image: Image = render(scene, **settings)
    return image


def _common_aim(scene_at: SceneAt, times: Sequence[float]) -> Targets:
    """Targets that hold those of all times; scenes are not kept."""
    return common_targets([scene_at(time).targets for time in times])
