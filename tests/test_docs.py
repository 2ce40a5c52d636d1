"""README and docs: their Python runs, their commands parse, what they name exists."""

import re
import shlex
from dataclasses import fields
from operator import attrgetter
from pathlib import Path

import pytest
from bench import __main__ as bench

import photonrelax as pr
from photonrelax import gallery
from photonrelax.cli import arguments
from photonrelax.estimation.methods import METHODS
from photonrelax.rendering.layers import LAYERS

ROOT = Path(__file__).parents[1]
README = ROOT / "README.md"
PAGES = [README, *sorted((ROOT / "docs").rglob("*.md"))]
NAMES = [str(page.relative_to(ROOT)) for page in PAGES]
# Paths in backticks are below one of these.
PACKAGE = ROOT / "src" / "photonrelax"
ROOTS = (ROOT, PACKAGE, PACKAGE / "_ext" / "spatial")
# Written by commands.
GENERATED = ("build/",)
# Settings classes by stage.
SETTINGS = {
    re.sub(r"\B(?=[A-Z])", "_", name.removesuffix("Settings")).lower(): getattr(pr, name)
    for name in pr.__all__
    if name.endswith("Settings")
}


def blocks(page, language):
    """The fenced blocks of a page in a language, as text."""
    return re.findall(rf"^ *```{language}\n(.*?)^ *```", page.read_text(), re.DOTALL | re.MULTILINE)


def commands(program):
    """The command lines of all pages that start with a program, without it and comments."""
    return [
        line.removeprefix(program).split(" #")[0]
        for page in PAGES
        for block in blocks(page, "sh")
        for line in block.splitlines()
        if line.startswith(program)
    ]


def prose(page):
    """A page without its fenced blocks."""
    return re.sub(r"^ *```.*?^ *```", "", page.read_text(), flags=re.DOTALL | re.MULTILINE)


def anchors(page):
    """The anchors that GitHub gives the headings of a page."""
    titles = re.findall(r"^#+ (.*)$", prose(page), re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", title.lower()).replace(" ", "-") for title in titles}


@pytest.fixture
def coarse_scenes(monkeypatch):
    """Built-in scenes of fewer faces, so that examples take no longer than they must."""
    build, coarser = gallery.scene, {"subdivisions": 5}
    sizes = {"prism": coarser, "sphere": coarser}
    monkeypatch.setattr(
        gallery, "scene", lambda name, **given: build(name, **sizes.get(name, {}) | given)
    )


@pytest.mark.usefixtures("coarse_scenes")
def test_the_example_of_the_readme_runs():
    (example,) = blocks(README, "python")
    names = {}
    exec(example, names)
    assert names["irradiance"].shape == (1, 3)
    assert names["irradiance"].min() > 0.0


EXAMPLES = [page for page in PAGES[1:] if blocks(page, "python")]


@pytest.mark.usefixtures("coarse_scenes")
@pytest.mark.parametrize("page", EXAMPLES, ids=lambda page: page.stem)
def test_examples_run_in_order(page, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    names = {}
    for example in blocks(page, "python"):
        exec(compile(example, page.name, "exec"), names)


@pytest.mark.parametrize("line", commands("photonrelax "))
def test_commands_are_understood(line):
    parser = arguments.parser(dict.fromkeys(arguments.COMMANDS))
    assert parser.parse_args(shlex.split(line))


@pytest.mark.parametrize("line", commands("python -m bench "))
def test_benchmarks_are_understood(line):
    assert bench.parsed(shlex.split(line))


@pytest.mark.parametrize("page", PAGES, ids=NAMES)
def test_links_lead_somewhere(page):
    for link in re.findall(r"\]\(([^)]+)\)", prose(page)):
        if link.startswith("https://"):
            continue
        path, _, anchor = link.partition("#")
        target = (page.parent / path).resolve() if path else page
        assert target.exists(), link
        if anchor:
            assert anchor in anchors(target), link


@pytest.mark.parametrize("page", PAGES, ids=NAMES)
def test_files_it_names_exist(page):
    for name in re.findall(r"`([\w.-]+(?:/[\w.-]+)+/?)`", prose(page)):
        found = any((root / name).exists() for root in ROOTS)
        assert found or name.startswith(GENERATED), name


@pytest.mark.parametrize("page", PAGES, ids=NAMES)
def test_public_names_it_uses_exist(page):
    for name in re.findall(r"`pr\.([\w.]+)", prose(page)):
        assert attrgetter(name)(pr), name


def tables(page):
    """The tables of a page: titles of columns, and rows of cells."""
    for lines in re.findall(r"(?:^\|.*\n)+", prose(page), re.MULTILINE):
        cells = [[cell.strip() for cell in line.split(" | ")] for line in lines.splitlines()]
        yield [cell.strip("| ") for cell in cells[0]], cells[2:]


LOCATED = [
    (row[titles.index("function")], row[titles.index("file")])
    for page in PAGES
    for titles, rows in tables(page)
    if {"function", "file"} <= {*titles}
    for row in rows
]


@pytest.mark.parametrize(("functions", "files"), LOCATED)
def test_functions_are_in_the_files_beside_them(functions, files):
    paths = [root / name for name in re.findall(r"`([^`]+)`", files) for root in ROOTS]
    source = "\n".join(path.read_text() for path in paths if path.exists())
    for name in re.findall(r"`(\w+)`", functions):
        assert re.search(rf"^\s*(?:c?p?def|class|static)\b.*\b{name}\b", source, re.M), name


def test_every_setting_is_on_a_page_with_its_default():
    row = re.compile(rf"^\| `({'|'.join(SETTINGS)})\.(\w+)` \| (.*?) \|", re.MULTILINE)
    found = {
        (stage, name): default
        for page in PAGES
        for stage, name, default in row.findall(page.read_text())
    }
    expected = {
        (stage, field.name): str(field.default)
        for stage, kind in SETTINGS.items()
        for field in fields(kind)
    }
    assert found == expected


ARCHITECTURE = (ROOT / "docs" / "architecture.md").read_text()


@pytest.mark.parametrize(
    "name", [*(field.name for field in fields(pr.PhotonMap)), *LAYERS, *METHODS]
)
def test_the_architecture_names_fields_layers_and_methods(name):
    assert name == "ledger" or f"`{name}`" in ARCHITECTURE


def test_the_architecture_names_every_folder():
    folders = {path.parent.relative_to(PACKAGE) for path in PACKAGE.rglob("*.py")}
    named = {Path(name) for name in re.findall(r"`([\w/]+)/`", ARCHITECTURE)}
    mirrors = {path for path in folders if path.parts[:1] == ("_ext",)}
    assert folders - mirrors - named - {Path()} == set()
