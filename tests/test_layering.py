"""Imports go one way, from the pipeline down to the kernels."""

import ast
import subprocess
import sys
from graphlib import TopologicalSorter
from pathlib import Path

import pytest

import photonrelax

PACKAGE = Path(photonrelax.__file__).parent
TIERS = [
    {"_ext"},
    {
        "_arrays",
        "_files",
        "_interrupts",
        "_meshes",
        "_progress",
        "sampling",
        "optics",
        "image",
        "measures",
        "spectrum",
    },
    {"kdtree", "raycast", "scene"},
    {"camera", "emit", "photonmap", "_checkpoint"},
    {
        "_bandwidths",
        "_facing",
        "_sheets",
        "_surfaces",
        "_curvature",
        "_followed",
        "_spectra",
        "trace",
        "structure",
        "gradient",
        "relax",
        "adaptive",
        "estimate",
        "diffusion",
    },
    {"dealing", "progressive", "frequency"},
    {"methods", "picture"},
    {"render", "gallery", "_hits"},
    {"passes"},
    {"compare"},
    {"cli", "_bars", "_options", "_settings", "_text", "__main__"},
]
TIER = {module: tier for tier, modules in enumerate(TIERS) for module in modules}
OWNERS = {"embreex": {"raycast"}, "trimesh.ray": {"raycast"}, "OpenEXR": {"image"}}
OWNERS |= {"skimage": {"measures"}, "flip_evaluator": {"measures"}}


def module_of(path):
    first = path.relative_to(PACKAGE).parts[0]
    return first.removesuffix(".py")


def imports(path):
    """Yield the dotted names a file imports, also inside functions, but not for types alone."""
    tree = ast.parse(path.read_text())
    for_types = {
        id(child)
        for node in ast.walk(tree)
        if isinstance(node, ast.If) and "TYPE_CHECKING" in ast.unparse(node.test)
        for child in ast.walk(node)
    }
    depth = len(path.relative_to(PACKAGE).parts)
    for node in ast.walk(tree):
        if id(node) in for_types:
            continue
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.level == 0:
            yield from (f"{node.module}.{alias.name}" for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.level == depth:
            base = f"photonrelax.{node.module}" if node.module else "photonrelax"
            yield from (f"{base}.{alias.name}" for alias in node.names)


FILES = [path for path in PACKAGE.rglob("*.py") if path != PACKAGE / "__init__.py"]


@pytest.mark.parametrize("path", FILES, ids=lambda p: str(p.relative_to(PACKAGE)))
def test_a_module_imports_only_its_tier_and_those_below(path):
    own = TIER[module_of(path)]
    for name in imports(path):
        parts = name.split(".")
        if parts[0] == "photonrelax" and len(parts) > 1 and parts[1] in TIER:
            assert TIER[parts[1]] <= own, f"{path.name} imports {name}"


def test_no_module_imports_itself_through_others():
    graph = {}
    for path in FILES:
        inner = (name.split(".") for name in imports(path))
        used = {p[1] for p in inner if p[0] == "photonrelax" and len(p) > 1 and p[1] in TIER}
        graph.setdefault(module_of(path), set()).update(used - {module_of(path)})
    TopologicalSorter(graph).prepare()


@pytest.mark.parametrize("library", OWNERS)
def test_one_module_alone_knows_each_outer_library(library):
    for path in FILES:
        if any(f"{name}.".startswith(f"{library}.") for name in imports(path)):
            assert module_of(path) in OWNERS[library]


def test_every_public_name_loads_and_functions_hide_their_modules():
    for name in photonrelax.__all__:
        assert getattr(photonrelax, name) is not None
    assert callable(photonrelax.relax)
    assert callable(photonrelax.render)
    with pytest.raises(AttributeError, match="no attribute 'nonsense'"):
        _ = photonrelax.nonsense


def test_importing_the_package_is_cheap():
    code = "import sys, photonrelax; print(*sys.modules)"
    loaded = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True
    )
    heavy = {"numpy", "scipy", "trimesh", "matplotlib", "OpenEXR", "PIL"}
    assert not heavy & set(loaded.stdout.split())


def test_the_gallery_needs_no_import_of_its_own():
    code = "import photonrelax as pr; print(*pr.gallery.names())"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert "prism" in done.stdout.split()
