"""The page of a comparison: one file that needs nothing else, pictures and all."""

from __future__ import annotations

import base64
import io
import json
from importlib.resources import files
from typing import Any

from .pictures import DIFFERENCE_GAIN, Bytes

_PLACE = "/* DATA */"


def page(
    about: dict[str, Any],
    table: dict[str, Any],
    pictures: dict[str, dict[str, Bytes]],
    photons: dict[str, dict[str, Any]],
) -> str:
    """Return the HTML of a page.

    Parameters
    ----------
    about : dict
        All but the pictures; see `Comparison.to_dict`.
    table : dict
        See `Table.to_dict`.
    pictures : dict
        For each method, and ``reference``, its kinds of pictures (height, width, 3).
    photons : dict
        Pictures of what photons carry, each with ``picture`` and ``about``.
    """
    data = {
        "about": about,
        "table": table,
        "gain": DIFFERENCE_GAIN,
        "pictures": {
            method: {kind: _uri(picture) for kind, picture in kinds.items()}
            for method, kinds in pictures.items()
        },
        "photons": [
            {"name": name, "picture": _uri(made["picture"]), "about": made["about"]}
            for name, made in photons.items()
        ],
    }
    template = files(__package__).joinpath("page.html").read_text(encoding="utf-8")
    # Inside a script element nothing may look like its end.
    return template.replace(_PLACE, json.dumps(data, allow_nan=False).replace("<", "\\u003c"))


def png(picture: Bytes) -> bytes:
    """Return a picture (height, width, 3) as a PNG file."""
    from PIL import Image

    file = io.BytesIO()
    Image.fromarray(picture).save(file, "PNG", optimize=True)
    return file.getvalue()


def _uri(picture: Bytes) -> str:
    return f"data:image/png;base64,{base64.b64encode(png(picture)).decode('ascii')}"
