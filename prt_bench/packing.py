"""Sparse 16-bit storage of arrays: small entries dropped, the others in whole steps of their column's range.

What an error in a column costs is the caller's to say, by weights. Assets of the runtime store dense arrays, see `assets.py`.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int, UInt8

from prt_bench.errors import AssetError

STEPS = 2**15 - 1
"""Of which a column's largest entry is one: so many multiples fit into 16 bits with a sign."""


class Packed(NamedTuple):
    """A matrix [n, m]: a bit for each entry that tells whether it is kept, the kept ones as 16-bit multiples of `step` [m]."""

    shape: tuple[int, int]
    kept: UInt8[np.ndarray, " bytes"]
    values: Int[np.ndarray, " kept"]
    step: Float[np.ndarray, " m"]

    @property
    def bytes(self) -> int:
        """Bytes of bits, values and steps."""
        return self.kept.nbytes + self.values.nbytes + self.step.nbytes

    def unpacked(self) -> Float[np.ndarray, "n m"]:
        """The matrix again in float32, zeros where entries were dropped."""
        return self.multiples() * self.step

    def multiples(self) -> Int[np.ndarray, "n m"]:
        """The 16-bit multiples of `step`, dense."""
        flags = np.unpackbits(self.kept, count=int(np.prod(self.shape))).astype(bool).reshape(self.shape)
        out = np.zeros(self.shape, np.int16)
        out[flags] = self.values
        return out


def threshold(share: float, *sizes: Float[np.ndarray, "n m"]) -> float:
    """The size from which on `share` of the entries of all arrays together are kept; 0 keeps all.

    Raises `AssetError` for a share outside of (0, 1].
    """
    if not 0 < share <= 1:
        raise AssetError(f"a share of {share:g} of the entries cannot be kept; give one above 0 and up to 1")
    entries = np.concatenate([size.ravel() for size in sizes])
    dropped = len(entries) - max(round(share * len(entries)), 1)
    return float(np.partition(entries, dropped)[dropped]) if dropped else 0.0


def packed(
    matrix: Float[np.ndarray, "n m"], least: float = 0.0, weight: Float[np.ndarray, " m"] | float = 1.0
) -> Packed:
    """Keep the entries with |entry| · weight ≥ `least`, a weight for each column.

    A kept entry is off by half a step at most, a step being its column's largest kept entry over 32767. Raises `AssetError`
    for values that are not finite.
    """
    if not np.isfinite(matrix).all():
        raise AssetError("a matrix with values that are not finite cannot be quantised; fit it again")
    flags = (np.abs(matrix) * weight >= least) & (matrix != 0)
    largest = np.max(np.abs(matrix), axis=0, where=flags, initial=0.0)
    step = np.where(largest > 0, largest / STEPS, 1.0).astype(np.float32)
    values = np.rint(matrix / step)[flags].astype(np.int16)
    return Packed((matrix.shape[0], matrix.shape[1]), np.packbits(flags), values, step)
