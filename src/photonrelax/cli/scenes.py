"""Scenes of the command line: built-in ones by name, and those of files."""

from __future__ import annotations

import argparse
import ast
import warnings
from pathlib import Path
from typing import TYPE_CHECKING, Any

import photonrelax as pr

from .. import gallery
from .streams import write_lines

if TYPE_CHECKING:
    from ..io.objects import Finding


def add_scene(parser: argparse.ArgumentParser, *others: str) -> None:
    """Add the argument that names a scene, or one of others, and the options of files."""
    names = (*gallery.names(), *others)
    parser.add_argument(
        "scene",
        type=lambda text: scene_name(text, names),
        metavar="SCENE|FILE",
        help=f"{', '.join(names)}; or a file: a script that defines scene(), glTF or a mesh",
    )
    add_file_options(parser)


def add_file_options(parser: argparse.ArgumentParser) -> None:
    """Add the options of scenes from files."""
    from ..io.options import LIGHT_UNITS

    group = parser.add_argument_group("scenes")
    group.add_argument(
        "--arg",
        action="append",
        type=_argument,
        metavar="NAME=VALUE",
        help="an argument of a built-in scene, or of the function scene() of a script; repeatable",
    )
    group.add_argument("--camera", metavar="NAME", help="camera, of several in a file (the first)")
    group.add_argument(
        "--light-units",
        choices=LIGHT_UNITS,
        default=LIGHT_UNITS[0],
        help="units of light in a glTF file, as its exporter was told (%(default)s)",
    )
    group.add_argument(
        "--strict",
        action="store_true",
        help="end with an error if the file holds what a scene cannot",
    )


def scene_name(text: str, names: tuple[str, ...]) -> str:
    """Name of a scene or of a file, which is told by its ending.

    Raises
    ------
    argparse.ArgumentTypeError
        If it is neither.
    """
    from ..io.load import endings

    # Which other files trimesh reads is not known before it is loaded.
    if text in names or Path(text).suffix:
        return text
    files = ", ".join(f"*{each}" for each in endings())
    raise argparse.ArgumentTypeError(
        f"should be one of {', '.join(names)} or a file named {files}, but is {text!r}"
    )


def is_file(name: str) -> bool:
    """True for the name of a file, false for that of a built-in scene."""
    return name not in (*gallery.names(), *gallery.pattern_names())


def scene_of(name: str, options: argparse.Namespace, **others: float) -> pr.Scene:
    """Scene of a name, with the options of files; warnings about a file are printed.

    `others` are arguments of a script besides those that the user gives.
    """
    arguments = dict(options.arg or ()) | others
    if not is_file(name):
        if options.camera:
            options.wrong_usage("--camera is of scenes from files: leave it out")
        return built_in(name, options)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        scene = pr.load_scene(
            name,
            camera=options.camera,
            light_units=options.light_units,
            strict=options.strict,
            arguments=arguments,
        )
    if not getattr(options, "quiet", False):
        lines = [f"photonrelax: warning: {each.message}" for each in caught]
        if lines:
            write_lines(*lines, to_stderr=True)
    return scene


def built_in(name: str, options: argparse.Namespace, **others: float) -> pr.Scene:
    """Built-in scene with the arguments that the user gives, and others."""
    given = dict(options.arg or ())
    unknown = sorted(given.keys() - set(gallery.arguments(name)))
    if unknown:
        options.wrong_usage(
            f"--arg should be of {', '.join(gallery.arguments(name))}, the arguments of {name}, "
            f"but is of {', '.join(unknown)}"
        )
    try:
        return gallery.scene(name, **given | others)
    except TypeError as error:
        return options.wrong_usage(f"--arg should have values that {name} takes: {error}")


def findings_of(name: str, options: argparse.Namespace) -> tuple[list[Finding], pr.Scene | None]:
    """Findings about a scene of a name, and the scene, its meshes mended."""
    from ..io.check import check_scene, scene_findings
    from ..io.options import LoadOptions

    if not is_file(name):
        scene = scene_of(name, options)
        return list(scene_findings(scene)), scene
    arguments = dict(options.arg or ())
    given = LoadOptions(options.camera, options.light_units, options.strict, arguments)
    return check_scene(name, given)


def _argument(text: str) -> tuple[str, Any]:
    """Name and value of ``NAME=VALUE``; a value that is no Python literal is text."""
    name, equals, value = text.partition("=")
    if not (equals and name.strip().isidentifier()):
        raise argparse.ArgumentTypeError(f"should be NAME=VALUE, but is {text!r}")
    try:
        return name.strip(), ast.literal_eval(value.strip())
    except (ValueError, SyntaxError, MemoryError, RecursionError):
        return name.strip(), value.strip()
