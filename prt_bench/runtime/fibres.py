"""Fibres on the GPU: what `hair.glsl` reads of the scattering function of each material that is hair."""

from collections.abc import Sequence

import moderngl
import numpy as np
from jaxtyping import Float

from prt_bench.hair import LOBES, Hair, Inclination, azimuthal, crossing
from prt_bench.scene import Material

AZIMUTHS, INCLINATIONS = 128, 32
"""Texels of a lobe's table."""
_ACROSS = 64  # nodes of the quadrature across a fibre


class Fibres:
    """Tables of the hair among `materials`, and the code that says what else there is to know of them.

    `layer` holds, for each material, its number among those that are hair, −1 for others.
    """

    def __init__(self, context: moderngl.Context, materials: Sequence[Material]) -> None:
        kinds = [material.hair for material in materials if material.hair is not None]
        numbers = iter(range(len(kinds)))
        self.layer = [-1 if material.hair is None else next(numbers) for material in materials]
        self.pasted = {"fibres": fibre_code(kinds)}
        layers = np.concatenate([lobe_tables(hair) for hair in kinds])
        content = np.ascontiguousarray(layers, "<f4").tobytes()
        self._texture = context.texture_array((AZIMUTHS, INCLINATIONS, len(layers)), 3, content, dtype="f4")
        self._texture.filter = (moderngl.LINEAR, moderngl.LINEAR)
        self._texture.repeat_x = self._texture.repeat_y = False

    def bind(self) -> None:
        """Bind the tables where `hair.glsl` reads."""
        self._texture.use(9)


def lobe_tables(hair: Hair) -> Float[np.ndarray, "4 I A 3"]:
    """Share of each lobe by inclination and azimuth, mean over the fibre's width: S without its longitudinal factors."""
    azimuth = np.pi * (np.arange(AZIMUTHS) + 0.5) / AZIMUTHS
    sine = (np.arange(INCLINATIONS) + 0.5) / INCLINATIONS
    out = Inclination.of(sine)
    node, weight = np.polynomial.legendre.leggauss(_ACROSS)
    table = np.zeros((LOBES, INCLINATIONS, AZIMUTHS, 3))
    # h = sin γ takes the square root at the rim out of the integrand.
    for gamma, share in zip(0.5 * np.pi * node, 0.25 * np.pi * weight * np.cos(0.5 * np.pi * node), strict=True):
        found = crossing(hair, out, np.full(INCLINATIONS, np.sin(gamma)))
        for p in range(LOBES):
            flat = np.full((INCLINATIONS, AZIMUTHS), 0.5 / np.pi)
            density = azimuthal(azimuth - found.turns[:, p, None], hair.scale) if p < 3 else flat
            table[p] += share * density[..., None] * found.weights[:, p, None]
    return table


def fibre_code(kinds: Sequence[Hair]) -> str:
    """`vec4 variances(int)` of the four lobes and `float scale_tilt(int)` in radians, of each kind of hair."""
    rows = ", ".join(f"vec4({', '.join(f'{value:.9e}' for value in hair.variances)})" for hair in kinds)
    tilts = ", ".join(f"{hair.tilt:.9e}" for hair in kinds)
    return (
        f"vec4 variances(int kind) {{ return vec4[]({rows})[kind]; }}\n"
        f"float scale_tilt(int kind) {{ return float[]({tilts})[kind]; }}\n"
    )
