"""Windows against ringing: a factor per band that fades the high ones. All keep the mean (factor 1 at l = 0).

Multiply with `zonal.convolve`. Only `positive` guarantees that light which is nowhere negative is reconstructed so.
"""

from functools import cache

import numpy as np
from jaxtyping import Float
from scipy.special import roots_jacobi

from prt_bench.spherical.harmonics import count
from prt_bench.spherical.zonal import zonal_factors


def hann(order: int) -> Float[np.ndarray, " order"]:
    """½ (1 + cos(π l / order)): a raised cosine that reaches zero at the first band left out. Little ringing is left."""
    count(order)
    return 0.5 * (1.0 + np.cos(np.pi * np.arange(order) / order))


def lanczos(order: int) -> Float[np.ndarray, " order"]:
    """sin(π l / order) / (π l / order): sharper than `hann`, and rings more."""
    count(order)
    return np.sinc(np.arange(order) / order)


@cache
def positive(order: int) -> Float[np.ndarray, " order"]:
    """The sharpest window under which a delta light, so any light, stays at or above zero everywhere.

    Its kernel is the polynomial p ≥ 0 of degree order − 1 on [−1, 1] with the largest mean cosine: with 2k or 2k + 1 the
    degree, p(t) = w(t) (J(t) / (t − τ))² for w = 1 or 1 + t, where J is the polynomial of degree k + 1 orthogonal under w and
    τ its largest root. A square, so ringing cannot fall below zero (Fejér 1916; Szegő, Orthogonal Polynomials, §7.72).
    """
    count(order)
    half, odd = divmod(order - 1, 2)
    roots = roots_jacobi(half + 1, 0.0, float(odd))[0]

    def kernel(t: np.ndarray) -> np.ndarray:
        return (1.0 + t) ** odd * np.prod(t[:, None] - roots[:-1], axis=1) ** 2

    factors = zonal_factors(kernel, order, order)
    return factors / factors[0]
