"""Events of paths where their rays hit surfaces: one pass over all live rays, without the GIL.

A pass takes every ray from embree's hit to the next ray for embree: the intersection in float64,
the event there, and the ray that leaves it. Rays of a batch follow a curve over the emitter, as
embree and memory are faster with rays close to one another in sequence; still every sum is taken in
the order of the photons, however they are split into batches.
"""

cimport cython
from libc.math cimport fabs
from libc.stdint cimport int32_t, int64_t, uint8_t, uint64_t

import numpy as np

from ..common.vec3 cimport copy, dot
from ..scene.dispersion cimport LONGEST, N_NODES, SHORTEST, at_wavelength
from ..scene.textures cimport colour_at
from .deposits cimport Deposit, Deposits
from .emission cimport Emission
from .emitter_order cimport N_CODES, write_codes
from .live_rays cimport LiveRays, Passage, to_embree
from .materials cimport (
    OVERFLOWED, Arrival, Interface, Materials, add_fault, cosine_at, counted_media_at, interface_at,
    is_absorbing, is_absorbing_surface, is_diffuse, is_dispersive, media_at, reflectance_at,
    transmittance,
)
from .path_events cimport (
    ENTERED, LEFT, MAX_LOSSES, OF_DIRECTION, OF_MEDIUM, OF_SURFACE, REFLECTED, SCATTERED, Crossing,
    Event, Loss, Ray, WhiteRay, append_signature, distance_along, event_counter, orient, random,
    sample_towards,
)
from .raycast cimport EmbreeFrame, EmbreeHits, Triangles

# Indices into photons.energy_ledger.PATH_OUTCOMES and transport.emission.PATHS.
cdef enum:
    STORED = 0
    ABSORBED = 1
    ESCAPED = 2
    CUT = 3
    FILTERED = 4  # "discarded" in the ledger
    N_OUTCOMES = 5

    CAUSTIC = 0
    GLOBAL = 1


# Photons of a region whose energies are summed in one row of the ledger. Batches hold whole blocks,
# so the sums do not depend on the batches.
cdef enum:
    PER_BLOCK = 1024

LEDGER_BLOCK = PER_BLOCK


@cython.final
cdef class Paths(LiveRays):
    """State of a batch of up to `size` paths; reused for one batch after another.

    Live rays are packed at the front. Ledger rows belong to blocks of `LEDGER_BLOCK` photons of one
    region, counted from its first in the batch.
    """

    cdef unsigned char[::1] memory, loss_memory
    cdef Ray* ray
    cdef Ray* spare
    cdef Loss* loss
    cdef Py_ssize_t n_losses, n_rays
    # Rays are in the order of paths; else the row of the first loss of each path in a pass.
    cdef bint in_order
    cdef int32_t[::1] first_loss
    cdef Deposits deposits
    # By block, and the block of each path.
    cdef double[:, :, ::1] ledger
    cdef int64_t[:, ::1] ends
    cdef double[:, ::1] luminance
    cdef int32_t[::1] block
    # Centre and radius.
    cdef double[4] guide
    cdef int path_filter, max_bounces
    cdef readonly Py_ssize_t size
    # Rays to be dispersed, each into `n_wavelengths`, whose colours (nodes, 3) are tabulated; the
    # photons of the paths, and the emission of each block.
    cdef unsigned char[::1] white_memory
    cdef WhiteRay* white
    cdef Py_ssize_t n_white
    cdef int n_wavelengths
    cdef const double[:, ::1] colours
    cdef const int64_t[::1] photons
    cdef list emissions
    cdef readonly int64_t n_met_specular

    def __init__(
        self, Materials materials, EmbreeFrame frame, Triangles triangles, Py_ssize_t size, *,
        int path_filter, int max_bounces, int n_wavelengths, const double[:, ::1] colours,
        guide=(0.0, 0.0, 0.0, 0.0),
    ):
        cdef Py_ssize_t n_rays = size
        self.guide = guide
        super().__init__(materials, frame, triangles)
        if not (n_wavelengths > 0 and colours.shape[0] == N_NODES and colours.shape[1] == 3):
            raise ValueError(f"colours should be of {N_NODES} wavelengths")
        self.size, self.n_wavelengths, self.colours = size, n_wavelengths, colours
        if materials.has_dispersion:
            n_rays = size * n_wavelengths
            self.white_memory = np.empty(size * sizeof(WhiteRay), np.uint8)
            self.white = <WhiteRay*> &self.white_memory[0]
        self.n_rays = n_rays
        self.memory = np.empty(2 * n_rays * sizeof(Ray), np.uint8)
        self.ray = <Ray*> &self.memory[0]
        self.spare = self.ray + n_rays
        self.loss_memory = np.empty(2 * MAX_LOSSES * n_rays * sizeof(Loss), np.uint8)
        self.loss = <Loss*> &self.loss_memory[0]
        self.origins = self.origin_array = np.empty((n_rays, 3), np.float32)
        self.directions = self.direction_array = np.empty((n_rays, 3), np.float32)
        self.block = np.empty(size, np.int32)
        self.deposits = Deposits(size)
        self.path_filter, self.max_bounces = path_filter, max_bounces

    def start(
        self, emissions, const int64_t[::1] counts, const int64_t[::1] photons, *,
        const uint64_t[::1] media, const double[:, ::1] luminance, double[:, :, ::1] ledger,
        int64_t[:, ::1] ends, bint along_curve=False,
    ):
        """Start paths with the primal rays of photons, given by their indices.

        Of each emission there are some, which follow one another, within a stack of media and of a
        luminance. Rays are in the order of the photons, or `along_curve` in Morton order of their
        emitter coordinates.
        """
        cdef Py_ssize_t i, k, end, n = photons.shape[0]
        cdef int64_t n_blocks = 0, n_given = 0, least = 0
        cdef int32_t block = 0
        if n > self.size:
            raise ValueError(f"photons should be at most {self.size}, but are {n}")
        for k in range(counts.shape[0]):
            n_blocks += (counts[k] + PER_BLOCK - 1) // PER_BLOCK
            n_given += counts[k]
            least = min(least, counts[k])
        if not (
            len(emissions) == counts.shape[0] == media.shape[0] == luminance.shape[0]
            and n_given == n and least == 0
            and luminance.shape[1] == ledger.shape[2] == 3
            and ledger.shape[0] == ends.shape[0] == n_blocks
            and ledger.shape[1] == ends.shape[1] == N_OUTCOMES
        ):
            raise ValueError("emissions, media, luminance, ledger and ends do not fit the photons")
        self.ledger, self.ends = ledger, ends
        self.luminance = np.empty((n_blocks, 3))
        self.emissions = []
        self.n_met_specular = self.n_white = 0
        self.photons = photons
        self.faults.take()
        self.deposits.clear(n)
        self.finite = True
        self.n_losses = 0
        self.in_order = not along_curve
        i = 0
        for k in range(counts.shape[0]):
            end = i + counts[k]
            while i < end:
                self.emissions.append(emissions[k])
                self.luminance[block, :] = luminance[k]
                self.emit_block(emissions[k], block, i, min(i + PER_BLOCK, end), media[k])
                i = min(i + PER_BLOCK, end)
                block += 1
        if along_curve:
            self.first_loss = np.empty(n + 1, np.int32)
            self.follow_curve(n)
        self.n_live = n
        self.check_finite()

    def disperse(self):
        """Start the paths that met a surface that disperses them, at their wavelengths.

        Each is taken up where it came from, with an even share of its light at each of wavelengths
        that are evenly spaced and turn with the index of the photon. Returns the number of rays.
        """
        cdef Py_ssize_t i, row
        cdef int order
        cdef double[::1] turn = np.empty(self.n_white)
        cdef int32_t path
        cdef Emission emission
        for i in range(self.n_white):
            path = self.white[i].ray.path
            emission = self.emissions[self.block[path]]
            turn[i] = emission.turn(self.photons[path])
        self.n_live = self.n_white * self.n_wavelengths
        with nogil:
            for i in range(self.n_white):
                for order in range(self.n_wavelengths):
                    row = i * self.n_wavelengths + order
                    self.resume(row, &self.white[i], order, (order + turn[i]) / self.n_wavelengths)
                self.lose_colour(i)
            self.settle()
        self.n_white = 0
        return self.n_live

    cdef void resume(
        self, Py_ssize_t row, const WhiteRay* white, int order, double share
    ) noexcept nogil:
        """Take up a white ray at one of its wavelengths, a share of the way to the longest."""
        cdef Ray* ray = &self.ray[row]
        cdef int c
        ray[0] = white.ray
        ray.order = order
        ray.is_resumed = True
        ray.wavelength = SHORTEST + share * (LONGEST - SHORTEST)
        for c in range(3):
            ray.throughput[c] /= self.n_wavelengths
            self.origins[row, c] = white.origin[c]
            self.directions[row, c] = white.direction[c]

    cdef void lose_colour(self, Py_ssize_t i) noexcept nogil:
        """Add what white light has more than its wavelengths together to the ledger."""
        cdef const Ray* ray
        cdef double[3] rest, coloured
        cdef int c, order
        copy(rest, self.white[i].ray.throughput)
        for order in range(self.n_wavelengths):
            ray = &self.ray[i * self.n_wavelengths + order]
            copy(coloured, ray.throughput)
            self.add_colour(coloured, ray.wavelength)
            for c in range(3):
                rest[c] -= coloured[c]
        self.lose(self.white[i].ray.path, FILTERED, rest)

    cdef bint disperses(self, const Event* event) noexcept nogil:
        """True if the ray meets a surface whose indices depend on the wavelength."""
        cdef Arrival arrival
        cdef int32_t i = event.hit.object_id
        if is_diffuse(self.materials, i):
            return False
        arrival.object_id, arrival.inside = i, event.inside
        arrival.media = media_at(self.materials, i, event.inside, event.ray.media)
        return is_dispersive(self.materials, &arrival)

    cdef void keep_white(self, Py_ssize_t row) noexcept nogil:
        """Put a ray aside, to be dispersed."""
        cdef WhiteRay* white = &self.white[self.n_white]
        cdef int c
        self.n_white += 1
        white.ray = self.ray[row]
        for c in range(3):
            white.origin[c] = self.origins[row, c]
            white.direction[c] = self.directions[row, c]

    def take_deposits(self):
        """Arrays of the deposits of a finished batch, as of `Deposits.take`."""
        return self.deposits.take()

    def live_rays(self):
        """Paths (n_live,), origins and directions (n_live, 3) of the live rays."""
        cdef Py_ssize_t i, c
        path = np.empty(self.n_live, dtype=np.intp)
        origin, direction = np.empty((self.n_live, 3)), np.empty((self.n_live, 3))
        cdef Py_ssize_t[::1] paths = path
        cdef double[:, ::1] origins = origin, directions = direction
        for i in range(self.n_live):
            paths[i] = self.ray[i].path
            for c in range(3):
                origins[i, c] = self.ray[i].origin[c]
                directions[i, c] = self.ray[i].direction[c]
        return path, origin, direction

    def stored_rays(self):
        """Rows (m,), origins and directions (m, 3) of the live rays whose light is stored."""
        cdef Py_ssize_t i
        cdef uint8_t[::1] stored = np.empty(self.n_live, np.uint8)
        for i in range(self.n_live):
            stored[i] = self.is_stored(&self.ray[i])
        rows = np.flatnonzero(stored)
        _, origin, direction = self.live_rays()
        return rows, origin[rows], direction[rows]

    def cross(self, EmbreeHits found, const Py_ssize_t[::1] rows, hits):
        """Deposit rays where they cross a sensor.

        Parameters
        ----------
        found : EmbreeHits
            Of all live rays; a ray ends there.
        rows : (m,)
            Of the rays among the live ones.
        hits : Intersections
            Where these cross the sensor next.

        Returns
        -------
        (k,) intp
            Indices into `rows` of the rays that go on beyond the crossing.
        """
        cdef const int32_t[::1] object_id = hits.object_id
        cdef const double[:, ::1] position = hits.position, normal = hits.geometric_normal
        cdef const double[::1] step = hits.step
        cdef Py_ssize_t[::1] ahead = np.empty(rows.shape[0], np.intp)
        cdef Py_ssize_t i, k = 0
        cdef Crossing at
        if not (found.n_rays == self.n_live and len(hits) == rows.shape[0]):
            raise ValueError("hits and rays do not fit one another")
        if rows.shape[0] and not 0 <= np.min(rows) <= np.max(rows) < self.n_live:
            raise ValueError(
                f"rows should be of {self.n_live} live rays, but are "
                f"{np.min(rows)} to {np.max(rows)}"
            )
        self.deposits.reserve(rows.shape[0])
        with nogil:
            for i in range(rows.shape[0]):
                if object_id[i] < 0:
                    continue
                at = Crossing(&position[i, 0], &normal[i, 0], step[i], object_id[i])
                if self.cross_one(found, rows[i], &at):
                    ahead[k] = i
                    k += 1
        return ahead.base[:k]

    cdef bint cross_one(
        self, EmbreeHits found, Py_ssize_t row, const Crossing* at
    ) noexcept nogil:
        """Deposit a ray at a crossing; false if it ends before.

        Light is absorbed by the random number of the event at the surface, which is ahead: what
        is absorbed before a sensor does not reach the surface.
        """
        cdef Ray ray = self.ray[row]
        cdef double cosine = fabs(dot(ray.direction, at.normal))
        cdef double distance = distance_along(&ray, at.position)
        cdef double[3] factor
        cdef Event event
        if ray.is_resumed:
            # White light that it was part of was stored.
            return False
        event.ray, event.counter = &ray, event_counter(&ray)
        if self.triangles.refine_hit(found, row, ray.origin, ray.direction, &event.hit):
            # Light that arrives on a surface in the plane of the sensor crosses it.
            if (distance - event.hit.distance) * cosine > at.step:
                return False
            orient(&event)
            ray.media = media_at(self.materials, event.hit.object_id, event.inside, ray.media)
        # Light that leaves a surface in the plane of the sensor does not.
        if distance * cosine <= at.step:
            return True
        if is_absorbing(self.materials, ray.media):
            transmittance(factor, self.materials, ray.media, distance)
            if not self.survives(factor, &event, OF_MEDIUM):
                return False
        ray.path_length += distance
        event.hit.object_id = at.object_id
        copy(event.hit.position, at.position)
        copy(event.hit.geometric, at.normal)
        orient(&event)
        self.deposit(&event)
        return True

    cdef emit_block(
        self, Emission emission, int32_t block, Py_ssize_t first, Py_ssize_t end, uint64_t media
    ):
        """Emit the photons of a block from the first on."""
        cdef const int64_t[::1] photons = self.photons
        cdef double[3] throughput
        cdef Py_ssize_t i
        cdef int c
        for c in range(3):
            # Channels in which the emitter is black stay out of every product.
            throughput[c] = 1.0 if self.luminance[block, c] > 0.0 else 0.0
        self.block[first:end] = block
        with nogil:
            for i in range(first, end):
                self.emit(emission, i, photons[i], throughput)
                self.ray[i].media = media
                # While the ray is in the cache.
                if self.in_order:
                    to_embree(self, i, self.ray[i].origin, self.ray[i].direction, NULL)

    cdef void emit(
        self, Emission emission, Py_ssize_t path, uint64_t index, const double* throughput
    ) noexcept nogil:
        cdef Ray* ray = &self.ray[path]
        ray.path = <int32_t>path
        ray.key = emission.key(index)
        ray.path_length = emission.region.start_distance
        ray.n_specular = ray.n_diffuse = ray.order = 0
        ray.wavelength = 0.0
        ray.is_resumed = False
        ray.signature = 0
        copy(ray.throughput, throughput)
        if emission.is_coloured:
            emission.colour(ray.throughput, index)
        self.deposits.coords[path, 2] = 0.0
        self.deposits.density[path] = emission.ray(
            index, ray.origin, ray.direction, &self.deposits.coords[path, 0]
        )

    cdef follow_curve(self, Py_ssize_t n):
        """Put the rays in Morton order of the cells of their emitter coordinates, for embree."""
        cdef const double[:, ::1] coords = self.deposits.coords
        cdef int32_t[::1] code = np.empty(n, np.int32)
        cdef int32_t[::1] first = np.zeros(N_CODES + 1, np.int32)
        cdef Ray* ordered = self.spare
        cdef Py_ssize_t i
        with nogil:
            write_codes(code, coords)
            for i in range(n):
                first[code[i] + 1] += 1
            for i in range(N_CODES):
                first[i + 1] += first[i]
            for i in range(n):
                ordered[first[code[i]]] = self.ray[i]
                first[code[i]] += 1
            self.ray, self.spare = self.spare, self.ray
            for i in range(n):
                to_embree(self, i, self.ray[i].origin, self.ray[i].direction, NULL)

    def advance(self, EmbreeHits found):
        """Process the hit of every live ray; return the number of rays still live."""
        cdef Py_ssize_t i, live = 0
        if found.n_rays != self.n_live:
            raise ValueError(f"found should be of {self.n_live} rays, but is of {found.n_rays}")
        self.deposits.reserve(self.n_live)
        with nogil:
            for i in range(self.n_live):
                self.triangles.prefetch(found, i)
                # Row `live` is never beyond row i, so the rays pack in place.
                if found.triangle[i] >= 0:
                    live += self.intersect(found, i, live)
                else:
                    self.terminate(&self.ray[i], ESCAPED)
            self.settle()
        self.n_live = live
        self.check_finite()
        return live

    cdef check_finite(self):
        if not self.finite:
            raise ValueError("rays should be finite, but the scene leads some to infinity")

    cdef Passage passage(self, Py_ssize_t row) noexcept nogil:
        cdef Ray* ray = &self.ray[row]
        return Passage(&ray.origin[0], &ray.direction[0], &ray.media)

    cdef bint intersect(self, EmbreeHits found, Py_ssize_t row, Py_ssize_t target) noexcept nogil:
        """Process the hit of one ray; true if its path continues, from row `target`."""
        cdef Ray* ray = &self.ray[row]
        cdef Event event
        cdef double[3] out
        if not self.triangles.refine_hit(found, row, ray.origin, ray.direction, &event.hit):
            return self.terminate(ray, ESCAPED)
        event.triangle, event.u, event.v = found.triangle[row], found.u[row], found.v[row]
        event.ray = ray
        event.counter = event_counter(ray)
        orient(&event)
        if self.materials.has_dispersion and ray.wavelength == 0.0 and self.disperses(&event):
            self.keep_white(row)
            return False
        ray.path_length += event.hit.distance
        if not self.survives_medium(&event):
            return self.terminate(ray, ABSORBED)
        if is_diffuse(self.materials, event.hit.object_id):
            if not self.scatter_diffuse(out, &event):
                return False
        elif not self.scatter_specular(out, &event):
            return self.terminate(ray, ABSORBED)
        if ray.n_specular + ray.n_diffuse > self.max_bounces:
            return self.terminate(ray, CUT)
        self.continue_path(target, &event, out)
        return True

    cdef void continue_path(
        self, Py_ssize_t target, const Event* event, const double* direction
    ) noexcept nogil:
        cdef Ray* ray = &self.ray[target]
        cdef double[3] offset
        cdef int c
        if ray != event.ray:
            ray[0] = event.ray[0]
        ray.is_resumed = False
        for c in range(3):
            ray.origin[c] = event.hit.position[c]
            ray.direction[c] = direction[c]
            offset[c] = event.hit.step * event.facing[c]
        to_embree(self, target, ray.origin, direction, offset)

    cdef bint survives_medium(self, const Event* event) noexcept nogil:
        """Apply the absorption on the way to the hit; false if the path ends."""
        cdef double[3] factor
        if event.ray.order == 0:
            event.ray.media = counted_media_at(
                self.materials, self.faults, event.hit.object_id, event.inside, event.ray.media
            )
        else:
            event.ray.media = media_at(
                self.materials, event.hit.object_id, event.inside, event.ray.media
            )
        if not is_absorbing(self.materials, event.ray.media):
            return True
        transmittance(factor, self.materials, event.ray.media, event.hit.distance)
        return self.roulette(factor, event, OF_MEDIUM, ABSORBED)

    cdef bint scatter_specular(self, double* out, const Event* event) noexcept nogil:
        """Reflect or refract into direction `out`; false if the light is absorbed."""
        cdef int32_t i = event.hit.object_id
        cdef Ray* ray = event.ray
        cdef int kind = REFLECTED
        cdef Arrival arrival
        cdef Interface at
        cdef double[3] reflectance
        self.n_met_specular += ray.n_specular == 0 and ray.n_diffuse == 0 and ray.order == 0
        arrival = Arrival(
            &ray.direction[0], &event.hit.geometric[0], &event.hit.shading[0], i, event.inside,
            ray.media, ray.wavelength,
        )
        interface_at(&at, self.materials, &arrival)
        if is_absorbing_surface(self.materials, i):
            reflectance_at(reflectance, self.materials, i, cosine_at(&at, &arrival))
            if not self.roulette(reflectance, event, OF_SURFACE, ABSORBED):
                return False
        if at.reflected == 1.0 or random(event, OF_SURFACE) < at.reflected:
            copy(out, at.to.reflection)
        else:
            copy(out, at.to.refraction)
            if not self.survives_tint(event):
                return False
            ray.media = at.beyond
            if at.overflows and ray.order == 0:
                add_fault(self.faults, i, OVERFLOWED)
            kind = LEFT if event.inside else ENTERED
        ray.n_specular += 1
        append_signature(ray, i, kind)
        return True

    cdef bint survives_tint(self, const Event* event) noexcept nogil:
        """Apply the tint of refracted light; false if the path ends."""
        cdef int32_t i = event.hit.object_id
        if not self.materials.is_tinted[i]:
            return True
        # The random number of the surface chose refraction.
        return self.roulette(&self.materials.tint[i, 0], event, OF_DIRECTION, ABSORBED)

    cdef bint scatter_diffuse(self, double* out, const Event* event) noexcept nogil:
        """Deposit light of the kind to be stored; true if the path continues along `out`."""
        cdef int32_t i = event.hit.object_id
        cdef Ray* ray = event.ray
        cdef bint stored = self.is_stored(ray)
        cdef int outcome = STORED if stored else FILTERED
        cdef double[3] albedo
        if stored:
            self.deposit(event)
        if self.path_filter == CAUSTIC:
            return self.terminate(ray, outcome)
        copy(albedo, &self.materials.reflectance[i, 0])
        if self.materials.is_textured[i]:
            colour_at(
                albedo, &self.materials.view[i], self.triangles.face_id[event.triangle],
                event.u, event.v,
            )
        if not self.roulette(albedo, event, OF_SURFACE, outcome):
            return self.terminate(ray, outcome)
        if not self.weigh(sample_towards(out, event, &self.guide[0]), ray, outcome):
            return self.terminate(ray, outcome)
        ray.n_diffuse += 1
        append_signature(ray, i, SCATTERED)
        return True

    cdef bint weigh(self, double weight, Ray* ray, int outcome) noexcept nogil:
        """Multiply the throughput by the weight of a direction; false if that is 0."""
        cdef double[3] lost
        cdef int c
        if weight == 1.0 or weight == 0.0:
            return weight > 0.0
        for c in range(3):
            lost[c] = ray.throughput[c] * (1.0 - weight)
            ray.throughput[c] *= weight
        self.add_colour(lost, ray.wavelength)
        self.lose(ray.path, outcome, lost)
        return True

    cdef bint is_stored(self, const Ray* ray) noexcept nogil:
        """True for light of the kind to be stored."""
        if self.path_filter == CAUSTIC:
            return ray.n_specular > 0
        return self.path_filter != GLOBAL or ray.n_diffuse > 0

    cdef void deposit(self, const Event* event) noexcept nogil:
        cdef Deposit* deposit = self.deposits.add()
        cdef const Ray* ray = event.ray
        cdef int c
        deposit.path, deposit.block = ray.path, self.block[ray.path]
        deposit.n_bounces = ray.n_specular
        deposit.object_id = event.hit.object_id
        deposit.path_length = ray.path_length
        deposit.path_signature = <int64_t>ray.signature
        for c in range(3):
            deposit.position[c] = event.hit.position[c]
            deposit.normal[c] = event.facing[c]
            deposit.wi[c] = -ray.direction[c]
            deposit.throughput[c] = ray.throughput[c]
        deposit.wavelength = ray.wavelength
        self.add_colour(deposit.throughput, ray.wavelength)

    cdef bint roulette(
        self, const double* factor, const Event* event, int number, int outcome
    ) noexcept nogil:
        """Continue a path as of `survives`.

        What a survivor gains or loses per channel is added to `outcome` in the ledger.
        """
        cdef double[3] lost
        cdef int c
        copy(lost, event.ray.throughput)
        if not self.survives(factor, event, number):
            return False
        for c in range(3):
            lost[c] -= event.ray.throughput[c]
        self.add_colour(lost, event.ray.wavelength)
        self.lose(event.ray.path, outcome, lost)
        return True

    cdef bint survives(
        self, const double* factor, const Event* event, int number
    ) noexcept nogil:
        """Multiply the throughput by a factor, with the share of luminance left as probability.

        Otherwise false. Survivors keep their luminance: all photons of an emitter carry the same.
        """
        cdef Ray* ray = event.ray
        cdef const double* luminance = &self.luminance[self.block[ray.path], 0]
        cdef double before = 0.0, after = 0.0
        cdef int c
        for c in range(3):
            before += luminance[c] * ray.throughput[c]
            after += luminance[c] * ray.throughput[c] * factor[c]
        if random(event, number) * before >= after:
            return False
        for c in range(3):
            ray.throughput[c] = ray.throughput[c] * factor[c] * (before / after)
        return True

    cdef bint terminate(self, const Ray* ray, int outcome) noexcept nogil:
        """Add the throughput of a path to the ledger; always false: it does not continue."""
        cdef double[3] lost
        self.ends[self.block[ray.path], outcome] += ray.order == 0
        if ray.wavelength == 0.0:
            self.lose(ray.path, outcome, ray.throughput)
            return False
        copy(lost, ray.throughput)
        self.add_colour(lost, ray.wavelength)
        self.lose(ray.path, outcome, lost)
        return False

    cdef void add_colour(self, double* flux, double wavelength) noexcept nogil:
        """Multiply flux by the colour of its wavelength, which white light does not have."""
        cdef int c
        if wavelength > 0.0:
            for c in range(3):
                flux[c] *= at_wavelength(&self.colours[0, c], 3, wavelength)

    cdef void lose(self, int32_t path, int outcome, const double* amount) noexcept nogil:
        """Add to the ledger, or keep a loss for that, so that losses are in the order of paths."""
        cdef Loss* loss
        if self.in_order:
            self.book(path, outcome, amount)
            return
        loss = &self.loss[self.n_losses]
        self.n_losses += 1
        loss.path, loss.outcome = path, outcome
        copy(loss.amount, amount)

    cdef void book(self, int32_t path, int outcome, const double* amount) noexcept nogil:
        cdef double* total = &self.ledger[self.block[path], outcome, 0]
        cdef int c
        for c in range(3):
            total[c] += amount[c]

    cdef void settle(self) noexcept nogil:
        """Add the losses kept in a pass to the ledger, in the order of the paths."""
        cdef Py_ssize_t i
        cdef const Loss* loss
        if self.in_order:
            return
        loss = self.losses_by_path()
        for i in range(self.n_losses):
            self.book(loss[i].path, loss[i].outcome, loss[i].amount)
        self.n_losses = 0

    cdef const Loss* losses_by_path(self) noexcept nogil:
        """Sort losses by their paths; those of a path keep their order."""
        cdef Loss* target = self.loss + MAX_LOSSES * self.n_rays
        cdef Py_ssize_t i
        cdef int32_t path
        self.first_loss[:] = 0
        for i in range(self.n_losses):
            self.first_loss[self.loss[i].path + 1] += 1
        for i in range(1, self.first_loss.shape[0]):
            self.first_loss[i] += self.first_loss[i - 1]
        for i in range(self.n_losses):
            path = self.loss[i].path
            target[self.first_loss[path]] = self.loss[i]
            self.first_loss[path] += 1
        return target
