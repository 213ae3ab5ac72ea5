"""Light of meshless samples on the screen: elliptical Gaussian splats on the surfaces that the pixels show.

Light at the samples is found in `samples.py`. Weights are normalised in the draw pass, so that a pixel gets a mean over the
samples that reach it. Shadows are splatted as shares of direct light that arrive, and multiply light that is evaluated per
pixel: its fall with distance and angle is then as fine as the screen, and only the shadows' edges are as coarse as the samples.
"""

from functools import cached_property
from typing import TYPE_CHECKING

import moderngl
import numpy as np
from jaxtyping import Float

from prt_bench.errors import AssetError
from prt_bench.runtime import shaders
from prt_bench.runtime.context import check
from prt_bench.runtime.draw import DrawPass, eye_of
from prt_bench.runtime.indirect import Indirect
from prt_bench.runtime.lights import UploadedLights
from prt_bench.runtime.projection import to_glsl
from prt_bench.runtime.samples import SamplePasses
from prt_bench.sampled import SampledLight

if TYPE_CHECKING:
    from prt_bench.runtime.runtime import Runtime

_DEFINES = {
    "BIAS": "0.5",  # of the reach, towards the eye
    "OFF_SURFACE": "0.3",  # of the reach
    "SAME_WAY": "0.5",  # cosine between the normals of sample and pixel
    "SHARPNESS": "3.0",
}

_OF_SAMPLES = "in_position", "in_normal", "in_tangent", "in_walls", "in_further_walls"


class SplattedLight(Indirect):
    """Indirect light of samples as splats, and direct light with their shadows, or with shadow maps where `shadow_maps` asks.

    Raises `AssetError` in scenes with hair, on whose strands there are no samples.
    """

    def __init__(self, runtime: "Runtime", model: SampledLight, shadow_maps: bool = False) -> None:
        if runtime.scene.strands is not None:
            raise AssetError(
                f"scene '{runtime.scene.name}' has hair, which splats do not light; use a lightmap's method"
            )
        super().__init__(runtime, {"RECONSTRUCT_SPLATS": 1})
        self.needs_shadows = shadow_maps
        self.samples = SamplePasses(runtime.context, model)
        self._splats = _SplatPass(runtime, self.samples)
        check(runtime.context, "loading splats")

    def prepare(self, lights: UploadedLights) -> None:
        """Light at the samples, and their splats. Raises `LightError` for light from infinitely far away."""
        self.samples.run(lights)
        self.splat()

    def splat(self) -> None:
        """The splats alone, of the light that the samples have, as the runtime's camera sees them."""
        self._splats.run(self.runtime.camera)

    def bind(self) -> None:
        """Bind what is on the screen."""
        self._splats.bind()

    @property
    def bytes(self) -> int:
        """GPU memory of samples, visibility and transfer; images as large as the screen are not counted."""
        return self.samples.bytes

    @cached_property
    def draw_pass(self) -> DrawPass:
        """Direct and indirect light; compiled on first use."""
        if self.needs_shadows:
            return self.runtime.draw_pass({"DIRECT": 1, **self._drawn})
        return self.runtime.draw_pass({"DIRECT": 1, "SPLATTED_SHADOWS": 1, **self._drawn}, shadow_maps=False)


class _SplatPass:
    """Surfaces into images of place and normal, then all splats into sums of light and of weights."""

    def __init__(self, runtime: "Runtime", samples: SamplePasses) -> None:
        context, size = runtime.context, runtime.size
        self._context, self._samples, self._height = context, samples, size[1]
        self._places, self._normals = context.texture(size, 4, dtype="f4"), context.texture(size, 4, dtype="f2")
        self._sums = context.texture(size, 4, dtype="f4"), context.texture(size, 4, dtype="f4")
        depth = context.depth_renderbuffer(size)
        self._surfaces = context.framebuffer([self._places, self._normals], depth)
        self._target = context.framebuffer(list(self._sums), depth)
        self._target.depth_mask = False
        self._place = shaders.program(context, "draw.vert", "places.frag", {"SHADED": 1})
        self._splat = shaders.program(context, "splat.vert", "splat.frag", _DEFINES)
        self._mesh = runtime.mesh.bound_to(self._place)
        self._quads = context.vertex_array(
            self._splat,
            [
                (samples.samples, "4f 4f 4f 4f 4f /i", *_OF_SAMPLES),
                (samples.lights, "4f 4f 4f /i", "in_direct", "in_open", "in_indirect"),
            ],
        )

    def run(self, camera: Float[np.ndarray, "4 4"]) -> None:
        ctx = self._context
        self._surfaces.use()
        self._surfaces.clear(depth=1.0)
        ctx.enable_only(moderngl.DEPTH_TEST | moderngl.CULL_FACE)
        ctx.depth_func, ctx.cull_face = "<", "back"
        shaders.uniform(self._place, "camera").write(to_glsl(camera))
        self._mesh.render(moderngl.TRIANGLES)
        self._target.use()
        self._target.clear()  # but not the depth, which is masked
        ctx.enable_only(moderngl.DEPTH_TEST | moderngl.BLEND)
        ctx.blend_func = moderngl.ONE, moderngl.ONE
        for name, value in (("camera", to_glsl(camera)), ("eye", eye_of(camera).astype("<f4").tobytes())):
            shaders.uniform(self._splat, name).write(value)
        shaders.uniform(self._splat, "pixel").value = 2.0 / (self._height * float(np.linalg.norm(camera[1, :3])))
        self._places.use(11)
        self._normals.use(12)
        self._quads.render(moderngl.TRIANGLE_STRIP, vertices=4, instances=self._samples.count)

    def bind(self) -> None:
        self._sums[0].use(9)
        self._sums[1].use(10)
