"""A small dictionary of blocks, built once."""

import pytest

from prt_bench.modular.dictionary import Dictionary, build
from prt_bench.modular.lightfield import Grid

SIDE, GRID = 8, Grid(8, 14)


@pytest.fixture(scope="session")
def dictionary() -> Dictionary:
    return build(SIDE, functions=24, prior=40, lights=40, grid=GRID, lightfields=64, arriving=24)
