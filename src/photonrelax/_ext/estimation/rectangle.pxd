"""Rectangles of footprints, from the edges of parallelograms, as inline functions for kernels."""

from libc.math cimport copysign, fabs, fmax, sqrt

from ..common.vec3 cimport cross, dot, normalise, orthonormal_frame
from ..spatial.simd.kernels cimport Rectangle
from .surface_integrals cimport NearEdges


cdef struct Footprint:
    Rectangle rectangle
    double[2] sides
    double area
    # Number of photons of its rule, and how far estimates of a uniform field are too low at points.
    double number
    double bias
    # Largest squared radius.
    double squared_largest
    # Edges of the surface within a squared radius; none without a scene.
    NearEdges near
    double squared_known


cdef inline void normalise_safely(double* a) noexcept nogil:
    """Scale a vector to unit length, also where its square is beyond the range of floats."""
    cdef double largest = fmax(fabs(a[0]), fmax(fabs(a[1]), fabs(a[2])))
    cdef int axis
    for axis in range(3):
        a[axis] /= largest
    normalise(a)


cdef inline void open_plane(Footprint* footprint, const double* normal) noexcept nogil:
    """Set the axes to a frame of the tangent plane; the normal may have any length."""
    cdef double* axes = footprint.rectangle.axes
    cdef int axis
    for axis in range(3):
        axes[6 + axis] = normal[axis]
    normalise_safely(&axes[6])
    orthonormal_frame(&axes[0], &axes[3], &axes[6])


cdef inline void open_rectangle(
    Footprint* footprint, const double* normal, const double* edges, double side
) noexcept nogil:
    """Set sides, axes and area from two edge vectors or, without these, the side of a square.

    The normal may have any length.
    """
    open_plane(footprint, normal)
    if edges == NULL:
        footprint.sides[0] = footprint.sides[1] = side
    else:
        fit_rectangle(footprint, edges)
    footprint.area = footprint.sides[0] * footprint.sides[1]


cdef inline void open_parallelogram(
    Footprint* footprint, const double* normal, const double* edges
) noexcept nogil:
    """Set sides, axes and area of two edge vectors in the metric in which these are perpendicular.

    It is that of a stretch of the tangent plane along a line between the edges, by a, and across
    it, by 1/a, so that areas are those of space. Axes are the rows of the map to that metric, of
    other lengths than one.
    """
    cdef double* axes = footprint.rectangle.axes
    cdef double[6] stretched
    cdef double[6] directions
    cdef double stretch
    cdef int axis
    open_plane(footprint, normal)
    for axis in range(6):
        stretched[axis] = edges[axis]
    stretch = stretch_between(edges, &axes[6], directions)
    if stretch != 1.0:
        for axis in range(2):
            apply_stretch(directions, stretch, &stretched[3 * axis])
    fit_rectangle(footprint, stretched)
    footprint.area = footprint.sides[0] * footprint.sides[1]
    if stretch != 1.0:
        for axis in range(2):
            apply_stretch(directions, stretch, &axes[3 * axis])


cdef inline double stretch_between(
    const double* edges, const double* normal, double* directions
) noexcept nogil:
    """Stretch that makes edges perpendicular; sets the directions it is along and across."""
    cdef double[2][3] edge
    cdef double cosine, squared, length
    cdef int i, axis
    for i in range(2):
        length = dot(&edges[3 * i], normal)
        for axis in range(3):
            edge[i][axis] = edges[3 * i + axis] - length * normal[axis]
        if edge[i][0] == edge[i][1] == edge[i][2] == 0.0:
            return 1.0
        normalise_safely(edge[i])
    cosine = dot(edge[0], edge[1])
    if fabs(cosine) < 1e-12:
        return 1.0
    # Along the longer of sum and difference, which has a direction.
    for axis in range(3):
        directions[axis] = edge[0][axis] + copysign(1.0, cosine) * edge[1][axis]
    normalise(directions)
    cross(&directions[3], normal, directions)
    # The square of the stretch is the tangent of half the acute angle; at least √tan 30°.
    squared = sqrt((1.0 - fabs(cosine)) / (1.0 + fabs(cosine)))
    return fmax(sqrt(squared), 0.7598356856515925)


cdef inline void apply_stretch(
    const double* directions, double stretch, double* vector
) noexcept nogil:
    cdef double along = dot(vector, directions), across = dot(vector, &directions[3])
    cdef int axis
    for axis in range(3):
        vector[axis] += (
            (stretch - 1.0) * along * directions[axis]
            + (1.0 / stretch - 1.0) * across * directions[3 + axis]
        )


cdef inline double largest_stretch(const Rectangle* rectangle) noexcept nogil:
    """Largest ratio of a distance in the plane to that in the metric of a footprint, or inverse."""
    # The two stretches are a and 1/a.
    cdef const double* axes = rectangle.axes
    cdef double squares = dot(axes, axes) + dot(&axes[3], &axes[3])
    return 0.5 * (sqrt(squares + 2.0) + sqrt(fmax(squares - 2.0, 0.0)))


cdef inline void fit_rectangle(Footprint* footprint, const double* edges) noexcept nogil:
    """Set sides and axes from two edge vectors; the axes are a frame of the tangent plane before.

    With the edges as rows of a matrix E in that frame, the sides are its singular values, and the
    axes the eigenvectors of EᵀE. Where these hardly differ the eigenvectors mean nothing: the axes
    then lie as near to both edges as they can, and the sides are the edges' lengths, scaled to the
    same area.
    """
    cdef double* axes = footprint.rectangle.axes
    cdef double[4] e
    cdef double[2] direction
    cdef double half_sum, half_difference, area, longer, unit = 0.0
    cdef int edge, i
    for edge in range(2):
        e[2 * edge] = dot(&edges[3 * edge], &axes[0])
        e[2 * edge + 1] = dot(&edges[3 * edge], &axes[3])
    for i in range(4):
        unit = fmax(unit, fabs(e[i]))
    if unit == 0.0:
        footprint.sides[0] = footprint.sides[1] = 0.0
        return
    # In a unit that keeps squares within the range of floats.
    for i in range(4):
        e[i] /= unit
    area = fabs(e[0] * e[3] - e[1] * e[2])
    half_sum = 0.5 * (e[0] * e[0] + e[1] * e[1] + e[2] * e[2] + e[3] * e[3])
    direction[0] = 0.5 * (e[0] * e[0] + e[2] * e[2] - e[1] * e[1] - e[3] * e[3])
    direction[1] = e[0] * e[1] + e[2] * e[3]
    half_difference = sqrt(direction[0] * direction[0] + direction[1] * direction[1])
    longer = sqrt(half_sum + half_difference)
    # From a ratio of 1.5 of its axes on a rectangle lies along them, not along the edges.
    if longer * longer > 1.5 * area:
        footprint.sides[0] = longer
        footprint.sides[1] = area / longer
        half_angle(direction)
    else:
        fit_to_edges(footprint, e, area, direction)
    footprint.sides[0] *= unit
    footprint.sides[1] *= unit
    turn(axes, direction)


cdef inline void half_angle(double* direction) noexcept nogil:
    """Replace a vector by the unit vector at half its angle, which is zero for none."""
    cdef double length = sqrt(direction[0] * direction[0] + direction[1] * direction[1])
    cdef double cosine = direction[0] / length, sine = direction[1] / length
    if cosine >= 0.0:
        direction[0] = sqrt(0.5 * (1.0 + cosine))
        direction[1] = 0.5 * sine / direction[0]
    else:
        direction[1] = sqrt(0.5 * (1.0 - cosine))
        direction[0] = 0.5 * sine / direction[1]


cdef inline void fit_to_edges(
    Footprint* footprint, const double* e, double area, double* direction
) noexcept nogil:
    """Set sides, and the first's direction, from edges of similar length at a wide angle."""
    cdef double first = sqrt(e[0] * e[0] + e[1] * e[1])
    cdef double second = sqrt(e[2] * e[2] + e[3] * e[3])
    cdef double scale = sqrt(area / (first * second)), length
    # The second edge turned by 90° towards the first.
    cdef double turned = 1.0 if e[0] * e[3] > e[1] * e[2] else -1.0
    direction[0] = e[0] / first + turned * e[3] / second
    direction[1] = e[1] / first - turned * e[2] / second
    length = sqrt(direction[0] * direction[0] + direction[1] * direction[1])
    direction[0] /= length
    direction[1] /= length
    footprint.sides[0] = first * scale
    footprint.sides[1] = second * scale


cdef inline void turn(double* axes, const double* direction) noexcept nogil:
    """Turn the first two axes so that the first has a direction given in their frame."""
    cdef int axis
    for axis in range(3):
        axes[axis] = direction[0] * axes[axis] + direction[1] * axes[3 + axis]
    normalise(axes)
    cross(&axes[3], &axes[6], axes)
