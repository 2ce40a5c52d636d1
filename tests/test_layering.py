"""Imports go one way: from the command line down the pipeline to the kernels."""

import ast
import subprocess
import sys
from functools import cache
from graphlib import TopologicalSorter
from pathlib import Path

import pytest

import photonrelax

PACKAGE = Path(photonrelax.__file__).parent
# Folders that may import those of the tiers above them in this list, and themselves.
TIERS = [
    {"_ext", "_version"},
    {"_util"},
    {"imaging"},
    {"scene", "spatial"},
    {"photons"},
    {"transport", "surfaces"},
    {"relaxation", "gallery"},
    {"io"},
    {"estimation"},
    {"rendering"},
    {"evaluation"},
    {"cli"},
    {"__main__"},
]
TIER = {folder: tier for tier, folders in enumerate(TIERS) for folder in folders}
# The modules that alone may import a library; the kernels have no Python to look at.
OWNERS = {
    "embreex": "transport.raycast",
    "trimesh.ray": "transport.raycast",
    "OpenEXR": "imaging.image",
    "skimage": "imaging.metrics",
    "flip_evaluator": "imaging.metrics",
}
FILES = [path for path in PACKAGE.rglob("*.py") if path != PACKAGE / "__init__.py"]


def parts_of(path):
    """The folders and the module's own name, below the package."""
    return path.relative_to(PACKAGE).with_suffix("").parts


@cache
def imports(path):
    """The dotted names that a file imports, also in functions, but not for types alone."""
    return tuple(_imports(path))


def _imports(path):
    tree = ast.parse(path.read_text())
    for_types = {
        id(child)
        for node in ast.walk(tree)
        if isinstance(node, ast.If) and "TYPE_CHECKING" in ast.unparse(node.test)
        for child in ast.walk(node)
    }
    folders = ("photonrelax", *parts_of(path)[:-1])
    for node in ast.walk(tree):
        if id(node) in for_types:
            continue
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            base = folders[: len(folders) - node.level + 1] if node.level else ()
            module = ".".join([*base, *([node.module] if node.module else [])])
            yield from (f"{module}.{alias.name}" for alias in node.names)


def inner(path):
    """The names below the package that a file imports, each as a tuple of its parts."""
    names = (name.split(".") for name in imports(path))
    return [tuple(parts[1:]) for parts in names if parts[0] == "photonrelax"]


def module_of(parts):
    """The module that an imported name lies in: the longest prefix that is one."""
    for n in range(len(parts), 0, -1):
        path = PACKAGE.joinpath(*parts[:n])
        if path.with_suffix(".py").exists() or path.with_suffix(".pyx").exists():
            return parts[:n]
        if (path / "__init__.py").exists():
            return (*parts[:n], "__init__")
    return ()


@pytest.mark.parametrize("path", FILES, ids=lambda p: ".".join(parts_of(p)))
def test_a_folder_imports_itself_and_the_tiers_below(path):
    own = parts_of(path)[0]
    for parts in filter(None, inner(path)):
        below = parts[0] == own or TIER[parts[0]] < TIER[own]
        assert below, f"{'.'.join(parts_of(path))} imports {'.'.join(parts)}"


@pytest.mark.parametrize("path", FILES, ids=lambda p: ".".join(parts_of(p)))
def test_below_the_command_line_nothing_imports_the_package_itself(path):
    if parts_of(path)[0] != "cli":
        assert () not in inner(path)


def test_every_folder_has_a_tier():
    assert {parts_of(path)[0] for path in FILES} == set(TIER)


def test_no_module_imports_itself_through_others():
    graph = {}
    for path in FILES:
        own = parts_of(path)
        graph[own] = {module_of(parts) for parts in inner(path)} - {own, ()}
    TopologicalSorter(graph).prepare()


def test_no_folder_imports_itself_through_others():
    graph = {}
    for path in FILES:
        own = parts_of(path)[0]
        graph.setdefault(own, set()).update({p[0] for p in inner(path) if p} - {own})
    TopologicalSorter(graph).prepare()


@pytest.mark.parametrize("library", OWNERS)
def test_one_module_alone_knows_each_outer_library(library):
    users = {
        ".".join(parts_of(path))
        for path in FILES
        if any(f"{name}.".startswith(f"{library}.") for name in imports(path))
    }
    assert users <= {OWNERS[library]}


def test_kernels_are_imported_by_the_folder_that_they_mirror_and_those_above():
    for path in FILES:
        own = parts_of(path)[0]
        for parts in inner(path):
            if parts[:1] == ("_ext",):
                mirrored = parts[1] if parts[1] != "common" else "_util"
                assert TIER[mirrored] <= TIER[own], f"{'.'.join(parts_of(path))} imports {parts}"


def test_every_public_name_loads():
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
