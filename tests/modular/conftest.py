"""A small dictionary of blocks and one of pipes, built once; and one of any numbers, where it does not matter what they are."""

import fcntl
import os
from collections.abc import Callable

import jax.numpy as jnp
import numpy as np
import pytest

from prt_bench.modular.cube import FACES
from prt_bench.modular.dictionary import DOORS, KINDS, Dictionary, build
from prt_bench.modular.lightfield import Grid
from prt_bench.modular.pipe_dictionary import PipeDictionary
from prt_bench.modular.pipe_dictionary import build as build_pipes

SIDE, GRID = 8, Grid(8, 14)


@pytest.fixture(scope="session")
def dictionary(tmp_path_factory: pytest.TempPathFactory) -> Dictionary:
    sizes = {"functions": 24, "prior": 40, "lights": 40, "lightfields": 64, "arriving": 24}
    return _shared(tmp_path_factory, "flat", lambda: build(SIDE, **sizes, grid=GRID, secondary=True))


@pytest.fixture(scope="session")
def spatial(tmp_path_factory: pytest.TempPathFactory) -> Dictionary:
    """For levels of several layers."""
    sizes = {"functions": 20, "prior": 32, "lights": 32, "lightfields": 64, "arriving": 24}
    return _shared(
        tmp_path_factory, "spatial", lambda: build(SIDE, **sizes, grid=Grid(6, 12), dimension=3, secondary=True)
    )


def _shared(folders: pytest.TempPathFactory, name: str, make: Callable[[], Dictionary]) -> Dictionary:
    """One of each for all workers of a run: what the first has built, the others read."""
    if "PYTEST_XDIST_WORKER" not in os.environ:
        return make()
    path = folders.getbasetemp().parent / f"{name}.safetensors"  # the folder of this run
    with path.with_suffix(".lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        return Dictionary.load(path if path.exists() else make().save(path))


@pytest.fixture(scope="session")
def any_dictionary() -> Dictionary:
    """Sizes all differ, so that none can stand for another."""
    random, n = np.random.default_rng(0), FACES * SIDE**2
    shapes = (
        (len(KINDS), n, 20),
        (len(KINDS), 20, n),
        (len(KINDS), n, 30),
        (len(DOORS), 14, 20),
        (2, 14, 14),
        (1, 14, 14),
        (12, 14),
        (n, 12),
    )
    return Dictionary(*(jnp.asarray(random.random(shape) / shape[-1], jnp.float32) for shape in shapes))


@pytest.fixture(scope="session")
def pipes() -> PipeDictionary:
    return build_pipes(16, functions=24, prior=32, lights=24, grid=Grid(6, 10), lightfields=48, arriving=24)
