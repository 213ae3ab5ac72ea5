"""Oracle: the reference itself, projected on the basis of `svd-ridge`. What a perfect transfer would achieve."""

from dataclasses import dataclass
from typing import ClassVar

import jax

from prt_bench.linalg import orthonormal
from prt_bench.methods.base import Method
from prt_bench.methods.examples import training_light
from prt_bench.methods.linear import warn_of_rank
from prt_bench.methods.svd_ridge import SvdRidge, fit_svd_ridge
from prt_bench.models import Observed, ProjectionModel


@dataclass(frozen=True)
class Projection(Method):
    """Best approximation of the answer in the span of `svd-ridge` with the same `basis` and `mean`."""

    name: ClassVar[str] = "projection"
    summary: ClassVar[str] = "oracle: the reference projected on the basis of svd-ridge"
    citation: ClassVar[str] = "belcour2022datadriven, fig. 14"
    role: ClassVar[str] = "ceiling"

    basis: int = 16
    mean: bool = True

    def __post_init__(self) -> None:
        self.require(self.basis >= 1, "basis", "at least 1")

    def fit(self, ds: Observed, key: jax.Array | None = None) -> ProjectionModel:
        """Orthonormalise the basis that `svd-ridge` would fit."""
        model = fit_svd_ridge(*training_light(ds), SvdRidge.ridge, self.basis, self.mean)
        warn_of_rank(self.label, model)
        return ProjectionModel(orthonormal(model.basis), model.singular_values)
