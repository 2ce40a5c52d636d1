"""Rays of paths at surfaces and sensors: their random numbers, directions and signatures."""

from libc.math cimport sqrt
from libc.stdint cimport int16_t, int32_t, uint64_t

from ..common.rng cimport mix, uniform
from ..common.vec3 cimport dot, normalise, orthonormal_frame
from .raycast cimport Hit
from .sampling cimport cap_direction, disk_point, hemisphere_direction

# Events that a path signature distinguishes.
cdef enum:
    REFLECTED = 0
    ENTERED = 1
    LEFT = 2
    SCATTERED = 3

# Random numbers of a path: the first few are those of its emission; each event then has four.
cdef enum:
    PER_EVENT = 4
    OF_MEDIUM = 0
    OF_SURFACE = 1
    OF_DIRECTION = 2


cdef struct Ray:
    # Next segment of a live path. `path` is its index in the batch; `media` is a stack.
    double[3] origin
    double[3] direction
    double[3] throughput
    double path_length
    uint64_t key, signature, media
    int32_t path
    int16_t n_specular, n_diffuse
    # nm; 0 of white light. Of the wavelengths into which a path is dispersed `order` is the number
    # of this one, and `is_resumed` true up to the surface that disperses.
    double wavelength
    int16_t order
    bint is_resumed


cdef struct WhiteRay:
    # A ray before a surface that disperses it, also in embree's frame.
    Ray ray
    float[3] origin
    float[3] direction


cdef struct Loss:
    # Flux of a path that ends or changes, relative to that of a photon.
    double[3] amount
    int32_t path, outcome


# Losses of a ray in a pass, at most: in the medium, at the surface, by its direction, and its end.
cdef enum:
    MAX_LOSSES = 4


cdef struct Event:
    # One ray at one surface. `facing` is the geometric normal on the side of the ray.
    Ray* ray
    Hit hit
    bint inside
    double[3] facing
    uint64_t counter
    # Barycentric coordinates of the second and third corner of the triangle.
    int32_t triangle
    double u, v


cdef struct Crossing:
    # A ray at a sensor: position, normal by the winding of the face, distance that rays resolve.
    const double* position
    const double* normal
    double step
    int32_t object_id


cdef inline double distance_along(const Ray* ray, const double* position) noexcept nogil:
    cdef double[3] way
    cdef int c
    for c in range(3):
        way[c] = position[c] - ray.origin[c]
    return dot(way, ray.direction)


cdef inline void orient(Event* event) noexcept nogil:
    """Set the side of the face that the ray comes from."""
    cdef int c
    event.inside = dot(event.ray.direction, event.hit.geometric) > 0.0
    for c in range(3):
        event.facing[c] = -event.hit.geometric[c] if event.inside else event.hit.geometric[c]


cdef inline uint64_t event_counter(const Ray* ray) noexcept nogil:
    """Number of the first random number of a ray's next event."""
    return PER_EVENT * (1 + ray.n_specular + ray.n_diffuse)


cdef inline double random(const Event* event, int number) noexcept nogil:
    return uniform(event.ray.key, event.counter + number)


cdef inline void around(double* out, const double* axis, const double* local) noexcept nogil:
    """Turn a direction from around z to around an axis."""
    cdef double[3] u
    cdef double[3] v
    cdef int c
    orthonormal_frame(u, v, axis)
    for c in range(3):
        out[c] = local[0] * u[c] + local[1] * v[c] + local[2] * axis[c]


cdef inline void sample_cosine(double* out, const Event* event, double first) noexcept nogil:
    """Draw a direction with cosine density around the normal; one random number is given."""
    cdef double[3] local
    cdef double[2] disk
    disk_point(disk, first, random(event, OF_DIRECTION + 1))
    hemisphere_direction(local, disk)
    around(out, event.facing, local)


cdef inline double sample_towards(
    double* out, const Event* event, const double* sphere
) noexcept nogil:
    """Draw a direction, half of them uniform in the cone of a sphere and half by the cosine.

    Returns the cosine's density over that of both, 0 below the surface. It is 1, and all directions
    are by the cosine, within the sphere, where the surface faces away from it, for light that was
    scattered before, as such factors would pile up, and if the radius is 0.
    """
    cdef double first = random(event, OF_DIRECTION), distance, sine, drop, cosine
    cdef double[3] axis
    cdef double[3] local
    cdef double[2] disk
    cdef int c
    for c in range(3):
        axis[c] = sphere[c] - event.hit.position[c]
    distance = sqrt(dot(axis, axis))
    if (
        sphere[3] == 0.0
        or event.ray.n_diffuse > 0
        or distance <= sphere[3]
        or dot(axis, event.facing) <= -sphere[3]
    ):
        sample_cosine(out, event, first)
        return 1.0
    sine = sphere[3] / distance
    drop = sine * sine / (1.0 + sqrt((1.0 - sine) * (1.0 + sine)))
    normalise(axis)
    if first < 0.5:
        disk_point(disk, 2.0 * first, random(event, OF_DIRECTION + 1))
        cap_direction(local, disk, drop)
        around(out, axis, local)
    else:
        sample_cosine(out, event, 2.0 * first - 1.0)
    cosine = dot(out, event.facing)
    if cosine <= 0.0:
        return 0.0
    if first >= 0.5 and dot(out, axis) < 1.0 - drop:
        return 2.0
    return cosine / (0.25 / drop + 0.5 * cosine)


cdef inline void append_signature(Ray* ray, int32_t object_id, int kind) noexcept nogil:
    cdef uint64_t step = 4 * <uint64_t>object_id + kind + 1
    ray.signature = mix(ray.signature + step * <uint64_t>0x9E3779B97F4A7C15)
