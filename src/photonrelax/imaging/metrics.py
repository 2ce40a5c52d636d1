"""Image error metrics: of radiance, and of display values."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from types import ModuleType
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from .._util.validation import Floats, float_array

# Wang et al. 2004: a Gaussian of 1.5 pixels, truncated at 3.5 standard deviations.
_SSIM_SIGMA = 1.5
SSIM_WINDOW = 11


@dataclass(frozen=True)
class Errors:
    """Errors of an image against a reference.

    Attributes
    ----------
    relative_l1, relative_l2 : float
        L1 and L2 norm of the difference over that of the reference; 0 is best.
    energy_bias : float
        Sum of the image over that of the reference, minus 1.
    ssim : float
        Mean structural similarity of display values (Wang et al. 2004); 1 is best.
    flip : float
        Mean FLIP of display values (Andersson et al. 2020), in [0, 1]: the visible change when
        flipping between image and reference; 0 is best.
    """

    relative_l1: float
    relative_l2: float
    energy_bias: float
    ssim: float
    flip: float

    def to_dict(self) -> dict[str, Any]:
        """The errors by name."""
        return asdict(self)


def relative_l1(image: ArrayLike, reference: ArrayLike) -> float:
    """Σ|image − reference| / Σ|reference|, over pixels and channels.

    Parameters
    ----------
    image, reference : (height, width, 3)
        Linear values of the same unit.

    Raises
    ------
    TypeError, ValueError
        If shapes differ, values are not finite or the reference is black.
    """
    values, expected = _pair(image, reference)
    return float(np.abs(values - expected).sum() / _not_black(np.abs(expected).sum()))


def relative_l2(image: ArrayLike, reference: ArrayLike) -> float:
    """√Σ(image − reference)² / √Σreference²; arguments as in `relative_l1`."""
    values, expected = _pair(image, reference)
    return float(np.linalg.norm(values - expected) / _not_black(float(np.linalg.norm(expected))))


def energy_bias(image: ArrayLike, reference: ArrayLike) -> float:
    """Σimage / Σreference − 1; arguments as in `relative_l1`."""
    values, expected = _pair(image, reference)
    return float(values.sum() / _not_black(expected.sum()) - 1.0)


def ssim(image: ArrayLike, reference: ArrayLike) -> float:
    """Mean structural similarity (SSIM) of display values.

    With Gaussian weights of 1.5 pixels, of each channel (Wang et al. 2004, Eq. 13).

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
    values, expected = _displayed(image, reference)
    if min(values.shape[:2]) < SSIM_WINDOW:
        raise ValueError(
            f"images should have at least {SSIM_WINDOW} x {SSIM_WINDOW} pixels for SSIM, "
            f"but have {values.shape[1]} x {values.shape[0]}"
        )
    return float(
        _scikit_image_metrics().structural_similarity(
            expected,
            values,
            data_range=1.0,
            channel_axis=2,
            gaussian_weights=True,
            sigma=_SSIM_SIGMA,
            use_sample_covariance=False,
        )
    )


def flip_map(image: ArrayLike, reference: ArrayLike) -> Floats:
    """LDR-FLIP (height, width) of display values, in [0, 1].

    At 67 pixels per degree of view, FLIP's default; the mean is FLIP as one number.

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
    values, expected = (a.astype(np.float32) for a in _displayed(image, reference))
    found, _, _ = _flip_evaluator().evaluate(
        expected, values, "LDR", inputsRGB=True, applyMagma=False, computeMeanError=False
    )
    return np.asarray(found, dtype=np.float64).reshape(expected.shape[:2])


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
        f"comparing images needs {package}: pip install 'photonrelax[compare]' brings it"
    )


def _pair(image: ArrayLike, reference: ArrayLike) -> tuple[Floats, Floats]:
    expected = float_array(reference, "reference", (None, None, 3))
    return float_array(image, "image", expected.shape), expected


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
