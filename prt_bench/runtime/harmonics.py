"""Assets that observe light as spherical-harmonic coefficients: no shadow maps, no measurement points, no transfer pass."""

from typing import TYPE_CHECKING

import moderngl
import numpy as np
from jaxtyping import Float

from prt_bench.assets import RuntimeAsset
from prt_bench.errors import AssetError
from prt_bench.runtime import shaders
from prt_bench.runtime.context import check
from prt_bench.runtime.indirect import BasisTexture, LoadedAsset, channels_apart
from prt_bench.runtime.lights import UploadedLights
from prt_bench.runtime.transfer import CHANNELS

if TYPE_CHECKING:
    from prt_bench.runtime.runtime import Runtime

_WORKGROUP = 64


class HarmonicsPass:
    """Coefficients [slots] of a lighting's emitters as seen from a place; `slots` are K padded to a multiple of four."""

    def __init__(self, context: moderngl.Context, centre: Float[np.ndarray, "3"], harmonics: int) -> None:
        self._context, self.harmonics = context, harmonics
        self.slots = 4 * -(-harmonics // 4)
        self.coefficients = context.buffer(reserve=16 * self.slots)
        self.coefficients.clear()
        place = ", ".join(f"{value:.9e}" for value in centre)
        sizes = {
            "COEFFICIENTS": self.slots,
            "HARMONICS": harmonics,
            "WORKGROUP": _WORKGROUP,
            "CENTRE": f"vec3({place})",
        }
        self._program = shaders.compute(context, "harmonics.comp", sizes)

    def run(self, lights: UploadedLights) -> None:
        """Project the emitters of `lights`."""
        lights.bind()
        self.coefficients.bind_to_storage_buffer(5)
        self._program.run(-(-self.slots // _WORKGROUP))
        self._context.memory_barrier()

    def read(self) -> Float[np.ndarray, "K 3"]:
        """The coefficients, W/m²/sr."""
        return np.frombuffer(self.coefficients.read(), "<f4").reshape(-1, 4)[: self.harmonics, :3].copy()

    def write(self, x: Float[np.ndarray, "K 3"]) -> None:
        """Replace the coefficients."""
        self.coefficients.write(np.pad(x, ((0, self.slots - len(x)), (0, 1))).astype("<f4").tobytes())


class ProjectedAsset(LoadedAsset):
    """What all ways of storing transfer share: the projection of light."""

    def __init__(self, runtime: "Runtime", asset: RuntimeAsset, kernel: shaders.Defines, channels: int) -> None:
        if channels not in (1, CHANNELS):
            raise AssetError(f"{asset.path} has transfer vectors for {channels} channels; this runtime has {CHANNELS}")
        harmonics = asset.arrays["basis"].shape[2]
        self.projection = HarmonicsPass(runtime.context, asset.arrays["centre"], harmonics)
        super().__init__(runtime, asset, {"COEFFICIENTS": self.projection.slots, **kernel})
        self.needs_shadows = not asset.includes_direct

    def measure(self, lights: UploadedLights) -> None:
        """Project the light onto harmonics."""
        self.projection.run(lights)

    def measured(self) -> Float[np.ndarray, "K 3"]:
        """The coefficients."""
        return self.projection.read()

    def coefficients_of(self, x: Float[np.ndarray, "K 3"]) -> Float[np.ndarray, "K 3"]:
        """The coefficients themselves."""
        self.projection.write(x)
        self.transfer()
        check(self.runtime.context, "transferring")
        return self.projection.read()


class HarmonicAsset(ProjectedAsset):
    """Transfer vectors in textures; the fragment shader multiplies them with the coefficients."""

    def __init__(self, runtime: "Runtime", asset: RuntimeAsset) -> None:
        basis = asset.arrays["basis"]
        layers = -(-basis.shape[2] // 4)
        channels = basis.shape[1]
        super().__init__(runtime, asset, {diffuse_kernel(channels): 1, "LAYERS": layers}, channels)
        self._basis = BasisTexture(runtime, channels_apart(basis, 4 * layers))
        check(runtime.context, f"loading {asset.path}")

    @staticmethod
    def runs(asset: RuntimeAsset) -> bool:
        """Harmonics, and transfer vectors in a texture."""
        return (asset.kernels["measure"], asset.kernels["reconstruct"]) == ("harmonics", "channels")

    def transfer(self) -> None:
        """Nothing: the coefficients are what was measured."""

    def bind(self) -> None:
        """Bind transfer textures and coefficients."""
        self._basis.bind()
        self.projection.coefficients.bind_to_uniform_block(0)

    @property
    def bytes(self) -> int:
        """GPU memory of transfer textures (padded texels included) and coefficients."""
        return self._basis.bytes + self.projection.coefficients.size

    def predict(self, x: Float[np.ndarray, "K 3"]) -> Float[np.ndarray, "T 3"]:
        """Light at the receivers from given coefficients."""
        self.coefficients_of(x)
        return self._basis.receiver_values(self, self._kernel)


def diffuse_kernel(channels: int) -> str:
    """The kernel of `reconstruct.glsl` for transfer vectors of one channel or of each."""
    return "RECONSTRUCT_BASIS" if channels == 1 else "RECONSTRUCT_CHANNELS"


class VertexAsset(ProjectedAsset):
    """Transfer vectors in a buffer; one invocation per vertex multiplies them, the rasteriser interpolates."""

    def __init__(self, runtime: "Runtime", asset: RuntimeAsset) -> None:
        basis = asset.arrays["basis"]
        if len(basis) != runtime.mesh_vertices:
            raise AssetError(
                f"{asset.path} holds transfer for {len(basis)} vertices, but the dataset has {runtime.mesh_vertices};"
                " load it with the dataset it was fitted on"
            )
        super().__init__(runtime, asset, {"RECONSTRUCT_VERTICES": 1}, basis.shape[1])
        context = runtime.context
        self._transfer = context.buffer(np.ascontiguousarray(basis, "<f4").tobytes())
        self._light = context.buffer(reserve=16 * len(basis))
        sizes = {"VERTICES": len(basis), "TRANSFER_CHANNELS": basis.shape[1], "HARMONICS": basis.shape[2]}
        self._program = shaders.compute(context, "vertices.comp", {**sizes, "WORKGROUP": _WORKGROUP})
        self._workgroups = -(-len(basis) // _WORKGROUP)
        check(context, f"loading {asset.path}")

    @staticmethod
    def runs(asset: RuntimeAsset) -> bool:
        """Harmonics, and transfer vectors at the vertices."""
        return (asset.kernels["measure"], asset.kernels["reconstruct"]) == ("harmonics", "vertices")

    def transfer(self) -> None:
        """Light at every vertex."""
        self._transfer.bind_to_storage_buffer(4)
        self.projection.coefficients.bind_to_storage_buffer(5)
        self._light.bind_to_storage_buffer(8)
        self._program.run(self._workgroups)
        self.runtime.context.memory_barrier()

    def bind(self) -> None:
        """Bind the light at the vertices."""
        self._light.bind_to_storage_buffer(8)

    @property
    def bytes(self) -> int:
        """GPU memory of transfer vectors, light at the vertices and coefficients."""
        return self._transfer.size + self._light.size + self.projection.coefficients.size

    def predict(self, x: Float[np.ndarray, "K 3"]) -> Float[np.ndarray, "T 3"]:
        """Light at the receivers from given coefficients: what the shader found at the vertices, interpolated here."""
        self.coefficients_of(x)
        light = np.frombuffer(self._light.read(), "<f4").reshape(-1, 4)[:, :3]
        corner = light[self.asset.arrays["corner"].astype(int)]
        return np.einsum("ti,tic->tc", self.asset.arrays["barycentric"], corner)
