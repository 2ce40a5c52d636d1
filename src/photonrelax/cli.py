"""The command line: arguments → settings → stages → files. The only file that prints."""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import photonrelax as pr

from . import gallery
from ._files import whole_file
from ._text import describe_image, describe_photons, stage_table
from .estimate import METHODS
from .image import read_exr

if TYPE_CHECKING:
    from .scene import Scene

INTERRUPTED = 130
_MAGIC_EXR, _MAGIC_NPZ = b"v/1\x01", b"PK\x03\x04"
Result = TypeVar("Result")


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line and return its exit code.

    0 for success, 1 for an error, 2 for wrong usage (raised as SystemExit), 130 for Ctrl-C.
    """
    options = _parser().parse_args(arguments)
    try:
        options.command(options)
    except KeyboardInterrupt:
        print("photonrelax: interrupted", file=sys.stderr)
        return INTERRUPTED
    except (ValueError, OSError, ImportError) as error:
        print(f"photonrelax: error: {error}", file=sys.stderr)
        return 1
    return 0


# --- commands ---------------------------------------------------------------------------------


def _render(options: argparse.Namespace) -> None:
    output = _output(options.output, ".exr")
    stats_path = None if options.stats is None else _output(options.stats)
    scene = _resized(gallery.scene(options.scene), options.width, options.height)
    with _Bars(options.quiet) as bars:
        image = pr.render(
            scene,
            method=options.method,
            n_emitted=options.photons,
            seed=options.seed,
            relax=pr.RelaxSettings(n_iterations=tuple(options.iterations)),
            gather=pr.GatherSettings(k=options.k),
            supersampling=options.supersampling,
            n_threads=options.threads,
            progress=bars,
        )
    preview = output.with_suffix(".png")
    image.write_exr(output)
    image.write_png(preview, exposure=options.exposure)
    if stats_path is not None:
        _write_json(stats_path, image.stats)
    _report(options, stage_table(image.stats["stages"]), f"wrote {output} and {preview}")


def _trace(options: argparse.Namespace) -> None:
    output = _output(options.output, ".npz")
    scene = gallery.scene(options.scene)
    with _Bars(options.quiet) as bars:
        photons, seconds = _timed(
            lambda: pr.trace_photons(
                scene,
                options.photons,
                seed=options.seed,
                sampler=options.sampler,
                n_threads=options.threads,
                progress=bars,
            )
        )
    photons.save(output)
    stages = {"trace": {"seconds": seconds, "emitted": options.photons, "stored": len(photons)}}
    _report(options, stage_table(stages), f"wrote {output}")


def _relax(options: argparse.Namespace) -> None:
    output = _output(options.output, ".npz")
    photons = pr.PhotonMap.load(options.photon_map)
    scene = None if options.scene is None else gallery.scene(options.scene)
    settings = pr.RelaxSettings(n_iterations=tuple(options.iterations))
    with _Bars(options.quiet) as bars:
        structure, structure_seconds = _timed(
            lambda: pr.detect_structure(photons, n_threads=options.threads, progress=bars)
        )
        relaxed, relax_seconds = _timed(
            lambda: pr.relax(
                photons,
                structure,
                settings,
                scene=scene,
                n_threads=options.threads,
                progress=bars,
            )
        )
    relaxed.save(output)
    stages = {
        "structure": {"seconds": structure_seconds, "photons": len(photons)},
        "relax": {"seconds": relax_seconds, "iterations": sum(options.iterations)},
    }
    _report(options, stage_table(stages), f"wrote {output}")


def _list(options: argparse.Namespace) -> None:
    width = max(map(len, gallery.names()))
    for name in gallery.names():
        print(f"{name:{width}}  {gallery.about(name)}")


def _info(options: argparse.Namespace) -> None:
    with options.file.open("rb") as file:
        magic = file.read(4)
    if magic == _MAGIC_EXR:
        print(describe_image(read_exr(options.file)))
    elif magic == _MAGIC_NPZ:
        print(describe_photons(pr.PhotonMap.load(options.file)))
    else:
        raise ValueError(f"{options.file} should be an EXR file or a photon map, but is neither")


# --- what is printed --------------------------------------------------------------------------


def _report(options: argparse.Namespace, *texts: str) -> None:
    if not options.quiet:
        print("\n".join(texts))


class _Bars:
    """A progress bar for each stage, on terminals; call it as ``bars(stage, done, total)``."""

    def __init__(self, quiet: bool) -> None:
        # None leaves it to tqdm to keep bars out of files and pipes.
        self._disable = True if quiet else None
        self._bars: dict[str, Any] = {}

    def __enter__(self) -> _Bars:
        return self

    def __exit__(self, *exception: object) -> None:
        for bar in self._bars.values():
            bar.close()

    def __call__(self, stage: str, done: int, total: int) -> None:
        from tqdm import tqdm

        if stage not in self._bars:
            self._bars[stage] = tqdm(
                total=total, desc=stage, unit_scale=True, disable=self._disable
            )
        bar = self._bars[stage]
        bar.total = total
        bar.update(done - bar.n)


# --- files and scenes -------------------------------------------------------------------------


def _output(path: Path, suffix: str | None = None) -> Path:
    """Return a path that can be written to; better to find out before the work than after."""
    if suffix is not None and path.suffix.lower() != suffix:
        raise ValueError(f"the output should be named *{suffix}, but is {path}")
    if not path.parent.is_dir():
        raise FileNotFoundError(f"cannot write {path}: there is no folder {path.parent}")
    if path.is_dir():
        raise IsADirectoryError(f"cannot write {path}: it is a folder")
    return path


def _write_json(path: Path, content: Mapping[str, Any]) -> None:
    with whole_file(path) as partial:
        partial.write_text(json.dumps(content, indent=2) + "\n", encoding="utf-8")


def _resized(scene: Scene, width: int | None, height: int | None) -> Scene:
    camera = scene.camera
    assert camera is not None, "every built-in scene has a camera"
    camera = replace(camera, width=width or camera.width, height=height or camera.height)
    return replace(scene, camera=camera)


def _timed(work: Callable[[], Result]) -> tuple[Result, float]:
    start = time.perf_counter()
    result = work()
    return result, time.perf_counter() - start


# --- arguments --------------------------------------------------------------------------------


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="photonrelax", description="Render sharp, noise-free caustics from few photons."
    )
    parser.add_argument("--version", action="version", version=f"photonrelax {pr.__version__}")
    commands = parser.add_subparsers(required=True, metavar="COMMAND")
    _add_render(commands)
    _add_trace(commands)
    _add_relax(commands)
    about = "list the built-in scenes"
    commands.add_parser("list", help=about, description=about).set_defaults(command=_list)
    about = "describe an EXR file or a photon map"
    info = commands.add_parser("info", help=about, description=about)
    info.add_argument("file", metavar="FILE", type=Path)
    info.set_defaults(command=_info)
    return parser


def _add_render(commands: Any) -> None:
    about = "render a built-in scene to an EXR file, and a PNG preview beside it"
    parser = commands.add_parser("render", help=about, description=about)
    parser.set_defaults(command=_render)
    _add_scene(parser)
    _add_output(parser, "FILE.exr")
    parser.add_argument(
        "--method", choices=METHODS, default="parameterised", help="default: %(default)s"
    )
    _add_emission(parser)
    parser.add_argument(
        "--k", type=_positive, default=15, metavar="N", help="photons per estimate (%(default)s)"
    )
    _add_iterations(parser)
    for name in ("width", "height"):
        parser.add_argument(f"--{name}", type=_positive, metavar="PIXELS", help="of the picture")
    parser.add_argument(
        "--supersampling",
        type=_positive,
        default=2,
        metavar="N",
        help="N x N rays per pixel (%(default)s)",
    )
    parser.add_argument(
        "--exposure", type=float, default=0.0, metavar="STOPS", help="of the PNG preview"
    )
    parser.add_argument("--stats", type=Path, metavar="FILE.json", help="write times and counts")
    _add_common(parser)


def _add_trace(commands: Any) -> None:
    about = "trace the photons of a built-in scene into a photon map"
    parser = commands.add_parser("trace", help=about, description=about)
    parser.set_defaults(command=_trace)
    _add_scene(parser)
    _add_output(parser, "FILE.npz")
    _add_emission(parser)
    parser.add_argument(
        "--sampler", choices=("halton", "random"), default="halton", help="default: %(default)s"
    )
    _add_common(parser)


def _add_relax(commands: Any) -> None:
    about = "relax the photons of a photon map"
    parser = commands.add_parser("relax", help=about, description=about)
    parser.set_defaults(command=_relax)
    parser.add_argument("photon_map", metavar="PHOTONS.npz", type=Path)
    _add_output(parser, "FILE.npz")
    parser.add_argument(
        "--scene",
        choices=gallery.names(),
        help="the scene of the photons, to keep them on its curved surfaces",
    )
    _add_iterations(parser)
    _add_common(parser)


def _add_scene(parser: argparse.ArgumentParser) -> None:
    names = gallery.names()
    parser.add_argument("scene", choices=names, metavar="SCENE", help=", ".join(names))


def _add_output(parser: argparse.ArgumentParser, metavar: str) -> None:
    parser.add_argument("-o", "--output", type=Path, required=True, metavar=metavar)


def _add_emission(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--photons", type=_positive, default=1_000_000, metavar="N", help="emitted (%(default)s)"
    )
    parser.add_argument("--seed", type=_whole, default=0, metavar="N", help="of the photons")


def _add_iterations(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--iterations",
        type=_whole,
        nargs=2,
        default=(7, 7),
        metavar=("CONSTRAINED", "COLLAPSED"),
        help="of relaxation (7 7)",
    )


def _add_common(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--threads", type=_positive, metavar="N", help="default: every core; results are the same"
    )
    parser.add_argument("--quiet", action="store_true", help="print nothing but errors")


def _whole(text: str) -> int:
    """Return a whole number of at least 0; 2e6 and 2_000_000 are fine."""
    try:
        number = int(text)
    except ValueError:
        number = _integral(text)
    if number < 0:
        raise argparse.ArgumentTypeError(f"should be a whole number, but is {text!r}")
    return number


def _integral(text: str) -> int:
    """Return the integer that a number like 2e6 stands for, -1 if it stands for none."""
    try:
        number = float(text)
    except ValueError:
        return -1
    return int(number) if number.is_integer() else -1


def _positive(text: str) -> int:
    number = _whole(text)
    if number < 1:
        raise argparse.ArgumentTypeError(f"should be at least 1, but is {text!r}")
    return number
