"""Assets that observe direct light at measurement points: every method that transfers direct to indirect light."""

from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float

from prt_bench.assets import RuntimeAsset
from prt_bench.errors import AssetError
from prt_bench.runtime.context import check
from prt_bench.runtime.indirect import BasisTexture, LoadedAsset, channels_apart
from prt_bench.runtime.lights import UploadedLights
from prt_bench.runtime.transfer import CHANNELS, TransferPass

if TYPE_CHECKING:
    from prt_bench.runtime.runtime import Runtime


class MeasuredAsset(LoadedAsset):
    """Measurement pass, transfer pass, and basis textures that the draw pass reads."""

    def __init__(self, runtime: "Runtime", asset: RuntimeAsset) -> None:
        reconstruct, basis = asset.kernels["reconstruct"].removeprefix("gamma-"), asset.arrays["basis"]
        if reconstruct == "coupled" and basis.shape[1] != CHANNELS:
            raise AssetError(f"{asset.path} couples {basis.shape[1]} channels; this runtime has {CHANNELS}")
        self.transfer_pass = TransferPass(runtime.context, asset, runtime.measurement)
        layers = -(-basis.shape[-1] // 4)
        if reconstruct == "coupled":
            basis = channels_apart(basis, 4 * layers)
        defines = {f"RECONSTRUCT_{reconstruct.upper()}": 1, "LAYERS": layers, **self.transfer_pass.defines}
        if reconstruct == "clusters":  # which cluster a texel belongs to lies behind its functions
            defines |= {"CLUSTER_BASIS": basis.shape[1], "LAYERS": basis.shape[1] // 4 + 1}
            basis = np.concatenate([basis, asset.arrays["cluster"][:, None]], axis=1)
        super().__init__(runtime, asset, defines)
        self._basis = BasisTexture(runtime, basis)
        check(runtime.context, f"loading {asset.path}")

    @staticmethod
    def runs(asset: RuntimeAsset) -> bool:
        """Direct light, and a basis in a texture."""
        reconstruct = asset.kernels["reconstruct"].removeprefix("gamma-")
        return asset.kernels["measure"] == "direct" and reconstruct in ("basis", "clusters", "coupled", "select")

    def measure(self, lights: UploadedLights) -> None:
        """Direct light at the measurement points."""
        self.runtime.measurement.run(lights)

    def transfer(self) -> None:
        """Coefficients of it."""
        self.transfer_pass.run()

    def bind(self) -> None:
        """Bind basis textures and coefficients."""
        self._basis.bind()
        self.transfer_pass.coefficients.bind_to_uniform_block(0)

    @property
    def bytes(self) -> int:
        """GPU memory of basis textures (padded texels included), weights and coefficients."""
        return self._basis.bytes + self.transfer_pass.bytes

    def measured(self) -> Float[np.ndarray, "M 3"]:
        """Direct light at the measurement points, W/m²."""
        return self.runtime.measurement.read()

    def coefficients_of(self, x: Float[np.ndarray, "M 3"]) -> Float[np.ndarray, "B C"]:
        """Coefficients of a measured vector, by the transfer pass."""
        self.runtime.measurement.write(x)
        self.transfer_pass.run()
        check(self.runtime.context, "transferring")
        return self.transfer_pass.read()

    def predict(self, x: Float[np.ndarray, "M 3"]) -> Float[np.ndarray, "T 3"]:
        """Transfer and reconstruction at the receivers."""
        self.coefficients_of(x)
        return self.receiver_values()

    def receiver_values(self) -> Float[np.ndarray, "T 3"]:
        """What the draw pass shows at the receivers."""
        return self._basis.receiver_values(self, self._kernel)
