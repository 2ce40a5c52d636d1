"""Plot of time over photon count, with the exponents of growth."""

from __future__ import annotations

from pathlib import Path
from statistics import median

import numpy as np

from bench.speed.timing import Timing

PANELS = {
    "all neighbours, K = 50": ("neighbours 50", ": neighbours 50"),
    "constrained neighbours, K = 50, 6-D": ("constrained 6", ": constrained 6"),
}
STAGES = ("build", "trace", "structure", "relaxation", "gather")


def save(sweep: dict[int, dict[str, Timing]], path: Path) -> None:
    """Plot the medians of a sweep over photon counts, on one thread."""
    from matplotlib.figure import Figure
    from matplotlib.ticker import NullFormatter

    figure = Figure(figsize=(13, 4.2), layout="constrained")
    panels = figure.subplots(1, 3)
    for axes, (title, (ours, ending)) in zip(panels, PANELS.items(), strict=False):
        theirs = dict.fromkeys(n for r in sweep.values() for n in r if n.endswith(ending))
        for name in (ours, *theirs):
            label = name.split(":")[0] if ":" in name else "photonrelax"
            _curve(axes, sweep, name, label)
        axes.set_title(title)
    for name in STAGES:
        _curve(panels[2], sweep, name, name)
    panels[2].set_title("stages of photonrelax")
    for axes in panels:
        axes.set(xscale="log", yscale="log", xlabel="photons", ylabel="s, one thread")
        axes.xaxis.set_minor_formatter(NullFormatter())
        axes.grid(which="major", alpha=0.3)
        axes.legend(fontsize="small")
    figure.savefig(path)


def _curve(axes, sweep: dict[int, dict[str, Timing]], name: str, label: str) -> None:
    counts = sorted(n for n, results in sweep.items() if name in results)
    seconds = [median(sweep[n][name].wall) for n in counts]
    if len(counts) > 1:
        label = f"{label}, slope {slope(counts, seconds):.2f}"
    width = 2.5 if label.startswith("photonrelax") else 1.2
    axes.plot(counts, seconds, marker="o", linewidth=width, label=label)


def slope(counts: list[int], seconds: list[float]) -> float:
    """Return the exponent of the growth of time."""
    return float(np.polyfit(np.log(counts), np.log(seconds), 1)[0])
