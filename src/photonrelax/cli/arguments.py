"""Arguments of the command line."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Mapping
from pathlib import Path

from .. import gallery
from .._version import __version__
from .casters import add_caster_options
from .scenes import add_file_options, add_scene, scene_name

PHOTONS = 1_000_000
PHOTONS_PER_PASS = 100_000
SUPERSAMPLING = 2
FPS = 24.0
REFERENCE_PASSES, REFERENCE_PHOTONS = 50, 1_000_000
SAMPLER = "halton"
# In place of the name of a file; a file of this name is ./-
STDOUT = "-"
_SIZE_UNITS = ("K", "M", "G", "T")


def parser(commands: Mapping[str, Callable[..., int | None]]) -> argparse.ArgumentParser:
    """Parser of the command line; `commands` are the functions to call."""
    parser = argparse.ArgumentParser(
        prog="photonrelax", description="Render sharp, noise-free caustics from few photons."
    )
    parser.add_argument("--version", action="version", version=f"photonrelax {__version__}")
    subparsers = parser.add_subparsers(required=True, metavar="COMMAND")
    for name, (about, add) in COMMANDS.items():
        subparser = subparsers.add_parser(name, help=about, description=about)
        subparser.set_defaults(command=commands[name], wrong_usage=subparser.error)
        add(subparser)
    return parser


def _add_render(parser: argparse.ArgumentParser) -> None:
    from ..estimation.methods import PLAIN_METHOD

    add_scene(parser)
    _add_output(parser, "FILE.exr")
    _add_choice(parser)
    parser.add_argument(
        "--photon-map",
        type=Path,
        metavar="FILE.npz",
        help="photons traced before in this scene, in place of new ones; for relaxed photons use "
        f"--method {PLAIN_METHOD}",
    )
    _add_components(parser)
    _add_final_gather(parser)
    _add_sampler(parser)
    _add_settings(parser)
    _add_image(parser)
    _add_crop(parser)
    _add_camera_paths(parser)
    _add_passes(parser)
    _add_memory(parser)
    parser.add_argument(
        "--stats",
        type=_path_or_stdout,
        metavar="FILE.json",
        help="write times and counts of the stages; - writes them to standard output, and the "
        "report to standard error",
    )
    _add_workers(parser)
    _add_common(parser)


def _add_choice(parser: argparse.ArgumentParser) -> None:
    from ..estimation.methods import DEFAULT_METHOD, METHODS
    from ..rendering.presets import PRESETS

    parser.add_argument(
        "--method", choices=METHODS, help=f"default: {DEFAULT_METHOD}, or that of --preset"
    )
    _add_emission(parser)
    parser.add_argument(
        "--preset",
        choices=PRESETS,
        help="method, photons, samples and settings, unless they are given",
    )
    _add_goal(parser)


def _add_goal(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--error",
        type=_positive_number,
        metavar="E",
        help="add photons until the estimated error of the image, relative L1 of its radiance or "
        "irradiance, is not more: 0.03, say",
    )
    parser.add_argument(
        "--seconds",
        type=_positive_number,
        metavar="T",
        help="time after which no photons are added",
    )


def _add_components(parser: argparse.ArgumentParser) -> None:
    # Without defaults, to refuse them where they are given beside --passes.
    parser.add_argument(
        "--components",
        type=_names,
        metavar="NAME,...",
        help="light to model, of emission,direct,caustic,indirect (all that the scene has)",
    )
    parser.add_argument(
        "--global",
        dest="n_global",
        type=whole,
        metavar="N",
        help="photons to emit for indirect light (as the plan says; 0 for none)",
    )


def _add_final_gather(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--final-gather",
        type=whole,
        default=0,
        metavar="N",
        help="rays to gather indirect light with, from each piece of surface in a pixel (0: none)",
    )


def _add_animate(parser: argparse.ArgumentParser) -> None:
    moving = ", ".join(name for name in gallery.names() if gallery.moves(name))
    parser.add_argument(
        "scene",
        type=lambda text: scene_name(text, gallery.names()),
        metavar="SCENE|FILE.py",
        help=f"that moves: {moving}, or a script that defines scene(time)",
    )
    add_file_options(parser)
    _add_output(parser, "FILE.%04d.exr")
    parser.add_argument("--frames", type=positive, required=True, metavar="N", help="their number")
    parser.add_argument(
        "--fps",
        type=_positive_number,
        default=FPS,
        metavar="RATE",
        help="frames a second, of the scene's time and of --movie (%(default)g)",
    )
    parser.add_argument(
        "--start",
        type=float,
        default=0.0,
        metavar="SECONDS",
        help="time of the first frame (%(default)g)",
    )
    parser.add_argument(
        "--movie", type=Path, metavar="FILE.webp", help="write an animated WebP or PNG file too"
    )
    _add_choice(parser)
    _add_components(parser)
    _add_final_gather(parser)
    _add_sampler(parser)
    _add_settings(parser)
    _add_image(parser)
    _add_workers(parser)
    _add_memory(parser)
    _add_common(parser)


def _add_memory(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--memory",
        type=_bytes,
        metavar="SIZE",
        help="memory to take at most, as 8G or 500M; what is estimated to take more is refused "
        "(nine tenths of what is free)",
    )


def _add_plan(parser: argparse.ArgumentParser) -> None:
    add_scene(parser)
    parser.add_argument(
        "--photons", type=positive, metavar="N", help=f"photons to emit for caustics ({PHOTONS})"
    )
    _add_components(parser)
    parser.add_argument("--threads", type=positive, metavar="N", help="number of threads (all)")


def _add_passes(parser: argparse.ArgumentParser) -> None:
    from ..estimation.methods import PASSES_METHOD

    group = parser.add_argument_group(
        "passes", f"passes of {PHOTONS_PER_PASS} new photons each; with --method {PASSES_METHOD}"
    )
    group.add_argument(
        "--passes",
        type=positive,
        metavar="N",
        help="total number, including passes of a resumed run",
    )
    group.add_argument(
        "--minutes",
        type=_positive_number,
        metavar="T",
        help="time limit; the last pass is completed",
    )
    group.add_argument(
        "--state",
        type=Path,
        metavar="FILE.npz",
        help="save the run here, and resume it if the file exists",
    )
    group.add_argument(
        "--interval",
        type=_positive_number,
        metavar="SECONDS",
        help="time between saving the run and the image (60)",
    )
    group.add_argument(
        "--stochastic", action="store_true", help="jitter pixel samples in every pass"
    )


def _add_trace(parser: argparse.ArgumentParser) -> None:
    from ..estimation.methods import METHODS

    with_spectra = ", ".join(each.name for each in METHODS.values() if each.needs_spectra)
    add_scene(parser)
    _add_output(parser, "FILE.npz|DIR")
    _add_emission(parser)
    _add_sampler(parser)
    parser.add_argument(
        "--chunk",
        type=positive,
        metavar="N",
        help="write a folder of parts of N photons emitted each, which takes memory for one; "
        "started again, an interrupted run goes on",
    )
    parser.add_argument(
        "--frequency-share",
        type=float,
        default=0.0,
        metavar="SHARE",
        help="share of the photons that get local frequency spectra, for --method "
        f"{with_spectra} (%(default)s; 0.02, say)",
    )
    _add_workers(parser)
    _add_common(parser)


def _add_relax(parser: argparse.ArgumentParser) -> None:
    from ..estimation.methods import DEFAULT_METHOD, METHODS

    parser.add_argument(
        "photon_map",
        metavar="PHOTONS.npz|DIR",
        type=Path,
        help="photon map; or the folder of its parts, which are relaxed by blocks into another",
    )
    _add_output(parser, "FILE.npz|DIR")
    parser.add_argument(
        "--block",
        type=positive,
        metavar="N",
        help="photons of a block, about, of those in parts (1000000)",
    )
    parser.add_argument(
        "--scene",
        type=lambda text: scene_name(text, gallery.names()),
        metavar="SCENE|FILE",
        help="scene of the photons, to project moved photons onto its surfaces",
    )
    add_file_options(parser)
    parser.add_argument(
        "--method",
        choices=[method.name for method in METHODS.values() if method.relax is not None],
        default=DEFAULT_METHOD,
        help=f"method that relaxes them ({DEFAULT_METHOD})",
    )
    _add_iterations(parser)
    _add_workers(parser)
    _add_common(parser)


def _add_compare(parser: argparse.ArgumentParser) -> None:
    from ..estimation.methods import METHODS

    names = (*gallery.names(), *gallery.pattern_names())
    parser.add_argument("scene", choices=names, metavar="SCENE", help=", ".join(names))
    _add_output(parser, "FOLDER")
    parser.add_argument(
        "--methods",
        nargs="+",
        choices=METHODS,
        metavar="METHOD",
        help=f"any of {', '.join(METHODS)}; default: the five of SJ13 Table I",
    )
    _add_emission(parser)
    _add_sampler(parser)
    _add_settings(parser)
    _add_image(parser)
    _add_reference(parser)
    _add_common(parser)


def _add_reference(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--reference",
        type=Path,
        metavar="FILE.exr",
        help="image of the same view to measure errors against; default: one that is computed "
        "and cached in FOLDER",
    )
    # Without defaults, to refuse them where they are given but no reference is computed.
    parser.add_argument(
        "--reference-passes",
        type=positive,
        metavar="N",
        help=f"number of progressive passes of a computed reference ({REFERENCE_PASSES})",
    )
    parser.add_argument(
        "--reference-photons",
        type=positive,
        metavar="N",
        help=f"photons in each of these, independent of --photons ({REFERENCE_PHOTONS})",
    )


def _add_tradeoff(parser: argparse.ArgumentParser) -> None:
    from ..evaluation.tradeoff import SWEPT_METHODS

    add_scene(parser)
    _add_output(parser, "FOLDER")
    parser.add_argument(
        "--methods",
        nargs="+",
        choices=SWEPT_METHODS,
        metavar="METHOD",
        help=f"any of {', '.join(SWEPT_METHODS)}; default: all",
    )
    _add_emission(parser)
    _add_size(parser)
    _add_reference(parser)
    _add_workers(parser)
    _add_common(parser)


def _add_irradiance(parser: argparse.ArgumentParser) -> None:
    from ..estimation.methods import DEFAULT_METHOD, METHODS

    add_scene(parser)
    parser.add_argument(
        "--on",
        metavar="OBJECT",
        help="name or number of the flat object to map, from the side with most light; required "
        "but for a mesh, which has a screen",
    )
    _add_output(parser, "FILE.exr")
    parser.add_argument(
        "--texels",
        type=positive,
        default=512,
        metavar="N",
        help="texels along the longer side (%(default)s)",
    )
    parser.add_argument(
        "--size",
        type=_positive_number,
        metavar="METRES",
        help="side of a square around the middle of the light, in place of the whole object; of a "
        "mesh in --units (its diagonal)",
    )
    parser.add_argument(
        "--encircled",
        type=_radii,
        metavar="RADIUS,...",
        help="print the flux within these radii, in m, of the centre and of the brightest point; "
        "of a mesh in --units, and of the axis too",
    )
    parser.add_argument(
        "--plot",
        type=Path,
        metavar="FILE.png",
        help="write false colours with a scale, and a cross-section",
    )
    parser.add_argument(
        "--method", choices=METHODS, default=DEFAULT_METHOD, help="default: %(default)s"
    )
    parser.add_argument(
        "--photon-map",
        type=Path,
        metavar="FILE.npz|DIR",
        help="photons traced before in this scene, in place of new ones; or the folder of blocks "
        "that `relax` wrote, which are gathered as they are, one after another",
    )
    _add_emission(parser)
    _add_goal(parser)
    _add_sampler(parser)
    _add_settings(parser)
    _add_exposure(parser)
    _add_memory(parser)
    add_caster_options(parser)
    _add_workers(parser)
    _add_common(parser)


def _add_check(parser: argparse.ArgumentParser) -> None:
    add_scene(parser)
    parser.add_argument(
        "--repair",
        type=Path,
        metavar="FILE.glb",
        help="write the scene with meshes of glass welded, closed and wound outwards, as far as "
        "that can be done",
    )


def _add_info(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("file", metavar="FILE", type=Path)


COMMANDS: dict[str, tuple[str, Callable[[argparse.ArgumentParser], None]]] = {
    "render": ("render a scene to an EXR file, and a PNG preview beside it", _add_render),
    "plan": ("print what light a render models, and why", _add_plan),
    "trace": ("trace the photons of a scene into a photon map", _add_trace),
    "relax": ("relax the photons of a photon map", _add_relax),
    "compare": ("compare methods on the same photons: table, images, HTML page", _add_compare),
    "irradiance": (
        "map the irradiance on a flat object, or behind a mesh, to an EXR file and a PNG preview",
        _add_irradiance,
    ),
    "animate": (
        "render frames of a scene that moves, but those whose files are there already",
        _add_animate,
    ),
    "tradeoff": (
        "sweep methods and settings, and find the best for every time: table, plot, HTML page",
        _add_tradeoff,
    ),
    "list": ("list the built-in scenes and photon patterns", lambda parser: None),
    "check": ("list what is wrong with a scene, without rendering it", _add_check),
    "info": ("describe an EXR file or a photon map", _add_info),
}


def _add_output(parser: argparse.ArgumentParser, metavar: str) -> None:
    parser.add_argument("-o", "--output", type=Path, required=True, metavar=metavar)


def _add_emission(parser: argparse.ArgumentParser) -> None:
    # Without defaults, to refuse them where they are given beside --photon-map.
    parser.add_argument(
        "--photons", type=positive, metavar="N", help=f"photons to emit ({PHOTONS})"
    )
    parser.add_argument("--seed", type=whole, metavar="N", help="seed of the photons (0)")


def _add_sampler(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--sampler", choices=("halton", "random"), help=f"sequence of the photons ({SAMPLER})"
    )


def _add_settings(parser: argparse.ArgumentParser) -> None:
    # Without defaults, to refuse settings that are given but read by no method.
    from ..estimation.refinement import REFINEMENTS
    from .settings import assignment

    parser.add_argument(
        "--k",
        type=positive,
        metavar="N",
        help="photons per estimate (15); in render with progressive methods: of the initial radius",
    )
    _add_iterations(parser)
    parser.add_argument(
        "--refinement",
        choices=tuple(REFINEMENTS),
        help="adapt the number of photons of each estimate, up to --k (none)",
    )
    parser.add_argument(
        "--set",
        action="append",
        type=assignment,
        metavar="STAGE.FIELD=VALUE",
        help="set a setting of a stage: diffusion.k=200, relax.n_iterations=3,3; repeatable",
    )


def _add_iterations(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--iterations",
        type=whole,
        nargs=2,
        metavar=("CONSTRAINED", "COLLAPSED"),
        help="iterations of relaxation (7 7; of mapped 5 5)",
    )


def _add_size(parser: argparse.ArgumentParser) -> None:
    for name in ("width", "height"):
        parser.add_argument(
            f"--{name}",
            type=positive,
            metavar="PIXELS",
            help=f"{name} of the image; alone, it keeps the proportions",
        )


def _add_image(parser: argparse.ArgumentParser) -> None:
    _add_size(parser)
    parser.add_argument(
        "--supersampling",
        type=positive,
        metavar="N",
        help=f"N x N samples per pixel ({SUPERSAMPLING})",
    )
    _add_exposure(parser)


def _add_crop(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--crop",
        type=whole,
        nargs=4,
        metavar=("X0", "Y0", "X1", "Y1"),
        help="render the pixels [X0, X1) x [Y0, Y1) of the image alone, from its upper left (all)",
    )


def _add_camera_paths(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--light-samples",
        type=positive,
        metavar="N",
        help="shadow rays from each of these samples to each extended emitter, and to all of many "
        "lamps (enough for noise below 2%% of a pixel)",
    )
    parser.add_argument(
        "--max-depth",
        type=whole,
        default=8,
        metavar="N",
        help="specular surfaces that a camera ray passes at most (%(default)s)",
    )
    parser.add_argument(
        "--indirect-k",
        type=positive,
        metavar="N",
        help="photons per estimate of indirect light (800, or 1600 of three million and more)",
    )


def _add_exposure(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--exposure",
        type=_stops,
        default=0.0,
        metavar="STOPS",
        help="exposure of PNG images, a factor of 2^STOPS (0)",
    )


def _add_workers(parser: argparse.ArgumentParser) -> None:
    group = parser.add_argument_group(
        "workers", "processes that share the work, --threads each (1); results do not depend on it"
    )
    where = group.add_mutually_exclusive_group()
    where.add_argument("--workers", type=positive, metavar="N", help="so many on this machine")
    where.add_argument(
        "--scheduler",
        metavar="tcp://HOST:PORT",
        help="those of a Dask scheduler, with the same version of this package",
    )
    group.add_argument(
        "--traceback", action="store_true", help="after an error, print where a worker had it"
    )


def _add_common(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--threads",
        type=positive,
        metavar="N",
        help="number of threads (all); results do not depend on it",
    )
    parser.add_argument("--quiet", action="store_true", help="print only errors")


def whole(text: str) -> int:
    """Whole number of at least 0, also written as 2e6 or 2_000_000."""
    try:
        number = int(text)
    except ValueError:
        number = _integral(text)
    if number < 0:
        raise argparse.ArgumentTypeError(f"should be a whole number, but is {text!r}")
    return number


def _integral(text: str) -> int:
    """Integer of a text like 2e6, -1 if it is none."""
    try:
        number = float(text)
    except ValueError:
        return -1
    return int(number) if number.is_integer() else -1


def positive(text: str) -> int:
    number = whole(text)
    if number < 1:
        raise argparse.ArgumentTypeError(f"should be at least 1, but is {text!r}")
    return number


def _path_or_stdout(text: str) -> Path | str:
    return STDOUT if text == STDOUT else Path(text)


def _positive_number(text: str) -> float:
    try:
        number = float(text)
    except ValueError:
        number = float("nan")
    if not 0.0 < number < float("inf"):
        raise argparse.ArgumentTypeError(f"should be a positive number, but is {text!r}")
    return number


def _bytes(text: str) -> float:
    """Bytes of a text like 8G, with K, M, G and T for powers of 1000."""
    number, unit = (text[:-1], text[-1].upper()) if text[-1:].isalpha() else (text, "")
    try:
        size = float(number) * 1000.0 ** ("", *_SIZE_UNITS).index(unit)
    except ValueError:
        size = float("nan")
    if not 0.0 < size < float("inf"):
        raise argparse.ArgumentTypeError(
            f"should be a size with one of {', '.join(_SIZE_UNITS)}, as 8G, but is {text!r}"
        )
    return size


def _names(text: str) -> tuple[str, ...]:
    """Names of a text like direct,caustic."""
    return tuple(name.strip() for name in text.split(","))


def _radii(text: str) -> tuple[float, ...]:
    """Positive numbers of a text like 0.05,1."""
    return tuple(_positive_number(number) for number in text.split(","))


def _stops(text: str) -> float:
    from ..imaging.image import MAX_EXPOSURE

    try:
        stops = float(text)
    except ValueError:
        stops = float("nan")
    if not abs(stops) <= MAX_EXPOSURE:
        raise argparse.ArgumentTypeError(
            f"should be a number between -{MAX_EXPOSURE:g} and {MAX_EXPOSURE:g}, but is {text!r}"
        )
    return stops
