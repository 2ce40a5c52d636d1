"""The command `animate`: frames of a scene that moves, each an EXR file and a PNG preview."""

from __future__ import annotations

import argparse
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING

from .. import gallery
from .._util.files import check_distinct, output_path, whole_file
from .interrupts import Interrupts
from .progress_bar import ProgressBars
from .scenes import built_in, is_file, scene_of
from .streams import write_lines
from .workers import executor_of

# Import lazily, so that Ctrl-C during an import reaches `main`.
if TYPE_CHECKING:
    from ..imaging.image import Image
    from ..rendering.animation import Animation, SceneAt
    from ..scene.scene import Scene


def animate(options: argparse.Namespace, interrupts: Interrupts) -> None:
    """Render the frames that are not there, and the movie of all."""
    paths = _frame_paths(options.output, options.frames)
    movie = None if options.movie is None else _movie_path(options.movie)
    check_distinct({"the first frame": paths[0].with_suffix(".png"), "--movie": movie})
    missing = [number for number, path in enumerate(paths) if not path.exists()]
    lines = []
    if missing:
        with ProgressBars(options.quiet, interrupts) as bars, executor_of(options) as executor:
            animation = _animation(options, bars, paths)
            images = animation.frames(missing, executor)
            for number, image in zip(missing, images, strict=True):
                interrupts.check()
                _write_frame(image, paths[number], options.exposure)
        lines = _reached_lines(animation)
    if movie is not None:
        _write_movie(paths, movie, options)
    if not options.quiet:
        there = len(paths) - len(missing)
        lines.append(f"wrote {len(missing)} frames to {options.output}; {there} were there already")
        write_lines(*lines)


def _animation(options: argparse.Namespace, bars: ProgressBars, paths: list[Path]) -> Animation:
    from ..rendering.animation import Animation
    from .render_arguments import chosen_method, render_arguments

    times = [options.start + number / options.fps for number in range(options.frames)]
    scene_at = _scene_at(options)
    method = chosen_method(options, scene_at(times[0]))
    animation = Animation(scene_at, times, **render_arguments(options, method, bars))
    if (options.error, options.seconds) != (None, None):
        n_emitted = _photons_there(paths)
        if n_emitted is not None:
            animation.fix_photons(n_emitted)
    return animation


def _photons_there(paths: list[Path]) -> int | None:
    """Photons of the first frame that is there, None if there is none or it has none."""
    from ..imaging.image import read_exr

    there = next((path for path in paths if path.exists()), None)
    if there is None:
        return None
    n_emitted = read_exr(there).metadata.get("photonrelax.photons_emitted")
    return None if n_emitted is None else int(n_emitted)


def _reached_lines(animation: Animation) -> list[str]:
    """The error of the first frame, if it was rendered to a goal."""
    from .reports import reached_line

    reached = animation.reached
    if reached is None:
        return []
    return [f"first frame: {reached_line(reached)}; {reached['photons_of_image']:,} photons each"]


def _scene_at(options: argparse.Namespace) -> SceneAt:
    from ..rendering.view import resized

    if is_file(options.scene):
        if Path(options.scene).suffix != ".py":
            raise ValueError(f"a scene that moves should be a script, but is {options.scene}")
        return lambda time: resized(
            scene_of(options.scene, options, time=time), options.width, options.height
        )
    if not gallery.moves(options.scene):
        moving = ", ".join(name for name in gallery.names() if gallery.moves(name))
        raise ValueError(f"{options.scene} does not move: it has no argument time, as {moving} has")

    def scene_at(time: float) -> Scene:
        return resized(built_in(options.scene, options, time=time), options.width, options.height)

    return scene_at


def _frame_paths(pattern: Path, n: int) -> list[Path]:
    """Paths of the frames, counted from zero by a place like %04d in the file's name."""
    try:
        paths = [output_path(pattern.with_name(pattern.name % number), ".exr") for number in (0, 1)]
    except (TypeError, ValueError):
        paths = []
    if len(set(paths)) < 2:
        raise ValueError(
            f"--output should have one place for numbers, as in %04d, but is {pattern}"
        )
    return [pattern.with_name(pattern.name % number) for number in range(n)]


def _movie_path(path: Path) -> Path:
    from ..imaging.image import check_movie

    check_movie(path)
    return output_path(path)


def _write_frame(image: Image, path: Path, exposure: float) -> None:
    with ExitStack() as files:
        image.write_exr(files.enter_context(whole_file(path)))
        image.write_png(files.enter_context(whole_file(path.with_suffix(".png"))), exposure)


def _write_movie(paths: list[Path], movie: Path, options: argparse.Namespace) -> None:
    from ..imaging.image import read_exr, write_movie

    pictures = [read_exr(path).display(options.exposure) for path in paths]
    write_movie(pictures, movie, options.fps)
