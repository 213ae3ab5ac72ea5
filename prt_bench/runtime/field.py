"""Assets whose basis functions come from a network of position and normal: evaluated for every fragment, without a texture."""

from collections.abc import Mapping
from typing import TYPE_CHECKING

import moderngl
import numpy as np
from jaxtyping import Float

from prt_bench.assets import RuntimeAsset
from prt_bench.errors import AssetError
from prt_bench.runtime import shaders
from prt_bench.runtime.context import check
from prt_bench.runtime.harmonics import HarmonicsPass
from prt_bench.runtime.indirect import LoadedAsset
from prt_bench.runtime.layers import buffer, spelled, turns
from prt_bench.runtime.lights import UploadedLights
from prt_bench.runtime.transfer import CHANNELS, TransferPass
from prt_bench.spherical import order_of

if TYPE_CHECKING:
    from prt_bench.runtime.runtime import Runtime

_WORKGROUP = 64
_MOST = 128


class FieldAsset(LoadedAsset):
    """Measurement and transfer as for every linear method; the draw pass evaluates the network, written for its shape."""

    def __init__(self, runtime: "Runtime", asset: RuntimeAsset) -> None:
        arrays, context = asset.arrays, runtime.context
        _same_receivers(runtime, asset)
        self.transfer_pass = TransferPass(context, asset, runtime.measurement)
        self._field = FieldBuffers(context, arrays, str(asset.path))
        functions = {"LAYERS": -(-arrays["head"].shape[0] // 4)}
        super().__init__(
            runtime, asset, {"RECONSTRUCT_FIELD": 1, **self._field.defines, **functions, **self.transfer_pass.defines}
        )
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
        self._field.bind()
        self.transfer_pass.coefficients.bind_to_uniform_block(0)

    @property
    def bytes(self) -> int:
        """GPU memory of the network, its grids, the transfer weights and coefficients."""
        return self._field.bytes + self.transfer_pass.bytes

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
        return evaluated(self)


def evaluated(loaded: "FieldAsset | HarmonicFieldAsset") -> Float[np.ndarray, "T 3"]:
    """What a field gives at the receivers with the coefficients there are now."""
    context, receivers, arrays = loaded.runtime.context, loaded.runtime.layout.receivers, loaded.asset.arrays
    rows = np.zeros((receivers, 2, 4), "<f4")
    rows[:, 0, :3], rows[:, 1, :3] = arrays["position"], arrays["normal"]
    places, texels = context.buffer(rows.tobytes()), context.buffer(reserve=4 * receivers)
    texels.clear()  # a field has no use for them
    values = context.buffer(reserve=16 * receivers)
    sizes = {"RECEIVERS": receivers, "RESOLUTION": 1}
    program = shaders.compute(context, "reconstruct.comp", {**sizes, **loaded.defines})
    loaded.bind()
    for binding, part in ((6, texels), (7, values), (13, places)):
        part.bind_to_storage_buffer(binding)
    program.run(-(-receivers // _WORKGROUP))
    context.memory_barrier()
    check(context, "evaluating a field")
    return np.frombuffer(values.read(), "<f4").reshape(-1, 4)[:, :3].copy()


class FieldBuffers:
    """Weights of a field on the GPU, and the `defines` by which shaders are written for its shape.

    `arrays` are named as an asset stores them; `head` is [B, h], or [W, K, h] for transfer vectors, whose rows are padded to
    a multiple of four. `name` is told where a layer is wider than `most`. Raises `AssetError` for those.
    """

    def __init__(
        self, context: moderngl.Context, arrays: Mapping[str, np.ndarray], name: str, most: int = _MOST
    ) -> None:
        depth, head = sum(each.startswith("matrix") for each in arrays), arrays["head"]
        if head.ndim == 3:
            layers = -(-head.shape[1] // 4)
            harmonics = {
                "ROWS": head.shape[0],
                "LAYERS": layers,
                "HARMONICS": head.shape[1],
                "ORDER": order_of(head.shape[1]),
            }
            head = np.pad(head, ((0, 0), (0, 4 * layers - head.shape[1]), (0, 0))).reshape(-1, head.shape[2])
        else:
            harmonics = {}
        matrices = [*(arrays[f"matrix{at}"] for at in range(depth)), head]
        sizes = [matrices[0].shape[1], *(len(matrix) for matrix in matrices)]
        if max(sizes) > most:
            raise AssetError(f"{name} has a layer of {max(sizes)}; a fragment evaluates {most} at most")
        grids = [arrays[each] for each in sorted(each for each in arrays if each.startswith("grid"))]
        middle = ", ".join(f"{value:.9e}" for value in arrays["box"][:3])
        self.defines: dict[str, int | str] = {
            "NETWORK": spelled(sizes), "LEVELS": len(grids), "DEPTH": len(matrices),
            "INPUTS": -(-max(sizes) // 4), "ENCODED": -(-sizes[0] // 4),
            "OCTAVES": (sizes[0] - 6 - 2 * len(grids)) // 6, "BOX_MIDDLE": f"vec3({middle})",
            "BOX_SCALE": f"{arrays['box'][3]:.9e}", **harmonics, **({"HALF": 1} if head.dtype == np.float16 else {}),
        }  # fmt: skip
        if grids:
            starts = np.cumsum([0, *(len(grid) for grid in grids)])[:-1]
            self.defines["GRID_SIDES"] = ", ".join(str(round(len(grid) ** (1 / 3))) for grid in grids)
            self.defines["GRID_STARTS"] = ", ".join(map(str, starts))
        self._weights = {10: context.buffer(buffer([_to_fours(matrix) for matrix in matrices]))}
        biases = [_to_fours(arrays[f"bias{at}"][:, None])[:, 0] for at in range(depth)]
        self._weights[11] = context.buffer(turns(sizes).tobytes() + np.concatenate(biases).astype("<f4").tobytes())
        if grids:
            self._weights[12] = context.buffer(b"".join(np.ascontiguousarray(grid).tobytes() for grid in grids))

    def bind(self) -> None:
        """Bind weights, biases and grids where `field.glsl` reads them."""
        for binding, weights in self._weights.items():
            weights.bind_to_storage_buffer(binding)

    @property
    def bytes(self) -> int:
        """GPU memory."""
        return sum(weights.size for weights in self._weights.values())


class HarmonicFieldAsset(LoadedAsset):
    """Light as harmonics, transfer vectors from a network in every fragment."""

    def __init__(self, runtime: "Runtime", asset: RuntimeAsset) -> None:
        arrays, channels = asset.arrays, asset.arrays["head"].shape[0]
        _same_receivers(runtime, asset)
        if channels not in (1, CHANNELS):
            raise AssetError(f"{asset.path} has transfer vectors for {channels} channels; this runtime has {CHANNELS}")
        self._field = FieldBuffers(runtime.context, arrays, str(asset.path))
        self.projection = HarmonicsPass(runtime.context, arrays["centre"], arrays["head"].shape[1])
        shape = {"COEFFICIENTS": self.projection.slots, "DIFFUSE_ROWS": channels}
        super().__init__(runtime, asset, {"RECONSTRUCT_FIELD": 1, **shape, **self._field.defines})
        self.needs_shadows = not asset.includes_direct
        check(runtime.context, f"loading {asset.path}")

    @staticmethod
    def runs(asset: RuntimeAsset) -> bool:
        """Harmonics, and a field."""
        return (asset.kernels["measure"], asset.kernels["reconstruct"]) == ("harmonics", "field")

    def measure(self, lights: UploadedLights) -> None:
        """Project the light onto harmonics."""
        self.projection.run(lights)

    def transfer(self) -> None:
        """Nothing: the coefficients are what was measured."""

    def bind(self) -> None:
        """Bind weights and coefficients."""
        self._field.bind()
        self.projection.coefficients.bind_to_uniform_block(0)

    @property
    def bytes(self) -> int:
        """GPU memory of the network, its grids and the coefficients."""
        return self._field.bytes + self.projection.coefficients.size

    def measured(self) -> Float[np.ndarray, "K 3"]:
        """The coefficients."""
        return self.projection.read()

    def coefficients_of(self, x: Float[np.ndarray, "K 3"]) -> Float[np.ndarray, "K 3"]:
        """The coefficients themselves."""
        self.projection.write(x)
        return self.projection.read()

    def predict(self, x: Float[np.ndarray, "K 3"]) -> Float[np.ndarray, "T 3"]:
        """Light at the receivers from given coefficients."""
        self.projection.write(x)
        return evaluated(self)


def _same_receivers(runtime: "Runtime", asset: RuntimeAsset) -> None:
    if len(asset.arrays["position"]) != runtime.layout.receivers:
        raise AssetError(
            f"{asset.path} is a field of {len(asset.arrays['position'])} receivers, but the dataset has"
            f" {runtime.layout.receivers}; load it with the dataset it was fitted on"
        )


def _to_fours(matrix: Float[np.ndarray, "o i"]) -> Float[np.ndarray, "o4 i"]:
    """Outputs padded with zeros to a multiple of four."""
    return np.pad(matrix, ((0, -len(matrix) % 4), (0, 0)))
