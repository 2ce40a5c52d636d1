"""What errors are measured against: a picture given, one kept from before, or one computed."""

from __future__ import annotations

import json
from pathlib import Path

from .. import __version__
from .._checkpoint import scene_digest
from .._progress import Progress, prefixed
from ..image import Image, read_exr
from ..passes import render_progressive
from ..scene import Scene
from .run import ABOUT, Plan, check_reference

_KEY = "photonrelax.reference_of"


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
    path: Path, plan: Plan, passes: int, progress: Progress | None = None, *, seed: int = 0
) -> Image:
    """Return the exact picture, where it is known, or the reference that is kept at a path.

    It is computed and kept if there is none, or one that is not of the same scene, view, photons,
    passes and seed; its photons are others than those compared, whatever their seed.
    """
    exact = plan.subject.exact(plan.supersampling)
    if exact is not None:
        return Image(
            {"radiance": exact, "caustic": exact}, {ABOUT: "exact irradiance at the same points"}
        )
    found = _found(path)
    if found is None or found.metadata.get(_KEY) != _key(plan, passes, seed):
        _computed(plan, passes, seed, progress).write_exr(path)
        # As it is kept: a later run measures the same.
        found = read_exr(path)
    return found


def _found(path: Path) -> Image | None:
    try:
        return read_exr(path) if path.exists() else None
    except ValueError:
        return None


def _computed(plan: Plan, passes: int, seed: int, progress: Progress | None) -> Image:
    """Return a reference by progressive photon mapping, at the hit points that are compared at."""
    image = render_progressive(
        _scene(plan),
        n_passes=passes,
        photons_per_pass=plan.n_emitted,
        seed=seed,
        supersampling=plan.supersampling,
        max_depth=plan.max_depth,
        n_threads=plan.n_threads,
        progress=prefixed(progress, "reference"),
    )
    (stage,) = image.stats["stages"].values()
    about = (
        f"progressive photon mapping, {passes:,} passes of {plan.n_emitted:,} photons "
        f"({stage['stored']:,} absorbed), {stage['seconds']:.0f} s"
    )
    return Image(image.layers, {**image.metadata, ABOUT: about, _KEY: _key(plan, passes, seed)})


def _key(plan: Plan, passes: int, seed: int) -> str:
    """Return all that the reference depends on."""
    depends_on = {
        "scene": scene_digest(_scene(plan)),
        "supersampling": plan.supersampling,
        "max_depth": plan.max_depth,
        "photons": plan.n_emitted,
        "passes": passes,
        "seed": seed,
        "version": __version__,
    }
    return json.dumps(depends_on)


def _scene(plan: Plan) -> Scene:
    scene = plan.subject.scene
    assert scene is not None, "what is not exact has a scene"
    return scene
