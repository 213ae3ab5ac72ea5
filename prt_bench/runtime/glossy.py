"""Assets of glossy transfer: what `harmonics` draws, and a Phong lobe in every pixel by triple products or fixed light."""

from typing import TYPE_CHECKING

import moderngl
import numpy as np
from jaxtyping import Float

from prt_bench.assets import RuntimeAsset
from prt_bench.errors import AssetError
from prt_bench.runtime import shaders
from prt_bench.runtime.context import check
from prt_bench.runtime.generate import matrix_entries, pairs
from prt_bench.runtime.harmonics import HarmonicsPass, ProjectedAsset, diffuse_kernel
from prt_bench.runtime.indirect import BasisTexture, channels_apart
from prt_bench.runtime.transfer import CHANNELS
from prt_bench.spherical import order_of, triple_products

if TYPE_CHECKING:
    from prt_bench.runtime.runtime import Runtime

_WORKGROUP = 64


class GlossyAsset(ProjectedAsset):
    """Transfer vectors of diffuse light, then those of the lobes, in one texture array.

    With inter-reflections of fixed light those come last, a vector for each channel. With the light fixed the transfer
    pass makes its matrices. `dense` takes the triple product by the whole tensor instead of the generated code, to be
    compared with it. Scenes without a glossy material compile no lobe in.
    """

    def __init__(self, runtime: "Runtime", asset: RuntimeAsset, dense: bool = False) -> None:
        basis = asset.arrays["basis"]
        order, fixed = order_of(basis.shape[2]), asset.kernels["reconstruct"] == "triple-fixed"
        bounced = asset.kernels["reconstruct"] == "triple-bounced"
        if bounced and basis.shape[1] != 1 + CHANNELS:
            raise AssetError(f"{asset.path} holds light in {basis.shape[1] - 1} channels; this runtime has {CHANNELS}")
        layers, channels = -(-basis.shape[2] // 4), 1 if bounced else max(basis.shape[1] - 1, 1)
        kernel = {diffuse_kernel(channels): 1, "LAYERS": layers, **({"BOUNCED": layers} if bounced else {})}
        self._lobe = {
            "GLOSSY": 1,
            "ORDER": order,
            "HARMONICS": basis.shape[2],
            "VISIBLE": 0 if bounced else (basis.shape[1] - 1) * layers,
            **({"FIXED": 1} if fixed else {}),
            **({"DENSE": 1} if dense else {}),
        }
        super().__init__(runtime, asset, {**kernel, **(self._lobe if runtime.scene.glossy else {})}, channels)
        self._basis = BasisTexture(runtime, channels_apart(basis, 4 * layers))
        self._matrix = MatrixPass(runtime.context, self.projection, order) if fixed else None
        self._tensor = None
        if dense:
            tensor = np.zeros((order**2,) * 3, "<f4")
            tensor[tuple(triple_products(order).indices.T)] = triple_products(order).values
            self._tensor = runtime.context.buffer(np.int32(order**2).tobytes() + tensor.tobytes())
        check(runtime.context, f"loading {asset.path}")

    @staticmethod
    def runs(asset: RuntimeAsset) -> bool:
        """Harmonics, and transfer vectors for lobes."""
        return asset.kernels["measure"] == "harmonics" and asset.kernels["reconstruct"].startswith("triple")

    def transfer(self) -> None:
        """The light's matrices where it is fixed; else nothing."""
        if self._matrix is not None:
            self._matrix.run()

    def bind(self) -> None:
        """Bind transfer textures, coefficients, and what multiplies them."""
        self._basis.bind()
        self.projection.coefficients.bind_to_uniform_block(0)
        if self._matrix is not None:
            self._matrix.matrix.bind_to_uniform_block(1)
        if self._tensor is not None:
            self._tensor.bind_to_storage_buffer(9)

    @property
    def bytes(self) -> int:
        """GPU memory of transfer textures (padded texels included), coefficients and matrices."""
        extra = [buffer.size for buffer in (self._tensor, self._matrix and self._matrix.matrix) if buffer is not None]
        return self._basis.bytes + self.projection.coefficients.size + sum(extra)

    def predict(self, x: Float[np.ndarray, "K 3"]) -> Float[np.ndarray, "T 3"]:
        """Irradiance at the receivers from given coefficients."""
        self.coefficients_of(x)
        return self._basis.receiver_values(self, self._kernel)

    def gloss(
        self, x: Float[np.ndarray, "K 3"], mirror: Float[np.ndarray, "T 3"], exponent: Float[np.ndarray, " T"]
    ) -> Float[np.ndarray, "T 3"]:
        """What lobes about `mirror` reflect at the receivers, for comparison with the model, W/m²."""
        self.coefficients_of(x)
        layout, context = self.runtime.layout, self.runtime.context
        texels = context.buffer(layout.texels.astype("<i4").tobytes())
        values = context.buffer(np.column_stack([mirror, exponent]).astype("<f4").tobytes())
        sizes = {"RECEIVERS": layout.receivers, "RESOLUTION": layout.resolution}
        program = shaders.compute(context, "gloss.comp", {**self._kernel, **self._lobe, **sizes})
        self.bind()
        texels.bind_to_storage_buffer(6)
        values.bind_to_storage_buffer(7)
        program.run(-(-layout.receivers // _WORKGROUP))
        context.memory_barrier()
        check(context, "reflecting")
        return np.frombuffer(values.read(), "<f4").reshape(-1, 4)[:, :3].copy()


class MatrixPass:
    """The upper halves of the light's three matrices, a row for each pair of coefficients."""

    def __init__(self, context: moderngl.Context, projection: HarmonicsPass, order: int) -> None:
        self._context, self._coefficients = context, projection.coefficients
        count = len(pairs(order))
        starts, indices, values = matrix_entries(order)
        self._starts = context.buffer(starts.astype("<i4").tobytes())
        self._entries = context.buffer(np.column_stack([indices, values]).astype("<f4").tobytes())
        self.matrix = context.buffer(reserve=16 * count)
        self._workgroups = -(-count // _WORKGROUP)
        self._program = shaders.compute(context, "matrix.comp", {"PAIRS": count, "WORKGROUP": _WORKGROUP})

    def run(self) -> None:
        """Matrices of the coefficients there are now."""
        self._entries.bind_to_storage_buffer(4)
        self._coefficients.bind_to_storage_buffer(5)
        self._starts.bind_to_storage_buffer(6)
        self.matrix.bind_to_storage_buffer(9)
        self._program.run(self._workgroups)
        self._context.memory_barrier()
