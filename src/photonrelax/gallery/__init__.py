"""Built-in scenes: one file each, every one a short function of its sizes."""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from ..scene import Scene

_ABOUT = {
    "prism": "glass prism before a strong point light: overlapping shards and filaments",
    "ring": "metal ring in slanting sunlight: the cardioid",
    "ripples": "sunlight through a wavy slab of glass: the net of light below water",
    "sphere": "glass sphere over a plane in collimated light: bright spot and folds",
}


def names() -> tuple[str, ...]:
    """Return the names of the built-in scenes."""
    return tuple(_ABOUT)


def about(name: str) -> str:
    """Return one line that says what a scene shows."""
    _check(name)
    return _ABOUT[name]


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
    _check(name)
    module = importlib.import_module(f".{name}", __name__)
    built: Scene = getattr(module, name)(**sizes)
    return built


def _check(name: str) -> None:
    if name not in _ABOUT:
        raise ValueError(f"scene should be one of {', '.join(_ABOUT)}, but is {name!r}")
