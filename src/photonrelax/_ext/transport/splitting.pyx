"""Rays that follow both branches at dielectrics, from emitters to diffuse surfaces.

A ray is known by its node, a point of an emitter's chart, and by the signature of its path. The
throughput of a branch is that of all light of its node that takes it. Either all branches are
followed: those below a threshold go on as single photons, by roulette, and from then on take one
branch of two, by a random number of their node and path. Or those are that lead to given sheets:
light of one path on one surface.
"""

cimport cython
from libc.stdint cimport int16_t, int32_t, uint8_t, uint64_t

import numpy as np

from ..common.rng cimport mix, uniform
from ..common.vec3 cimport copy, dot
from .live_rays cimport LiveRays, Passage, to_embree
from .materials cimport (
    OVERFLOWED, Arrival, Interface, Materials, add_fault, cosine_at, counted_media_at, interface_at,
    is_absorbing, is_diffuse, reflectance_at, transmittance,
)
from .path_events cimport ENTERED, LEFT, REFLECTED
from .raycast cimport EmbreeFrame, EmbreeHits, Hit, Triangles

# Random numbers of an event of a single photon.
cdef enum:
    OF_BRANCH = 0
    OF_ROULETTE = 1


cdef struct SplitRay:
    # `media` is a stack; `throughput` is of the light of the node.
    double[3] origin
    double[3] direction
    double[3] throughput
    uint64_t key, signature, parent, media
    int32_t node
    int16_t n_specular
    bint is_single


cdef struct Arrived:
    # Light of a node that has arrived on a diffuse surface, by one path.
    double[3] position
    double[3] normal
    double[3] throughput
    uint64_t sheet
    int32_t node, object_id
    bint is_single


cdef struct Meeting:
    SplitRay ray
    Hit hit
    bint inside


cdef inline uint64_t sheet_of(uint64_t signature, int32_t object_id) noexcept nogil:
    """Light of one path on one surface."""
    return signature ^ (<uint64_t>(object_id + 1) * <uint64_t>0x9E3779B97F4A7C15)


def sheets(const uint64_t[::1] signature, const int32_t[::1] object_id):
    """Sheets (n,) of light of path signatures on the surfaces of objects (n,)."""
    cdef Py_ssize_t i, n = signature.shape[0]
    cdef uint64_t[::1] out = np.empty(n, np.uint64)
    if object_id.shape[0] != n:
        raise ValueError("signatures and objects do not fit one another")
    for i in range(n):
        out[i] = sheet_of(signature[i], object_id[i])
    return out.base


@cython.final
cdef class SplitPaths(LiveRays):
    """Live rays of a batch, and the light that has arrived so far.

    Parameters
    ----------
    materials, frame, triangles
        Of the scene.
    least_throughput : float
        Branches of less in every channel are followed as single photons.
    max_bounces : int
        Events after which a ray ends.
    followed : (k,) uint64 array, optional
        Sheets, and the signatures of paths that lead to them, ascending: others are not followed,
        and none as single photons.
    """

    cdef double least_throughput
    cdef const uint64_t[::1] followed
    cdef readonly bint follows_all
    cdef int max_bounces
    cdef unsigned char[::1] memory, next_memory, arrived_memory
    cdef SplitRay* ray
    cdef SplitRay* next_ray
    cdef Arrived* arrived
    cdef Py_ssize_t n_arrived

    def __init__(
        self, Materials materials, EmbreeFrame frame, Triangles triangles, *,
        double least_throughput, int max_bounces, const uint64_t[::1] followed=None,
    ):
        LiveRays.__init__(self, materials, frame, triangles)
        self.follows_all = followed is None
        self.followed = np.empty(0, np.uint64) if followed is None else followed
        self.least_throughput, self.max_bounces = least_throughput, max_bounces
        self.memory = self.next_memory = self.arrived_memory = np.empty(0, np.uint8)
        self.origins = np.empty((0, 3), np.float32)

    def start(
        self, const double[:, ::1] origin, const double[:, ::1] direction, const uint64_t[::1] key,
        *, uint64_t media,
    ):
        """Start rays (n, 3) of unit directions within media; `key` (n,) seeds random numbers."""
        cdef Py_ssize_t i, c, n = key.shape[0]
        if not (origin.shape[0] == direction.shape[0] == n
                and origin.shape[1] == direction.shape[1] == 3):
            raise ValueError("origins, directions and keys do not fit one another")
        self.n_arrived = 0
        self.finite = True
        self.faults.take()
        self.reserve(n)
        self.swap()
        with nogil:
            for i in range(n):
                for c in range(3):
                    self.ray[i].origin[c], self.ray[i].direction[c] = origin[i, c], direction[i, c]
                    self.ray[i].throughput[c] = 1.0
                self.ray[i].key, self.ray[i].signature, self.ray[i].parent = key[i], 0, 0
                self.ray[i].media = media
                self.ray[i].node = <int32_t>i
                self.ray[i].n_specular = 0
                self.ray[i].is_single = False
                to_embree(self, i, self.ray[i].origin, self.ray[i].direction, NULL)
        self.n_live = n
        self.check_finite()

    def live_rays(self):
        """Nodes (n_live,), origins and directions (n_live, 3) of the live rays."""
        cdef Py_ssize_t i
        cdef int32_t[::1] node = np.empty(self.n_live, np.int32)
        cdef double[:, ::1] origin = np.empty((self.n_live, 3))
        cdef double[:, ::1] direction = np.empty((self.n_live, 3))
        for i in range(self.n_live):
            node[i] = self.ray[i].node
            copy(&origin[i, 0], self.ray[i].origin)
            copy(&direction[i, 0], self.ray[i].direction)
        return node.base, origin.base, direction.base

    def signatures(self):
        """Signatures (n_live, 2) of the live rays, and of their paths one event before."""
        cdef Py_ssize_t i
        cdef uint64_t[:, ::1] out = np.empty((self.n_live, 2), np.uint64)
        for i in range(self.n_live):
            out[i, 0], out[i, 1] = self.ray[i].signature, self.ray[i].parent
        return out.base

    def advance(self, EmbreeHits found):
        """Process the hit of every live ray; return the number of their continuations."""
        cdef Py_ssize_t i, live = 0
        if found.n_rays != self.n_live:
            raise ValueError(f"found should be of {self.n_live} rays, but is of {found.n_rays}")
        self.reserve(2 * self.n_live)
        with nogil:
            for i in range(self.n_live):
                live = self.process(found, i, live)
        self.swap()
        self.n_live = live
        self.check_finite()
        return live

    def arrivals(self):
        """Columns (m, …) of the light that has arrived, in the order of the passes."""
        cdef Py_ssize_t i, m = self.n_arrived
        cdef int32_t[::1] node = np.empty(m, np.int32), object_id = np.empty(m, np.int32)
        cdef uint64_t[::1] sheet = np.empty(m, np.uint64)
        cdef uint8_t[::1] is_single = np.empty(m, np.uint8)
        cdef double[:, ::1] position = np.empty((m, 3)), normal = np.empty((m, 3))
        cdef double[:, ::1] throughput = np.empty((m, 3))
        with nogil:
            for i in range(m):
                node[i], object_id[i] = self.arrived[i].node, self.arrived[i].object_id
                sheet[i], is_single[i] = self.arrived[i].sheet, self.arrived[i].is_single
                copy(&position[i, 0], self.arrived[i].position)
                copy(&normal[i, 0], self.arrived[i].normal)
                copy(&throughput[i, 0], self.arrived[i].throughput)
        return {
            "node": node.base,
            "sheet": sheet.base,
            "position": position.base,
            "normal": normal.base,
            "throughput": throughput.base,
            "object_id": object_id.base,
            "is_single": is_single.base.view(np.bool_),
        }

    cdef swap(self):
        self.ray, self.next_ray = self.next_ray, self.ray
        self.memory, self.next_memory = self.next_memory, self.memory

    cdef check_finite(self):
        if not self.finite:
            raise ValueError("rays should be finite, but the scene leads some to infinity")

    cdef reserve(self, Py_ssize_t n):
        """Make room for n rays of the next level, and for as many arrivals more."""
        cdef unsigned char[::1] larger
        cdef Py_ssize_t size = (self.n_arrived + n) * <Py_ssize_t> sizeof(Arrived)
        if self.next_memory.shape[0] < n * <Py_ssize_t> sizeof(SplitRay):
            self.next_memory = np.empty(n * sizeof(SplitRay), np.uint8)
        if n:
            self.next_ray = <SplitRay*> &self.next_memory[0]
        if self.origins.shape[0] < n:
            self.origins = self.origin_array = np.empty((n, 3), np.float32)
            self.directions = self.direction_array = np.empty((n, 3), np.float32)
        if self.arrived_memory.shape[0] < size:
            larger = np.empty(max(size, 2 * self.arrived_memory.shape[0]), np.uint8)
            larger[: self.arrived_memory.shape[0]] = self.arrived_memory
            self.arrived_memory = larger
            self.arrived = <Arrived*> &self.arrived_memory[0]

    cdef Passage passage(self, Py_ssize_t row) noexcept nogil:
        cdef SplitRay* ray = &self.ray[row]
        return Passage(&ray.origin[0], &ray.direction[0], &ray.media)

    cdef Py_ssize_t process(
        self, EmbreeHits found, Py_ssize_t row, Py_ssize_t target
    ) noexcept nogil:
        """Record an arrival, or write the continuations from row `target`; return the end."""
        cdef Meeting at
        cdef double[3] factor
        cdef int c
        self.triangles.prefetch(found, row)
        if not self.triangles.refine_hit(
            found, row, self.ray[row].origin, self.ray[row].direction, &at.hit
        ):
            return target
        at.ray = self.ray[row]
        at.inside = dot(at.ray.direction, at.hit.geometric) > 0.0
        at.ray.media = counted_media_at(
            self.materials, self.faults, at.hit.object_id, at.inside, at.ray.media
        )
        if is_absorbing(self.materials, at.ray.media):
            transmittance(factor, self.materials, at.ray.media, at.hit.distance)
            for c in range(3):
                at.ray.throughput[c] *= factor[c]
        if is_diffuse(self.materials, at.hit.object_id):
            if at.ray.n_specular > 0:
                self.arrive(&at)
            return target
        if at.ray.n_specular >= self.max_bounces:
            return target
        return self.split(&at, target)

    cdef void arrive(self, const Meeting* at) noexcept nogil:
        cdef Arrived* light = &self.arrived[self.n_arrived]
        cdef uint64_t sheet = sheet_of(at.ray.signature, at.hit.object_id)
        cdef double side = -1.0 if at.inside else 1.0
        cdef int c
        if not (self.follows_all or contains(self.followed, sheet)):
            return
        self.n_arrived += 1
        light.node, light.object_id = at.ray.node, at.hit.object_id
        light.sheet, light.is_single = sheet, at.ray.is_single
        copy(light.position, at.hit.position)
        copy(light.throughput, at.ray.throughput)
        for c in range(3):
            light.normal[c] = side * at.hit.geometric[c]

    cdef Py_ssize_t split(self, const Meeting* at, Py_ssize_t target) noexcept nogil:
        """Write the reflection and the refraction of a ray, or one of them; return the end."""
        cdef Arrival arrival = Arrival(
            &at.ray.direction[0], &at.hit.geometric[0], &at.hit.shading[0], at.hit.object_id,
            at.inside, at.ray.media, 0.0,
        )
        cdef Interface to
        cdef double[3] throughput, reflectance
        cdef int32_t i = at.hit.object_id
        cdef double reflected, refracted
        cdef int c
        interface_at(&to, self.materials, &arrival)
        reflectance_at(reflectance, self.materials, i, cosine_at(&to, &arrival))
        reflected, refracted = to.reflected, 1.0 - to.reflected
        if at.ray.is_single:
            # A single photon takes all of one branch.
            reflected = 1.0 if random(at, OF_BRANCH) < reflected else 0.0
            refracted = 1.0 - reflected
        if reflected > 0.0:
            for c in range(3):
                throughput[c] = at.ray.throughput[c] * reflected * reflectance[c]
            target += self.follow(at, target, &to, throughput, REFLECTED)
        if refracted > 0.0:
            if to.overflows:
                add_fault(self.faults, i, OVERFLOWED)
            for c in range(3):
                throughput[c] = at.ray.throughput[c] * refracted * self.materials.tint[i, c]
            target += self.follow(at, target, &to, throughput, LEFT if at.inside else ENTERED)
        return target

    cdef bint follow(
        self, const Meeting* at, Py_ssize_t target, const Interface* to, double* throughput,
        int kind,
    ) noexcept nogil:
        """Write a ray that leaves a surface; false if it is not followed."""
        cdef SplitRay* ray = &self.next_ray[target]
        cdef double most = max(throughput[0], max(throughput[1], throughput[2]))
        cdef bint is_single = at.ray.is_single
        cdef uint64_t signature = mix(
            at.ray.signature
            + (4 * <uint64_t>at.hit.object_id + kind + 1) * <uint64_t>0x9E3779B97F4A7C15
        )
        cdef double[3] offset
        cdef int c
        if not self.follows_all:
            if not contains(self.followed, signature):
                return False
        elif most < self.least_throughput:
            if random(at, OF_ROULETTE + kind) * self.least_throughput >= most:
                return False
            for c in range(3):
                throughput[c] *= self.least_throughput / most
            is_single = True
        copy(ray.origin, at.hit.position)
        if kind == REFLECTED:
            copy(ray.direction, to.to.reflection)
        else:
            copy(ray.direction, to.to.refraction)
        copy(ray.throughput, throughput)
        ray.key, ray.node, ray.is_single = at.ray.key, at.ray.node, is_single
        ray.n_specular = at.ray.n_specular + 1
        ray.media = at.ray.media if kind == REFLECTED else to.beyond
        ray.signature, ray.parent = signature, at.ray.signature
        for c in range(3):
            offset[c] = at.hit.step * at.hit.geometric[c]
        to_embree(self, target, ray.origin, ray.direction, offset)
        return True


cdef double random(const Meeting* at, int number) noexcept nogil:
    """Random number of an event of a path from a node."""
    return uniform(mix(at.ray.key ^ at.ray.signature), number)


cdef bint contains(const uint64_t[::1] values, uint64_t wanted) noexcept nogil:
    """True if a value is among those that ascend."""
    cdef Py_ssize_t low = 0, high = values.shape[0], middle
    while low < high:
        middle = (low + high) // 2
        if values[middle] < wanted:
            low = middle + 1
        else:
            high = middle
    return low < values.shape[0] and values[low] == wanted
