"""What errors are measured against: a picture given, one kept from before, or one computed.

One is computed by two runs of progressive photon mapping with photons of their own, whose mean it
is. Half of what they differ by is its noise. Its bias is what discs do that start small and still
have a size: each run is made once more, of the same photons, with discs twice as wide, and where
bias goes with the width, as at edges, it is what the wide ones differ by from the small. (In smooth
light it goes with the square: then that is three times the bias.)
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from glob import escape
from hashlib import blake2b
from pathlib import Path

import numpy as np

from .._util import validation
from .._util.progress import Progress, prefixed
from .._util.validation import Floats, check_seed
from .._version import __version__
from ..estimation.progressive import ProgressiveSettings
from ..imaging.image import Image, read_exr
from ..rendering.progressive_render import Checkpoints, pass_seed, render_progressive
from ..scene.digest import scene_digest
from ..scene.scene import Scene
from .comparison import COST
from .request import Plan
from .truth import ABOUT, check_reference

_KEY, _DOUBT = "photonrelax.reference_of", "photonrelax.reference_doubt"
# Discs twice as wide hold four times as many photons.
_WIDE = 4
_LAYERS = ("radiance", "caustic")


@dataclass(frozen=True)
class Effort:
    """What a computed reference takes.

    Attributes
    ----------
    passes : int
        In both runs together; an odd one more is done.
    photons : int
        In each pass, whatever the number compared.
    k : int
        Discs start just short of the k-th nearest photon of a first pass.
    seed : int
        Of the runs; their photons are others than those compared, whatever their seed.
    """

    passes: int = 50
    photons: int = 1_000_000
    k: int = 4
    seed: int = 0

    def __post_init__(self) -> None:
        for name, low in (("passes", 1), ("photons", 1), ("k", 2)):
            validation.count(getattr(self, name), name, low=low)
        check_seed(self.seed)

    @property
    def passes_each(self) -> int:
        """Passes of each of the two runs."""
        return (self.passes + 1) // 2


@dataclass(frozen=True)
class Doubt:
    """How far a reference may be off: relative L1 and L2 of its noise and of its bias."""

    noise_l1: float
    noise_l2: float
    bias_l1: float
    bias_l2: float

    def text(self) -> str:
        """Return the figures in words."""
        return (
            f"its own noise {self.noise_l1:.1%} (L1), {self.noise_l2:.1%} (L2), "
            f"its bias about {self.bias_l1:.1%}, {self.bias_l2:.1%}"
        )


def given(path: Path, plan: Plan) -> Image:
    """Read a reference from an EXR file that any program may have written.

    Raises
    ------
    FileNotFoundError, ValueError
        If there is none, or it does not show what is compared.
    """
    image = read_exr(path)
    check_reference(image, plan)
    about = image.metadata.get(ABOUT)
    told = {ABOUT: f"{path.name}: {about}" if about else path.name}
    return Image(image.layers, {**image.metadata, **told})


def kept(
    path: Path, plan: Plan, effort: Effort | None = None, progress: Progress | None = None
) -> Image:
    """Return the exact picture, where it is known, or the reference that is kept at a path.

    It is computed and kept if there is none, or one that is not of the same scene, view and effort.
    Until it is whole its runs are kept beside it, and gone on with if they were stopped.

    Raises
    ------
    ValueError
        If what is at the path is not a reference that was computed here.
    """
    exact = plan.subject.exact(plan.supersampling)
    if exact is not None:
        about = {ABOUT: "exact irradiance at the same points"}
        return Image({"radiance": exact, "caustic": exact}, about)
    effort = effort or Effort()
    key = _key(plan, effort)
    check_own(path)
    found = read_exr(path) if path.exists() else None
    if found is None or found.metadata.get(_KEY) != key:
        _computed(path, plan, effort, progress).write_exr(path)
        _remove_runs(path)
        # As it is kept: a later run measures the same.
        found = read_exr(path)
    return found


def check_own(path: Path) -> None:
    """Raise ValueError if a file is something else than a reference that was computed here."""
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


def doubt(reference: Image) -> Doubt | None:
    """Return how far a reference may be off, if it was estimated."""
    told = reference.metadata.get(_DOUBT)
    return None if told is None else Doubt(**json.loads(told))


def estimated_doubt(small: list[Floats], wide: list[Floats]) -> Doubt:
    """Return how far the mean of two runs may be off.

    Parameters
    ----------
    small : two (height, width, 3)
        The caustics of the runs.
    wide : two (height, width, 3)
        The same with discs twice as wide.
    """
    truth = 0.5 * (small[0] + small[1])
    noise = 0.5 * (small[0] - small[1])
    one, other = (b - a for a, b in zip(small, wide, strict=True))
    # Noise of one run has no part in the other's: what both say is bias.
    l1 = 0.5 * (one * np.sign(other) + other * np.sign(one)).sum()
    square = (one * other).sum()
    total, norm = np.abs(truth).sum(), np.linalg.norm(truth)
    return Doubt(
        float(np.abs(noise).sum() / total),
        float(np.linalg.norm(noise) / norm),
        float(max(l1, 0.0) / total),
        float(np.sqrt(max(square, 0.0)) / norm),
    )


def _computed(path: Path, plan: Plan, effort: Effort, progress: Progress | None) -> Image:
    """Return a reference by progressive photon mapping, at the hit points that are compared at."""
    fresh = not any(path.parent.glob(_runs_of(path)))
    runs = dict(_runs(path, plan, effort, progress))
    small, wide = ([runs[k, half] for half in range(2)] for k in (effort.k, _WIDE * effort.k))
    layers = {
        name: 0.5 * sum(np.asarray(image.layers[name]) for image in small) for name in _LAYERS
    }
    estimated = estimated_doubt(_caustics(small), _caustics(wide))
    stages = [image.stats["stages"]["passes"] for image in small]
    cost = {
        "emitted": 2 * effort.passes_each * effort.photons,
        "stored": sum(stage["stored"] for stage in stages),
        "seconds": sum(stage["seconds"] for stage in stages) if fresh else None,
    }
    about = (
        f"progressive photon mapping, two runs of {effort.passes_each:,} passes of "
        f"{effort.photons:,} photons ({cost['stored']:,} absorbed), discs of "
        f"{effort.k} photons at first; {estimated.text()}"
    )
    told = {
        ABOUT: about,
        COST: json.dumps(cost),
        _DOUBT: json.dumps(asdict(estimated)),
        _KEY: _key(plan, effort),
    }
    return Image(layers, {**small[0].metadata, **told})


def _runs(
    path: Path, plan: Plan, effort: Effort, progress: Progress | None
) -> Iterator[tuple[tuple[int, int], Image]]:
    """Yield the pictures of the runs by k and half; each goes on where it was stopped."""
    cases = [(k, half) for k in (effort.k, _WIDE * effort.k) for half in range(2)]
    identity = blake2b(_key(plan, effort).encode(), digest_size=8).hexdigest()
    for number, (k, half) in enumerate(cases):
        state = path.with_name(f".{path.stem}.{identity}.{number}.npz")
        image = render_progressive(
            _scene(plan),
            n_passes=effort.passes_each,
            photons_per_pass=effort.photons,
            seed=pass_seed(effort.seed, half),
            settings=ProgressiveSettings(k=k),
            supersampling=plan.supersampling,
            max_depth=plan.max_depth,
            checkpoints=Checkpoints(state),
            n_threads=plan.n_threads,
            progress=prefixed(progress, f"reference, run {number + 1} of {len(cases)}"),
        )
        yield (k, half), image


def _caustics(images: list[Image]) -> list[Floats]:
    return [np.asarray(image.layers["caustic"]) for image in images]


def _runs_of(path: Path) -> str:
    return f".{escape(path.stem)}.{'[0-9a-f]' * 16}.[0-3].npz"


def _remove_runs(path: Path) -> None:
    for state in path.parent.glob(_runs_of(path)):
        state.unlink()


def _key(plan: Plan, effort: Effort) -> str:
    """Return all that the reference depends on."""
    depends_on = {
        "scene": scene_digest(_scene(plan)),
        "supersampling": plan.supersampling,
        "max_depth": plan.max_depth,
        **asdict(effort),
        "passes": effort.passes_each,
        "version": __version__,
    }
    return json.dumps(depends_on)


def _scene(plan: Plan) -> Scene:
    scene = plan.subject.scene
    assert scene is not None, "what is not exact has a scene"
    return scene
