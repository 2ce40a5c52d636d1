"""Numbers of photons that adapt to the light around a point: refinements of Jensen's estimate.

Few photons are noisy, many blur; both refinements choose a number K between `k_min` and `k` for
each point, from the estimates of a constant kernel whose bandwidth is the distance to the K-th
photon,

    E_K = Σ_{i < K} Φ_i / (π d_K²),

where Φ_i is the flux of the i-th nearest photon, its mean over the channels, and d_K the distance
to the K-th. The estimate is then that of K photons and the kernel of the settings, with the same K
for all values of the photons. The papers were not available: this is their idea as described in
SJ13 §2 and elsewhere, with decision rules of our own.

``differential-checking`` (Jensen & Christensen 1995): the kernel grows from k_min photons on, and
stops where the estimate keeps rising, or keeps falling, as it does once the kernel extends over an
edge. Here E_K is compared whenever the number has grown by a fifth; after six rises or six falls in
a row, in which it has trebled, K is the number reached. (The number where the rise began would be
nearer to k_min, but a number chosen where the estimate turns is chosen by its noise: in uniform
light such estimates are as noisy as those of k_min photons.)

``bias-compensation`` (Schregle 2003): K is found by binary search. With μ the running mean of the
estimates accepted so far, weighted by their numbers of photons, and L the last number accepted
(k_min at first), the one in the middle, K, is tried: the deviation E_K - μ is noise if it is
probable under the noise expected,

    (E_K - μ)² <= z² μ² u_K (1/(L - 1) - 1/(K - 1)),
    u_K = (K - 1) Σ_{i < K} Φ_i² / (Σ_{i < K} Φ_i)²,

and bias otherwise. The factor of z² is the variance of the difference between estimates of L
photons and of the K that they are among, for independent photons; u_K is 1 if all carry the same
flux. (Exactly it has K - 2 and L - 2, for the variance of E_K is E² / (K - 2); but K may be as low
as two.) After noise the search continues among more photons, after bias among fewer. z is 2.576,
which one deviation in a hundred exceeds; Schregle draws a random number against the probability.

Over a footprint K is that of its point, and the radius that of the rule of
`photonrelax.estimation.footprint` with K photons.

docs/measurements/refinements.md has the numbers of photons and the errors measured in uniform light
and at an edge.
"""

from __future__ import annotations

from .._ext.estimation import refinement as _refinement

REFINEMENTS = {
    "none": None,
    "differential-checking": _refinement.DIFFERENTIAL_CHECKING,
    "bias-compensation": _refinement.BIAS_COMPENSATION,
}
