"""Eigenvalues and eigenvectors of symmetric matrices in a plane."""


cdef struct Components:
    # Eigenvalues, larger first, and the first eigenvector.
    double first
    double second
    double cosine
    double sine


cdef Components decompose(double uu, double uv, double vv) noexcept nogil
