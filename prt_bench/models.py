"""Fitted models: the three stages measure → transfer → reconstruct as JAX pytrees.

Models are what an asset holds and the runtime runs, whatever method fitted them; a method only chooses their weights.
"""

from abc import abstractmethod
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, ClassVar, Protocol, Self

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from prt_bench.errors import FitError
from prt_bench.lights import Lighting
from prt_bench.linalg import safe_norm

if TYPE_CHECKING:
    from prt_bench.assets import RuntimeAsset


class Observed(Protocol):
    """What a model may look at: any object with these arrays, a `LightingDataset` above all. They may be traced."""

    measured: Float[np.ndarray, "N M C"]
    indirect: Float[np.ndarray, "N T C"]
    indirect_half: Float[np.ndarray, "N T C"]
    lightings: tuple[Lighting, ...]


class Model(eqx.Module):
    """A fitted model. Every stage is differentiable and can be jitted and vmapped over its arrays."""

    kernels: ClassVar[dict[str, str]]
    """Names of the runtime kernels of the three stages; empty for models that cannot run in real time.

    With "direct": "included" a prediction holds the direct light too, and the runtime adds none.
    """
    narrow: ClassVar[tuple[str, ...]] = ("basis",)
    """Beginnings of the names of arrays that an asset stores in its own dtype; all others stay float32."""
    compared: ClassVar[tuple[str, ...]] = ()
    """Names of arrays that an asset holds for comparison with the reference alone, and whose bytes do not count."""

    @property
    def includes_direct(self) -> bool:
        """Whether predictions hold the direct light too."""
        return self.kernels.get("direct") == "included"

    def __hash__(self) -> int:
        """By identity, so that `jax.jit(model.transfer)` takes a stage as it is (Equinox modules hash by content)."""
        return id(self)

    def measure(self, ds: Observed) -> Float[Array, "N M C"]:
        """What is observed of the light at run time: direct irradiance at the measurement points, W/m²."""
        return jnp.asarray(ds.measured)

    @abstractmethod
    def transfer(self, x: Float[Array, "N M C"]) -> Float[Array, "N B C"]:
        """Coefficients from the observation: a set for each channel, or one [N, B, 1] for all."""

    @abstractmethod
    def reconstruct(self, u: Float[Array, "N B C"]) -> Float[Array, "N T C"]:
        """Indirect irradiance at the receivers from the coefficients, W/m²; all of it where the kernels include the direct."""

    def predict(self, ds: Observed) -> Float[Array, "N T C"]:
        """All three stages."""
        return self.reconstruct(self.transfer(self.measure(ds)))

    @abstractmethod
    def arrays(self) -> dict[str, Float[np.ndarray, "..."]]:
        """The weights by name, as an asset stores them."""

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, Float[Array, "..."]]) -> Self:
        """The model of weights by name: the inverse of `arrays`."""
        return cls(**arrays)

    @property
    def span(self) -> Float[Array, "T B"] | Float[Array, "TC B"] | None:
        """Columns whose span holds every channel of a prediction, or all of them interleaved; None where there are none.

        For the projection error.
        """
        return None

    @property
    def spectrum(self) -> Float[Array, " n"] | None:
        """Singular values of the light it was fitted to, descending; None when none were computed. They are not shipped."""
        return None

    @property
    def history(self) -> dict[str, Float[np.ndarray, " k"]]:
        """Curves of the training that found the weights; none where they were fitted in closed form. They are not shipped."""
        return {}

    def export(self, path: str | Path, dtype: str = "float32") -> "RuntimeAsset":
        """Write the weights as a runtime asset, the basis in `dtype` ("float32" or "float16"), and return it loaded back."""
        from prt_bench.assets import write_asset

        return write_asset(self, Path(path), dtype)


class LinearModel(Model):
    """u = W [x; ‖x‖], y = basis · u: every linear method with or without a mean scaled by the norm.

    basis [T, B]; weights [W, B, M + 1] with W = 1 (one matrix for all channels) or C (one each); the last column multiplies
    the Euclidean norm of the measured vector, taken per channel. Homogeneous of degree 1 in the light.
    """

    kernels: ClassVar[dict[str, str]] = {"measure": "direct", "transfer": "linear", "reconstruct": "basis"}

    basis: Float[Array, "T B"]
    weights: Float[Array, "W B M1"]
    singular_values: Float[Array, " n"] | None = None

    def transfer(self, x: Float[Array, "N M C"]) -> Float[Array, "N B C"]:
        """W [x; ‖x‖] per channel."""
        augmented = jnp.concatenate([x, safe_norm(x, axis=1)], axis=1)
        if self.weights.shape[0] == 1:
            return jnp.einsum("bm,nmc->nbc", self.weights[0], augmented, precision="highest")
        if self.weights.shape[0] != x.shape[2]:
            raise FitError(
                f"the model has a transfer matrix for each of {self.weights.shape[0]} channels, but the light has "
                f"{x.shape[2]}; fit it on a dataset with the same channels"
            )
        return jnp.einsum("cbm,nmc->nbc", self.weights, augmented, precision="highest")

    def reconstruct(self, u: Float[Array, "N B C"]) -> Float[Array, "N T C"]:
        """basis · u."""
        return jnp.einsum("tb,nbc->ntc", self.basis, u, precision="highest")

    def arrays(self) -> dict[str, Float[np.ndarray, "..."]]:
        """basis and weights."""
        return {"basis": np.asarray(self.basis), "weights": np.asarray(self.weights)}

    @property
    def span(self) -> Float[Array, "T B"]:
        """The basis itself."""
        return self.basis

    @property
    def spectrum(self) -> Float[Array, " n"] | None:
        """Singular values of the training light."""
        return self.singular_values


class CoupledModel(Model):
    """u = W [x; ‖x‖], y = basis · u on vectors that interleave all colour channels: one set of coefficients for all of them.

    basis [T, C, B]; weights [B, M·C + 1], whose columns run over the points with the channel fastest; the last multiplies
    the norm over points and channels. Homogeneous of degree 1 in the light. Unlike `LinearModel` it knows the colours of
    the lights that it was fitted to, and those alone.
    """

    kernels: ClassVar[dict[str, str]] = {"measure": "direct", "transfer": "coupled", "reconstruct": "coupled"}

    basis: Float[Array, "T C B"]
    weights: Float[Array, "B MC1"]
    singular_values: Float[Array, " n"] | None = None

    @classmethod
    def of(cls, joined: LinearModel, channels: int) -> "CoupledModel":
        """From a model of one matrix that was fitted to `interleaved` light."""
        size = joined.basis.shape[1]
        return cls(joined.basis.reshape(-1, channels, size), joined.weights[0], joined.singular_values)

    def transfer(self, x: Float[Array, "N M C"]) -> Float[Array, "N B 1"]:
        """W [x; ‖x‖] of all channels together. Raises `FitError` for another number of channels than was fitted."""
        channels = self.basis.shape[1]
        if x.shape[2] != channels:
            raise FitError(
                f"the model couples {channels} channels, but the light has {x.shape[2]};"
                " fit it on a dataset with the same channels"
            )
        return LinearModel(self.basis[:, 0], self.weights[None]).transfer(interleaved(x))

    def reconstruct(self, u: Float[Array, "N B 1"]) -> Float[Array, "N T C"]:
        """basis · u."""
        return jnp.einsum("tcb,nbo->ntc", self.basis, u, precision="highest")

    def arrays(self) -> dict[str, Float[np.ndarray, "..."]]:
        """basis and weights."""
        return {"basis": np.asarray(self.basis), "weights": np.asarray(self.weights)}

    @property
    def span(self) -> Float[Array, "TC B"]:
        """The basis over points and channels, the channel fastest."""
        return self.basis.reshape(-1, self.basis.shape[2])

    @property
    def spectrum(self) -> Float[Array, " n"] | None:
        """Singular values of the training light."""
        return self.singular_values


def interleaved(light: Float[Array, "N P C"]) -> Float[Array, "N PC 1"]:
    """All channels of a lighting as one vector, the channel fastest."""
    return light.reshape(len(light), -1, 1)


class NearestModel(Model):
    """The closest training lighting by direction of the measured vector, scaled by its norm; each channel chooses its own.

    basis [T, B]: indirect light of the B training columns over the norm of their measured vectors;
    directions [B, M]: those vectors, normalised. The choice is piecewise constant, so its gradient comes from the norm alone.
    """

    kernels: ClassVar[dict[str, str]] = {"measure": "direct", "transfer": "nearest", "reconstruct": "select"}

    basis: Float[Array, "T B"]
    directions: Float[Array, "B M"]

    def transfer(self, x: Float[Array, "N M C"]) -> Float[Array, "N B C"]:
        """‖x‖ at the chosen column, 0 elsewhere."""
        score = jnp.einsum("bm,nmc->nbc", self.directions, x, precision="highest")
        choice = jnp.argmax(score, axis=1)
        one_hot = jnp.moveaxis(jnp.arange(self.directions.shape[0]) == choice[..., None], -1, 1)
        return one_hot * safe_norm(x, axis=1)

    def reconstruct(self, u: Float[Array, "N B C"]) -> Float[Array, "N T C"]:
        """The chosen columns, scaled."""
        return jnp.einsum("tb,nbc->ntc", self.basis, u, precision="highest")

    def arrays(self) -> dict[str, Float[np.ndarray, "..."]]:
        """basis and directions."""
        return {"basis": np.asarray(self.basis), "directions": np.asarray(self.directions)}


class ProjectionModel(Model):
    """Oracle: observes the answer and projects it on an orthonormal basis [T, B]."""

    kernels: ClassVar[dict[str, str]] = {}

    basis: Float[Array, "T B"]
    singular_values: Float[Array, " n"] | None = None

    def measure(self, ds: Observed) -> Float[Array, "N T C"]:
        """The indirect light itself."""
        return jnp.asarray(ds.indirect)

    def transfer(self, x: Float[Array, "N T C"]) -> Float[Array, "N B C"]:
        """basisᵀ x."""
        return jnp.einsum("tb,ntc->nbc", self.basis, x, precision="highest")

    def reconstruct(self, u: Float[Array, "N B C"]) -> Float[Array, "N T C"]:
        """basis · u."""
        return jnp.einsum("tb,nbc->ntc", self.basis, u, precision="highest")

    def arrays(self) -> dict[str, Float[np.ndarray, "..."]]:
        """The basis."""
        return {"basis": np.asarray(self.basis)}

    @property
    def span(self) -> Float[Array, "T B"]:
        """The basis itself."""
        return self.basis

    @property
    def spectrum(self) -> Float[Array, " n"] | None:
        """Singular values of the training light."""
        return self.singular_values


class ReferenceModel(Model):
    """Oracle: observes the answer from half of the rays and returns it."""

    kernels: ClassVar[dict[str, str]] = {}

    def measure(self, ds: Observed) -> Float[Array, "N T C"]:
        """Indirect light from the first half of the rays."""
        return jnp.asarray(ds.indirect_half)

    def transfer(self, x: Float[Array, "N T C"]) -> Float[Array, "N T C"]:
        """Identity."""
        return x

    def reconstruct(self, u: Float[Array, "N T C"]) -> Float[Array, "N T C"]:
        """Identity."""
        return u

    def arrays(self) -> dict[str, Float[np.ndarray, "..."]]:
        """No weights."""
        return {}
