"""Glossy indirect light by direction: an asset that predicts nine coefficients a point, beside the light that it goes with.

The coefficients are expanded over the lightmap's texels once a frame, and a lobe reads them in every pixel. What they mean
is in `prt_bench.glossy_indirect`; frames without them compile, upload and run nothing of this.
"""

from types import SimpleNamespace
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float, Int

from prt_bench.assets import RuntimeAsset
from prt_bench.errors import AssetError
from prt_bench.glossy_indirect import COEFFICIENTS, ORDER
from prt_bench.points import Lightmap
from prt_bench.runtime import shaders
from prt_bench.runtime.context import check
from prt_bench.runtime.indirect import Indirect
from prt_bench.runtime.lightmap import LightmapLayout, nearest_receiver
from prt_bench.runtime.lights import UploadedLights
from prt_bench.runtime.measured import MeasuredAsset

if TYPE_CHECKING:
    from prt_bench.runtime.runtime import Runtime

_WORKGROUP = 64


class GlossyIndirect(Indirect):
    """`diffuse` light as it was, and lobes that reflect direct light and what `asset` predicts at the receivers `rows` [G].

    The asset is one fitted to `Directional.dataset`. Raises `AssetError` for one of other receivers or one that does not
    observe direct light, and where `diffuse` has lobes or direct light of its own.
    """

    def __init__(self, runtime: "Runtime", diffuse: Indirect, asset: RuntimeAsset, rows: Int[np.ndarray, " G"]) -> None:
        if not MeasuredAsset.runs(asset):
            raise AssetError(f"{asset.path} has the kernels {asset.kernels}, which hold no light by direction")
        if diffuse.includes_direct or "GLOSSY" in diffuse.defines:
            raise AssetError("directional light goes beside a model of indirect light alone, without lobes of its own")
        receivers = len(rows) * COEFFICIENTS
        if len(asset.arrays["basis"]) != receivers:
            raise AssetError(
                f"{asset.path} predicts {len(asset.arrays['basis'])} values, but {len(rows)} glossy receivers have"
                f" {receivers}; fit it to their own dataset"
            )
        context, layout = runtime.context, runtime.layout
        side = int(np.ceil(np.sqrt(receivers)))
        square = Lightmap(side, np.arange(receivers), np.zeros((0, 3, 2)), np.zeros(0, int))
        beside = SimpleNamespace(
            context=context, measurement=runtime.measurement,
            layout=LightmapLayout(context, square, np.zeros(receivers, bool)),
        )  # fmt: skip
        self._diffuse = diffuse
        self._asset = MeasuredAsset(beside, asset)  # pyright: ignore[reportArgumentType]
        glossy = Lightmap(layout.resolution, layout.texels[rows], np.zeros((0, 3, 2)), np.zeros(0, int))
        sources = nearest_receiver(glossy, np.zeros(len(rows), bool))
        self._points = glossy.texel
        self._sources = context.buffer(sources.astype("<i4").tobytes())
        self._texture = context.texture_array((layout.resolution, layout.resolution, COEFFICIENTS), 4, dtype="f4")
        self._texture.repeat_x = self._texture.repeat_y = False
        sizes = {"WORKGROUP": _WORKGROUP, "RESOLUTION": layout.resolution, "SIDE": side}
        self._program = shaders.compute(context, "directional.comp", {**sizes, **self._asset.defines})
        super().__init__(runtime, {**diffuse.defines, "GLOSSY": 1, "DIRECTIONAL": 1, "ORDER": ORDER})
        check(context, f"loading {asset.path}")

    def prepare(self, lights: UploadedLights) -> None:
        """Both assets' passes, and the coefficients at every texel."""
        self._diffuse.prepare(lights)
        if not isinstance(self._diffuse, MeasuredAsset):
            self._asset.measure(lights)
        self._asset.transfer()
        self._fill()

    def bind(self) -> None:
        """Bind what the diffuse light reads, and the coefficients."""
        self._diffuse.bind()
        self._texture.use(6)

    @property
    def bytes(self) -> int:
        """GPU memory of both."""
        own = 16 * int(np.prod(self._texture.size)) + self._sources.size
        return self._diffuse.bytes + self._asset.bytes + own

    def predict(self, x: Float[np.ndarray, "M 3"]) -> Float[np.ndarray, "G 9 3"]:
        """Coefficients at the glossy receivers from a given measured vector, for comparison with the model, W/m²."""
        self._asset.coefficients_of(x)
        self._fill()
        side = self.runtime.layout.resolution
        check(self.runtime.context, "filling directional light")
        stored = np.frombuffer(self._texture.read(), "<f4").reshape(COEFFICIENTS, side * side, 4)
        return np.moveaxis(stored[:, self._points, :3], 0, 1).copy()

    def _fill(self) -> None:
        context, side = self.runtime.context, self.runtime.layout.resolution
        self._asset.bind()
        self._sources.bind_to_storage_buffer(6)
        self._texture.bind_to_image(0, read=False, write=True)
        self._program.run(-(-side * side // _WORKGROUP))
        context.memory_barrier()
