"""Indirect light as the draw pass reads it: an asset with its three kernels, or a plain lightmap."""

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
from prt_bench.runtime.transfer import CHANNELS, TransferPass

if TYPE_CHECKING:
    from prt_bench.runtime.runtime import Runtime

_WORKGROUP = 64


class Indirect(ABC):
    """A texture and the kernel that turns it into irradiance. Draw passes are compiled on first use."""

    def __init__(self, runtime: "Runtime", columns: Float[np.ndarray, "T B"], kernel: shaders.Defines) -> None:
        if len(columns) != runtime.layout.receivers:
            raise AssetError(
                f"indirect light for {len(columns)} receivers does not fit this dataset, whose lightmap has"
                f" {runtime.layout.receivers}; load it with the dataset it was fitted on"
            )
        self.runtime = runtime
        self._kernel = kernel
        self.texture = runtime.layout.upload(columns)

    @abstractmethod
    def prepare(self, lights: UploadedLights) -> None:
        """Passes that come before drawing; shadow maps are there already."""

    def bind(self) -> None:
        """Bind what `reconstruct.glsl` reads."""
        self.texture.use(1)

    @property
    def bytes(self) -> int:
        """GPU memory in bytes."""
        return int(np.prod(self.texture.size)) * self.texture.components * int(self.texture.dtype[1])

    @cached_property
    def draw_pass(self) -> DrawPass:
        """Direct and indirect light."""
        return self.runtime.draw_pass({"DIRECT": 1, "INDIRECT": 1, **self._kernel})

    @cached_property
    def draw_pass_alone(self) -> DrawPass:
        """Indirect light alone."""
        return self.runtime.draw_pass({"INDIRECT": 1, **self._kernel})

    def receiver_values(self) -> Float[np.ndarray, "T 3"]:
        """Indirect irradiance at the receivers by the draw pass's own reconstruction, W/m²."""
        layout, context = self.runtime.layout, self.runtime.context
        texels = context.buffer(layout.texels.astype("<i4").tobytes())
        values = context.buffer(reserve=16 * layout.receivers)
        sizes = {"RECEIVERS": layout.receivers, "RESOLUTION": layout.resolution}
        program = shaders.compute(context, "reconstruct.comp", {**sizes, **self._kernel})
        self.bind()
        texels.bind_to_storage_buffer(6)
        values.bind_to_storage_buffer(7)
        program.run(-(-layout.receivers // _WORKGROUP))
        context.memory_barrier()
        check(context, "reconstructing")
        return np.frombuffer(values.read(), "<f4").reshape(-1, 4)[:, :3].copy()


class PlainLightmap(Indirect):
    """Irradiance stored per texel, in colour or grey: a reference, or a prediction made elsewhere."""

    def __init__(self, runtime: "Runtime", irradiance: Float[np.ndarray, "T C"]) -> None:
        colours = np.broadcast_to(irradiance, (len(irradiance), 3)).astype(np.float32)
        super().__init__(runtime, colours, {"RECONSTRUCT_LIGHTMAP": 1})

    def prepare(self, lights: UploadedLights) -> None:
        """Nothing: the light is in the texture."""


class LoadedAsset(Indirect):
    """An asset on the GPU: measure → transfer → reconstruct."""

    def __init__(self, runtime: "Runtime", asset: RuntimeAsset) -> None:
        kernels, basis = asset.kernels, asset.arrays["basis"]
        reconstruct = kernels["reconstruct"].removeprefix("gamma-")
        if kernels["measure"] != "direct" or reconstruct not in ("basis", "coupled", "select"):
            raise AssetError(f"{asset.path} has the kernels {kernels}, which this runtime lacks")
        if reconstruct == "coupled" and basis.shape[1] != CHANNELS:
            raise AssetError(f"{asset.path} couples {basis.shape[1]} channels; this runtime has {CHANNELS}")
        transfer_pass = TransferPass(runtime.context, asset, runtime.measurement)
        layers = -(-basis.shape[-1] // 4)
        if reconstruct == "coupled":
            basis = _channels_apart(basis, 4 * layers)
        defines = {f"RECONSTRUCT_{reconstruct.upper()}": 1, "LAYERS": layers, **transfer_pass.defines}
        super().__init__(runtime, basis, defines)
        self.asset = asset
        self.transfer_pass = transfer_pass
        check(runtime.context, f"loading {asset.path}")

    def prepare(self, lights: UploadedLights) -> None:
        """Measure, then transfer."""
        self.runtime.measurement.run(lights)
        self.transfer_pass.run()

    def bind(self) -> None:
        """Bind basis textures and coefficients."""
        super().bind()
        self.transfer_pass.coefficients.bind_to_uniform_block(0)

    @property
    def bytes(self) -> int:
        """GPU memory of basis textures (padded texels included), weights and coefficients."""
        return super().bytes + self.transfer_pass.bytes

    def transfer(self, x: Float[np.ndarray, "M 3"]) -> Float[np.ndarray, "B C"]:
        """Coefficients of a measured vector, by the transfer pass."""
        self.runtime.measurement.write(x)
        self.transfer_pass.run()
        check(self.runtime.context, "transferring")
        return self.transfer_pass.read()

    def predict(self, x: Float[np.ndarray, "M 3"]) -> Float[np.ndarray, "T 3"]:
        """Transfer and reconstruction at the receivers, for comparison with the model, W/m²."""
        self.transfer(x)
        return self.receiver_values()


def _channels_apart(basis: Float[np.ndarray, "T C B"], size: int) -> Float[np.ndarray, "T columns"]:
    """Each channel's functions side by side, padded to `size` with zeros so that every channel begins a layer."""
    return np.pad(basis, ((0, 0), (0, 0), (0, size - basis.shape[2]))).reshape(len(basis), -1)
