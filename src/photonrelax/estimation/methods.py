"""Table of methods, a record each, and preparation of a method's field of irradiance.

A new method is its module and one `Method` among the records here, or one handed to `register`.
A new stage with settings of its own is one line in `StageSettings`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, field, replace
from functools import partial
from time import perf_counter
from typing import Any, NamedTuple, TypedDict, Unpack, get_args, get_type_hints

from .._util.parallel import thread_count
from .._util.progress import Progress
from ..photons.blocks import BlockedPhotons
from ..photons.photon_map import PhotonMap
from ..relaxation.gradient import GradientSettings, detect_gradient
from ..relaxation.relax import RelaxSettings
from ..relaxation.relax import relax as relax_photons
from ..relaxation.rest_density import RestDensity, RestDensitySettings, rest_density
from ..relaxation.structure import Structure, StructureSettings, detect_structure
from ..scene.scene import Scene
from ..transport.raycast import RayCaster
from .block_field import BlockedField
from .diffusion import DiffusionField, DiffusionSettings
from .envelope.envelope import Envelope, EnvelopeSettings
from .envelope.field import EnvelopeField
from .envelope.tracing import laid_envelope
from .field import Field, PhotonField
from .frequency import FrequencyField, FrequencySettings
from .nearest import GatherSettings, IrradianceField
from .progressive import ProgressiveSettings
from .split_passes import ProgressiveField
from .surface import Surface, lit_objects, objects_lit_in_blocks

DEFAULT_METHOD = "mapped"
PLAIN_METHOD = "standard"
"""The method that gathers from photons as they are: relaxed ones, say, from a file."""
PASSES_METHOD = "progressive"
"""The method that `photonrelax.render_progressive` renders with fresh photons in every pass."""
METHODS_OF_SJ13 = ("standard", "relaxation", "diffusion", "parameterised", "progressive")
"""The methods that SJ13's Table I compares, in its order."""

COMPARED_METHODS = (*METHODS_OF_SJ13, DEFAULT_METHOD)
"""The methods that are compared unless others are named."""


class StageSettings(TypedDict, total=False):
    """Settings objects by stage, in the order of the pipeline; None stands for the defaults.

    These are the papers', except for diffusion's: see `photonrelax.DiffusionSettings`, and for
    ``mapped``, which relaxes by ``RelaxSettings((5, 5), step=2)``.
    """

    structure: StructureSettings | None
    gradient: GradientSettings | None
    rest_density: RestDensitySettings | None
    relax: RelaxSettings | None
    gather: GatherSettings | None
    diffusion: DiffusionSettings | None
    progressive: ProgressiveSettings | None
    frequency: FrequencySettings | None
    envelope: EnvelopeSettings | None


SETTINGS_CLASSES: dict[str, type] = {
    stage: get_args(hint)[0] for stage, hint in get_type_hints(StageSettings).items()
}
"""The settings class of each stage."""


def irradiance_field(
    photons: PhotonMap | BlockedPhotons | Envelope,
    *,
    method: str = DEFAULT_METHOD,
    scene: Scene | None = None,
    n_threads: int | None = None,
    progress: Progress | None = None,
    **settings: Unpack[StageSettings],
) -> Field:
    """Field of irradiance at any points, prepared once by a method.

    Parameters
    ----------
    photons : PhotonMap, BlockedPhotons or Envelope
        Photons from `trace_photons` or from any other renderer, or what `trace_envelope` returns.
        Those of `relax_parts` are gathered as they are, by the first four methods.
    method : str
        One of:

        - ``parameterised``: SJ13;
        - ``mapped``: the same, towards the density that the map from emitter coordinates to
          positions prescribes, see `photonrelax.relaxation.rest_density`; the default;
        - ``relaxation``: the original relaxation (Spencer & Jones 2009, see
          `photonrelax.relaxation.gradient`), all of whose iterations are in space;
        - ``standard``: the photons as they are (Jensen);
        - ``diffusion``, ``isotropic-diffusion``: with kernels that adapt their shape, or their size
          alone, to the structure around a point (SSO08);
        - ``progressive``: photons as they are, split into passes (Hachisuka et al. 2008);
        - ``frequency``: the same, with radii no smaller than local frequency spectra ask for
          (FPPM); some of the photons carry such (see `photonrelax.trace_photons`);
        - ``envelope``: light laid over the images of emitters, of an `Envelope` or the scene's.
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
    Field
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
    if isinstance(photons, BlockedPhotons):
        return _gather_blocks(photons, method_named(method), given, scene, n_threads)
    return prepare(method, MethodInput(photons, given, scene, n_threads, progress))


def _gather_blocks(
    photons: BlockedPhotons,
    method: Method,
    settings: Settings,
    scene: Scene | None,
    n_threads: int | None,
) -> BlockedField:
    if method.stages[-1] != "gather":
        raise ValueError(
            f"photons in blocks are gathered as they are, but method is {method.name!r}, which "
            "estimates in another way: give it their photon_map(), in memory"
        )
    gather = Settings(**{**method.defaults, **settings.given}).of("gather")
    field = BlockedField(photons, gather, n_threads=n_threads)
    if scene is not None:
        field.surface = Surface(
            scene, thread_count(n_threads), objects_lit_in_blocks(scene, photons)
        )
    return field


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
    """The arguments of a method's preparation; see `irradiance_field`.

    `caster` is the scene's, if there is one already: building it takes time.
    """

    elements: PhotonMap | Envelope | None
    settings: Settings
    scene: Scene | None
    n_threads: int | None
    progress: Progress | None
    caster: RayCaster | None = None

    @property
    def photons(self) -> PhotonMap:
        """The elements of methods that estimate from photons; raises TypeError for others."""
        if not isinstance(self.elements, PhotonMap):
            raise TypeError(
                "photons should be a PhotonMap, but is "
                f"{type(self.elements).__name__}, of which only method='envelope' makes a field"
            )
        return self.elements


class RelaxedPhotons(NamedTuple):
    """Photons that a method has relaxed.

    Attributes
    ----------
    photons : PhotonMap
    structure : Structure
        Of the photons before.
    seconds, used : dict
        Time, s, and settings of each stage.
    """

    photons: PhotonMap
    structure: Structure
    seconds: dict[str, float]
    used: dict[str, dict[str, Any]]


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
        ``prepare(inputs)``, a `MethodInput`, returns the `Field`.
    needs_spectra : bool
        Photons carry local frequency spectra; see `photonrelax.trace_photons`.
    splits_passes : bool
        The photon map is split into passes, so that the number of photons in an estimate varies.
    relax : callable, optional
        ``relax(inputs)``, a `MethodInput`, returns the `RelaxedPhotons`, if it relaxes them.
    defaults : dict
        Settings by stage, where they are not those of the stage's class.
    needs_photons : bool
        False if light is not of a photon map, but traced by the method itself.
    """

    name: str
    stages: tuple[str, ...]
    prepare: Callable[[MethodInput], Field]
    needs_spectra: bool = False
    splits_passes: bool = False
    relax: Callable[[MethodInput], RelaxedPhotons] | None = None
    defaults: Mapping[str, Any] = field(default_factory=dict)
    needs_photons: bool = True

    def default(self, stage: str) -> Any:
        """Settings of a stage where none are given."""
        return self.defaults[stage] if stage in self.defaults else SETTINGS_CLASSES[stage]()

    def frequency_share(self, settings: Settings) -> float:
        """Share of the photons that are to carry spectra, in [0, 1]."""
        return settings.of("frequency").share if self.needs_spectra else 0.0


def _standard(inputs: MethodInput) -> PhotonField:
    gather = inputs.settings.of("gather")
    return IrradianceField(inputs.photons, gather, n_threads=inputs.n_threads)


def _relax_by_structure(inputs: MethodInput) -> RelaxedPhotons:
    stages = _Stages(inputs)
    structure = stages.run("structure", detect_structure)
    return stages.relaxed(structure, inputs.settings.of("relax"))


def _relax_by_gradient(inputs: MethodInput) -> RelaxedPhotons:
    stages = _Stages(inputs)
    structure = stages.run("gradient", detect_gradient, seconds_of="structure")
    settings = inputs.settings.of("relax")
    in_space = replace(settings, n_iterations=(0, sum(settings.n_iterations)))
    return stages.relaxed(structure, in_space)


def _relax_to_rest(inputs: MethodInput) -> RelaxedPhotons:
    stages = _Stages(inputs)
    structure = stages.run("structure", detect_structure)
    rest = stages.run("rest_density", rest_density)
    return stages.relaxed(structure, inputs.settings.of("relax"), rest)


class _Stages:
    """Stages of a method that relaxes photons, one after the other.

    Attributes
    ----------
    seconds, used : dict
        Time, s, and settings of the stages done.
    """

    def __init__(self, inputs: MethodInput) -> None:
        self._inputs = inputs
        self._options: dict[str, Any] = {"n_threads": inputs.n_threads, "progress": inputs.progress}
        self.seconds: dict[str, float] = {}
        self.used: dict[str, dict[str, Any]] = {}

    def run(self, stage: str, work: Callable[..., Any], seconds_of: str | None = None) -> Any:
        """Result of a stage's work on the photons; its time is counted under `seconds_of`."""
        settings = self._inputs.settings.of(stage)
        started = perf_counter()
        found = work(self._inputs.photons, settings, **self._options)
        self.seconds[seconds_of or stage] = perf_counter() - started
        self.used[stage] = asdict(settings)
        return found

    def relaxed(
        self, structure: Structure, settings: RelaxSettings, rest: RestDensity | None = None
    ) -> RelaxedPhotons:
        """Photons relaxed as far as the structure allows."""
        inputs, started = self._inputs, perf_counter()
        moved = relax_photons(
            inputs.photons,
            structure,
            settings,
            rest=rest,
            scene=inputs.scene,
            caster=inputs.caster,
            **self._options,
        )
        self.seconds["relax"] = perf_counter() - started
        self.used["relax"] = asdict(settings)
        return RelaxedPhotons(moved, structure, self.seconds, self.used)


def _relaxing_method(
    name: str,
    stages: tuple[str, ...],
    relax: Callable[[MethodInput], RelaxedPhotons],
    defaults: Mapping[str, Any] | None = None,
) -> Method:
    """The method that gathers from relaxed photons."""
    prepare = partial(_gather_relaxed, relax)
    return Method(name, (*stages, "relax", "gather"), prepare, relax=relax, defaults=defaults or {})


def _gather_relaxed(
    relax: Callable[[MethodInput], RelaxedPhotons], inputs: MethodInput
) -> PhotonField:
    relaxed = relax(inputs)
    return IrradianceField(
        relaxed.photons,
        inputs.settings.of("gather"),
        structure=relaxed.structure,
        seconds=relaxed.seconds,
        used=relaxed.used,
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


def _envelope(inputs: MethodInput) -> EnvelopeField:
    envelope = inputs.elements
    if not isinstance(envelope, Envelope):
        if inputs.scene is None:
            raise TypeError(
                "photons should be an Envelope, from trace_envelope, or scene should be given for "
                f"method='envelope', but photons is {type(envelope).__name__}"
            )
        settings = inputs.settings.of("envelope")
        envelope = laid_envelope(inputs.scene, settings, inputs.n_threads, inputs.caster)
    rest = None
    if envelope.rest is not None:
        rest = _gather_relaxed(_relax_to_rest, replace(inputs, elements=envelope.rest))
        rest.surface = _surface_of(inputs.scene, envelope.rest, inputs.n_threads)
    return EnvelopeField(envelope, rest, n_threads=inputs.n_threads)


_TO_REST = {"relax": RelaxSettings((5, 5), step=2.0)}
_RECORDS = (
    Method("standard", ("gather",), _standard),
    _relaxing_method("relaxation", ("gradient",), _relax_by_gradient),
    _relaxing_method("parameterised", ("structure",), _relax_by_structure),
    _relaxing_method(
        "mapped",
        ("structure", "rest_density"),
        _relax_to_rest,
        _TO_REST,
    ),
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
    Method(
        "envelope",
        ("structure", "rest_density", "relax", "gather", "envelope"),
        _envelope,
        defaults=_TO_REST,
        needs_photons=False,
    ),
)
METHODS = {method.name: method for method in _RECORDS}
"""All methods by name."""

PHOTON_METHODS = tuple(method.name for method in _RECORDS if method.needs_photons)
"""Names of the methods that estimate from photon maps."""


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


def relaxed_photons(name: str, inputs: MethodInput) -> RelaxedPhotons:
    """Photons relaxed by the method of a name; raises ValueError if it does not relax any."""
    relaxing = {method.name: method.relax for method in METHODS.values()}
    relax = relaxing.get(name)
    if relax is None:
        names = ", ".join(each for each, has in relaxing.items() if has is not None)
        raise ValueError(f"method should be one that relaxes photons, {names}, but is {name!r}")
    return relax(_completed(METHODS[name], inputs))


def prepare(name: str, inputs: MethodInput) -> Field:
    """Do the preparation of the method of a name; raises ValueError if there is none."""
    method = method_named(name)
    field = method.prepare(_completed(method, inputs))
    if method.needs_photons:
        field.surface = _surface_of(inputs.scene, inputs.photons, inputs.n_threads)
    return field


def _surface_of(scene: Scene | None, photons: PhotonMap, n_threads: int | None) -> Surface | None:
    """Surfaces that photons light; None if the scene is not known."""
    if scene is None:
        return None
    return Surface(scene, thread_count(n_threads), lit_objects(scene, photons))


def _completed(method: Method, inputs: MethodInput) -> MethodInput:
    """The input with the method's own defaults for settings that are not given."""
    return replace(inputs, settings=Settings(**{**method.defaults, **inputs.settings.given}))
