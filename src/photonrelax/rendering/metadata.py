"""Image metadata as text."""

from __future__ import annotations

import json
from typing import Any

from .._version import __version__
from ..photons.photon_map import PhotonMap


def _ledger(photons: PhotonMap) -> dict[str, Any] | None:
    return None if photons.ledger is None else photons.ledger.to_dict()


def photon_header(photons: PhotonMap, **others: Any) -> dict[str, str]:
    """Return what the header of a picture says, of the photons it was made from as well."""
    return header(
        photons_emitted=photons.n_emitted,
        photons_stored=len(photons),
        ledger=_ledger(photons),
        **{name: getattr(photons, name) for name in ("seed", "sampler", "paths")},
        **others,
    )


def header(**values: Any) -> dict[str, str]:
    """Return what is told of a picture as its metadata; as text, since integers of EXR headers
    wrap at 32 bits.
    """
    values = {"version": __version__, **values}
    return {f"photonrelax.{name}": _text(value) for name, value in values.items()}


def _text(value: Any) -> str:
    """Return text as it is and anything else as JSON, which has no word for infinity but null."""
    if isinstance(value, str):
        return value
    finite = json.loads(json.dumps(value), parse_constant=lambda name: None)
    return json.dumps(finite)
