"""Shadow pass: depth of the scene from every shadow view, in one instanced draw into one atlas."""

import moderngl

from prt_bench.runtime import shaders
from prt_bench.runtime.lights import UploadedLights
from prt_bench.runtime.mesh import MeshBuffers

GL_CLIP_DISTANCE0 = 0x3000


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
