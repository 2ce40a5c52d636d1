"""Photons of an envelope: well spaced, of equal luminance, for other programs and relaxation."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ..._ext.transport.splitting import sheets
from ..._util.validation import Floats, count
from ...photons.photon_map import PhotonMap
from ...photons.photon_trees import morton_order
from ...transport.emission import MAX_PHOTONS
from .elements import luminances
from .sheets import scattered

if TYPE_CHECKING:
    from .envelope import Envelope

Rows = NDArray[np.intp]
# Columns of photon maps, besides their flux, that those of envelopes have.
_COLUMNS = (
    *("position", "normal", "emitter_coords", "emitter_density"),
    *("emitter_id", "path_signature", "object_id"),
)


def envelope_photons(envelope: Envelope, n: int, n_threads: int) -> PhotonMap:
    """Photons of an envelope, n in all; those of its own photons are chosen among these.

    Along each sheet every part has the photons of its light, to less than one.
    """
    n = count(n, "n", high=MAX_PHOTONS)
    n_rest = _number_of_rest(envelope, n)
    parts = [] if n_rest == n else [_of_images(envelope, n - n_rest, n_threads)]
    if envelope.rest is not None and n_rest:
        parts.append(_thinned(envelope.rest, n_rest))
    return _joined(parts, n)


def _number_of_rest(envelope: Envelope, n: int) -> int:
    """Those of n photons that are chosen among photons without images."""
    if envelope.rest is None:
        return 0
    of_rest = float(luminances(envelope.rest.flux).sum())
    total = of_rest + float(luminances(envelope.flux).sum())
    return min(len(envelope.rest), round(n * of_rest / total))


def _of_images(envelope: Envelope, n: int, n_threads: int) -> PhotonMap:
    luminance = luminances(envelope.flux)
    order = _along_sheets(envelope, n_threads)
    ends = np.cumsum(luminance[order])
    each = ends[-1] / n
    row = order[np.searchsorted(ends, each * (np.arange(n) + 0.5))]
    at = _barycentric(n)
    flux = envelope.flux[row] * (each / luminance[row])[:, np.newaxis]
    flux *= envelope.flux.sum(axis=0) / np.maximum(flux.sum(axis=0), 1e-300)
    coords, sent, emitter_id = _emission(envelope, row, at)
    object_id = np.array([envelope.objects[each] for each in envelope.sheet[row].tolist()])
    signature = sheets(envelope.sheet[row], object_id.astype(np.int32))
    return PhotonMap(
        np.einsum("nk,nkc->nc", at, envelope.position[row]),
        envelope.normal[row],
        flux,
        emitter_coords=coords,
        emitter_density=sent / each,
        emitter_id=emitter_id,
        path_signature=signature.view(np.int64),
        object_id=envelope.surface_ids[object_id],
    )


def _along_sheets(envelope: Envelope, n_threads: int) -> Rows:
    """Rows of the triangles, sheet by sheet, along a curve that keeps neighbours together."""
    middle = envelope.place.mean(axis=1, dtype=np.float64)
    along = np.empty(len(envelope), dtype=np.intp)
    flat = np.column_stack([middle, np.zeros(len(envelope))])
    along[morton_order(flat, n_threads)] = np.arange(len(envelope))
    return np.lexsort((along, envelope.sheet, envelope.chart))


def _barycentric(n: int) -> Floats:
    """Evenly scattered points (n, 3) of triangles."""
    u, v = scattered(n).T
    folded = u + v > 1.0
    u, v = np.where(folded, 1.0 - u, u), np.where(folded, 1.0 - v, v)
    return np.column_stack([1.0 - u - v, u, v])


def _emission(
    envelope: Envelope, row: Rows, at: Floats
) -> tuple[Floats, Floats, NDArray[np.int32]]:
    """Emitter coordinates (n, 2) or (n, 3), luminance around them, W per m² or sr; emitters."""
    place = np.einsum("nk,nkc->nc", at, envelope.place[row])
    chart = envelope.chart[row]
    width = max(each.coords_width for each in envelope.charts)
    coords, sent = np.zeros((len(row), width)), np.empty(len(row))
    for number, each in enumerate(envelope.charts):
        mine = chart == number
        coords[mine, : each.coords_width], sent[mine] = each.coords(place[mine])
    emitters = np.array([each.emitter_id for each in envelope.charts], dtype=np.int32)
    return coords, sent, emitters[chart]


def _thinned(photons: PhotonMap, n: int) -> PhotonMap:
    """Photons, n of them in the order of emission, with the flux of all."""
    assert photons.emitter_density is not None
    rows = (np.arange(n) * len(photons)) // n
    kept = photons.subset(rows)
    scale = photons.flux.sum(axis=0) / np.maximum(kept.flux.sum(axis=0), 1e-300)
    density = photons.emitter_density[rows] * (n / len(photons))
    return kept.replace(flux=kept.flux * scale, emitter_density=density)


def _joined(parts: list[PhotonMap], n: int) -> PhotonMap:
    columns = {name: [getattr(part, name) for part in parts] for name in ("flux", *_COLUMNS)}
    width = max(each.shape[1] for each in columns["emitter_coords"])
    columns["emitter_coords"] = [
        np.pad(each, ((0, 0), (0, width - each.shape[1]))) for each in columns["emitter_coords"]
    ]
    extended = [part.extended_ids for part in parts if part.extended_ids is not None]
    joined: dict[str, Any] = {name: np.concatenate(each) for name, each in columns.items()}
    return PhotonMap(
        **joined,
        n_emitted=n,
        well_spaced=True,
        paths="caustic",
        extended_ids=np.concatenate(extended) if extended else None,
    )
