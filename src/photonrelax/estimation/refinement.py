"""Numbers of photons that adapt to the light around a point: refinements of Jensen's estimate.

Few photons are noisy, many blur; both refinements choose a number K between `k_min` and `k` for
each point. They compare the estimates of a constant kernel that reaches to the K-th photon,

    E_K = Σ_{i < K} Φ_i / (π d_K²),

where Φ_i is the flux of the i-th nearest photon, its mean over the channels, and d_K the distance
to the K-th. The estimate itself is then that of K photons and the kernel asked for, with the same K
for all that photons carry. Neither paper is at hand: what follows is their idea as SJ13 §2 and
common knowledge have it, with decision rules of our own.

``differential-checking`` (Jensen & Christensen 1995): the kernel grows from k_min photons on, and
stops where the estimate keeps rising, or keeps falling, as it does once the kernel reaches over an
edge. Here E_K is computed whenever the number has grown by a fifth; after six rises or six falls
in a row, in which it has trebled, K is the number reached. (The number where the rise began would
be nearer to k_min, but a number chosen where the estimate turns is chosen by its noise: in uniform
light such estimates are as noisy as those of k_min photons.)

``bias-compensation`` (Schregle 2003): K is found by binary search. With μ the running mean of the
estimates accepted so far, weighted by their numbers of photons, and L the last number accepted
(k_min at first), the one in the middle, K, is tried: the deviation E_K - μ is noise if it is
probable under the noise expected,

    (E_K - μ)² <= z² μ² u_K (1/(L - 1) - 1/(K - 1)),
    u_K = (K - 1) Σ_{i < K} Φ_i² / (Σ_{i < K} Φ_i)²,

and bias else. Beside z² stands the variance by which estimates of L photons differ from those of
the K that they are among, for independent photons; u_K is 1 if all carry the same flux. (Exactly
it has K - 2 and L - 2, for the variance of E_K is E² / (K - 2); but K may be as low as two.) Noise
lets the search go on among more photons, bias among fewer. z is 2.576, beyond which one deviation
in a hundred lies; Schregle instead draws a random number against the probability.

Measured with random photons and numbers from 15 to 200, in this order of the two:

- in uniform light estimates use 180 and 190 photons; their noise is 10.3 % and 9.9 % (8.4 % with
  200 photons, 32 % with 15), and their mean 0.9 % and 0.2 % low with the Epanechnikov kernel, not
  with the constant one. The numbers are chosen by chance there, which is how it comes; it differs
  from light to light, so nothing makes up for it;
- beyond an edge to darkness, as far as 200 photons of the lit side reach, they use 80 and 66
  photons, and are wrong by 0.17 of the light both (by 0.26 with 200 photons, by 0.14 with 15);
- as far before the edge they use 177 and 174 photons: half of the neighbourhood dark is a drop in
  the estimate too slow for either rule, and errors are those of 200 photons within 2 %.
"""

from __future__ import annotations

from .._ext.estimation import refinement as _adaptive

REFINEMENTS = {
    "none": None,
    "differential-checking": _adaptive.DIFFERENTIAL_CHECKING,
    "bias-compensation": _adaptive.BIAS_COMPENSATION,
}
