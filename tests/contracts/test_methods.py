"""Every discovered method keeps the contract, on the cube room; and the contract notices a method that breaks it."""

from dataclasses import dataclass
from typing import ClassVar

import jax.numpy as jnp
import pytest

from prt_bench.contract import CHECKS, check, example_dataset
from prt_bench.methods import methods
from prt_bench.methods.base import Method
from prt_bench.models import LinearModel

DATASET = example_dataset(walls=5)


@pytest.mark.parametrize("name", methods())
@pytest.mark.parametrize("holds", CHECKS)
def test_contract(name, holds):
    CHECKS[holds](methods()[name](), DATASET)


class ShiftedModel(LinearModel):
    """Adds a constant: neither homogeneous nor black for black light."""

    def transfer(self, x):
        return super().transfer(x) + 1.0


class RootModel(LinearModel):
    """Takes a root whose slope at zero is infinite."""

    def transfer(self, x):
        return jnp.sqrt(jnp.abs(super().transfer(x)))


class OrderedModel(LinearModel):
    """Mixes the channels."""

    def transfer(self, x):
        return super().transfer(x) * x.shape[2]


@dataclass(frozen=True)
class Wrong(Method):
    name: ClassVar[str] = "wrong"
    summary: ClassVar[str] = "breaks the contract"
    citation: ClassVar[str] = "none"

    model: type[LinearModel] = LinearModel
    first_only: bool = False

    def fit(self, ds, key=None):
        light = jnp.asarray(ds.indirect, jnp.float64)
        indirect = light[0] if self.first_only else jnp.sum(light, axis=0)
        measured = ds.measured.shape[1]
        return self.model(jnp.sum(indirect, axis=1, keepdims=True), jnp.ones((1, 1, measured + 1)))


@pytest.mark.parametrize(
    ("method", "broken"),
    [
        (Wrong(model=ShiftedModel), {"homogeneous", "black"}),
        (Wrong(model=RootModel), {"homogeneous", "gradients"}),
        (Wrong(model=OrderedModel), {"one channel"}),
        (Wrong(first_only=True), {"permutation"}),
    ],
)
def test_contract_notices(method, broken):
    failed = {finding.name for finding in check(method, DATASET) if not finding.passed}
    assert broken <= failed


def test_a_sound_method_passes_every_check():
    assert [finding for finding in check(Wrong(), DATASET) if not finding.passed] == []
