"""Passes of a progressive render, each by its number alone: in this process or in workers."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from .._util import validation
from .._util.validation import check_seed
from ..estimation.progressive import HitPointStatistics
from ..photons.photon_map import NothingStoredError, PhotonMap
from ..transport.trace import trace_photons
from .pass_statistics import PassHitPoints, PassSums
from .view import View


class PassPhotons(NamedTuple):
    """Photons of a pass, and why there are none."""

    photons: PhotonMap
    nothing: str | None = None


class PassFindings(NamedTuple):
    """Sums that a pass adds to the statistics, number of its photons, and why there are none."""

    sums: PassSums
    n_stored: int
    nothing: str | None


class PassTracer(NamedTuple):
    """Tracer of the photons of passes; `seed` is that of the run."""

    view: View
    photons_per_pass: int
    seed: int

    def trace(self, number: int) -> PassPhotons:
        """Photons of the pass of a number."""
        view = self.view
        try:
            photons = trace_photons(
                view.scene,
                self.photons_per_pass,
                seed=pass_seed(self.seed, number),
                n_threads=view.n_threads,
                caster=view.caster,
                sensors=False,
            )
        except NothingStoredError as nothing:
            return PassPhotons(nothing.photons, str(nothing))
        return PassPhotons(photons)

    def trace_lean(self, number: int) -> PassPhotons:
        """Photons of the pass of a number with no more than is gathered: less to send."""
        photons, nothing = self.trace(number)
        return PassPhotons(PhotonMap(photons.position, photons.normal, photons.flux), nothing)


class PassGatherer(NamedTuple):
    """Gatherer of passes where they are traced, whose radii are global."""

    tracer: PassTracer
    hit_points: PassHitPoints
    statistics: HitPointStatistics

    def gather(self, number: int) -> PassFindings:
        """Findings of the pass of a number, whatever others do."""
        photons, nothing = self.tracer.trace(number)
        radius = self.statistics.pass_radius(number)
        sums = self.hit_points.sums(photons, number, radius)
        return PassFindings(sums, len(photons), nothing)


def pass_seed(seed: int, number: int) -> int:
    """Seed of a pass: the first 64 bits of NumPy's ``SeedSequence((seed, number))``."""
    state = np.random.SeedSequence((check_seed(seed), validation.count(number, "number", low=0)))
    return int(state.generate_state(1, np.uint64)[0])
