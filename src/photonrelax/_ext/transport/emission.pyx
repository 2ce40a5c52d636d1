"""Primal rays of one emitter, each from its index alone: the loop body writes only row i."""

cimport cython
from cython.parallel cimport prange
from libc.math cimport M_PI, cbrt, cos, fabs, sin, sqrt
from libc.stdint cimport int64_t, uint8_t, uint64_t

from ..common.rng cimport hash_next, uniform
from ..common.threads cimport ELEMENTS, Watch, close_watch, goes_on, open_watch, team_size
from ..common.vec3 cimport copy, cross, dot, normalise, orthonormal_frame
from .sampling cimport (
    cap_direction, disk_point, radical_inverse, radical_inverse_2, radical_inverse_3,
    sphere_direction, wrapped,
)

import numpy as np

# The kinds of scene.emission_region.
cdef enum:
    DISK = 0
    CAP = 1
    SPHERE = 2
    ELLIPSE = 3
    SPOT = 4
    SUN = 5
    AREA = 6

cdef enum:
    # Candidates between looks for signals.
    LOOK_EVERY = 1 << 12

cdef double SMALLEST_REST = 2.0**-53

# Random numbers of a photon: two for its coordinates, this one, then those of events. Two more
# coordinates come after those of any event.
cdef enum:
    OF_SELECTION = 2
    OF_ANGLE = 1 << 30
    OF_SHARE = OF_ANGLE + 2
    OF_TURN = OF_ANGLE + 3


cdef double squared_distance(const double* centre, const double* point) noexcept nogil:
    cdef double squared = 0.0
    cdef int c
    for c in range(3):
        squared += (point[c] - centre[c]) * (point[c] - centre[c])
    return squared


cdef double squared_distance_to_ray(
    const double* centre, const double* origin, const double* direction
) noexcept nogil:
    cdef double[3] offset, aside
    cdef double along
    cdef int c
    for c in range(3):
        offset[c] = centre[c] - origin[c]
    along = max(dot(offset, direction), 0.0)
    for c in range(3):
        aside[c] = offset[c] - along * direction[c]
    return dot(aside, aside)


cdef double ellipse_direction(double* out, const double* p, const double* shape) noexcept nogil:
    """Lift a point of the unit disk to a cap, by way of the cap's outline seen along z.

    `shape` is cos and sin of the tilt between z and the cap's axis, cos and sin of its half angle.
    The outline is an ellipse; 1 - x^2 - y^2 is expanded so that thin caps keep their digits.
    """
    cdef double cos_tilt = shape[0], sin_tilt = shape[1]
    cdef double cos_cap = shape[2], sin_cap = shape[3]
    cdef double x = cos_tilt * p[0], square
    out[0] = cos_cap * sin_tilt + sin_cap * x
    out[1] = sin_cap * p[1]
    square = (
        cos_tilt * cos_tilt
        - 2.0 * cos_cap * sin_tilt * sin_cap * x
        + sin_cap * sin_cap * (sin_tilt * sin_tilt - x * x - p[1] * p[1])
    )
    out[2] = sqrt(square) if square > 0.0 else 0.0
    return out[2]


cdef double spot_direction(double* out, double u, double v, const double* shape) noexcept nogil:
    """Map the unit square to a sector of a spot's cone, or to the whole cone around z.

    The density follows the intensity, which is returned relative to that on the axis.
    """
    cdef double inner = shape[0], width = shape[1] - shape[0], half_azimuth = shape[4]
    cdef double content, drop, root = 1.0, stretch, radius = 1.0
    if half_azimuth < M_PI:
        content = shape[2] + u * (shape[3] - shape[2])
        out[0] = cos(half_azimuth * (2.0 * v - 1.0))
        out[1] = sin(half_azimuth * (2.0 * v - 1.0))
    else:
        disk_point(out, u, v)
        radius = sqrt(out[0] * out[0] + out[1] * out[1])
        content = shape[3] * radius * radius
    drop = content
    if content > inner:
        # Rounding must not take the density to zero.
        root = cbrt(max(1.0 - 3.0 * (content - inner) / width, SMALLEST_REST))
        drop = inner + width * (1.0 - root)
    stretch = sqrt(drop * (2.0 - drop)) / radius if radius > 0.0 else 0.0
    out[0] *= stretch
    out[1] *= stretch
    out[2] = 1.0 - drop
    return root * root


@cython.final
cdef class EmissionRegion:
    """The numbers of a `scene.emission_region.EmissionRegion`; `density` is of its photons."""

    def __init__(
        self, int kind, const double[::1] origin, const double[:, ::1] frame,
        const double[::1] shape, *, double start_distance, const double[::1] coords_offset,
        double density, const double[::1] target=None, const double[:, :, ::1] triangles=None,
        const double[::1] cumulative=None, SkyMap sky=None, const double[:, ::1] colours=None,
    ):
        cdef int i, c
        if not (
            origin.shape[0] == frame.shape[0] == frame.shape[1] == 3
            and coords_offset.shape[0] in (2, 3)
            and shape.shape[0] <= SHAPE_NUMBERS
        ):
            raise ValueError("origin, frame, shape and offset of an emission region do not fit")
        self.kind = kind
        for c in range(3):
            self.origin[c] = origin[c]
            self.coords_offset[c] = coords_offset[c] if c < coords_offset.shape[0] else 0.0
            for i in range(3):
                self.frame[i][c] = frame[i, c]
        for i in range(SHAPE_NUMBERS):
            self.shape[i] = shape[i] if i < shape.shape[0] else 0.0
        self.start_distance = start_distance
        self.density = density
        self.target, self.triangles, self.cumulative = target, triangles, cumulative
        self.sky, self.colours = sky, colours

    cdef void to_world(self, double* out, const double* local) noexcept nogil:
        cdef int c
        for c in range(3):
            out[c] = (
                local[0] * self.frame[0][c]
                + local[1] * self.frame[1][c]
                + local[2] * self.frame[2][c]
            )

    cdef double from_point(self, double* direction, double u, double v) noexcept nogil:
        """Write a direction from a point and return its density."""
        cdef double[2] disk
        cdef double[3] local, world
        cdef double relative = 1.0
        if self.kind == SPHERE:
            sphere_direction(local, u, v)
        elif self.kind == SPOT:
            relative = spot_direction(local, u, v, &self.shape[0])
        else:
            disk_point(disk, u, v)
            if self.kind == CAP:
                cap_direction(local, disk, self.shape[0])
            else:
                relative = ellipse_direction(local, disk, &self.shape[0])
        self.to_world(world, local)
        normalise(world)
        copy(direction, world)
        return self.density * relative

    cdef double from_plane(
        self, double* origin, double* direction, double* coords, double u, double v
    ) noexcept nogil:
        """Write a ray of parallel light and its coordinates on the emitter plane."""
        cdef double[3] local
        cdef int c
        disk_point(local, u, v)
        local[0] *= self.shape[0]
        local[1] *= self.shape[0]
        coords[0] = local[0] + self.coords_offset[0]
        coords[1] = local[1] + self.coords_offset[1]
        local[2] = 0.0
        self.to_world(origin, local)
        for c in range(3):
            origin[c] += self.origin[c]
            direction[c] = self.frame[2][c]
        return self.density

    cdef double from_sun(
        self, double* origin, double* direction, double* coords, const double* point
    ) noexcept nogil:
        """Write a ray of a sun and its coordinates, across the ray from the centre of all."""
        cdef double[3] local, across, along, start
        cdef double[2] disk
        cdef double upstream = self.shape[2]
        cdef int c
        if self.sky is None:
            disk_point(disk, point[2], point[3])
            cap_direction(local, disk, self.shape[1])
        else:
            self.sky.direction(local, point[2], point[3])
            for c in range(3):
                local[c] = -local[c]
        orthonormal_frame(across, along, local)
        disk_point(disk, point[0], point[1])
        coords[0] = coords[1] = 0.0
        if self.shape[3] == 0.0:
            coords[0] = self.shape[0] * disk[0] + dot(&self.coords_offset[0], across)
            coords[1] = self.shape[0] * disk[1] + dot(&self.coords_offset[0], along)
        self.to_world(direction, local)
        normalise(direction)
        for c in range(3):
            start[c] = self.shape[0] * (disk[0] * across[c] + disk[1] * along[c])
        self.to_world(origin, start)
        for c in range(3):
            origin[c] += self.origin[c] + upstream * (self.frame[2][c] - direction[c])
        return self.density

    cdef double from_area(
        self, double* origin, double* direction, double* coords, const double* point
    ) noexcept nogil:
        """Write a ray from an area to the target and its direction as coordinates."""
        cdef double[3] normal
        cdef double cosine
        self.at_area(origin, normal, point)
        self.to_target(direction, origin, point)
        cosine = dot(normal, direction)
        copy(coords, direction)
        for c in range(3):
            origin[c] += (self.start_distance if cosine > 0.0 else -self.start_distance) * normal[c]
        return self.density * (self.shape[3] if self.shape[3] > 0.0 else fabs(cosine))

    cdef void at_area(self, double* position, double* normal, const double* point) noexcept nogil:
        """Write a point of an area, uniform over it, and the normal there."""
        cdef Py_ssize_t first = 0, last = self.cumulative.shape[0] - 1, middle
        cdef const double* corner
        cdef double[3] u, v
        cdef double below, along
        cdef int c
        while first < last:
            middle = (first + last) // 2
            if self.cumulative[middle] <= point[2]:
                first = middle + 1
            else:
                last = middle
        below = self.cumulative[first - 1] if first > 0 else 0.0
        along = sqrt((point[2] - below) / (self.cumulative[first] - below))
        corner = &self.triangles[first, 0, 0]
        for c in range(3):
            u[c] = corner[3 + c] - corner[c]
            v[c] = corner[6 + c] - corner[c]
            position[c] = corner[c] + along * ((1.0 - point[3]) * u[c] + point[3] * v[c])
        cross(normal, u, v)
        normalise(normal)

    cdef double to_target(
        self, double* direction, const double* origin, const double* point
    ) noexcept nogil:
        """Write a direction to the target, uniform over it; return 1 - cos of its half angle."""
        cdef double[3] axis, across, along, local
        cdef double[2] disk
        cdef double distance, sine, one_minus_cos
        cdef int c
        for c in range(3):
            axis[c] = self.target[c] - origin[c]
        distance = sqrt(dot(axis, axis))
        if distance <= self.shape[0]:
            sphere_direction(direction, point[0], point[1])
            return 2.0
        sine = self.shape[0] / distance
        one_minus_cos = sine * sine / (1.0 + sqrt((1.0 - sine) * (1.0 + sine)))
        normalise(axis)
        disk_point(disk, point[0], point[1])
        cap_direction(local, disk, one_minus_cos)
        orthonormal_frame(across, along, axis)
        for c in range(3):
            direction[c] = local[0] * across[c] + local[1] * along[c] + local[2] * axis[c]
        normalise(direction)
        return one_minus_cos

    cdef double taken(self, const double* point) noexcept nogil:
        """Share of a candidate that is a photon of an area: its cosine and solid angle."""
        cdef double[3] origin, normal, direction
        cdef double one_minus_cos, cosine
        self.at_area(origin, normal, point)
        one_minus_cos = self.to_target(direction, origin, point)
        cosine = dot(normal, direction)
        return (fabs(cosine) if self.shape[2] > 0.0 else cosine) * one_minus_cos / self.shape[1]

    cdef double ray(
        self, double* origin, double* direction, double* coords, const double* point
    ) noexcept nogil:
        """Write the ray and coordinates of a point of the unit square, or hypercube if extended."""
        cdef double density
        cdef int c
        if self.kind == DISK:
            return self.from_plane(origin, direction, coords, point[0], point[1])
        if self.kind == SUN:
            return self.from_sun(origin, direction, coords, point)
        if self.kind == AREA:
            return self.from_area(origin, direction, coords, point)
        density = self.from_point(direction, point[0], point[1])
        for c in range(3):
            coords[c] = direction[c]
            origin[c] = self.origin[c] + self.start_distance * direction[c]
        return density


cdef inline void write_point(
    Emission emission, uint64_t index, double* point
) noexcept nogil:
    """Write the point of the unit square or hypercube of a candidate."""
    cdef uint64_t key
    if emission.halton:
        point[0] = wrapped(radical_inverse_2(index), emission.shift[0])
        point[1] = wrapped(radical_inverse_3(index), emission.shift[1])
        if emission.n_numbers == 4:
            point[2] = wrapped(radical_inverse(index, 5), emission.shift[2])
            point[3] = wrapped(radical_inverse(index, 7), emission.shift[3])
    else:
        key = emission.key(index)
        point[0], point[1] = uniform(key, 0), uniform(key, 1)
        if emission.n_numbers == 4:
            point[2], point[3] = uniform(key, OF_ANGLE), uniform(key, OF_ANGLE + 1)


@cython.final
cdef class Emission:
    """The candidates of a region, by index; an empty shift selects the random sampler.

    Those that lie in the `outlines` (m, 4) of earlier regions are no photons, nor those beyond one
    whose squared radius is negative.
    """

    def __init__(
        self, EmissionRegion region, uint64_t seed, uint64_t stream, const double[::1] shift,
        const double[:, ::1] outlines,
    ):
        cdef int i
        if outlines.shape[1] != 4:
            raise ValueError(f"outlines should have 4 columns, but have {outlines.shape[1]}")
        self.region = region
        self.stream_key = hash_next(hash_next(0, seed), stream)
        self.outlines = outlines
        self.is_coloured = region.sky is not None
        self.n_numbers = 4 if region.kind == SUN or region.kind == AREA else 2
        self.halton = shift.shape[0] > 0
        self.turned = uniform(hash_next(self.stream_key, 0), OF_TURN)
        if self.halton and shift.shape[0] < self.n_numbers:
            raise ValueError(f"shift should have {self.n_numbers} numbers")
        for i in range(self.n_numbers if self.halton else 0):
            self.shift[i] = shift[i]

    cdef void colour(self, double* out, uint64_t index) noexcept nogil:
        """Write the flux of a photon over that of the mean one, if photons differ in colour."""
        cdef double[3] direction
        cdef double[4] point
        write_point(self, index, point)
        copy(out, &self.region.colours[self.region.sky.direction(direction, point[2], point[3]), 0])

    def mean_colour(self, int64_t n, int64_t first=0):
        """Mean colour (3,) of the photons among candidates first … n - 1; ones if there are none.

        Blocks are summed by themselves, so that no digits are lost to many photons.
        """
        cdef double[3] total, block, own
        cdef int64_t index, found = 0
        cdef int c
        cdef Watch watch
        if not self.is_coloured:
            return [1.0, 1.0, 1.0]
        watch = open_watch()
        with nogil:
            for c in range(3):
                total[c] = block[c] = 0.0
            for index in range(first, n):
                if not goes_on(&watch, index % LOOK_EVERY == 0):
                    break
                if self.accepts(index):
                    self.colour(own, index)
                    found += 1
                    for c in range(3):
                        block[c] += own[c]
                if index % LOOK_EVERY == LOOK_EVERY - 1 or index == n - 1:
                    for c in range(3):
                        total[c] += block[c]
                        block[c] = 0.0
        close_watch(&watch)
        return [total[c] / found for c in range(3)] if found else [1.0, 1.0, 1.0]

    cdef double turn(self, uint64_t index) noexcept nogil:
        """Number in [0, 1) that turns the wavelengths of a photon's light.

        With the numbers of its ray it is a Halton point, of the next base.
        """
        if self.halton:
            return wrapped(radical_inverse(index, 5 if self.n_numbers == 2 else 11), self.turned)
        return uniform(self.key(index), OF_TURN)

    cdef uint64_t key(self, uint64_t index) noexcept nogil:
        """Return the key of the random numbers of a photon."""
        return hash_next(self.stream_key, index)

    def spectrum_photons(self, const int64_t[::1] candidates, double share):
        """Mask (n,) of a share of the photons, each by its index among the candidates alone."""
        cdef Py_ssize_t i
        cdef uint8_t[::1] out = np.empty(candidates.shape[0], np.uint8)
        for i in range(out.shape[0]):
            out[i] = uniform(self.key(candidates[i]), OF_SELECTION) < share
        return out.base

    def share(self, Py_ssize_t n):
        """Share of photons among the first n candidates; at least that of half a photon."""
        cdef Py_ssize_t i, found = 0
        for i in range(n):
            found += self.accepts(i)
        return max(found, 0.5) / n

    def photons(self, Py_ssize_t n, Py_ssize_t step, int64_t limit):
        """Candidates that are photons 0, step, …, and the numbers of photons and of candidates.

        There are n photons unless the candidates reach their limit before. Candidates end before
        photon n, not after photon n - 1: the share of photons among them would be too large.
        """
        cdef Py_ssize_t found = 0
        cdef int64_t index = 0
        cdef int64_t[::1] starts = np.empty(n // step + 1, np.int64)
        cdef Watch watch = open_watch()
        with nogil:
            while index < limit and goes_on(&watch, index % LOOK_EVERY == 0):
                if self.accepts(index):
                    if found == n:
                        break
                    if found % step == 0:
                        starts[found // step] = index
                    found += 1
                index += 1
        close_watch(&watch)
        return np.asarray(starts)[: (found + step - 1) // step], found, index

    def accepted(self, int64_t first, Py_ssize_t n):
        """Indices (n,) of n photons among the candidates from `first` on; there have to be n."""
        cdef Py_ssize_t found = 0
        cdef int64_t index = first
        cdef int64_t[::1] out = np.empty(n, np.int64)
        with nogil:
            while found < n:
                if self.accepts(index):
                    out[found] = index
                    found += 1
                index += 1
        return np.asarray(out)

    cdef bint accepts(self, uint64_t index) noexcept nogil:
        """False if a candidate lies in an earlier region, or beyond the clip of its own."""
        cdef double[3] origin
        cdef double[3] direction
        cdef double[3] coords
        cdef double[4] point
        cdef double squared
        cdef Py_ssize_t i
        coords[2] = 0.0
        write_point(self, index, point)
        if self.region.kind == AREA and (
            uniform(self.key(index), OF_SHARE) >= self.region.taken(point)
        ):
            return False
        self.region.ray(origin, direction, coords, point)
        for i in range(self.outlines.shape[0]):
            if self.region.kind == SUN or self.region.kind == AREA:
                squared = squared_distance_to_ray(&self.outlines[i, 0], origin, direction)
            else:
                squared = squared_distance(&self.outlines[i, 0], coords)
            if (squared < fabs(self.outlines[i, 3])) == (self.outlines[i, 3] > 0.0):
                return False
        return True

    cdef double ray(
        self, uint64_t index, double* origin, double* direction, double* coords
    ) noexcept nogil:
        """Write a photon's primal ray and emitter coordinates, and return its density."""
        cdef double[4] point
        write_point(self, index, point)
        return self.region.ray(origin, direction, coords, point)


def emit(
    Emission emission, const int64_t[::1] candidates, *, double[:, ::1] origin,
    double[:, ::1] direction, double[:, ::1] coords, double[::1] density, int n_threads,
):
    """Fill the rows with the rays of candidates, given by their indices."""
    cdef Py_ssize_t i, n = density.shape[0]
    if not (
        n == candidates.shape[0] == origin.shape[0] == direction.shape[0] == coords.shape[0]
        and origin.shape[1] == direction.shape[1] == 3
        and coords.shape[1] == (2 if emission.region.kind in (DISK, SUN) else 3)
    ):
        raise ValueError("candidates, rays, coords and density do not fit one another")
    for i in prange(
        n, nogil=True, schedule="static", num_threads=team_size(n_threads, n, ELEMENTS)
    ):
        density[i] = emission.ray(candidates[i], &origin[i, 0], &direction[i, 0], &coords[i, 0])
