"""Irradiance over the surface of a mesh: means over the texels of its UV chart."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from .._util import validation
from .._util.validation import Floats
from .field import Field
from .irradiance_map import checked_shape

if TYPE_CHECKING:
    import trimesh

Ids = NDArray[np.intp]

# Pairs of a face and a texel looked at together, which bounds memory.
_PAIRS = 1 << 18
# Coordinates of a chart may leave it by this much, through rounding.
_OUTSIDE = 1e-6
# Pieces of a smaller share of a texel are left out.
_LEAST_SHARE = 1e-9
# Faces of a texel are estimated as one where their positions and edges differ by less, over its
# size: estimates allow for the curvature of their footprints.
_CONTINUES = 0.15


@dataclass(frozen=True, eq=False)
class _Pieces:
    """Parts of faces in one texel each.

    texel (p,) is row · nx + column; share (p,) that of the texel's area; centre (p, 2) the centroid
    in the chart, in texels. The face's plane is given by the position at the chart's origin (p, 3)
    and the edges (p, 2, 3) of a texel on it, m; normal (p, 3) is on its front, as long as a texel's
    area.
    """

    texel: Ids
    share: Floats
    centre: Floats
    origin: Floats
    edges: Floats
    normal: Floats

    def __getitem__(self, rows: Ids) -> _Pieces:
        return _Pieces(**{f.name: getattr(self, f.name)[rows] for f in fields(self)})

    def at(self, places: Floats) -> Floats:
        """Positions (p, 3) of places (p, 2) of the chart, in texels."""
        positions: Floats = self.origin + np.einsum("pi,pij->pj", places, self.edges)
        return positions


def lightmap(
    field: Field, mesh: trimesh.Trimesh, shape: tuple[int, int], *, padding: int = 0
) -> tuple[Floats, Floats]:
    """Irradiance over the front of a mesh, as an image on its UV chart.

    Parameters
    ----------
    field : Field
        Of `irradiance_field`.
    mesh : trimesh.Trimesh
        With texture coordinates, ``mesh.visual.uv`` (v, 2) in [0, 1], and faces that wind towards
        the light.
    shape : (int, int)
        Texels (nx, ny) along U and along V.
    padding : int
        Texels around the chart that get the value of the nearest texel in it, so that filters do
        not mix in what is outside.

    Returns
    -------
    irradiance : (ny, nx, 3) float array
        Means over the surface in each texel, W/m²; NaN outside of chart and padding. Row 0 is at
        V = 1, as image files have it. Where a chart overlaps itself it is the mean over all of it.
    coverage : (ny, nx) float array
        Share of each texel that the chart covers, at most 1.

    Raises
    ------
    TypeError, ValueError
        If the mesh has no texture coordinates, some are not finite or outside of [0, 1], the chart
        has no area, or a number is out of its range.
    """
    nx, ny = checked_shape(shape)
    padding = validation.count(padding, "padding", low=0, high=validation.MAX_REPEATS)
    pieces = _merged(_pieces(_chart(mesh, nx, ny), nx, ny), nx)
    # Charts that overlap fill a texel more than once.
    scale = np.sqrt(np.minimum(pieces.share, 1.0))[:, np.newaxis, np.newaxis]
    irradiance = field(pieces.at(pieces.centre), pieces.normal, footprint=scale * pieces.edges)
    weight = pieces.share * np.linalg.norm(pieces.normal, axis=1)
    sums = [np.bincount(pieces.texel, weight * channel, nx * ny) for channel in irradiance.T]
    area, coverage = (np.bincount(pieces.texel, part, nx * ny) for part in (weight, pieces.share))
    with np.errstate(invalid="ignore"):
        image = np.column_stack([channel / area for channel in sums]).reshape(ny, nx, 3)
    return _padded(image, padding), np.minimum(coverage, 1.0).reshape(ny, nx)


def _chart(mesh: trimesh.Trimesh, nx: int, ny: int) -> tuple[Floats, Floats]:
    """Corners of the faces in the chart, (f, 3, 2) in texels, and in space, (f, 3, 3)."""
    uv = getattr(mesh.visual, "uv", None)
    if uv is None:
        raise ValueError(
            "mesh should have texture coordinates, mesh.visual.uv, but has none: give it a chart, "
            "with trimesh's mesh.unwrap() say"
        )
    uv = validation.float_array(uv, "mesh.visual.uv", (len(mesh.vertices), 2))
    if uv.min() < -_OUTSIDE or uv.max() > 1.0 + _OUTSIDE:
        raise ValueError(
            "mesh.visual.uv should lie in [0, 1], as a chart that does not repeat, but ranges from "
            f"{uv.min():g} to {uv.max():g}"
        )
    in_texels = np.clip(np.column_stack([uv[:, 0], 1.0 - uv[:, 1]]), 0.0, 1.0) * (nx, ny)
    faces = np.asarray(mesh.faces)
    chart, corners = in_texels[faces], np.asarray(mesh.vertices)[faces]
    seen = np.flatnonzero((_areas(chart) != 0.0) & _normals(corners).any(axis=1))
    if len(seen) == 0:
        raise ValueError("mesh should have faces with an area on its UV chart, but has none")
    return chart[seen], corners[seen]


def _pieces(chart: tuple[Floats, Floats], nx: int, ny: int) -> _Pieces:
    """The pieces that texels cut faces into."""
    uv, corners = chart
    first = np.minimum(np.floor(uv.min(axis=1)).astype(np.intp), (nx - 1, ny - 1))
    end = np.minimum(np.ceil(uv.max(axis=1)).astype(np.intp), (nx, ny))
    n_across, n_down = np.maximum(end - first, 1).T
    ends = np.cumsum(n_across * n_down)
    found = []
    for start in range(0, int(ends[-1]), _PAIRS):
        pair = np.arange(start, min(start + _PAIRS, int(ends[-1])))
        face = np.searchsorted(ends, pair, side="right")
        row, column = np.divmod(pair - (ends - n_across * n_down)[face], n_across[face])
        corner = first[face] + np.column_stack([column, row])
        share, centre = _overlap(uv[face] - corner[:, np.newaxis])
        kept = np.flatnonzero(share > _LEAST_SHARE)
        found.append((face[kept], corner[kept], share[kept], centre[kept]))
    face, corner, share, centre = (np.concatenate(column) for column in zip(*found, strict=True))
    edges, normal = _texel_edges(uv, corners), _normals(corners)
    origin = corners[:, 0] - np.einsum("fi,fij->fj", uv[:, 0], edges)
    # Of the length of a texel's area.
    normal /= np.abs(_areas(uv))[:, np.newaxis]
    texel = corner[:, 1] * nx + corner[:, 0]
    return _Pieces(texel, share, corner + centre, origin[face], edges[face], normal[face])


def _texel_edges(uv: Floats, corners: Floats) -> Floats:
    """Changes (f, 2, 3) of the position over the width and the height of a texel, m."""
    ab, ac = np.moveaxis(uv[:, 1:] - uv[:, :1], 1, 0)
    along_ab, along_ac = np.moveaxis(corners[:, 1:] - corners[:, :1], 1, 0)
    right = ac[:, 1:] * along_ab - ab[:, 1:] * along_ac
    down = ab[:, :1] * along_ac - ac[:, :1] * along_ab
    return np.stack([right, down], axis=1) / _areas(uv)[:, np.newaxis, np.newaxis]


def _merged(pieces: _Pieces, nx: int) -> _Pieces:
    """Pieces of a texel that continue its largest one as one with that."""
    pieces = pieces[np.lexsort((-pieces.share, pieces.texel))]
    is_first = np.diff(pieces.texel, prepend=-1) != 0
    of_texel, first = np.cumsum(is_first) - 1, np.flatnonzero(is_first)
    continues = _continue(pieces, pieces[first[of_texel]], nx)
    of_texel, parts = of_texel[continues], pieces[np.flatnonzero(continues)]
    share = np.bincount(of_texel, parts.share).astype(np.float64)
    centre = [np.bincount(of_texel, parts.share * at) / share for at in parts.centre.T]
    whole = replace(pieces[first], share=share, centre=np.column_stack(centre))
    others = pieces[np.flatnonzero(~continues)]
    columns = ((getattr(whole, f.name), getattr(others, f.name)) for f in fields(_Pieces))
    return _Pieces(*map(np.concatenate, columns))


def _continue(pieces: _Pieces, largest: _Pieces, nx: int) -> NDArray[np.bool_]:
    """Mask (p,) of the pieces that continue the largest of their texels."""
    row, column = np.divmod(pieces.texel, nx)
    middle = np.column_stack([column, row]) + 0.5
    size = np.linalg.norm(largest.edges, axis=2).max(axis=1)
    apart = np.linalg.norm(pieces.at(middle) - largest.at(middle), axis=1)
    turned = np.linalg.norm(pieces.edges - largest.edges, axis=2).max(axis=1)
    same_side = np.einsum("pi,pi->p", pieces.normal, largest.normal) > 0.0
    continues: NDArray[np.bool_] = (np.maximum(apart, turned) <= _CONTINUES * size) & same_side
    return continues


def _overlap(triangles: Floats) -> tuple[Floats, Floats]:
    """Areas (p,) and centroids (p, 2) of what triangles (p, 3, 2) have in the unit square.

    By Green's theorem, an integral along each edge of what lies under it in the square: with y
    clamped to [0, 1] an edge has up to three straight parts.
    """
    moments = np.zeros((3, len(triangles)))
    for i in range(3):
        moments += _under_edge(triangles[:, i], triangles[:, (i + 1) % 3])
    area = np.abs(moments[0])
    with np.errstate(invalid="ignore", divide="ignore"):
        centroid = (moments[1:] / moments[0]).T
    return area, np.clip(np.nan_to_num(centroid), 0.0, 1.0)


def _under_edge(a: Floats, b: Floats) -> Floats:
    """Area and first moments (3, p) between edges from a to b and the axis, in the unit square."""
    step = b - a
    with np.errstate(invalid="ignore", divide="ignore"):
        crossings = [((at - a) / step) for at in (0.0, 1.0)]
    inner = [np.where(np.isfinite(t), np.clip(t, 0.0, 1.0), 0.0) for t in crossings]
    zeros = np.zeros(len(a))
    t = np.sort([zeros, *(t[:, axis] for t in inner for axis in (0, 1)), zeros + 1.0], axis=0)
    x, y = (np.clip(a[:, axis] + t * step[:, axis], 0.0, 1.0) for axis in (0, 1))
    width, (x0, x1), (y0, y1) = np.diff(x, axis=0), (x[:-1], x[1:]), (y[:-1], y[1:])
    area = width * (y0 + y1) / 2.0
    moment_x = width * (x0 * (2.0 * y0 + y1) + x1 * (y0 + 2.0 * y1)) / 6.0
    moment_y = width * (y0 * y0 + y0 * y1 + y1 * y1) / 6.0
    return np.array([area.sum(axis=0), moment_x.sum(axis=0), moment_y.sum(axis=0)])


def _padded(image: Floats, padding: int) -> Floats:
    """Image with texels that are NaN but no farther than `padding` from others filled by these."""
    empty = np.isnan(image[..., 0])
    if padding == 0 or not empty.any():
        return image
    from scipy.ndimage import distance_transform_edt

    distance, (row, column) = distance_transform_edt(empty, return_indices=True)
    return np.where((distance <= padding)[..., np.newaxis], image[row, column], np.nan)


def _areas(uv: Floats) -> Floats:
    """Twice the signed areas (f,) of triangles (f, 3, 2)."""
    ab, ac = uv[:, 1] - uv[:, 0], uv[:, 2] - uv[:, 0]
    areas: Floats = ab[:, 0] * ac[:, 1] - ab[:, 1] * ac[:, 0]
    return areas


def _normals(corners: Floats) -> Floats:
    """Normals (f, 3) by the winding of triangles (f, 3, 3), twice as long as their areas."""
    normals: Floats = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    return normals
