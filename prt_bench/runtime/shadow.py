"""Shadow pass: depth of the scene from every shadow view, in one instanced draw into one atlas; and how it is looked up."""

import moderngl
import numpy as np

from prt_bench.runtime import shaders
from prt_bench.runtime.lights import UploadedLights
from prt_bench.runtime.mesh import MeshBuffers
from prt_bench.scene import Scene

DEPTH_OFFSET = 0.25
"""How far before its receiver an occluder must lie to cast a shadow, in shadow texels."""
SURFACE_END = 1.0
"""How far behind a surface a shadow texel's depth may lie and still belong to it, in shadow texels."""
RAY_OFFSET = 2.0**-14
"""Offset of shadow rays relative to the scene's size, as in the bake; added to DEPTH_OFFSET."""
GL_CLIP_DISTANCE0 = 0x3000


def lighting_defines(scene: Scene, size: int, shadows: bool) -> shaders.Defines:
    """What `emitters.glsl` and `shadow.glsl` are compiled with, for an atlas of `size` texels a side."""
    magnitude = max(float(np.abs(scene.bounds).max()), scene.extent)
    return {
        "DEPTH_OFFSET": f"{DEPTH_OFFSET:.9e}",
        "SURFACE_END": f"{SURFACE_END:.9e}",
        "RAY_OFFSET": f"{RAY_OFFSET * magnitude:.9e}",
        "ATLAS_SIZE": f"{size}.0",
        **({"SHADOWS": 1} if shadows else {}),
    }


class ShadowPass:
    """A square depth atlas of `size` texels a side, shared evenly by the views of a lighting."""

    def __init__(self, context: moderngl.Context, mesh: MeshBuffers, size: int, defines: shaders.Defines) -> None:
        self._context = context
        self.atlas = context.depth_texture((size, size))
        self.atlas.compare_func = ""
        self.atlas.filter = (moderngl.NEAREST, moderngl.NEAREST)
        self._target = context.framebuffer(depth_attachment=self.atlas)
        self._mesh = mesh.bound_to(shaders.program(context, "shadow.vert", None, defines))

    def run(self, lights: UploadedLights) -> None:
        """Draw the views of `lights` and bind the atlas for lookups."""
        self._target.use()
        self._target.clear(depth=1.0)
        self._context.enable_only(moderngl.DEPTH_TEST)
        self._context.depth_func = "<"
        lights.bind()
        for plane in range(4):
            self._context.enable_direct(GL_CLIP_DISTANCE0 + plane)
        if lights.view_count:
            self._mesh.render(moderngl.TRIANGLES, instances=lights.view_count)
        for plane in range(4):
            self._context.disable_direct(GL_CLIP_DISTANCE0 + plane)
        self.bind()

    def bind(self) -> None:
        """Bind the atlas where `shadow.glsl` looks."""
        self.atlas.use(0)
