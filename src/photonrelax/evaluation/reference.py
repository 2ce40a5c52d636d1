"""Reference images, read or computed, and the errors of images against them.

A computed reference is the mean of two runs of stochastic progressive photon mapping with
independent photons; its pixels are means over their areas.
Half of the difference of the runs is its noise. Its bias comes from the width of the discs that
photons are gathered in: each run is repeated with the same photons and discs of twice the initial
width. Where the bias is proportional to the width, as at edges, it equals the change from the
narrow to the wide discs. (In smooth light it is proportional to the square of the width, and the
change is three times the bias.)
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from concurrent.futures import Executor
from dataclasses import asdict, dataclass
from glob import escape
from hashlib import blake2b
from pathlib import Path
from typing import Any

import numpy as np

from .._util import validation
from .._util.progress import Progress, prefixed
from .._util.text import encodable
from .._util.validation import Floats, check_seed
from .._version import __version__
from ..estimation.progressive import ProgressiveSettings
from ..imaging import metrics
from ..imaging.image import Image, read_exr, srgb
from ..imaging.metrics import Errors
from ..rendering.checkpoint import check_checkpoint
from ..rendering.layers import total_radiance, with_radiance
from ..rendering.passes import pass_seed
from ..rendering.progressive_render import Checkpoints, render_progressive
from ..scene.digest import scene_digest
from ..scene.scene import Scene
from ..transport.emission import MAX_PHOTONS
from ..transport.trace import check_photons_fit
from .analytic_pixels import AnalyticPixels
from .request import ComparisonRequest

# Keys of the metadata of references.
ABOUT, COST = "photonrelax.reference", "photonrelax.reference_cost"
UNCERTAINTY = "photonrelax.reference_doubt"
_KEY = "photonrelax.reference_of"
# Discs of twice the width hold four times as many photons.
_WIDE = 4
_LAYERS = ("radiance", "caustic")


@dataclass(frozen=True)
class ReferenceSettings:
    """Number of photons and passes of a computed reference.

    Attributes
    ----------
    passes : int
        In both runs together; rounded up to an even number.
    photons : int
        In each pass, independent of the number of photons that are compared.
    k : int
        The initial radius of a disc is just short of the k-th nearest photon of the first pass.
    seed : int
        Of the runs; their photons differ from those compared for every seed of these.
    """

    passes: int = 50
    photons: int = 1_000_000
    k: int = 4
    seed: int = 0

    def __post_init__(self) -> None:
        validation.count(self.passes, "passes", high=validation.MAX_REPEATS)
        validation.count(self.photons, "photons", high=MAX_PHOTONS)
        validation.count(self.k, "k", low=2, high=validation.MAX_NEIGHBOURS // _WIDE)
        check_seed(self.seed)

    @property
    def passes_per_run(self) -> int:
        """Passes of each of the two runs."""
        return (self.passes + 1) // 2


@dataclass(frozen=True)
class Uncertainty:
    """Relative L1 and L2 of the noise and the bias of a reference."""

    noise_l1: float
    noise_l2: float
    bias_l1: float
    bias_l2: float

    def text(self) -> str:
        """The figures as a phrase."""
        return (
            f"its own noise {self.noise_l1:.1%} (L1), {self.noise_l2:.1%} (L2), "
            f"its bias about {self.bias_l1:.1%}, {self.bias_l2:.1%}"
        )


class Reference:
    """A reference image, and analytic pixels, to measure images of the same view against.

    Parameters
    ----------
    image : Image
        With ``radiance``; ``caustic`` is taken as the difference to direct light if it is missing.
    fixed : dict
        Layers of the same view that do not depend on photons.
    exposure : float
        Display values are those of radiance times 2^exposure.
    analytic : AnalyticPixels, optional
        Caustic that is known analytically.

    Attributes
    ----------
    image : Image
        As given.
    clipped : float
        Share of the pixels that exceed the range of a display, where SSIM and FLIP see nothing.
    analytic_share : float
        Share of the pixels that are known analytically.
    analytic_errors : dict
        `errors_where_analytic` of the reference itself.
    """

    def __init__(
        self,
        image: Image,
        fixed: dict[str, Floats],
        exposure: float,
        analytic: AnalyticPixels | None = None,
    ) -> None:
        self.image = image
        self._fixed = fixed
        self._radiance = np.asarray(image.layers["radiance"])
        self._caustic = np.asarray(
            image.layers.get("caustic", self._radiance - total_radiance(fixed))
        )
        self._scale = 2.0**exposure
        self._displayed = srgb(self._scale * self._radiance)
        self._analytic = analytic
        self.clipped = float((self._scale * self._radiance > 1.0).any(axis=2).mean())
        self.analytic_share = 0.0 if analytic is None else float(analytic.where.mean())
        self.analytic_errors = self.errors_where_analytic(self._caustic)

    @property
    def description(self) -> str:
        """Origin of the reference, as text."""
        return self.image.metadata.get(ABOUT, "a given image")

    @property
    def cost(self) -> dict[str, Any]:
        """Photons ``emitted`` and ``stored``, and ``seconds`` of a computed reference."""
        return _cost_of(self.image)

    def measure(self, caustic: Floats) -> tuple[Image, Errors]:
        """Image of a caustic with its difference from the reference, and its errors."""
        layers = with_radiance({"caustic": caustic, **self._fixed})
        radiance = layers["radiance"]
        displayed = srgb(self._scale * radiance)
        flip = metrics.flip_map(displayed, self._displayed)
        errors = Errors(
            relative_l1=metrics.relative_l1(caustic, self._caustic),
            relative_l2=metrics.relative_l2(caustic, self._caustic),
            energy_bias=metrics.energy_bias(caustic, self._caustic),
            ssim=metrics.ssim(displayed, self._displayed),
            flip=float(flip.mean()),
        )
        maps = {"difference": radiance - self._radiance, "flip": flip}
        return Image({**layers, **maps}), errors

    def errors_where_analytic(self, caustic: Floats) -> dict[str, float]:
        """Relative L1, L2 and energy bias over the analytic pixels; empty without such."""
        analytic = self._analytic
        if analytic is None or not analytic.where.any():
            return {}
        found, exact = (layer[analytic.where][np.newaxis] for layer in (caustic, analytic.caustic))
        return {
            "relative_l1": metrics.relative_l1(found, exact),
            "relative_l2": metrics.relative_l2(found, exact),
            "energy_bias": metrics.energy_bias(found, exact),
        }


# --- checks ---------------------------------------------------------------------------------------


def check_reference(image: Image, request: ComparisonRequest) -> None:
    """Raise ValueError if a reference does not show the requested view, or is black."""
    if "radiance" not in image.layers:
        raise ValueError(
            f"the reference should have channels R, G and B, but has {sorted(image.layers)}"
        )
    for name in {"radiance", "caustic"} & image.layers.keys():
        _check_layer(name, np.asarray(image.layers[name]), request.subject.size)
    _cost_of(image)


def _cost_of(image: Image) -> dict[str, Any]:
    """Cost in the metadata of a reference; empty for an image of another origin."""
    text = image.metadata.get(COST, "{}")
    try:
        cost = json.loads(text)
        numbers = [cost["emitted"], cost["stored"], cost["seconds"] or 0.0] if cost != {} else []
    except (ValueError, TypeError, LookupError, RecursionError):
        cost, numbers = None, []
    if cost is None or not all(type(number) in (int, float) for number in numbers):
        raise ValueError(
            f"the reference should have emitted, stored and seconds as JSON in {COST}, "
            f"but has {text[:60]!r}"
        )
    return dict(cost)


def _check_layer(name: str, layer: Floats, size: tuple[int, int]) -> None:
    width, height = size
    if layer.shape[:2] != (height, width):
        found = " x ".join(map(str, layer.shape[1::-1]))
        raise ValueError(
            f"the reference should have {width} x {height} pixels as the images have, "
            f"but has {found}"
        )
    if layer.shape[2:] != (3,):
        raise ValueError(f"the reference should have three channels of {name}, but has one")
    if not np.isfinite(layer).all():
        n = int((~np.isfinite(layer)).any(axis=2).sum())
        raise ValueError(f"the reference should be finite, but {n:,} pixels of {name} are not")
    if not layer.any():
        raise ValueError(f"the reference should not be black, but its {name} is")


def check_cached(path: Path) -> None:
    """Raise ValueError if a file exists that is not a reference computed by this module."""
    if not path.exists():
        return
    try:
        own = _KEY in read_exr(path).metadata
    except ValueError:
        own = False
    if not own:
        raise ValueError(
            f"{path} should be a reference that was computed here, which would be replaced, but is "
            "not: move it away, or give it with --reference"
        )


def check_computable(path: Path, request: ComparisonRequest, settings: ReferenceSettings) -> None:
    """Raise an error, before the work, if no reference can be computed and cached at a path.

    Raises
    ------
    ValueError
        As `check_cached`, or if the state of an interrupted run is damaged.
    MemoryError
        If the photons of a pass surely do not fit in memory.
    """
    check_cached(path)
    if path.exists() and read_exr(path).metadata.get(_KEY) == _key(request, settings):
        read_reference(path, request)
    for state in _states(path, request, settings):
        check_checkpoint(state)
    check_photons_fit(_scene(request), settings.photons)


# --- references from files ------------------------------------------------------------------------


def read_reference(path: Path, request: ComparisonRequest) -> Image:
    """Read a reference from an EXR file of any program.

    Raises
    ------
    OSError, ValueError, MemoryError
        If it cannot be read, is damaged, or does not show the requested view.
    """
    image = read_exr(path)
    try:
        check_reference(image, request)
    except ValueError as error:
        raise ValueError(f"{path} is not a reference for this comparison: {error}") from None
    about = image.metadata.get(ABOUT)
    name = encodable(path.name)
    metadata = {ABOUT: f"{name}: {about}" if about else name}
    return Image(image.layers, {**image.metadata, **metadata})


def cached_reference(
    path: Path,
    request: ComparisonRequest,
    settings: ReferenceSettings | None = None,
    progress: Progress | None = None,
    executor: Executor | None = None,
) -> Image:
    """The exact image of the subject if it has one; otherwise the reference cached at a path.

    The reference is computed if there is none, or one of another scene, view or settings. While it
    is computed, the runs are saved beside it; an interrupted reference is resumed. An executor
    renders its passes, as in `photonrelax.render_progressive`.

    Raises
    ------
    ValueError
        If the file at the path is not a reference computed by this module.
    """
    exact = request.subject.exact(request.supersampling)
    if exact is not None:
        about = {ABOUT: "exact irradiance at the same points"}
        return Image({"radiance": exact, "caustic": exact}, about)
    settings = settings or ReferenceSettings()
    key = _key(request, settings)
    check_cached(path)
    cached = read_exr(path) if path.exists() else None
    if cached is None or cached.metadata.get(_KEY) != key:
        _computed(path, request, settings, progress, executor).write_exr(path)
        _remove_runs(path)
        # Read again: the float32 values of the file are what later comparisons get.
        cached = read_exr(path)
    return cached


# --- uncertainty ----------------------------------------------------------------------------------


def uncertainty_of(reference: Image) -> Uncertainty | None:
    """Uncertainty of a reference, None unless it was estimated."""
    text = reference.metadata.get(UNCERTAINTY)
    if text is None:
        return None
    try:
        return Uncertainty(**json.loads(text))
    except (ValueError, TypeError, RecursionError) as error:
        raise ValueError(f"{UNCERTAINTY} should be an uncertainty as JSON: {error}") from None


def estimate_uncertainty(narrow: list[Floats], wide: list[Floats]) -> Uncertainty:
    """Estimate the uncertainty of the mean of two runs.

    Parameters
    ----------
    narrow : two (height, width, 3)
        The caustics of the runs.
    wide : two (height, width, 3)
        The same with discs of twice the initial width.
    """
    mean = 0.5 * (narrow[0] + narrow[1])
    noise = 0.5 * (narrow[0] - narrow[1])
    one, other = (b - a for a, b in zip(narrow, wide, strict=True))
    # The noise of the runs is independent: what their changes have in common is bias.
    l1 = 0.5 * (one * np.sign(other) + other * np.sign(one)).sum()
    square = (one * other).sum()
    total, norm = np.abs(mean).sum(), np.linalg.norm(mean)
    return Uncertainty(
        float(np.abs(noise).sum() / total),
        float(np.linalg.norm(noise) / norm),
        float(max(l1, 0.0) / total),
        float(np.sqrt(max(square, 0.0)) / norm),
    )


# --- computed references --------------------------------------------------------------------------


def _computed(
    path: Path,
    request: ComparisonRequest,
    settings: ReferenceSettings,
    progress: Progress | None,
    executor: Executor | None,
) -> Image:
    """Reference by progressive photon mapping, at the hit points of the compared images."""
    resumed = any(path.parent.glob(_run_pattern(path)))
    runs = dict(_runs(path, request, settings, progress, executor))
    narrow, wide = ([runs[k, half] for half in range(2)] for k in (settings.k, _WIDE * settings.k))
    layers = {
        name: 0.5 * sum(np.asarray(image.layers[name]) for image in narrow) for name in _LAYERS
    }
    uncertainty = estimate_uncertainty(_caustics(narrow), _caustics(wide))
    cost = _cost(narrow, settings, resumed)
    metadata = {
        ABOUT: _description(settings, cost["stored"], uncertainty),
        COST: json.dumps(cost),
        UNCERTAINTY: json.dumps(asdict(uncertainty)),
        _KEY: _key(request, settings),
    }
    return Image(layers, {**narrow[0].metadata, **metadata})


def _cost(runs: list[Image], settings: ReferenceSettings, resumed: bool) -> dict[str, Any]:
    """Photons and seconds of the runs; the seconds of a resumed run are unknown."""
    stages = [image.stats["stages"]["passes"] for image in runs]
    return {
        "emitted": 2 * settings.passes_per_run * settings.photons,
        "stored": sum(stage["stored"] for stage in stages),
        "seconds": None if resumed else sum(stage["seconds"] for stage in stages),
    }


def _description(settings: ReferenceSettings, n_stored: int, uncertainty: Uncertainty) -> str:
    return (
        f"progressive photon mapping, two runs of {settings.passes_per_run:,} passes of "
        f"{settings.photons:,} photons ({n_stored:,} absorbed), discs of "
        f"{settings.k} photons at first; {uncertainty.text()}"
    )


def _runs(
    path: Path,
    request: ComparisonRequest,
    settings: ReferenceSettings,
    progress: Progress | None,
    executor: Executor | None,
) -> Iterator[tuple[tuple[int, int], Image]]:
    """Images of the runs by k and half; an interrupted run is resumed."""
    cases = [(k, half) for k in (settings.k, _WIDE * settings.k) for half in range(2)]
    states = _states(path, request, settings)
    for number, ((k, half), state) in enumerate(zip(cases, states, strict=True)):
        image = render_progressive(
            _scene(request),
            n_passes=settings.passes_per_run,
            photons_per_pass=settings.photons,
            seed=pass_seed(settings.seed, half),
            settings=ProgressiveSettings(k=k),
            supersampling=request.supersampling,
            # Samples are anywhere in their pixel, which so is the mean over it.
            stochastic=True,
            max_depth=request.max_depth,
            # Only caustics are compared.
            n_global=0,
            checkpoints=Checkpoints(state),
            n_threads=request.n_threads,
            progress=prefixed(progress, f"reference, run {number + 1} of {len(cases)}"),
            executor=executor,
        )
        yield (k, half), image


def _states(path: Path, request: ComparisonRequest, settings: ReferenceSettings) -> list[Path]:
    """Files of the four runs of a reference, which need not exist."""
    identity = blake2b(_key(request, settings).encode(), digest_size=8).hexdigest()
    return [path.with_name(f".{path.stem}.{identity}.{number}.npz") for number in range(4)]


def _caustics(images: list[Image]) -> list[Floats]:
    return [np.asarray(image.layers["caustic"]) for image in images]


def _run_pattern(path: Path) -> str:
    return f".{escape(path.stem)}.{'[0-9a-f]' * 16}.[0-3].npz"


def _remove_runs(path: Path) -> None:
    for state in path.parent.glob(_run_pattern(path)):
        state.unlink()


def _key(request: ComparisonRequest, settings: ReferenceSettings) -> str:
    """All that a reference depends on, as JSON."""
    depends_on = {
        "scene": scene_digest(_scene(request)),
        "stochastic": True,
        "supersampling": request.supersampling,
        "max_depth": request.max_depth,
        **asdict(settings),
        "passes": settings.passes_per_run,
        "version": __version__,
    }
    return json.dumps(depends_on)


def _scene(request: ComparisonRequest) -> Scene:
    scene = request.subject.scene
    assert scene is not None, "a subject without an exact image has a scene"
    return scene
