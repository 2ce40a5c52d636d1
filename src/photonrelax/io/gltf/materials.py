"""Materials of glTF files: metal, roughness, transmission and what extends them."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from ..._util.validation import Floats
from ...scene.dispersion import Abbe
from ...scene.materials import Dielectric, Diffuse, Material, Mirror
from ..json_entry import JsonEntry
from ..substitutions import Substitutions
from .lights import LUMENS_PER_WATT
from .textures import TextureReader, TextureUse

# Metal that is rougher is diffuse.
_MIRROR_ROUGHNESS = 0.3
# The factor of KHR_materials_dispersion times the Abbe number.
DISPERSION_TIMES_ABBE = 20.0
# Of a share of metal or glass, the larger part counts.
_HALF = 0.5
# Colours of media are no darker, for their absorption to be finite.
_LEAST_COLOUR = 1e-9
# Members of a material that are textures, none of which is read.
_TEXTURES = {
    "normalTexture": "the normals of the mesh",
    "occlusionTexture": "occlusion as it is",
    "emissiveTexture": "the factor alone",
}
# Extensions of materials without a counterpart, and what is used instead.
_IGNORED = {
    "KHR_materials_anisotropy": "none",
    "KHR_materials_clearcoat": "no coat",
    "KHR_materials_diffuse_transmission": "an opaque surface",
    "KHR_materials_iridescence": "no film",
    "KHR_materials_pbrSpecularGlossiness": "the metal and roughness of the standard",
    "KHR_materials_sheen": "no sheen",
    "KHR_materials_unlit": "a diffuse surface",
}
MATERIAL_EXTENSIONS = (
    *_IGNORED,
    "KHR_materials_dispersion",
    "KHR_materials_emissive_strength",
    "KHR_materials_ior",
    "KHR_materials_specular",
    "KHR_materials_transmission",
    "KHR_materials_volume",
)


@dataclass(frozen=True, eq=False)
class Surface:
    """A material of a file.

    Attributes
    ----------
    name : str
    material : Material
    radiance : (3,)
        Emitted, W/(m² sr); zero of most.
    two_sided : bool
        Emits on both sides where its mesh is open.
    texture : TextureUse, optional
        Of a diffuse material, in place of its albedo.
    """

    name: str
    material: Material
    radiance: Floats
    two_sided: bool
    texture: TextureUse | None = None


class MaterialReader:
    """Reads materials, and adds what has no counterpart to the substitutions.

    Parameters
    ----------
    generator : str
        Program that wrote the file: Blender's glass takes its colour once for a way through it.
    light_units : str
        Of emitted light in files of other programs.
    textures : TextureReader
    substitutions : Substitutions
    """

    def __init__(
        self,
        generator: str,
        light_units: str,
        textures: TextureReader,
        substitutions: Substitutions,
    ) -> None:
        self._textures = textures
        self._from_blender = "blender" in generator.lower()
        # Blender writes the strength of its own lights on surfaces whatever the units of lamps.
        in_nits = light_units == "standard" and not self._from_blender
        self._watts = LUMENS_PER_WATT if in_nits else 1.0
        self._substitutions = substitutions

    def read(self, entry: JsonEntry, name: str) -> Surface:
        """A material, with its radiance."""
        self._add_ignored(entry, name)
        base = entry.entry("pbrMetallicRoughness")
        colour = base.numbers("baseColorFactor", (1.0, 1.0, 1.0, 1.0), 0.0, 1.0)[:3]
        material = self._material(entry, base, colour, name)
        radiance = self._radiance(entry)
        if radiance.any() and material.is_specular:
            self._substitutions.add(name, "light of glass or metal", "a diffuse lamp")
            material = Diffuse(colour)
        texture = None
        if "baseColorTexture" in base:
            if isinstance(material, Diffuse):
                texture = self._textures.read(base.entry("baseColorTexture"), colour, name)
            else:
                self._substitutions.add(name, "baseColorTexture", "the factor alone")
        return Surface(name, material, radiance, entry.flag("doubleSided"), texture)

    def _material(self, entry: JsonEntry, base: JsonEntry, colour: Floats, name: str) -> Material:
        roughness = base.number("roughnessFactor", 1.0, 0.0, 1.0)
        metallic = self._share(name, "metal", base.number("metallicFactor", 1.0, 0.0, 1.0))
        transmission = _extension(entry, "transmission")
        if self._share(name, "glass", transmission.number("transmissionFactor", 0.0, 0.0, 1.0)):
            if roughness > 0.0:
                self._substitutions.add(name, f"glass of roughness {roughness:g}", "smooth glass")
            return self._glass(entry, colour)
        if not metallic:
            self._add_gloss(entry, name, roughness)
            return Diffuse(colour)
        if roughness > 0.0:
            used = "a smooth metal" if roughness <= _MIRROR_ROUGHNESS else "a diffuse surface"
            self._substitutions.add(name, f"metal of roughness {roughness:g}", used)
        if roughness > _MIRROR_ROUGHNESS:
            return Diffuse(colour)
        return Mirror(colour, schlick=True)

    def _share(self, name: str, what: str, share: float) -> bool:
        """Whether a material is metal or glass, as its larger part is."""
        if share not in (0.0, 1.0):
            used = what if share >= _HALF else f"no {what}"
            self._substitutions.add(name, f"{share:g} {what}", used)
        return share >= _HALF

    def _glass(self, entry: JsonEntry, colour: Floats) -> Dielectric:
        ior = _extension(entry, "ior").number("ior", 1.5, low=1.0)
        dispersion = _extension(entry, "dispersion").number("dispersion", 0.0, low=0.0)
        return Dielectric(
            Abbe(ior, DISPERSION_TIMES_ABBE / dispersion) if dispersion > 0.0 else ior,
            absorption=_absorption(_extension(entry, "volume")),
            tint=np.sqrt(colour) if self._from_blender else colour,
        )

    def _radiance(self, entry: JsonEntry) -> Floats:
        strength = _extension(entry, "emissive_strength").number("emissiveStrength", 1.0, low=0.0)
        factor = entry.numbers("emissiveFactor", (0.0, 0.0, 0.0), 0.0, 1.0)
        radiance: Floats = factor * strength / self._watts
        return radiance

    def _add_gloss(self, entry: JsonEntry, name: str, roughness: float) -> None:
        specular = _extension(entry, "specular").number("specularFactor", 1.0, 0.0, 1.0)
        if roughness < 1.0 and specular > 0.0:
            self._substitutions.add(name, f"gloss of roughness {roughness:g}", "no gloss")

    def _add_ignored(self, entry: JsonEntry, name: str) -> None:
        for key, used in _TEXTURES.items():
            if key in entry:
                self._substitutions.add(name, key, used)
        base = entry.entry("pbrMetallicRoughness")
        if "metallicRoughnessTexture" in base:
            self._substitutions.add(name, "metallicRoughnessTexture", "the factors alone")
        for extension in entry.entry("extensions").names():
            if extension not in MATERIAL_EXTENSIONS or extension in _IGNORED:
                self._substitutions.add(name, extension, _IGNORED.get(extension, "nothing of it"))
        if entry.text("alphaMode", "OPAQUE") != "OPAQUE":
            self._substitutions.add(name, f"alphaMode {entry.text('alphaMode')}", "opaque")


def _extension(entry: JsonEntry, name: str) -> JsonEntry:
    return entry.entry("extensions").entry(f"KHR_materials_{name}")


def _absorption(volume: JsonEntry) -> Floats:
    """Absorption (3,) of the medium that has a colour after a distance, 1/m."""
    if "attenuationDistance" not in volume:
        return np.zeros(3)
    distance = volume.number("attenuationDistance", math.inf, low=math.ulp(0.0))
    colour = volume.numbers("attenuationColor", (1.0, 1.0, 1.0), 0.0, 1.0)
    return np.log(1.0 / np.maximum(colour, _LEAST_COLOUR)) / distance
