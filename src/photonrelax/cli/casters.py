"""Options of maps behind a mesh alone: its material, units and place in the light."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING, Any

import photonrelax as pr

from .scenes import is_file

# Import lazily, so that Ctrl-C during an import reaches `main`.
if TYPE_CHECKING:
    from .._util.validation import Floats

# Light that is sparse is blurred over no more than this share of the map: photons in the dark
# around a focus would otherwise be averaged with all of the focus.
_GATHER_SHARE = 1.0 / 64.0


def add_caster_options(parser: argparse.ArgumentParser) -> None:
    """Add the options of a mesh; those that are not given are None."""
    from ..io.caster import MATERIALS, UNITS

    group = parser.add_argument_group(
        "meshes", "a file of a mesh alone, in parallel light, and the map of a screen behind it"
    )
    group.add_argument(
        "--material", choices=MATERIALS, help="of all of the mesh (that of the file, or glass)"
    )
    group.add_argument("--ior", type=float, metavar="N", help="index of refraction of glass (1.5)")
    group.add_argument(
        "--units",
        choices=UNITS,
        help="units of the file, of --distance, --size and --encircled (m)",
    )
    group.add_argument(
        "--direction", type=numbers, metavar="X,Y,Z", help="of the light (0,0,-1: down)"
    )
    group.add_argument(
        "--distance",
        type=float,
        metavar="D",
        help="from the last point of the mesh along the light to the screen (its diagonal)",
    )
    group.add_argument(
        "--rotate", type=numbers, metavar="X,Y,Z", help="turn the mesh about x, then y, then z"
    )
    group.add_argument(
        "--sun-angular-radius",
        type=float,
        metavar="DEGREES",
        help="half the angle under which the light is seen (0: parallel light)",
    )


def numbers(text: str) -> tuple[float, float, float]:
    """Three numbers of a text like 0,0,-1."""
    try:
        x, y, z = (float(each) for each in text.split(","))
    except ValueError:
        raise argparse.ArgumentTypeError(f"should be three numbers, but is {text!r}") from None
    return x, y, z


def is_mesh(name: str) -> bool:
    """True for the name of a file of a mesh alone."""
    from ..io.load import is_mesh_file

    return is_file(name) and is_mesh_file(name)


def complete_options(options: argparse.Namespace) -> None:
    """Make options of a mesh arguments of its file, and its screen the object to map.

    Ends with wrong usage where there is no mesh and such options are given, or no object.
    """
    from ..io.caster import SCREEN, CasterSetup

    names = [name for name in CasterSetup.__dataclass_fields__ if name in vars(options)]
    given = {name: getattr(options, name) for name in names if getattr(options, name) is not None}
    if not is_mesh(options.scene):
        if given:
            option = next(iter(given)).replace("_", "-")
            options.wrong_usage(f"--{option} is of a file of a mesh alone: leave it out")
        if options.on is None:
            options.wrong_usage("the following arguments are required: --on")
        return
    sensor: dict[str, Any] = {"screen": "sensor"} if options.on is None else {}
    options.arg = [*sensor.items(), *given.items(), *(options.arg or [])]
    options.on = options.on or SCREEN


def unit_of(options: argparse.Namespace) -> tuple[str, float]:
    """Name and length, m, of the unit of lengths among options."""
    from ..io.caster import UNITS

    name = dict(options.arg or ()).get("units", "m") if is_mesh(options.scene) else "m"
    return name, UNITS[name]


def map_size(options: argparse.Namespace, scene: pr.Scene) -> float | None:
    """Side of the map, m; None for all of the object."""
    if options.size is not None:
        return float(options.size * unit_of(options)[1])
    # Sensors do not count.
    return scene.scale if is_mesh(options.scene) else None


def gather_radius(options: argparse.Namespace, size: float | None) -> float | None:
    """Gather radius of maps behind a mesh, m; None for the automatic one."""
    return _GATHER_SHARE * size if is_mesh(options.scene) and size is not None else None


def axis_point(options: argparse.Namespace, scene: pr.Scene) -> Floats | None:
    """Point (3,) of a mesh's screen on the ray along the light through its middle."""
    if not is_mesh(options.scene):
        return None
    middle: Floats = scene.objects[-1].mesh.vertices.mean(axis=0)
    return middle
