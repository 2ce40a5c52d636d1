"""Plot of an irradiance map: false colours with a scale, and a cross-section."""

from __future__ import annotations

import os

import numpy as np

from .._util.files import whole_file
from .._util.validation import Floats
from ..estimation.texels import TexelGrid


def check_installed() -> None:
    """Raise ImportError unless matplotlib is installed."""
    try:
        import matplotlib  # noqa: F401
    except ImportError as error:
        raise ImportError(
            "plots need matplotlib, which is not installed: pip install 'photonrelax[plot]'"
        ) from error


def write_plot(
    path: str | os.PathLike[str], irradiance: Floats, grid: TexelGrid, title: str
) -> None:
    """Write a PNG of a map (ny, nx, 3), mean of its channels, and its row of most light.

    Raises
    ------
    OSError
        If the file cannot be written.
    """
    from matplotlib.figure import Figure

    values = irradiance.mean(axis=2)
    width, height = float(np.linalg.norm(grid.u)), float(np.linalg.norm(grid.v))
    row = int(values.sum(axis=1).argmax())
    figure = Figure(figsize=(6, 8), layout="constrained")
    above, below = figure.subplots(2, 1, height_ratios=(2, 1))
    shown = above.imshow(values, extent=(0.0, width, height, 0.0), cmap="inferno")
    figure.colorbar(shown, ax=above, label="W/m²")
    at = (row + 0.5) / grid.shape[1] * height
    above.axhline(at, color="white", linewidth=0.5, linestyle="--")
    above.set(title=title, xlabel="m", ylabel="m")
    below.plot((np.arange(grid.shape[0]) + 0.5) / grid.shape[0] * width, values[row], linewidth=1)
    below.set(xlabel=f"m, at {at:.4g} m from the top", ylabel="W/m²", xlim=(0.0, width))
    with whole_file(path) as partial:
        figure.savefig(partial, format="png", dpi=120)
