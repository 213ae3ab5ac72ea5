"""Dtype routes: the precision in which data arrive, and the one they are computed with."""

from dataclasses import dataclass
from typing import Any

import jax.numpy as jnp
import numpy as np


@dataclass(frozen=True)
class Route:
    """Data are rounded to `data` and handed over as `compute`. `eps` is the unit roundoff of the computation."""

    name: str
    data: Any
    compute: Any

    @property
    def eps(self) -> float:
        """Machine epsilon of the computation."""
        return float(jnp.finfo(self.compute).eps)

    @property
    def data_eps(self) -> float:
        """Machine epsilon of the data."""
        return float(jnp.finfo(self.data).eps)

    @property
    def gradient_tolerance(self) -> float:
        """How closely a gradient must match finite differences, relative to its size."""
        return 1e-6 if self.compute is np.float64 else 1e-4

    def arrive(self, array: Any) -> np.ndarray:
        """The array as it arrives. What is too large for the data's dtype arrives as infinity."""
        with np.errstate(over="ignore"):
            return np.asarray(array).astype(self.data).astype(self.compute)


F64 = Route("f64", np.float64, np.float64)
F32 = Route("f32", np.float32, np.float32)
F16 = Route("f32 from f16", np.float16, np.float32)
BF16 = Route("f32 from bf16", jnp.bfloat16, np.float32)
ROUTES = (F64, F32, F16, BF16)
