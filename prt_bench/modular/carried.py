"""Light that is carried from shape to shape: lightfields sent breadth first through interfaces, and what arrives by each.

An interface here has one direction. What shapes there are, and how they are joined, is told by matrices between interfaces.
"""

from collections import defaultdict
from collections.abc import Hashable, Mapping, Sequence
from typing import NamedTuple, TypeVar

import numpy as np
from jaxtyping import Float, Int

from prt_bench.errors import SpecError

Key = TypeVar("Key", bound=Hashable)


class Carried(NamedTuple):
    """Pairs of an interface and a source of light, by interface: r of `to` is the sum of `pairs` times b of `source`."""

    pairs: Float[np.ndarray, "E R B"]
    to: Int[np.ndarray, " E"]
    source: Int[np.ndarray, " E"]


def carried(
    leaving: Sequence[Mapping[Key, Float[np.ndarray, "k B"]]],
    onwards: Mapping[Key, Sequence[tuple[Key, Float[np.ndarray, "k k"]]]],
    arrive: Mapping[Key, Float[np.ndarray, "R k"]],
    shape: tuple[int, int],
    depth: int,
    tolerance: float,
) -> Carried:
    """Carry the light of each source through up to `depth` interfaces, numbered in the order of `arrive`.

    `leaving` has the lightfields that each source sends through interfaces, `onwards` how those in one become those in the
    next; `shape` is that of a pair, R and B. Of the pairs of a source the weakest are left out, as many as together hold
    `tolerance`² of the squares of all. Raises `SpecError` for a depth below 1, and for a tolerance that is not from 0 to
    below 1.
    """
    if depth < 1:
        raise SpecError(f"light in a level passes through at least 1 interface, not {depth}")
    if not 0 <= tolerance < 1:
        raise SpecError(f"the tolerance of a level's pairs is from 0 to below 1, not {tolerance}")
    number = {key: at for at, key in enumerate(arrive)}
    to, from_, pairs = [], [], []
    for source, first in enumerate(leaving):
        front: dict[Key, np.ndarray] = dict(first)
        summed: dict[Key, np.ndarray] = {}
        for _ in range(depth):
            following: dict[Key, np.ndarray] = defaultdict(lambda: np.zeros(()))
            for key, light in front.items():
                summed[key] = summed.get(key, np.zeros(())) + arrive[key] @ light
                for after, way in onwards[key]:
                    following[after] = following[after] + way @ light
            front = following
        squares = {key: float(np.sum(matrix**2)) for key, matrix in summed.items()}
        spare = tolerance**2 * sum(squares.values())
        for key in sorted(summed, key=squares.__getitem__):
            spare -= squares[key]
            if spare < 0:
                to.append(number[key])
                from_.append(source)
                pairs.append(summed[key])
    order = np.argsort(np.array(to, int), kind="stable")
    stacked = np.stack(pairs)[order] if pairs else np.zeros((0, *shape))
    return Carried(stacked, np.array(to, int)[order], np.array(from_, int)[order])
