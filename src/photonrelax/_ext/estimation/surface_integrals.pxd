"""Part of a kernel that lies on surface, from the edges near it.

In the plane of the footprint let w be the kernel, δ the unit mass at its middle, and H a vector
field with div H = δ - w that vanishes where w does. Over the surface Ω, whose boundary ∂Ω has the
outward normal n,

    ∫_Ω w = [the middle is on Ω] - ∮_∂Ω H · n ds,

so that only edges within reach of the kernel count, and those of two surfaces that meet, which run
in opposite directions, cancel. H first spreads the mass along x on the line y = 0 and then, in each
column, along y. w(x, y) = f(x) g(y) cut off at a distance r of the rectangle has the columns

    H_y = sign(y) f(x) (G(top(x)) - G(|y|))₊,   G' = g,

with top(x) the half-height of what is within r; f = g = 1 gives areas.
"""

cdef enum:
    # Largest radius near edges over that without: within it a corner of 22.5° has as much surface.
    SURFACE_WITHIN = 4


cdef struct NearEdges:
    # Ends (xa, ya, xb, yb) in the plane of a footprint, from its middle and along its axes, with
    # the surface to the left; whether the middle is on the surface.
    double* ends
    Py_ssize_t n
    bint inside


cdef double share_of_radial(const NearEdges* near, double radius, int kernel) noexcept nogil

cdef double area_on_surface(
    const NearEdges* near, const double* sides, double radius
) noexcept nogil

cdef double share_on_surface(
    const NearEdges* near, const double* sides, double radius
) noexcept nogil

cdef double squared_of_disc(const NearEdges* near, double radius) noexcept nogil
