"""Draw pass: the scene from a camera, lit directly and indirectly, over the sky; and the tone map for display.

One program per combination of effects. What a frame does not use is compiled out.
"""

import moderngl
import numpy as np
from jaxtyping import Float

from prt_bench.runtime import shaders
from prt_bench.runtime.lights import UploadedLights
from prt_bench.runtime.mesh import MeshBuffers
from prt_bench.runtime.projection import to_glsl
from prt_bench.scene import LEAST_TILT


class Screen:
    """Where frames go: linear radiance in float32 with depth, and its 8-bit sRGB picture."""

    def __init__(self, context: moderngl.Context, size: tuple[int, int]) -> None:
        self.size = size
        self._context = context
        self.radiance = context.texture(size, 4, dtype="f4")
        self._picture = context.texture(size, 4, dtype="f1")
        self.linear = context.framebuffer([self.radiance], context.depth_renderbuffer(size))
        self.display = context.framebuffer([self._picture])
        self._tone_map = shaders.program(context, "screen.vert", "tonemap.frag", {})
        self._triangle = context.vertex_array(self._tone_map, [])

    def tone_map(self, exposure: float, target: moderngl.Framebuffer | None = None) -> None:
        """Radiance · 2^exposure through the sRGB transfer function into `display`, or another framebuffer."""
        (target or self.display).use()
        self._context.enable_only(moderngl.NOTHING)
        self.radiance.use(4)
        shaders.uniform(self._tone_map, "exposure").value = 2.0**exposure
        self._triangle.render(moderngl.TRIANGLES, vertices=3)

    def read_linear(self) -> Float[np.ndarray, "H W 3"]:
        """Radiance, top row first, W/m²/sr."""
        return self._rows(np.frombuffer(self.linear.read(components=3, dtype="f4"), "<f4"))

    def read_picture(self) -> np.ndarray:
        """8-bit sRGB [H, W, 3], top row first."""
        return self._rows(np.frombuffer(self.display.read(components=3), np.uint8))

    def _rows(self, flat: np.ndarray) -> np.ndarray:
        return flat.reshape(self.size[1], self.size[0], 3)[::-1].copy()


class DrawPass:
    """The shaded scene; `defines` choose what irradiance holds (DIRECT, SHADOWS, INDIRECT and its kernel)."""

    def __init__(self, context: moderngl.Context, mesh: MeshBuffers, defines: shaders.Defines) -> None:
        self._context = context
        self._ranges = mesh.ranges
        images = {"ALBEDO_IMAGE": 1} if mesh.has_images else {}
        images |= {"NORMAL_IMAGE": 1, "LEAST_TILT": f"{LEAST_TILT:.9e}"} if mesh.has_normals else {}
        images |= {"TRANSLUCENT": 1} if mesh.translucent and "INDIRECT" in defines else {}
        images |= {"HAIR": 1} if mesh.hair else {}
        images |= {"ROUGHNESS_IMAGE": 1} if mesh.has_roughness and "GLOSSY" in defines else {}
        pasted = mesh.hair.pasted if mesh.hair else None
        self._hair = mesh.hair
        self._programs = {
            "depth": shaders.program(context, "draw.vert", None, {}),
            "back": shaders.program(context, "draw.vert", "back.frag", {}),
            "shaded": shaders.program(context, "draw.vert", "draw.frag", {"SHADED": 1, **images, **defines}, pasted),
        }
        self._meshes = {name: mesh.bound_to(self._programs[name]) for name in ("depth", "back", "shaded")}
        self._sky = Sky(context)

    def run(self, screen: Screen, camera: Float[np.ndarray, "4 4"], lights: UploadedLights) -> None:
        """Draw one frame: depth first, so that every pixel is shaded once; then surfaces, backs and sky.

        `camera` is world to clip. Lights and whatever the reconstruction reads are bound by the caller.
        """
        ctx = self._context
        screen.linear.use()
        screen.linear.clear(depth=1.0)
        for name in ("depth", "back", "shaded"):
            shaders.uniform(self._programs[name], "camera").write(to_glsl(camera))
        ctx.enable_only(moderngl.DEPTH_TEST | moderngl.CULL_FACE)
        ctx.depth_func, ctx.cull_face = "<", "back"
        screen.linear.color_mask = (False, False, False, False)
        self._meshes["depth"].render(moderngl.TRIANGLES)
        screen.linear.color_mask = (True, True, True, True)
        ctx.depth_func = "<="
        if "eye" in self._programs["shaded"]:
            shaders.uniform(self._programs["shaded"], "eye").value = tuple(eye_of(camera))
        if self._hair and "viewer" in self._programs["shaded"]:
            shaders.uniform(self._programs["shaded"], "viewer").value = tuple(eye_of(camera))
            self._hair.bind()
        for first, count, images in self._ranges:
            for unit, image in images.items():
                image.use(unit)
            self._meshes["shaded"].render(moderngl.TRIANGLES, vertices=count, first=first)
        # Backs lie a little deeper, so that the other side of a two-sided surface, where it has one, wins.
        ctx.cull_face, ctx.depth_func, ctx.polygon_offset = "front", "<", (0.0, 16.0)
        self._meshes["back"].render(moderngl.TRIANGLES)
        ctx.polygon_offset = (0.0, 0.0)
        ctx.enable_only(moderngl.DEPTH_TEST | moderngl.BLEND)
        ctx.depth_func = "<="
        self._sky.draw(camera, lights)


class Sky:
    """Environment maps behind whatever is drawn."""

    def __init__(self, context: moderngl.Context) -> None:
        self._context = context
        self._program = shaders.program(context, "screen.vert", "sky.frag", {})
        self._triangle = context.vertex_array(self._program, [])

    def draw(self, camera: Float[np.ndarray, "4 4"], lights: UploadedLights) -> None:
        """Add up the maps of `lights`, where the depth test lets them and blending is on."""
        self._context.blend_func = moderngl.ONE, moderngl.ONE
        for texture, rotation in lights.environments:
            to_map = np.eye(4)
            to_map[:3, :3] = rotation.T
            from_screen = to_map @ directions_from_screen(camera)
            shaders.uniform(self._program, "from_screen").write(to_glsl(from_screen))
            texture.use(3)
            self._triangle.render(moderngl.TRIANGLES, vertices=3)


def directions_from_screen(camera: Float[np.ndarray, "4 4"]) -> Float[np.ndarray, "4 4"]:
    """Clip space at depth 1 to world directions from the eye, of any length."""
    minus_eye = np.eye(4)
    minus_eye[:3, 3] = -eye_of(camera)
    return minus_eye @ np.linalg.inv(camera)


def eye_of(camera: Float[np.ndarray, "4 4"]) -> Float[np.ndarray, "3"]:
    """Where a projection looks from: it sends its centre to (0, 0, 1, 0)."""
    inverse = np.linalg.inv(camera)
    return inverse[:3, 2] / inverse[3, 2]
