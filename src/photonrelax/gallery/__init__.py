"""Built-in scenes, and photons without a scene: one file each, a short function of its sizes."""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from ..scene.scene import Scene
    from .photon_pattern import Distribution

_ABOUT = {
    "prism": "glass prism before a strong point light: overlapping shards and filaments",
    "reflector": "bent strip of metal: a caustic beside light that is smooth",
    "ring": "metal ring in slanting sunlight: the cardioid",
    "ripples": "sunlight through a wavy slab of glass: the net of light below water",
    "sphere": "glass sphere over a plane in collimated light: bright spot and folds",
}
_ABOUT_DISTRIBUTIONS = {
    "shapes": "photons alone: a disc, a square and three lines of equal density on black",
}


def names() -> tuple[str, ...]:
    """Return the names of the built-in scenes."""
    return tuple(_ABOUT)


def distribution_names() -> tuple[str, ...]:
    """Return the names of the built-in distributions: photons without a scene."""
    return tuple(_ABOUT_DISTRIBUTIONS)


def about(name: str) -> str:
    """Return one line that says what a scene or a distribution shows."""
    every = _ABOUT | _ABOUT_DISTRIBUTIONS
    _check(name, every, "name")
    return every[name]


def scene(name: str, **sizes: Any) -> Scene:
    """Build a scene by its name.

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
    _check(name, _ABOUT, "scene")
    built: Scene = _build(name, sizes)
    return built


def distribution(name: str, **sizes: Any) -> Distribution:
    """Make the photons of a distribution by its name, with their exact irradiance.

    Parameters
    ----------
    name : str
        One of `distribution_names()`; also the name of the module and the function that make it.
    **sizes
        Arguments of that function, in place of its defaults.

    Returns
    -------
    Distribution
        Photons, irradiance at points and as pixel means, and how to take a picture of them.

    Raises
    ------
    ValueError
        If there is no such distribution.
    """
    _check(name, _ABOUT_DISTRIBUTIONS, "distribution")
    made: Distribution = _build(name, sizes)
    return made


def _build(name: str, sizes: dict[str, Any]) -> Any:
    module = importlib.import_module(f".{name}", __name__)
    return getattr(module, name)(**sizes)


def _check(name: str, known: dict[str, str], what: str) -> None:
    if name not in known:
        raise ValueError(f"{what} should be one of {', '.join(known)}, but is {name!r}")
