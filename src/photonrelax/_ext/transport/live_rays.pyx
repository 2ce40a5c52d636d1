"""Rays that are followed together, in embree's frame, and through surfaces that are not there."""

import numpy as np

from ..common.vec3 cimport copy, dot
from .materials cimport beyond_hidden, is_hidden
from .raycast cimport Hit


cdef class LiveRays:
    """Live rays of a batch of paths, packed at the front of the rows.

    A class of paths has the rays themselves, and says by `passage` where each is.
    """

    def __init__(self, Materials materials, EmbreeFrame frame, Triangles triangles):
        self.materials, self.frame, self.triangles = materials, frame, triangles
        self.has_hidden = materials.has_hidden
        self.faults = Faults(len(materials.kind))

    @property
    def rays(self):
        """Origins and directions (n_live, 3) of the live rays in embree's frame."""
        return self.origin_array[: self.n_live], self.direction_array[: self.n_live]

    def pass_hidden(self, EmbreeHits found):
        """Take live rays on from surfaces that they hit and that are not there.

        These are surfaces of dielectrics in media of larger priority. Origins stay: rays start anew
        in embree's frame alone.

        Returns
        -------
        (k,) intp, (k, 3), (k, 3)
            Rows of these rays among the live ones, where they hit the surfaces, and directions.
        """
        cdef Py_ssize_t i, k = 0, n = self.n_live
        cdef Py_ssize_t[::1] rows = np.empty(n, np.intp)
        cdef double[:, ::1] position = np.empty((n, 3)), direction = np.empty((n, 3))
        with nogil:
            for i in range(n):
                if self.pass_one(found, i, &position[k, 0]):
                    copy(&direction[k, 0], self.passage(i).direction)
                    rows[k] = i
                    k += 1
        return rows.base[:k], position.base[:k], direction.base[:k]

    cdef Passage passage(self, Py_ssize_t row) noexcept nogil:
        """The ray of a row; of the classes that have rays."""
        return Passage(NULL, NULL, NULL)

    cdef bint pass_one(self, EmbreeHits found, Py_ssize_t row, double* position) noexcept nogil:
        """Take a ray on from its hit, whose position is written; false if the surface is there."""
        cdef Passage ray = self.passage(row)
        cdef int triangle = found.triangle[row]
        cdef double[3] offset
        cdef Hit hit
        cdef int c
        if triangle < 0 or not is_hidden(
            self.materials, self.triangles.faces[triangle, 3], ray.media[0]
        ):
            return False
        self.triangles.refine_hit(found, row, ray.origin, ray.direction, &hit)
        ray.media[0] = beyond_hidden(
            self.materials, self.faults, hit.object_id, dot(ray.direction, hit.geometric) > 0.0,
            ray.media[0],
        )
        copy(position, hit.position)
        for c in range(3):
            offset[c] = hit.step * hit.geometric[c]
        to_embree(self, row, position, ray.direction, offset)
        return True
