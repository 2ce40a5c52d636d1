"""Methods and settings for a purpose: measured trades of error for time, by classes of scenes.

The data, `presets.json`, are written by `python -m bench presets` from the fronts of
`photonrelax.evaluation.tradeoff`.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cache
from importlib.resources import files
from typing import Any, NamedTuple

from .._util.validation import check_choice
from ..estimation.methods import DEFAULT_METHOD, Settings, method_named
from ..scene.scene import Scene

PRESETS = ("draft", "preview", "final", "paper")
"""Names, from the quickest to the most exact, and the settings of the papers."""
SCENE_CLASSES = ("sharp", "extended")
"""Classes of scenes: light of parallel and point-like emitters, and of extended ones."""
_PHOTONS = 1_000_000
# Presets that are chosen by their errors.
_MEASURED = PRESETS[:3]


@dataclass(frozen=True)
class Choice:
    """A method with its settings and numbers.

    Attributes
    ----------
    method : str
    n_emitted : int
        Photons of caustics; methods without photons do not read it.
    supersampling : int
        s·s samples a pixel.
    stages : mapping
        Settings that are not the method's defaults, by stage and field.
    """

    method: str
    n_emitted: int
    supersampling: int = 2
    stages: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)

    @property
    def settings(self) -> Settings:
        """Settings of its stages."""
        record = method_named(self.method)
        return Settings(
            **{
                stage: replace(record.default(stage), **_without_lists(values))
                for stage, values in self.stages.items()
            }
        )

    @property
    def name(self) -> str:
        """Method and settings in one line, without the number of photons."""
        parts = [
            f"{stage}.{name}={_text(value)}"
            for stage, values in self.stages.items()
            for name, value in values.items()
        ]
        if self.supersampling != 2:
            parts.append(f"supersampling={self.supersampling}")
        return " ".join([self.method, *parts])

    def to_dict(self) -> dict[str, Any]:
        """The attributes as JSON has them."""
        return {**vars(self), "stages": {name: dict(v) for name, v in self.stages.items()}}


def _without_lists(values: Mapping[str, Any]) -> dict[str, Any]:
    return {name: tuple(v) if isinstance(v, list) else v for name, v in values.items()}


def _text(value: Any) -> str:
    return ",".join(map(str, value)) if isinstance(value, list | tuple) else f"{value:g}"


def scene_class(scene: Scene) -> str:
    """Class of a scene, of `SCENE_CLASSES`."""
    spread = any(emitter.is_extended or emitter.is_background for emitter in scene.emitters)
    return "extended" if spread else "sharp"


def preset(name: str, scene: Scene, method: str | None = None) -> Choice:
    """The choice that a preset makes for a scene.

    Parameters
    ----------
    name : str
        Of `PRESETS`.
    scene : Scene
    method : str, optional
        The method, if it is chosen already.

    Raises
    ------
    ValueError
        If there is no such preset, or the method has none.
    """
    check_choice(name, "preset", PRESETS)
    rows = preset_data()["presets"][scene_class(scene)][name]
    if method is None:
        method = next(iter(rows))
    if method not in rows:
        raise ValueError(
            f"presets are of the methods {', '.join(rows)}, but method is {method!r}: leave out "
            "the preset, or take one of these"
        )
    row = rows[method]
    return Choice(method, row["n_emitted"], row["supersampling"], row["stages"])


def preset_names() -> set[str]:
    """Names of the choices of all presets, which leave out numbers of photons."""
    return {
        Choice(method, 0, row["supersampling"], row["stages"]).name
        for of_class in preset_data()["presets"].values()
        for rows in of_class.values()
        for method, row in rows.items()
    }


class Work(NamedTuple):
    """Processor seconds that were measured in scenes of a class.

    Attributes
    ----------
    photon : float
        For each photon emitted, of the best preset.
    envelope : float
        Of the first division of an envelope.
    """

    photon: float
    envelope: float


def work_of(scene: Scene) -> Work:
    """Seconds that photons and envelopes take in scenes of the class."""
    name = scene_class(scene)
    row = next(iter(preset_data()["presets"][name][_MEASURED[-1]].values()))
    # Where no envelope was measured none is worth a try.
    envelope = preset_data()["envelopes"][name] or float("inf")
    return Work(row["seconds"] / row["n_emitted"], envelope)


def choose(
    scene: Scene, method: str | None, name: str | None = None, error: float | None = None
) -> Choice:
    """Method and settings of a render.

    Parameters
    ----------
    scene : Scene
    method : str, optional
        The method, if it is chosen already.
    name : str, optional
        Of a preset.
    error : float, optional
        Without a preset's name: the quickest preset that reaches it is chosen.
    """
    if name is not None:
        return preset(name, scene, method)
    if error is not None:
        found = _for_error(scene, method, error)
        if found is not None:
            return found
    return Choice(method_named(method or DEFAULT_METHOD).name, _PHOTONS)


def _for_error(scene: Scene, method: str | None, error: float) -> Choice | None:
    """The quickest preset whose error is not more, or the most exact; None without presets."""
    found = None
    of_class = preset_data()["presets"][scene_class(scene)]
    for rows in (of_class[each] for each in _MEASURED):
        name = next(iter(rows)) if method is None else method
        if name not in rows:
            continue
        row = rows[name]
        if found is None or row["error"] < found[1]:
            found = (
                Choice(name, row["n_emitted"], row["supersampling"], row["stages"]),
                row["error"],
            )
        if row["error"] <= error:
            break
    return None if found is None else found[0]


@cache
def preset_data() -> dict[str, Any]:
    """The file of presets: version and date of the measurement, and rows by class and preset.

    The first row of each is of the method that is best for `final`. Rows are ``measured`` if their
    errors and times are of two scenes of the class or more, not of all scenes, nor the papers'.
    """
    text = files(__package__).joinpath("presets.json").read_text(encoding="utf-8")
    data: dict[str, Any] = json.loads(text)
    return data
