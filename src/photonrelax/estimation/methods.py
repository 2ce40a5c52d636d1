"""Table of methods, a record each, and preparation of a method's field of irradiance.

A new method is its module and one `Method` among the records here, or one handed to `register`.
A new stage with settings of its own is one line in `StageSettings`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, replace
from time import perf_counter
from typing import Any, TypedDict, Unpack, get_args, get_type_hints

from .._util.parallel import thread_count
from .._util.progress import Progress
from ..photons.photon_map import PhotonMap
from ..relaxation.gradient import GradientSettings, detect_gradient
from ..relaxation.relax import RelaxSettings
from ..relaxation.relax import relax as relax_photons
from ..relaxation.structure import Structure, StructureSettings, detect_structure
from ..scene.scene import Scene
from .diffusion import DiffusionField, DiffusionSettings
from .field import PhotonField
from .frequency import FrequencyField, FrequencySettings
from .nearest import GatherSettings, IrradianceField
from .progressive import ProgressiveSettings
from .split_passes import ProgressiveField
from .surface import Surface, lit_objects

DEFAULT_METHOD = "parameterised"
PLAIN_METHOD = "standard"
"""The method that gathers from photons as they are: relaxed ones, say, from a file."""
PASSES_METHOD = "progressive"
"""The method that `photonrelax.render_progressive` renders with fresh photons in every pass."""
METHODS_OF_SJ13 = ("standard", "relaxation", "diffusion", "parameterised", "progressive")
"""The methods that SJ13's Table I compares, in its order."""


class StageSettings(TypedDict, total=False):
    """Settings objects by stage, in the order of the pipeline; None stands for the defaults.

    These are the papers', except for diffusion's: see `photonrelax.DiffusionSettings`.
    """

    structure: StructureSettings | None
    gradient: GradientSettings | None
    relax: RelaxSettings | None
    gather: GatherSettings | None
    diffusion: DiffusionSettings | None
    progressive: ProgressiveSettings | None
    frequency: FrequencySettings | None


SETTINGS_CLASSES: dict[str, type] = {
    stage: get_args(hint)[0] for stage, hint in get_type_hints(StageSettings).items()
}
"""The settings class of each stage."""


def irradiance_field(
    photons: PhotonMap,
    *,
    method: str = DEFAULT_METHOD,
    scene: Scene | None = None,
    n_threads: int | None = None,
    progress: Progress | None = None,
    **settings: Unpack[StageSettings],
) -> PhotonField:
    """Field of irradiance at any points, prepared once by a method.

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
        - ``progressive``: photons as they are, split into passes (Hachisuka et al. 2008);
        - ``frequency``: the same, with radii no smaller than local frequency spectra ask for
          (FPPM); some of the photons carry such (see `photonrelax.trace_photons`).
    scene : Scene, optional
        Keeps moved photons on their objects; see `photonrelax.relaxation.relax`. Estimates beside
        edges of its surfaces are right, and NaN, with a warning, where no surface that stores
        light is within reach; without it all surface is taken to go on for ever.
    n_threads : int, optional
        Threads; all available by default. Results do not depend on it.
    progress : callable, optional
        Called as ``progress(stage, done, total)``.
    **settings
        Of stages, as in ``relax=RelaxSettings((3, 3))``; see `StageSettings`. Those of stages
        that the method does not have are ignored.

    Returns
    -------
    PhotonField
        Called as ``field(points, normals)``, with (m, 3) arrays each, the points in m; returns
        irradiance (m, 3), W/m². With ``footprint=…``, edge vectors or sides of pixels, its means
        over them. What photons carry beside their flux, (n, c), has its densities (m, c) per m² by
        ``field.densities(values)(points, normals)``.

    Raises
    ------
    TypeError, ValueError
        If the method is not known, or a setting.
    """
    given = settings_of("irradiance_field", dict(settings))
    return prepare(method, MethodInput(photons, given, scene, n_threads, progress))


class Settings:
    """Settings of the stages of any method.

    Parameters
    ----------
    **given
        By stage, see `StageSettings`.

    Attributes
    ----------
    given : dict
        Those that are not None.

    Raises
    ------
    TypeError
        If there is no such stage, or settings are not of its class.
    """

    def __init__(self, **given: Unpack[StageSettings]) -> None:
        self.given: dict[str, Any] = {
            stage: value for stage, value in given.items() if value is not None
        }
        _check_stages("Settings", self.given)
        for stage, value in self.given.items():
            if not isinstance(value, SETTINGS_CLASSES[stage]):
                name = SETTINGS_CLASSES[stage].__name__
                raise TypeError(f"{stage} should be {name}, but is {value!r}")

    def of(self, stage: str) -> Any:
        """Settings of a stage: those given, or the defaults of its class."""
        return self.given[stage] if stage in self.given else SETTINGS_CLASSES[stage]()


def settings_of(function: str, arguments: dict[str, Any]) -> Settings:
    """Settings among the keyword arguments of a function; raises TypeError if others are left."""
    _check_stages(function, arguments)
    return Settings(**arguments)


def _check_stages(function: str, arguments: dict[str, Any]) -> None:
    unknown = [name for name in arguments if name not in SETTINGS_CLASSES]
    if unknown:
        raise TypeError(
            f"{function} has no argument {', '.join(unknown)}; "
            f"settings are {', '.join(SETTINGS_CLASSES)}"
        )


@dataclass(frozen=True)
class MethodInput:
    """The arguments of a method's preparation; see `irradiance_field`."""

    photons: PhotonMap
    settings: Settings
    scene: Scene | None
    n_threads: int | None
    progress: Progress | None


@dataclass(frozen=True)
class Method:
    """A method: all that is known of it outside of its module.

    Attributes
    ----------
    name : str
        As users give it.
    stages : tuple of str
        The stages whose settings it reads, in order; the last evaluates the estimates.
    prepare : callable
        ``prepare(inputs)``, a `MethodInput`, returns the `PhotonField`.
    needs_spectra : bool
        Photons carry local frequency spectra; see `photonrelax.trace_photons`.
    splits_passes : bool
        The photon map is split into passes, so that the number of photons in an estimate varies.
    """

    name: str
    stages: tuple[str, ...]
    prepare: Callable[[MethodInput], PhotonField]
    needs_spectra: bool = False
    splits_passes: bool = False

    def frequency_share(self, settings: Settings) -> float:
        """Share of the photons that are to carry spectra, in [0, 1]."""
        return settings.of("frequency").share if self.needs_spectra else 0.0


def _standard(inputs: MethodInput) -> PhotonField:
    gather = inputs.settings.of("gather")
    return IrradianceField(inputs.photons, gather, n_threads=inputs.n_threads)


def _parameterised(inputs: MethodInput) -> PhotonField:
    settings = inputs.settings.of("structure")
    relax = inputs.settings.of("relax")
    used = {"structure": asdict(settings), "relax": asdict(relax)}
    return _relaxed(
        inputs, lambda **options: detect_structure(inputs.photons, settings, **options), relax, used
    )


def _relaxation(inputs: MethodInput) -> PhotonField:
    settings = inputs.settings.of("gradient")
    relax = inputs.settings.of("relax")
    relax = replace(relax, n_iterations=(0, sum(relax.n_iterations)))
    used = {"gradient": asdict(settings), "relax": asdict(relax)}
    return _relaxed(
        inputs, lambda **options: detect_gradient(inputs.photons, settings, **options), relax, used
    )


def _relaxed(
    inputs: MethodInput,
    detect: Callable[..., Structure],
    relax: RelaxSettings,
    used: dict[str, Any],
) -> PhotonField:
    """Field of photons relaxed as far as the structure detected allows."""
    options: dict[str, Any] = {"n_threads": inputs.n_threads, "progress": inputs.progress}
    started = perf_counter()
    structure = detect(**options)
    detected = perf_counter()
    relaxed = relax_photons(inputs.photons, structure, relax, scene=inputs.scene, **options)
    return IrradianceField(
        relaxed,
        inputs.settings.of("gather"),
        structure=structure,
        seconds={"structure": detected - started, "relax": perf_counter() - detected},
        used=used,
        n_threads=inputs.n_threads,
    )


def _diffusion(inputs: MethodInput, *, isotropic: bool = False) -> PhotonField:
    return DiffusionField(
        inputs.photons,
        inputs.settings.of("diffusion"),
        isotropic=isotropic,
        n_threads=inputs.n_threads,
        progress=inputs.progress,
    )


def _isotropic_diffusion(inputs: MethodInput) -> PhotonField:
    return _diffusion(inputs, isotropic=True)


def _progressive(inputs: MethodInput) -> PhotonField:
    settings = inputs.settings.of("progressive")
    return ProgressiveField(inputs.photons, settings, n_threads=inputs.n_threads)


def _frequency(inputs: MethodInput) -> PhotonField:
    return FrequencyField(
        inputs.photons,
        inputs.settings.of("progressive"),
        inputs.settings.of("frequency"),
        n_threads=inputs.n_threads,
    )


_RECORDS = (
    Method("standard", ("gather",), _standard),
    Method("relaxation", ("gradient", "relax", "gather"), _relaxation),
    Method("parameterised", ("structure", "relax", "gather"), _parameterised),
    Method("diffusion", ("diffusion",), _diffusion),
    Method("isotropic-diffusion", ("diffusion",), _isotropic_diffusion),
    Method("progressive", ("progressive",), _progressive, splits_passes=True),
    Method(
        "frequency",
        ("progressive", "frequency"),
        _frequency,
        needs_spectra=True,
        splits_passes=True,
    ),
)
METHODS = {method.name: method for method in _RECORDS}
"""All methods by name."""


def register(method: Method, **settings: type) -> None:
    """Add a method, and the settings classes of those of its stages that are new, by stage.

    Raises
    ------
    ValueError
        If another method has the name, or a stage another class.
    """
    _check_new("method", {method.name: method}, METHODS)
    _check_new("stage", settings, SETTINGS_CLASSES)
    SETTINGS_CLASSES.update(settings)
    METHODS[method.name] = method


def _check_new(what: str, added: Mapping[str, object], known: Mapping[str, object]) -> None:
    for name, value in added.items():
        if known.get(name, value) != value:
            raise ValueError(
                f"{what} {name!r} should have a name of its own, but {known[name]!r} has that"
            )


def method_named(name: str) -> Method:
    """The method of a name; raises ValueError if there is none."""
    if name not in METHODS:
        raise ValueError(f"method should be one of {', '.join(METHODS)}, but is {name!r}")
    return METHODS[name]


def prepare(name: str, inputs: MethodInput) -> PhotonField:
    """Do the preparation of the method of a name; raises ValueError if there is none."""
    field = method_named(name).prepare(inputs)
    if inputs.scene is not None:
        lit = lit_objects(inputs.scene, inputs.photons)
        field.surface = Surface(inputs.scene, thread_count(inputs.n_threads), lit)
    return field
