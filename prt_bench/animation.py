"""Models of a clip: one basis over all keyframes, and a transfer matrix for each of them.

One matrix for the whole clip needs nothing of its own: a `Clip` is a set of examples, which `svd-ridge` is fitted to as it
is. Belcour et al. 2022, §5, "Working with Animated Assets".
"""

import warnings
from collections.abc import Sequence
from dataclasses import fields, replace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from prt_bench.clip import Clip
from prt_bench.dataset import LightingDataset
from prt_bench.errors import FitError, SpecError
from prt_bench.linalg import leading_basis
from prt_bench.methods.base import Method
from prt_bench.methods.examples import normalised, training_light
from prt_bench.models import LinearModel


class KeyframeModel(eqx.Module):
    """u = W_k [x; ‖x‖], y = basis · u, with one orthonormal basis [T, B] and a matrix for each keyframe k.

    weights [keyframes, W, B, M + 1], W and the last column as in `LinearModel`. At run time the basis stays where it is and
    a matrix of a few thousand numbers is exchanged or blended per frame.
    """

    basis: Float[Array, "T B"]
    weights: Float[Array, "keyframes W B M1"]

    def at(self, blend: Sequence[float] | Float[np.ndarray, " keyframes"]) -> LinearModel:
        """The model of one pose: its matrix is Σ blend_k W_k. Raises `FitError` unless there is a weight per keyframe."""
        if len(blend) != len(self.weights):
            raise FitError(
                f"{len(blend)} blend weights were given for {len(self.weights)} keyframes; give one for each"
            )
        return LinearModel(self.basis, jnp.einsum("k,kwbm->wbm", jnp.asarray(blend), self.weights, precision="highest"))

    def keyframe(self, index: int) -> LinearModel:
        """The model of one keyframe."""
        return LinearModel(self.basis, self.weights[index])


def common_basis(clip: Clip, count: int) -> Float[Array, "T B"]:
    """The `count` leading left singular vectors of the normalised indirect light of all keyframes together."""
    examples = normalised(*training_light(clip))
    return leading_basis(examples.y, count, examples.floor)[0]


def fit_keyframes(method: Method, clip: Clip, key: jax.Array | None = None) -> KeyframeModel:
    """Fit a linear method to every keyframe of `clip` (its training split), on one basis of `method.basis` functions.

    Each keyframe is fitted with as many functions of its own as its lightings determine, and what that predicts is projected
    on the common basis. For `svd-ridge` without mean this *is* ridge regression of each keyframe's coefficients in the common
    basis; what `operator-ridge` knows of light that lies outside the span of the keyframe's lightings is lost.

    Raises `SpecError` for a method that has no basis size or whose model is not linear.
    """
    if "basis" not in [setting.name for setting in fields(method)]:
        raise SpecError(
            f"method '{method.name}' has no basis that keyframes could share; use svd-ridge or operator-ridge"
        )
    models = [_fit_in_full(method, ds, key) for ds in clip]
    basis = common_basis(clip, getattr(method, "basis"))  # noqa: B009
    return KeyframeModel(basis, jnp.stack([_on_basis(basis, model) for model in models]))


def hat_blend(
    time: float, times: Float[np.ndarray, " keyframes"], period: float = 1.0
) -> Float[np.ndarray, " keyframes"]:
    """Weights that interpolate linearly between the keyframes before and after `time`, in a motion of that period."""
    return np.array([np.interp(time, times, row, period=period) for row in np.eye(len(times))])


def _fit_in_full(method: Method, ds: LightingDataset, key: jax.Array | None) -> LinearModel:
    full = min(ds.measured.shape[0] * ds.indirect.shape[2], ds.indirect.shape[1])
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of missing rank: full rank is asked for wherever it is there
        model = replace(method, **{"basis": full}).fit(ds, key)
    if not isinstance(model, LinearModel):
        raise SpecError(f"method '{method.label}' does not fit a linear model, so keyframes cannot share its basis")
    return model


def _on_basis(basis: Float[Array, "T B"], model: LinearModel) -> Float[Array, "W B M1"]:
    """The model's matrix for its predictions' coefficients in another, orthonormal basis: Uᵀ (basis · W)."""
    change = jnp.matmul(basis.T, model.basis, precision="highest")
    return jnp.einsum("bo,wom->wbm", change, model.weights, precision="highest")
