"""Counts of a frame's work against counts by hand."""

import jax
import numpy as np

from prt_bench.assets import write_asset
from prt_bench.learned.cost import cost_of
from prt_bench.learned.fields import LEVELS, Field, FieldModel
from prt_bench.learned.models import ResidualModel
from prt_bench.learned.networks import Network
from prt_bench.models import LinearModel

MEASURED, TEXELS, FUNCTIONS = 10, 7, 6


def linear(channels):
    rng = np.random.default_rng(0)
    return LinearModel(rng.normal(size=(TEXELS, FUNCTIONS)), rng.normal(size=(channels, FUNCTIONS, MEASURED + 1)))


def test_a_texture(tmp_path):
    for channels in (1, 3):
        found = cost_of(write_asset(linear(channels), tmp_path / str(channels)))
        assert found.transfer_operations == 3 * FUNCTIONS * (MEASURED + 1)
        assert found.transfer_bytes == 4 * channels * FUNCTIONS * (MEASURED + 1)
        assert found.fragment_operations == 3 * FUNCTIONS
        assert found.fragment_bytes == 4 * 8 * 4, "two layers of four channels, four texels of each"


def test_a_residual_network(tmp_path):
    network = Network.random(jax.random.key(0), [MEASURED, 4, 5])
    model = ResidualModel(linear(3), network, np.ones((3, FUNCTIONS, 5)))
    plain, found = (cost_of(write_asset(each, tmp_path / "asset")) for each in (linear(3), model))
    products = MEASURED * 4 + 4 * 5 + 4 + 5 + FUNCTIONS * 5
    assert found.transfer_operations - plain.transfer_operations == 3 * products
    assert found.transfer_bytes - plain.transfer_bytes == 4 * (products + 2 * FUNCTIONS * 5)
    assert found[2:] == plain[2:]
    narrow = cost_of(write_asset(model, tmp_path / "half", "float16"))
    assert narrow.fragment_bytes == found.fragment_bytes // 2


def test_a_field(tmp_path):
    box = np.array([0.0, 0, 0, 1])
    for encoding, inputs, nodes in (("frequency", 30, 0), ("grid", 12, 16 * len(LEVELS))):
        field = Field.random(jax.random.key(0), encoding, box, 5, 2, FUNCTIONS)
        model = FieldModel(field, linear(3).weights, np.zeros((TEXELS, 3)), np.ones((TEXELS, 3)))
        found = cost_of(write_asset(model, tmp_path / encoding))
        products = inputs * 5 + 5 * 5 + 5 + 5 + FUNCTIONS * 5
        assert found.fragment_operations == products + nodes + 3 * FUNCTIONS
        assert found.fragment_bytes == 4 * (products + nodes)
