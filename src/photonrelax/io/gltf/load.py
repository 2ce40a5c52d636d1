"""Scenes of glTF 2.0 files."""

from __future__ import annotations

from pathlib import Path

from ...scene.scene import Scene
from ..options import LoadOptions
from ..substitutions import Substitutions
from .cameras import cameras_of, chosen_camera
from .exact import decoded
from .file import GltfFile
from .lights import EXTENSION as LIGHTS
from .lights import emitters_of
from .materials import MATERIAL_EXTENSIONS, MaterialReader
from .nodes import INSTANCES, placed_nodes
from .objects import ObjectBuilder
from .textures import TRANSFORM, WEBP, TextureReader

# Extensions that a file may require.
_KNOWN = {LIGHTS, TRANSFORM, WEBP, INSTANCES, "KHR_mesh_quantization", *MATERIAL_EXTENSIONS}


def load_gltf(path: Path, options: LoadOptions) -> Scene:
    """Scene of a glTF file; what it holds and a scene cannot is one warning.

    Raises
    ------
    OSError
        If the file, or one that it names, cannot be read.
    ValueError
        If it is damaged, requires an extension that is not known, or has no object or no light;
        with ``strict``, if it holds what a scene cannot.
    """
    options.refuse_arguments(path)
    file = GltfFile(path)
    _check_extensions(file)
    exact = decoded(file)
    if exact is not None:
        return _with_camera(path, exact, options.camera)
    nodes = placed_nodes(file)
    camera = chosen_camera(path, cameras_of(file, nodes), options.camera)
    substitutions = Substitutions()
    _add_ignored(file, substitutions)
    generator = file.root.entry("asset").text("generator")
    materials = MaterialReader(
        generator, options.light_units, TextureReader(file, substitutions), substitutions
    )
    built = ObjectBuilder(file, materials, substitutions, options.maker).build(nodes)
    emitters = built.emitters + emitters_of(file, nodes, options.light_units, substitutions)
    if not built.objects:
        raise ValueError(
            f"{path} should have a mesh of triangles that emits no light, but has none"
        )
    if not emitters:
        raise ValueError(
            f"{path} should have a light, but has none: export the lights of the scene "
            f"({LIGHTS}), or a material that emits"
        )
    substitutions.report(path, options.strict)
    return Scene(built.objects, emitters, camera, path.stem)


def _with_camera(path: Path, scene: Scene, name: str | None) -> Scene:
    """The scene; raises ValueError if a camera is asked for, of which it has no names."""
    if name is not None:
        raise ValueError(f"{path} has the one camera of its scene, but camera is {name!r}")
    return scene


def _check_extensions(file: GltfFile) -> None:
    unknown = [each for each in file.root.texts("extensionsRequired") if each not in _KNOWN]
    if unknown:
        raise ValueError(
            f"{file.path} requires extensions of glTF that are not known: {', '.join(unknown)}. "
            "Export it without them, compression for one"
        )


def _add_ignored(file: GltfFile, substitutions: Substitutions) -> None:
    if file.entries("animations"):
        substitutions.add("scene", "animations", "the scene at rest")
    for extension in file.root.texts("extensionsUsed"):
        if extension not in _KNOWN:
            substitutions.add("scene", extension, "nothing of it")
