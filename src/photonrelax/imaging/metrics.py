"""How far pictures are from a reference: errors of radiance, and of what is seen on a display."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from types import ModuleType
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from .._util.validation import Floats, float_array

# As in Wang et al. 2004: a Gaussian of 1.5 pixels, cut off at 3.5 deviations.
_SSIM_SIGMA = 1.5
SSIM_WINDOW = 11


@dataclass(frozen=True)
class Errors:
    """Errors of a picture against a reference.

    Attributes
    ----------
    relative_l1, relative_l2 : float
        Sum of absolute differences over that of the reference; root of the sum of squared
        differences over that of the reference. 0 is best.
    energy_bias : float
        Sum of the picture over that of the reference, less 1.
    ssim : float
        Mean structural similarity on a display (Wang et al. 2004); 1 is best.
    flip : float
        Mean FLIP on a display (Andersson et al. 2020): how much a viewer who flips between the
        two sees change, in [0, 1].
    """

    relative_l1: float
    relative_l2: float
    energy_bias: float
    ssim: float
    flip: float

    def to_dict(self) -> dict[str, Any]:
        """Return the errors by name."""
        return asdict(self)


def relative_l1(image: ArrayLike, reference: ArrayLike) -> float:
    """Return Σ|image − reference| / Σ|reference|, over pixels and channels.

    Parameters
    ----------
    image, reference : (height, width, 3)
        Linear values of one unit.

    Raises
    ------
    TypeError, ValueError
        If shapes differ, values are not finite or the reference is black.
    """
    values, truth = _pair(image, reference)
    return float(np.abs(values - truth).sum() / _not_black(np.abs(truth).sum()))


def relative_l2(image: ArrayLike, reference: ArrayLike) -> float:
    """Return √Σ(image − reference)² / √Σreference²; arguments as in `relative_l1`."""
    values, truth = _pair(image, reference)
    return float(np.linalg.norm(values - truth) / _not_black(float(np.linalg.norm(truth))))


def energy_bias(image: ArrayLike, reference: ArrayLike) -> float:
    """Return Σimage / Σreference − 1; arguments as in `relative_l1`."""
    values, truth = _pair(image, reference)
    return float(values.sum() / _not_black(truth.sum()) - 1.0)


def ssim(image: ArrayLike, reference: ArrayLike) -> float:
    """Return the mean structural similarity of two pictures as displayed.

    Gaussian weights of 1.5 pixels, each channel by itself (Wang et al. 2004, Eq. 13).

    Parameters
    ----------
    image, reference : (height, width, 3)
        Display values in [0, 1] (`photonrelax.imaging.image.srgb`), at least 11 pixels each way.

    Raises
    ------
    TypeError, ValueError
        If shapes differ or are too small, or values are not in [0, 1].
    ImportError
        If scikit-image is not installed.
    """
    values, truth = _displayed(image, reference)
    if min(values.shape[:2]) < SSIM_WINDOW:
        raise ValueError(
            f"pictures should have at least {SSIM_WINDOW} x {SSIM_WINDOW} pixels for SSIM, "
            f"but have {values.shape[1]} x {values.shape[0]}"
        )
    return float(
        _scikit_image_metrics().structural_similarity(
            truth,
            values,
            data_range=1.0,
            channel_axis=2,
            gaussian_weights=True,
            sigma=_SSIM_SIGMA,
            use_sample_covariance=False,
        )
    )


def flip_map(image: ArrayLike, reference: ArrayLike) -> Floats:
    """Return LDR-FLIP (height, width) in [0, 1] of two pictures as displayed.

    Seen from where a degree holds 67 pixels, FLIP's default; FLIP as one number is the mean.

    Parameters
    ----------
    image, reference : (height, width, 3)
        Display values in [0, 1] (`photonrelax.imaging.image.srgb`).

    Raises
    ------
    TypeError, ValueError
        If shapes differ or values are not in [0, 1].
    ImportError
        If flip-evaluator is not installed.
    """
    values, truth = (a.astype(np.float32) for a in _displayed(image, reference))
    found, _, _ = _flip_evaluator().evaluate(
        truth, values, "LDR", inputsRGB=True, applyMagma=False, computeMeanError=False
    )
    return np.asarray(found, dtype=np.float64).reshape(truth.shape[:2])


def check_installed() -> None:
    """Raise ImportError, saying what to install, unless `ssim` and `flip_map` can be computed."""
    _scikit_image_metrics()
    _flip_evaluator()


def _scikit_image_metrics() -> ModuleType:
    try:
        from skimage import metrics
    except ImportError:
        raise _missing("scikit-image") from None
    return metrics


def _flip_evaluator() -> ModuleType:
    try:
        import flip_evaluator
    except ImportError:
        raise _missing("flip-evaluator") from None
    return flip_evaluator


def _missing(package: str) -> ImportError:
    return ImportError(
        f"comparing pictures needs {package}: pip install 'photonrelax[compare]' brings it"
    )


def _pair(image: ArrayLike, reference: ArrayLike) -> tuple[Floats, Floats]:
    truth = float_array(reference, "reference", (None, None, 3))
    return float_array(image, "image", truth.shape), truth


def _displayed(image: ArrayLike, reference: ArrayLike) -> tuple[Floats, Floats]:
    for name, values in zip(("image", "reference"), pair := _pair(image, reference), strict=True):
        if values.size and not (values.min() >= 0.0 and values.max() <= 1.0):
            raise ValueError(
                f"{name} should hold display values in [0, 1], but holds "
                f"{values.min():g} to {values.max():g}"
            )
    return pair


def _not_black(total: float) -> float:
    if not total > 0.0:
        raise ValueError("reference should not be black: errors relative to it have no meaning")
    return total
