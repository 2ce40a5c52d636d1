"""Sharp, noise-free caustics from few photons.

Photon mapping with the parameterised photon relaxation of Spencer & Jones 2013 and the methods
it is compared with. Public names load on first use, so importing the package stays cheap.
"""

from __future__ import annotations

import importlib
import sys
from types import ModuleType
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from . import gallery as gallery
    from .camera import HitPoints as HitPoints
    from .diffusion import DiffusionSettings as DiffusionSettings
    from .estimate import Field as Field
    from .estimate import GatherSettings as GatherSettings
    from .estimate import IrradianceField as IrradianceField
    from .estimate import estimate_irradiance as estimate_irradiance
    from .frequency import FrequencySettings as FrequencySettings
    from .gradient import GradientSettings as GradientSettings
    from .gradient import detect_gradient as detect_gradient
    from .image import Image as Image
    from .kdtree import KDTree as KDTree
    from .kdtree import Neighbours as Neighbours
    from .methods import irradiance_field as irradiance_field
    from .passes import Checkpoints as Checkpoints
    from .passes import render_progressive as render_progressive
    from .photonmap import EnergyLedger as EnergyLedger
    from .photonmap import PhotonMap as PhotonMap
    from .progressive import ProgressiveSettings as ProgressiveSettings
    from .progressive import ProgressiveStatistics as ProgressiveStatistics
    from .relax import RelaxSettings as RelaxSettings
    from .relax import relax as relax
    from .render import render as render
    from .scene import Camera as Camera
    from .scene import CollimatedEmitter as CollimatedEmitter
    from .scene import Dielectric as Dielectric
    from .scene import Diffuse as Diffuse
    from .scene import LambertianEmitter as LambertianEmitter
    from .scene import Mirror as Mirror
    from .scene import PointEmitter as PointEmitter
    from .scene import Scene as Scene
    from .scene import SceneObject as SceneObject
    from .structure import Structure as Structure
    from .structure import StructureSettings as StructureSettings
    from .structure import detect_structure as detect_structure
    from .trace import trace_photons as trace_photons

__version__ = "0.1.0"

_MODULE_OF = {
    "Camera": "scene",
    "Checkpoints": "passes",
    "CollimatedEmitter": "scene",
    "Dielectric": "scene",
    "Diffuse": "scene",
    "DiffusionSettings": "diffusion",
    "EnergyLedger": "photonmap",
    "Field": "estimate",
    "FrequencySettings": "frequency",
    "GatherSettings": "estimate",
    "GradientSettings": "gradient",
    "HitPoints": "camera",
    "Image": "image",
    "IrradianceField": "estimate",
    "KDTree": "kdtree",
    "LambertianEmitter": "scene",
    "Mirror": "scene",
    "Neighbours": "kdtree",
    "PhotonMap": "photonmap",
    "PointEmitter": "scene",
    "ProgressiveSettings": "progressive",
    "ProgressiveStatistics": "progressive",
    "RelaxSettings": "relax",
    "Scene": "scene",
    "SceneObject": "scene",
    "Structure": "structure",
    "StructureSettings": "structure",
    "detect_gradient": "gradient",
    "detect_structure": "structure",
    "estimate_irradiance": "estimate",
    "irradiance_field": "methods",
    "relax": "relax",
    "render": "render",
    "render_progressive": "passes",
    "trace_photons": "trace",
}
_SUBPACKAGES = ("gallery",)
__all__ = sorted([*_MODULE_OF, *_SUBPACKAGES, "__version__"])


class _Package(ModuleType):
    """The package, whose `relax` and `render` are the functions, not the modules holding them.

    The import system binds every submodule to its own name in the package, also when another
    module imports it; for these two that would hide the public function.
    """

    def __setattr__(self, name: str, value: object) -> None:
        if isinstance(value, ModuleType) and _MODULE_OF.get(name) == name:
            value = getattr(value, name)
        super().__setattr__(name, value)


sys.modules[__name__].__class__ = _Package


def __getattr__(name: str) -> object:
    if name in _SUBPACKAGES:
        return importlib.import_module(f".{name}", __name__)
    if name not in _MODULE_OF:
        raise AttributeError(f"module 'photonrelax' has no attribute {name!r}")
    module = importlib.import_module(f".{_MODULE_OF[name]}", __name__)
    value = getattr(module, name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return __all__
