"""Gradients of flux density, from which the original relaxation takes its constraints.

Spencer & Jones 2009 constrain photons "in the direction of and proportional to the magnitude of
the gradient" of the flux density that the photons themselves suggest, times a gain that the user
sets, and relax them in space alone (SJ13 §1–3). How they estimate the gradient is not said there;
here it is reconstructed as the mean shift m of the photons around one, which points up the
gradient: the mean offset of the k nearest photons, in the tangent plane, over their radius r. In a
field E whose gradient is constant within r,

    m = r ∇E / (4 E),

if photons carry equal flux, as relaxing assumes anyway: every photon counts for one, whatever it
carries, and m is that of the density of photons. It has no unit, so that a gain suits maps of any
brightness. At a straight edge to darkness the neighbourhood is a half disc, whose centroid is
4/(3π) of its radius off; the constraint is one there:

    constraint = min(1, gain · 3π/4 · |m|).

Noise has a mean shift too and, as in the original, nothing is done about it; errors measured
for gains and numbers of photons are in docs/methods/relaxation.md.
"""

from __future__ import annotations

from dataclasses import dataclass

from .._ext.relaxation import structure as _structure
from .._ext.relaxation.structure import gradient_constraint
from .._util import validation
from .._util.frozen import set_field
from .._util.parallel import thread_count
from .._util.progress import Progress, Reporter
from ..photons.group_trees import group_tree
from ..photons.neighbourhoods import neighbour_groups
from ..photons.photon_map import PhotonMap
from .structure import Structure, empty_columns

__all__ = ["GradientSettings", "detect_gradient", "gradient_constraint"]


@dataclass(frozen=True)
class GradientSettings:
    """Settings of constraints along the gradient of the flux density.

    Attributes
    ----------
    k : int
        Photons in a neighbourhood, the photon itself among them.
    gain : float
        Factor of the constraint. One constrains photons fully at an edge to darkness; more keeps
        shallower steps too, and takes noise for them: independent photons of uniform light have a
        mean constraint of gain · 1.48/√k.
    """

    k: int = 50
    gain: float = 1.0

    def __post_init__(self) -> None:
        k = validation.count(self.k, "GradientSettings.k", low=4, high=validation.MAX_NEIGHBOURS)
        set_field(self, "k", k)
        set_field(self, "gain", validation.positive(self.gain, "GradientSettings.gain"))


def detect_gradient(
    photons: PhotonMap,
    settings: GradientSettings | None = None,
    *,
    n_threads: int | None = None,
    progress: Progress | None = None,
) -> Structure:
    """Constraint of each photon's moves along the gradient of flux density, and its direction.

    The gradient is that of the density of photons, the same where all carry equal flux.

    Parameters
    ----------
    photons : PhotonMap
        Photons, n of them; their emitter coordinates are ignored.
    settings : GradientSettings, optional
        Number of photons and gain.
    n_threads : int, optional
        Threads; all available by default. The result does not depend on it.
    progress : callable, optional
        Called as ``progress("structure", done, n)``.

    Returns
    -------
    Structure
        One row a photon: ``basis[:, 0]`` runs along the contours of flux density, ``basis[:, 1]``
        up its gradient. Without emitter ranges it serves iterations in space alone,
        ``RelaxSettings(n_iterations=(0, 14))``.
    """
    settings = settings or GradientSettings()
    threads = thread_count(n_threads)
    report = Reporter(progress, "structure", len(photons))
    found = empty_columns(len(photons))
    for group in neighbour_groups(photons, threads):
        place = photons.position, photons.normal
        of_group = group_tree(*place, group=group, n_threads=threads)
        inputs = _structure.StructureInputs(
            rows=of_group.rows, normal=photons.normal, range_radius=of_group.ranges, reach=None
        )
        k = 1 if group.at_rest else settings.k
        options = {"k": k, "gain": settings.gain, "n_threads": threads}
        for first, end in report.chunks(len(of_group.tree)):
            _structure.detect(of_group.tree.kernel, first, end, inputs, found, **options)
        of_group.repeat(*found.values())
        if of_group.n_merged:
            report.advance(of_group.n_merged)
    return Structure(**found, emitter_range=None)
