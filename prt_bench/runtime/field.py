"""Assets whose basis functions come from a network of position and normal: evaluated for every fragment, without a texture."""

from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float

from prt_bench.assets import RuntimeAsset
from prt_bench.errors import AssetError
from prt_bench.runtime import shaders
from prt_bench.runtime.context import check
from prt_bench.runtime.indirect import LoadedAsset
from prt_bench.runtime.layers import buffer, spelled, turns
from prt_bench.runtime.lights import UploadedLights
from prt_bench.runtime.transfer import TransferPass

if TYPE_CHECKING:
    from prt_bench.runtime.runtime import Runtime

_WORKGROUP = 64
_MOST = 128


class FieldAsset(LoadedAsset):
    """Measurement and transfer as for every linear method; the draw pass evaluates the network, written for its shape."""

    def __init__(self, runtime: "Runtime", asset: RuntimeAsset) -> None:
        arrays, context = asset.arrays, runtime.context
        if len(arrays["position"]) != runtime.layout.receivers:
            raise AssetError(
                f"{asset.path} is a field of {len(arrays['position'])} receivers, but the dataset has"
                f" {runtime.layout.receivers}; load it with the dataset it was fitted on"
            )
        depth = sum(name.startswith("matrix") for name in arrays)
        matrices = [*(arrays[f"matrix{at}"] for at in range(depth)), arrays["head"]]
        sizes = [matrices[0].shape[1], *(len(matrix) for matrix in matrices)]
        if max(sizes) > _MOST:
            raise AssetError(f"{asset.path} has a layer of {max(sizes)}; a fragment evaluates {_MOST} at most")
        grids = [arrays[name] for name in sorted(name for name in arrays if name.startswith("grid"))]
        self.transfer_pass = TransferPass(context, asset, runtime.measurement)
        middle = ", ".join(f"{value:.9e}" for value in arrays["box"][:3])
        defines = {
            "RECONSTRUCT_FIELD": 1, "NETWORK": spelled(sizes), "LAYERS": -(-sizes[-1] // 4), "LEVELS": len(grids),
            "DEPTH": len(matrices), "INPUTS": -(-max(sizes) // 4), "ENCODED": -(-sizes[0] // 4),
            "OCTAVES": (sizes[0] - 6 - 2 * len(grids)) // 6, "BOX_MIDDLE": f"vec3({middle})",
            "BOX_SCALE": f"{arrays['box'][3]:.9e}",
            **({"HALF": 1} if arrays["head"].dtype == np.float16 else {}), **self.transfer_pass.defines,
        }  # fmt: skip
        if grids:
            starts = np.cumsum([0, *(len(grid) for grid in grids)])[:-1]
            defines["GRID_SIDES"] = ", ".join(str(round(len(grid) ** (1 / 3))) for grid in grids)
            defines["GRID_STARTS"] = ", ".join(map(str, starts))
        super().__init__(runtime, asset, defines)
        self._weights = {10: context.buffer(buffer([_to_fours(matrix) for matrix in matrices]))}
        biases = [_to_fours(arrays[f"bias{at}"][:, None])[:, 0] for at in range(depth)]
        self._weights[11] = context.buffer(turns(sizes).tobytes() + np.concatenate(biases).astype("<f4").tobytes())
        if grids:
            self._weights[12] = context.buffer(b"".join(np.ascontiguousarray(grid).tobytes() for grid in grids))
        check(context, f"loading {asset.path}")

    @staticmethod
    def runs(asset: RuntimeAsset) -> bool:
        """Direct light, and a field."""
        return (asset.kernels["measure"], asset.kernels["reconstruct"]) == ("direct", "field")

    def measure(self, lights: UploadedLights) -> None:
        """Direct light at the measurement points."""
        self.runtime.measurement.run(lights)

    def transfer(self) -> None:
        """Coefficients of it."""
        self.transfer_pass.run()

    def bind(self) -> None:
        """Bind weights and coefficients."""
        for binding, weights in self._weights.items():
            weights.bind_to_storage_buffer(binding)
        self.transfer_pass.coefficients.bind_to_uniform_block(0)

    @property
    def bytes(self) -> int:
        """GPU memory of the network, its grids, the transfer weights and coefficients."""
        return sum(weights.size for weights in self._weights.values()) + self.transfer_pass.bytes

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
        """Transfer, and the field at the receivers."""
        self.coefficients_of(x)
        context, receivers = self.runtime.context, self.runtime.layout.receivers
        rows = np.zeros((receivers, 2, 4), "<f4")
        rows[:, 0, :3], rows[:, 1, :3] = self.asset.arrays["position"], self.asset.arrays["normal"]
        places, texels = context.buffer(rows.tobytes()), context.buffer(reserve=4 * receivers)
        texels.clear()  # a field has no use for them
        values = context.buffer(reserve=16 * receivers)
        program = shaders.compute(
            context, "reconstruct.comp", {"RECEIVERS": receivers, "RESOLUTION": 1, **self._kernel}
        )
        self.bind()
        for binding, part in ((6, texels), (7, values), (13, places)):
            part.bind_to_storage_buffer(binding)
        program.run(-(-receivers // _WORKGROUP))
        context.memory_barrier()
        check(context, "evaluating a field")
        return np.frombuffer(values.read(), "<f4").reshape(-1, 4)[:, :3].copy()


def _to_fours(matrix: Float[np.ndarray, "o i"]) -> Float[np.ndarray, "o4 i"]:
    """Outputs padded with zeros to a multiple of four."""
    return np.pad(matrix, ((0, -len(matrix) % 4), (0, 0)))
