"""Regressions with certified answers: the linear sets of the NIST Statistical Reference Datasets that are hard.

Data and certified coefficients are in `nist.json`, with their source.
"""

import json
from functools import cache
from importlib.resources import files
from typing import NamedTuple

import numpy as np
from jaxtyping import Float


class Regression(NamedTuple):
    """Design [parameters, observations] with a row of ones first, response [1, observations], certified [parameters]."""

    design: Float[np.ndarray, "M n"]
    response: Float[np.ndarray, "1 n"]
    certified: Float[np.ndarray, " M"]


@cache
def regressions() -> dict[str, Regression]:
    """Longley, Wampler1 to 5 and Filip by name."""
    sets = json.loads(files("prt_bench.stability").joinpath("nist.json").read_text(encoding="utf-8"))["sets"]
    return {name: _regression(**entry) for name, entry in sets.items()}


def _regression(predictors: list, response: list, certified: list, degree: int | None = None) -> Regression:
    x = np.asarray(predictors, np.float64)
    design = x.T if degree is None else x ** np.arange(1, degree + 1)[:, None]
    return Regression(np.vstack([np.ones(len(x)), design]), np.asarray(response)[None], np.asarray(certified))
