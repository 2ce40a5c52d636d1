"""The methods by name: each prepares photons once, for irradiance anywhere."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from time import perf_counter
from typing import Any

from .._util.progress import Progress
from ..photons.photon_map import PhotonMap
from ..relaxation.gradient import GradientSettings, detect_gradient
from ..relaxation.relax import RelaxSettings
from ..relaxation.relax import relax as relax_photons
from ..relaxation.structure import Structure, StructureSettings, detect_structure
from ..scene.scene import Scene
from .diffusion import DiffusionField, DiffusionSettings
from .field import Field
from .frequency import FrequencyField, FrequencySettings
from .nearest import GatherSettings, IrradianceField
from .progressive import ProgressiveSettings
from .split_passes import ProgressiveField


def irradiance_field(
    photons: PhotonMap,
    *,
    method: str = "parameterised",
    scene: Scene | None = None,
    n_threads: int | None = None,
    progress: Progress | None = None,
    **settings: Any,
) -> Field:
    """Do a method's preparation once; the result gives irradiance anywhere.

    Parameters
    ----------
    photons : PhotonMap
        Photons from `trace_photons` or from any other renderer.
    method : str
        One of:

        - ``parameterised``: SJ13, the default;
        - ``relaxation``: the original relaxation (Spencer & Jones 2009, see
          `photonrelax.relaxation.gradient`), all of whose iterations are in space;
        - ``standard``: the photons as they are (Jensen);
        - ``diffusion``, ``isotropic-diffusion``: with kernels that adapt their shape, or their size
          alone, to the structure around a point (SSO08);
        - ``progressive``: photons as they are, dealt to passes (Hachisuka et al. 2008);
        - ``frequency``: these with discs no smaller than spectra ask for (FPPM); some of the
          photons carry such (see `photonrelax.trace_photons`).
    scene : Scene, optional
        Keeps moved photons on their objects; see `photonrelax.relaxation.relax`.
    n_threads : int, optional
        Threads; all available by default. Results do not depend on it.
    progress : callable, optional
        Called as ``progress(stage, done, total)``.
    **settings
        Of stages: `Settings`' fields by name, as in ``relax=RelaxSettings((3, 3))``. Those of
        stages that the method has not are not looked at.

    Returns
    -------
    Field
        Called as ``field(points, normals)``, with (m, 3) arrays each, the points in m; returns
        irradiance (m, 3), W/m². What photons carry beside their flux, (n, c), has its densities
        (m, c) per m² by ``field.densities(values)(points, normals)``.

    Raises
    ------
    TypeError, ValueError
        If the method is not known, or a setting.
    """
    chosen = settings_of("irradiance_field", settings)
    return prepare(method, Task(photons, chosen, scene, n_threads, progress))


@dataclass(frozen=True, kw_only=True)
class Settings:
    """The settings of every stage of every method; None for the defaults.

    These are the papers', save for diffusion's: see `photonrelax.DiffusionSettings`.
    """

    structure: StructureSettings | None = None
    gradient: GradientSettings | None = None
    relax: RelaxSettings | None = None
    gather: GatherSettings | None = None
    diffusion: DiffusionSettings | None = None
    progressive: ProgressiveSettings | None = None
    frequency: FrequencySettings | None = None

    def __post_init__(self) -> None:
        for name, kind in KINDS.items():
            value = getattr(self, name)
            if value is not None and not isinstance(value, kind):
                raise TypeError(f"{name} should be {kind.__name__}, but is {value!r}")


KINDS: dict[str, type] = {
    "structure": StructureSettings,
    "gradient": GradientSettings,
    "relax": RelaxSettings,
    "gather": GatherSettings,
    "diffusion": DiffusionSettings,
    "progressive": ProgressiveSettings,
    "frequency": FrequencySettings,
}


def settings_of(function: str, arguments: dict[str, Any]) -> Settings:
    """Return the settings among a function's arguments; raise TypeError if others are left."""
    unknown = [name for name in arguments if name not in KINDS]
    if unknown:
        raise TypeError(
            f"{function} has no argument {', '.join(unknown)}; settings are {', '.join(KINDS)}"
        )
    return Settings(**arguments)


@dataclass(frozen=True)
class Task:
    """What a method is given."""

    photons: PhotonMap
    settings: Settings
    scene: Scene | None
    n_threads: int | None
    progress: Progress | None


def _standard(task: Task) -> Field:
    return IrradianceField(task.photons, task.settings.gather, n_threads=task.n_threads)


def _parameterised(task: Task) -> Field:
    structure = task.settings.structure or StructureSettings()
    relax = task.settings.relax or RelaxSettings()
    used = {"structure": asdict(structure), "relax": asdict(relax)}
    return _relaxed(
        task, lambda **how: detect_structure(task.photons, structure, **how), relax, used
    )


def _relaxation(task: Task) -> Field:
    gradient = task.settings.gradient or GradientSettings()
    relax = task.settings.relax or RelaxSettings()
    relax = replace(relax, n_iterations=(0, sum(relax.n_iterations)))
    used = {"gradient": asdict(gradient), "relax": asdict(relax)}
    return _relaxed(task, lambda **how: detect_gradient(task.photons, gradient, **how), relax, used)


def _relaxed(
    task: Task, detect: Callable[..., Structure], relax: RelaxSettings, used: dict[str, Any]
) -> Field:
    """Gather from photons relaxed as far as the structure detected allows."""
    how: dict[str, Any] = {"n_threads": task.n_threads, "progress": task.progress}
    started = perf_counter()
    found = detect(**how)
    detected = perf_counter()
    relaxed = relax_photons(task.photons, found, relax, scene=task.scene, **how)
    return IrradianceField(
        relaxed,
        task.settings.gather,
        structure=found,
        seconds={"structure": detected - started, "relax": perf_counter() - detected},
        used=used,
        n_threads=task.n_threads,
    )


def _diffusion(task: Task, *, isotropic: bool = False) -> Field:
    return DiffusionField(
        task.photons,
        task.settings.diffusion,
        isotropic=isotropic,
        n_threads=task.n_threads,
        progress=task.progress,
    )


def _isotropic_diffusion(task: Task) -> Field:
    return _diffusion(task, isotropic=True)


def _progressive(task: Task) -> Field:
    return ProgressiveField(task.photons, task.settings.progressive, n_threads=task.n_threads)


def _frequency(task: Task) -> Field:
    settings = task.settings
    return FrequencyField(
        task.photons, settings.progressive, settings.frequency, n_threads=task.n_threads
    )


_METHODS: dict[str, Callable[[Task], Field]] = {
    "standard": _standard,
    "relaxation": _relaxation,
    "parameterised": _parameterised,
    "diffusion": _diffusion,
    "isotropic-diffusion": _isotropic_diffusion,
    "progressive": _progressive,
    "frequency": _frequency,
}
METHODS = tuple(_METHODS)
STAGES: dict[str, tuple[str, ...]] = {
    "standard": ("gather",),
    "relaxation": ("gradient", "relax", "gather"),
    "parameterised": ("structure", "relax", "gather"),
    "diffusion": ("diffusion",),
    "isotropic-diffusion": ("diffusion",),
    "progressive": ("progressive",),
    "frequency": ("progressive", "frequency"),
}
"""The fields of `Settings` that each method reads."""


def prepare(method: str, task: Task) -> Field:
    """Do a method's preparation; raise ValueError if the method is not known."""
    check_method(method)
    return _METHODS[method](task)


def check_method(method: str) -> None:
    """Raise ValueError unless the method is known."""
    if method not in METHODS:
        raise ValueError(f"method should be one of {', '.join(METHODS)}, but is {method!r}")


def frequency_share(method: str, settings: Settings) -> float:
    """Return the share of the photons that are to carry spectra for a method."""
    return (settings.frequency or FrequencySettings()).share if method == "frequency" else 0.0
