"""The page of a comparison: one file that needs nothing else, pictures and all."""

from __future__ import annotations

import base64
import json
from importlib.resources import files
from typing import Any

from ...estimation.methods import DEFAULT_METHOD
from .images import DIFFERENCE_GAIN

_PLACE = "/* DATA */"


def page(
    about: dict[str, Any],
    table: dict[str, Any],
    pictures: dict[str, dict[str, bytes]],
    photons: list[dict[str, Any]],
) -> str:
    """Return the HTML of a page.

    Parameters
    ----------
    about : dict
        All but the pictures; see `Comparison.to_dict`.
    table : dict
        See `Table.to_dict`.
    pictures : dict
        For each method, and ``reference``, its kinds of pictures as PNG files.
    photons : list of dict
        Pictures of what photons carry, each with ``name``, ``picture`` and ``about``.
    """
    data = {
        "about": about,
        "table": table,
        "gain": DIFFERENCE_GAIN,
        "default": DEFAULT_METHOD,
        "pictures": {
            method: {kind: _uri(picture) for kind, picture in kinds.items()}
            for method, kinds in pictures.items()
        },
        "photons": [{**made, "picture": _uri(made["picture"])} for made in photons],
    }
    template = files(__package__).joinpath("page.html").read_text(encoding="utf-8")
    # Inside a script element nothing may look like its end.
    return template.replace(_PLACE, json.dumps(data, allow_nan=False).replace("<", "\\u003c"))


def _uri(picture: bytes) -> str:
    return f"data:image/png;base64,{base64.b64encode(picture).decode('ascii')}"
