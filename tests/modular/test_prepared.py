"""The operator as one core runs it, and which pairs of blocks it leaves out."""

from itertools import product

import numpy as np
import pytest

from prt_bench.errors import SpecError
from prt_bench.modular.level import Level, maze, transfer
from prt_bench.modular.prepared import PreparedLevel

from .conftest import SIDE

CELLS = [(i, j) for i in range(3) for j in range(3)]


@pytest.mark.parametrize(
    ("level", "channels"),
    [
        (Level(((0, 0),)), 3),
        (maze(12, seed=4), 3),
        (Level(tuple(CELLS)), 1),
        (maze(12, seed=4, layers=3), 3),
        (Level(tuple(product(range(3), repeat=3))), 1),
    ],
    ids=["one", "maze", "hall", "layers", "cube"],
)
def test_what_is_prepared_is_the_operator(level, channels, any_dictionary):
    operator = transfer(level, any_dictionary)
    random, shape = np.random.default_rng(0), (len(level.cells), 6 * SIDE**2, channels)
    direct, albedo = random.random((2, *shape), np.float32)
    albedo *= np.asarray(operator.solid)[:, :, None]
    prepared = PreparedLevel(operator, channels)

    def ordered(light):
        return np.ascontiguousarray(np.swapaxes(light, 1, 2)[prepared.order])

    for bounces in (1, 3, 1):  # nothing of a call is left for the next
        wanted = ordered(np.asarray(operator(direct, albedo, bounces)))
        found = prepared(ordered(direct), ordered(albedo), bounces)
        np.testing.assert_allclose(found, wanted, atol=1e-5 * wanted.max())


def test_the_weakest_pairs_of_each_source_are_left_out(any_dictionary):
    level, tolerance = maze(20, seed=1), 0.2
    every, some = (transfer(level, any_dictionary, tolerance=given) for given in (0.0, tolerance))
    assert len(some.pairs) < 0.8 * len(every.pairs)
    squares = {}
    for operator in (every, some):
        found = squares[id(operator)] = {}
        for to, source, pair in zip(
            *map(np.asarray, (operator.pair_to, operator.pair_from, operator.pairs)), strict=True
        ):
            found.setdefault(int(source), {})[int(to)] = float(np.sum(pair.astype(float) ** 2))
    for source, pairs in squares[id(every)].items():
        kept = squares[id(some)][source]
        assert kept == {to: pairs[to] for to in kept}
        gone = sorted(size for to, size in pairs.items() if to not in kept)
        allowed = tolerance**2 * sum(pairs.values())
        assert sum(gone) <= allowed < sum(gone) + min(kept.values())
        assert not gone or gone[-1] <= min(kept.values())
    with pytest.raises(SpecError, match="tolerance"):
        transfer(level, any_dictionary, tolerance=1.0)
