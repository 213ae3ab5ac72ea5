"""Spherical harmonics: real, orthonormal, z the polar axis, index l(l + 1) + m, no Condon–Shortley phase.

`harmonics` evaluates them, `projection` makes coefficients of lights and maps, `zonal` and `windows` scale bands, `rotation`
turns coefficients, `products` multiplies functions. K = order² coefficients; whatever is not data passes NumPy or JAX arrays
and computes in their dtype. Nothing here knows scenes or transport.
"""

from prt_bench.spherical.harmonics import azimuths, bands, count, evaluate, order_of, quadrature
from prt_bench.spherical.products import (
    TripleProducts,
    dense_operations,
    product,
    product_matrix,
    sparse_operations,
    triple_products,
)
from prt_bench.spherical.projection import cap_light, delta_light, project_environment, reconstruct
from prt_bench.spherical.rotation import Blocks, apply, block_diagonal, rotate, rotation_blocks
from prt_bench.spherical.windows import hann, lanczos, positive
from prt_bench.spherical.zonal import cap_lobe, cap_solid_angle, convolve, cosine_lobe, phong_lobe, zonal_factors

__all__ = [
    "Blocks",
    "TripleProducts",
    "apply",
    "azimuths",
    "bands",
    "block_diagonal",
    "cap_light",
    "cap_lobe",
    "cap_solid_angle",
    "convolve",
    "cosine_lobe",
    "count",
    "delta_light",
    "dense_operations",
    "evaluate",
    "hann",
    "lanczos",
    "order_of",
    "phong_lobe",
    "positive",
    "product",
    "product_matrix",
    "project_environment",
    "quadrature",
    "reconstruct",
    "rotate",
    "rotation_blocks",
    "sparse_operations",
    "triple_products",
    "zonal_factors",
]
