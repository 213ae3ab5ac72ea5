"""How light leaves the blocks of a level, passes through others and arrives: a dictionary's operators from face to face.

Light along each of the six directions is kept in that direction's frame, which is one of `rotations`. What a dictionary holds
is for light that enters along +x and leaves a block as its entry stands; everywhere else it is rolled between frames.
"""

import numpy as np
from jaxtyping import Float

from prt_bench.modular.cube import FACES
from prt_bench.modular.dictionary import DOORS, Dictionary
from prt_bench.modular.lightfield import EXITS
from prt_bench.modular.rotations import FACE, INVERSE, PRODUCT, ROLLS


class Passages:
    """The matrices of `dictionary` in float64, rolled as light in a level needs them; `arrive` [R, k] is the dictionary's."""

    arrive: Float[np.ndarray, "R k"]

    def __init__(self, dictionary: Dictionary) -> None:
        self._leave, onwards, roll, self.arrive = (
            np.asarray(part, np.float64)
            for part in (dictionary.leave, dictionary.onwards, dictionary.roll, dictionary.arrive)
        )
        self._rolls = [np.linalg.matrix_power(each, count) for each in roll for count in range(ROLLS)]
        self._exits = dict(zip(EXITS.values(), onwards, strict=False))
        if self._rolls:
            self._exits |= {FACE[FACES * rolls, EXITS["left"]]: self._rolled_left(rolls) for rolls in range(1, ROLLS)}
        self._known: dict[tuple[int, int], Float[np.ndarray, "k k"]] = {}

    def leaving(self, kind: int, pose: int, face: int) -> Float[np.ndarray, "k B"]:
        """From b of a block to the lightfield that leaves through a missing face."""
        own = FACE[INVERSE[pose], face]
        return self._framed(_frame(face, pose, own), self._leave[DOORS.index((kind, own))])

    def onwards(self, along: int, exit_: int) -> Float[np.ndarray, "k k"]:
        """From the lightfield that enters a block towards face `along` to that which leaves through another than it came by."""
        if (along, exit_) not in self._known:
            own = FACE[INVERSE[along], exit_]
            self._known[along, exit_] = self._framed(_frame(exit_, along, own), self._exits[own])
        return self._known[along, exit_]

    def _framed(self, rolls: int, light: Float[np.ndarray, "k m"]) -> Float[np.ndarray, "k m"]:
        """Light in the frame of its direction that is given in one so many rolls away."""
        return self._rolls[rolls] @ light if rolls else light

    def _rolled_left(self, rolls: int) -> Float[np.ndarray, "k k"]:
        """Rolled back, to the left, rolled again: to the exit that lies so many quarter turns about +x from the left one."""
        roll, left = FACES * rolls, EXITS["left"]
        return self._framed(_frame(FACE[roll, left], roll, left), self._exits[left] @ self._rolls[-rolls])


def _frame(face: int, rotation: int, own: int) -> int:
    """Rolls from the frame of a face to that of another face that a rotation takes there."""
    return int(PRODUCT[INVERSE[face], PRODUCT[rotation, own]]) // FACES
