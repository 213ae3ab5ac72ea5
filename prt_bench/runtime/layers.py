"""GLSL for dense networks, written for the shapes that an asset has: a block of code per layer, sizes and offsets as numbers.

Matrices lie in a buffer as blocks of four inputs of one output, outputs next to each other, so that neighbouring invocations
read neighbouring words; float16 takes half of it. A shape is text: widths joined by "_", as a shader's NETWORK defines it.
"""

from collections.abc import Sequence
from functools import cache
from itertools import pairwise

import numpy as np
from jaxtyping import Float, Int

TILE = 1024
"""Words of four weights that a workgroup shares at a time: half of what every GPU has."""


def spelled(sizes: Sequence[int]) -> str:
    """Widths as a shader's NETWORK defines them."""
    return "_".join(map(str, sizes))


def blocks(matrix: Float[np.ndarray, "o i"]) -> Float[np.ndarray, "b o 4"]:
    """A matrix as the buffer holds it, inputs padded with zeros to a multiple of four."""
    padded = np.pad(matrix, ((0, 0), (0, -matrix.shape[1] % 4)))
    return np.ascontiguousarray(padded.reshape(len(matrix), -1, 4).swapaxes(0, 1))


def buffer(matrices: Sequence[Float[np.ndarray, "o i"]]) -> bytes:
    """All matrices one after another, in their own dtype (float32 or float16)."""
    dtype = "<f2" if matrices[0].dtype == np.float16 else "<f4"
    return b"".join(blocks(matrix).astype(dtype).tobytes() for matrix in matrices)


@cache
def network_code(shape: str) -> str:
    """`void layers(uint lane)`: all layers but the first input's, one output per invocation, then `head`.

    Reads `observed(m)`, `four(block)` and `biases[]`; passes activations on in `activations[2][]`, shared; the last layer adds
    to `coefficients[]` with HEAD_CHANNELS matrices and no bias.
    """
    *hidden, last = pairwise(map(int, shape.split("_")))
    lines, at, bias = [], 0, 0
    for layer, (into, out) in enumerate(hidden):
        source, target = (layer + 1) % 2, layer % 2
        lines += [f"for (uint o = lane; o < {out}u; o += WORKGROUP) {{", f"    vec3 sum = vec3(biases[{bias}u + o]);"]
        lines += _products(into, at, out, "observed" if layer == 0 else f"passed{source}")
        lines += [f"    activations[{target}][o] = squareplus(sum);", "}", "barrier();"]
        at, bias = at + -(-into // 4) * out, bias + out
    into, out = last
    source, size = f"passed{(len(hidden) + 1) % 2}", -(-into // 4) * out
    lines += [f"for (uint o = lane; o < {out}u; o += WORKGROUP) {{", "    vec3 sum = vec3(0.0);"]
    lines += ["#if HEAD_CHANNELS == 1", *_products(into, at, out, source), "#else"]
    lines += [f"    for (uint b = 0u; b < {-(-into // 4)}u; ++b) {{", f"        mat4x3 a = {_columns(source, into)};"]
    for c, name in enumerate("rgb"):
        row = f"vec4(a[0].{name}, a[1].{name}, a[2].{name}, a[3].{name})"
        lines.append(f"        sum.{name} += dot({row}, four({at + c * size}u + b * {out}u + o));")
    lines += ["    }", "#endif", "    coefficients[o].rgb += size * sum;", "}"]
    reads = [f"vec3 passed{each}(uint i) {{ return activations[{each}][i]; }}" for each in (0, 1)]
    return "\n".join(reads) + "\nvoid layers(uint lane, vec3 size) {\n" + _indented(lines) + "}\n"


def _products(into: int, at: int, out: int, source: str) -> list[str]:
    return [
        f"    for (uint b = 0u; b < {-(-into // 4)}u; ++b) sum += {_columns(source, into)} * four({at}u + b * {out}u + o);"
    ]


def _columns(source: str, into: int) -> str:
    """Four inputs of all channels; those beyond the last have a weight of zero, and are taken from within."""
    reads = [
        f"{source}(4u * b + {i}u)" if into % 4 == 0 else f"{source}(min(4u * b + {i}u, {into - 1}u))" for i in range(4)
    ]
    return f"mat4x3({', '.join(reads)})"


def _indented(lines: Sequence[str]) -> str:
    return "".join(line + "\n" if line.startswith("#") else f"    {line}\n" for line in lines)


@cache
def field_code(shape: str) -> str:
    """`void field(vec3 place, vec3 normal, out vec4 phi[])`: a block of loops per layer, for a fragment of its own.

    Widths are those of inputs, layers and functions. `encode` fills the first layer's inputs. How often each loop turns is read
    from `turns[]` (see `turns`): compilers that know it take minutes to unroll them.
    """
    layers = list(pairwise(map(int, shape.split("_"))))
    most = max(_fours(width) for into, out in layers for width in (into, out))
    lines = [f"vec4 a[{most}], b[{most}];", "encode(place, normal, a);"]
    at, bias, source, target = 0, 0, "a", "b"
    for number, (into, out) in enumerate(layers):
        last = number == len(layers) - 1
        result = "phi" if last else target
        begin = "vec4(0.0)" if last else f"biases[{bias} + g]"
        lines += [f"for (int g = 0; g < turns[{number}].y; ++g) {{", f"    vec4 sum = {begin};"]
        lines += [f"    for (int i = 0; i < turns[{number}].x; ++i) {{"]
        lines += [f"        uint w = uint({at} + {4 * _fours(out)} * i + 4 * g);", f"        vec4 v = {source}[i];"]
        lines += [
            "        sum += vec4(dot(four(w), v), dot(four(w + 1u), v), dot(four(w + 2u), v), dot(four(w + 3u), v));"
        ]
        lines += ["    }", f"    {result}[g] = {'sum' if last else 'squareplus(sum)'};", "}"]
        at, bias, source, target = at + _fours(into) * 4 * _fours(out), bias + _fours(out), target, source
    return f"void field(vec3 place, vec3 normal, out vec4 phi[{_fours(layers[-1][1])}]) {{\n{_indented(lines)}}}\n"


@cache
def shared_field_code(shape: str) -> str:
    """`void field(...)` as `field_code` has it, for a workgroup whose invocations all call it: they fetch weights together.

    Some outputs of a layer at a time, as many as a `tile` of `TILE` words of four takes, lie in shared memory; each invocation
    keeps the activations of its own place.
    """
    layers = list(pairwise(map(int, shape.split("_"))))
    most = max(_fours(width) for into, out in layers for width in (into, out))
    lines = [f"vec4 a[{most}], b[{most}];", "uint lane = gl_LocalInvocationIndex;", "encode(place, normal, a);"]
    at, bias, source, target = 0, 0, "a", "b"
    for number, (into, out) in enumerate(layers):
        last = number == len(layers) - 1
        result, begin = ("phi", "vec4(0.0)") if last else (target, f"biases[{bias} + g]")
        outputs, row = max(TILE // (4 * _fours(into)), 1), 4 * _fours(into)
        lines += [f"for (int first = 0; first < turns[{number}].y; first += {outputs}) {{"]
        lines += [f"    int end = min(first + {outputs}, turns[{number}].y);", "    barrier();"]
        lines += [f"    for (uint w = lane; w < uint((end - first) * {row}); w += WORKGROUP) {{"]
        lines += [f"        uint g = uint(first) + w / {row}u, i = (w % {row}u) / 4u;"]
        lines += [
            f"        tile[w] = four({at}u + {4 * _fours(out)}u * i + 4u * g + w % 4u);",
            "    }",
            "    barrier();",
        ]
        lines += ["    for (int g = first; g < end; ++g) {", f"        vec4 sum = {begin};"]
        lines += [f"        for (int i = 0; i < turns[{number}].x; ++i) {{"]
        lines += [f"            int w = (g - first) * {row} + 4 * i;", f"            vec4 v = {source}[i];"]
        lines += [
            "            sum += vec4(dot(tile[w], v), dot(tile[w + 1], v), dot(tile[w + 2], v), dot(tile[w + 3], v));"
        ]
        lines += ["        }", f"        {result}[g] = {'sum' if last else 'squareplus(sum)'};", "    }", "}"]
        at, bias, source, target = at + _fours(into) * 4 * _fours(out), bias + _fours(out), target, source
    head = f"shared vec4 tile[{TILE}];\n"
    return (
        f"{head}void field(vec3 place, vec3 normal, out vec4 phi[{_fours(layers[-1][1])}]) {{\n{_indented(lines)}}}\n"
    )


def turns(sizes: Sequence[int]) -> Int[np.ndarray, "l 4"]:
    """Blocks of four inputs and of four outputs of each layer, as `field_code` reads them."""
    rows = [(_fours(into), _fours(out), 0, 0) for into, out in pairwise(sizes)]
    return np.array(rows, "<i4")


def _fours(width: int) -> int:
    return -(-width // 4)


CODE = {"network": network_code, "field": field_code, "shared_field": shared_field_code}
"""What `#include "generated/NAME"` pastes, for the shape that NETWORK defines."""
