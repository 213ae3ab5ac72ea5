"""Every discovered method keeps the contract, on the cube room."""

import pytest

from prt_bench.contract import CHECKS, check_method, example_dataset
from prt_bench.methods import methods

DATASET = example_dataset()


@pytest.mark.parametrize("name", methods())
@pytest.mark.parametrize("check", CHECKS)
def test_contract(name, check):
    CHECKS[check](methods()[name](), DATASET)
