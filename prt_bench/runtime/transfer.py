"""Transfer pass: a few coefficients from the measured vector, by the kernel an asset names."""

import moderngl
import numpy as np
from jaxtyping import Float

from prt_bench.assets import RuntimeAsset
from prt_bench.errors import AssetError
from prt_bench.runtime import shaders
from prt_bench.runtime.measure import MeasurePass
from prt_bench.runtime.network import NetworkPass

_LINEAR_WORKGROUP = 64
_NEAREST_WORKGROUP = 256
CHANNELS = 3
"""Every light of the runtime has three."""


class TransferPass:
    """One asset's transfer. `coefficients` holds the `slots` vectors that `reconstruct.glsl` reads: B of them padded to
    a multiple of four (and one for the size of the light in gamma space), or norm and choice. `defines` are what the two
    shaders must agree on."""

    def __init__(self, context: moderngl.Context, asset: RuntimeAsset, measure: MeasurePass) -> None:
        self._context, self._measure = context, measure
        self.kernel = asset.kernels["transfer"].removeprefix("gamma-")
        stored = "weights" if "weights" in asset.arrays else "basis"
        self.basis = asset.arrays[stored].shape[-1 if stored == "basis" else -2]
        gamma = asset.arrays.get("gamma")
        if self.kernel in ("linear", "coupled", "residual"):
            weights = asset.arrays["weights"]
            file, workgroup, self._workgroups = "linear.comp", _LINEAR_WORKGROUP, self.basis
            self.slots = 4 * -(-self.basis // 4) + (gamma is not None)
            coupled = self.kernel == "coupled"
            measurements = (weights.shape[-1] - 1) // (CHANNELS if coupled else 1)
            extra = {"COUPLED": 1} if coupled else {"WEIGHT_CHANNELS": weights.shape[0]}
        elif self.kernel == "nearest":
            weights = asset.arrays["directions"]
            file, workgroup, self._workgroups = "nearest.comp", _NEAREST_WORKGROUP, 1
            self.slots = 2
            measurements, extra = weights.shape[1], {}
        else:
            raise AssetError(f"{asset.path} needs the transfer kernel '{self.kernel}', which this runtime lacks")
        self.defines: dict[str, int | str] = {"COEFFICIENTS": self.slots}
        if gamma is not None:
            self.defines |= {"GAMMA": f"{gamma[0]:.9e}", "TOE": f"{gamma[1]:.9e}"}
        if measurements != measure.count:
            raise AssetError(
                f"{asset.path} expects {measurements} measurement points, but the dataset has {measure.count};"
                " load it with the dataset it was fitted on"
            )
        most = context.info["GL_MAX_UNIFORM_BLOCK_SIZE"] // 16
        if self.slots > most:
            raise AssetError(
                f"{asset.path} has {self.basis} basis functions; this GPU passes at most {most} coefficients"
            )
        self._weights = context.buffer(np.ascontiguousarray(weights, "<f4").tobytes())
        self.coefficients = context.buffer(reserve=16 * self.slots)
        self.coefficients.clear()
        sizes = {"MEASUREMENTS": measurements, "BASIS": self.basis, "WORKGROUP": workgroup, **extra, **self.defines}
        self._program = shaders.compute(context, file, sizes)
        self._network = NetworkPass(context, asset, measure) if self.kernel == "residual" else None

    @property
    def bytes(self) -> int:
        """GPU memory of weights and coefficients."""
        return self._weights.size + self.coefficients.size + (self._network.bytes if self._network else 0)

    def run(self) -> None:
        """Coefficients of whatever was measured last."""
        self._measure.measured.bind_to_storage_buffer(3)
        self._weights.bind_to_storage_buffer(4)
        self.coefficients.bind_to_storage_buffer(5)
        self._program.run(self._workgroups)
        self._context.memory_barrier()
        if self._network:
            self._network.run(self.coefficients)

    def read(self) -> Float[np.ndarray, "B C"]:
        """The coefficients as the model's `transfer` gives them."""
        stored = np.frombuffer(self.coefficients.read(), "<f4").reshape(-1, 4)[:, :3]
        if self.kernel == "nearest":
            norm, choice = stored[:2]
            return np.where(np.arange(self.basis)[:, None] == choice, norm, 0.0).astype(np.float32)
        size = stored[-1:] if "GAMMA" in self.defines else stored[:0]
        read = np.concatenate([stored[: self.basis], size])
        return read[:, :1] if self.kernel == "coupled" else read
