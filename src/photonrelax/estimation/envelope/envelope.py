"""Envelopes: light laid down over the images of the emitters, sheet by sheet.

A caustic is the image of an emitter under a map from its coordinates to where light lands, one map
for each path signature. A chart of the coordinates is divided into triangles; each carries its
flux to its image, and images add up. Nothing is random, and no density is estimated. Light without
smooth images is that of photons. docs/methods/envelope.md has the derivation.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..._util import validation
from ..._util.frozen import set_field
from ..._util.parallel import thread_count
from ..._util.parcels import state_without_caches
from ..._util.validation import Floats
from ...photons.photon_map import PhotonMap
from ...spatial.box_tree import BoxTree
from ...transport.splitting import Signatures
from .charts import Chart
from .elements import luminances
from .sampling import envelope_photons

# Misplaced light, over all, unless asked for, and rays that reach about that.
_ERROR, _RAYS_OF_ERROR = 0.01, 40_000
# Share of the light of photons that lies elsewhere, from the errors of maps of relaxed photons.
NOISE = 0.1


@dataclass(frozen=True)
class EnvelopeSettings:
    """Limits of the division of elements, and the length that images are resolved to.

    Attributes
    ----------
    n_rays : int, optional
        Rays from emitters, at most; a million by default.
    error : float, optional
        Share of the light that may be misplaced; 0.01 unless rays or time are limited.
    seconds : float, optional
        Time, about: rays are traced in seven tenths of it, at the pace so far. Which elements are
        divided then depends on the machine.
    footprint : float, optional
        Length that images are resolved to, m: the side of a texel, say. By default that of the
        pixels of a render, or 1/400 of the extent of the light.
    n_photons : int, optional
        Photons to emit for light without images, at most; by default as many as for other methods,
        a million unless a render is told.
    """

    n_rays: int | None = None
    error: float | None = None
    seconds: float | None = None
    footprint: float | None = None
    n_photons: int | None = None

    def __post_init__(self) -> None:
        for name in ("n_rays", "n_photons"):
            if getattr(self, name) is not None:
                number = validation.count(getattr(self, name), f"EnvelopeSettings.{name}")
                set_field(self, name, number)
        for name in ("error", "seconds", "footprint"):
            if getattr(self, name) is not None:
                value = validation.positive(getattr(self, name), f"EnvelopeSettings.{name}")
                set_field(self, name, value)

    @property
    def misplaced(self) -> float:
        """Share of the light that may be misplaced."""
        if self.error is not None:
            return self.error
        return _ERROR if self.n_rays is None and self.seconds is None else 0.0

    @property
    def expected(self) -> float:
        """Share of the light that will about be misplaced, which falls with the rays."""
        n_rays = _RAYS_OF_ERROR if self.n_rays is None else max(self.n_rays, _RAYS_OF_ERROR)
        return self.error or _ERROR * _RAYS_OF_ERROR / n_rays

    @property
    def n_rays_certain(self) -> int:
        """Rays that are traced whatever the scene; 0 if an error or a time may end them before."""
        return self.n_rays or 0 if (self.error, self.seconds) == (None, None) else 0


class EnvelopeLedger(NamedTuple):
    """Flux (3,) of all emitters, W; `emitted` is the sum of the others.

    Attributes
    ----------
    emitted : (3,) float64
        Through the charts, and by emitters without one.
    images : (3,) float64
        Laid down over images.
    points : (3,) float64
        Laid down around points, as images jump, or as light that no image has was found first.
    photons : (3,) float64
        Of photons.
    lost : (3,) float64
        Absorbed or escaped, or of no sheet that was found.
    """

    emitted: Floats
    images: Floats
    points: Floats
    photons: Floats
    lost: Floats


@dataclass(frozen=True, eq=False)
class Envelope:
    """Images of all emitters of a scene as straight triangles, and photons of all other light.

    Attributes
    ----------
    position : (n, 3, 3) float64
        Corners, m.
    normal : (n, 3) float64
        Unit normals of the surfaces they lie on, on the side of the light.
    flux : (n, 3) float64
        W, even over each triangle.
    place : (n, 3, 2) float32
        Corners in the unit squares of their charts.
    sheet : (n,) uint64
        Path and surface of the light.
    chart : (n,) int32
        Rows of `charts`.
    misplaced : (n,) float64
        Estimated luminance of each that lies elsewhere by a footprint or more, W.
    charts : list of Chart
    objects : dict of int to int
        Surface of each sheet.
    surface_ids : (k,) int32
        Ids of the objects whose surfaces they are.
    rest : PhotonMap, optional
        Photons of sheets that have no images, and of emitters without a chart.
    ledger : EnvelopeLedger
    settings : EnvelopeSettings
        Those used.
    n_rays, n_segments : int
        Rays from emitters, and of all.
    n_elements : int
        Images of elements with six nodes each, that the triangles are pieces of.
    seconds : dict
        Time of each stage, s.
    """

    position: Floats
    normal: Floats
    flux: Floats
    place: NDArray[np.float32]
    sheet: Signatures
    misplaced: Floats
    chart: NDArray[np.int32]
    charts: list[Chart]
    objects: dict[int, int]
    surface_ids: NDArray[np.int32]
    rest: PhotonMap | None
    ledger: EnvelopeLedger
    settings: EnvelopeSettings
    n_rays: int
    n_segments: int
    n_elements: int
    seconds: dict[str, float]

    __getstate__ = state_without_caches

    def __len__(self) -> int:
        return len(self.flux)

    @property
    def error(self) -> float:
        """Estimated share of the light that is misplaced."""
        of_photons = 0.0 if self.rest is None else float(luminances(self.rest.flux).sum())
        total = float(luminances(self.flux).sum()) + of_photons
        return (float(self.misplaced.sum()) + NOISE * of_photons) / total if total else 0.0

    @cached_property
    def tree(self) -> BoxTree:
        """Boxes of the triangles."""
        return BoxTree(self.position.min(axis=1), self.position.max(axis=1))

    def photons(self, n: int, *, n_threads: int | None = None) -> PhotonMap:
        """Photons of the light, well spaced and with emitter coordinates.

        Parameters
        ----------
        n : int
            Number of photons. All have the same luminance, but for those of light without images,
            of which there are as many as that has, and no more than were traced.
        n_threads : int, optional
            Threads; all by default. The result does not depend on them.

        Returns
        -------
        PhotonMap
            Its flux is that of the envelope.

        Raises
        ------
        TypeError, ValueError
            If n is not an integer from 1 on.
        """
        return envelope_photons(self, n, thread_count(n_threads))
