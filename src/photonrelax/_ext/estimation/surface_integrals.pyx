"""The integrals of surface_integrals.pxd."""

from libc.math cimport (
    M_PI, asin, asinh, atan2, ceil, copysign, cos, erf, exp, fabs, fmax, fmin, sin, sqrt,
)

import numpy as np

from ..spatial.simd.kernels cimport (
    CONE_WEIGHTS, EPANECHNIKOV_WEIGHTS, GAUSSIAN_DEVIATION, GAUSSIAN_WEIGHTS,
)

cdef enum:
    # Nodes of a panel of Gauss's quadrature.
    NODES = 8
    # Places that divide an edge, with its ends.
    MAX_BREAKS = 11
    BISECTIONS = 24

# Length of a panel in deviations: 8 nodes are then exact to 1e-10.
cdef double PANEL = 1.5
# Deviations inside a side from which on the profile along it is constant, to 1e-9.
cdef double DEEP = 6.3
# Length of a side, in deviations, below which its profile is a series.
cdef double NARROW = 0.25
# Least part of a kernel on surface that estimates are divided by.
cdef double LEAST_SHARE = 1.0 / 16.0

cdef double[NODES] nodes
cdef double[NODES] weights
for _i, (_node, _weight) in enumerate(zip(*np.polynomial.legendre.leggauss(NODES))):
    nodes[_i] = _node
    weights[_i] = _weight


cdef struct Kernel:
    # Half the sides of a footprint; the radius of the cut; the Gaussian's deviation, zero for a
    # kernel that is one.
    double[2] half
    double radius
    double deviation


cdef double area_on_surface(
    const NearEdges* near, const double* sides, double radius
) noexcept nogil:
    """Area of what is within a radius of a rectangle and on surface."""
    cdef Kernel kernel
    set_kernel(&kernel, sides, radius, 0.0)
    return integral(&kernel, near)


cdef double share_on_surface(
    const NearEdges* near, const double* sides, double radius
) noexcept nogil:
    """Part of a footprint's kernel that lies on surface, or the least that counts."""
    cdef Kernel kernel
    if near.n == 0:
        return 1.0
    set_kernel(&kernel, sides, radius, GAUSSIAN_DEVIATION * radius)
    return fmax(integral(&kernel, near) / (2.0 * mass_beyond(&kernel, 0.0)), LEAST_SHARE)


cdef double squared_of_disc(const NearEdges* near, double radius) noexcept nogil:
    """Square of the radius of the disc with as much surface as one of a radius without edges.

    That of the largest radius, within which edges are known, if it has less; the radius itself if
    the middle is off the surface. By bisection: it is a limit, which need not be sharp.
    """
    cdef double[2] sides = [0.0, 0.0]
    cdef double low = radius, high = SURFACE_WITHIN * radius, middle
    cdef int _step
    if near.n == 0 or not near.inside:
        return radius * radius
    for _step in range(BISECTIONS):
        middle = 0.5 * (low + high)
        if area_on_surface(near, sides, middle) < M_PI * radius * radius:
            low = middle
        else:
            high = middle
    return high * high


cdef inline void set_kernel(
    Kernel* kernel, const double* sides, double radius, double deviation
) noexcept nogil:
    kernel.half[0] = 0.5 * sides[0]
    kernel.half[1] = 0.5 * sides[1]
    kernel.radius = radius
    kernel.deviation = deviation


cdef double integral(const Kernel* kernel, const NearEdges* near) noexcept nogil:
    """Integral of a kernel over the surface."""
    cdef double total = 2.0 * mass_beyond(kernel, 0.0) if near.inside else 0.0
    cdef Py_ssize_t i
    for i in range(near.n):
        total += flow_in(kernel, &near.ends[4 * i])
    # To rounding, where nothing of it is on the surface.
    return fmax(total, 0.0)


cdef double flow_in(const Kernel* kernel, const double* ends) noexcept nogil:
    """Flow of H onto the surface over one edge, -∫ H · n ds."""
    cdef double total = 0.0, x
    if (ends[1] < 0.0) != (ends[3] < 0.0):
        x = ends[0] - ends[1] * (ends[2] - ends[0]) / (ends[3] - ends[1])
        total = copysign(mass_beyond(kernel, fabs(x)), x)
        if ends[3] > ends[1]:
            total = -total
    return total + column_integral(kernel, ends)


cdef double profile(const Kernel* kernel, int axis, double x) noexcept nogil:
    """Profile of a kernel along one axis: the mean of a normal density over the side."""
    cdef double half = kernel.half[axis], deviation = kernel.deviation, second, squared
    x /= deviation
    half /= deviation
    if 2.0 * half >= NARROW:
        return (normal_integral(x + half) - normal_integral(x - half)) / (2.0 * half * deviation)
    # s²/24 and so on, with Hermite polynomials.
    second = half * half / 6.0
    squared = x * x
    return normal(x) / deviation * (
        1.0 + second * (squared - 1.0)
        + 0.3 * second * second * (squared * squared - 6.0 * squared + 3.0)
        + 3.0 / 70.0 * second ** 3 * (squared ** 3 - 15.0 * squared ** 2 + 45.0 * squared - 15.0)
    )


cdef double profile_integral(const Kernel* kernel, int axis, double x) noexcept nogil:
    """Integral of `profile` from zero."""
    cdef double half = kernel.half[axis], deviation = kernel.deviation, second, squared
    x /= deviation
    half /= deviation
    if 2.0 * half >= NARROW:
        return (second_integral(x + half) - second_integral(x - half)) / (2.0 * half)
    second = half * half / 6.0
    squared = x * x
    return normal_integral(x) - x * normal(x) * (
        second + 0.3 * second * second * (squared - 3.0)
        + 3.0 / 70.0 * second ** 3 * (squared * squared - 10.0 * squared + 15.0)
    )


cdef inline double normal(double x) noexcept nogil:
    return exp(-0.5 * x * x) / sqrt(2.0 * M_PI)


cdef inline double normal_integral(double x) noexcept nogil:
    """Integral of the normal density from zero, Φ(x) - ½."""
    return 0.5 * erf(x * sqrt(0.5))


cdef inline double second_integral(double x) noexcept nogil:
    """Integral of `normal_integral`, but for a constant."""
    return x * normal_integral(x) + normal(x)


cdef inline double top_of(const Kernel* kernel, double x) noexcept nogil:
    """Half the height of the column at x of what is within the radius of the rectangle."""
    cdef double beyond = fmax(fabs(x) - kernel.half[0], 0.0)
    return kernel.half[1] + sqrt(
        fmax((kernel.radius - beyond) * (kernel.radius + beyond), 0.0)
    )


cdef double mass_beyond(const Kernel* kernel, double x) noexcept nogil:
    """Integral of a kernel beyond x >= 0, over all of the columns there."""
    cdef double total = 0.0, angle, half, at, sine, cosine
    cdef int panel, i
    if x >= kernel.half[0] + kernel.radius:
        return 0.0
    if kernel.deviation == 0.0:
        return 2.0 * area_of_columns(kernel, x, kernel.half[0] + kernel.radius)
    if x < kernel.half[0]:
        total = profile_integral(kernel, 0, kernel.half[0]) - profile_integral(kernel, 0, x)
        total *= profile_integral(kernel, 1, kernel.half[1] + kernel.radius)
    angle = asin(fmin(fmax(x - kernel.half[0], 0.0) / kernel.radius, 1.0))
    half = 0.25 * (0.5 * M_PI - angle)
    for panel in range(2):
        for i in range(NODES):
            at = angle + (2 * panel + 1 + nodes[i]) * half
            sine = sin(at)
            cosine = cos(at)
            total += (
                weights[i] * half * kernel.radius * cosine
                * profile(kernel, 0, kernel.half[0] + kernel.radius * sine)
                * profile_integral(kernel, 1, kernel.half[1] + kernel.radius * cosine)
            )
    return 2.0 * total


cdef inline double area_of_columns(
    const Kernel* kernel, double low, double high
) noexcept nogil:
    """Area of the upper halves of the columns of what is within the radius, from one x to another.

    Both on one side of the middle or on the rectangle; negative if they are in falling order.
    """
    cdef double area = kernel.half[1] * (high - low)
    cdef double flat = fmin(high, kernel.half[0]) - fmin(low, kernel.half[0])
    area += kernel.radius * flat
    return area + half_segment(kernel, high) - half_segment(kernel, low)


cdef inline double half_segment(const Kernel* kernel, double x) noexcept nogil:
    """Area of a quarter of the corner's disc up to x, none of it before the rectangle's end."""
    cdef double beyond = fmin(fmax(x - kernel.half[0], 0.0), kernel.radius)
    if beyond == 0.0:
        return 0.0
    return 0.5 * (
        beyond * sqrt((kernel.radius - beyond) * (kernel.radius + beyond))
        + kernel.radius * kernel.radius * asin(beyond / kernel.radius)
    )


cdef double column_integral(const Kernel* kernel, const double* ends) noexcept nogil:
    """Integral of H_y along x over an edge."""
    cdef double[MAX_BREAKS] breaks
    cdef double dx = ends[2] - ends[0], dy = ends[3] - ends[1], total = 0.0
    cdef Py_ssize_t n = 1, axis, i
    if fabs(dx) <= 1e-14 * kernel.radius:
        return 0.0
    breaks[0] = 0.0
    n = add_break(breaks, n, -ends[1], dy)
    for axis in range(2):
        n = add_breaks(breaks, n, kernel.half[axis], ends[axis], dy if axis else dx)
        if kernel.half[axis] > DEEP * kernel.deviation > 0.0:
            n = add_breaks(
                breaks, n, kernel.half[axis] - DEEP * kernel.deviation, ends[axis],
                dy if axis else dx
            )
    breaks[n] = 1.0
    for i in range(n):
        total += piece_integral(kernel, ends, breaks[i], breaks[i + 1])
    return total


cdef inline Py_ssize_t add_breaks(
    double* breaks, Py_ssize_t n, double at, double start, double length
) noexcept nogil:
    """Insert the places of an edge at which a coordinate is `at` and minus that."""
    n = add_break(breaks, n, at - start, length)
    return add_break(breaks, n, -at - start, length)


cdef inline Py_ssize_t add_break(
    double* breaks, Py_ssize_t n, double distance, double length
) noexcept nogil:
    """Insert the place of a distance along an edge, if it is on it; return the number of places."""
    cdef Py_ssize_t hole = n
    cdef double place
    if length == 0.0 or not 0.0 < distance / length < 1.0:
        return n
    place = distance / length
    while breaks[hole - 1] > place:
        breaks[hole] = breaks[hole - 1]
        hole -= 1
    breaks[hole] = place
    return n + 1


cdef double piece_integral(
    const Kernel* kernel, const double* ends, double first, double last
) noexcept nogil:
    """Integral of H_y along x over a piece of an edge on which coordinates keep their ranges."""
    cdef double middle = 0.5 * (first + last)
    cdef double x = ends[0] + middle * (ends[2] - ends[0])
    cdef double y = ends[1] + middle * (ends[3] - ends[1])
    cdef double[2] rate
    cdef double[2] start
    cdef double a = 0.0, b = 0.0, c = -kernel.radius * kernel.radius, root
    cdef int axis
    for axis in range(2):
        # Excess over half a side, which is linear in the place.
        rate[axis] = ends[2 + axis] - ends[axis]
        start[axis] = ends[axis]
        if (y if axis else x) < 0.0:
            rate[axis] = -rate[axis]
            start[axis] = -start[axis]
        start[axis] -= kernel.half[axis]
        if fabs(y if axis else x) > kernel.half[axis]:
            a += rate[axis] * rate[axis]
            b += rate[axis] * start[axis]
            c += start[axis] * start[axis]
    if a > 0.0:
        root = b * b - a * c
        if root <= 0.0:
            return 0.0
        root = sqrt(root)
        first = fmax(first, (-b - root) / a)
        last = fmin(last, (-b + root) / a)
    elif c > 0.0:
        return 0.0
    if first >= last:
        return 0.0
    return copysign(1.0, y) * panels_integral(
        kernel, ends, first, last, fabs(x) > kernel.half[0]
    )


cdef double panels_integral(
    const Kernel* kernel, const double* ends, double first, double last, bint is_beside
) noexcept nogil:
    """Integral of |H_y| along x from one place of an edge to another, with its sign.

    Beside the rectangle, where columns end at a circle, over the angle there.
    """
    cdef double dx = ends[2] - ends[0], dy = ends[3] - ends[1], total = 0.0
    cdef double low = ends[0] + first * dx, high = ends[0] + last * dx
    cdef double side = copysign(1.0, low + high), half, at, x, y, scale = 1.0
    cdef Py_ssize_t n, i
    cdef int node
    if kernel.deviation == 0.0:
        return side * area_of_columns(kernel, side * low, side * high) - (high - low) * fabs(
            ends[1] + 0.5 * (first + last) * dy
        )
    n = n_panels(kernel, ends, first, last)
    if is_beside:
        low = asin(fmin(fmax(side * low - kernel.half[0], 0.0) / kernel.radius, 1.0))
        high = asin(fmin(fmax(side * high - kernel.half[0], 0.0) / kernel.radius, 1.0))
    half = 0.5 * (high - low) / n
    for i in range(n):
        for node in range(NODES):
            at = low + (2 * i + 1 + nodes[node]) * half
            x = at
            if is_beside:
                x = side * (kernel.half[0] + kernel.radius * sin(at))
                scale = side * kernel.radius * cos(at)
            y = ends[1] + dy * fmin(fmax((x - ends[0]) / dx, 0.0), 1.0)
            total += weights[node] * scale * profile(kernel, 0, x) * fmax(
                profile_integral(kernel, 1, top_of(kernel, x))
                - profile_integral(kernel, 1, fabs(y)),
                0.0
            )
    return total * half


cdef inline Py_ssize_t n_panels(
    const Kernel* kernel, const double* ends, double first, double last
) noexcept nogil:
    """Number of panels for a piece of an edge."""
    cdef double length = 0.0, middle = 0.5 * (first + last), at
    cdef int axis
    for axis in range(2):
        at = fabs(ends[axis] + middle * (ends[2 + axis] - ends[axis]))
        if at > kernel.half[axis] - DEEP * kernel.deviation:
            length = fmax(length, fabs(ends[2 + axis] - ends[axis]) * (last - first))
    return max(<Py_ssize_t> ceil(length / (PANEL * kernel.deviation)), <Py_ssize_t> 1)


cdef double share_of_radial(const NearEdges* near, double radius, int kernel) noexcept nogil:
    """Part of a kernel at a point that lies on surface, or the least that counts."""
    cdef double[2] sides = [0.0, 0.0]
    cdef double share = 1.0 if near.inside else 0.0
    cdef Py_ssize_t i
    if kernel == GAUSSIAN_WEIGHTS:
        return share_on_surface(near, sides, radius)
    for i in range(near.n):
        share -= radial_flow(&near.ends[4 * i], radius, kernel)
    return fmax(share, LEAST_SHARE)


cdef double radial_flow(const double* ends, double radius, int kernel) noexcept nogil:
    """Flow out over one edge of the field that points away from the middle.

    Its flow through an angle is the kernel's mass beyond the edge there: with u the squared ratio
    of the distance to the radius, (1 - u) / 2π for the constant kernel, (1 - u)² / 2π for
    Epanechnikov's, (1 - 3 u + 2 u^(3/2)) / 2π for the cone.
    """
    cdef double dx = (ends[2] - ends[0]) / radius, dy = (ends[3] - ends[1]) / radius
    cdef double length = sqrt(dx * dx + dy * dy), height, low, high, half
    if length == 0.0:
        return 0.0
    # Of the line from the middle, positive if the surface is on this side.
    height = (dy * ends[0] - dx * ends[1]) / (length * radius)
    if not 0.0 < fabs(height) < 1.0:
        return 0.0
    half = sqrt(1.0 - height * height)
    low = (ends[0] * dx + ends[1] * dy) / (length * radius)
    high = fmin(low + length, half)
    low = fmax(low, -half)
    if low >= high:
        return 0.0
    return copysign(
        mass_before(high, fabs(height), kernel) - mass_before(low, fabs(height), kernel), height
    )


cdef double mass_before(double at, double height, int kernel) noexcept nogil:
    """Integral of the mass beyond a line over the angle up to a place of the line."""
    cdef double squared = height * height, distance
    cdef double total = atan2(at, height)
    if kernel == CONE_WEIGHTS:
        distance = sqrt(squared + at * at)
        total += height * (at * distance + squared * asinh(at / height) - 3.0 * at)
    elif kernel == EPANECHNIKOV_WEIGHTS:
        total += height * (squared * at + at * at * at / 3.0 - 2.0 * at)
    else:
        total -= height * at
    return total / (2.0 * M_PI)
