"""The 24 rotations of the cube onto itself: as matrices, how they follow one another, and what they do to faces and samples.

Rotation 6 m + f rolls by m quarter turns about +x, from +y to +z, and then takes +x to face f. The first six, without a roll,
are the frames of light along the six directions; of these 0, 5, 1 and 4 are the quarter turns about +y.
"""

from functools import cache

import numpy as np
from jaxtyping import Int

from prt_bench.modular.cube import FACES, inward, sample_points

ROLLS = 4
"""Quarter turns about an axis."""
_ROLL = np.array([[1, 0, 0], [0, 0, -1], [0, 1, 0]])
_FRAMES = np.array(
    [
        [[1, 0, 0], [0, 1, 0], [0, 0, 1]],
        [[-1, 0, 0], [0, 1, 0], [0, 0, -1]],
        [[0, -1, 0], [1, 0, 0], [0, 0, 1]],
        [[0, 1, 0], [-1, 0, 0], [0, 0, 1]],
        [[0, 0, -1], [0, 1, 0], [1, 0, 0]],
        [[0, 0, 1], [0, 1, 0], [-1, 0, 0]],
    ]
)
ROTATIONS: Int[np.ndarray, "24 3 3"] = np.concatenate(
    [_FRAMES @ np.linalg.matrix_power(_ROLL, rolls) for rolls in range(ROLLS)]
)
"""As matrices on columns."""


def _number(matrices: Int[np.ndarray, "*n 3 3"]) -> Int[np.ndarray, "*n"]:
    return np.argmax(np.all(matrices[..., None, :, :] == ROTATIONS, axis=(-2, -1)), axis=-1)


PRODUCT: Int[np.ndarray, "24 24"] = _number(ROTATIONS[:, None] @ ROTATIONS)
"""At [a, b] the rotation that is b and then a."""
INVERSE: Int[np.ndarray, " 24"] = _number(np.swapaxes(ROTATIONS, 1, 2))
_OUT = -inward(np.arange(FACES)).astype(int)
FACE: Int[np.ndarray, "24 6"] = np.argmax(np.einsum("rij,fj,gi->rfg", ROTATIONS, _OUT, _OUT), axis=2)
"""At [r, f] where rotation r takes face f."""


@cache
def turns(side: int) -> Int[np.ndarray, "24 n"]:
    """p with x[p[r]] the light of a cube after rotation r, where x [n] is that of the cube, at `side`² samples a face."""
    position, _ = sample_points(side)
    places = np.rint((2 * position + 1) * side).astype(int)  # odd numbers within a face, even ones across it
    number = {tuple(place): row for row, place in enumerate(places.tolist())}
    centred = places - side
    found = np.empty((len(ROTATIONS), len(places)), int)
    for rotation, matrix in enumerate(ROTATIONS):
        found[rotation] = [number[tuple(place)] for place in (centred @ matrix + side).tolist()]  # rows: the inverse
    return found
