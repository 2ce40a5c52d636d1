"""Means over texels of envelopes, and of relaxed photons, by the time they take."""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path
from time import process_time

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter

import photonrelax as pr
from bench.arguments import numbers
from bench.markdown import markdown_table
from bench.studies import slopes
from bench.studies.pixel_means import Errors

# Texels beyond so many means are cut off in the clipped error, and those below a share of the mean
# are not asked whether their error is held.
_CLIP, _DARK = 5.0, 0.01
# Texels along the sides of squares that the noise of references is taken to be even over, and its
# deviations that are allowed for.
_EVEN, _DEVIATIONS = 7, 2.0


@dataclass(frozen=True)
class Study:
    """Scenes, rays of envelopes, photons emitted, and the references of `slopes`.

    Attributes
    ----------
    errors : tuple of float
        Shares of light that envelopes may misplace.
    fine : float
        That of the envelope which others are compared with.
    """

    scenes: tuple[str, ...] = ("ring", "ripples", "prism", "sphere", "water")
    errors: tuple[float, ...] = (0.05, 0.01)
    fine: float = 0.001
    photons: tuple[int, ...] = (300_000, 1_000_000)
    references: slopes.Study = field(default_factory=slopes.Study)


@dataclass(frozen=True)
class Found:
    """Means over texels and the seconds of tracing and preparation, and of the map.

    `told` is the error of the whole, `error` that of each texel, W/m².
    """

    name: str
    rays: str
    seconds: tuple[float, float]
    means: NDArray
    told: float = 0.0
    error: NDArray | None = None


@dataclass(frozen=True)
class Truth:
    """Counted means over texels and the deviations of their noise, and those of a fine envelope."""

    counted: NDArray
    noise: NDArray
    fine: NDArray

    @classmethod
    def of(cls, study: Study, subject: slopes.Subject) -> Truth:
        """Noise by the difference between the halves of the passes, over squares of texels."""
        difference = 0.5 * (subject.halves[0] - subject.halves[1])
        squares = uniform_filter(np.square(difference), _EVEN)
        noise = np.sqrt(np.maximum(squares, 0.0))
        fine = next(envelopes(replace(study, errors=(study.fine,)), subject))
        return cls(subject.halves.mean(axis=0), noise, fine.means)

    def held(self, found: Found) -> list[str]:
        """Texels whose error is held; estimates of all over the errors of all."""
        if found.error is None:
            return ["", "", ""]
        lit = self.counted > _DARK * self.counted.mean()
        held = [
            (np.abs(found.means - exact) <= found.error + allowed)[lit].mean()
            for exact, allowed in ((self.counted, _DEVIATIONS * self.noise), (self.fine, 0.0))
        ]
        told, misplaced = found.error.sum(), np.abs(found.means - self.fine).sum()
        ratio = f"{told / misplaced:.1f}" if misplaced > 0.0 else ""
        return [f"{held[0]:.3f}", f"{held[1]:.3f}", ratio]


def error_field(envelope: pr.Envelope, light: pr.Field) -> pr.Field:
    """Field of the error that is estimated, W/m²."""
    share, n = light.layers["envelope.error"], len(envelope)
    rest = envelope.rest
    if rest is not None:
        rest = rest.replace(flux=rest.flux * share[n:])
    misplaced = replace(envelope, flux=envelope.flux * share[:n], rest=rest)
    return pr.irradiance_field(misplaced, method="envelope")


def envelopes(study: Study, subject: slopes.Subject) -> Iterator[Found]:
    """Yield the map of each envelope."""
    side = subject.floor.side / study.references.texels
    for error in study.errors:
        started = process_time()
        envelope = pr.trace_envelope(subject.scene, error=error, footprint=side)
        light = pr.irradiance_field(envelope, method="envelope")
        traced = process_time()
        means = subject.floor.means(light)
        seconds = traced - started, process_time() - traced
        rays = f"{envelope.n_rays:,} / {envelope.n_segments:,}"
        misplaced = subject.floor.means(error_field(envelope, light))
        name = f"envelope, error {error:g}"
        yield Found(name, rays, seconds, means, envelope.error, misplaced)


def relaxed(study: Study, subject: slopes.Subject) -> Iterator[Found]:
    """Yield the map of each number of photons, by the default method."""
    for n in study.photons:
        started = process_time()
        photons = pr.trace_photons(subject.scene, n, caster=subject.caster)
        light = pr.irradiance_field(photons, scene=subject.scene, gather=pr.GatherSettings(k=8))
        traced = process_time()
        means = subject.floor.means(light)
        seconds = traced - started, process_time() - traced
        yield Found("mapped, k = 8", f"{n:,} photons", seconds, means)


def rows(study: Study) -> Iterator[list[str]]:
    """Yield the rows of the table."""
    for name in study.scenes:
        subject = slopes.Subject.of(study.references, name)
        truth, doubt = Truth.of(study, subject), subject.doubt
        exact = truth.counted
        yield [name, "reference", "", "", f"{doubt.rms:.3f} {doubt.l1:.4f}", *[""] * 5]
        for found in (*envelopes(study, subject), *relaxed(study, subject)):
            errors = Errors.of(found.means, exact)
            mean = exact.mean()
            cut = (np.minimum(each, _CLIP * mean) for each in (found.means, exact))
            clipped = np.abs(np.subtract(*cut)).mean() / mean
            yield [
                name,
                found.name,
                found.rays,
                f"{found.seconds[0]:.2f} + {found.seconds[1]:.2f}",
                f"{errors.rms:.3f} {errors.l1:.4f}",
                f"{clipped:.4f}",
                f"{found.told:.4f}" if found.told else "",
                *truth.held(found),
            ]


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the scenes, the errors and the numbers of photons, and the references."""
    default = Study()
    parser.add_argument("--scenes", default=",".join(default.scenes))
    parser.add_argument("--errors", default=",".join(map(str, default.errors)))
    parser.add_argument("--fine", type=float, default=default.fine)
    parser.add_argument("--photons", type=numbers, default=list(default.photons))
    references = default.references
    parser.add_argument("--reference-passes", type=int, default=references.reference_passes)
    parser.add_argument("--photons-per-pass", type=int, default=references.photons_per_pass)
    parser.add_argument("--cache", type=Path, help="folder that references are kept in")


def run(options: argparse.Namespace) -> None:
    """Print the table."""
    references = slopes.Study(
        reference_passes=options.reference_passes,
        photons_per_pass=options.photons_per_pass,
        cache=options.cache,
    )
    study = Study(
        tuple(options.scenes.split(",")),
        tuple(float(each) for each in options.errors.split(",")),
        options.fine,
        tuple(options.photons),
        references,
    )
    print(markdown(study))


def markdown(study: Study) -> str:
    """Table of the study."""
    titles = ["scene", "", "rays / segments", "seconds", "rms, L1", "L1, clipped", "told"]
    titles += ["held", "held, fine", "over fine"]
    references = study.references
    return (
        f"{markdown_table(titles, rows(study))}\n\nRoot mean square error over the mean and "
        f"relative L1 of means over {references.texels} x {references.texels} texels of the floor, "
        f"against {references.reference_passes} counted passes of "
        f"{references.photons_per_pass:,} photons, whose noise is in the rows of references; L1 "
        f"with texels cut off at {_CLIP:g} means; the error that the envelope tells; the share of "
        f"the texels above {_DARK:g} of the mean whose error the layer holds, with {_DEVIATIONS:g} "
        "deviations of the reference's noise, and without any against an envelope of error "
        f"{study.fine:g}; the sum of the layer over the L1 error against that. Processor seconds "
        "of tracing and preparation, and of the map.\n"
    )
