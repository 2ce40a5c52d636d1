"""Structure tensors around points, and the shapes of kernels that follow from them."""

from .surface_integrals cimport NearEdges
from .tangent_plane cimport EvaluationPoints, Plane, TangentPhotons


cdef class KernelShape:
    cdef double edge_threshold
    cdef double exponent
    cdef double least_eigenvalue
    cdef double largest
    cdef bint isotropic


cdef struct Tensor:
    Plane plane
    # Mean flux and gradient, (n_blocks, 4, 16).
    const double* columns
    # Sums of the weights, of weighted flux, and of the weighted products of gradients.
    double weight
    double flux
    double uu
    double uv
    double vv
    # Direction across the structure; λ₁ of the structure tensor; eigenvalues of the diffusion
    # tensor along the structure and across.
    double cosine
    double sine
    double edge
    double length
    double width


cdef void measure(
    Tensor* tensor, TangentPhotons photons, EvaluationPoints points, Py_ssize_t i
) noexcept nogil
cdef void shape(Tensor* tensor, TangentPhotons photons, KernelShape kernel_shape) noexcept nogil
cdef void find_near(
    EvaluationPoints points, const Tensor* tensor, const double* half, int thread, NearEdges* near
) noexcept nogil
