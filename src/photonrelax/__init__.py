"""Sharp, noise-free caustics from few photons.

Photon mapping with the parameterised photon relaxation of Spencer & Jones 2013 and the methods
it is compared with. Public names load on first use, so importing the package stays cheap.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING

from ._version import __version__ as __version__

if TYPE_CHECKING:
    from . import gallery as gallery
    from ._util.workers import WorkerLostError as WorkerLostError
    from .estimation.block_relaxation import relax_parts as relax_parts
    from .estimation.diffusion import DiffusionSettings as DiffusionSettings
    from .estimation.envelope.envelope import Envelope as Envelope
    from .estimation.envelope.envelope import EnvelopeSettings as EnvelopeSettings
    from .estimation.envelope.tracing import trace_envelope as trace_envelope
    from .estimation.field import Field as Field
    from .estimation.frequency import FrequencySettings as FrequencySettings
    from .estimation.irradiance_map import irradiance_map as irradiance_map
    from .estimation.lightmap import lightmap as lightmap
    from .estimation.methods import irradiance_field as irradiance_field
    from .estimation.nearest import GatherSettings as GatherSettings
    from .estimation.nearest import IrradianceField as IrradianceField
    from .estimation.nearest import estimate_irradiance as estimate_irradiance
    from .estimation.progressive import ProgressiveSettings as ProgressiveSettings
    from .estimation.progressive import ProgressiveStatistics as ProgressiveStatistics
    from .evaluation.tradeoff import TradeoffRequest as TradeoffRequest
    from .evaluation.tradeoff import tradeoff as tradeoff
    from .imaging.image import Image as Image
    from .io.load import load_scene as load_scene
    from .io.save import save_scene as save_scene
    from .photons.blocks import BlockedPhotons as BlockedPhotons
    from .photons.energy_ledger import EnergyLedger as EnergyLedger
    from .photons.parts import PhotonParts as PhotonParts
    from .photons.photon_map import PhotonMap as PhotonMap
    from .relaxation.gradient import GradientSettings as GradientSettings
    from .relaxation.gradient import detect_gradient as detect_gradient
    from .relaxation.relax import RelaxSettings as RelaxSettings
    from .relaxation.relax import relax as relax
    from .relaxation.rest_density import RestDensity as RestDensity
    from .relaxation.rest_density import RestDensitySettings as RestDensitySettings
    from .relaxation.rest_density import rest_density as rest_density
    from .relaxation.structure import Structure as Structure
    from .relaxation.structure import StructureSettings as StructureSettings
    from .relaxation.structure import detect_structure as detect_structure
    from .rendering.plan import Plan as Plan
    from .rendering.plan import plan as plan
    from .rendering.progressive_render import Checkpoints as Checkpoints
    from .rendering.progressive_render import render_progressive as render_progressive
    from .rendering.render import render as render
    from .scene.area_emitter import AreaEmitter as AreaEmitter
    from .scene.camera import Camera as Camera
    from .scene.dispersion import Abbe as Abbe
    from .scene.dispersion import Cauchy as Cauchy
    from .scene.dispersion import Sellmeier as Sellmeier
    from .scene.emitters import CollimatedEmitter as CollimatedEmitter
    from .scene.emitters import LambertianEmitter as LambertianEmitter
    from .scene.emitters import PointEmitter as PointEmitter
    from .scene.emitters import SpotEmitter as SpotEmitter
    from .scene.environment import EnvironmentEmitter as EnvironmentEmitter
    from .scene.materials import Dielectric as Dielectric
    from .scene.materials import Diffuse as Diffuse
    from .scene.materials import Mirror as Mirror
    from .scene.materials import Sensor as Sensor
    from .scene.scene import Scene as Scene
    from .scene.scene import SceneObject as SceneObject
    from .scene.shapes import Disk as Disk
    from .scene.shapes import Rectangle as Rectangle
    from .scene.shapes import Sphere as Sphere
    from .scene.textures import Texture as Texture
    from .spatial.kdtree import KDTree as KDTree
    from .spatial.kdtree import Neighbours as Neighbours
    from .transport.hit_points import HitPoints as HitPoints
    from .transport.parts import trace_parts as trace_parts
    from .transport.trace import trace_photons as trace_photons


_MODULE_OF = {
    "Abbe": "scene.dispersion",
    "AreaEmitter": "scene.area_emitter",
    "Camera": "scene.camera",
    "Cauchy": "scene.dispersion",
    "Checkpoints": "rendering.progressive_render",
    "CollimatedEmitter": "scene.emitters",
    "Dielectric": "scene.materials",
    "Diffuse": "scene.materials",
    "DiffusionSettings": "estimation.diffusion",
    "Disk": "scene.shapes",
    "EnergyLedger": "photons.energy_ledger",
    "EnvironmentEmitter": "scene.environment",
    "Envelope": "estimation.envelope.envelope",
    "EnvelopeSettings": "estimation.envelope.envelope",
    "Field": "estimation.field",
    "FrequencySettings": "estimation.frequency",
    "GatherSettings": "estimation.nearest",
    "GradientSettings": "relaxation.gradient",
    "HitPoints": "transport.hit_points",
    "Image": "imaging.image",
    "IrradianceField": "estimation.nearest",
    "KDTree": "spatial.kdtree",
    "LambertianEmitter": "scene.emitters",
    "Mirror": "scene.materials",
    "Neighbours": "spatial.kdtree",
    "BlockedPhotons": "photons.blocks",
    "PhotonMap": "photons.photon_map",
    "PhotonParts": "photons.parts",
    "Plan": "rendering.plan",
    "PointEmitter": "scene.emitters",
    "ProgressiveSettings": "estimation.progressive",
    "ProgressiveStatistics": "estimation.progressive",
    "Rectangle": "scene.shapes",
    "RelaxSettings": "relaxation.relax",
    "RestDensity": "relaxation.rest_density",
    "RestDensitySettings": "relaxation.rest_density",
    "Scene": "scene.scene",
    "SceneObject": "scene.scene",
    "Sellmeier": "scene.dispersion",
    "Sensor": "scene.materials",
    "Sphere": "scene.shapes",
    "SpotEmitter": "scene.emitters",
    "Structure": "relaxation.structure",
    "StructureSettings": "relaxation.structure",
    "Texture": "scene.textures",
    "TradeoffRequest": "evaluation.tradeoff",
    "WorkerLostError": "_util.workers",
    "detect_gradient": "relaxation.gradient",
    "detect_structure": "relaxation.structure",
    "estimate_irradiance": "estimation.nearest",
    "irradiance_field": "estimation.methods",
    "irradiance_map": "estimation.irradiance_map",
    "lightmap": "estimation.lightmap",
    "load_scene": "io.load",
    "plan": "rendering.plan",
    "relax": "relaxation.relax",
    "relax_parts": "estimation.block_relaxation",
    "render": "rendering.render",
    "render_progressive": "rendering.progressive_render",
    "rest_density": "relaxation.rest_density",
    "save_scene": "io.save",
    "trace_envelope": "estimation.envelope.tracing",
    "trace_parts": "transport.parts",
    "trace_photons": "transport.trace",
    "tradeoff": "evaluation.tradeoff",
}
_SUBPACKAGES = ("gallery",)
__all__ = sorted([*_MODULE_OF, *_SUBPACKAGES, "__version__"])


# Hidden from type checkers, which would take any name for one of the package's.
if not TYPE_CHECKING:

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
