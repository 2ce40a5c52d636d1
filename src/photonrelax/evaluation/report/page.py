"""Self-contained HTML page of a comparison."""

from __future__ import annotations

import base64
import json
from importlib.resources import files
from typing import Any

from ...estimation.methods import DEFAULT_METHOD
from .images import DIFFERENCE_GAIN

_DATA = "/* DATA */"


def page(
    about: dict[str, Any],
    table: dict[str, Any],
    images: dict[str, dict[str, bytes]],
    photons: list[dict[str, Any]],
) -> str:
    """HTML of the page.

    Parameters
    ----------
    about : dict
        `Comparison.to_dict`.
    table : dict
        `Table.to_dict`.
    images : dict
        Images as PNG files by kind, for each method and ``reference``.
    photons : list of dict
        Images of photon attributes, each with ``name``, ``image``, a PNG file, and ``about``.
    """
    data = {
        "about": about,
        "table": table,
        "gain": DIFFERENCE_GAIN,
        "default": DEFAULT_METHOD,
        "images": {
            method: {kind: _data_uri(image) for kind, image in kinds.items()}
            for method, kinds in images.items()
        },
        "photons": [{**each, "image": _data_uri(each["image"])} for each in photons],
    }
    template = files(__package__).joinpath("page.html").read_text(encoding="utf-8")
    # Escaped: a script element must not contain its end tag.
    return template.replace(_DATA, json.dumps(data, allow_nan=False).replace("<", "\\u003c"))


def _data_uri(png: bytes) -> str:
    return f"data:image/png;base64,{base64.b64encode(png).decode('ascii')}"
