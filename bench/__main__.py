"""Comparisons by one command each; run from the root of a checkout.

python -m bench                   compare with peers: tables, JSON and a plot
python -m bench versions          every stage compared with another build
python -m bench contention        every stage on several threads and on one, beside busy processes
python -m bench scaling           work on processes compared with the same in one process
python -m bench blocks            relaxing by blocks on disk compared with one piece in memory
python -m bench table1            SJ13's Table I compared with the paper's own figures
python -m bench memory            bytes a photon takes in each stage
python -m bench lamps             times and noise of a room with one lamp, and with many
python -m bench figure3           SJ13's Fig. 2 and 3: overlapping sets, constrained and relaxed
python -m bench figure7           SJ13's Fig. 7: λ₂ of uniform photons, and the constraint
python -m bench figure9           SJ13's Fig. 9: rings at three numbers of photons, and a reference
python -m bench progressive       convergence of progressive photon mapping to analytic irradiance
python -m bench shapes            SSO08's Fig. 4: shapes in twelve ways, as an image and as figures
python -m bench envelope          errors of envelopes and of relaxed photons, by time
python -m bench envelope-times    times of envelopes to an error over texels
python -m bench envelope-cost     time and memory of envelopes, by rays and triangles
python -m bench known-maps        errors of envelopes of scenes whose map is known, by rays
python -m bench equal-error       SSO08's Table 1: photons for the error of diffusion
python -m bench flicker           changes between frames of `pool`, over those of references
python -m bench frequency         frequency-driven and progressive photon mapping, on `reflector`
python -m bench methods           errors and times of every method on the same photons
python -m bench refinements       refinements of standard estimates compared with relaxations
python -m bench kernels           kernels of estimates at points, against analytic irradiance
python -m bench gallery-light     light on patches of gallery scenes, against counted particles
python -m bench initial-radius    progressive photon mapping by its initial radius
python -m bench pixel-means       errors of means over texels by photons, against counted photons
python -m bench error-times       errors of irradiance maps over the time they take
python -m bench resolution        errors by gaps, thicknesses and widths that float32 tells apart
python -m bench extremes          errors at extremes of sizes, densities, indices and cameras
python -m bench promises          true errors and times of renders that promise some
python -m bench fronts            times of methods by error, on many scenes
python -m bench presets           presets from the fronts of `photonrelax tradeoff`
python -m bench settings          errors over pixels by iterations, k and step of relaxation
python -m bench tessellation      changes of the caustic of `cognac` with twice the facets
python -m bench dispersion        noise of colour behind plates, by how light is dispersed
python -m bench emitters          light of two emitters whose photons push one another, or do not
python -m bench even-light        noise of even light, relaxed to the density its map prescribes
python -m bench slopes            light relaxed to the density its map prescribes, and to even one
"""

from __future__ import annotations

import argparse
import sys

from bench.speed import (
    block_run,
    blocks,
    contention,
    many_lamps,
    memory,
    memory_stage,
    scaling,
    side_by_side,
    simd,
    versions,
)
from bench.studies import (
    dispersion,
    emitters,
    envelope,
    envelope_cost,
    envelope_times,
    equal_error,
    error_times,
    even_light,
    extremes,
    figure3,
    figure7,
    figure9,
    flicker,
    frequency,
    fronts,
    gallery_light,
    initial_radius,
    kernels,
    known_maps,
    methods,
    pixel_means,
    presets,
    progressive,
    promises,
    refinements,
    resolution,
    settings,
    shapes,
    slopes,
    table1,
    tessellation,
)

_DEFAULT = "compare"
_COMMANDS = {
    _DEFAULT: side_by_side,
    "versions": versions,
    "contention": contention,
    "scaling": scaling,
    "blocks": blocks,
    "lamps": many_lamps,
    "table1": table1,
    "figure3": figure3,
    "figure7": figure7,
    "figure9": figure9,
    "memory": memory,
    "methods": methods,
    "progressive": progressive,
    "shapes": shapes,
    "equal-error": equal_error,
    "flicker": flicker,
    "frequency": frequency,
    "refinements": refinements,
    "initial-radius": initial_radius,
    "kernels": kernels,
    "gallery-light": gallery_light,
    "pixel-means": pixel_means,
    "error-times": error_times,
    "resolution": resolution,
    "envelope": envelope,
    "envelope-cost": envelope_cost,
    "envelope-times": envelope_times,
    "known-maps": known_maps,
    "dispersion": dispersion,
    "emitters": emitters,
    "even-light": even_light,
    "slopes": slopes,
    "tessellation": tessellation,
    "extremes": extremes,
    "fronts": fronts,
    "presets": presets,
    "settings": settings,
    "promises": promises,
    # The processes that `compare`, `memory` and `blocks` start.
    "simd": simd,
    "stage": memory_stage,
    "block-run": block_run,
}


def parsed(arguments: list[str]) -> argparse.Namespace:
    """Return options, `run` among them: the function of the command."""
    parser = argparse.ArgumentParser(
        prog="python -m bench",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    commands = parser.add_subparsers(dest="command", required=True)
    for name, command in _COMMANDS.items():
        added = commands.add_parser(name)
        command.add_arguments(added)
        added.set_defaults(run=command.run)
    named = arguments and (arguments[0] in commands.choices or arguments[0] in ("-h", "--help"))
    return parser.parse_args(arguments if named else [_DEFAULT, *arguments])


def main(arguments: list[str]) -> None:
    options = parsed(arguments)
    options.run(options)


if __name__ == "__main__":
    main(sys.argv[1:])
