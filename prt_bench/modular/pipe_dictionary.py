"""The dictionary of pipes: reduced transfer of a straight one and of a bend, and of what passes through their ends.

Three shapes are two entries: a bend to the right is one to the left, mirrored. Lightfields are kept in a span that is its own
mirror image, so that mirroring is a small orthogonal matrix, and no shape, direction or end needs matrices of its own.
"""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from prt_bench.errors import SpecError
from prt_bench.modular.dictionary import Operators, filled
from prt_bench.modular.lightfield import Grid, contracted, spanning
from prt_bench.modular.modes import factors
from prt_bench.modular.pipe import ALONG, SHAPES, orders
from prt_bench.modular.pipe_light import mirrored, passage, reduced, response
from prt_bench.progress import track

_LEAST_SIDE = 8


class PipeDictionary(Operators):
    """Reduced operators of the entries straight and bend, K = 2: B functions of a pipe, k of lightfields, R of what arrives.

    `basis` [K, n, B] and `read` [K, B, n] as in `modes.Modes`; `leave` [K, 2, k, B] from coefficients of a pipe to the
    lightfield that leaves through its far and its near end; `onwards` [K, k, k] from the near end to the far one; `arrive`
    [K, R, k] from a lightfield that enters through the near end to what arrives, and `arriving` [n, R] from that to irradiance,
    the same for both entries; `mirror` [k, k] exchanges right and left of a lightfield.
    """

    basis: Float[Array, "K n B"]
    read: Float[Array, "K B n"]
    leave: Float[Array, "K 2 k B"]
    onwards: Float[Array, "K k k"]
    arrive: Float[Array, "K R k"]
    arriving: Float[Array, "n R"]
    mirror: Float[Array, "k k"]
    secondary: None = None

    @property
    def side(self) -> int:
        """Samples along and around a pipe."""
        return round(self.basis.shape[1] ** 0.5)


def build(
    side: int = 64,
    functions: int = 32,
    prior: int = 64,
    lights: int = 63,
    grid: Grid | None = None,
    lightfields: int = 96,
    arriving: int = 32,
) -> PipeDictionary:
    """Compute the dictionary; `side`² samples a pipe, `functions` within it, `lightfields` between pipes.

    A lightfield has 8² points and 16² directions unless a `grid` is given. Raises `SpecError` for sizes that are too small and
    for a `side` that is odd. Not differentiable.
    """
    grid = grid or Grid(8, 16)
    least = {"side": _LEAST_SIDE, "functions": 1, "prior": functions, "lights": 1, "lightfields": 1, "arriving": 1}
    given = {"side": side, "functions": functions, "prior": prior, "lights": lights}
    for name, value in {**given, "lightfields": lightfields, "arriving": arriving}.items():
        if value < least[name]:
            raise SpecError(f"{name} of a dictionary of pipes is {value}, but must be at least {least[name]}")
    if side % 2:
        raise SpecError(f"side of a dictionary of pipes is {side}, but must be even, for a pipe has a mirror image")
    swap, backwards = mirrored(grid), orders(side)[ALONG]
    entries = [reduced(pipe, side, functions, prior, lights) for pipe in track(SHAPES, "pipes")]
    passages = [passage(pipe, side, grid) for pipe in track(SHAPES, "ends")]
    # What leaves through the near end is the mirror image of what a pipe with its samples in reverse sends through the far one.
    fields = [
        (leave @ modes.implicit, (leave @ modes.implicit[backwards])[swap])
        for modes, (leave, _) in zip(entries, passages, strict=True)
    ]
    strength = [modes.decay[: modes.implicit.shape[1]] for modes in entries]
    likely = np.concatenate(
        [field * size for size, both in zip(strength, fields, strict=True) for field in both], axis=1
    )
    ways = [onwards for _, onwards in passages]
    turned = [*ways, ways[1][swap][:, swap]]
    span = spanning(np.concatenate([likely, likely[swap]], axis=1), turned, lightfields)
    leave = np.zeros((len(SHAPES), 2, span.shape[1], functions))
    for kind, both in enumerate(fields):
        for end, field in enumerate(both):
            leave[kind, end] = filled(span.T @ field, functions)
    onwards = np.stack([contracted(span.T @ (way @ span)) for way in ways])
    arrives = [response(pipe, side, grid, span) for pipe in track(SHAPES, "walls")]
    basis = factors(np.concatenate(arrives, axis=1))[0][:, :arriving]
    return PipeDictionary(
        *(
            jnp.asarray(array, jnp.float32)
            for array in (
                np.stack([filled(modes.basis, functions) for modes in entries]),
                np.stack([filled(modes.read.T, functions).T for modes in entries]),
                leave, onwards, np.stack([basis.T @ each for each in arrives]), basis, span.T @ span[swap],
            )
        )
    )  # fmt: skip
