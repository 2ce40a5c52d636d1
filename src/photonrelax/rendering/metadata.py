"""Image metadata as text."""

from __future__ import annotations

import json
from typing import Any

from .._version import __version__
from ..photons.blocks import BlockedPhotons
from ..photons.photon_map import PhotonMap


def ledger_values(photons: PhotonMap) -> dict[str, Any] | None:
    """Energy ledger of photons for JSON, None if they have none."""
    return None if photons.ledger is None else photons.ledger.to_dict()


def photon_metadata(photons: PhotonMap | BlockedPhotons, **others: Any) -> dict[str, str]:
    """Metadata of an image of a photon map."""
    head = photons.photons(0, 0) if isinstance(photons, BlockedPhotons) else photons
    return metadata(
        photons_emitted=head.n_emitted,
        photons_stored=len(photons),
        ledger=ledger_values(head),
        **{name: getattr(head, name) for name in ("seed", "sampler", "paths")},
        **others,
    )


def metadata(**values: Any) -> dict[str, str]:
    """Metadata of an image, with the version of the package.

    As text, since integers of EXR headers wrap at 32 bits.
    """
    values = {"version": __version__, **values}
    return {f"photonrelax.{name}": _text(value) for name, value in values.items()}


def _text(value: Any) -> str:
    """Text as it is, other values as JSON. JSON has no infinity: null."""
    if isinstance(value, str):
        return value
    finite = json.loads(json.dumps(value), parse_constant=lambda name: None)
    return json.dumps(finite)
