"""What happens to paths where their rays hit: one pass over all live rays, without the GIL.

Paths advance in their own order and live rays stay in it, so every sum is taken in the order of
the photons however they are split into batches.
"""

cimport cython
from libc.math cimport exp
from libc.stdint cimport int32_t, int64_t, uint64_t

from .core cimport dot, hash_key, mix, orthonormal_frame, uniform
from .optics cimport facing_normal, fresnel_reflectance, reflect_into, refract_into
from .sampling cimport disk_point, hemisphere_direction

# The values of scene.py, and the places of photonmap.FATES and emit.PATHS.
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


@cython.final
cdef class Hits:
    """What the live rays hit."""

    cdef const int32_t[::1] object_id
    cdef const double[::1] distance
    cdef const double[:, ::1] position, geometric_normal, shading_normal

    def __init__(
        self, const int32_t[::1] object_id, const double[::1] distance,
        const double[:, ::1] position, const double[:, ::1] geometric_normal,
        const double[:, ::1] shading_normal,
    ):
        self.object_id = object_id
        self.distance = distance
        self.position = position
        self.geometric_normal = geometric_normal
        self.shading_normal = shading_normal


@cython.final
cdef class Deposits:
    """Room for what one pass stores."""

    cdef int32_t[::1] path, n_bounces, object_id
    cdef double[:, ::1] position, normal, wi, throughput
    cdef double[::1] path_length
    cdef int64_t[::1] path_signature

    def __init__(
        self, int32_t[::1] path, double[:, ::1] position, double[:, ::1] normal,
        double[:, ::1] wi, double[:, ::1] throughput, double[::1] path_length,
        int64_t[::1] path_signature, int32_t[::1] n_bounces, int32_t[::1] object_id,
    ):
        self.path = path
        self.position = position
        self.normal = normal
        self.wi = wi
        self.throughput = throughput
        self.path_length = path_length
        self.path_signature = path_signature
        self.n_bounces = n_bounces
        self.object_id = object_id


cdef struct Event:
    # One ray at one surface: `towards` faces back to where the ray came from.
    int32_t object_id
    bint inside
    const double* direction
    const double* geometric
    const double* shading
    double[3] towards
    uint64_t key
    uint64_t counter


cdef void orient(Event* event) noexcept nogil:
    """Find the side of the face that the ray comes from."""
    cdef int c
    event.inside = dot(event.direction, event.geometric) > 0.0
    for c in range(3):
        event.towards[c] = -event.geometric[c] if event.inside else event.geometric[c]


cdef void scatter(double* out, const Event* event) noexcept nogil:
    """Draw a direction with cosine density around the normal."""
    cdef double[3] u
    cdef double[3] v
    cdef double[3] local
    cdef double[2] disk
    cdef int c
    orthonormal_frame(u, v, event.towards)
    disk_point(
        disk,
        uniform(event.key, event.counter + OF_DIRECTION),
        uniform(event.key, event.counter + OF_DIRECTION + 1),
    )
    hemisphere_direction(local, disk)
    for c in range(3):
        out[c] = local[0] * u[c] + local[1] * v[c] + local[2] * event.towards[c]


@cython.final
cdef class Paths:
    """A batch of paths of one emitter.

    `origin`, `direction`, `leaving` and `path` hold the live rays, packed at the front and
    ordered by path; the other arrays have a row per path. Ledger rows belong to blocks of
    `block` photons, counted from the emitter's first.
    """

    cdef Surfaces surfaces
    cdef double[:, ::1] origin, direction, leaving
    cdef int32_t[::1] path
    cdef double[:, ::1] throughput
    cdef double[::1] path_length
    cdef uint64_t[::1] signature, key
    cdef int32_t[::1] n_specular, n_diffuse, medium
    cdef double[:, :, ::1] ledger
    cdef int64_t[::1] ends
    cdef const double[::1] luminance
    cdef int wanted, max_bounces, block
    cdef readonly Py_ssize_t n_live, n_deposits
    cdef readonly int64_t n_met_specular

    def __init__(
        self, Surfaces surfaces, double[:, ::1] origin, double[:, ::1] direction,
        double[:, ::1] leaving, int32_t[::1] path, double[:, ::1] throughput,
        double[::1] path_length, uint64_t[::1] signature, uint64_t[::1] key,
        int32_t[::1] n_specular, int32_t[::1] n_diffuse, int32_t[::1] medium,
        double[:, :, ::1] ledger, int64_t[::1] ends, *, const double[::1] luminance,
        int wanted, int max_bounces, int block,
    ):
        self.surfaces = surfaces
        self.origin, self.direction, self.leaving, self.path = origin, direction, leaving, path
        self.throughput, self.path_length = throughput, path_length
        self.signature, self.key = signature, key
        self.n_specular, self.n_diffuse, self.medium = n_specular, n_diffuse, medium
        self.ledger, self.ends = ledger, ends
        self.luminance = luminance
        self.wanted, self.max_bounces, self.block = wanted, max_bounces, block
        self.n_met_specular = 0

    def start(self, uint64_t seed, uint64_t emitter_id, uint64_t first, double travelled):
        """Make every path a live ray that has not met anything yet."""
        cdef Py_ssize_t i
        cdef int c
        with nogil:
            for i in range(self.path.shape[0]):
                self.path[i] = <int32_t>i
                self.key[i] = hash_key(seed, emitter_id, first + i)
                self.path_length[i] = travelled
                self.n_specular[i] = self.n_diffuse[i] = 0
                self.signature[i] = 0
                self.medium[i] = -1
                for c in range(3):
                    self.leaving[i, c] = 0.0
                    # Colours the emitter lacks stay out of every product.
                    self.throughput[i, c] = 1.0 if self.luminance[c] > 0.0 else 0.0
        self.n_live = self.path.shape[0]

    def advance(self, Hits hits, Deposits deposits):
        """Take every live ray through the surface it hit; return how many are still live."""
        cdef Py_ssize_t ray, live = 0
        self.n_deposits = 0
        with nogil:
            for ray in range(self.n_live):
                # Row `live` is never beyond row `ray`, so the rays pack in place.
                live += self.meet(ray, live, hits, deposits)
        self.n_live = live
        return live

    cdef bint meet(
        self, Py_ssize_t ray, Py_ssize_t target, Hits hits, Deposits deposits
    ) noexcept nogil:
        """Take one ray through what it hit; true if it goes on, from row `target`."""
        cdef Py_ssize_t path = self.path[ray]
        cdef Event event
        cdef double[3] out
        event.object_id = hits.object_id[ray]
        if event.object_id < 0:
            return self.end(path, ESCAPED)
        event.direction = &self.direction[ray, 0]
        event.key = self.key[path]
        event.counter = PER_EVENT * (1 + self.n_specular[path] + self.n_diffuse[path])
        event.geometric = &hits.geometric_normal[ray, 0]
        event.shading = &hits.shading_normal[ray, 0]
        orient(&event)
        self.path_length[path] += hits.distance[ray]
        if not self.survives_medium(path, &event, hits.distance[ray]):
            return self.end(path, ABSORBED)
        if self.surfaces.kind[event.object_id] == DIFFUSE:
            if not self.at_diffuse(out, path, ray, &event, hits, deposits):
                return False
        elif not self.at_specular(out, path, &event):
            return self.end(path, ABSORBED)
        if self.n_specular[path] + self.n_diffuse[path] > self.max_bounces:
            return self.end(path, CUT)
        self.go_on(target, path, &hits.position[ray, 0], out, event.towards)
        return True

    cdef void go_on(
        self, Py_ssize_t target, Py_ssize_t path, const double* position, const double* direction,
        const double* leaving,
    ) noexcept nogil:
        cdef int c
        self.path[target] = <int32_t>path
        for c in range(3):
            self.origin[target, c] = position[c]
            self.direction[target, c] = direction[c]
            self.leaving[target, c] = leaving[c]

    cdef bint survives_medium(
        self, Py_ssize_t path, const Event* event, double distance
    ) noexcept nogil:
        """Beer–Lambert over the way to this hit.

        A ray that hits a dielectric from inside was in it; any other was in what it last entered.
        """
        cdef int32_t medium = self.medium[path]
        cdef double[3] transmittance
        cdef int c
        if event.inside and self.surfaces.kind[event.object_id] == DIELECTRIC:
            medium = self.medium[path] = event.object_id
        if medium < 0:
            return True
        for c in range(3):
            transmittance[c] = exp(-self.surfaces.absorption[medium, c] * distance)
        return self.roulette(path, transmittance, event, OF_MEDIUM, ABSORBED)

    cdef bint at_specular(self, double* out, Py_ssize_t path, const Event* event) noexcept nogil:
        """Leave a mirror or an interface in direction `out`; false if absorbed."""
        cdef int32_t i = event.object_id
        cdef int what = REFLECTED
        cdef double[3] normal
        self.n_met_specular += self.n_specular[path] == 0 and self.n_diffuse[path] == 0
        if self.surfaces.kind[i] == MIRROR:
            if not self.roulette(
                path, &self.surfaces.reflectance[i, 0], event, OF_SURFACE, ABSORBED
            ):
                return False
            facing_normal(normal, event.direction, event.geometric, event.shading, 1.0, 1.0)
            reflect_into(out, event.direction, normal)
        else:
            what = self.through_interface(
                out, path, event, self.surfaces.ior[i], self.surfaces.exterior_ior[i]
            )
        self.n_specular[path] += 1
        self.sign(path, i, what)
        return True

    cdef int through_interface(
        self, double* out, Py_ssize_t path, const Event* event, double inner, double outer
    ) noexcept nogil:
        """Reflect or refract, keep track of the medium, and return which it was."""
        cdef double n1 = inner if event.inside else outer
        cdef double n2 = outer if event.inside else inner
        cdef double choice = uniform(event.key, event.counter + OF_SURFACE)
        cdef double[3] normal
        facing_normal(normal, event.direction, event.geometric, event.shading, n1, n2)
        if choice < fresnel_reflectance(min(-dot(event.direction, normal), 1.0), n1, n2):
            reflect_into(out, event.direction, normal)
            return REFLECTED
        refract_into(out, event.direction, normal, n1, n2)
        self.medium[path] = -1 if event.inside else event.object_id
        return LEFT if event.inside else ENTERED

    cdef bint at_diffuse(
        self, double* out, Py_ssize_t path, Py_ssize_t ray, const Event* event, Hits hits,
        Deposits deposits,
    ) noexcept nogil:
        """Deposit what is wanted; true if the path is scattered on in direction `out`."""
        cdef bint stored = True
        cdef int fate
        if self.wanted == CAUSTIC:
            stored = self.n_specular[path] > 0
        elif self.wanted == GLOBAL:
            stored = self.n_diffuse[path] > 0
        fate = STORED if stored else DISCARDED
        if stored:
            self.deposit(path, event, &hits.position[ray, 0], deposits)
        if self.wanted == CAUSTIC or not self.roulette(
            path, &self.surfaces.reflectance[event.object_id, 0], event, OF_SURFACE, fate
        ):
            return self.end(path, fate)
        scatter(out, event)
        self.n_diffuse[path] += 1
        self.sign(path, event.object_id, SCATTERED)
        return True

    cdef void deposit(
        self, Py_ssize_t path, const Event* event, const double* position, Deposits deposits
    ) noexcept nogil:
        cdef Py_ssize_t row = self.n_deposits
        cdef int c
        deposits.path[row] = <int32_t>path
        deposits.n_bounces[row] = self.n_specular[path]
        deposits.object_id[row] = event.object_id
        deposits.path_length[row] = self.path_length[path]
        deposits.path_signature[row] = <int64_t>self.signature[path]
        for c in range(3):
            deposits.position[row, c] = position[c]
            deposits.normal[row, c] = event.towards[c]
            deposits.wi[row, c] = -event.direction[c]
            deposits.throughput[row, c] = self.throughput[path, c]
        self.n_deposits = row + 1

    cdef bint roulette(
        self, Py_ssize_t path, const double* factor, const Event* event, int number, int fate
    ) noexcept nogil:
        """Let a path survive with the share of its luminance that is left; true if it does.

        Survivors keep their luminance, so photons of an emitter all carry the same. What a
        survivor gains or loses per channel is booked under `fate`.
        """
        cdef double before = 0.0, after = 0.0, kept
        cdef int c
        for c in range(3):
            before += self.luminance[c] * self.throughput[path, c]
            after += self.luminance[c] * self.throughput[path, c] * factor[c]
        if uniform(event.key, event.counter + number) * before >= after:
            return False
        for c in range(3):
            kept = self.throughput[path, c] * factor[c] * (before / after)
            self.ledger[path // self.block, fate, c] += self.throughput[path, c] - kept
            self.throughput[path, c] = kept
        return True

    cdef void sign(self, Py_ssize_t path, int32_t object_id, int what) noexcept nogil:
        cdef uint64_t step = 4 * <uint64_t>object_id + what + 1
        self.signature[path] = mix(self.signature[path] + step * <uint64_t>0x9E3779B97F4A7C15)

    cdef bint end(self, Py_ssize_t path, int fate) noexcept nogil:
        """Book what is left of a path; always false, for `it does not go on`."""
        cdef int c
        self.ends[fate] += 1
        for c in range(3):
            self.ledger[path // self.block, fate, c] += self.throughput[path, c]
        return False
