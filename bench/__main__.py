"""Comparisons by one command each; run from the root of a checkout.

python -m bench                   compare with peers; the tables of the README, JSON and a plot
python -m bench table1            SJ13's Table I beside the paper's own figures
python -m bench memory            bytes a photon takes in each stage
python -m bench figure7           SJ13's Fig. 7: λ₂ of uniform photons, and the constraint
python -m bench progressive       how progressive photon mapping converges, against known maps
python -m bench shapes            SSO08's Fig. 4: shapes in twelve ways, as a picture and as figures
python -m bench equal-error       SSO08's Table 1: photons for the error of diffusion
python -m bench frequency         frequency-driven beside progressive photon mapping, on `reflector`
python -m bench methods           errors and times of every method on the same photons
python -m bench refinements       refinements of standard estimates beside relaxations
python -m bench first-discs       progressive photon mapping by how small its discs start
"""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path

from bench.speed import machine, memory, peers, plot, simd
from bench.speed import side_by_side as compare
from bench.speed.report import Report
from bench.speed.timing import keep_memory
from bench.studies import (
    equal_error,
    figure7,
    first_discs,
    frequency,
    methods,
    progressive,
    refinements,
    shapes,
    table1,
)
from photonrelax.evaluation import reference


def numbers(text: str) -> list[int]:
    return [int(float(number)) for number in text.split(",")]


def parsed(arguments: list[str]) -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        prog="python -m bench",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    commands = parser.add_subparsers(dest="command", required=True)
    added = {
        "compare": _compare,
        "table1": _table1,
        "figure7": _figure7,
        "memory": _memory,
        "methods": _methods,
        "progressive": _progressive,
        "shapes": _shapes,
        "equal-error": _equal_error,
        "frequency": _frequency,
        "refinements": lambda parser: None,
        "first-discs": lambda parser: None,
    }
    for name, add in added.items():
        add(commands.add_parser(name))
    # Run by `compare` in a process of its own.
    internal = commands.add_parser("simd")
    for name in ("n", "n_threads", "rounds"):
        internal.add_argument(name, type=int)
    stage = commands.add_parser("stage")
    stage.add_argument("name")
    stage.add_argument("n", type=int)
    stage.add_argument("folder", type=Path)
    # Without a command, compare.
    named = arguments and (arguments[0] in commands.choices or arguments[0] in ("-h", "--help"))
    return parser.parse_args(arguments if named else ["compare", *arguments])


def _compare(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--photons", type=float, help="of the tables, default 863e3")
    parser.add_argument("--sweep", type=numbers, help="of the plot, default 1e5,863e3,4e6")
    parser.add_argument("--threads", type=numbers, default=[1, 2], help="default 1,2")
    parser.add_argument("--rounds", type=int, default=5, help="default 5")
    parser.add_argument("--clock", choices=("wall", "cpu"), default="wall")
    parser.add_argument("--quick", action="store_true", help="few photons: does it run?")
    parser.add_argument("--out", type=Path, default=Path("build/bench"), help="folder for results")


def _table1(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--emitted", type=float, default=20e6, help="default 20e6")
    parser.add_argument("--stored", type=float, default=863e3, help="of the second column")
    parser.add_argument("--methods", action="store_true", help="all five columns of the paper")
    parser.add_argument("--passes", type=int, default=50, help="of progressive, default 50")
    parser.add_argument("--threads", type=int, help="default all")
    parser.add_argument("--quick", action="store_true", help="few photons: does it run?")


def _memory(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--photons", type=numbers, default=[1_000_000, 4_000_000])
    parser.add_argument("--whole", type=float, help="so many photons through all stages, say 20e6")


def _frequency(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--photons", type=numbers, default=[1_000_000, 2_000_000, 6_000_000])
    parser.add_argument("--seeds", type=int, default=3, help="default 3")
    parser.add_argument("--passes", type=int, default=64, help="default 64")


def _progressive(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--passes", type=int, default=1024, help="default 1024")
    parser.add_argument("--photons", type=float, default=20e3, help="in each pass, default 20e3")


def _methods(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--photons", type=numbers, default=[100_000, 1_000_000])
    parser.add_argument("--scenes", nargs="+", default=methods.SCENES, metavar="SCENE")
    parser.add_argument("--pixels", type=int, default=256, help="default 256")
    effort = methods.REFERENCES
    parser.add_argument(
        "--passes", type=int, default=effort.passes, help="of references, default 200"
    )
    parser.add_argument("--reference-photons", type=float, default=effort.photons, help="in each")
    parser.add_argument("--out", type=Path, default=methods.FOLDER)


def _figure7(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--sets", type=float, default=figure7.SETS, help="default 100000")
    parser.add_argument("--out", type=Path, default=Path("build/bench/figure7.svg"))


def _shapes(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--seeds", type=int, default=shapes.SEEDS, help="photon maps, default 8")
    parser.add_argument("--out", type=Path, default=Path("build/bench/shapes.png"))


def _equal_error(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--scenes", nargs="+", default=tuple(equal_error.PAPER), metavar="SCENE")
    parser.add_argument("--sampler", choices=("random", "halton"), default="random")


def run_shapes(options: argparse.Namespace) -> None:
    """Save the pictures and print the tables."""
    shapes.save(options.out)
    print(f"saved in {options.out}", file=sys.stderr)
    print(shapes.markdown(options.seeds))


def run_table1(options: argparse.Namespace) -> None:
    """Print our column beside the paper's, or all columns."""
    stored, emitted = (2e4, 2e5) if options.quick else (options.stored, options.emitted)
    if options.methods:
        print(table1.every_method(int(stored), options.passes, options.threads))
    else:
        print(table1.markdown(int(emitted), int(stored), options.threads))


def run_figure7(options: argparse.Namespace) -> None:
    """Print the table and save the plot."""
    found = figure7.second_eigenvalues(int(options.sets))
    print(figure7.markdown(found))
    options.out.parent.mkdir(parents=True, exist_ok=True)
    figure7.save(found, options.out)
    print(f"saved in {options.out}", file=sys.stderr)


def run_compare(options: argparse.Namespace) -> None:
    """Measure, print the tables, save them with the plot and all times."""
    n = int(options.photons or (2e4 if options.quick else 863e3))
    sweep = options.sweep or ([5_000, n] if options.quick else [100_000, n, 4_000_000])
    rounds = 1 if options.quick else options.rounds
    for line in peers.missing().values():
        print(line, file=sys.stderr)
    keep_memory()
    report = Report(n, rounds, machine.description(), clock=options.clock)
    options.out.mkdir(parents=True, exist_ok=True)
    for task in compare.fill(report, sweep, options.threads, pixels=60 if options.quick else 600):
        _save(report, options.out)
        print(f"... {task}", file=sys.stderr, flush=True)
    _save(report, options.out)
    print(report.markdown())
    try:
        plot.save(report.sweep, options.out / "time.svg")
    except ImportError:
        print("no plot: pip install '.[bench]'", file=sys.stderr)
    print(f"saved in {options.out}: tables.md, results.json, time.svg", file=sys.stderr)


def _save(report: Report, folder: Path) -> None:
    (folder / "results.json").write_text(json.dumps(report.to_dict(), indent=1))
    (folder / "tables.md").write_text(report.markdown())


def main(arguments: list[str]) -> None:
    options = parsed(arguments)
    if options.command == "compare":
        run_compare(options)
    elif options.command == "table1":
        run_table1(options)
    elif options.command == "memory":
        print(memory.markdown(options.photons))
        if options.whole:
            print(memory.whole(int(options.whole)))
    elif options.command == "figure7":
        run_figure7(options)
    elif options.command == "progressive":
        print(progressive.markdown(options.passes, int(options.photons)))
    elif options.command == "frequency":
        print(frequency.markdown(options.photons, n_seeds=options.seeds, passes=options.passes))
    elif options.command == "methods":
        matrix = methods.Matrix(
            photons=tuple(options.photons),
            scenes=tuple(options.scenes),
            pixels=options.pixels,
            effort=reference.ReferenceSettings(options.passes, int(options.reference_photons)),
            folder=options.out,
        )
        print(methods.markdown(matrix))
    elif options.command == "refinements":
        print(refinements.markdown(refinements.Study()))
    elif options.command == "first-discs":
        print(first_discs.markdown())
        print(first_discs.dealt())
    elif options.command == "shapes":
        run_shapes(options)
    elif options.command == "equal-error":
        print(equal_error.markdown(options.scenes, options.sampler))
    elif options.command == "simd":
        simd.main(options.n, options.n_threads, options.rounds)
    else:
        memory.stage(options.name, options.n, options.folder)


if __name__ == "__main__":
    main(sys.argv[1:])
