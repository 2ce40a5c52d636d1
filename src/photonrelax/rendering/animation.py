"""Animations: frames whose photons leave the emitters alike, so that only what moves changes.

Photon i has the same emitter coordinates in every frame: emitters aim at what holds the casters of
all frames, and as many photons are emitted in each. Relaxation starts from the photons as traced.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import Executor
from dataclasses import replace
from functools import partial
from typing import Any

from .._util.workers import checked_executor, worker_map
from ..estimation.methods import method_named
from ..imaging.image import Image
from ..scene.casters import Targets, common_targets
from ..scene.scene import Scene
from .error_target import Goal
from .plan import checked_components, plan
from .presets import choose
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
        Other arguments of `photonrelax.render`. A preset is that of the first frame. With ``error``
        or ``seconds``, the first frame is rendered to it, and all frames, the first too, with as
        many photons as that took, in one image each.

    Attributes
    ----------
    reached : dict, optional
        The error of the first frame, as `photonrelax.render` has it in ``stats["error"]``, when it
        was rendered to a goal.

    Raises
    ------
    ValueError
        If an argument is invalid, or ``error`` or ``seconds`` is given with a method that has no
        number of photons to find.
    """

    def __init__(
        self,
        scene_at: SceneAt,
        times: Sequence[float],
        *,
        n_emitted: int | None = None,
        n_global: int | None = None,
        components: Iterable[str] | None = None,
        **settings: Any,
    ) -> None:
        self.times = tuple(times)
        self.reached: dict[str, Any] | None = None
        self._scene_at = scene_at
        self._aim = _common_aim(scene_at, self.times)
        self._goal = Goal(settings.pop("error", None), settings.pop("seconds", None))
        components = checked_components(components)
        numbers = {"n_emitted": n_emitted, "n_global": n_global, "components": components}
        self._first = self.scene(0)
        self._settings = self._chosen(settings | numbers)
        if not self._goal.is_given:
            self.fix_photons(self._settings["n_emitted"])

    def _chosen(self, settings: dict[str, Any]) -> dict[str, Any]:
        """Settings, with what a preset or an error chooses for the first frame."""
        name = settings.pop("preset", None)
        choice = choose(self._first, settings.get("method"), name, self._goal.preset_error)
        if self._goal.is_given and not method_named(choice.method).needs_photons:
            raise ValueError(
                f"error and seconds find a number of photons for all frames, but {choice.method} "
                "has none: take another method, or give settings of its own"
            )
        chosen = {
            "method": choice.method,
            "n_emitted": choice.n_emitted,
            "supersampling": choice.supersampling,
        }
        given = {name: value for name, value in settings.items() if value is not None}
        return settings | chosen | choice.settings.given | given

    def fix_photons(self, n_emitted: int) -> None:
        """Emit so many photons in all frames, and as many of indirect light as the first needs.

        A goal is given up: the number is that of frames that were rendered to it before.
        """
        names = ("n_global", "components", "n_threads")
        known = {name: self._settings.get(name) for name in names}
        found = plan(self._first, n_emitted=n_emitted, **known)
        self._settings |= {"n_emitted": n_emitted, "n_global": found.n_global}
        self._goal = Goal()

    def _reach_goal(self, executor: Executor | None) -> None:
        """Find the photons of all frames by the first, if they are to be found."""
        if not self._goal.is_given:
            return
        pilot = self._settings | {"error": self._goal.error, "seconds": self._goal.seconds}
        (image,) = _images(pilot, [self._first], executor)
        self.reached = image.stats["error"]
        self.fix_photons(self.reached["photons_of_image"])

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
        executor = checked_executor(executor)
        self._reach_goal(executor)
        yield from _images(self._settings, map(self.scene, numbers), executor)

    def frame(self, number: int) -> Image:
        """The picture of a frame, by its number from zero."""
        (image,) = self.frames([number])
        return image


def _images(
    settings: dict[str, Any], scenes: Iterable[Scene], executor: Executor | None
) -> Iterator[Image]:
    """Pictures of scenes, here or in workers, which have no progress to report."""
    if executor is None:
        yield from map(partial(_picture, settings), scenes)
        return
    sent = {name: value for name, value in settings.items() if name != "progress"}
    threads = sent.get("n_threads") or 1
    yield from worker_map(_picture, sent, scenes, executor, n_threads=threads)


def _picture(settings: dict[str, Any], scene: Scene) -> Image:
    """Picture of the scene of a frame."""
    image: Image = render(scene, **settings)
    return image


def _common_aim(scene_at: SceneAt, times: Sequence[float]) -> Targets:
    """Targets that hold those of all times; scenes are not kept."""
    return common_targets([scene_at(time).targets for time in times])
