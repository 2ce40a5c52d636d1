"""SJ13's Fig. 2 and 3: two overlapping sets, constrained together and each by itself."""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

import photonrelax as pr
from bench.markdown import markdown_table
from photonrelax import gallery
from photonrelax.gallery.two_sets import SETS
from photonrelax.relaxation.gradient import detect_gradient
from photonrelax.relaxation.structure import Structure

Floats = NDArray[np.float64]

# Photons this near to the border of the disc are on it; those so far from it and from the other set
# are away from borders, m.
_BORDER, _AWAY = 0.01, 0.05
_TITLES = (
    *("constrained by the gradient (2e)", "relaxed so (2f)", "the sets (3a, b)"),
    *("constrained within the sets (3d)", "relaxed within the sets (3e)", "then together (3f)"),
)


class Sets:
    """Photons of `two-sets`, their structures, and the photons relaxed in three ways."""

    def __init__(self, n: int, n_iterations: int) -> None:
        photons = gallery.pattern("two-sets", n=n).photons
        self.photons = photons
        # Emitter coordinates of the disc's photons are their positions.
        self.of_disc = (photons.emitter_coords == photons.position[:, :2]).all(axis=1)
        self.gradient, self.structure = detect_gradient(photons), pr.detect_structure(photons)
        one, two = (0, 2 * n_iterations), (n_iterations, n_iterations)
        self.by_gradient = self._relaxed(self.gradient, one)
        self.within_sets = self._relaxed(self.structure, (n_iterations, 0))
        self.together = self._relaxed(self.structure, two)

    def _relaxed(self, structure: Structure, n_iterations: tuple[int, int]) -> pr.PhotonMap:
        settings = pr.RelaxSettings(n_iterations=n_iterations)
        return pr.relax(self.photons, structure, settings)

    def constraints(self, structure: Structure) -> tuple[float, float, float]:
        """Means over photons of the disc: on its border outside the other set and in it, and away.

        Those away from all borders should be free.
        """
        disc, other = SETS
        xy = self.photons.position[self.of_disc, :2]
        value = structure.constraint[self.of_disc]
        radius = np.linalg.norm(xy - disc.centre, axis=1)
        on_border, in_other = radius > disc.radius - _BORDER, other.holds(xy)
        to_other = cKDTree(self.photons.position[~self.of_disc, :2]).query(xy)[0]
        away = (radius < disc.radius - _AWAY) & (to_other > _AWAY)
        outside, inside = on_border & ~in_other, on_border & in_other
        return float(value[outside].mean()), float(value[inside].mean()), float(value[away].mean())

    def outside(self, photons: pr.PhotonMap) -> float:
        """Share of the photons that are outside of their sets."""
        xy = photons.position[:, :2]
        disc, other = (each.holds(xy) for each in SETS)
        return float(np.where(self.of_disc, ~disc, ~other).mean())

    def unevenness(self, photons: pr.PhotonMap) -> float:
        """Deviation of distances to the nearest photon over their mean, where both sets are."""
        xy = photons.position[:, :2]
        nearest = cKDTree(xy).query(xy, k=2)[0][:, 1]
        both = nearest[SETS[0].holds(xy) & SETS[1].holds(xy)]
        return float(both.std() / both.mean())


def rows_of_constraints(sets: Sets) -> Iterator[list[str]]:
    """Rows of the table of constraints."""
    for name, structure in (("by the gradient", sets.gradient), ("in the sets", sets.structure)):
        yield [name, *(f"{value:.2f}" for value in sets.constraints(structure))]


def rows_of_photons(sets: Sets) -> Iterator[list[str]]:
    """Rows of the table of relaxed photons."""
    for name, photons in (
        ("as emitted", sets.photons),
        ("relaxed by the gradient", sets.by_gradient),
        ("relaxed within the sets", sets.within_sets),
        ("then together", sets.together),
    ):
        yield [name, f"{sets.outside(photons):.1%}", f"{sets.unevenness(photons):.2f}"]


def save(sets: Sets, path: Path) -> None:
    """Plot the photons of both figures: grey to red by constraint, or by set."""
    from matplotlib.figure import Figure

    by_set = np.where(sets.of_disc, "tab:blue", "tab:orange")
    panels: tuple[tuple[pr.PhotonMap, Any], ...] = (
        *((sets.photons, _colours(sets.gradient)), (sets.by_gradient, "black")),
        *((sets.photons, by_set), (sets.photons, _colours(sets.structure))),
        *((sets.within_sets, "black"), (sets.together, "black")),
    )
    figure = Figure(figsize=(12, 8.4), layout="constrained")
    for axes, title, (photons, colour) in zip(
        figure.subplots(2, 3).flat, _TITLES, panels, strict=True
    ):
        x, y, _ = photons.position.T
        axes.scatter(x, y, s=2.5, c=colour, linewidths=0)
        axes.set(title=title, aspect="equal", xlim=(0.08, 0.9), ylim=(0.1, 0.9))
        axes.set_axis_off()
    figure.savefig(path, dpi=75)


def _colours(structure: Structure) -> Floats:
    """Colours (n, 3) of constraints: grey where free, red where held."""
    share = structure.constraint[:, np.newaxis]
    colours: Floats = (1.0 - share) * [0.75, 0.75, 0.75] + share * [0.9, 0.0, 0.0]
    return colours


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of the study."""
    parser.add_argument("-o", "--output", type=Path, default=Path("figure3.png"))
    parser.add_argument("--photons", type=int, default=8000, help="default 8000")
    parser.add_argument("--iterations", type=int, default=7, help="of each stage")


def run(options: argparse.Namespace) -> None:
    """Print the tables and write the picture."""
    sets = Sets(options.photons, options.iterations)
    titles = ["constraints", "border of the disc", "within the other set", "away from borders"]
    print(markdown_table(titles, rows_of_constraints(sets)), end="\n\n")
    titles = ["photons", "outside of their sets", "unevenness where both are"]
    print(markdown_table(titles, rows_of_photons(sets)))
    save(sets, options.output)
    print(f"\nwrote {options.output}")
