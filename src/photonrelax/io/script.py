"""Scenes that Python scripts make."""

from __future__ import annotations

import importlib.util
import inspect
import sys
import traceback
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from types import ModuleType
from typing import Any

from .._util.files import first_bytes
from ..scene.scene import Scene
from .options import LoadOptions

FUNCTION = "scene"


def load_script(path: Path, options: LoadOptions) -> Scene:
    """Scene that a script's function ``scene`` returns, called with the arguments by name.

    The script may import modules beside it.

    Raises
    ------
    ValueError
        If it fails, defines no such function, or that takes other arguments.
    TypeError
        If the function returns something else.
    """
    _refuse_camera(path, options)
    first_bytes(path, 1)
    with _importing_beside(path):
        function = getattr(_run(path), FUNCTION, None)
        if not callable(function):
            raise ValueError(f"{path} should define a function {FUNCTION}(), but does not")
        _check_arguments(path, function, options)
        made = _calling(path, lambda: function(**options.arguments))
    if not isinstance(made, Scene):
        raise TypeError(
            f"{FUNCTION}() of {path} should return a photonrelax.Scene, but returns "
            f"{type(made).__name__}"
        )
    return made


def _refuse_camera(path: Path, options: LoadOptions) -> None:
    if options.camera is not None:
        raise ValueError(
            f"{path} has the one camera of the scene that it makes, but camera is "
            f"{options.camera!r}: give the script an argument for it"
        )


def _run(path: Path) -> ModuleType:
    """The script as a module, found by its name, as dataclasses in it need."""
    name = f"photonrelax_scene_{path.stem}"
    spec = importlib.util.spec_from_file_location(name, path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module
    loader = spec.loader
    _calling(path, lambda: loader.exec_module(module))
    return module


@contextmanager
def _importing_beside(path: Path) -> Iterator[None]:
    folder = str(path.resolve().parent)
    sys.path.insert(0, folder)
    try:
        yield
    finally:
        sys.path.remove(folder)


def _calling(path: Path, call: Callable[[], Any]) -> Any:
    """Result of code of the script; its errors name the script and the line."""
    try:
        return call()
    except Exception as error:
        frames = traceback.extract_tb(error.__traceback__)
        lines = [frame.lineno for frame in frames if frame.filename == str(path)]
        where = f", line {lines[-1]}" if lines else ""
        raise ValueError(f"{path}{where} fails with {type(error).__name__}: {error}") from error


def _check_arguments(path: Path, function: Callable[..., Any], options: LoadOptions) -> None:
    signature = inspect.signature(function)
    try:
        signature.bind(**options.arguments)
    except TypeError as error:
        raise ValueError(
            f"arguments should fit {FUNCTION}{signature} of {path}, but are "
            f"{dict(options.arguments)}: {error}"
        ) from None
