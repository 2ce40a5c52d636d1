"""What pictures are measured against."""

from __future__ import annotations

import numpy as np

from .._util.validation import Floats
from ..imaging import metrics
from ..imaging.image import Image, srgb
from ..imaging.metrics import Errors
from .analytic_pixels import Known
from .request import Plan

ABOUT = "photonrelax.reference"
"""Where the metadata of a reference say what it is."""


def check_reference(reference: Image, plan: Plan) -> None:
    """Raise ValueError if a reference does not show what is compared, or has no light."""
    if "radiance" not in reference.layers:
        raise ValueError(
            f"the reference should have channels R, G and B, but has {sorted(reference.layers)}"
        )
    width, height = plan.subject.size
    for name in {"radiance", "caustic"} & reference.layers.keys():
        layer = np.asarray(reference.layers[name])
        if layer.shape[:2] != (height, width):
            found = " x ".join(map(str, layer.shape[1::-1]))
            raise ValueError(
                f"the reference should have {width} x {height} pixels as the pictures have, "
                f"but has {found}"
            )
        if layer.shape[2:] != (3,):
            raise ValueError(f"the reference should have three channels of {name}, but has one")
        if not np.isfinite(layer).all():
            n = int((~np.isfinite(layer)).any(axis=2).sum())
            raise ValueError(f"the reference should be finite, but {n:,} pixels of {name} are not")
        if not layer.any():
            raise ValueError(f"the reference should not be black, but its {name} is")


class Truth:
    """The reference, ready to be measured against; and where light is known, that.

    Parameters
    ----------
    reference : Image
        See `compare`.
    fixed : dict
        Layers of the same view that need no photons; see `View`.
    exposure : float
        Pictures are shown times 2^exposure.
    known : Known, optional
        Light that is known without photons.

    Attributes
    ----------
    clipped : float
        Share of the reference's pixels that a display cuts off, where SSIM and FLIP see nothing.
    known_share : float
        Share of the pixels whose light is known.
    known_errors : dict
        Of the reference itself there; see `against_known`.
    """

    def __init__(
        self,
        reference: Image,
        fixed: dict[str, Floats],
        exposure: float,
        known: Known | None = None,
    ) -> None:
        self._fixed = fixed
        self._radiance = np.asarray(reference.layers["radiance"])
        self._caustic = np.asarray(
            reference.layers.get("caustic", self._radiance - fixed["direct"])
        )
        self._scale = 2.0**exposure
        self._shown = srgb(self._scale * self._radiance)
        self._known = known
        self.clipped = float((self._scale * self._radiance > 1.0).any(axis=2).mean())
        self.known_share = 0.0 if known is None else float(known.where.mean())
        self.known_errors = self.against_known(self._caustic)

    def measured(self, caustic: Floats) -> tuple[Image, Errors]:
        """Return the picture with its difference from the truth, and its errors."""
        radiance = caustic + self._fixed["direct"]
        shown = srgb(self._scale * radiance)
        flip = metrics.flip_map(shown, self._shown)
        errors = Errors(
            relative_l1=metrics.relative_l1(caustic, self._caustic),
            relative_l2=metrics.relative_l2(caustic, self._caustic),
            energy_bias=metrics.energy_bias(caustic, self._caustic),
            ssim=metrics.ssim(shown, self._shown),
            flip=float(flip.mean()),
        )
        made = {"difference": radiance - self._radiance, "flip": flip}
        return Image({"radiance": radiance, "caustic": caustic, **self._fixed, **made}), errors

    def against_known(self, caustic: Floats) -> dict[str, float]:
        """Return relative L1, L2 and energy bias over the pixels whose light is known, if any."""
        if self._known is None or not self._known.where.any():
            return {}
        found, exact = (
            layer[self._known.where][np.newaxis] for layer in (caustic, self._known.caustic)
        )
        return {
            "relative_l1": metrics.relative_l1(found, exact),
            "relative_l2": metrics.relative_l2(found, exact),
            "energy_bias": metrics.energy_bias(found, exact),
        }
