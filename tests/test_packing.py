"""Sparse 16-bit storage: what comes back, what it takes, and which entries are worth keeping."""

import numpy as np
import pytest

from prt_bench.errors import AssetError
from prt_bench.packing import packed, threshold

MATRIX = np.random.default_rng(0).normal(size=(40, 7)) * 10.0 ** np.arange(-3, 4)


def test_a_kept_entry_is_off_by_half_a_step_of_its_column():
    found = packed(MATRIX).unpacked()
    step = np.abs(MATRIX).max(axis=0) / 32767
    assert np.all(np.abs(found - MATRIX) <= 0.5001 * step)
    assert packed(MATRIX).bytes == 40 * 7 // 8 + 2 * 40 * 7 + 4 * 7


def test_dropped_entries_are_those_whose_weighted_size_is_least():
    weight = 10.0 ** np.arange(3, -4, -1)
    least = threshold(0.25, np.abs(MATRIX) * weight)
    small = packed(MATRIX, least, weight)
    found = small.unpacked()
    kept = found != 0
    assert kept.sum() == len(small.values) == 70
    sizes = np.abs(MATRIX) * weight
    assert sizes[kept].min() > sizes[~kept].max()
    assert kept.any(axis=0).all()  # without weights the last column alone would stay
    np.testing.assert_allclose(found[kept], MATRIX[kept], rtol=1e-3)
    assert small.bytes == 40 * 7 // 8 + 2 * 70 + 4 * 7


def test_one_threshold_serves_several_arrays():
    parts = np.arange(10.0)[:, None], np.arange(100.0, 130.0)[:, None]
    least = threshold(0.5, *parts)
    assert [int((part >= least).sum()) for part in parts] == [0, 20]
    assert threshold(1.0, *parts) == 0.0


def test_what_cannot_be_packed_is_refused():
    assert not packed(np.zeros((3, 2))).unpacked().any()
    with pytest.raises(AssetError, match="not finite"):
        packed(np.array([[1.0, np.inf]]))
    for share in (0.0, 1.5):
        with pytest.raises(AssetError, match="above 0 and up to 1"):
            threshold(share, MATRIX)
