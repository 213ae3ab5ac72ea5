"""The pass of a residual network: it adds to the coefficients that the linear transfer pass left."""

import moderngl
import numpy as np

from prt_bench.assets import RuntimeAsset
from prt_bench.errors import AssetError
from prt_bench.runtime import shaders
from prt_bench.runtime.layers import buffer, spelled
from prt_bench.runtime.measure import MeasurePass

_WORKGROUP = 128
_SHARED = 32768  # bytes that a workgroup can share on every GPU with OpenGL 4.3


class NetworkPass:
    """Weights of one asset's network on the GPU, in the precision that the asset stores, and the program for its shape."""

    def __init__(self, context: moderngl.Context, asset: RuntimeAsset, measure: MeasurePass) -> None:
        arrays, self._context, self._measure = asset.arrays, context, measure
        depth = sum(name.startswith("matrix") for name in arrays)
        matrices = [arrays[f"matrix{at}"] for at in range(depth)]
        head = arrays["head"]
        sizes = [matrices[0].shape[1], *(len(matrix) for matrix in matrices), head.shape[1]]
        widest = max(sizes[1:-1])
        if 16 * (2 * widest + _WORKGROUP) > _SHARED:
            raise AssetError(
                f"{asset.path} has a layer of {widest}, more than a workgroup can share; train it with width = 512 or less"
            )
        biases = np.concatenate([arrays[f"bias{at}"] for at in range(depth)])
        self._matrices = context.buffer(buffer([*matrices, *head]))
        self._biases = context.buffer(biases.astype("<f4").tobytes())
        half = {"HALF": 1} if head.dtype == np.float16 else {}
        defines = {
            "NETWORK": spelled(sizes), "WIDEST": widest, "MEASUREMENTS": sizes[0], "HEAD_CHANNELS": len(head),
            "WORKGROUP": _WORKGROUP, **half,
        }  # fmt: skip
        self._program = shaders.compute(context, "network.comp", defines)

    @property
    def bytes(self) -> int:
        """GPU memory of the weights."""
        return self._matrices.size + self._biases.size

    def run(self, coefficients: moderngl.Buffer) -> None:
        """Add the network's share of whatever was measured last."""
        self._measure.measured.bind_to_storage_buffer(3)
        coefficients.bind_to_storage_buffer(5)
        self._matrices.bind_to_storage_buffer(10)
        self._biases.bind_to_storage_buffer(11)
        self._program.run(1)
        self._context.memory_barrier()
