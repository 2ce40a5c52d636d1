"""Materials of a scene's objects, and their functions for arrays of rays.

Every loop body writes only row i.
"""

from collections import namedtuple

cimport cython
from libc.stdint cimport INT32_MAX, int32_t, uint8_t, uint64_t

import numpy as np

from ..common.vec3 cimport dot
from ..scene.dispersion cimport N_NODES
from .media cimport current

# The kinds of `scene.materials.MaterialTable`.
KINDS = {"diffuse": DIFFUSE, "mirror": MIRROR, "dielectric": DIELECTRIC, "sensor": SENSOR}

Interfaces = namedtuple("Interfaces", "normal is_shading n1 n2 reflected rising beyond")
Interfaces.__doc__ = """Specular surfaces that m rays meet.

normal (m, 3) faces the rays; is_shading (m,) flags where it is the interpolated one. n1, n2 (m,)
are the indices of refraction on the side of the ray and beyond, `reflected` (m,) the shares of the
light that are reflected by dielectrics, 1 for mirrors; `rising` (m, 3) the reflectances of those
that rise at grazing angles, 1 for others; and `beyond` (m,) the media that refracted rays are in.
"""


@cython.final
cdef class Materials:
    """Materials of n objects; `table` is their `MaterialTable`.

    `bits` is the number of bits of a medium in a stack, by the number of dielectrics.
    """

    def __init__(self, table):
        self.table = table
        self.kind = np.array([KINDS[kind] for kind in table.kind], dtype=np.int32)
        self.reflectance, self.exterior_ior = table.reflectance, table.exterior_ior
        self.tint = table.tint
        self.is_tinted = (table.tint != 1.0).any(axis=1).astype(np.uint8)
        self.is_schlick = table.schlick.astype(np.uint8)
        dielectrics = self.dielectrics
        numbers = np.zeros(len(table.kind), np.uint64)
        numbers[dielectrics] = 1 + np.arange(len(dielectrics))
        self.medium = numbers
        self.bits = next(bits for bits in (8, 16, 32) if len(dielectrics) < 1 << bits)
        absorption = np.concatenate([np.zeros((1, 3)), table.absorption[dielectrics]])
        self.medium_ior = np.concatenate([[1.0], table.ior[dielectrics]])
        self.absorption = absorption
        self.set_dispersions([table.dispersed_ior[i] for i in dielectrics])
        self.is_absorbing = absorption.any(axis=1).astype(np.uint8)
        self.set_textures(table.textures)
        self.set_ranks(table.priority[dielectrics], dielectrics)

    def set_dispersions(self, dispersions):
        """Set the tables of the indices of media, each (nodes,) or None."""
        curve = np.full(1 + len(dispersions), -1, np.int32)
        tables = [(i, each) for i, each in enumerate(dispersions) if each is not None]
        for row, (i, _) in enumerate(tables):
            curve[1 + i] = row
        self.curve, self.has_dispersion = curve, len(tables) > 0
        self.dispersed_ior = np.array([each for _, each in tables]).reshape(-1, N_NODES)

    def set_textures(self, textures):
        """Point to the textures of objects, each a `FaceTexture` or None."""
        cdef TextureView* view
        cdef const uint8_t[:, :, ::1] bytes
        cdef const float[:, :, ::1] floats
        cdef const double[::1] meaning
        cdef const double[:, :, ::1] uv
        cdef Py_ssize_t i
        cdef int c
        self.is_textured = np.array([each is not None for each in textures], np.uint8)
        self.view_memory = np.zeros(max(len(textures), 1) * sizeof(TextureView), np.uint8)
        view = <TextureView*> &self.view_memory[0]
        self.view, self.arrays = view, []
        for i, each in enumerate(textures):
            if each is None:
                continue
            image, meaning, uv = each.texture.image, each.texture.meaning, each.uv
            self.arrays.append((image, meaning.base, uv.base))
            if image.dtype == np.uint8:
                bytes = image
                view[i].bytes = &bytes[0, 0, 0]
            else:
                floats = image
                view[i].floats = &floats[0, 0, 0]
            view[i].height, view[i].width = image.shape[:2]
            view[i].meaning, view[i].uv = &meaning[0], &uv[0, 0, 0]
            view[i].wrap_u, view[i].wrap_v = each.texture.wraps
            for c in range(3):
                view[i].factor[c] = each.texture.factor[c]

    def set_ranks(self, priority, dielectrics):
        """Set the ranks of media and of surfaces by the priorities (m,) of the dielectrics.

        Surfaces with indices of their own, and those of other materials, are there in all media.
        """
        _, rank = np.unique(priority, return_inverse=True)
        surface = np.full(len(self.kind), INT32_MAX, np.int32)
        surface[dielectrics] = rank
        surface[~np.isnan(self.exterior_ior)] = INT32_MAX
        self.rank, self.surface_rank = np.concatenate([[-1], rank]).astype(np.int32), surface
        self.has_hidden = surface.min(initial=INT32_MAX) < rank.max(initial=-1)

    @property
    def diffuse(self):
        """Flags (n,) of the diffuse objects, on which photons and camera rays end."""
        return np.asarray(self.kind) == DIFFUSE

    @property
    def dielectrics(self):
        """Ids (m,) of the objects that are media; those of a stack count from 1 in this order."""
        return np.flatnonzero(np.asarray(self.kind) == DIELECTRIC)

    @property
    def max_depth(self):
        """Number of media that a ray can be in at once."""
        return 64 // self.bits

    def arrive(self, const double[:, ::1] direction, hits, const uint64_t[::1] media):
        """Media (m,) that rays were in up to their hits, and what these transmitted (m, 3).

        `media` (m,) are those where the rays started.
        """
        cdef const int32_t[::1] object_id = hits.object_id
        cdef const double[:, ::1] geometric = hits.geometric_normal
        cdef const double[::1] distance = hits.distance
        cdef Py_ssize_t i, m = direction.shape[0]
        cdef uint64_t[::1] at_hit = np.empty(m, np.uint64)
        cdef double[:, ::1] transmitted = np.ones((m, 3))
        cdef bint inside
        check_rows(m, direction.shape[1], hits, media)
        with nogil:
            for i in range(m):
                inside = dot(&direction[i, 0], &geometric[i, 0]) > 0.0
                at_hit[i] = media_at(self, object_id[i], inside, media[i])
                if is_absorbing(self, at_hit[i]):
                    transmittance(&transmitted[i, 0], self, at_hit[i], distance[i])
        return at_hit.base, transmitted.base

    def pass_hidden(self, const double[:, ::1] direction, hits, uint64_t[::1] media):
        """Rows (k,) of rays (m, 3) whose hits are of surfaces that are not there.

        `media` (m,), where the rays started, become those beyond for these rays.
        """
        cdef const int32_t[::1] object_id = hits.object_id
        cdef const double[:, ::1] geometric = hits.geometric_normal
        cdef Py_ssize_t i, k = 0, m = direction.shape[0]
        cdef Py_ssize_t[::1] rows = np.empty(m, np.intp)
        cdef Faults faults = Faults(len(self.kind))
        cdef bint inside
        check_rows(m, direction.shape[1], hits, media)
        with nogil:
            for i in range(m):
                if object_id[i] >= 0 and is_hidden(self, object_id[i], media[i]):
                    inside = dot(&direction[i, 0], &geometric[i, 0]) > 0.0
                    media[i] = beyond_hidden(self, faults, object_id[i], inside, media[i])
                    rows[k] = i
                    k += 1
        return rows.base[:k]

    def absorption_in(self, uint64_t media):
        """Absorption (3,) of the medium that rules in a stack, 1/m."""
        return np.array(self.absorption[current(media, self.bits)])

    def interfaces(self, const double[:, ::1] direction, hits, const uint64_t[::1] media):
        """`Interfaces` of rays of unit direction (m, 3) in media (m,) with specular surfaces."""
        cdef const int32_t[::1] object_id = hits.object_id
        cdef const double[:, ::1] geometric = hits.geometric_normal
        cdef const double[:, ::1] shading = hits.shading_normal
        cdef Py_ssize_t i, m = direction.shape[0]
        cdef double[:, ::1] normal = np.empty((m, 3))
        cdef uint8_t[::1] is_shading = np.empty(m, np.uint8)
        cdef double[:, ::1] numbers = np.empty((3, m))
        cdef double[:, ::1] rising = np.ones((m, 3))
        cdef uint64_t[::1] beyond = np.empty(m, np.uint64)
        cdef Arrival at
        cdef Interface out
        check_rows(m, direction.shape[1], hits, media)
        with nogil:
            for i in range(m):
                at = Arrival(
                    &direction[i, 0], &geometric[i, 0], &shading[i, 0], object_id[i],
                    dot(&direction[i, 0], &geometric[i, 0]) > 0.0, media[i], 0.0,
                )
                interface_at(&out, self, &at)
                normal[i, 0], normal[i, 1], normal[i, 2] = out.to.normal
                is_shading[i], beyond[i] = out.to.is_shading, out.beyond
                numbers[0, i], numbers[1, i], numbers[2, i] = out.n1, out.n2, out.reflected
                if self.is_schlick[object_id[i]]:
                    reflectance_at(&rising[i, 0], self, object_id[i], cosine_at(&out, &at))
        return Interfaces(
            normal.base, is_shading.base.view(np.bool_), *numbers.base, rising.base, beyond.base
        )


@cython.final
cdef class Faults:
    """Counts, by object, of events by which stacks of media and the nesting of bodies disagree."""

    def __init__(self, Py_ssize_t n_objects):
        self.count = np.zeros((n_objects, N_FAULTS), np.int64)

    def take(self):
        """Rows (k, 3) of objects and their counts, which start again from zero.

        Counts are of rays that left an object unentered, and that entered it beyond the media that
        a stack holds.
        """
        cdef object counts = self.count.base
        if not self.total:
            return np.empty((0, 1 + N_FAULTS), np.int64)
        object_id = np.flatnonzero(counts.any(axis=1))
        rows = np.column_stack([object_id, counts[object_id]])
        counts[object_id] = 0
        self.total = 0
        return rows


cdef check_rows(Py_ssize_t m, Py_ssize_t width, hits, const uint64_t[::1] media):
    if not (len(hits) == media.shape[0] == m and width == 3):
        raise ValueError("directions, hits and media do not fit one another")
