"""Ceiling: the path-traced light itself, from half of the rays. Its error is the noise floor of the data."""

from dataclasses import dataclass
from typing import ClassVar

import jax

from prt_bench.methods.base import Method
from prt_bench.models import Observed, ReferenceModel


@dataclass(frozen=True)
class Reference(Method):
    """The first half of the rays predicts all of them; no method can be told from a perfect one below this error."""

    name: ClassVar[str] = "reference"
    summary: ClassVar[str] = "oracle: traced light from half of the rays; its error is the noise floor"
    citation: ClassVar[str] = "split halves"
    role: ClassVar[str] = "ceiling"

    def fit(self, ds: Observed, key: jax.Array | None = None) -> ReferenceModel:
        """Nothing to fit."""
        return ReferenceModel()
