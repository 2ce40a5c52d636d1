"""Built-in scenes and photon patterns, a module each named after it."""

from __future__ import annotations

import importlib
import inspect
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from ..scene.scene import Scene
    from .photon_pattern import PhotonPattern

_SCENES = {
    "box": "three coloured boxes, a white ball and a glass ball: colour that bleeds",
    "cognac": "golden liquid, stirred up, in a balloon glass: the caustic beside it",
    "cylinder": "cylinder of tinted glass on a plane, in slanting light",
    "ellipsoid": "ellipsoid of coloured glass, and the caustic that it throws",
    "lamp": "faceted halogen lamp above a chair: every bit of light is caustic",
    "lights": "red, green and blue lights through clear and coloured glass",
    "pool": "sun through moving water: a net of light on the floor and walls of a pool",
    "prism": "glass prism before a strong point light: overlapping shards and filaments",
    "reflector": "bent strip of metal: a caustic beside light that is smooth",
    "ring": "metal ring in slanting sunlight: the nephroid",
    "ripples": "sunlight through a wavy slab of glass: the net of light below water",
    "rings": "rings and coins of gold and silver on a table",
    "spectrum": "prism in a dark room: a rainbow on the wall",
    "sphere": "glass sphere over a plane in collimated light: bright spot and folds",
    "toruses": "a torus of glass and one of metal, linked",
}
_PHOTON_PATTERNS = {
    "shapes": "photons alone: a disc, a square and three lines of equal density on black",
    "two-sets": "photons alone: two overlapping sets of uneven density, after SJ13 Fig. 2 and 3",
}


def names() -> tuple[str, ...]:
    """Names of the built-in scenes."""
    return tuple(_SCENES)


def pattern_names() -> tuple[str, ...]:
    """Names of the built-in photon patterns, which have no scene."""
    return tuple(_PHOTON_PATTERNS)


def about(name: str) -> str:
    """One-line description of a scene or photon pattern."""
    descriptions = _SCENES | _PHOTON_PATTERNS
    _check(name, descriptions, "name")
    return descriptions[name]


def scene(name: str, **sizes: Any) -> Scene:
    """Build a scene.

    Parameters
    ----------
    name : str
        One of `names()`; also the name of the module and the function that build it.
    **sizes
        Arguments of that function, in place of its defaults.

    Raises
    ------
    ValueError
        If there is no such scene.
    """
    _check(name, _SCENES, "scene")
    built: Scene = _build(name, sizes)
    return built


def arguments(name: str) -> tuple[str, ...]:
    """Names of the arguments of a scene."""
    _check(name, _SCENES, "scene")
    return tuple(inspect.signature(_builder(name)).parameters)


def moves(name: str) -> bool:
    """Whether a scene depends on an argument `time`."""
    return "time" in arguments(name)


def pattern(name: str, **sizes: Any) -> PhotonPattern:
    """Make the photons of a pattern, with their exact irradiance.

    Parameters
    ----------
    name : str
        One of `pattern_names()`; also the name of the module and the function that make it.
    **sizes
        Arguments of that function, in place of its defaults.

    Returns
    -------
    PhotonPattern
        Photons, and their exact irradiance at points and as pixel means.

    Raises
    ------
    ValueError
        If there is no such photon pattern.
    """
    _check(name, _PHOTON_PATTERNS, "photon pattern")
    made: PhotonPattern = _build(name, sizes)
    return made


# Names of earlier versions.
distribution_names, distribution = pattern_names, pattern


def _build(name: str, sizes: dict[str, Any]) -> Any:
    return _builder(name)(**sizes)


def _builder(name: str) -> Callable[..., Any]:
    module = name.replace("-", "_")
    builder: Callable[..., Any] = getattr(importlib.import_module(f".{module}", __name__), module)
    return builder


def _check(name: str, known: dict[str, str], argument: str) -> None:
    if name not in known:
        raise ValueError(f"{argument} should be one of {', '.join(known)}, but is {name!r}")
