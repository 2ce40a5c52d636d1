"""The README's Python runs as printed."""

import re
from pathlib import Path

README = Path(__file__).parents[1] / "README.md"


def test_the_example_runs():
    (example,) = re.findall(r"```python\n(.*?)```", README.read_text(), re.DOTALL)
    names = {}
    exec(example, names)
    assert names["irradiance"].shape == (1, 3)
    assert names["irradiance"].min() > 0.0


def test_files_it_names_exist():
    text = README.read_text()
    for link in re.findall(r"\]\(([^)]+)\)", text):
        assert (README.parent / link).exists(), link
    for name in re.findall(r"\| `(test_\w+\.py)` \|", text):
        assert (README.parent / "tests" / name).exists(), name
