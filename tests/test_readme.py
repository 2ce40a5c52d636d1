"""The README's Python runs as printed."""

import re
import shlex
from pathlib import Path

import pytest

from photonrelax.cli import arguments

README = Path(__file__).parents[1] / "README.md"


def test_the_example_runs():
    (example,) = re.findall(r"```python\n(.*?)```", README.read_text(), re.DOTALL)
    names = {}
    exec(example, names)
    assert names["irradiance"].shape == (1, 3)
    assert names["irradiance"].min() > 0.0


COMMANDS = re.findall(r"^photonrelax (.*?)(?:\s+#.*)?$", README.read_text(), re.MULTILINE)


@pytest.mark.parametrize("line", COMMANDS)
def test_commands_are_understood(line):
    parser = arguments.parser(dict.fromkeys(arguments.COMMANDS))
    assert parser.parse_args(shlex.split(line))


def test_files_it_names_exist():
    text = README.read_text()
    for link in re.findall(r"\]\(([^)]+)\)", text):
        assert (README.parent / link).exists(), link
    for name in re.findall(r"`((?:\w+/)*test_\w+\.py)`", text):
        assert (README.parent / "tests" / name).exists(), name
