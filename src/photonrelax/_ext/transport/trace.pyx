"""What happens to paths where their rays hit: one pass over all live rays, without the GIL.

A pass takes every ray from what embree found to what embree is given next: the exact hit, the
event there, and the ray that leaves it. Live rays stay in the order of their paths, so every sum
is taken in the order of the photons however they are split into batches.
"""

cimport cython
from libc.math cimport exp, isfinite
from libc.stdint cimport int32_t, int64_t, uint64_t

import numpy as np

from ..common.rng cimport mix, uniform
from ..common.vec3 cimport dot, orthonormal_frame
from .deposits cimport Deposit, Deposits
from .emission cimport Emission
from .optics cimport facing_normal, fresnel_reflectance, reflect_into, refract_into
from .raycast cimport EmbreeFrame, EmbreeHits, Hit, Triangles
from .sampling cimport disk_point, hemisphere_direction

# The values of scene.py, and the places of photonmap.PATH_OUTCOMES and emit.PATHS.
cdef enum:
    DIFFUSE = 0
    MIRROR = 1
    DIELECTRIC = 2

    STORED = 0
    ABSORBED = 1
    ESCAPED = 2
    CUT = 3
    DISCARDED = 4

    CAUSTIC = 0
    GLOBAL = 1

# Events a path signature tells apart.
cdef enum:
    REFLECTED = 0
    ENTERED = 1
    LEFT = 2
    SCATTERED = 3

# Random numbers: the first few of a path are emission's; each event then has four.
cdef enum:
    PER_EVENT = 4
    OF_MEDIUM = 0
    OF_SURFACE = 1
    OF_DIRECTION = 2


# Photons whose energy is summed up together: a row of the ledger. Batches hold whole blocks, so
# the sums do not depend on the batches.
cdef enum:
    PER_BLOCK = 1024

BLOCK = PER_BLOCK


@cython.final
cdef class Surfaces:
    """The materials, one row per object."""

    cdef const int32_t[::1] kind
    cdef const double[:, ::1] reflectance, absorption
    cdef const double[::1] ior, exterior_ior

    def __init__(
        self, const int32_t[::1] kind, const double[:, ::1] reflectance, const double[::1] ior,
        const double[::1] exterior_ior, const double[:, ::1] absorption,
    ):
        self.kind = kind
        self.reflectance = reflectance
        self.ior = ior
        self.exterior_ior = exterior_ior
        self.absorption = absorption


cdef struct Ray:
    # A live path. `path` counts from the first of the batch; `medium` is an object or -1.
    double[3] origin
    double[3] direction
    double[3] throughput
    double path_length
    uint64_t key, signature
    int32_t path, n_specular, n_diffuse, medium


cdef struct Event:
    # One ray at one surface: `towards` faces back to where the ray came from.
    Ray* ray
    Hit hit
    bint inside
    double[3] towards
    uint64_t counter


cdef void orient(Event* event) noexcept nogil:
    """Find the side of the face that the ray comes from."""
    cdef int c
    event.inside = dot(event.ray.direction, event.hit.geometric) > 0.0
    for c in range(3):
        event.towards[c] = -event.hit.geometric[c] if event.inside else event.hit.geometric[c]


cdef double chance(const Event* event, int number) noexcept nogil:
    return uniform(event.ray.key, event.counter + number)


cdef void scatter(double* out, const Event* event) noexcept nogil:
    """Draw a direction with cosine density around the normal."""
    cdef double[3] u
    cdef double[3] v
    cdef double[3] local
    cdef double[2] disk
    cdef int c
    orthonormal_frame(u, v, event.towards)
    disk_point(disk, chance(event, OF_DIRECTION), chance(event, OF_DIRECTION + 1))
    hemisphere_direction(local, disk)
    for c in range(3):
        out[c] = local[0] * u[c] + local[1] * v[c] + local[2] * event.towards[c]


cdef void sign(Ray* ray, int32_t object_id, int what) noexcept nogil:
    cdef uint64_t step = 4 * <uint64_t>object_id + what + 1
    ray.signature = mix(ray.signature + step * <uint64_t>0x9E3779B97F4A7C15)


@cython.final
cdef class Paths:
    """Room for batches of up to `size` paths of one emitter, one batch after the other.

    Live rays are packed at the front, in the order of their paths. Ledger rows belong to blocks
    of `BLOCK` photons, counted from the emitter's first.
    """

    cdef Surfaces surfaces
    cdef EmbreeFrame frame
    cdef Triangles triangles
    cdef unsigned char[::1] memory
    cdef Ray* ray
    cdef object origin_array, direction_array
    cdef float[:, ::1] origins, directions
    cdef readonly Deposits deposits
    cdef double[:, :, ::1] ledger
    cdef int64_t[::1] ends
    cdef double[3] luminance
    cdef int wanted, max_bounces
    cdef bint sound
    cdef readonly Py_ssize_t size, n_live
    cdef readonly int64_t n_met_specular

    def __init__(
        self, Surfaces surfaces, EmbreeFrame frame, Triangles triangles, Py_ssize_t size, *,
        int wanted, int max_bounces,
    ):
        self.surfaces, self.frame, self.triangles = surfaces, frame, triangles
        self.size = size
        self.memory = np.empty(size * sizeof(Ray), np.uint8)
        self.ray = <Ray*> &self.memory[0]
        self.origins = self.origin_array = np.empty((size, 3), np.float32)
        self.directions = self.direction_array = np.empty((size, 3), np.float32)
        self.deposits = Deposits(size)
        self.wanted, self.max_bounces = wanted, max_bounces

    @property
    def rays(self):
        """Origins and directions (n_live, 3) of the live rays, as embree takes them."""
        return self.origin_array[: self.n_live], self.direction_array[: self.n_live]

    def start(
        self, Emission emission, const int64_t[::1] photons, *, const double[::1] luminance,
        double[:, :, ::1] ledger, int64_t[::1] ends,
    ):
        """Emit photons by their indices into live rays that have met nothing yet."""
        cdef Py_ssize_t i, c, n = photons.shape[0]
        if n > self.size:
            raise ValueError(f"photons should be at most {self.size}, but are {n}")
        self.ledger, self.ends = ledger, ends
        self.n_met_specular = 0
        self.deposits.clear(n)
        for c in range(3):
            self.luminance[c] = luminance[c]
        self.sound = True
        with nogil:
            for i in range(n):
                self.emit(emission, i, photons[i])
        self.n_live = n
        self.check_sound()

    def live(self):
        """Return path, origin and direction of the live rays, (n_live, 7)."""
        cdef Py_ssize_t i, c
        cdef double[:, ::1] rows = np.empty((self.n_live, 7))
        for i in range(self.n_live):
            rows[i, 0] = self.ray[i].path
            for c in range(3):
                rows[i, 1 + c] = self.ray[i].origin[c]
                rows[i, 4 + c] = self.ray[i].direction[c]
        return np.asarray(rows)

    cdef void emit(self, Emission emission, Py_ssize_t path, uint64_t index) noexcept nogil:
        cdef Ray* ray = &self.ray[path]
        cdef int c
        ray.path = <int32_t>path
        ray.key = emission.key(index)
        ray.path_length = emission.region.start_distance
        ray.n_specular = ray.n_diffuse = 0
        ray.signature = 0
        ray.medium = -1
        for c in range(3):
            # Colours the emitter lacks stay out of every product.
            ray.throughput[c] = 1.0 if self.luminance[c] > 0.0 else 0.0
        self.deposits.coords[path, 2] = 0.0
        self.deposits.density[path] = emission.ray(
            index, ray.origin, ray.direction, &self.deposits.coords[path, 0]
        )
        self.enter(path, NULL)

    def advance(self, EmbreeHits found):
        """Take every live ray through the surface it hit; return how many are still live."""
        cdef Py_ssize_t i, live = 0
        if found.n_rays != self.n_live:
            raise ValueError(f"found should be of {self.n_live} rays, but is of {found.n_rays}")
        self.deposits.reserve(self.n_live)
        with nogil:
            for i in range(self.n_live):
                self.triangles.prefetch(found, i)
                # Row `live` is never beyond row i, so the rays pack in place.
                live += self.meet(found, i, live)
        self.n_live = live
        self.check_sound()
        return live

    cdef check_sound(self):
        if not self.sound:
            raise ValueError("rays should be finite, but the scene leads some to infinity")

    cdef void enter(self, Py_ssize_t row, const double* leaving) noexcept nogil:
        """Write a ray as embree takes it."""
        cdef Ray* ray = &self.ray[row]
        cdef double skipped = self.frame.ray_to_embree(
            ray.origin, ray.direction, leaving, &self.origins[row, 0], &self.directions[row, 0]
        )
        if not isfinite(skipped):
            self.sound = False

    cdef bint meet(self, EmbreeHits found, Py_ssize_t row, Py_ssize_t target) noexcept nogil:
        """Take one ray through what it hit; true if it goes on, from row `target`."""
        cdef Ray* ray = &self.ray[row]
        cdef Event event
        cdef double[3] out
        if not self.triangles.refine_hit(found, row, ray.origin, ray.direction, &event.hit):
            return self.end(ray, ESCAPED)
        event.ray = ray
        event.counter = PER_EVENT * (1 + ray.n_specular + ray.n_diffuse)
        orient(&event)
        ray.path_length += event.hit.distance
        if not self.survives_medium(&event):
            return self.end(ray, ABSORBED)
        if self.surfaces.kind[event.hit.object_id] == DIFFUSE:
            if not self.at_diffuse(out, &event):
                return False
        elif not self.at_specular(out, &event):
            return self.end(ray, ABSORBED)
        if ray.n_specular + ray.n_diffuse > self.max_bounces:
            return self.end(ray, CUT)
        self.go_on(target, &event, out)
        return True

    cdef void go_on(
        self, Py_ssize_t target, const Event* event, const double* direction
    ) noexcept nogil:
        cdef Ray* ray = &self.ray[target]
        cdef int c
        if ray != event.ray:
            ray[0] = event.ray[0]
        for c in range(3):
            ray.origin[c] = event.hit.position[c]
            ray.direction[c] = direction[c]
        self.enter(target, event.towards)

    cdef bint survives_medium(self, const Event* event) noexcept nogil:
        """Beer–Lambert over the way to this hit.

        A ray that hits a dielectric from inside was in it; any other was in what it last entered.
        """
        cdef double[3] transmittance
        cdef int c
        if event.inside and self.surfaces.kind[event.hit.object_id] == DIELECTRIC:
            event.ray.medium = event.hit.object_id
        if event.ray.medium < 0:
            return True
        for c in range(3):
            transmittance[c] = exp(
                -self.surfaces.absorption[event.ray.medium, c] * event.hit.distance
            )
        return self.roulette(transmittance, event, OF_MEDIUM, ABSORBED)

    cdef bint at_specular(self, double* out, const Event* event) noexcept nogil:
        """Leave a mirror or an interface in direction `out`; false if absorbed."""
        cdef int32_t i = event.hit.object_id
        cdef Ray* ray = event.ray
        cdef int what = REFLECTED
        cdef double[3] normal
        self.n_met_specular += ray.n_specular == 0 and ray.n_diffuse == 0
        if self.surfaces.kind[i] == MIRROR:
            if not self.roulette(&self.surfaces.reflectance[i, 0], event, OF_SURFACE, ABSORBED):
                return False
            facing_normal(normal, ray.direction, event.hit.geometric, event.hit.shading, 1.0, 1.0)
            reflect_into(out, ray.direction, normal)
        else:
            what = self.through_interface(
                out, event, self.surfaces.ior[i], self.surfaces.exterior_ior[i]
            )
        ray.n_specular += 1
        sign(ray, i, what)
        return True

    cdef int through_interface(
        self, double* out, const Event* event, double inner, double outer
    ) noexcept nogil:
        """Reflect or refract, keep track of the medium, and return which it was."""
        cdef double n1 = inner if event.inside else outer
        cdef double n2 = outer if event.inside else inner
        cdef const double* d = event.ray.direction
        cdef double[3] normal
        facing_normal(normal, d, event.hit.geometric, event.hit.shading, n1, n2)
        if chance(event, OF_SURFACE) < fresnel_reflectance(min(-dot(d, normal), 1.0), n1, n2):
            reflect_into(out, d, normal)
            return REFLECTED
        refract_into(out, d, normal, n1, n2)
        event.ray.medium = -1 if event.inside else event.hit.object_id
        return LEFT if event.inside else ENTERED

    cdef bint at_diffuse(self, double* out, const Event* event) noexcept nogil:
        """Deposit what is wanted; true if the path is scattered on in direction `out`."""
        cdef int32_t i = event.hit.object_id
        cdef Ray* ray = event.ray
        cdef bint stored = True
        cdef int fate
        if self.wanted == CAUSTIC:
            stored = ray.n_specular > 0
        elif self.wanted == GLOBAL:
            stored = ray.n_diffuse > 0
        fate = STORED if stored else DISCARDED
        if stored:
            self.deposit(event)
        if self.wanted == CAUSTIC or not self.roulette(
            &self.surfaces.reflectance[i, 0], event, OF_SURFACE, fate
        ):
            return self.end(ray, fate)
        scatter(out, event)
        ray.n_diffuse += 1
        sign(ray, i, SCATTERED)
        return True

    cdef void deposit(self, const Event* event) noexcept nogil:
        cdef Deposit* deposit = self.deposits.add()
        cdef const Ray* ray = event.ray
        cdef int c
        deposit.path = ray.path
        deposit.n_bounces = ray.n_specular
        deposit.object_id = event.hit.object_id
        deposit.path_length = ray.path_length
        deposit.path_signature = <int64_t>ray.signature
        for c in range(3):
            deposit.position[c] = event.hit.position[c]
            deposit.normal[c] = event.towards[c]
            deposit.wi[c] = -ray.direction[c]
            deposit.throughput[c] = ray.throughput[c]

    cdef bint roulette(
        self, const double* factor, const Event* event, int number, int fate
    ) noexcept nogil:
        """Let a path survive with the share of its luminance that is left; true if it does.

        Survivors keep their luminance, so photons of an emitter all carry the same. What a
        survivor gains or loses per channel is booked under `fate`.
        """
        cdef Ray* ray = event.ray
        cdef double before = 0.0, after = 0.0, kept
        cdef int c
        for c in range(3):
            before += self.luminance[c] * ray.throughput[c]
            after += self.luminance[c] * ray.throughput[c] * factor[c]
        if chance(event, number) * before >= after:
            return False
        for c in range(3):
            kept = ray.throughput[c] * factor[c] * (before / after)
            self.ledger[ray.path // PER_BLOCK, fate, c] += ray.throughput[c] - kept
            ray.throughput[c] = kept
        return True

    cdef bint end(self, const Ray* ray, int fate) noexcept nogil:
        """Book what is left of a path; always false, for `it does not go on`."""
        cdef int c
        self.ends[fate] += 1
        for c in range(3):
            self.ledger[ray.path // PER_BLOCK, fate, c] += ray.throughput[c]
        return False
