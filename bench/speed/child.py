"""Measurements in a process of their own, which prints JSON on its last line."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parents[2]


def result(arguments: list[str], environment: dict[str, str]) -> Any:
    """Return the result of ``python -m bench`` with arguments and more of an environment.

    Raises
    ------
    subprocess.CalledProcessError
        If the process fails; its reason is on stderr.
    """
    done = subprocess.run(
        [sys.executable, "-m", "bench", *arguments],
        cwd=ROOT,
        env=os.environ | environment,
        stdout=subprocess.PIPE,
        text=True,
        check=True,
    )
    return json.loads(done.stdout.splitlines()[-1])
