"""Materials of Mitsuba 3 scenes."""

from __future__ import annotations

import numpy as np

from ..._util.validation import Floats
from ...scene.materials import Dielectric, Diffuse, Material, Mirror
from ...scene.textures import Texture
from ..substitutions import Substitutions
from .nodes import Plugin
from .textures import BitmapReader

# Indices of refraction by Mitsuba's names.
_IORS = {
    "vacuum": 1.0,
    "air": 1.000277,
    "ice": 1.31,
    "water": 1.333,
    "acetone": 1.36,
    "ethanol": 1.361,
    "glycerol": 1.4729,
    "benzene": 1.501,
    "pyrex": 1.47,
    "fused quartz": 1.458,
    "acrylic glass": 1.49,
    "polypropylene": 1.49,
    "bk7": 1.5046,
    "sodium chloride": 1.544,
    "amber": 1.55,
    "pet": 1.575,
    "diamond": 2.419,
}
# Reflectances of metals along the normal, linear sRGB.
_METALS = {
    "Ag": (0.972, 0.960, 0.915),
    "Al": (0.913, 0.922, 0.924),
    "Au": (1.0, 0.782, 0.344),
    "Cr": (0.549, 0.556, 0.554),
    "Cu": (0.955, 0.638, 0.538),
}
# BSDFs around another, which is used alone, and BSDFs in place of rough ones.
_WRAPPERS = ("mask", "bumpmap", "normalmap")
_SMOOTH = {"roughconductor": "conductor", "roughdielectric": "dielectric"}
_ABSENT = 0.5
# Names of the diffuse colour, where it is not "diffuse_reflectance".
_ALBEDOS = {"diffuse": "reflectance", "principled": "base_color"}


def material_of(bsdf: Plugin | None, uv: Floats | None, bitmaps: BitmapReader) -> Material | None:
    """Material of a BSDF, Mitsuba's default where there is none; None of one that is not there.

    Parameters
    ----------
    bsdf : Plugin, optional
    uv : (v, 2), optional
        Texture coordinates of the vertices of its shape.
    bitmaps : BitmapReader

    Raises
    ------
    OSError, ValueError
        If a bitmap cannot be read, or a value is none.
    """
    substitutions = bitmaps.substitutions
    if bsdf is None:
        return Diffuse(_ABSENT)
    if bsdf.kind == "null":
        return None
    inner = bsdf.first_of("bsdf")
    if bsdf.kind == "twosided":
        return material_of(inner, uv, bitmaps)
    if bsdf.kind in _WRAPPERS:
        substitutions.add(bsdf.label, bsdf.kind, "the BSDF inside of it")
        return material_of(inner, uv, bitmaps)
    albedo = _ALBEDOS.get(bsdf.kind, "diffuse_reflectance")
    for name, child in bsdf.children.items():
        if child.tag == "texture" and not (name == albedo and child.kind == "bitmap"):
            substitutions.add(bsdf.label, f"texture {child.kind}", "the default colour")
    kind = _SMOOTH.get(bsdf.kind, bsdf.kind)
    if kind != bsdf.kind:
        substitutions.add(bsdf.label, bsdf.kind, f"a smooth {kind}")
    if kind == "diffuse":
        return Diffuse(_albedo(bsdf, albedo, uv, bitmaps))
    if kind == "dielectric":
        return _dielectric(bsdf, substitutions)
    if kind == "conductor":
        return _conductor(bsdf, substitutions)
    if kind == "thindielectric":
        substitutions.add(bsdf.label, kind, "a surface that light passes unchanged")
        return None
    substitutions.add(bsdf.label, kind, "a diffuse surface")
    return Diffuse(_albedo(bsdf, albedo, uv, bitmaps))


def _albedo(bsdf: Plugin, name: str, uv: Floats | None, bitmaps: BitmapReader) -> Texture | Floats:
    child = bsdf.children.get(name)
    if child is None or child.kind != "bitmap":
        return bsdf.colour(name, _ABSENT)
    return bitmaps.texture(child, uv, bsdf.label)


def _dielectric(bsdf: Plugin, substitutions: Substitutions) -> Dielectric:
    if (bsdf.colour("specular_reflectance", 1.0) != 1.0).any():
        substitutions.add(bsdf.label, "specular_reflectance", "Fresnel's")
    return Dielectric(
        _ior(bsdf, "int_ior", "bk7"),
        exterior_ior=_ior(bsdf, "ext_ior", "air"),
        tint=bsdf.colour("specular_transmittance", 1.0),
    )


def _ior(bsdf: Plugin, name: str, default: str) -> float:
    value = bsdf.values.get(name, default)
    if isinstance(value, str) and value.lower() in _IORS:
        return _IORS[value.lower()]
    return bsdf.number(name, 1.0)


def _conductor(bsdf: Plugin, substitutions: Substitutions) -> Mirror:
    factor = bsdf.colour("specular_reflectance", 1.0)
    metal = bsdf.text("material", "none")
    by_index = bool({"eta", "k"} & bsdf.values.keys())
    if metal == "none" and not by_index:
        return Mirror(factor)
    if by_index:
        reflectance, held = _reflectance(bsdf.colour("eta", 0.0), bsdf.colour("k", 1.0)), "eta, k"
    elif metal in _METALS:
        reflectance, held = np.array(_METALS[metal]), f"metal {metal}"
    else:
        raise ValueError(
            f"{bsdf.label}: material should be none or one of {', '.join(_METALS)}, or eta and k "
            f"be given, but is {metal!r}"
        )
    substitutions.add_reading(bsdf.label, held, "reflectance by Schlick's approximation")
    return Mirror(factor * reflectance, schlick=True)


def _reflectance(eta: Floats, k: Floats) -> Floats:
    """Fresnel reflectance along the normal."""
    reflectance: Floats = ((eta - 1.0) ** 2 + k**2) / ((eta + 1.0) ** 2 + k**2)
    return reflectance
