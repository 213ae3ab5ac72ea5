"""Gamma space: the curve, light over its own size along it, and the models that transfer light there.

Light is divided by its root mean square before the curve and multiplied by it after, so that whatever is fitted in gamma
space stays homogeneous of degree 1. What is fitted there is no concern of this module.
"""

from abc import abstractmethod
from typing import ClassVar

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from prt_bench.linalg import safe_norm
from prt_bench.models import CoupledModel, LinearModel, Model, interleaved

TOE = 1e-2
"""Where the curve turns from a straight line into a root, relative to the root mean square of the measured light.

A shorter toe is a steeper line: dark measurement points then count, and flicker, for more than what they cause.
"""


def curve(
    v: Float[Array, "*s"], gamma: float | Float[Array, ""], toe: float | Float[Array, ""] = TOE
) -> Float[Array, "*s"]:
    """2 hᵖ sinh(p asinh(v / 2h)) with p = 1 / γ and the toe h: sign(v) |v|ᵖ for |v| ≫ h, a straight line of slope p hᵖ⁻¹ at 0.

    Odd, increasing and smooth everywhere, unlike a signed power, whose slope at 0 is infinite; so are values and
    derivatives of its inverse, which is the same curve of 1/γ with the toe hᵖ.
    """
    return 2.0 * toe ** (1.0 / gamma) * jnp.sinh(jnp.arcsinh(v / (2.0 * toe)) / gamma)


def uncurve(
    w: Float[Array, "*s"], gamma: float | Float[Array, ""], toe: float | Float[Array, ""] = TOE
) -> Float[Array, "*s"]:
    """The inverse of `curve`: 2 h sinh(γ asinh(w / 2hᵖ))."""
    return curve(w, 1.0 / gamma, toe ** (1.0 / gamma))


def root_mean_square(x: Float[Array, "N M C"]) -> Float[Array, "N 1 C"]:
    """The size of each column of light, with gradient 0 at black."""
    return safe_norm(x, axis=1) / x.shape[1] ** 0.5


def over(light: Float[Array, "N P C"], size: Float[Array, "N 1 C"]) -> Float[Array, "N P C"]:
    """light / size, and 0 where the size is 0."""
    lit = size > 0
    return jnp.where(lit, light / jnp.where(lit, size, 1.0), 0.0)


class GammaModel(Model):
    """u = W [g; ‖g‖] with g = curve(x / s), and y = s · uncurve(basis · u), where s is the root mean square of x.

    The linear model in between (`inside`) has the same weights and works in gamma space; a mean that it scales is scaled by
    the norm of g. The last coefficient is s. `gamma` is γ and the toe of `curve`. Homogeneous of degree 1 in the light, and
    exactly 0 with gradient 0 at black; never additive.
    """

    basis: Float[Array, "..."]
    weights: Float[Array, "..."]
    gamma: Float[Array, " 2"]
    singular_values: Float[Array, " n"] | None = None

    @property
    @abstractmethod
    def inside(self) -> LinearModel | CoupledModel:
        """The model that maps gamma-corrected to gamma-corrected light."""

    @abstractmethod
    def size(self, x: Float[Array, "N M C"]) -> Float[Array, "N 1 C"] | Float[Array, "N 1 1"]:
        """s: the root mean square of what shares a set of coefficients."""

    def transfer(self, x: Float[Array, "N M C"]) -> Float[Array, "N B1 C"]:
        """The coefficients in gamma space, and s in the last row."""
        size = self.size(x)
        u = self.inside.transfer(curve(over(x, size), self.gamma[0], self.gamma[1]))
        return jnp.concatenate([u, size], axis=1)

    def reconstruct(self, u: Float[Array, "N B1 C"]) -> Float[Array, "N T C"]:
        """s · uncurve(basis · u)."""
        return u[:, -1:] * uncurve(self.inside.reconstruct(u[:, :-1]), self.gamma[0], self.gamma[1])

    def arrays(self) -> dict[str, Float[np.ndarray, "..."]]:
        """basis, weights and gamma."""
        return {**self.inside.arrays(), "gamma": np.asarray(self.gamma)}

    @property
    def spectrum(self) -> Float[Array, " n"] | None:
        """Singular values of the training light in gamma space."""
        return self.singular_values


class GammaLinearModel(GammaModel):
    """`LinearModel` in gamma space: each channel by itself."""

    kernels: ClassVar[dict[str, str]] = {"measure": "direct", "transfer": "gamma-linear", "reconstruct": "gamma-basis"}

    @property
    def inside(self) -> LinearModel:
        """basis [T, B], weights [W, B, M + 1]."""
        return LinearModel(self.basis, self.weights)

    def size(self, x: Float[Array, "N M C"]) -> Float[Array, "N 1 C"]:
        """Over the points, of each channel."""
        return root_mean_square(x)


class GammaCoupledModel(GammaModel):
    """`CoupledModel` in gamma space: all channels together."""

    kernels: ClassVar[dict[str, str]] = {
        "measure": "direct",
        "transfer": "gamma-coupled",
        "reconstruct": "gamma-coupled",
    }

    @property
    def inside(self) -> CoupledModel:
        """basis [T, C, B], weights [B, M·C + 1]."""
        return CoupledModel(self.basis, self.weights)

    def size(self, x: Float[Array, "N M C"]) -> Float[Array, "N 1 1"]:
        """Over points and channels."""
        return root_mean_square(interleaved(x))


def in_gamma_space(model: LinearModel | CoupledModel, gamma: float) -> GammaModel:
    """The model that was fitted to gamma-corrected light, as a model of light."""
    wrapped = GammaLinearModel if isinstance(model, LinearModel) else GammaCoupledModel
    return wrapped(model.basis, model.weights, jnp.array([gamma, TOE]), model.singular_values)
