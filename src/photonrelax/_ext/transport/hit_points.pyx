"""Camera rays, followed through specular surfaces to the diffuse points that they see.

A pass takes every ray of a batch from embree's hit to its continuations: a ray splits in two at a
dielectric. Rays carry the changes of their origins and directions over the width and the height of
a sample (ray differentials, Igehy 1999), which are the edges of the sample on the surface it sees.
"""

cimport cython
from libc.math cimport INFINITY, fabs, isfinite, sqrt
from libc.stdint cimport int32_t, int64_t, uint8_t, uint64_t

import numpy as np

from ..common.vec3 cimport copy, dot, orthonormal_frame
from .curvature cimport change_along, normal_derivative
from .live_rays cimport LiveRays, Passage, to_embree
from .materials cimport (
    OVERFLOWED, Arrival, Interface, Materials, add_fault, cosine_at, counted_media_at, interface_at,
    is_absorbing, is_diffuse, reflectance_at, transmittance,
)
from .optics cimport reflection_change, refraction_change
from .raycast cimport EmbreeFrame, EmbreeHits, Hit, Triangles

# Limit of the change of a unit vector over a sample, beyond which it is anywhere.
cdef double LONGEST_CHANGE = 2.0


cdef struct SeenPoint:
    double[3] position
    double[3] normal
    double[3] weight
    double[2][3] footprint
    int64_t pixel
    # Object, and face of its mesh where that has a texture.
    int32_t object_id, face_id
    bint from_behind


cdef struct CameraRay:
    double[3] origin
    double[3] direction
    double[3] weight
    # Changes over the width and the height of a sample.
    double[2][3] origin_change
    double[2][3] direction_change
    uint64_t media
    int64_t pixel


cdef struct Meeting:
    # One ray at one surface. `inside` is true if it meets the back of the face.
    CameraRay ray
    Hit hit
    int32_t triangle
    bint inside


@cython.final
cdef class CameraPaths(LiveRays):
    """Camera rays that are followed together, one batch after another.

    Parameters
    ----------
    materials, frame, triangles : Materials, EmbreeFrame, Triangles
        Of the scene.
    least_weight : float
        Rays of less weight in every channel are not followed.
    longest_edge : float
        Limit of the edges of footprints, m: at grazing angles they have none.
    first_emitter : int
        First surface that emits. Rays that meet one which is specular, too, are recorded as points
        there, beside their continuations; and those that hit nothing as points of object -1. -1 for
        neither.
    """

    cdef double least_weight, longest_edge
    cdef int first_emitter
    # Rays of this level and of the next, (n, sizeof(CameraRay)).
    cdef unsigned char[::1] memory, next_memory
    cdef CameraRay* ray
    cdef CameraRay* next_ray
    # The hits (n, sizeof(Hit)) of the live rays that `first_surfaces` has refined, if any.
    cdef unsigned char[::1] hit_memory
    cdef Hit* hit
    cdef EmbreeHits refined
    # (n, sizeof(SeenPoint))
    cdef unsigned char[::1] seen_memory
    cdef SeenPoint* seen
    cdef Py_ssize_t n_seen
    # Number of points seen on each level.
    cdef list seen_on_level

    def __init__(
        self, Materials materials, EmbreeFrame frame, Triangles triangles, *, double least_weight,
        double longest_edge, int first_emitter=-1,
    ):
        super().__init__(materials, frame, triangles)
        self.least_weight, self.longest_edge = least_weight, longest_edge
        self.first_emitter = first_emitter
        self.memory = self.next_memory = np.empty(0, np.uint8)
        self.origins = np.empty((0, 3), np.float32)
        self.hit_memory = self.seen_memory = np.empty(0, np.uint8)
        self.seen_on_level = []

    def live_rays(self):
        """Pixels (n_live,), origins and directions (n_live, 3) of the live rays."""
        cdef Py_ssize_t i
        pixel = np.empty(self.n_live, np.int64)
        origin, direction = np.empty((self.n_live, 3)), np.empty((self.n_live, 3))
        cdef int64_t[::1] pixels = pixel
        cdef double[:, ::1] origins = origin, directions = direction
        for i in range(self.n_live):
            pixels[i] = self.ray[i].pixel
            copy(&origins[i, 0], self.ray[i].origin)
            copy(&directions[i, 0], self.ray[i].direction)
        return pixel, origin, direction

    def start(
        self, const double[:, ::1] origin, const double[:, ::1] direction, const int64_t[::1] pixel,
        *, const double[::1] axis, const double[:, ::1] origin_change,
        const double[:, ::1] film_change,
    ):
        """Start the rays of a batch, outside of all media.

        Parameters
        ----------
        origin, direction, pixel : (n, 3), (n, 3), (n,)
            Unit directions.
        axis : (3,)
            Viewing axis of the camera, a unit vector.
        origin_change, film_change : (2, 3)
            Changes over the width and the height of a sample: of origins, and of the points where
            rays cross a film at a distance of 1 along the axis.
        """
        cdef Py_ssize_t i, n = origin.shape[0]
        if not (
            direction.shape[0] == pixel.shape[0] == n
            and origin.shape[1] == direction.shape[1] == axis.shape[0] == 3
            and origin_change.shape[0] == film_change.shape[0] == 2
            and origin_change.shape[1] == film_change.shape[1] == 3
        ):
            raise ValueError("camera rays and their changes do not fit one another")
        self.restart(n)
        with nogil:
            for i in range(n):
                start_ray(
                    &self.ray[i], &origin[i, 0], &direction[i, 0], &axis[0],
                    &origin_change[0, 0], &film_change[0, 0],
                )
                self.ray[i].pixel = pixel[i]
                to_embree(self, i, self.ray[i].origin, self.ray[i].direction, NULL)
        self.n_live = n
        self.check_finite()

    def start_gather(
        self, const double[:, ::1] origin, const double[:, ::1] direction, const int64_t[::1] pixel,
        const double[::1] spread,
    ):
        """Start rays (n, 3) from points, outside of all media.

        Each has a square of directions, of a side that is its `spread` (n,), rad.
        """
        cdef Py_ssize_t i, n = origin.shape[0]
        if not (
            direction.shape[0] == pixel.shape[0] == spread.shape[0] == n
            and origin.shape[1] == direction.shape[1] == 3
        ):
            raise ValueError("rays and their spreads do not fit one another")
        self.restart(n)
        with nogil:
            for i in range(n):
                start_square(&self.ray[i], &origin[i, 0], &direction[i, 0], spread[i])
                self.ray[i].pixel = pixel[i]
                to_embree(self, i, self.ray[i].origin, self.ray[i].direction, NULL)
        self.n_live = n
        self.check_finite()

    cdef restart(self, Py_ssize_t n):
        """Make room for n rays of a new batch."""
        self.n_seen = 0
        self.refined = None
        self.faults.take()
        self.reserve(n)
        self.ray, self.next_ray = self.next_ray, self.ray
        self.memory, self.next_memory = self.next_memory, self.memory
        self.finite = True

    def set_media(self, const uint64_t[::1] media):
        """Set the media (n_live,) that the live rays start in."""
        cdef Py_ssize_t i
        if media.shape[0] != self.n_live:
            raise ValueError(f"media should be of {self.n_live} rays, but are {media.shape[0]}")
        for i in range(self.n_live):
            self.ray[i].media = media[i]

    def first_surfaces(self, EmbreeHits found, const double[::1] axis, Py_ssize_t n_samples):
        """Surfaces that pixels of `n_samples` live rays each see first.

        Rays that start on a surface are moved off it: `found` has to be found again for them.

        Returns
        -------
        normal : (n, 3)
            Means of the shading normals on the side of the rays, zero for rays that hit nothing.
        depth : (n,)
            Least distances along an axis, m; infinite where nothing is hit.
        n_moved : int
            Number of rays that start on a surface.
        """
        cdef Py_ssize_t i, pixel, c, n_moved = 0, n = self.n_live // n_samples
        cdef double[:, ::1] normal = np.zeros((n, 3))
        cdef double[::1] depth = np.full(n, INFINITY)
        cdef double[3] own
        cdef Hit* hit
        if axis.shape[0] != 3 or n * n_samples != self.n_live:
            raise ValueError("axis and samples do not fit the rays")
        self.check_hits(found)
        self.keep_hits_of(found)
        with nogil:
            for i in range(self.n_live):
                hit = &self.hit[i]
                if not self.refine(hit, found, i):
                    continue
                pixel = i // n_samples
                seen_normal(own, self.ray[i].direction, hit)
                for c in range(3):
                    normal[pixel, c] += own[c]
                depth[pixel] = min(
                    depth[pixel], hit.distance * dot(self.ray[i].direction, &axis[0])
                )
                n_moved += self.leave_surface(i, hit)
            for pixel in range(n):
                for c in range(3):
                    normal[pixel, c] /= n_samples
        return normal.base, depth.base, n_moved

    def leave_surfaces(self, EmbreeHits found):
        """Move rays off surfaces that they start on; return the number of these.

        `found` has to be found again for them.
        """
        cdef Py_ssize_t i, n_moved = 0
        cdef Hit hit
        self.check_hits(found)
        with nogil:
            for i in range(self.n_live):
                if self.refine(&hit, found, i):
                    n_moved += self.leave_surface(i, &hit)
        return n_moved

    def advance(self, EmbreeHits found):
        """Process the hit of every live ray; return the number of their continuations."""
        cdef Py_ssize_t i, live = 0, before = self.n_seen
        self.check_hits(found)
        self.reserve(2 * self.n_live)
        with nogil:
            for i in range(self.n_live):
                live = self.process(found, i, live)
        self.refined = None
        self.ray, self.next_ray = self.next_ray, self.ray
        self.memory, self.next_memory = self.next_memory, self.memory
        self.n_live = live
        self.seen_on_level.append(self.n_seen - before)
        self.check_finite()
        return live

    def seen_points(self):
        """Columns of the points seen by the batch, (m, …), in the order of the levels."""
        cdef Py_ssize_t i, m = self.n_seen
        cdef int64_t[::1] pixel = np.empty(m, np.int64)
        cdef int32_t[::1] object_id = np.empty(m, np.int32)
        cdef int32_t[::1] face_id = np.empty(m, np.int32)
        cdef uint8_t[::1] from_behind = np.empty(m, np.uint8)
        cdef double[:, ::1] position = np.empty((m, 3)), normal = np.empty((m, 3))
        cdef double[:, ::1] weight = np.empty((m, 3))
        cdef double[:, :, ::1] footprint = np.empty((m, 2, 3))
        with nogil:
            for i in range(m):
                pixel[i], object_id[i] = self.seen[i].pixel, self.seen[i].object_id
                from_behind[i] = self.seen[i].from_behind
                face_id[i] = self.seen[i].face_id
                copy(&position[i, 0], self.seen[i].position)
                copy(&normal[i, 0], self.seen[i].normal)
                copy(&weight[i, 0], self.seen[i].weight)
                copy(&footprint[i, 0, 0], self.seen[i].footprint[0])
                copy(&footprint[i, 1, 0], self.seen[i].footprint[1])
        return {
            "pixel": pixel.base,
            "position": position.base,
            "normal": normal.base,
            "weight": weight.base,
            "object_id": object_id.base,
            "face_id": face_id.base,
            "from_behind": from_behind.base.view(np.bool_),
            "footprint": footprint.base,
            "n_specular": np.repeat(
                np.arange(len(self.seen_on_level), dtype=np.int32), self.seen_on_level
            ),
        }

    cdef check_hits(self, EmbreeHits found):
        if found.n_rays != self.n_live:
            raise ValueError(f"found should be of {self.n_live} rays, but is of {found.n_rays}")

    cdef check_finite(self):
        if not self.finite:
            raise ValueError("rays should be finite, but the camera or the scene leads some away")

    cdef keep_hits_of(self, EmbreeHits found):
        """Make room for hits of the live rays, which are refined once for both of their passes."""
        cdef Py_ssize_t size = self.n_live * sizeof(Hit)
        if self.hit_memory.shape[0] < size:
            self.hit_memory = np.empty(size, np.uint8)
            self.hit = <Hit*> &self.hit_memory[0]
        self.refined = found

    cdef reserve(self, Py_ssize_t n):
        """Make room for n rays of the next level, and for as many points more."""
        cdef unsigned char[::1] larger
        cdef Py_ssize_t seen = (self.n_seen + n) * sizeof(SeenPoint)
        if self.next_memory.shape[0] < n * <Py_ssize_t> sizeof(CameraRay):
            self.next_memory = np.empty(n * sizeof(CameraRay), np.uint8)
        if n:
            self.next_ray = <CameraRay*> &self.next_memory[0]
        if self.origins.shape[0] < n:
            self.origins = self.origin_array = np.empty((n, 3), np.float32)
            self.directions = self.direction_array = np.empty((n, 3), np.float32)
        if self.seen_memory.shape[0] < seen:
            larger = np.empty(max(seen, 2 * self.seen_memory.shape[0]), np.uint8)
            larger[: self.seen_memory.shape[0]] = self.seen_memory
            self.seen_memory = larger
            self.seen = <SeenPoint*> &self.seen_memory[0]

    cdef bint refine(self, Hit* hit, EmbreeHits found, Py_ssize_t i) noexcept nogil:
        """Write the hit of a live ray; false for a miss."""
        self.triangles.prefetch(found, i)
        return self.triangles.refine_hit(
            found, i, self.ray[i].origin, self.ray[i].direction, hit
        )

    cdef bint leave_surface(self, Py_ssize_t i, const Hit* hit) noexcept nogil:
        """Move a live ray off the surface that it hits if it starts on that."""
        cdef double[3] offset
        cdef int c
        if hit.distance * fabs(dot(self.ray[i].direction, hit.geometric)) > hit.step:
            return False
        for c in range(3):
            offset[c] = hit.step * hit.geometric[c]
        to_embree(self, i, self.ray[i].origin, self.ray[i].direction, offset)
        return True

    cdef Passage passage(self, Py_ssize_t row) noexcept nogil:
        cdef CameraRay* ray = &self.ray[row]
        return Passage(&ray.origin[0], &ray.direction[0], &ray.media)

    cdef Py_ssize_t process(
        self, EmbreeHits found, Py_ssize_t row, Py_ssize_t target
    ) noexcept nogil:
        """Record a diffuse point, or write the continuations from row `target`; return the end."""
        cdef Meeting at
        cdef double[3] transmitted
        cdef int c
        if self.refined is found:
            at.hit = self.hit[row]
        else:
            self.refine(&at.hit, found, row)
        if at.hit.object_id < 0:
            if self.first_emitter >= 0:
                self.record_escape(&self.ray[row])
            return target
        at.ray = self.ray[row]
        at.triangle = found.triangle[row]
        at.inside = dot(at.ray.direction, at.hit.geometric) > 0.0
        transfer(&at)
        at.ray.media = counted_media_at(
            self.materials, self.faults, at.hit.object_id, at.inside, at.ray.media
        )
        if is_absorbing(self.materials, at.ray.media):
            transmittance(transmitted, self.materials, at.ray.media, at.hit.distance)
            for c in range(3):
                at.ray.weight[c] *= transmitted[c]
        if is_diffuse(self.materials, at.hit.object_id):
            self.record(&at)
            return target
        if 0 <= self.first_emitter <= at.hit.object_id:
            self.record(&at)
        return self.split(&at, target)

    cdef void record_escape(self, const CameraRay* ray) noexcept nogil:
        """Record a ray that hits nothing: its direction for a normal, its changes for edges."""
        cdef SeenPoint* point = &self.seen[self.n_seen]
        cdef int side
        self.n_seen += 1
        point[0] = SeenPoint(pixel=ray.pixel, object_id=-1, face_id=-1)
        copy(point.weight, ray.weight)
        copy(point.normal, ray.direction)
        for side in range(2):
            write_limited(point.footprint[side], ray.direction_change[side], LONGEST_CHANGE)

    cdef void record(self, const Meeting* at) noexcept nogil:
        cdef SeenPoint* point = &self.seen[self.n_seen]
        cdef int side
        self.n_seen += 1
        point.pixel = at.ray.pixel
        point.object_id = at.hit.object_id
        point.face_id = -1
        if self.materials.is_textured[at.hit.object_id]:
            point.face_id = self.triangles.face_id[at.triangle]
        point.from_behind = at.inside
        copy(point.position, at.hit.position)
        seen_normal(point.normal, at.ray.direction, &at.hit)
        copy(point.weight, at.ray.weight)
        for side in range(2):
            write_limited(point.footprint[side], at.ray.origin_change[side], self.longest_edge)

    cdef Py_ssize_t split(self, Meeting* at, Py_ssize_t target) noexcept nogil:
        """Write the reflection and the refraction of a ray, unless faint; return the end."""
        cdef Arrival arrival = Arrival(
            &at.ray.direction[0], &at.hit.geometric[0], &at.hit.shading[0], at.hit.object_id,
            at.inside, at.ray.media, 0.0,
        )
        cdef Interface to
        cdef double[2][3] normal_change
        cdef double[3] weight, reflectance
        cdef int32_t i = at.hit.object_id
        cdef int c
        interface_at(&to, self.materials, &arrival)
        reflectance_at(reflectance, self.materials, i, cosine_at(&to, &arrival))
        self.change_normal(normal_change, at, to.to.is_shading)
        for c in range(3):
            weight[c] = at.ray.weight[c] * to.reflected * reflectance[c]
        if self.is_followed(weight):
            self.follow(at, target, to.to.reflection, weight, at.ray.media)
            for c in range(2):
                reflection_change(
                    self.next_ray[target].direction_change[c], at.ray.direction, to.to.normal,
                    at.ray.direction_change[c], normal_change[c],
                )
            target += 1
        if to.reflected == 1.0:
            return target
        for c in range(3):
            # Radiance over the square of the index is constant across an interface.
            weight[c] = at.ray.weight[c] * (1.0 - to.reflected) * (to.n1 / to.n2) ** 2
            weight[c] *= self.materials.tint[i, c]
        if to.overflows:
            add_fault(self.faults, i, OVERFLOWED)
        if self.is_followed(weight):
            self.follow(at, target, to.to.refraction, weight, to.beyond)
            for c in range(2):
                refraction_change(
                    self.next_ray[target].direction_change[c], at.ray.direction, to.to.normal,
                    at.ray.direction_change[c], normal_change[c], to.n1, to.n2,
                )
            target += 1
        return target

    cdef bint is_followed(self, const double* weight) noexcept nogil:
        return max(weight[0], max(weight[1], weight[2])) >= self.least_weight

    cdef void follow(
        self, const Meeting* at, Py_ssize_t target, const double* direction, const double* weight,
        uint64_t media,
    ) noexcept nogil:
        """Write a ray that leaves a surface, but for the changes of its direction."""
        cdef CameraRay* ray = &self.next_ray[target]
        cdef double[3] offset
        cdef int c
        copy(ray.origin, at.hit.position)
        copy(ray.direction, direction)
        copy(ray.weight, weight)
        copy(ray.origin_change[0], at.ray.origin_change[0])
        copy(ray.origin_change[1], at.ray.origin_change[1])
        ray.media = media
        ray.pixel = at.ray.pixel
        for c in range(3):
            offset[c] = at.hit.step * at.hit.geometric[c]
        to_embree(self, target, ray.origin, ray.direction, offset)

    cdef void change_normal(
        self, double[3]* out, const Meeting* at, bint is_shading
    ) noexcept nogil:
        """Write the changes of the normal over the edges on the surface, on the ray's side."""
        cdef double[9] derivative
        cdef double side = -1.0 if at.inside else 1.0
        cdef int edge, c
        for edge in range(2):
            for c in range(3):
                out[edge][c] = 0.0
        if not (is_shading and self.triangles.smooth[at.hit.object_id]):
            return
        self.derivative(derivative, at)
        for edge in range(2):
            change_along(out[edge], derivative, at.ray.origin_change[edge])
            for c in range(3):
                out[edge][c] *= side

    cdef void derivative(self, double* out, const Meeting* at) noexcept nogil:
        cdef const double* a = &self.triangles.corners[self.triangles.faces[at.triangle, 0], 0]
        cdef const double* b = &self.triangles.corners[self.triangles.faces[at.triangle, 1], 0]
        cdef const double* c = &self.triangles.corners[self.triangles.faces[at.triangle, 2], 0]
        cdef double[3] position
        cdef int axis
        for axis in range(3):
            position[axis] = at.hit.position[axis] - self.frame.origin[axis]
        normal_derivative(out, position, a, b, c, a + 3, b + 3, c + 3)


cdef inline void write_limited(double* out, const double* change, double longest) noexcept nogil:
    """Write a change: no longer than the limit, and zero if not finite."""
    cdef double length = sqrt(dot(change, change))
    cdef double scale = 0.0
    cdef int c
    if isfinite(length):
        scale = 1.0 if length <= longest else longest / length
    for c in range(3):
        out[c] = scale * change[c] if scale > 0.0 else 0.0


cdef void start_ray(
    CameraRay* ray, const double* origin, const double* direction, const double* axis,
    const double* origin_change, const double* film_change,
) noexcept nogil:
    """Write a ray of weight one outside of all media.

    A change of where a ray crosses the film changes its direction by what is perpendicular to it,
    over the distance to the film.
    """
    cdef double along, per_distance = dot(direction, axis)
    cdef int edge, c
    copy(ray.origin, origin)
    copy(ray.direction, direction)
    ray.media = 0
    for c in range(3):
        ray.weight[c] = 1.0
    for edge in range(2):
        copy(ray.origin_change[edge], origin_change + 3 * edge)
        along = dot(direction, film_change + 3 * edge)
        for c in range(3):
            ray.direction_change[edge][c] = per_distance * (
                film_change[3 * edge + c] - along * direction[c]
            )


cdef void start_square(
    CameraRay* ray, const double* origin, const double* direction, double spread
) noexcept nogil:
    """Write a ray of weight one outside of all media, with a square of directions around it."""
    cdef int edge, c
    copy(ray.origin, origin)
    copy(ray.direction, direction)
    ray.media = 0
    orthonormal_frame(ray.direction_change[0], ray.direction_change[1], direction)
    for c in range(3):
        ray.weight[c] = 1.0
    for edge in range(2):
        for c in range(3):
            ray.origin_change[edge][c] = 0.0
            ray.direction_change[edge][c] *= spread


cdef void transfer(Meeting* at) noexcept nogil:
    """Carry the changes of the ray's origin to its hit, along the face."""
    cdef double* change
    cdef double along, facing = dot(at.ray.direction, at.hit.geometric)
    cdef int edge, c
    for edge in range(2):
        change = at.ray.origin_change[edge]
        for c in range(3):
            change[c] += at.hit.distance * at.ray.direction_change[edge][c]
        along = dot(change, at.hit.geometric) / facing
        for c in range(3):
            change[c] -= along * at.ray.direction[c]


cdef void seen_normal(double* out, const double* direction, const Hit* hit) noexcept nogil:
    """Write the shading normal on the side of the face that the ray comes from."""
    cdef double side = -1.0 if dot(direction, hit.geometric) > 0.0 else 1.0
    cdef int c
    for c in range(3):
        out[c] = side * hit.shading[c]
