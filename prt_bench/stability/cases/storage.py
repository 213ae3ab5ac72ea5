"""Stored bases: quantisation keeps its analytic bound, and what does not fit is refused."""

import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np

from prt_bench.models import LinearModel
from prt_bench.stability import families
from prt_bench.stability.cell import Kind, Measured, Member, case
from prt_bench.stability.routes import F64, Route

_TEXELS, _BASIS, _POINTS = 200, 8, 6
_MIXED = np.geomspace(1.0, 1e-3, _BASIS)


def stores() -> dict[str, Any]:
    """What is written and read back, by dtype."""

    def stored(dtype: str) -> Any:
        def through(model: LinearModel) -> tuple[np.ndarray, float, float]:
            info = jnp.finfo(dtype)
            with tempfile.TemporaryDirectory() as folder:
                found = model.export(Path(folder) / "asset", dtype).arrays["basis"].astype(np.float64)
            return found, float(info.eps) / 2, float(info.smallest_subnormal)

        return through

    return {"float32": stored("float32"), "float16": stored("float16")}


def _bases(route: Route) -> Iterator[Member]:
    for seed in families.SEEDS:
        rng = np.random.default_rng(seed)
        plain = np.linalg.qr(rng.normal(size=(_TEXELS, _BASIS)))[0]
        weights = rng.normal(size=(1, _BASIS, _POINTS + 1))
        local = plain * (rng.random(plain.shape) < 0.05)
        for name, basis in {
            "orthonormal": plain, "ranges of three decades": plain * _MIXED, "sparse": local,
            "faint": plain * 1e-4, "dark": 0 * plain,
        }.items():  # fmt: skip
            yield Member(f"{name}, seed {seed}", LinearModel(jnp.asarray(route.arrive(basis)), jnp.asarray(weights)))


@case("B9", "quantised bases", subjects=stores, family=_bases)
def quantised(store: Any, model: LinearModel, route: Route) -> Iterator[Measured]:
    """B9: each number by half a unit in its last place, so that a small function is not lost beside a large one."""
    found, roundoff, least = store(model)
    basis = np.asarray(model.basis, np.float64)
    allowed = roundoff * np.abs(basis) + least / 2
    yield Measured(float(np.max(np.abs(found - basis) / allowed)), 1.0 + 1e-9)


def _too_large(route: Route) -> Iterator[Member]:
    plain = np.random.default_rng(0).normal(size=(_TEXELS, _BASIS))
    for name, value in (("NaN", np.nan), ("infinity", np.inf), ("1e300", 1e300)):
        basis = plain.copy()
        basis[3, 2] = value
        yield Member(name, LinearModel(jnp.asarray(basis), jnp.ones((1, _BASIS, _POINTS + 1))))


@case("B9", "weights that do not fit", kind=Kind.REFUSAL, subjects=stores, family=_too_large, routes=(F64,))
def overflowing(store: Any, model: LinearModel, route: Route) -> bool:
    """B9: refused with the name of the array, and nothing is written."""
    store(model)
    return False
