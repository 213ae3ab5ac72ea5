"""A fit that reads light in blocks: the same model as in memory, no more of the light at once than it was allowed."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

import prt_bench as prt
from prt_bench.contract import example_dataset
from prt_bench.errors import FitError, SpecError
from prt_bench.methods.blocks import Blocks

DS = example_dataset(lightings=24, measurements=32)
TRAIN, TEST = DS.split("train"), DS.split("test")
SINGLE = SimpleNamespace(measured=TRAIN.measured, indirect=TRAIN.indirect.astype(np.float32))
WHOLE = 8 * TRAIN.indirect.size


def both(memory=WHOLE // 5, light=SINGLE, **settings):
    wide, narrow = (prt.method("svd-ridge", memory=size, **settings).fit(light) for size in (WHOLE, memory))
    return wide, narrow


@pytest.mark.parametrize(
    "settings",
    [
        {},
        {"mean": False},
        {"transfer": "per-channel"},
        {"transfer": "per-channel", "mean": False},
        {"transfer": "coupled"},
        {"gamma": 2.2},
        {"gamma": 2.2, "transfer": "coupled", "mean": False},
        {"normalise": "measured"},
        {"basis": 1},
    ],
)
def test_blocks_and_memory_fit_the_same(settings):
    wide, narrow = both(**{"basis": 12, **settings})
    expected = np.asarray(wide.predict(TEST))
    np.testing.assert_allclose(narrow.predict(TEST), expected, atol=1e-6 * np.abs(expected).max())
    assert narrow.basis.shape == wide.basis.shape
    largest = float(wide.singular_values[0]) if wide.singular_values.size else 1.0
    np.testing.assert_allclose(narrow.singular_values, wide.singular_values, atol=1e-6 * largest)


def test_the_basis_is_orthonormal_where_the_gram_matrix_alone_is_not():
    """B1: singular values over five decades."""
    rng = np.random.default_rng(0)
    left, right = (np.linalg.qr(rng.normal(size=(size, 30)))[0] for size in (400, 40))
    light = ((left * np.geomspace(1, 1e-5, 30)) @ right.T).T[:, :, None]
    ds = SimpleNamespace(measured=rng.uniform(1, 2, (40, 50, 1)), indirect=light.astype(np.float32))
    model = prt.method("svd-ridge", basis=20, mean=False, normalise="measured", memory=20_000).fit(ds)
    np.testing.assert_allclose(model.basis.T @ model.basis, np.eye(20), atol=1e-13)


def test_missing_rank_is_told_and_left_empty():
    """B2, B3: twelve lightings that are one."""
    lit = [int(np.argmax(SINGLE.measured.max(axis=(1, 2))))]
    light = SimpleNamespace(
        measured=np.repeat(SINGLE.measured[lit], 12, axis=0), indirect=np.repeat(SINGLE.indirect[lit], 12, axis=0)
    )
    with pytest.warns(UserWarning, match="rank"):
        wide, narrow = both(memory=2000, light=light, basis=8)
    np.testing.assert_array_equal(np.any(narrow.basis, axis=0), np.any(wide.basis, axis=0))
    expected = np.asarray(wide.predict(TEST))
    np.testing.assert_allclose(narrow.predict(TEST), expected, atol=1e-6 * np.abs(expected).max())


class Store:
    """An array on disk that remembers the largest piece asked of it."""

    def __init__(self, array):
        self.array, self.dtype, self.largest, self.read = array, array.dtype, 0, 0

    def __getitem__(self, key):
        piece = self.array[key]
        self.largest, self.read = max(self.largest, piece.nbytes), self.read + piece.nbytes
        return piece


@pytest.mark.parametrize("parts", [4, 16])
def test_light_on_disk_is_read_twice_and_never_as_a_whole(parts):
    store = Store(np.asarray(DS.arrays["indirect"][:], np.float32))
    ds = replace(DS, arrays={**DS.arrays, "indirect": store}).split("train")
    model = prt.method("svd-ridge", basis=12, memory=WHOLE // parts).fit(ds)
    assert store.largest <= WHOLE // parts // 8
    assert store.read == 2 * SINGLE.indirect.nbytes
    assert "indirect" not in vars(ds)
    expected = np.asarray(prt.method("svd-ridge", basis=12).fit(SINGLE).predict(TEST))
    np.testing.assert_allclose(model.predict(TEST), expected, atol=1e-6 * np.abs(expected).max())


def test_blocks_cover_every_receiver_once():
    blocks = Blocks.over(SINGLE, 64 * SINGLE.measured[:, 0].size * 5)
    assert blocks is not None
    assert 216 % blocks.step
    np.testing.assert_array_equal(np.concatenate([light for _, light in blocks], axis=1), SINGLE.indirect)
    vectors = np.concatenate([light for _, light in blocks.interleaved()], axis=1)
    np.testing.assert_array_equal(vectors[:, :, 0], SINGLE.indirect.reshape(len(vectors), -1))


def test_what_fits_or_comes_in_float64_stays_in_memory():
    assert Blocks.over(SINGLE, WHOLE) is None
    assert Blocks.over(SimpleNamespace(measured=TRAIN.measured, indirect=TRAIN.indirect.astype(float)), 1) is None


def test_damaged_light_and_impossible_memory_are_refused():
    damaged = SimpleNamespace(measured=SINGLE.measured, indirect=SINGLE.indirect.copy())
    damaged.indirect[3, 5, 0] = np.nan
    with pytest.raises(FitError, match="indirect light has values that are not finite"):
        prt.method("svd-ridge", memory=1000).fit(damaged)
    with pytest.raises(SpecError, match="'memory' must be a positive number of bytes"):
        prt.method("svd-ridge", memory=0)
