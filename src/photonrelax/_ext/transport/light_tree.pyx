"""Shadow rays from lit points to some of many lamps, chosen by the light that they bring.

Lamps are the leaves of a tree whose nodes bound them by spheres and cones, which tells the light
that a node may bring to a point (after Conty Estevez & Kulla 2018). From the root down, nodes
divide an interval of length n among their children in proportion to it, and leaves among their
lamps by the light that these do bring. Marks at distances of one choose the lamps in whose parts
they lie. So a lamp with a part longer than one always is chosen, and with very many marks all are.
"""

from libc.math cimport INFINITY, ceil, sqrt
from libc.stdint cimport int32_t, int64_t, uint8_t, uint64_t

cimport cython

import numpy as np

from ..common.rng cimport hash_key, uniform
from ..common.vec3 cimport copy, dot
from .raycast cimport EmbreeFrame
from .sampling cimport radical_inverse_2, wrapped

from .direct_light import ShadowRays

# As in scene/lamps.py.
cdef enum:
    PARALLEL, UNIFORM, COSINE, SPOT

# Children of a node; the most lamps of a leaf; more entries of a stack than trees of as many lamps
# as there are ids need.
cdef enum:
    FAN = 4
    MAX_LEAF = 16
    MAX_STACK = 64
MAX_LAMPS_OF_LEAF = MAX_LEAF

# Columns of a node, for each of its children: the sphere around its lamps; the cone that all their
# light is in, as its apex, axis, cos of its half angle and 1 / (1 - cos); coefficients of the
# intensity in it, of even powers of the place from border to axis; the brightness of its
# lamps. Spheres of parallel light are around the ends of axes.
cdef enum:
    MIDDLE = 0
    RADIUS = 3
    APEX = 4
    AXIS = 7
    BORDER = 10
    STEEPNESS = 11
    PROFILE = 12
    BRIGHTNESS = 16
    N_COLUMNS = 17

# Least squared distance to lamps of a node over that from their middle to the farthest. Weight of
# the largest cosine that one of them may have on the surface, to that of their middle. The least
# noise of those tried: any is right as long as none is zero.
cdef double NEAREST = 0.25
cdef double HIGHEST = 0.5
# In place of a length of zero.
cdef double TINY = 1e-300


cdef struct Leaf:
    # Of each lamp: unit vector to it; its distance; irradiance on the surface over its intensity.
    double[MAX_LEAF] x, y, z, distance, relative


cdef struct Part:
    # A node and its part of the interval.
    int32_t node
    double begin, end


@cython.final
cdef class LightTree:
    """Tree of lamps that are all points, or all parallel light.

    Parameters
    ----------
    lamps : LampTable
        In the order of the leaves.
    offset : (n,) float64
        Distances from the lamps within which they bring no light, m.
    nodes : (k, 17, 4) float64
        The columns above of the children of each node.
    child : (k + l,) int32
        First of the four children, which follow one another, of nodes, and then -1 of l leaves.
    span : (k + l, 2) int32
        First lamp, and that after the last.
    """
    cdef readonly Py_ssize_t n_lamps
    cdef bint is_parallel, has_axes
    cdef const uint8_t[::1] kind
    cdef const double[:, ::1] place, axis, intensity
    cdef const double[::1] brightness
    cdef const double[::1] inner, outer
    cdef const double[:, :, ::1] nodes
    cdef const int32_t[::1] child
    cdef const int32_t[:, ::1] span

    def __init__(self, lamps, offset, nodes, child, span):
        self.n_lamps = len(lamps)
        self.is_parallel = lamps.kind[0] == PARALLEL
        self.kind, self.axis = lamps.kind, lamps.axis
        self.inner, self.outer = lamps.inner, lamps.outer
        self.has_axes = bool((lamps.kind != UNIFORM).any())
        # By column, for vector instructions.
        self.place = np.ascontiguousarray(np.column_stack([lamps.position, offset]).T)
        self.intensity, self.brightness = lamps.intensity, lamps.brightness
        self.nodes, self.child, self.span = nodes, child, span

    cdef Py_ssize_t light(
        self, int32_t node, const double* position, const double* normal, Leaf* out
    ) noexcept nogil:
        """Unoccluded light of the lamps of a leaf at a point on a surface; return their number."""
        cdef Py_ssize_t first = self.span[node, 0], n = self.span[node, 1] - first, j
        if self.is_parallel:
            for j in range(n):
                out.x[j] = -self.axis[first + j, 0]
                out.y[j] = -self.axis[first + j, 1]
                out.z[j] = -self.axis[first + j, 2]
                out.distance[j] = INFINITY
                out.relative[j] = max(
                    out.x[j] * normal[0] + out.y[j] * normal[1] + out.z[j] * normal[2], 0.0
                )
            return n
        point_lights(
            n, &self.place[0, first], &self.place[1, first], &self.place[2, first],
            &self.place[3, first], position, normal, out,
        )
        for j in range(n if self.has_axes else 0):
            if out.relative[j] > 0.0:
                out.relative[j] *= self.lobe(first + j, out, j)
        return n

    cdef double lobe(self, Py_ssize_t lamp, const Leaf* to_lamps, Py_ssize_t j) noexcept nogil:
        """Intensity of a lamp, the j-th of a leaf, to a point over that on its axis."""
        cdef const double* axis = &self.axis[lamp, 0]
        cdef double[3] to_lamp
        cdef double drop = 0.0, rest
        cdef int c
        if self.kind[lamp] == UNIFORM:
            return 1.0
        to_lamp[0], to_lamp[1], to_lamp[2] = to_lamps.x[j], to_lamps.y[j], to_lamps.z[j]
        if self.kind[lamp] == COSINE:
            return max(-dot(to_lamp, axis), 0.0)
        # 1 - cos from the chord keeps its digits in narrow cones.
        for c in range(3):
            drop += 0.5 * (to_lamp[c] + axis[c]) * (to_lamp[c] + axis[c])
        rest = (self.outer[lamp] - drop) / (self.outer[lamp] - self.inner[lamp])
        rest = min(max(rest, 0.0), 1.0)
        return rest * rest

    cdef void importance(
        self, Py_ssize_t node, const double* p, const double* n, double* out
    ) noexcept nogil:
        """Light that each child of a node may bring; zero only where it brings none."""
        cdef const double* row = &self.nodes[node, 0, 0]
        cdef double x, y, z, height, squared, least
        cdef int j
        if self.is_parallel:
            for j in range(FAN):
                height = -(row[j] * n[0] + row[FAN + j] * n[1] + row[2 * FAN + j] * n[2])
                out[j] = row[BRIGHTNESS * FAN + j] * (
                    HIGHEST * max(height + row[RADIUS * FAN + j], 0.0)
                    + (1.0 - HIGHEST) * max(height, 0.0)
                )
            return
        # Without branches, for vector instructions.
        for j in range(FAN):
            x = row[j] - p[0]
            y = row[FAN + j] - p[1]
            z = row[2 * FAN + j] - p[2]
            height = x * n[0] + y * n[1] + z * n[2]
            least = NEAREST * row[RADIUS * FAN + j] * row[RADIUS * FAN + j]
            squared = max(x * x + y * y + z * z, least)
            height = HIGHEST * max(height + row[RADIUS * FAN + j], 0.0) + (1.0 - HIGHEST) * max(
                height, 0.0
            )
            out[j] = row[BRIGHTNESS * FAN + j] * height / (squared * sqrt(squared) + TINY)
        if self.has_axes:
            inside_cones(row, p, out)


cdef void point_lights(
    Py_ssize_t n, const double* x, const double* y, const double* z, const double* offset,
    const double* position, const double* normal, Leaf* out
) noexcept nogil:
    """Light of points that shine alike in all directions."""
    cdef double to_x, to_y, to_z, cosine
    cdef double[MAX_LEAF] distance, inverse
    cdef Py_ssize_t j
    # Of roots and quotients alone, in arrays that are surely apart, for vector instructions.
    for j in range(n):
        to_x, to_y, to_z = x[j] - position[0], y[j] - position[1], z[j] - position[2]
        distance[j] = sqrt(to_x * to_x + to_y * to_y + to_z * to_z)
        inverse[j] = 1.0 / (distance[j] if distance[j] > TINY else TINY)
    for j in range(n):
        to_x = (x[j] - position[0]) * inverse[j]
        to_y = (y[j] - position[1]) * inverse[j]
        to_z = (z[j] - position[2]) * inverse[j]
        cosine = to_x * normal[0] + to_y * normal[1] + to_z * normal[2]
        cosine = cosine if cosine > 0.0 else 0.0
        out.x[j], out.y[j], out.z[j], out.distance[j] = to_x, to_y, to_z, distance[j]
        out.relative[j] = cosine * inverse[j] * inverse[j] if distance[j] > offset[j] else 0.0


cdef void inside_cones(const double* row, const double* p, double* out) noexcept nogil:
    """Multiply the light of a node's children by their intensity towards a point."""
    cdef double x, y, z, along, square, profile
    cdef int j
    for j in range(FAN):
        x = p[0] - row[APEX * FAN + j]
        y = p[1] - row[(APEX + 1) * FAN + j]
        z = p[2] - row[(APEX + 2) * FAN + j]
        along = (
            x * row[AXIS * FAN + j] + y * row[(AXIS + 1) * FAN + j]
            + z * row[(AXIS + 2) * FAN + j]
        ) / sqrt(x * x + y * y + z * z + TINY)
        along = (along - row[BORDER * FAN + j]) * row[STEEPNESS * FAN + j]
        along = along if along < 1.0 else 1.0
        square = along * along
        profile = row[PROFILE * FAN + j] + square * (
            row[(PROFILE + 1) * FAN + j] + square * (
                row[(PROFILE + 2) * FAN + j] + square * square * row[(PROFILE + 3) * FAN + j]
            )
        )
        out[j] *= profile if along > 0.0 else 0.0


cdef struct Rays:
    # Columns of rays, and their number.
    Py_ssize_t* lamp
    double* direction
    double* distance
    double* irradiance
    Py_ssize_t count


def sampled_shadow_rays(
    EmbreeFrame frame, LightTree tree, const double[:, ::1] position, const double[:, ::1] normal,
    double n, const double[::1] shift
):
    """`ShadowRays` of points (m, 3) with normals to n lamps each or fewer, and the lamps of rays.

    The sum of the irradiance of the rays of a point that are not occluded is that of all lamps, in
    the mean over `shift` (m,), the first mark in [0, 1).
    """
    cdef Py_ssize_t i, k, m = position.shape[0]
    capacity = m * int(min(n, tree.n_lamps))
    cdef Py_ssize_t[::1] row = np.empty(capacity, np.intp)
    cdef Py_ssize_t[::1] lamp = np.empty(capacity, np.intp)
    cdef double[:, ::1] origin = np.empty((capacity, 3))
    cdef double[:, ::1] direction = np.empty((capacity, 3))
    cdef double[:, ::1] offset = np.empty((capacity, 3))
    cdef double[::1] distance = np.empty(capacity)
    cdef double[:, ::1] arriving = np.empty((capacity, 3))
    cdef double step
    cdef Rays rays
    cdef int c
    if m > 0:
        rays.lamp, rays.direction = &lamp[0], &direction[0, 0]
        rays.distance, rays.irradiance = &distance[0], &arriving[0, 0]
    rays.count = k = 0
    with nogil:
        for i in range(m):
            choose(tree, &position[i, 0], &normal[i, 0], n, shift[i], &rays)
            step = frame.resolution_at(&position[i, 0])
            while k < rays.count:
                row[k] = i
                copy(&origin[k, 0], &position[i, 0])
                for c in range(3):
                    offset[k, c] = step * normal[i, c]
                k += 1
    return ShadowRays(
        row.base[:k], origin.base[:k], direction.base[:k], offset.base[:k], distance.base[:k],
        arriving.base[:k],
    ), lamp.base[:k]


cdef void choose(
    LightTree tree, const double* position, const double* normal, double n, double shift,
    Rays* rays
) noexcept nogil:
    """Append the rays of a point to the lamps that its marks choose."""
    cdef Part[MAX_STACK] stack
    cdef Part part
    cdef int depth = 1
    # The first mark that has not chosen yet: parts are in sequence.
    cdef double mark = shift
    stack[0] = Part(0, 0.0, n)
    while depth > 0:
        depth -= 1
        part = stack[depth]
        if mark >= part.end:
            continue
        if tree.child[part.node] < 0:
            choose_lamps(tree, part, mark, shift, position, normal, rays)
            mark = mark_from(mark, part.end, shift)
        elif not divide(tree, part, mark, position, normal, stack, &depth):
            mark = mark_from(mark, part.end, shift)


cdef inline double mark_from(double mark, double least, double shift) noexcept nogil:
    """The first of the marks that is not below `least`, from a given one on."""
    if least - mark > 4.0:
        mark = shift + ceil(least - shift)
    while mark < least:
        mark += 1.0
    return mark


cdef inline bint divide(
    LightTree tree, Part part, double mark, const double* position, const double* normal,
    Part* stack, int* depth
) noexcept nogil:
    """Push children with marks on a stack, the first uppermost; False if all are dark."""
    cdef double[FAN] bright
    cdef double[FAN + 1] border
    cdef double total, scale
    cdef int j
    tree.importance(part.node, position, normal, bright)
    total = bright[0] + bright[1] + bright[2] + bright[3]
    if not total > 0.0:
        return False
    scale = (part.end - part.begin) / total
    border[0] = part.begin
    for j in range(FAN):
        border[j + 1] = border[j] + scale * bright[j]
    j = FAN
    # The last that is not dark ends where all end, however sums are rounded.
    while bright[j - 1] == 0.0:
        j -= 1
    border[j] = part.end
    while j > 0:
        j -= 1
        if bright[j] > 0.0 and border[j + 1] > mark:
            stack[depth[0]] = Part(tree.child[part.node] + j, border[j], border[j + 1])
            depth[0] += 1
    return True


cdef inline void choose_lamps(
    LightTree tree, Part part, double mark, double shift, const double* position,
    const double* normal, Rays* rays
) noexcept nogil:
    """Append rays to the lamps of a leaf that have marks."""
    cdef Leaf leaf
    cdef double[MAX_LEAF] bright
    cdef double total = 0.0, end = part.begin, scale, weight
    cdef Py_ssize_t first = tree.span[part.node, 0], n, j
    cdef int c
    n = tree.light(part.node, position, normal, &leaf)
    for j in range(n):
        bright[j] = leaf.relative[j] * tree.brightness[first + j]
        total += bright[j]
    if not total > 0.0:
        return
    scale = (part.end - part.begin) / total
    for j in range(n):
        end += scale * bright[j]
        if mark < end and bright[j] > 0.0:
            # Of parts shorter than one, so many have marks; longer ones always have.
            weight = leaf.relative[j] / min(scale * bright[j], 1.0)
            rays.lamp[rays.count] = first + j
            rays.distance[rays.count] = leaf.distance[j]
            rays.direction[3 * rays.count] = leaf.x[j]
            rays.direction[3 * rays.count + 1] = leaf.y[j]
            rays.direction[3 * rays.count + 2] = leaf.z[j]
            for c in range(3):
                rays.irradiance[3 * rays.count + c] = weight * tree.intensity[first + j, c]
            rays.count += 1
            mark = mark_from(mark, end, shift)


def sample_shifts(
    uint64_t seed, uint64_t stream, const int64_t[::1] pixel, const int64_t[::1] number
):
    """First marks (m,) of points, evenly spaced by their numbers in a pixel, shifted by pixel."""
    cdef Py_ssize_t i, m = pixel.shape[0]
    cdef double[::1] shift = np.empty(m)
    with nogil:
        for i in range(m):
            shift[i] = wrapped(
                radical_inverse_2(number[i]), uniform(hash_key(seed, stream, pixel[i]), 0)
            )
    return shift.base
