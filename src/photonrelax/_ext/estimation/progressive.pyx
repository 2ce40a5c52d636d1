"""Statistics of hit points, updated by passes of photons (Hachisuka, Ogaki & Jensen 2008)."""

from cython.parallel cimport prange
from libc.math cimport sqrt

from ..common.threads cimport ELEMENTS, team_size


def update(
    double[::1] n, double[:, ::1] tau, double[::1] radius, *,
    const double[::1] counts, const double[:, ::1] sums, const double[::1] least,
    double alpha, double weight, int n_threads
):
    """Update statistics with the photons that a pass has within the radii, in place.

    Arrays have a row per hit point: photons kept N, flux kept τ and radii R; numbers and sums of
    the photons of the pass, the sums to be multiplied by `weight`; least radii, None for zero.
    Numbers of photons are those of a disc; over footprints they need not be whole.
    """
    cdef Py_ssize_t i
    if not (
        n.shape[0] == tau.shape[0] == radius.shape[0] == counts.shape[0] == sums.shape[0]
        and tau.shape[1] == sums.shape[1] and (least is None or least.shape[0] == n.shape[0])
    ):
        raise ValueError("numbers, sums and radii do not fit one another")
    for i in prange(
        n.shape[0], nogil=True, schedule="static",
        num_threads=team_size(n_threads, n.shape[0], ELEMENTS)
    ):
        if counts[i] > 0:
            update_one(i, n, tau, radius, counts[i], sums, least, alpha, weight)


cdef void update_one(
    Py_ssize_t row, double[::1] n, double[:, ::1] tau, double[::1] radius, double found,
    const double[:, ::1] sums, const double[::1] least, double alpha, double weight
) noexcept nogil:
    """Update one hit point; write its row only.

    N' = N + α M, R'² = R² N' / (N + M) and τ' = (τ + Φ) R'² / R², unless R' is limited.
    """
    cdef double share = (n[row] + alpha * found) / (n[row] + found)
    cdef double floor
    cdef Py_ssize_t channel
    if least is not None:
        floor = least[row] / radius[row]
        share = max(share, min(floor * floor, 1.0))
    n[row] = (n[row] + found) * share
    for channel in range(tau.shape[1]):
        tau[row, channel] = (tau[row, channel] + weight * sums[row, channel]) * share
    radius[row] *= sqrt(share)
