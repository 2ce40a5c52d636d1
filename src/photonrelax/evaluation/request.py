"""Parameters of a comparison, validated before the work."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from .._util import validation
from .._util.frozen import set_field
from .._util.validation import check_choice, check_seed
from ..estimation.methods import COMPARED_METHODS, METHODS, Method, Settings, method_named
from ..imaging.metrics import SSIM_WINDOW
from ..transport.emission import MAX_PHOTONS, SAMPLERS
from ..transport.hit_points import MAX_DEPTH
from .subject import Subject


@dataclass(frozen=True, kw_only=True, eq=False)
class ComparisonRequest:
    """Parameters of a comparison of methods.

    Attributes
    ----------
    subject : Subject
        `SceneSubject` or `PhotonPatternSubject`.
    methods : tuple of str
        Methods to compare; by default `COMPARED_METHODS`.
    variants : dict
        Further columns: method and settings by name.
    n_emitted, seed, sampler : int, int, str
        Of the photons, which all methods share; see `photonrelax.trace_photons`.
    settings : Settings
        Settings of the stages of all methods.
    supersampling, max_depth : int
        s·s samples a pixel; maximum number of specular surfaces on a camera path.
    exposure : float
        Images are displayed, and SSIM and FLIP measured, times 2^exposure.
    rounds : int
        Number of interleaved runs of all methods; times are medians.
    n_threads : int, optional
        Threads; all available by default. Only times depend on it.

    Raises
    ------
    TypeError, ValueError
        If a method is unknown or not applicable to the subject, a number is out of its range, or
        images are too small for SSIM.
    MemoryError
        If photons or images surely do not fit in memory.
    """

    subject: Subject
    methods: tuple[str, ...] = ()
    variants: Mapping[str, tuple[str, Settings]] = field(default_factory=dict)
    n_emitted: int = 1_000_000
    seed: int = 0
    sampler: str = "halton"
    settings: Settings = field(default_factory=Settings)
    supersampling: int = 2
    max_depth: int = 8
    exposure: float = 0.0
    rounds: int = 1
    n_threads: int | None = None

    def __post_init__(self) -> None:
        methods = tuple(dict.fromkeys(self.methods)) or COMPARED_METHODS
        set_field(self, "methods", methods)
        for method, _ in self.columns().values():
            self._check_spectra(method_named(method))
        validation.count(self.n_emitted, "n_emitted", high=MAX_PHOTONS)
        for name in ("supersampling", "rounds"):
            validation.count(getattr(self, name), name, high=validation.MAX_REPEATS)
        validation.count(self.max_depth, "max_depth", low=0, high=MAX_DEPTH)
        check_seed(self.seed)
        check_choice(self.sampler, "sampler", SAMPLERS)
        self._check_size()
        self.subject.check_memory(self.n_emitted, self.supersampling, self.max_depth)

    def columns(self) -> dict[str, tuple[str, Settings]]:
        """Method and settings of each column by its name."""
        return {name: (name, self.settings) for name in self.methods} | dict(self.variants)

    def _check_spectra(self, method: Method) -> None:
        if method.needs_spectra and self.subject.scene is None:
            others = ", ".join(each.name for each in METHODS.values() if not each.needs_spectra)
            raise ValueError(
                f"methods on {self.subject.name} should be of {others}, but include {method.name}: "
                "photons that were not traced carry no spectra"
            )

    def _check_size(self) -> None:
        width, height = self.subject.size
        if min(width, height) < SSIM_WINDOW:
            raise ValueError(
                f"images should have at least {SSIM_WINDOW} x {SSIM_WINDOW} pixels to be "
                f"measured by SSIM, but have {width} x {height}"
            )
