"""SJ13's Fig. 7: distribution of λ₂ of uniform photons, and the constraint over λ₂."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import numpy as np
from scipy.stats import norm

from bench.markdown import markdown_table
from bench.speed.inputs import Floats
from photonrelax.relaxation import structure as st

K = 100
SETS = 100_000
# Spencer & Jones 2013, §4.3.2.
PAPER = {"mean": 0.2219, "deviation": 0.0188}


def second_eigenvalues(n_sets: int) -> Floats:
    """Return λ₂ of sets of K independent, uniform points in the unit disc."""
    rng = np.random.default_rng(0)
    radius, turn = np.sqrt(rng.random((n_sets, K))), 2 * np.pi * rng.random((n_sets, K))
    points = radius[..., np.newaxis] * np.stack([np.cos(turn), np.sin(turn)], axis=-1)
    return st.principal_components(points)[0][:, 1]


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--sets", type=float, default=SETS, help="default 100000")
    parser.add_argument("--out", type=Path, default=Path("build/bench/figure7.svg"))


def run(options: argparse.Namespace) -> None:
    """Print the table and save the plot."""
    found = second_eigenvalues(int(options.sets))
    print(markdown(found))
    options.out.parent.mkdir(parents=True, exist_ok=True)
    save(found, options.out)
    print(f"saved in {options.out}", file=sys.stderr)


def markdown(found: Floats) -> str:
    """Return a table of the paper's figures, the measured ones and the closed forms."""
    forms = {"mean": st.isotropic_mean(K), "deviation": st.isotropic_sd(K)}
    values = {"mean": found.mean(), "deviation": found.std()}
    table = markdown_table(
        [f"λ₂ of {len(found):,} sets of {K} uniform points", "SJ13", "measured", "photonrelax"],
        ([n, *(f"{each[n]:.4f}" for each in (PAPER, values, forms))] for n in PAPER),
    )
    skew = float((((found - found.mean()) / found.std()) ** 3).mean())
    apart = farthest_from_gaussian(found)
    note = (
        "A Gaussian of the same mean and deviation differs from the distribution by at most "
        f"{apart:.1%} of the sets; its skewness is {skew:+.2f}, a Gaussian's 0."
    )
    return f"{table}\n\n{note}\n"


def farthest_from_gaussian(found: Floats) -> float:
    """Return the largest distance of the cumulative distributions."""
    shares = (np.arange(len(found)) + 0.5) / len(found)
    expected = norm.cdf(np.sort(found), found.mean(), found.std())
    return float(np.abs(expected - shares).max())


def save(found: Floats, path: Path) -> None:
    """Plot both frames of the figure."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(10, 4), layout="constrained")
    left, right = figure.subplots(1, 2)
    x = np.linspace(found.min(), found.max(), 300)
    left.hist(found, bins=120, density=True, color="0.75")
    left.plot(x, norm.pdf(x, found.mean(), found.std()), color="tab:red")
    left.set(title="(a) uniform points", xlabel="λ₂", ylabel="density")
    x = np.linspace(0.0, 0.25, 501)
    free = [0.75 * np.pi * st.anisotropy_to_gradient(value) for value in x]
    constraint = [f * st.noise_attenuation(value, K) for f, value in zip(free, x, strict=True)]
    right.plot(x, free, color="tab:red", label="Eq. 2, times 3π/4")
    right.plot(x, constraint, color="black", label="with noise taken off (Eq. 6)")
    right.set(title="(b) constraint", xlabel="λ₂")
    right.legend()
    figure.savefig(path)
