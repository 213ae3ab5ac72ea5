"""GLSL that is written by the program: harmonics and triple products of one order, without loops, indices or zeros.

What a loop over all K³ products would do, the sparse tensor does with one line per pair of coefficients and one per entry.
"""

from collections.abc import Iterator
from functools import cache
from math import pi, sqrt

import numpy as np

from prt_bench.spherical import bands, cosine_lobe, triple_products


@cache
def harmonics_code(order: int) -> str:
    """`void harmonics(vec3 d, out float y[K])`: all harmonics of a unit direction, by the recurrence of `evaluate`."""
    return _function(f"void harmonics(vec3 d, out float y[{order**2}])", _harmonics_lines(order))


def _harmonics_lines(order: int) -> list[str]:
    lines = ["float c0 = 1.0, s0 = 0.0;"]
    lines += [
        f"float c{m} = d.x * c{m - 1} - d.y * s{m - 1}, s{m} = d.x * s{m - 1} + d.y * c{m - 1};"
        for m in range(1, order)
    ]
    for m in range(order):
        for band in range(m, order):
            if band == m:
                value = _number(_first(m))
            else:
                value = f"{_number(_ahead(band, m))} * d.z * q{band - 1}_{m}"
                if band > m + 1:
                    value += f" - {_number(_ahead(band, m) / _ahead(band - 1, m))} * q{band - 2}_{m}"
            lines.append(f"float q{band}_{m} = {value};")
            middle = band * (band + 1)
            lines.append(f"y[{middle + m}] = q{band}_{m} * c{m};")
            if m:
                lines.append(f"y[{middle - m}] = q{band}_{m} * s{m};")
    return lines


@cache
def open_code(order: int) -> str:
    """`void open_surface(vec3 d, out float y[K])`: the transfer vector of a point that sees the hemisphere about d."""
    factors = np.asarray(cosine_lobe(order))[bands(order)]
    lines = [f"y[{k}] *= {_number(float(factor))};" for k, factor in enumerate(factors)]
    return _function(f"void open_surface(vec3 d, out float y[{order**2}])", _harmonics_lines(order) + lines)


@cache
def lobe_code(order: int) -> str:
    """`void lobe(float s, inout float y[K])`: bands times the factors of a normalised Phong lobe of exponent s."""
    lines = ["float u = 1.0 / (1.0 + s);", "float l0 = 1.0, l1 = 1.0 / (1.0 + u);"]
    lines += [
        f"float l{band} = l{band - 2} * (1.0 + {_number(1.0 - band)} * u) / (1.0 + {_number(band)} * u);"
        for band in range(2, order)
    ]
    lines += [f"y[{k}] *= l{band};" for k, band in enumerate(bands(order)) if band]
    return _function(f"void lobe(float s, inout float y[{order**2}])", lines)


@cache
def product_code(order: int) -> str:
    """`void product(float a[K], float b[K], out float f[K])`: coefficients of the product of two functions.

    Γ is symmetric, so a_i b_k + a_k b_i is formed once for each pair and serves all entries (i, k, j).
    """
    size = order * order
    lines = [f"for (int k = 0; k < {size}; ++k) f[k] = 0.0;", "float p;"]
    pair = None
    for (i, k, j), value in _ordered(order):
        if pair != (i, k):
            pair = (i, k)
            lines.append(f"p = a[{i}] * b[{i}];" if i == k else f"p = a[{i}] * b[{k}] + a[{k}] * b[{i}];")
        lines.append(f"f[{j}] += {_number(value)} * p;")
    return _function(f"void product(float a[{size}], float b[{size}], out float f[{size}])", lines)


@cache
def dense_product_code(order: int) -> str:
    """The same function by three loops over the whole tensor in a buffer: what `product_code` is compared with.

    The buffer holds K before the tensor: compilers take minutes to unroll loops whose length they know.
    """
    size = order * order
    lines = [
        "for (int j = 0; j < size; ++j) {",
        "    float sum = 0.0;",
        "    for (int i = 0; i < size; ++i)",
        "        for (int k = 0; k < size; ++k) sum += tensor[(j * size + i) * size + k] * a[i] * b[k];",
        "    f[j] = sum;",
        "}",
    ]
    declared = "layout(std430, binding = 9) readonly buffer Tensor { int size; float tensor[]; };\n"
    return declared + _function(f"void product(float a[{size}], float b[{size}], out float f[{size}])", lines)


def operations(order: int) -> dict[str, int]:
    """Multiplications and additions of one product of two functions: by the whole tensor, and by the generated code."""
    entries = list(_ordered(order))
    formed = pairs(order)
    equal = sum(i == k for i, k in formed)
    size = order * order
    return {"dense": 3 * size**3, "sparse": 2 * len(entries) + 3 * (len(formed) - equal) + equal}


def _ordered(order: int) -> Iterator[tuple[tuple[int, int, int], float]]:
    """Entries (i, k, j) with i ≤ k, sorted, and their values."""
    indices, values = triple_products(order)
    kept = indices[:, 0] <= indices[:, 1]
    return (((int(i), int(k), int(j)), float(v)) for (i, k, j), v in zip(indices[kept], values[kept], strict=True))


def pairs(order: int) -> list[tuple[int, int]]:
    """The pairs (i, k), i ≤ k, of coefficients whose product has a part below the order, in the order of the code."""
    return sorted({entry[:2] for entry, _ in _ordered(order)})


@cache
def bilinear_code(order: int) -> str:
    """`vec3 bilinear(float a[K], float b[K])`: aᵀ M b of each channel, M's upper half a row per pair in a uniform block."""
    size = order * order
    lines = ["vec3 sum = vec3(0.0);"]
    for row, (i, k) in enumerate(pairs(order)):
        both = f"a[{i}] * b[{i}]" if i == k else f"a[{i}] * b[{k}] + a[{k}] * b[{i}]"
        lines.append(f"sum += matrix[{row}].rgb * ({both});")
    declared = f"layout(std140, binding = 1) uniform Matrix {{ vec4 matrix[{len(pairs(order))}]; }};\n"
    return declared + _function(f"vec3 bilinear(float a[{size}], float b[{size}])", [*lines, "return sum;"])


def matrix_entries(order: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """M_ik = Σ_j Γ_ijk L_j by rows of `pairs`: starts [pairs + 1], indices j, values Γ."""
    entries = list(_ordered(order))
    rows = {pair: row for row, pair in enumerate(pairs(order))}
    owner = np.array([rows[entry[:2]] for entry, _ in entries])
    starts = np.searchsorted(owner, np.arange(len(rows) + 1))
    return starts, np.array([entry[2] for entry, _ in entries]), np.array([value for _, value in entries])


CODE = {
    "harmonics": harmonics_code,
    "open": open_code,
    "lobe": lobe_code,
    "product": product_code,
    "dense_product": dense_product_code,
    "bilinear": bilinear_code,
}
"""What `#include "generated/NAME"` pastes, for the order that ORDER defines."""


def _first(m: int) -> float:
    """q[m, m]: the constant of sinᵐθ, with the √2 of m > 0."""
    value = sqrt(1.0 / (4.0 * pi)) * (sqrt(2.0) if m else 1.0)
    for i in range(1, m + 1):
        value *= sqrt((2 * i + 1) / (2 * i))
    return value


def _ahead(band: int, m: int) -> float:
    """What q[l − 1, m] z is multiplied by; q[l − 2, m] has this over that of the band before."""
    return sqrt((4 * band**2 - 1) / (band**2 - m**2))


def _function(head: str, lines: list[str]) -> str:
    return head + " {\n" + "\n".join("    " + line for line in lines) + "\n}\n"


def _number(value: float) -> str:
    return f"{np.float32(value):.9e}" if value >= 0 else f"({np.float32(value):.9e})"
