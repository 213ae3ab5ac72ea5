"""Indirect light as the draw pass reads it: a kernel with what it reads, from an asset or a plain lightmap."""

from abc import ABC, abstractmethod
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float

from prt_bench.assets import RuntimeAsset
from prt_bench.errors import AssetError
from prt_bench.runtime import shaders
from prt_bench.runtime.context import check
from prt_bench.runtime.draw import DrawPass
from prt_bench.runtime.lights import UploadedLights
from prt_bench.runtime.transfer import CHANNELS

if TYPE_CHECKING:
    from prt_bench.runtime.runtime import Runtime

_WORKGROUP = 64


class Indirect(ABC):
    """Light that the draw pass adds, by the kernel of `reconstruct.glsl` that `defines` compile in."""

    needs_shadows = True
    """Whether any pass looks up shadow maps."""
    includes_direct = False
    """Whether it replaces the direct light of the runtime."""

    def __init__(self, runtime: "Runtime", kernel: shaders.Defines) -> None:
        self.runtime = runtime
        self._kernel = kernel

    @property
    def defines(self) -> shaders.Defines:
        """What compiles the kernel in."""
        return self._kernel

    @abstractmethod
    def prepare(self, lights: UploadedLights) -> None:
        """Passes that come before drawing; shadow maps are there already."""

    @abstractmethod
    def bind(self) -> None:
        """Bind what `reconstruct.glsl` reads."""

    @property
    @abstractmethod
    def bytes(self) -> int:
        """GPU memory in bytes."""

    @cached_property
    def draw_pass(self) -> DrawPass:
        """Direct and indirect light; compiled on first use."""
        return self.runtime.draw_pass({"DIRECT": 1, **self._drawn})

    @cached_property
    def draw_pass_alone(self) -> DrawPass:
        """Indirect light alone."""
        return self.runtime.draw_pass(self._drawn)

    @property
    def _drawn(self) -> shaders.Defines:
        return {"INDIRECT": 1, **self._kernel, **({"MIPS": 1} if self.runtime.layout.mips else {})}


class BasisTexture:
    """Values at the receivers as a texture array, and the draw pass's own reconstruction from it at the receivers."""

    def __init__(self, runtime: "Runtime", columns: Float[np.ndarray, "T B"]) -> None:
        if len(columns) != runtime.layout.receivers:
            raise AssetError(
                f"indirect light for {len(columns)} receivers does not fit this dataset, whose lightmap has"
                f" {runtime.layout.receivers}; load it with the dataset it was fitted on"
            )
        self._runtime = runtime
        self.texture = runtime.layout.upload(columns)

    def bind(self) -> None:
        """Bind it where `reconstruct.glsl` reads."""
        self.texture.use(1)

    @property
    def bytes(self) -> int:
        """GPU memory in bytes, padded texels and halved images included."""
        texels = sum(4.0**-level for level in range(self._runtime.layout.mips + 1)) * np.prod(self.texture.size)
        return int(texels) * self.texture.components * int(self.texture.dtype[1])

    def receiver_values(self, source: Indirect, kernel: shaders.Defines) -> Float[np.ndarray, "T 3"]:
        """What `source` shows at the receivers with the coefficients it has now, W/m²."""
        layout, context = self._runtime.layout, self._runtime.context
        texels = context.buffer(layout.texels.astype("<i4").tobytes())
        values = context.buffer(reserve=16 * layout.receivers)
        sizes = {"RECEIVERS": layout.receivers, "RESOLUTION": layout.resolution}
        program = shaders.compute(context, "reconstruct.comp", {**sizes, **kernel})
        source.bind()
        texels.bind_to_storage_buffer(6)
        values.bind_to_storage_buffer(7)
        program.run(-(-layout.receivers // _WORKGROUP))
        context.memory_barrier()
        check(context, "reconstructing")
        return np.frombuffer(values.read(), "<f4").reshape(-1, 4)[:, :3].copy()


class PlainLightmap(Indirect):
    """Irradiance stored per texel, in colour or grey: a reference, or a prediction made elsewhere."""

    def __init__(self, runtime: "Runtime", irradiance: Float[np.ndarray, "T C"]) -> None:
        super().__init__(runtime, {"RECONSTRUCT_LIGHTMAP": 1})
        colours = np.broadcast_to(irradiance, (len(irradiance), CHANNELS)).astype(np.float32)
        self._basis = BasisTexture(runtime, colours)

    def prepare(self, lights: UploadedLights) -> None:
        """Nothing: the light is in the texture."""

    def bind(self) -> None:
        """Bind the texture."""
        self._basis.bind()

    @property
    def bytes(self) -> int:
        """GPU memory of the texture."""
        return self._basis.bytes

    def receiver_values(self) -> Float[np.ndarray, "T 3"]:
        """The irradiance read back."""
        return self._basis.receiver_values(self, self._kernel)


class LoadedAsset(Indirect):
    """An asset on the GPU: measure → transfer → reconstruct."""

    def __init__(self, runtime: "Runtime", asset: RuntimeAsset, kernel: shaders.Defines) -> None:
        super().__init__(runtime, kernel)
        self.asset = asset
        self.includes_direct = asset.includes_direct

    @staticmethod
    @abstractmethod
    def runs(asset: RuntimeAsset) -> bool:
        """Whether this class has the kernels of `asset`."""

    def prepare(self, lights: UploadedLights) -> None:
        """Measure, then transfer."""
        self.measure(lights)
        self.transfer()

    @abstractmethod
    def measure(self, lights: UploadedLights) -> None:
        """The first stage, of lights whose shadow maps are drawn where it needs them."""

    @abstractmethod
    def transfer(self) -> None:
        """The second stage, of what was measured last."""

    @abstractmethod
    def measured(self) -> Float[np.ndarray, "M 3"]:
        """What was measured last, as the model's `measure` gives it."""

    @abstractmethod
    def coefficients_of(self, x: Float[np.ndarray, "M 3"]) -> Float[np.ndarray, "B C"]:
        """Coefficients of a given observation, as the model's `transfer` gives them."""

    @abstractmethod
    def predict(self, x: Float[np.ndarray, "M 3"]) -> Float[np.ndarray, "T 3"]:
        """Transfer and reconstruction at the receivers of a given observation, for comparison with the model, W/m²."""


def channels_apart(basis: Float[np.ndarray, "T C B"], size: int) -> Float[np.ndarray, "T columns"]:
    """Each channel's functions side by side, padded to `size` with zeros so that every channel begins a layer."""
    return np.pad(basis, ((0, 0), (0, 0), (0, size - basis.shape[2]))).reshape(len(basis), -1)
