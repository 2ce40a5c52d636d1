"""Commands: from arguments by settings and stages to files and printed reports."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from time import perf_counter
from typing import TYPE_CHECKING, Any, TypeVar

import photonrelax as pr

from .. import gallery
from .._util.files import (
    check_distinct,
    first_bytes,
    json_text,
    output_path,
    whole_file,
    write_json,
)
from .animate import animate
from .arguments import (
    PHOTONS,
    PHOTONS_PER_PASS,
    REFERENCE_PASSES,
    REFERENCE_PHOTONS,
    SAMPLER,
    STDOUT,
    SUPERSAMPLING,
    parser,
)
from .casters import axis_point, complete_options, gather_radius, map_size, unit_of
from .interrupts import Interrupts
from .parts import photons_given, relax_in_blocks, trace_in_parts
from .progress_bar import ProgressBars
from .scenes import scene_of
from .streams import complain, escaping_streams, write_lines
from .tradeoff import tradeoff
from .workers import executor_of, print_traceback

# Import lazily, so that Ctrl-C during an import reaches `main`.
if TYPE_CHECKING:
    from concurrent.futures import Executor

    from ..estimation.field import Field
    from ..estimation.methods import Settings
    from ..evaluation import ComparisonRequest
    from ..evaluation.reference import ReferenceSettings
    from ..io.objects import Finding
    from ..rendering.object_map import ObjectMap

_MAGIC_EXR, _MAGIC_NPZ = b"v/1\x01", b"PK\x03\x04"
_EXPECTED = (ValueError, TypeError, OSError, ImportError, MemoryError)
Result = TypeVar("Result")


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line and return its exit code.

    0 for success, 1 for an error or a scene that `check` finds wrong, 2 for wrong usage (raised as
    SystemExit); 130 for Ctrl-C, 143 for SIGTERM and 129 for SIGHUP.
    """
    options = argparse.Namespace()
    with escaping_streams(), Interrupts() as interrupts:
        try:
            options = parser(_COMMANDS).parse_args(arguments)
            code: int | None = options.command(options, interrupts)
        except KeyboardInterrupt:
            return _interrupted(interrupts)
        except Exception as error:
            # An interrupted import can raise any exception.
            if interrupts.received:
                return _interrupted(interrupts)
            if not isinstance(error, _EXPECTED):
                raise
            complain(f"error: {str(error) or 'out of memory'}")
            if getattr(options, "traceback", False):
                print_traceback(error)
            return 1
    return code or 0


def _interrupted(interrupts: Interrupts) -> int:
    complain(interrupts.reason)
    return interrupts.exit_code


# --- commands ---------------------------------------------------------------------------------


def _render(options: argparse.Namespace, interrupts: Interrupts) -> None:
    _check_render_options(options)
    output = output_path(options.output, ".exr")
    preview = output_path(output.with_suffix(".png"))
    stats = output_path(options.stats) if isinstance(options.stats, Path) else None
    check_distinct(
        {
            "the image": output,
            "the preview": preview,
            "--stats": stats,
            "--photon-map": options.photon_map,
            "--state": options.state,
        }
    )

    in_passes = (options.passes, options.minutes) != (None, None)
    image = (_render_passes if in_passes else _render_once)(options, interrupts)
    with ExitStack() as files:
        # All files are replaced together, when the last is complete.
        _place(files, image, options)
        if stats is not None:
            write_json(_partial(files, stats), image.stats)
        interrupts.check()
    from .reports import light_layers, reached_line, stage_table

    if options.stats == STDOUT:
        write_lines(json_text(image.stats))
    modelled = f"modelled: {', '.join(light_layers(image))}"
    table = stage_table(image.stats["stages"])
    reached = [reached_line(image.stats["error"])] if "error" in image.stats else []
    _report(options, modelled, table, *reached, f"wrote {output} and {preview}")


def _check_render_options(options: argparse.Namespace) -> None:
    """End with wrong usage if options of photons and passes contradict each other."""
    from ..estimation.methods import PASSES_METHOD

    emission = (options.photons, options.seed, options.sampler)
    if options.photon_map is not None and (options.error, options.seconds) != (None, None):
        options.wrong_usage("--error and --seconds emit photons: leave out --photon-map")
    if options.photon_map is not None and emission != (None, None, None):
        options.wrong_usage(
            "--photon-map has its photons already: leave out --photons, --seed and --sampler"
        )
    passes = (options.passes, options.minutes)
    goal = (options.preset, options.error, options.seconds)
    others = (options.state, options.interval, options.stochastic)
    if passes == (None, None):
        if others != (None, None, False):
            options.wrong_usage("--state, --interval and --stochastic need --passes or --minutes")
    elif goal != (None, None, None):
        options.wrong_usage(
            "--passes and --minutes say how long passes go on: leave out --preset, --error and "
            "--seconds"
        )
    elif options.method != PASSES_METHOD:
        options.wrong_usage(f"--passes and --minutes need --method {PASSES_METHOD}")
    elif options.photon_map is not None:
        options.wrong_usage("every pass emits its photons: leave out --photon-map")
    elif (options.components, options.final_gather) != (None, 0):
        options.wrong_usage(
            "passes are of all light, and indirect light is estimated: leave out --components "
            "and --final-gather"
        )
    elif options.crop is not None:
        options.wrong_usage("passes are of whole images: leave out --crop")
    elif options.sampler == "random":
        options.wrong_usage("passes are of Halton photons: leave out --sampler")
    elif any(each[:2] == ("progressive", "n_passes") for each in options.set or ()):
        options.wrong_usage("progressive.n_passes splits a photon map: set --passes instead")


def _render_passes(options: argparse.Namespace, interrupts: Interrupts) -> pr.Image:
    from ..rendering.view import resized
    from .settings import settings_from_options

    settings = settings_from_options(options, (options.method,), ("gather", "progressive"))

    def write(image: pr.Image) -> None:
        with ExitStack() as files:
            _place(files, image, options)

    scene = resized(scene_of(options.scene, options), options.width, options.height)
    with ProgressBars(options.quiet, interrupts) as bars, executor_of(options) as executor:
        return pr.render_progressive(
            scene,
            n_passes=options.passes,
            seconds=None if options.minutes is None else 60.0 * options.minutes,
            photons_per_pass=options.photons or PHOTONS_PER_PASS,
            seed=options.seed or 0,
            settings=settings.of("progressive"),
            supersampling=options.supersampling or SUPERSAMPLING,
            max_depth=options.max_depth,
            light_samples=options.light_samples,
            n_global=options.n_global,
            indirect=_indirect_settings(options),
            stochastic=options.stochastic,
            checkpoints=pr.Checkpoints(options.state, options.interval or 60.0, write),
            n_threads=options.threads,
            progress=bars,
            executor=executor,
        )


def _render_once(options: argparse.Namespace, interrupts: Interrupts) -> pr.Image:
    from ..rendering.view import resized
    from .render_arguments import chosen_method, render_arguments

    photons = None if options.photon_map is None else pr.PhotonMap.load(options.photon_map)
    scene = resized(scene_of(options.scene, options), options.width, options.height)
    method = chosen_method(options, scene)
    with ProgressBars(options.quiet, interrupts) as bars, executor_of(options) as executor:
        return pr.render(
            scene,
            max_depth=options.max_depth,
            crop=options.crop,
            light_samples=options.light_samples,
            indirect=_indirect_settings(options),
            photons=photons,
            executor=executor,
            **render_arguments(options, method, bars),
        )


def _indirect_settings(options: argparse.Namespace) -> pr.GatherSettings | None:
    return None if options.indirect_k is None else pr.GatherSettings(k=options.indirect_k)


def _plan(options: argparse.Namespace, interrupts: Interrupts) -> None:
    from ..rendering.cost import estimate_costs
    from ..rendering.simplifications import simplifications
    from .reports import cost_table, plan_table, simplification_table

    scene = scene_of(options.scene, options)
    found = pr.plan(
        scene,
        n_emitted=_photons(options),
        n_global=options.n_global,
        components=options.components,
        n_threads=options.threads,
    )
    costs = estimate_costs(scene, found, options.threads)
    left_out = simplification_table(simplifications(scene))
    write_lines(plan_table(found), "", left_out, "", cost_table(costs))


def _trace(options: argparse.Namespace, interrupts: Interrupts) -> None:
    from .reports import stage_table

    if options.chunk is not None:
        trace_in_parts(options, interrupts)
        return
    output = output_path(options.output, ".npz")
    scene = scene_of(options.scene, options)
    with ProgressBars(options.quiet, interrupts) as bars, executor_of(options) as executor:
        photons, seconds = _timed(
            lambda: pr.trace_photons(
                scene,
                _photons(options),
                seed=options.seed or 0,
                sampler=options.sampler or SAMPLER,
                frequency_share=options.frequency_share,
                n_threads=options.threads,
                progress=bars,
                executor=executor,
            )
        )
    photons.save(output)
    counts = {"emitted": _photons(options), "stored": len(photons)}
    stages = {"trace": {"seconds": seconds, **counts}}
    _report(options, stage_table(stages), f"wrote {output}")


def _relax(options: argparse.Namespace, interrupts: Interrupts) -> None:
    from ..estimation.methods import MethodInput, Settings, method_named, relaxed_photons
    from .reports import stage_table

    if options.photon_map.is_dir():
        relax_in_blocks(options, interrupts)
        return
    if options.block is not None:
        options.wrong_usage("--block is of photons in parts: leave it out")
    if (options.workers, options.scheduler) != (None, None):
        options.wrong_usage("workers share the blocks of photons in parts: leave them out")
    output = output_path(options.output, ".npz")
    photons = pr.PhotonMap.load(options.photon_map)
    scene = None if options.scene is None else scene_of(options.scene, options)
    settings = Settings()
    if options.iterations is not None:
        default = method_named(options.method).default("relax")
        settings = Settings(relax=replace(default, n_iterations=tuple(options.iterations)))
    with ProgressBars(options.quiet, interrupts) as bars:
        inputs = MethodInput(photons, settings, scene, options.threads, bars)
        relaxed = relaxed_photons(options.method, inputs)
    relaxed.photons.save(output)
    stages: dict[str, dict[str, Any]] = {
        stage: {"seconds": seconds, "photons": len(photons)}
        for stage, seconds in relaxed.seconds.items()
    }
    iterations = sum(relaxed.used["relax"]["n_iterations"])
    stages["relax"] = {"seconds": relaxed.seconds["relax"], "iterations": iterations}
    _report(options, stage_table(stages), f"wrote {output}")


def _compare(options: argparse.Namespace, interrupts: Interrupts) -> None:
    from ..evaluation import reference, run_methods
    from ..evaluation.report import folder
    from ..imaging import metrics

    _check_reference(options)
    images = {f"the image {name}": options.output / name for name in folder.image_names()}
    check_distinct({"--reference": options.reference, **images})
    metrics.check_installed()
    request = _comparison_request(options)
    image = None
    if options.reference is not None:
        image = reference.read_reference(options.reference, request)
    folder.prepare_folder(options.output, request.methods)
    settings = _reference_settings(options)
    if _computes_reference(options):
        reference.check_computable(options.output / folder.REFERENCE, request, settings)
    with ProgressBars(options.quiet, interrupts) as bars:
        runs = run_methods(request, progress=bars)
        # A reference may take long: it is computed when little else can fail.
        path = options.output / folder.REFERENCE
        image = image or reference.cached_reference(path, request, settings, bars)
        comparison = runs.measure(image)
    table = folder.write(comparison, options.output)
    _report(options, table.text(), f"wrote {options.output / folder.PAGE}")


def _check_reference(options: argparse.Namespace) -> None:
    """End with wrong usage if options of a computed reference are given where none is."""
    if _computes_reference(options):
        return
    given = f"the irradiance of {options.scene} is exact"
    if options.reference is not None:
        given = "--reference gives one"
    for name in ("passes", "photons"):
        if getattr(options, f"reference_{name}") is not None:
            options.wrong_usage(
                f"--reference-{name} is of a reference that is computed, but {given}: leave it out"
            )


def _computes_reference(options: argparse.Namespace) -> bool:
    return options.reference is None and options.scene in gallery.names()


def _comparison_request(options: argparse.Namespace) -> ComparisonRequest:
    from ..evaluation import COMPARED_METHODS, ComparisonRequest, gallery_subject
    from .settings import settings_from_options

    methods = tuple(options.methods or COMPARED_METHODS)
    return ComparisonRequest(
        subject=gallery_subject(options.scene, options.width, options.height),
        methods=methods,
        n_emitted=_photons(options),
        seed=options.seed or 0,
        sampler=options.sampler or SAMPLER,
        settings=settings_from_options(options, methods),
        supersampling=options.supersampling or SUPERSAMPLING,
        exposure=options.exposure,
        n_threads=options.threads,
    )


def _reference_settings(options: argparse.Namespace) -> ReferenceSettings:
    from ..evaluation.reference import ReferenceSettings

    return ReferenceSettings(
        options.reference_passes or REFERENCE_PASSES,
        options.reference_photons or REFERENCE_PHOTONS,
    )


def _irradiance(options: argparse.Namespace, interrupts: Interrupts) -> None:
    from ..evaluation import irradiance_plot
    from .reports import encircled_table, reached_line

    complete_options(options)
    output = output_path(options.output, ".exr")
    preview = output_path(output.with_suffix(".png"))
    plot = None if options.plot is None else output_path(options.plot, ".png")
    check_distinct({"the map": output, "the preview": preview, "--plot": plot})
    if plot is not None:
        irradiance_plot.check_installed()
    scene = scene_of(options.scene, options)
    size = map_size(options, scene)
    _check_map_goal(options, size)
    _check_map_photons(options)
    with ExitStack() as files:
        executor = files.enter_context(executor_of(options))
        found, image = _object_map(options, interrupts, scene, size, executor)
        _place(files, image, options)
        if plot is not None:
            irradiance_plot.write_plot(
                _partial(files, plot),
                found.irradiance,
                found.grid,
                f"{options.scene}, {options.on}",
            )
        interrupts.check()
    texts = [f"wrote {output} and {preview}" + ("" if plot is None else f" and {plot}")]
    if options.encircled is not None:
        axis = axis_point(options, scene)
        texts.insert(0, encircled_table(found, options.encircled, unit_of(options), axis))
    if "error" in image.stats:
        texts.insert(0, reached_line(image.stats["error"]))
    _report(options, *texts)


def _check_map_photons(options: argparse.Namespace) -> None:
    """End with wrong usage if options of photons that are traced are given with those of a file."""
    emission = (options.photons, options.seed, options.sampler, options.error, options.seconds)
    if options.photon_map is not None and emission != 5 * (None,):
        options.wrong_usage(
            "--photon-map has its photons already: leave out --photons, --seed, --sampler, "
            "--error and --seconds"
        )


def _check_map_goal(options: argparse.Namespace, size: float | None) -> None:
    """End with wrong usage if maps of several photons cannot be compared."""
    from ..estimation.methods import METHODS

    if (options.error, options.seconds) == (None, None):
        return
    if size is not None:
        options.wrong_usage(
            "--error and --seconds need maps of one place, and --size and files of a mesh alone "
            "follow the light: leave them out"
        )
    if not METHODS[options.method].needs_photons:
        options.wrong_usage("--error and --seconds add photons: take another --method")


def _object_map(
    options: argparse.Namespace,
    interrupts: Interrupts,
    scene: pr.Scene,
    size: float | None,
    executor: Executor | None,
) -> tuple[ObjectMap, pr.Image]:
    """Map of an object, the last of several with --error or --seconds, and the image to write."""
    from ..rendering.budget import check_map_fits
    from ..rendering.error_target import Goal, render_to_goal
    from ..rendering.object_map import ObjectMap
    from .settings import settings_from_options

    found: list[ObjectMap] = []
    settings = settings_from_options(options, (options.method,))
    n_rays = settings.of("envelope").n_rays_certain

    def once(n_emitted: int, seed: int) -> pr.Image:
        n_traced = n_emitted if options.photon_map is None else 0
        check_map_fits(scene, n_traced, options.texels, options.memory, n_rays=n_rays)
        emission = n_emitted, seed
        radius = gather_radius(options, size)
        field, photons = _field_of_scene(
            *(options, interrupts, scene, emission), radius=radius, executor=executor
        )
        place = scene, options.on, options.texels
        found[:] = [ObjectMap(field, *place, size=size, photons=photons, executor=executor)]
        return found[0].image

    goal, seed = Goal(options.error, options.seconds), options.seed or 0
    if goal.is_given:
        image = render_to_goal(once, goal, _photons(options), seed, "irradiance")
    else:
        image = once(_photons(options), seed)
    return found[0], image


def _field_of_scene(
    options: argparse.Namespace,
    interrupts: Interrupts,
    scene: pr.Scene,
    emission: tuple[int, int],
    *,
    radius: float | None,
    executor: Executor | None,
) -> tuple[Field, pr.PhotonMap | pr.BlockedPhotons]:
    """Field on the object to map, of photons by their number and seed, or of those given.

    They are gathered within a radius unless settings have one.
    """
    from ..estimation.methods import MethodInput, method_named, prepare
    from ..rendering.object_map import blocks_of_surface, object_named, photons_of_surface

    settings, method = _map_settings(options, radius), method_named(options.method)
    object_id = object_named(scene, options.on)
    given = None if options.photon_map is None else photons_given(options.photon_map, scene)
    if isinstance(given, pr.BlockedPhotons):
        blocked = blocks_of_surface(given, scene, object_id)
        whole = {"method": options.method, "scene": scene, "n_threads": options.threads}
        return pr.irradiance_field(blocked, **whole, **settings.given), blocked
    with ProgressBars(options.quiet, interrupts) as bars:
        photons = given or pr.trace_photons(
            scene,
            emission[0],
            seed=emission[1],
            sampler=options.sampler or SAMPLER,
            frequency_share=method.frequency_share(settings),
            n_threads=options.threads,
            progress=bars,
            executor=executor,
        )
        there = photons_of_surface(photons, scene, object_id)
        inputs = MethodInput(there, settings, scene, options.threads, bars)
        return prepare(options.method, inputs), there


def _map_settings(options: argparse.Namespace, radius: float | None) -> Settings:
    """Settings of a map's stages, which gather within a radius unless options say otherwise."""
    from ..estimation.methods import Settings, method_named
    from .settings import settings_from_options

    settings = settings_from_options(options, (options.method,))
    method = method_named(options.method)
    if radius is not None and "gather" in method.stages:
        gather = settings.given.get("gather", method.default("gather"))
        if gather.gather_radius is None:
            gather = replace(gather, gather_radius=radius)
            settings = Settings(**settings.given | {"gather": gather})
    return settings


def _check(options: argparse.Namespace, interrupts: Interrupts) -> int:
    from ..io.check import findings_left
    from .scenes import findings_of

    repaired = None if options.repair is None else output_path(options.repair, ".glb")
    findings, scene = findings_of(options.scene, options)
    write_lines(*_told(findings))
    if repaired is not None and scene is not None:
        pr.save_scene(scene, repaired)
        findings = list(findings_left(findings, repaired))
        write_lines(f"wrote {repaired}, in which there are", *_told(findings))
    return int(any(each.spoils for each in findings))


def _told(findings: Sequence[Finding]) -> list[str]:
    """A line for each finding."""
    lines = [f"{'error' if each.spoils else 'note'}: {each.text}" for each in findings]
    return lines or ["no findings"]


def _list(options: argparse.Namespace, interrupts: Interrupts) -> None:
    names = (*gallery.names(), *gallery.pattern_names())
    width = max(map(len, names))
    write_lines(*(f"{name:{width}}  {gallery.about(name)}" for name in names))


def _info(options: argparse.Namespace, interrupts: Interrupts) -> None:
    from ..imaging.image import read_exr
    from .reports import describe_image, describe_photons

    magic = first_bytes(options.file, 4)
    if magic == _MAGIC_EXR:
        write_lines(describe_image(read_exr(options.file)))
    elif magic == _MAGIC_NPZ:
        write_lines(describe_photons(pr.PhotonMap.load(options.file)))
    else:
        raise ValueError(f"{options.file} should be an EXR file or a photon map, but is neither")


# --- reports ------------------------------------------------------------------------------------


def _report(options: argparse.Namespace, *texts: str) -> None:
    if not options.quiet:
        # Standard output may be taken by the statistics.
        write_lines(*texts, to_stderr=getattr(options, "stats", None) == STDOUT)


# --- scenes and files --------------------------------------------------------------------------


def _place(files: ExitStack, image: pr.Image, options: argparse.Namespace) -> None:
    """Write the image and its preview, which replace older files when `files` is closed."""
    image.write_exr(_partial(files, options.output))
    image.write_png(_partial(files, options.output.with_suffix(".png")), options.exposure)


def _partial(files: ExitStack, path: Path) -> Path:
    return files.enter_context(whole_file(path))


def _photons(options: argparse.Namespace) -> int:
    return options.photons or PHOTONS


def _timed(work: Callable[[], Result]) -> tuple[Result, float]:
    start = perf_counter()
    result = work()
    return result, perf_counter() - start


_COMMANDS = {
    "render": _render,
    "plan": _plan,
    "trace": _trace,
    "relax": _relax,
    "compare": _compare,
    "irradiance": _irradiance,
    "animate": animate,
    "tradeoff": tradeoff,
    "check": _check,
    "list": _list,
    "info": _info,
}
